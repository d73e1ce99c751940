//! A farm inside this process: the server on a loopback port and one worker, over the same HTTP as any farm.
//!
//! Several processes of a machine may have one state folder open, each with a farm of its own: they share finished tasks,
//! and a task that two of them want at once is run by one. A worker takes the tasks of its own process's bakes alone, so
//! that nothing is left half done for others when that process ends.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use lightkiln_proto::api::NewBake;
use lightkiln_server::farm::Farm;
use lightkiln_server::store::StoreError;
use lightkiln_server::{Config, Occupant, Seat, Server, ServerError};
use lightkiln_worker::kinds::Runner;
use lightkiln_worker::runtime::{Level, ShutdownFlag, Worker, WorkerConfig, WorkerError, usual_tasks};
use tokio::runtime::Runtime;
use tokio::sync::oneshot;

use crate::console::say;
use crate::failure::{Exit, Failure, Result};
use crate::interrupt::Interrupt;
use crate::kinds::KindTables;

/// Lease length: long enough for a machine that is busy or was asleep. Leases that a crash leaves are ended by those who
/// share the folder, as soon as the seat is free.
const LEASE_SECS: u32 = 60;
/// Waiting calls look this often for what other processes have done.
const POLL_INTERVAL: Duration = Duration::from_millis(250);
/// Time for which a bake waits for memory that other programs have, while it has no task in hand.
const MEMORY_PATIENCE: Duration = Duration::from_secs(600);
/// A folder that is in use is tried again after this; the wait is told of once it has lasted longer than a start takes.
const TRY_AGAIN_AFTER: Duration = Duration::from_millis(200);
const SILENT_FOR: Duration = Duration::from_secs(1);

/// Server and worker; both end when it is dropped.
pub struct EmbeddedFarm {
    url: String,
    seat: Seat,
    state: PathBuf,
    farm: Arc<Farm>,
    worker_flag: ShutdownFlag,
    worker: Arc<Worker>,
    worker_thread: Option<JoinHandle<()>>,
    /// Why the worker has ended, once it has.
    worker_end: Arc<OnceLock<Failure>>,
    /// Memory that the worker waits for, as the user was told of it.
    told_of_memory: Mutex<Option<String>>,
    server_end: Option<oneshot::Sender<()>>,
    runtime: Option<Runtime>,
}

impl EmbeddedFarm {
    /// Opens the state folder, making it if need be, and starts to serve and to work with `threads` threads. Waits, with a
    /// word, while others have the folder open that it cannot be shared with.
    ///
    /// Bakes that a killed process left are cancelled: nobody waits for them. Their finished tasks stay.
    pub fn start(state: &Path, threads: usize, kinds: &KindTables, interrupt: &Interrupt) -> Result<Self> {
        let failed = |what: &str| Failure::new(Exit::Failed, what.to_owned());
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .enable_all()
            .build()
            .map_err(|error| failed("the server's threads cannot be started").caused_by(&error))?;
        let config =
            Config { kinds: kinds.contract.clone(), poll_interval: POLL_INTERVAL, ..Config::new(state) };
        let (server, seat) = open(&runtime, &config, interrupt)?;
        let listener =
            runtime.block_on(server.bind("127.0.0.1:0")).map_err(|error| server_failure(&error))?;
        let address = listener
            .local_addr()
            .map_err(|error| failed("the server's address is not known").caused_by(&error))?;
        let inside = server.farm();
        let (server_end, ended) = oneshot::channel::<()>();
        runtime.spawn(async move {
            let shutdown = async {
                let _ = ended.await;
            };
            if let Err(error) = server.serve(listener, shutdown).await {
                tracing::error!(%error, "the embedded server ended");
            }
        });
        let url = format!("http://{address}");
        let mut config = WorkerConfig::new(&url, &seat.name);
        config.labels = vec![seat.name.clone()];
        config.threads = threads;
        config.tasks = usual_tasks(threads);
        config.lease_secs = LEASE_SECS;
        config.memory_patience = Some(MEMORY_PATIENCE);
        let worker = Worker::new(config, Arc::new(Runner::new(&kinds.worker)))
            .map_err(|error| failed("the embedded worker cannot start").caused_by(&error))?;
        let mut farm = Self {
            url,
            seat,
            state: state.to_owned(),
            farm: inside,
            worker_flag: ShutdownFlag::new(),
            worker: Arc::new(worker),
            worker_thread: None,
            worker_end: Arc::default(),
            told_of_memory: Mutex::default(),
            server_end: Some(server_end),
            runtime: Some(runtime),
        };
        farm.worker_thread = Some(farm.start_worker());
        Ok(farm)
    }

    fn start_worker(&self) -> JoinHandle<()> {
        let (worker, flag, end) = (self.worker.clone(), self.worker_flag.clone(), self.worker_end.clone());
        std::thread::spawn(move || {
            if let Err(error) = worker.run(&flag) {
                // It is set once.
                let _ = end.set(worker_failure(&error));
            }
        })
    }

    /// Base URL of the server.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Keeps a bake to this process's worker.
    pub fn reserve(&self, bake: &mut NewBake) {
        bake.needs.labels.push(self.seat.name.clone());
    }

