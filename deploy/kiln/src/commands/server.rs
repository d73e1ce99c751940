//! `kiln server`: the HTTP API, the queue and the chunk store.

use std::error::Error as StdError;
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use lightkiln_proto::kinds::Kinds;
use lightkiln_server::places::ChunksPlace;
use lightkiln_server::store::FarmRules;
use lightkiln_server::{Config, ConnectionConfig, LimitConfig, Retention, TlsFiles, WebhookConfig};
use lightkiln_worker::runtime::Level;
use tokio::runtime::Runtime;

use crate::arguments::StateArguments;
use crate::console::answer;
use crate::embedded::server_failure;
use crate::failure::{Exit, Failure, Result};
use crate::interrupt::Interrupt;
use crate::pages::pages;

/// Also the longest wait of one look at the flag; any length would do there.
const HOUR: Duration = Duration::from_secs(3600);

/// Arguments of `kiln server`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Address and port to listen on; port 0 takes a free one. The address is printed on standard output
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:7410")]
    listen: String,
    /// Listens on addresses that other machines can reach, although nobody has a token: whoever reaches the port can
    /// submit, read and cancel bakes. Without need where 'kiln token' made tokens
    #[arg(long)]
    allow_non_loopback: bool,
    #[command(flatten)]
    state: StateArguments,
    /// Store of the chunks: a folder, or s3://BUCKET/PREFIX with keys, region and endpoint in the usual variables
    /// AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION and AWS_ENDPOINT_URL [default: a folder in the state folder]
    #[arg(long, value_name = "URL", env = "KILN_CHUNKS")]
    chunks: Option<ChunksPlace>,
    /// Serves with TLS: PEM file of the certificate, with those between it and one that callers trust. Read at the start
    #[arg(long, value_name = "FILE", requires = "tls_key", help_heading = "TLS")]
    tls_cert: Option<PathBuf>,
    /// PEM file of the certificate's private key
    #[arg(long, value_name = "FILE", requires = "tls_cert", help_heading = "TLS")]
    tls_key: Option<PathBuf>,
    /// Posts to this URL when a bake has ended, signed with the secret in the variable KILN_WEBHOOK_SECRET; may be given
    /// several times
    #[arg(long, value_name = "URL", help_heading = "Webhooks")]
    webhook: Vec<String>,
    /// Lets webhooks call this machine (127.0.0.1, ::1) and its link (169.254.0.0/16, fe80::/10)
    #[arg(long, help_heading = "Webhooks", requires = "webhook")]
    webhook_allow_local: bool,
    /// Calls a second of one caller, a token at an address, in the long run; twice as many at once. More are answered
    /// 429 with Retry-After. 0 is no limit
    #[arg(long, value_name = "N", default_value_t = LimitConfig::default().calls_per_sec, help_heading = "Limits",
        value_parser = clap::value_parser!(u32).range(0..=1_000_000))]
    calls_per_sec: u32,
    /// Calls under way at a time, those of waiting workers and watchers included. 0 is no limit
    #[arg(long, value_name = "N", default_value_t = LimitConfig::default().calls_at_a_time, help_heading = "Limits",
        value_parser = clap::value_parser!(u32).range(0..=1_000_000))]
    calls_at_a_time: u32,
    /// Connections at a time; fewer where few files may be open (ulimit -n). A silent one makes room for another. 0 is as
    /// many as the system allows
    #[arg(long, value_name = "N", default_value_t = ConnectionConfig::default().at_a_time, help_heading = "Limits",
        value_parser = clap::value_parser!(u32).range(0..=1_000_000))]
    connections: u32,
    /// The same of one address; three quarters of all at most. 0 is no limit of its own
    #[arg(long, value_name = "N", default_value_t = ConnectionConfig::default().of_address, help_heading = "Limits",
        value_parser = clap::value_parser!(u32).range(0..=1_000_000))]
    connections_of_address: u32,
    /// Bytes a second that an upload must bring in the long run; slower ones end with 408. Plans must bring 64 times as
    /// much while others wait for their room. 0 is no limit but for plans
    #[arg(long, value_name = "BYTES", default_value_t = LimitConfig::default().body_bytes_per_sec, help_heading = "Limits",
        value_parser = clap::value_parser!(u32).range(0..=1_000_000_000))]
    upload_bytes_per_sec: u32,
    /// Most that the chunk store may hold, such as 500M, 200G or 2T; uploads beyond are refused with 507 until there is
    /// room [default: as much as there is]
    #[arg(long, value_name = "SIZE", value_parser = parse_size)]
    quota: Option<u64>,
    /// Times that a worker may be lost with one task (killed, out of reach, its machine gone) before its bake fails; each costs a second
    /// more of waiting than the one before. Failures that workers report count apart
    #[arg(long, value_name = "N", default_value_t = FarmRules::default().lost_workers, help_heading = "Limits",
        value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    lost_workers: u32,
    /// Hours that stored bytes stay although no bake needs them; longer than the longest upload and task
    #[arg(long, value_name = "HOURS", default_value_t = 24, value_parser = clap::value_parser!(u32).range(1..=8760))]
    grace_hours: u32,
    /// Deletes bakes this many days after their end, with the results that no other bake holds [default: never]
    #[arg(long, value_name = "DAYS", value_parser = clap::value_parser!(u32).range(1..=36500))]
    keep_days: Option<u32>,
}

