//! Arguments that several subcommands share.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use lightkiln_client::fetch::ApiClient;
use lightkiln_http::RetryPolicy;
use lightkiln_server::places::DatabasePlace;

use crate::embedded::or_in_state;
use crate::failure::{Failure, Result};
use crate::interrupt::Interrupt;

/// Few and quick, as a person waits for the first answer.
const FIRST_CONTACT: RetryPolicy = RetryPolicy::new()
    .with_min_delay(Duration::from_millis(250))
    .with_max_delay(Duration::from_secs(1))
    .with_max_times(4);

/// Which certificates to trust.
#[derive(Args, Clone, Debug)]
pub struct TrustArgument {
    /// PEM file of certificates, one of which must have signed that of the server [default: those of the web's authorities]
    #[arg(long, value_name = "FILE", env = "KILN_CA")]
    pub ca: Option<PathBuf>,
}

impl TrustArgument {
    /// The file's content, if there is one to read.
    pub fn pem(&self) -> Result<Option<Vec<u8>>> {
        let Some(path) = &self.ca else { return Ok(None) };
        std::fs::read(path).map(Some).map_err(|error| {
            let what = format!("the certificates to trust, {}, cannot be read", path.display());
            Failure::bad_input(what).caused_by(&error).try_this("another file with --ca")
        })
    }

    /// A server that answers quickly or not at all; its waits end on Ctrl-C.
    pub fn connect(&self, url: &str, interrupt: &Interrupt) -> Result<ApiClient> {
        let client = ApiClient::trusting(url, own_token()?.as_deref(), self.pem()?.as_deref())?;
        Ok(client.with_retry(FIRST_CONTACT).with_shutdown(interrupt.flag().clone()))
    }
}

/// Which server to call.
#[derive(Args, Clone, Debug)]
pub struct ServerArgument {
    /// Base URL of the server
    #[arg(long, value_name = "URL", env = "KILN_SERVER", default_value = "http://127.0.0.1:7410")]
    pub server: String,
    #[command(flatten)]
    pub trust: TrustArgument,
}

impl ServerArgument {
    /// The server, for calls that Ctrl-C ends with the process.
    pub fn connect(&self) -> Result<ApiClient> {
        self.connect_until(&Interrupt::default())
    }

    /// The server, for calls that wait until they are interrupted.
    pub fn connect_until(&self, interrupt: &Interrupt) -> Result<ApiClient> {
        self.trust.connect(&self.server, interrupt)
    }
}

/// Where a farm's server keeps its state.
#[derive(Args, Clone, Debug)]
pub struct StateArguments {
    /// Folder of the server's state [default: server in the state folder of 'kiln bake']
    #[arg(long, value_name = "DIR", global = true)]
    state: Option<PathBuf>,
    /// Database of the queue: sqlite:PATH, or postgres://USER:PASSWORD@HOST/NAME, which any number of servers may
    /// share [default: a file in the state folder]
    #[arg(long, value_name = "URL", env = "KILN_DATABASE", hide_env_values = true, global = true)]
    pub database: Option<DatabasePlace>,
}

impl StateArguments {
    /// The folder.
    pub fn folder(&self) -> Result<PathBuf> {
        or_in_state(self.state.clone(), "server")
    }
}

/// The token for calls to a farm, from the variable `KILN_TOKEN`: command lines can be read by others.
pub fn own_token() -> Result<Option<String>> {
    let Some(token) = std::env::var_os("KILN_TOKEN").filter(|token| !token.is_empty()) else {
        return Ok(None);
    };
    let token = token.into_string().ok().filter(|token| token.bytes().all(|byte| byte.is_ascii_graphic()));
    let wrong = || {
        Failure::bad_input(
            "KILN_TOKEN holds what no token has: spaces, line ends or letters that are not ASCII",
        )
        .try_this("KILN_TOKEN with what 'kiln token create' printed")
    };
    token.map(Some).ok_or_else(wrong)
}
