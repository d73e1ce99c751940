//! The log: to standard error, filtered by `KILN_LOG`. Spans of traces go to whom [`crate::telemetry`] names.

use std::io;

use tracing_subscriber::filter::LevelFilter;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;
use tracing_subscriber::{EnvFilter, Layer as _};

use crate::telemetry::Telemetry;

/// Starts logging, warnings and errors unless `KILN_LOG` says otherwise (`info`, `lightkiln_server=debug`, …), and traces
/// if the environment asks for them; those of `role` are exported until what is returned is dropped.
pub fn start(role: &str) -> Telemetry {
    let filter = EnvFilter::builder()
        .with_default_directive(LevelFilter::WARN.into())
        .with_env_var("KILN_LOG")
        .from_env_lossy();
    let log = tracing_subscriber::fmt::layer().with_writer(io::stderr).with_target(false).with_filter(filter);
    let telemetry = Telemetry::from_environment(role);
    tracing_subscriber::registry().with(log).with(telemetry.layer()).init();
    telemetry.warn();
    telemetry
}
