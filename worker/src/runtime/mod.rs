//! The worker as a process sees it: claims tasks over HTTP, runs them, hands results in. Blocking calls on plain
//! threads; a few tasks at a time, each with a share of the threads inside it: one goes on while another talks to the
//! server, or has a step that is not parallel.
//!
//! Invariants, whatever happens: a result is handed in only under a lease not known to be lost; a task whose lease ends
//! here without a result is failed, released, or runs out, so another worker gets it; the same task gives the same
//! bytes, so doing one twice is a waste and never an error.

mod abreast;
mod aside;
mod attempt;
mod claim;
mod crowd;
mod farm;
mod gauge;
mod host;
mod memory;
mod results;
mod room;
mod seat;
mod share;
mod shift;
mod spare;
mod store;
#[cfg(test)]
mod tests;
mod trace;
mod watch;

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use lightkiln_http::{DiskCache, FOREVER, retry};
use lightkiln_proto::api::Lease;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::problem::chain;
use thiserror::Error;

use crate::task::{MemoryCache, TaskRunner};
use crowd::Crowd;
use farm::Farm;
use gauge::{Gauge, Kernel};
use memory::MemoryWatch;
use results::Results;
use share::Threads;
use shift::Shift;
use spare::Next;

pub use attempt::Outcome;
pub use lightkiln_http::{CallError, Level, ShutdownFlag};
pub use seat::{Seat, new_id};
pub use share::usual_tasks;

/// Pause after an answer without tasks, so that a server that does not hold claims open is not asked in a tight loop.
const EMPTY_ANSWER_PAUSE: Duration = Duration::from_millis(20);

/// Configuration of a worker.
#[derive(Clone, Debug)]
pub struct WorkerConfig {
    /// Base URL of the server.
    pub server_url: String,
    /// Bearer token, if the farm asks for one; visible ASCII.
    pub token: Option<String>,
    /// Certificates (PEM) one of which must have signed the server's; the usual ones unless set.
    pub ca_pem: Option<Vec<u8>>,
    /// Name on the farm; unique there, as a worker that failed a task is not given it again.
    pub name: String,
    /// Threads, which the tasks in hand share. More → faster, with more memory in use.
    pub threads: usize,
    /// Tasks in hand at a time; each may use `memory_mib`. More → less idle time, with more memory in use.
    pub tasks: usize,
    /// Memory in MiB that a task may use; bakes that need more go to other workers.
    pub memory_mib: u32,
    /// Most bytes that this process may take: tasks in hand fail as out of memory when it takes more. Without one, limits of the
    /// kernel alone count.
    pub memory_limit: Option<u64>,
    /// Time for which a worker without a task waits for memory that others have, before it ends. None waits for ever.
    pub memory_patience: Option<Duration>,
    /// Seat on this machine, from which the next process tells what this one left. Without one, leases of a process that ends without
    /// a word run out.
    pub seat: Option<Arc<Seat>>,
    /// Labels that bakes may ask for.
    pub labels: Vec<String>,
    /// The machine that it runs on, at most 200 characters; empty where that cannot be told. Results are verified on another one.
    pub machine: String,
    /// Folder for fetched artefacts; without one each is fetched anew unless it is still in memory.
    pub cache_dir: Option<PathBuf>,
    /// Bytes that the folder may hold. More → fewer fetches.
    pub cache_bytes: u64,
    /// Bytes of decoded artefacts to keep in memory, at most a quarter of the smallest limit of memory. More → less decoding.
    pub memory_bytes: usize,
    /// Length of a lease in seconds, 5..=3600. More → fewer heartbeats, later rescue of a dead worker's task.
    pub lease_secs: u32,
    /// Seconds that the server may hold a claim open, 0..=60. More → fewer calls while there is no work.
    pub claim_wait_secs: u32,
    /// Time that a task may still take once draining began, before it is given back.
    pub drain_grace: Duration,
    /// Takes so many tasks, then ends. None is no limit.
    pub max_tasks: Option<u32>,
    /// Ends once the server had no task for it for so long. None is to stay.
    pub exit_when_idle: Option<Duration>,
}

impl WorkerConfig {
    /// A worker for the server at `server_url`, with a thread per processor, [`usual_tasks`] and no cache on disk.
    pub fn new(server_url: impl Into<String>, name: impl Into<String>) -> Self {
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        Self {
            server_url: server_url.into(),
            token: None,
            ca_pem: None,
            name: name.into(),
            threads,
            tasks: usual_tasks(threads),
            memory_mib: 0,
            memory_limit: None,
            memory_patience: None,
            seat: None,
            labels: Vec::new(),
            machine: host::Host::here().id().chars().take(MACHINE_CHARS_MAX).collect(),
            cache_dir: None,
            cache_bytes: 20 << 30,
            memory_bytes: 2 << 30,
            lease_secs: LEASE_SECS,
            claim_wait_secs: 20,
            drain_grace: Duration::from_secs(20),
            max_tasks: None,
            exit_when_idle: None,
        }
    }
}

