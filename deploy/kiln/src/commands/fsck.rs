//! `kiln fsck`: checks a farm's stored bytes, and makes good what can be made good.

use std::time::Duration;

use clap::Args;
use lightkiln_server::fsck::{Checks, Findings, Flaw, Incomplete};
use lightkiln_server::places::ChunksPlace;
use lightkiln_server::{ServerError, check_storage};
use tokio::runtime::Runtime;

use crate::arguments::StateArguments;
use crate::console::{answer, put_json};
use crate::embedded::server_failure;
use crate::failure::{Exit, Failure, Result};

/// Arguments of `kiln fsck`.
#[derive(Args, Debug)]
#[command(
    after_help = "It may run beside servers. Missing and corrupt chunks are given up by --repair: their tasks run again \
                        where a live bake needs them, at once, and else when a later bake does. Orphaned bytes are removed. \
                        Bakes that lost results after their end are named; a new bake of the scene completes them. \
                        Lost scenes of bakes under way cannot be repaired: submitting them again uploads them."
)]
pub struct Arguments {
    #[command(flatten)]
    state: StateArguments,
    /// The farm's chunk store, as given to 'kiln server' [default: a folder in the state folder]
    #[arg(long, value_name = "URL", env = "KILN_CHUNKS")]
    chunks: Option<ChunksPlace>,
    /// Makes good what is found
    #[arg(long)]
    repair: bool,
    /// Looks at lengths alone, and reads no bytes
    #[arg(long)]
    quick: bool,
    /// Hours after which bytes that nobody knows of count as orphaned; younger ones may be uploads under way
    #[arg(long, value_name = "HOURS", default_value_t = 24, value_parser = clap::value_parser!(u32).range(0..=8760))]
    grace_hours: u32,
    /// Prints what was found as JSON
    #[arg(long)]
    json: bool,
}

/// Checks, and fails if something is wrong and was not made good.
pub fn run(arguments: Arguments) -> Result<()> {
    let checks = Checks {
        reads: !arguments.quick,
        repairs: arguments.repair,
        grace: Duration::from_secs(3600 * u64::from(arguments.grace_hours)),
    };
    let runtime = Runtime::new()
        .map_err(|error| Failure::new(Exit::Failed, "no thread can be started").caused_by(&error))?;
    let checked: std::result::Result<Findings, ServerError> = runtime.block_on(check_storage(
        &arguments.state.folder()?,
        arguments.state.database.as_ref(),
        arguments.chunks.as_ref(),
        checks,
    ));
    let findings = checked.map_err(|error| server_failure(&error))?;
    if arguments.json {
        put_json(&findings);
    } else {
        print(&findings);
    }
    if findings.is_sound() {
        return Ok(());
    }
    let failure = Failure::new(Exit::Unsound, "the stored bytes are not sound");
    Err(if checks.repairs {
        failure.try_this("'kiln submit' of the scenes that are lost, which uploads them again")
    } else {
        failure.try_this("'kiln fsck --repair'")
    })
}

fn print(findings: &Findings) {
    answer!("{} chunks, {} bytes", findings.chunks, findings.bytes);
    let kinds = [
        ("missing", &findings.missing),
        ("corrupt", &findings.corrupt),
        ("orphaned", &findings.orphaned),
        ("lost", &findings.lost),
    ];
    for (kind, flaws) in kinds {
        for Flaw { digest, bytes, references } in flaws {
            answer!("{kind:8}  {digest}  {bytes} bytes, {references} references");
        }
    }
    for Incomplete { bake, name, results_lost } in &findings.incomplete {
        answer!(
            "bake      {bake} ({name}) lost {results_lost} results after its end; a new bake of its scene makes them"
        );
    }
    if findings.repaired {
        answer!("repaired; {} results were forgotten", findings.results_forgotten);
    }
}
