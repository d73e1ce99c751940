//! `kiln submit`: asks a farm for a bake and prints its id.

use std::path::PathBuf;

use clap::Args;

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
    /// Waits until the bake ends; Ctrl-C ends the wait, not the bake
    #[arg(long)]
    wait: bool,
}

/// Prints the bake's id on standard output.
pub fn run(arguments: Arguments) -> Result<()> {
    let settings = arguments.settings.resolve()?;
    let scene = PackedScene::read(&arguments.scene)?;
    let interrupt = Interrupt::listen()?;
    let client = connect(&arguments.server.server, &interrupt)?;
    let bake = scene.submit(&client, &settings, arguments.priority)?;
    println!("{}", bake.id);
    if arguments.wait {
        follow(&client, &bake.id, &interrupt, || Ok(()))?;
    }
    Ok(())
}