/// Longest word for a machine that servers take.
const MACHINE_CHARS_MAX: usize = 200;

/// Seconds of a lease where nobody says. Longer → a slow or sleepy machine keeps its task; shorter → a dead one's task is
/// given on sooner.
pub const LEASE_SECS: u32 = 30;

/// A worker that cannot start or cannot go on.
#[derive(Debug, Error)]
pub enum WorkerError {
    /// The cache folder cannot be used.
    #[error("the cache folder {} cannot be used; choose one that can be written", .folder.display())]
    Cache {
        /// The folder.
        folder: PathBuf,
        /// Why.
        #[source]
        source: std::io::Error,
    },
    /// The threads cannot be started.
    #[error("{threads} threads cannot be started; ask for fewer")]
    Threads {
        /// Count asked for.
        threads: usize,
        /// Why.
        #[source]
        source: rayon::ThreadPoolBuildError,
    },
    /// The server cannot be called by this URL, or with these certificates.
    #[error(transparent)]
    Server(CallError),
    /// Memory does not come free, although there is no task.
    #[error("no memory comes free for tasks: {seen}")]
    Memory {
        /// The limit that is reached.
        seen: String,
        /// Whether this process has so much of it that its end helps.
        is_own: bool,
    },
    /// The server refuses this worker for good.
    #[error("the server gives this worker no tasks")]
    Refused(#[source] CallError),
}

/// Takes tasks from a server until told to stop.
pub struct Worker {
    config: WorkerConfig,
    runner: Arc<dyn TaskRunner>,
    farm: Arc<Farm>,
    disk: Option<DiskCache>,
    memory: MemoryCache,
    threads: Threads,
    memory_watch: MemoryWatch,
    /// Set while no task is begun for want of memory.
    waits_for_memory: Mutex<Option<String>>,
    /// Tasks in hand, and how many may be.
    in_hand: AtomicUsize,
    crowd: Crowd,
    /// Held while a claim is open: one call waits for work, however many tasks may be in hand. Leases that came with one and that nobody
    /// has begun: each of those who wait for their turn takes one.
    claiming: Mutex<VecDeque<Lease>>,
    /// Those who have no task.
    idle: AtomicUsize,
    results: Arc<Results>,
}

/// Exchanges a code for the right to work with `token`, which whoever calls made and keeps; the worker's name on the farm.
/// The same call again is safe.
pub fn enrol(server_url: &str, ca_pem: Option<&[u8]>, code: &str, token: &str) -> Result<String, CallError> {
    let farm = Farm::new(server_url, Some(code), ca_pem)?;
    Ok(farm.enrol(Digest::of(token.as_bytes()))?.name)
}

impl Worker {
    /// Opens the cache and starts the threads; calls nothing yet.
    pub fn new(config: WorkerConfig, runner: Arc<dyn TaskRunner>) -> Result<Self, WorkerError> {
        Self::with_gauge(config, runner, Box::new(Kernel::default()))
    }

    fn with_gauge(
        config: WorkerConfig,
        runner: Arc<dyn TaskRunner>,
        gauge: Box<dyn Gauge>,
    ) -> Result<Self, WorkerError> {
        let open = |folder: &PathBuf| {
            let opened = DiskCache::open(folder, config.cache_bytes);
            opened.map_err(|source| WorkerError::Cache { folder: folder.clone(), source })
        };
        let disk = config.cache_dir.as_ref().map(open).transpose()?;
        let threads = Threads::new(config.threads);
        // Whether they can be started is better known now than at the first task.
        let started = threads.start().map(drop);
        started.map_err(|source| WorkerError::Threads { threads: threads.all(), source })?;
        let farm = Farm::new(&config.server_url, config.token.as_deref(), config.ca_pem.as_deref());
        let farm = Arc::new(farm.map_err(WorkerError::Server)?);
        let memory_watch = MemoryWatch::new(config.memory_limit, gauge);
        Ok(Self {
            runner,
            farm,
            disk,
            memory: MemoryCache::new(memory_watch.cache_bytes(config.memory_bytes)),
            threads,
            memory_watch,
            waits_for_memory: Mutex::default(),
            in_hand: AtomicUsize::new(0),
            crowd: Crowd::new(config.tasks),
            claiming: Mutex::default(),
            idle: AtomicUsize::new(0),
            results: Arc::default(),
            config,
        })
    }