    /// Errors once the worker has ended, as nobody would do the tasks, and once the disk is full: unlike a server, a bake
    /// has somebody who waits, and goes on where it was when it is asked for again. The answer is a word to that user, if there is
    /// something to say.
    pub fn check(&self) -> Result<Option<String>> {
        if self.farm.full_refusals() > 0 {
            let what = format!("no room is left on the disk of {}", self.state.display());
            return Err(Failure::new(Exit::Failed, what).try_this(
                "the same command again once there is room, as it goes on from the tasks that are done; or --state with a \
                 folder on another disk",
            ));
        }
        if let Some(failure) = self.worker_end.get() {
            return Err(failure.clone());
        }
        match &self.worker_thread {
            Some(thread) if !thread.is_finished() => Ok(self.word_of_memory()),
            _ => Err(Failure::new(Exit::Failed, "the worker inside this process has ended")
                .try_this("the same command with KILN_LOG=info, to see why")),
        }
    }

    /// A word when the worker begins to wait for memory, and one when it goes on.
    fn word_of_memory(&self) -> Option<String> {
        let waits = self.worker.waits_for_memory();
        let mut told = self.told_of_memory.lock().unwrap_or_else(PoisonError::into_inner);
        if *told == waits {
            return None;
        }
        told.clone_from(&waits);
        Some(match waits {
            Some(memory) => format!(
                "waiting for memory: {memory}; this bake goes on when some comes free. Ctrl-C ends the wait; close other programs to \
                 shorten it"
            ),
            None => "memory is free again; this bake goes on".to_owned(),
        })
    }

    /// Tells the worker to give its task back now.
    pub fn stop_worker(&self) {
        self.worker_flag.raise(Level::Stop);
    }
}

impl Drop for EmbeddedFarm {
    fn drop(&mut self) {
        self.stop_worker();
        // A worker that ended in an error has told so in the log.
        if self.worker_thread.take().is_some_and(|thread| thread.join().is_err()) {
            tracing::error!("the embedded worker panicked");
        }
        if let Some(server_end) = self.server_end.take() {
            let _ = server_end.send(());
        }
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_timeout(Duration::from_secs(5));
        }
    }
}

/// Why a bake cannot go on whose worker has ended.
fn worker_failure(error: &WorkerError) -> Failure {
    let next_step = match error {
        WorkerError::Memory { .. } => {
            "the same command again once other programs have let go of memory; it goes on from the tasks that are done"
        }
        _ => "the same command with KILN_LOG=info, to see more",
    };
    Failure::new(Exit::Failed, "the worker inside this process has ended")
        .caused_by(error)
        .try_this(next_step)
}

/// Opens the state folder as soon as it can be shared.
fn open(runtime: &Runtime, config: &Config, interrupt: &Interrupt) -> Result<(Server, Seat)> {
    let (began, mut told) = (Instant::now(), None);
    loop {
        let by = match runtime.block_on(Server::open_seated(config.clone())) {
            // A server may run for ever: nobody waits for its end.
            Err(error @ ServerError::StateInUse { by: Occupant::Server(_), .. }) => {
                return Err(server_failure(&error));
            }
            Err(ServerError::StateInUse { by, .. }) => by,
            opened => return opened.map_err(|error| server_failure(&error)),
        };
        if began.elapsed() >= SILENT_FOR && told.as_ref() != Some(&by) {
            say!(
                "waiting: {} is in use by {by}; this bake goes on when that has ended. Ctrl-C ends the wait, and --state \
                 with another folder makes it needless",
                config.state_dir.display()
            );
            told = Some(by);
        }
        if interrupt.flag().wait(TRY_AGAIN_AFTER, |level| level > Level::Run) > Level::Run {
            return Err(Failure::new(Exit::Interrupted, "interrupted"));
        }
    }
}

/// One thread per processor.
pub fn all_processors() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
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
        ServerError::State { source, .. } if cannot_be_written(source) => {
            (Exit::BadInput, "--state with a folder that can be written")
        }
        ServerError::StateInUse { by: Occupant::Server(_), .. } => (
            Exit::BadInput,
            "'kiln bake --server URL' with that server's address, or --state with another folder",
        ),
        ServerError::StateInUse { .. } => {
            (Exit::BadInput, "--state with a folder of its own, or again when that has ended")
        }
        ServerError::Listen { .. } => (Exit::BadInput, "--listen 127.0.0.1:0 for a free port"),
        ServerError::NotLoopback { .. } => (
            Exit::BadInput,
            "'kiln token create NAME --scope admin', or --allow-non-loopback if the network is trusted",
        ),
        ServerError::Tls { .. } => {
            (Exit::BadInput, "--tls-cert and --tls-key with files that belong together and can be read")
        }
        ServerError::Store(StoreError::Unavailable(_)) => (
            Exit::Failed,
            "--database with the address of a database that runs, and a name and password that it knows",
        ),
        _ => (Exit::Failed, "--state with a folder that can be written and has free room"),
    };
    let what = match error {
        ServerError::StateInUse { .. } | ServerError::State { .. } => "the state folder cannot be opened",
        _ => "the server cannot run",
    };
    Failure::new(exit, what).caused_by(error).try_this(next_step)
}

/// Whether a folder was chosen that nothing can be written to, now or later.
fn cannot_be_written(error: &io::Error) -> bool {
    use io::ErrorKind::{NotADirectory, PermissionDenied, ReadOnlyFilesystem};
    matches!(error.kind(), NotADirectory | PermissionDenied | ReadOnlyFilesystem)
}
