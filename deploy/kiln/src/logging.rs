//! The log: to standard error, filtered by `KILN_LOG`, or `RUST_LOG` where that is not set. Spans of traces go to whom [`crate::telemetry`] names.

use std::io::{self, IsTerminal as _};

use tracing_subscriber::filter::LevelFilter;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;
use tracing_subscriber::{EnvFilter, Layer as _};

use crate::telemetry::Telemetry;

/// Variables that filter the log, the first one that is set.
const VARIABLES: [&str; 2] = ["KILN_LOG", "RUST_LOG"];
/// Filter of commands that end: what server and worker inside this process warn of, the command says in its own words.
const OF_COMMANDS: &str = "warn,lightkiln_server=error,lightkiln_worker=error,arboard=error,winit=error";

/// Starts logging, warnings and errors unless [`VARIABLES`] say otherwise (`info`, `lightkiln_server=debug`, …), and traces
/// if the environment asks for them; those of `role` are exported until what is returned is dropped. `stays` says that the
/// command goes on until somebody stops it: then the log is all that it says.
pub fn start(role: &str, stays: bool) -> Telemetry {
    let given = VARIABLES.iter().find_map(|name| std::env::var(name).ok().filter(|value| !value.is_empty()));
    let filter = EnvFilter::builder()
        .with_default_directive(LevelFilter::WARN.into())
        .parse_lossy(given.as_deref().unwrap_or(if stays { "" } else { OF_COMMANDS }));
    let log = tracing_subscriber::fmt::layer()
        .with_writer(io::stderr)
        .with_ansi(io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|no| no.is_empty()))
        .with_target(false)
        .with_filter(filter);
    let telemetry = Telemetry::from_environment(role);
    tracing_subscriber::registry().with(log).with(telemetry.layer()).init();
    telemetry.warn();
    telemetry
}