    /// Claims and does tasks until `shutdown` is raised, or the worker has done what it came for. A server that is away is
    /// waited for.
    ///
    /// When one of its threads cannot go on, `shutdown` is raised for the others, as they could not either.
    pub fn run(&self, shutdown: &ShutdownFlag) -> Result<(), WorkerError> {
        if self.config.seat.as_ref().is_some_and(|seat| seat.left_several_for_memory()) {
            self.crowd.squeeze();
        }
        self.tell_of_left(shutdown);
        // No task is begun before the first look.
        self.look_at_memory(shutdown);
        let has_ended = AtomicBool::new(false);
        let shift = Shift::new(self.config.max_tasks, self.config.exit_when_idle);
        let ended = std::thread::scope(|scope| {
            scope.spawn(|| self.watch_memory(&has_ended, shutdown));
            let start = |_| scope.spawn(|| self.take_tasks_or_end_all(shutdown, &shift));
            let running: Vec<_> = (0..self.config.tasks.max(1)).map(start).collect();
            let ended = running.into_iter().map(|thread| thread.join().flatten()).collect();
            has_ended.store(true, Ordering::Release);
            shutdown.wake();
            ended
        });
        end_of(ended)
    }

    /// Takes tasks on one of the threads. If that ends in an error or a panic, it is told at once, and the others end.
    fn take_tasks_or_end_all(&self, shutdown: &ShutdownFlag, shift: &Shift) -> Ended {
        let ended = catch_unwind(AssertUnwindSafe(|| self.take_tasks(shutdown, shift)));
        self.give_back_spare(shutdown);
        match &ended {
            Ok(Ok(())) => return ended,
            Ok(Err(error)) => tracing::error!(reason = chain(error), "the worker cannot go on"),
            Err(_) => tracing::error!("a thread of the worker panicked"),
        }
        shutdown.raise(Level::Drain);
        ended
    }

    /// Claims and does one task after the other.
    fn take_tasks(&self, shutdown: &ShutdownFlag, shift: &Shift) -> Result<(), WorkerError> {
        loop {
            self.idle.fetch_add(1, Ordering::AcqRel);
            let mut spare = self.claiming.lock().unwrap_or_else(PoisonError::into_inner);
            let next = self.next_task(&mut spare, shutdown, shift);
            self.idle.fetch_sub(1, Ordering::AcqRel);
            match next? {
                Next::Task(lease) => {
                    self.in_hand.fetch_add(1, Ordering::AcqRel);
                    // A claim may have been open for long.
                    self.look_at_memory(shutdown);
                    if self.memory_watch.is_exhausted() {
                        self.give_back_untried([*lease], shutdown);
                    } else {
                        let _in_hand = shift.take();
                        drop(spare);
                        self.do_task(&lease, shutdown);
                    }
                    self.in_hand.fetch_sub(1, Ordering::AcqRel);
                    shutdown.wake();
                }
                Next::Nothing if shift.is_idle() => return Ok(()),
                // In turn: nobody else asks meanwhile.
                Next::Nothing => {
                    shutdown.wait(EMPTY_ANSWER_PAUSE, |level| level > Level::Run);
                }
                Next::Over => return Ok(()),
            }
        }
    }

    fn do_task(&self, lease: &Lease, shutdown: &ShutdownFlag) {
        tracing::info!(kind = lease.task.kind, label = lease.task.label, "took");
        if let Outcome::HandedIn(_) = self.attempt(lease, shutdown) {
            self.crowd.note_done();
        }
        if let Some(seat) = &self.config.seat {
            seat.let_go(&lease.token);
        }
    }

    /// Tells the farm of leases that former processes in this seat left, so that their tasks need not wait for the leases' end.
    fn tell_of_left(&self, shutdown: &ShutdownFlag) {
        let Some(seat) = &self.config.seat else { return };
        for (token, failure) in seat.left(&self.config.server_url, &self.config.name) {
            let pause = |error: &CallError, wait: Duration| {
                tracing::warn!(%error, "a task of a process before this one could not be given up yet");
                let level = shutdown.wait(wait, |level| level > Level::Run);
                if level > Level::Run { Err(CallError::Stopped) } else { Ok(()) }
            };
            match retry(FOREVER, || self.farm.fail(&token, &failure), pause) {
                // The next process tries again.
                Err(CallError::Stopped) => return,
                Err(error) => {
                    tracing::warn!(%error, "a task of a process before this one is left to its lease's end")
                }
                Ok(()) => tracing::warn!(reason = failure.message, "a process before this one left a task"),
            }
            seat.let_go(&token);
        }
    }
}

/// How one of a worker's threads ended.
type Ended = std::thread::Result<Result<(), WorkerError>>;

/// The end of a worker whose threads ended so: a panic goes before errors.
fn end_of(ended: Vec<Ended>) -> Result<(), WorkerError> {
    let ended: Vec<_> =
        ended.into_iter().map(|ended| ended.unwrap_or_else(|panic| resume_unwind(panic))).collect();
    ended.into_iter().collect()
}
