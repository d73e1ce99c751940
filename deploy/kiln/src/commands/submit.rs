//! `kiln submit`: asks a farm for a bake and prints its id.

use std::path::PathBuf;

use clap::Args;
use lightkiln_proto::api::Needs;

use super::following::follow;
use super::submitting::{PackedScene, connect};
use crate::arguments::ServerArgument;
use crate::failure::Result;
use crate::interrupt::Interrupt;
use crate::settings::SettingsArguments;

/// Arguments of `kiln submit`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// The scene: a .glb, a .gltf with its files beside it, or a .zip of them
    scene: PathBuf,
    #[command(flatten)]
    server: ServerArgument,
    #[command(flatten)]
    settings: SettingsArguments,
    /// Bigger runs first
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    priority: i32,
    /// Memory in MiB that a worker must have to take its tasks
    #[arg(long, value_name = "MIB", default_value_t = 0)]
    needs_memory_mib: u32,
    /// Threads that a worker must have to take its tasks
    #[arg(long, value_name = "N", default_value_t = 0)]
    needs_threads: u32,
    /// A label that a worker must have to take its tasks; may be repeated
    #[arg(long = "needs-label", value_name = "LABEL")]
    needs_labels: Vec<String>,
    /// Seconds that one attempt at a task may take before it counts as failed [default: a day]
    #[arg(long, value_name = "SECS")]
    attempt_limit_secs: Option<u32>,
    /// Waits until the bake ends; Ctrl-C ends the wait, not the bake
    #[arg(long)]
    wait: bool,
}

/// Prints the bake's id on standard output.
pub fn run(arguments: Arguments) -> Result<()> {
    let settings = arguments.settings.resolve()?;
    let scene = PackedScene::read(&arguments.scene)?;
    let needs = Needs {
        memory_mib: arguments.needs_memory_mib,
        threads: arguments.needs_threads,
        labels: arguments.needs_labels,
    };
    let interrupt = Interrupt::listen()?;
    let client = connect(&arguments.server.server, &interrupt)?;
    let bake = scene.submit(&client, |bake| {
        bake.settings = settings;
        bake.priority = arguments.priority;
        bake.needs = needs;
        bake.attempt_limit_secs = arguments.attempt_limit_secs;
    })?;
    println!("{}", bake.id);
    if arguments.wait {
        follow(&client, &bake.id, &interrupt, || Ok(()))?;
    }
    Ok(())
}
