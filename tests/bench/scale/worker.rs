//! Workers of the real runtime whose tasks take their time and nothing else.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use lightkiln_proto::jobs::{Artefact, TaskSpec};
use lightkiln_tests::scale::timeline::Span;
use lightkiln_worker::runtime::{ShutdownFlag, Worker, WorkerConfig};
use lightkiln_worker::task::{
    ArtefactSource, MemoryCache, Progress, TaskError, TaskOutput, TaskRunner, params,
};
use serde::Deserialize;

/// Kind of the tasks.
pub const KIND: &str = "bench.timed";
/// Memory of a worker for decoded artefacts, in bytes: tasks decode nothing.
const MEMORY_BYTES: usize = 1 << 20;

/// Parameters of a task.
#[derive(Deserialize)]
struct Params {
    /// Its time in microseconds.
    micros: u64,
}

/// Runs tasks that only wait, and notes when.
pub struct Timed {
    began: Instant,
    spans: Mutex<Vec<Span>>,
}

impl Timed {
    pub fn new() -> Self {
        Self { began: Instant::now(), spans: Mutex::default() }
    }

    /// Time since the beginning.
    pub fn now(&self) -> Duration {
        self.began.elapsed()
    }

    pub fn count(&self) -> usize {
        self.spans.lock().unwrap_or_else(PoisonError::into_inner).len()
    }

    /// The tasks that have run.
    pub fn spans(&self) -> Vec<Span> {
        self.spans.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl TaskRunner for Timed {
    fn kinds(&self) -> Vec<String> {
        vec![KIND.to_owned()]
    }

    fn run(
        &self,
        task: &TaskSpec,
        inputs: &[Artefact],
        _: &[Vec<Artefact>],
        source: &dyn ArtefactSource,
        _: &MemoryCache,
        progress: &Progress,
    ) -> Result<TaskOutput, TaskError> {
        let begin = self.now();
        let Params { micros } = params(task)?;
        for input in inputs {
            source.get(input.digest)?;
        }
        let until = begin + Duration::from_micros(micros);
        while self.now() < until {
            progress.check()?;
            std::thread::park_timeout(until.saturating_sub(self.now()));
        }
        let output = ("out".to_owned(), task.label.clone().into_bytes());
        self.spans.lock().unwrap_or_else(PoisonError::into_inner).push(Span { begin, end: self.now() });
        Ok(TaskOutput { artefacts: vec![output], ..TaskOutput::default() })
    }
}

/// A worker of so many tasks at a time, with a cache folder of its own.
pub fn worker(url: &str, folder: &Path, number: usize, in_hand: usize, runner: Arc<Timed>) -> Worker {
    let name = format!("timed-{number}");
    let config = WorkerConfig {
        threads: in_hand,
        tasks: in_hand,
        cache_dir: Some(folder.join(&name)),
        memory_bytes: MEMORY_BYTES,
        drain_grace: Duration::ZERO,
        ..WorkerConfig::new(url, name)
    };
    Worker::new(config, runner).unwrap()
}

/// Workers under way; they end when this is dropped.
pub struct Crew {
    shutdown: Vec<ShutdownFlag>,
    threads: Vec<std::thread::JoinHandle<()>>,
}

impl Crew {
    pub fn start(workers: Vec<Worker>) -> Self {
        let shutdown: Vec<ShutdownFlag> = workers.iter().map(|_| ShutdownFlag::new()).collect();
        let threads = workers.into_iter().zip(&shutdown).map(|(worker, flag)| {
            let flag = flag.clone();
            std::thread::spawn(move || worker.run(&flag).unwrap())
        });
        Self { threads: threads.collect(), shutdown }
    }
}

impl Drop for Crew {
    fn drop(&mut self) {
        self.shutdown.iter().for_each(|flag| flag.raise(lightkiln_worker::runtime::Level::Stop));
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}
