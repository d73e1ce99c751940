//! One attempt at one task: run it, store its outputs, hand in the result, or say why there is none.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use lightkiln_http::{CallError, Level, ShutdownFlag};
use lightkiln_proto::api::{Blame, CommitVerdict, Failure, Lease, TaskResult};
use lightkiln_proto::problem::{ProblemCode, chain};
use lightkiln_proto::trace::TARGET;
use rayon::{ThreadPool, ThreadPoolBuildError};

use super::Worker;
use super::store::LeaseStore;
use super::trace::{self, step};
use super::watch::{LEASE_INTERVALS, LeaseWatch, StopReason, cut, tell};
use crate::task::{Progress, TaskError, TaskOutput};

/// Most times that a result's outputs are uploaded before the attempt fails.
const UPLOADS_MAX: u32 = 4;

/// Fate of a lease.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// A result was handed in, with the server's answer.
    HandedIn(CommitVerdict),
    /// The attempt failed and was reported.
    Failed(Blame),
    /// The task was given back.
    Released,
    /// The lease was lost; nothing was handed in.
    Lost,
}

/// Why an attempt has no result.
enum NoResult {
    Stopped,
    Failed(Failure),
}

impl Worker {
    /// Does the task of `lease` to its end, whatever that is; when it returns the lease needs nothing more.
    pub(super) fn attempt(&self, lease: &Lease, shutdown: &ShutdownFlag) -> Outcome {
        let span = trace::attempt_span(lease, &self.config.name);
        let outcome = span.in_scope(|| self.attempt_in_span(lease, shutdown));
        trace::note_outcome(&span, outcome);
        outcome
    }

    fn attempt_in_span(&self, lease: &Lease, shutdown: &ShutdownFlag) -> Outcome {
        let progress = Progress::new();
        let watch = LeaseWatch {
            farm: &self.farm,
            token: &lease.token,
            interval: Duration::from_secs(self.config.lease_secs.into()) / LEASE_INTERVALS,
            grace: self.config.drain_grace,
            progress: &progress,
            memory: &self.memory_watch,
            shutdown,
            finished: AtomicBool::new(false),
            stop: Mutex::new(None),
        };
        let store = LeaseStore { farm: &self.farm, disk: self.disk.as_ref(), progress: &progress, shutdown };
        std::thread::scope(|scope| {
            scope.spawn(|| watch.run());
            // `work` catches panics, so `finish` is always reached and the scope can end.
            let worked = match watch.acknowledge(&store) {
                Ok(()) => self.work(lease, &store),
                Err(error) => Err(no_result_of_call("the task could not be begun", error)),
            };
            let outcome = self.settle(lease, worked, &watch);
            watch.finish();
            outcome
        })
    }

    fn work(&self, lease: &Lease, store: &LeaseStore<'_>) -> Result<CommitVerdict, NoResult> {
        let started = Instant::now();
        // The threads end with the task, before its result is sent: others have them meanwhile.
        let output = {
            let share = self.threads.start().map_err(|error| no_result_of_threads(&error))?;
            self.run_task(lease, &share.pool, store)
        };
        let mut output = output.map_err(no_result_of_task)?;
        count(&mut output, started.elapsed(), store.progress);
        let artefacts: Vec<_> =
            output.artefacts.into_iter().map(|(name, bytes)| (name, Arc::new(bytes))).collect();
        let mut result = Arc::new(TaskResult {
            outputs: Vec::new(),
            plan: output.plan,
            counters: output.counters,
            note: output.note,
        });
        let mut uploads = 0;
        loop {
            uploads += 1;
            Arc::make_mut(&mut result).outputs = match store.put_all(&artefacts) {
                Ok(outputs) => outputs,
                Err(error) => return Err(no_result_of_call("the outputs could not be stored", error)),
            };
            let _span = step(|| tracing::info_span!(target: TARGET, "commit")).entered();
            match self.hand_in(lease, &result, store) {
                Ok(verdict) => return Ok(verdict),
                Err(CallError::Stopped) => {
                    if store.shutdown.level() > Level::Run {
                        let label = &lease.task.label;
                        tracing::warn!(
                            label,
                            "the server did not take a result in time; its task runs again elsewhere"
                        );
                    }
                    return Err(NoResult::Stopped);
                }
                // A database that dies forgets the last moments; uploads of then have to be told again.
                Err(error) if error.code() == Some(ProblemCode::NotStored) && uploads < UPLOADS_MAX => {
                    tracing::warn!(%error, "the server no longer knows of an output; uploading again");
                }
                Err(error) => return Err(no_result_of_call("the result was not accepted", error)),
            }
        }
    }

