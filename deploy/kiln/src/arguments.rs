//! Arguments that several subcommands share.

use std::path::PathBuf;

use clap::Args;

use crate::failure::{Failure, Result};

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
