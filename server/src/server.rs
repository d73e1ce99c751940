//! A server over its state: opening, serving, stopping.
//!
//! Unless told otherwise the state is one folder, and one server may have it open, or bakes beside each other
//! ([`crate::hold`]):
//! ```text
//! STATE/lock, seats/   held while a program has the queue's file open
//! STATE/farm.sqlite    the queue (with -wal and -shm beside it)
//! STATE/chunks/ab/…    the bytes
//! ```
//! With PostgreSQL and S3 a server keeps nothing itself: any number of them may serve one farm, and come and go.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use lightkiln_proto::kinds::Kinds;
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio_rustls::TlsAcceptor;

use crate::chunks::ObjectChunks;
use crate::clock::SystemClock;
use crate::collect::{self, Retention};
use crate::connections::{self, ConnectionConfig};
use crate::error::{Result, ServerError};
use crate::farm::Farm;
use crate::fsck::{self, Checks, Findings};
use crate::hold::{self, Hold, make_folder};
use crate::http::{self, LimitConfig};
use crate::left_over;
use crate::occupant::Occupant;
use crate::pages::Pages;
use crate::places::{ChunksPlace, DatabasePlace};
use crate::storage::Storage;
use crate::store::{FarmRules, SqlStore};
use crate::tls::TlsFiles;
use crate::wakeup::{LocalWakeup, PostgresWakeup, Wakeup};
use crate::webhooks::{self, WebhookConfig};

/// Configuration of a server. `Config::new(folder)` gives the defaults.
#[derive(Clone, Debug)]
pub struct Config {
    /// Folder of all state that has no other place; made if need be.
    pub state_dir: PathBuf,
    /// Address of the queue's database. Default: `farm.sqlite` in the state folder.
    pub database: Option<DatabasePlace>,
    /// Address of the chunk store. Default: `chunks` in the state folder.
    pub chunks: Option<ChunksPlace>,
    /// Serve addresses that other machines can reach although nobody has a token. Default: no.
    pub allow_non_loopback: bool,
    /// Serve with TLS. Default: without.
    pub tls: Option<TlsFiles>,
    /// Webhooks that are told when a bake has ended. Default: none.
    pub webhooks: Option<WebhookConfig>,
    /// Kinds of bake that are taken in. Default: all that the contract knows.
    pub kinds: Kinds,
    /// Limits of calls.
    pub limits: LimitConfig,
    /// Limits of connections.
    pub connections: ConnectionConfig,
    /// Files for browsers. Default: none.
    pub pages: Pages,
    /// Most bytes of chunks at a time; uploads beyond are refused until there is room. Default: no limit but the disk's.
    pub quota_bytes: Option<u64>,
    /// Retention of chunks and bakes.
    pub retention: Retention,
    /// Rules of the queue.
    pub rules: FarmRules,
    /// Expired leases are looked for this often. Shorter → lost workers are noticed sooner. Default: 1 s.
    pub reap_interval: Duration,
    /// Waiting calls look again this often without a hint. Shorter → sooner, at more load. Default: 1 s.
    pub poll_interval: Duration,
    /// Requests under way may take this long after the order to stop. Default: 10 s.
    pub stop_grace: Duration,
}

impl Config {
    /// The defaults over a state folder.
    pub fn new(state_dir: impl Into<PathBuf>) -> Self {
        Self {
            state_dir: state_dir.into(),
            database: None,
            chunks: None,
            allow_non_loopback: false,
            tls: None,
            webhooks: None,
            kinds: Kinds::new(),
            limits: LimitConfig::default(),
            connections: ConnectionConfig::default(),
            pages: Pages::default(),
            quota_bytes: None,
            retention: Retention::default(),
            rules: FarmRules::default(),
            reap_interval: Duration::from_secs(1),
            poll_interval: Duration::from_secs(1),
            stop_grace: Duration::from_secs(10),
        }
    }

    /// Whether the database is a program that may start later, or again.
    pub(crate) fn database_is_remote(&self) -> bool {
        matches!(self.database, Some(DatabasePlace::Postgres(_)))
    }

    /// The certificate and its key, if there are some.
    pub(crate) async fn acceptor(&self) -> Result<Option<TlsAcceptor>> {
        let Some(files) = &self.tls else { return Ok(None) };
        files.read().await.map(Some).map_err(|source| {
            let TlsFiles { cert, key } = files.clone();
            ServerError::Tls { cert, key, source }
        })
    }
}

