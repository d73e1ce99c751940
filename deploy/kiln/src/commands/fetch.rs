//! `kiln fetch`: downloads a finished bake as a bundle.

use std::path::PathBuf;
use std::time::Instant;

use clap::Args;
use lightkiln_proto::kinds::Kinds;

use crate::arguments::{PatienceArgument, ServerArgument};
use crate::bundle::write_bundle;
use crate::console::say;
use crate::failure::Result;
use crate::interrupt::Interrupt;

/// Arguments of `kiln fetch`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// The bake's id, or its first characters (4 or more)
    id: String,
    /// Folder to write the bundle to, new, empty or a bundle's; its chunks that are there already are kept
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    server: ServerArgument,
    #[command(flatten)]
    patience: PatienceArgument,
}

/// Downloads manifest, chunks and report; the same command again goes on after an interruption.
pub fn run(arguments: Arguments, kinds: &Kinds) -> Result<()> {
    let started = Instant::now();
    let interrupt = Interrupt::listen()?;
    let client = arguments.patience.with(arguments.server.connect_until(&interrupt)?);
    let bake = client.bake(&arguments.id)?;
    let written = write_bundle(kinds, &client, &bake, &bake.name, &arguments.out, started);
    let (_, done) = written.map_err(|failure| match bake.results_lost {
        0 => failure,
        lost => failure.try_this(format!(
            "'kiln submit' of its scene, then this again: {lost} results were lost after the bake had ended"
        )),
    })?;
    let (fetched, bytes, kept) = (done.fetched, done.fetched_bytes, done.kept);
    say!("{fetched} chunks fetched ({bytes} bytes), {kept} were there already: {}", arguments.out.display());
    Ok(())
}