    fn hand_in(
        &self,
        lease: &Lease,
        result: &Arc<TaskResult>,
        store: &LeaseStore<'_>,
    ) -> Result<CommitVerdict, CallError> {
        let (results, token, result) = (self.results.clone(), lease.token.clone(), result.clone());
        store.insist(move |farm| results.hand_in(farm, &token, &result))
    }

    fn run_task(
        &self,
        lease: &Lease,
        pool: &ThreadPool,
        store: &LeaseStore<'_>,
    ) -> Result<TaskOutput, TaskError> {
        let span = step(|| tracing::info_span!(target: TARGET, "run"));
        // The span goes with the task to the pool's thread, where its inputs are fetched.
        let run = || {
            span.in_scope(|| {
                self.runner.run(&lease.task, &lease.inputs, &lease.alike, store, &self.memory, store.progress)
            })
        };
        match catch_unwind(AssertUnwindSafe(|| pool.install(run))) {
            Ok(outcome) => outcome,
            Err(panic) => Err(TaskError::Panicked { message: panic_message(panic.as_ref()) }),
        }
    }

    /// Tells the server how the attempt ended, unless it knows or must not hear.
    fn settle(
        &self,
        lease: &Lease,
        worked: Result<CommitVerdict, NoResult>,
        watch: &LeaseWatch<'_>,
    ) -> Outcome {
        let label = &lease.task.label;
        match (worked, watch.stop_reason()) {
            (Ok(verdict), _) => {
                tracing::info!(kind = lease.task.kind, label, ?verdict, "handed in");
                Outcome::HandedIn(verdict)
            }
            (Err(_), Some(StopReason::Lost)) => {
                tracing::info!(kind = lease.task.kind, label, "the lease was lost; its result is dropped");
                Outcome::Lost
            }
            // The watch reported it at once: the process might not have lived on until here.
            (Err(_), Some(StopReason::Exhausted(blame))) => Outcome::Failed(blame),
            (Err(NoResult::Stopped), reason) | (Err(NoResult::Failed(_)), reason @ Some(_)) => {
                tracing::info!(kind = lease.task.kind, label, ?reason, "given back");
                let token = lease.token.clone();
                tell("release", &self.farm, &watch.last_words(), move |farm| farm.release(&token));
                Outcome::Released
            }
            (Err(NoResult::Failed(failure)), None) => {
                tracing::warn!(kind = lease.task.kind, label, message = failure.message, "failed");
                let (token, blame) = (lease.token.clone(), failure.blame);
                tell("failure", &self.farm, &watch.last_words(), move |farm| farm.fail(&token, &failure));
                Outcome::Failed(blame)
            }
        }
    }
}

fn count(output: &mut TaskOutput, elapsed: Duration, progress: &Progress) {
    let rays = progress.rays();
    let counters = [
        ("secs", elapsed.as_secs_f64()),
        ("rays_closest", rays.closest as f64),
        ("rays_occlusion", rays.occlusion as f64),
        ("rays_linking", rays.linking as f64),
    ];
    for (name, value) in counters {
        output.counters.entry(name.to_owned()).or_insert(value);
    }
}

fn no_result_of_task(error: TaskError) -> NoResult {
    match error {
        TaskError::Cancelled(_) => NoResult::Stopped,
        error => NoResult::Failed(Failure { blame: error.blame(), message: cut(&chain(&error)) }),
    }
}

fn no_result_of_threads(error: &ThreadPoolBuildError) -> NoResult {
    let message = cut(&format!("threads cannot be started; ask for fewer: {error}"));
    NoResult::Failed(Failure { blame: Blame::Worker, message })
}

fn no_result_of_call(what: &str, error: CallError) -> NoResult {
    if matches!(error, CallError::Stopped) {
        return NoResult::Stopped;
    }
    // Every worker's output would be as large.
    let (blame, next_step) = match error.is_too_large() {
        true => (Blame::Task, "; split the scene, or lower its textures' sizes"),
        false => (Blame::Worker, ""),
    };
    NoResult::Failed(Failure { blame, message: cut(&format!("{what}: {}{next_step}", chain(&error))) })
}

fn panic_message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or("no message").to_owned()
}