/// An open farm, ready to serve.
pub struct Server {
    config: Config,
    farm: Arc<Farm>,
    store: Arc<SqlStore>,
    tls: Option<TlsAcceptor>,
    closing: watch::Sender<bool>,
    /// Whether others have the state folder open beside it.
    is_seated: bool,
    /// Held, not read.
    _hold: Option<Hold>,
}

/// A server's seat at a state folder that others have open beside it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Seat {
    /// A name that no other has meanwhile. A bake of this process asks for it as a label of its workers, so that nobody
    /// else works on it, and whoever has the seat next knows that it was left over.
    pub name: String,
}

impl Server {
    /// Opens queue and bytes; fails if another program has the queue's file open.
    pub async fn open(config: Config) -> Result<Self> {
        let in_state = DatabasePlace::Sqlite(config.state_dir.join("farm.sqlite"));
        let database = config.database.clone().unwrap_or(in_state);
        let (store, wakeup, hold) = open_database(&database).await?;
        Self::over(config, store, wakeup, hold).await
    }

    /// Opens queue and bytes in the state folder, beside others that do the same; fails if it is a server's, or another
    /// machine's, or has to be brought up to date while others have it open.
    ///
    /// Bakes that ended processes left are cancelled, now and while it serves: nobody waits for them. Their finished tasks
    /// stay, and those under way are given back.
    pub async fn open_seated(config: Config) -> Result<(Self, Seat)> {
        let path = config.state_dir.join("farm.sqlite");
        let seating = hold::take_seat(&config.state_dir)?;
        if !seating.others.is_empty() && !SqlStore::is_current_sqlite(&path).await? {
            let by = Occupant::OlderBakes(seating.others.iter().map(|(_, process)| *process).collect());
            return Err(ServerError::StateInUse { path: config.state_dir, by });
        }
        let store = SqlStore::open_sqlite(&path, Arc::new(SystemClock)).await?;
        let held: Vec<String> = seating.others.into_iter().map(|(name, _)| name).collect();
        left_over::clear(&store, &held, &seating.free).await?;
        // Others may take their seats from here on.
        drop(seating.gate);
        let wakeup = Arc::new(LocalWakeup::default());
        let server = Self::over(config, store, wakeup, Some(seating.hold)).await?;
        let server = Self { is_seated: true, ..server };
        Ok((server, Seat { name: seating.name }))
    }

    async fn over(
        config: Config,
        store: SqlStore,
        wakeup: Arc<dyn Wakeup>,
        hold: Option<Hold>,
    ) -> Result<Self> {
        let tls = config.acceptor().await?;
        let store = Arc::new(store.with_rules(config.rules));
        let in_state = ChunksPlace::Folder(config.state_dir.join("chunks"));
        let chunks = Arc::new(ObjectChunks::open(config.chunks.as_ref().unwrap_or(&in_state))?);
        let (closing, is_closing) = watch::channel(false);
        let storage = Storage::new(store.clone(), chunks, config.quota_bytes);
        let kinds = config.kinds.clone();
        let farm = Farm::new(store.clone(), storage, wakeup, kinds, config.poll_interval, is_closing);
        let farm = Arc::new(farm);
        Ok(Self { config, farm, store, tls, closing, is_seated: false, _hold: hold })
    }

    /// The farm itself, for calls without HTTP.
    pub fn farm(&self) -> Arc<Farm> {
        self.farm.clone()
    }

    /// Listens on an address such as `127.0.0.1:0`, if it may be served.
    pub async fn bind(&self, address: &str) -> Result<TcpListener> {
        let cannot = |source| ServerError::Listen { address: address.to_owned(), source };
        let resolved: Vec<SocketAddr> = tokio::net::lookup_host(address).await.map_err(cannot)?.collect();
        for address in &resolved {
            self.require_servable(*address).await?;
        }
        TcpListener::bind(&resolved[..]).await.map_err(cannot)
    }

    async fn require_servable(&self, address: SocketAddr) -> Result<()> {
        let may_be_open = address.ip().is_loopback() || self.config.allow_non_loopback;
        if may_be_open || self.farm.guard.has_bearers().await? {
            return Ok(());
        }
        Err(ServerError::NotLoopback { address })
    }

