//! A farm inside this process: the server on a loopback port and one worker, over the same HTTP as any farm.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use lightkiln_proto::api::{BakeFilter, BakeState};
use lightkiln_server::farm::Farm;
use lightkiln_server::store::StoreError;
use lightkiln_server::{Config, Server, ServerError};
use lightkiln_worker::kinds::Runner;
use lightkiln_worker::runtime::{Level, ShutdownFlag, Worker, WorkerConfig, WorkerError, usual_tasks};
use tokio::runtime::Runtime;
use tokio::sync::oneshot;

use crate::failure::{Exit, Failure, Result};
use crate::kinds::KindTables;

/// Lease length: long enough for a machine that is busy or was asleep; leases that a crash leaves are cancelled at the start.
const LEASE_SECS: u32 = 60;
/// Bakes that one look at the queue lists.
const PAGE_BAKES: u32 = 100;

/// Server and worker; both end when it is dropped.
pub struct EmbeddedFarm {
    url: String,
    worker_flag: ShutdownFlag,
    worker: Option<JoinHandle<std::result::Result<(), WorkerError>>>,
    server_end: Option<oneshot::Sender<()>>,
    runtime: Option<Runtime>,
}

impl EmbeddedFarm {
    /// Opens the state folder, making it if need be, and starts to serve and to work with `threads` threads.
    ///
    /// Bakes that a killed process left are cancelled: nobody waits for them. Their finished tasks stay.
    pub fn start(state: &Path, threads: usize, kinds: &KindTables) -> Result<Self> {
        let failed = |what: &str| Failure::new(Exit::Failed, what.to_owned());
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .enable_all()
            .build()
            .map_err(|error| failed("the server's threads cannot be started").caused_by(&error))?;
        let opened = runtime.block_on(async {
            let server = Server::open(Config { kinds: kinds.contract.clone(), ..Config::new(state) }).await?;
            cancel_left_over(&server.farm()).await?;
            let listener = server.bind("127.0.0.1:0").await?;
            Ok((server, listener))
        });
        let (server, listener) = opened.map_err(|error| server_failure(&error))?;
        let address = listener
            .local_addr()
            .map_err(|error| failed("the server's address is not known").caused_by(&error))?;
        let (server_end, ended) = oneshot::channel::<()>();
        runtime.spawn(async move {
            let shutdown = async {
                let _ = ended.await;
            };
            if let Err(error) = server.serve(listener, shutdown).await {
                tracing::error!(%error, "the embedded server ended");
            }
        });
        let mut farm = Self {
            url: format!("http://{address}"),
            worker_flag: ShutdownFlag::new(),
            worker: None,
            server_end: Some(server_end),
            runtime: Some(runtime),
        };
        let mut config = WorkerConfig::new(&farm.url, "embedded");
        config.threads = threads;
        config.tasks = usual_tasks(threads);
        config.lease_secs = LEASE_SECS;
        let worker = Worker::new(config, Arc::new(Runner::new(&kinds.worker)))
            .map_err(|error| failed("the embedded worker cannot start").caused_by(&error))?;
        let flag = farm.worker_flag.clone();
        farm.worker = Some(std::thread::spawn(move || worker.run(&flag)));
        Ok(farm)
    }

    /// Base URL of the server.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Errors once the worker has ended: nobody would do the tasks.
    pub fn check(&self) -> Result<()> {
        match &self.worker {
            Some(worker) if !worker.is_finished() => Ok(()),
            _ => Err(Failure::new(Exit::Failed, "the embedded worker has ended")
                .try_this("the same command with KILN_LOG=info, to see why")),
        }
    }

    /// Tells the worker to give its task back now.
    pub fn stop_worker(&self) {
        self.worker_flag.raise(Level::Stop);
    }
}

impl Drop for EmbeddedFarm {
    fn drop(&mut self) {
        self.stop_worker();
        if let Some(worker) = self.worker.take() {
            match worker.join() {
                Ok(Ok(())) => {}
                Ok(Err(error)) => tracing::error!(%error, "the embedded worker ended early"),
                Err(_) => tracing::error!("the embedded worker panicked"),
            }
        }
        if let Some(server_end) = self.server_end.take() {
            let _ = server_end.send(());
        }
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_timeout(Duration::from_secs(5));
        }
    }
}

async fn cancel_left_over(farm: &Farm) -> std::result::Result<(), ServerError> {
    let live = BakeFilter { states: vec![BakeState::Running, BakeState::Paused], ..BakeFilter::default() };
    let mut after = None;
    loop {
        let page = farm.store.list(&live, after, PAGE_BAKES).await?;
        for bake in &page.bakes {
            tracing::info!(bake = bake.id, "a bake was left by a process that has ended; it is cancelled");
            farm.store.cancel(&bake.id).await?;
        }
        match page.next {
            Some(next) => after = Some(next),
            None => return Ok(()),
        }
    }
}

/// Where a farm inside this process keeps its state unless told: `$KILN_STATE`, `$XDG_CACHE_HOME/lightkiln`,
/// `~/.cache/lightkiln`.
pub fn default_state() -> Result<PathBuf> {
    let folder = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    folder("KILN_STATE")
        .or_else(|| folder("XDG_CACHE_HOME").map(|cache| cache.join("lightkiln")))
        .or_else(|| folder("HOME").map(|home| home.join(".cache").join("lightkiln")))
        .ok_or_else(|| {
            Failure::bad_input("there is no place for the state: neither KILN_STATE nor HOME is set")
                .try_this("--state DIR")
        })
}

/// The folder given, or else `name` in the state folder.
pub fn or_in_state(given: Option<PathBuf>, name: &str) -> Result<PathBuf> {
    given.map_or_else(|| Ok(default_state()?.join(name)), Ok)
}

/// A server that cannot open, listen or go on, and what to do about it.
pub fn server_failure(error: &ServerError) -> Failure {
    let (exit, next_step) = match error {
        ServerError::StateInUse { .. } => (
            Exit::BadInput,
            "--state with a folder of its own, or one 'kiln server' and 'kiln bake --server URL' for all",
        ),
        ServerError::Listen { .. } => (Exit::BadInput, "--listen 127.0.0.1:0 for a free port"),
        ServerError::NotLoopback { .. } => (
            Exit::BadInput,
            "'kiln token create NAME --scope admin', or --allow-non-loopback if the network is trusted",
        ),
        ServerError::Tls { .. } => {
            (Exit::BadInput, "--tls-cert and --tls-key with files that belong together and can be read")
        }
        ServerError::Store(StoreError::Unavailable(_)) => {
            (Exit::Failed, "--database with the address of a database that runs")
        }
        _ => (Exit::Failed, "--state with a folder that can be written and has free room"),
    };
    Failure::new(exit, "the server cannot run").caused_by(error).try_this(next_step)
}