/// Bytes from a number with a unit of 1024 to some power.
fn parse_size(text: &str) -> std::result::Result<u64, String> {
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let shift = match text[digits.len()..].to_ascii_uppercase().trim_end_matches("IB") {
        "" => Some(0),
        "K" => Some(10),
        "M" => Some(20),
        "G" => Some(30),
        "T" => Some(40),
        _ => None,
    };
    let size =
        digits.parse::<u64>().ok().zip(shift).and_then(|(number, shift)| number.checked_mul(1 << shift));
    size.ok_or_else(|| format!("'{text}' is no size; write a number and K, M, G or T, such as 200G"))
}

/// Serves until a signal comes.
pub fn run(arguments: Arguments, kinds: &Kinds) -> Result<()> {
    let interrupt = Interrupt::listen()?;
    let tls = arguments.tls_cert.zip(arguments.tls_key).map(|(cert, key)| TlsFiles { cert, key });
    let scheme = if tls.is_some() { "https" } else { "http" };
    let config = Config {
        kinds: kinds.clone(),
        pages: pages(),
        tls,
        webhooks: webhooks(&arguments.webhook, arguments.webhook_allow_local)?,
        limits: LimitConfig {
            calls_per_sec: arguments.calls_per_sec,
            calls_at_a_time: arguments.calls_at_a_time,
            body_bytes_per_sec: arguments.upload_bytes_per_sec,
            ..LimitConfig::default()
        },
        connections: ConnectionConfig {
            at_a_time: arguments.connections,
            of_address: arguments.connections_of_address,
            ..ConnectionConfig::default()
        },
        allow_non_loopback: arguments.allow_non_loopback,
        database: arguments.state.database.clone(),
        chunks: arguments.chunks,
        quota_bytes: arguments.quota,
        rules: FarmRules { lost_workers: arguments.lost_workers },
        retention: Retention {
            grace: HOUR * arguments.grace_hours,
            bakes: arguments.keep_days.map(|days| 24 * HOUR * days),
            ..Retention::default()
        },
        ..Config::new(arguments.state.folder()?)
    };
    let failed =
        |what: &str, error: &(dyn StdError + 'static)| Failure::new(Exit::Failed, what).caused_by(error);
    let runtime = Runtime::new().map_err(|error| failed("the server's threads cannot be started", &error))?;
    runtime.block_on(async {
        let flag = interrupt.flag().clone();
        let signal =
            tokio::task::spawn_blocking(
                move || {
                    while flag.wait(HOUR, |level| level > Level::Run) == Level::Run {}
                },
            );
        let shutdown = async {
            let _ = signal.await;
        };
        // For scripts that asked for a free port: the first and only line on standard output.
        let announce = |address| answer!("listening on {scheme}://{address}");
        let served = lightkiln_server::serve(config, &arguments.listen, announce, shutdown).await;
        // The thread that waits for a signal would keep the process.
        interrupt.flag().raise(Level::Drain);
        served.map_err(|error| server_failure(&error))
    })
}

/// The secret comes from a variable, as command lines can be read by others.
fn webhooks(urls: &[String], allow_local: bool) -> Result<Option<WebhookConfig>> {
    if urls.is_empty() {
        return Ok(None);
    }
    let secret = std::env::var("KILN_WEBHOOK_SECRET").unwrap_or_default();
    let config = WebhookConfig::new(urls, &secret, allow_local);
    config.map(Some).map_err(|error| {
        Failure::bad_input("the server cannot run").caused_by(&error).try_this(
            "--webhook https://HOST/PATH, and KILN_WEBHOOK_SECRET with what 'openssl rand -hex 32' prints",
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_with_their_units() {
        for (text, bytes) in [("0", 0), ("12", 12), ("3k", 3 << 10), ("500M", 500 << 20), ("2TiB", 2 << 40)] {
            assert_eq!(parse_size(text), Ok(bytes), "{text}");
        }
        for text in ["", "G", "1.5G", "-1", "1X", "99999999999T", "1 G"] {
            assert!(parse_size(text).is_err(), "{text}");
        }
    }
}