    /// Serves until `shutdown` is done, then lets requests under way end and closes the state.
    pub async fn serve(
        self,
        listener: TcpListener,
        shutdown: impl Future<Output = ()> + Send + 'static,
    ) -> Result<()> {
        let address = listener.local_addr().map_err(ServerError::Serve)?;
        self.require_servable(address).await?;
        let reaper = tokio::spawn(reap(self.farm.clone(), self.config.reap_interval));
        let webhooks =
            self.config.webhooks.clone().map(|config| {
                tokio::spawn(webhooks::run(self.farm.clone(), config, self.closing.subscribe()))
            });
        let seats = self.is_seated.then(|| {
            let folder = self.config.state_dir.clone();
            let interval = self.config.reap_interval;
            tokio::spawn(left_over::watch(self.farm.clone(), self.store.clone(), folder, interval))
        });
        let collector = tokio::spawn(collect::run(self.farm.clone(), self.config.retention));
        let closing = self.closing.clone();
        let stop = async move {
            shutdown.await;
            // Waiting calls and event streams end on this.
            closing.send_replace(true);
        };
        let connections = self.config.connections.within(connections::open_files());
        let limits = self.config.limits.beside(connections.at_a_time);
        let app = http::router(self.farm.clone(), limits, self.config.pages.clone());
        let serving = connections::serve(listener, app, self.tls.clone(), connections, stop);
        let mut closing = self.closing.subscribe();
        let too_long = async {
            let _ = closing.wait_for(|closing| *closing).await;
            tokio::time::sleep(self.config.stop_grace).await;
        };
        tracing::info!(%address, "serving");
        tokio::select! {
            () = serving => (),
            () = too_long => tracing::warn!("requests still under way after the grace were cut off"),
        }
        reaper.abort();
        if let Some(webhooks) = webhooks {
            webhooks.abort();
        }
        if let Some(seats) = seats {
            seats.abort();
        }
        collector.abort();
        self.store.close().await;
        Ok(())
    }
}

async fn reap(farm: Arc<Farm>, interval: Duration) {
    let mut ticks = tokio::time::interval(interval);
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    // Before the first look, and after the database was away, workers could not be heard: that is not their fault.
    let mut was_deaf = true;
    loop {
        ticks.tick().await;
        let looked = async {
            if was_deaf {
                farm.extend_leases().await?;
            }
            farm.reap().await
        };
        let outcome = looked.await;
        was_deaf = outcome.is_err();
        if let Err(error) = outcome {
            tracing::error!(error = error.chain(), "expired leases could not be ended; trying again");
        }
    }
}

type OpenDatabase = (SqlStore, Arc<dyn Wakeup>, Option<Hold>);

/// The queue alone, beside a server that may be running on it.
///
/// The place is that of [`Config::database`].
pub async fn open_store(state_dir: &Path, database: Option<&DatabasePlace>) -> Result<SqlStore> {
    let in_state = DatabasePlace::Sqlite(state_dir.join("farm.sqlite"));
    Ok(match database.unwrap_or(&in_state) {
        DatabasePlace::Sqlite(path) => {
            make_folder(path.parent().unwrap_or(Path::new("")))?;
            SqlStore::open_sqlite(path, Arc::new(SystemClock)).await?
        }
        DatabasePlace::Postgres(url) => SqlStore::open_postgres(url, None).await?,
    })
}

/// Checks the stored bytes, beside servers that may be running on them. The places are those of [`Config`].
pub async fn check_storage(
    state_dir: &Path,
    database: Option<&DatabasePlace>,
    chunks: Option<&ChunksPlace>,
    checks: Checks,
) -> Result<Findings> {
    let store = Arc::new(open_store(state_dir, database).await?);
    let in_state = ChunksPlace::Folder(state_dir.join("chunks"));
    let chunks = Arc::new(ObjectChunks::open(chunks.unwrap_or(&in_state))?);
    let storage = Storage::new(store.clone(), chunks.clone(), None);
    let findings = fsck::check(&*store, &*chunks, &storage, checks).await;
    store.close().await;
    findings
}

async fn open_database(place: &DatabasePlace) -> Result<OpenDatabase> {
    Ok(match place {
        DatabasePlace::Sqlite(path) => {
            let hold = hold::alone(path.parent().unwrap_or(Path::new("")))?;
            let store = SqlStore::open_sqlite(path, Arc::new(SystemClock)).await?;
            (store, Arc::new(LocalWakeup::default()), Some(hold))
        }
        DatabasePlace::Postgres(url) => {
            // The database's time: leases are granted by one server and judged by another.
            let store = SqlStore::open_postgres(url, None).await?;
            (store, Arc::new(PostgresWakeup::connect(url).await?), None)
        }
    })
}
