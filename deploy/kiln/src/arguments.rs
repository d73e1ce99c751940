//! Arguments that several subcommands share.

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use lightkiln_client::fetch::{ApiClient, Source};
#[cfg(feature = "view")]
use lightkiln_client::lights::quoted;
use lightkiln_http::{DiskCache, Notice, Patience, RetryPolicy};
use lightkiln_server::places::DatabasePlace;

use crate::console::say;
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

/// How long a server that is away is waited for.
#[derive(Args, Clone, Debug)]
pub struct PatienceArgument {
    /// Waits so long for a farm that does not answer, as its server or database starts again, such as 90s, 10m or 2h; says
    /// so on standard error. 0 gives up at once
    #[arg(long, value_name = "TIME", env = "KILN_PATIENCE", default_value = "10m", value_parser = parse_patience)]
    patience: Duration,
}

impl PatienceArgument {
    /// The farm's server, waited for; without patience, asked once.
    pub fn with(&self, client: ApiClient) -> ApiClient {
        let server = client.base().to_owned();
        client.with_patience(Patience::new(self.patience, move |notice| tell(&server, &notice)))
    }
}

fn parse_patience(text: &str) -> std::result::Result<Duration, String> {
    if text == "0" {
        return Ok(Duration::ZERO);
    }
    humantime::parse_duration(text).map_err(|_| format!("'{text}' is no time; write 0, 90s, 10m or 2h"))
}

fn tell(server: &str, notice: &Notice<'_>) {
    let whole = |time: Duration| humantime::format_duration(Duration::from_secs(time.as_secs()));
    match notice {
        Notice::Waiting { error, left } => {
            let why = lightkiln_proto::problem::chain(*error);
            say!("waiting for {server}, for {} at most (--patience): {why}", whole(*left));
        }
        Notice::Back { after } => say!("{server} answers again, after {}", whole(*after)),
    }
}

/// A bake to look at.
#[derive(Args, Clone, Debug)]
pub struct BakeArgument {
    /// Bundle folder; with --server, the id of a bake there, which must be done but for preview and view
    #[arg(value_name = "BUNDLE_OR_ID")]
    bake: PathBuf,
    /// Takes the bake from the server at this URL
    #[arg(long, value_name = "URL")]
    server: Option<String>,
    #[command(flatten)]
    trust: TrustArgument,
    #[command(flatten)]
    patience: PatienceArgument,
    /// Folder for chunks fetched from a server, from which the next picture takes them [default: chunks in the state folder]
    #[arg(long, value_name = "DIR", requires = "server")]
    cache: Option<PathBuf>,
    /// GiB that the cache folder may hold, the least recently used go first; 0 for no cache
    #[arg(long, value_name = "GIB", default_value_t = 4, value_parser = clap::value_parser!(u64).range(0..=65536), requires = "server")]
    cache_gib: u64,
}

impl BakeArgument {
    /// The words that name it on a command line.
    #[cfg(feature = "view")]
    pub fn words(&self) -> String {
        let bake = quoted(&self.bake.to_string_lossy());
        self.server.as_ref().map_or(bake.clone(), |url| format!("{bake} --server {}", quoted(url)))
    }

    /// The bundle's folder; of a bake on a farm, its id.
    pub fn folder(&self) -> &Path {
        &self.bake
    }

    /// Server and id of a bake on a farm.
    pub fn on_farm(&self) -> Result<Option<(ApiClient, String)>> {
        let Some(url) = &self.server else { return Ok(None) };
        let client = self.patience.with(self.trust.connect(url, &Interrupt::default())?);
        Ok(Some((client, self.bake.to_string_lossy().into_owned())))
    }

    /// Its source, with a cache for what a server gives.
    pub fn open(&self) -> Result<Source> {
        let Some((client, id)) = self.on_farm()? else { return Ok(Source::bundle(&self.bake)?) };
        let source = Source::server(client, id);
        Ok(match self.cache_gib {
            0 => source,
            gib => cached(source, or_in_state(self.cache.clone(), "chunks").ok(), gib),
        })
    }
}

/// The source with a cache in a folder, or without one where the folder cannot be used, which is said.
fn cached(source: Source, folder: Option<PathBuf>, gib: u64) -> Source {
    let Some(folder) = folder else {
        say!(
            "note: there is no place for a cache (neither KILN_STATE nor HOME is set): chunks are fetched each time"
        );
        return source;
    };
    match DiskCache::open(&folder, gib << 30) {
        Ok(cache) => source.with_cache(cache),
        Err(error) => {
            let folder = folder.display();
            say!("warning: the cache {folder} cannot be used ({error}): chunks are fetched each time");
            source
        }
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
