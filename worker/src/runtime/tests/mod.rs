//! A worker when all goes well, and when server, task or machine fail.

mod beats;
pub(super) mod fake_farm;
mod far;
mod farewell;
mod memory;
mod turns;

use std::sync::Mutex;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use lightkiln_proto::api::{Blame, Verdict};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{Artefact, TaskSpec};

use super::*;
use crate::task::{ArtefactSource, Progress, TaskError, TaskOutput};
use fake_farm::{FakeFarm, LIMIT, State};

type Run = dyn Fn(&[Artefact], &dyn ArtefactSource, &Progress) -> Result<TaskOutput, TaskError> + Send + Sync;

struct FakeRunner(Box<Run>);

impl TaskRunner for FakeRunner {
    fn kinds(&self) -> Vec<String> {
        vec!["test".into()]
    }

    fn run(
        &self,
        _task: &TaskSpec,
        inputs: &[Artefact],
        _: &[Vec<Artefact>],
        source: &dyn ArtefactSource,
        _memory: &MemoryCache,
        progress: &Progress,
    ) -> Result<TaskOutput, TaskError> {
        (self.0)(inputs, source, progress)
    }
}

/// Joins its inputs into one output.
fn joining(
    inputs: &[Artefact],
    source: &dyn ArtefactSource,
    _progress: &Progress,
) -> Result<TaskOutput, TaskError> {
    let mut joined = Vec::new();
    for input in inputs {
        joined.extend_from_slice(&source.get(input.digest)?);
    }
    Ok(TaskOutput { artefacts: vec![("joined".into(), joined)], ..TaskOutput::default() })
}

/// Works until it is told to stop.
fn endless(_: &[Artefact], _: &dyn ArtefactSource, progress: &Progress) -> Result<TaskOutput, TaskError> {
    let started = Instant::now();
    while started.elapsed() < LIMIT {
        progress.check()?;
        std::thread::park_timeout(Duration::from_millis(5));
    }
    panic!("the task was not told to stop within {LIMIT:?}")
}

/// A worker under test, and the flag that ends it.
struct Running {
    worker: Arc<Worker>,
    shutdown: ShutdownFlag,
    thread: std::thread::JoinHandle<Result<(), WorkerError>>,
}

impl Running {
    fn start(
        farm: &FakeFarm,
        run: impl Fn(&[Artefact], &dyn ArtefactSource, &Progress) -> Result<TaskOutput, TaskError>
        + Send
        + Sync
        + 'static,
        change: impl FnOnce(&mut WorkerConfig),
    ) -> Self {
        let runner = Arc::new(FakeRunner(Box::new(run)));
        Self::start_with(farm, runner, Box::new(Kernel::default()), change)
    }

    fn start_with(
        farm: &FakeFarm,
        runner: Arc<dyn TaskRunner>,
        gauge: Box<dyn Gauge>,
        change: impl FnOnce(&mut WorkerConfig),
    ) -> Self {
        let mut config = WorkerConfig::new(farm.url(), "worker");
        config.threads = 2;
        config.tasks = 1;
        config.lease_secs = 1;
        change(&mut config);
        let worker = Arc::new(Worker::with_gauge(config, runner, gauge).unwrap());
        let shutdown = ShutdownFlag::new();
        let (running, flag) = (worker.clone(), shutdown.clone());
        Self { worker, shutdown, thread: std::thread::spawn(move || running.run(&flag)) }
    }

    fn end(self, level: Level) {
        self.shutdown.raise(level);
        self.thread.join().unwrap().unwrap();
    }
}

fn run_until(
    farm: &FakeFarm,
    run: impl Fn(&[Artefact], &dyn ArtefactSource, &Progress) -> Result<TaskOutput, TaskError>
    + Send
    + Sync
    + 'static,
    what: &str,
    done: impl Fn(&State) -> bool,
) {
    let running = Running::start(farm, run, |_| {});
    farm.wait_for(what, done);
    running.end(Level::Drain);
}

fn beats(state: &State) -> bool {
    state.calls.iter().any(|call| call.ends_with("/heartbeat"))
}

#[test]
fn result_is_handed_in_with_its_outputs_stored_and_its_time_counted() {
    let farm = FakeFarm::start();
    farm.offer("t1", &[b"ab", b"cd"]);
    run_until(&farm, joining, "commit", |state| state.committed.len() == 1);
    let state = farm.state();
    let result = &state.committed["t1"];
    assert_eq!(result.outputs[0].name, "joined");
    assert_eq!(state.chunks[&result.outputs[0].digest], b"abcd");
    assert!(result.counters.contains_key("secs") && result.counters.contains_key("rays_closest"));
}

#[test]
fn tasks_in_hand_go_on_side_by_side() {
    let farm = FakeFarm::start();
    ["t1", "t2", "t3"].iter().for_each(|token| farm.offer(token, &[token.as_bytes()]));
    let all_are_here = std::sync::Barrier::new(3);
    let meeting = move |inputs: &[Artefact], source: &dyn ArtefactSource, progress: &Progress| {
        all_are_here.wait();
        joining(inputs, source, progress)
    };
    let running = Running::start(&farm, meeting, |config| config.tasks = 3);
    farm.wait_for("three commits", |state| state.committed.len() == 3);
    running.end(Level::Drain);
}

#[test]
fn worker_ends_by_itself_after_its_tasks_or_when_there_are_none() {
    let farm = FakeFarm::start();
    ["t1", "t2", "t3"].iter().for_each(|token| farm.offer(token, &[token.as_bytes()]));
    let two = Running::start(&farm, joining, |config| (config.tasks, config.max_tasks) = (4, Some(2)));
    // Nobody tells it to stop.
    two.thread.join().unwrap().unwrap();
    let mut state = farm.state();
    assert_eq!((state.committed.len(), state.leases.len()), (2, 1), "one is left for others");
    // A server that is busy for once has not said that there is nothing.
    state.refuse = vec!["POST /v1/leases"];
    drop(state);
    let rest = Running::start(&farm, joining, |config| config.exit_when_idle = Some(Duration::ZERO));
    rest.thread.join().unwrap().unwrap();
    assert_eq!(farm.state().committed.len(), 3);
}

#[test]
fn thread_that_is_refused_for_good_ends_the_worker_and_its_tasks_go_back() {
    let farm = FakeFarm::start();
    farm.offer("t1", &[]);
    let running = Running::start(&farm, endless, |config| {
        (config.tasks, config.lease_secs, config.drain_grace) = (2, 60, Duration::ZERO);
    });
    farm.wait_for("heartbeat", beats);
    farm.state().is_closed = true;
    // Nobody tells it to stop.
    let ended = running.thread.join().unwrap();
    assert!(matches!(ended, Err(WorkerError::Refused(_))), "{ended:?}");
    assert_eq!(farm.state().released, ["t1"]);
}

#[test]
fn panic_of_a_thread_is_not_hidden_by_an_error_of_another() {
    let error = || WorkerError::Memory { seen: String::new(), is_own: false };
    let panic = Box::new("on purpose");
    let ended = catch_unwind(|| end_of(vec![Ok(Err(error())), Err(panic), Ok(Ok(()))]));
    assert_eq!(ended.unwrap_err().downcast_ref(), Some(&"on purpose"));
    assert!(end_of(vec![Ok(Ok(())), Ok(Err(error()))]).is_err() && end_of(vec![Ok(Ok(()))]).is_ok());
}

#[test]
fn output_that_the_server_has_is_not_sent_again() {
    let farm = FakeFarm::start();
    farm.offer("t1", &[b"same"]);
    run_until(&farm, joining, "commit", |state| state.committed.len() == 1);
    assert!(farm.state().calls.iter().all(|call| !call.starts_with("PUT")));
}

#[test]
fn output_that_the_server_has_cut_short_is_sent_again() {
    let farm = FakeFarm::start();
    farm.offer("t1", &[b"wh", b"ole"]);
    farm.state().chunks.insert(Digest::of(b"whole"), b"who".to_vec());
    run_until(&farm, joining, "commit", |state| state.committed.len() == 1);
    assert_eq!(farm.state().chunks[&Digest::of(b"whole")], b"whole");
}

#[test]
fn output_refused_as_too_large_is_blamed_on_the_task_with_what_to_do() {
    let farm = FakeFarm::start();
    farm.offer("t1", &[b"a", b"b"]);
    farm.state().is_narrow = true;
    run_until(&farm, joining, "failure", |state| state.failures.len() == 1);
    let failure = &farm.state().failures[0];
    assert_eq!(failure.blame, Blame::Task);
    assert!(
        failure.message.contains("on purpose") && failure.message.contains("split the scene"),
        "{failure:?}"
    );
}

#[test]
fn lost_answers_and_refusals_are_asked_for_again() {
    let farm = FakeFarm::start();
    farm.offer("t1", &[b"a", b"b"]);
    farm.state().lose_answers = vec!["GET /v1/chunks", "PUT /v1/chunks", "POST /v1/leases/t1/commit"];
    farm.state().refuse =
        vec!["POST /v1/leases", "GET /v1/chunks", "HEAD /v1/chunks", "POST /v1/leases/t1/commit"];
    let commits = |state: &State| state.calls.iter().filter(|call| call.ends_with("/commit")).count();
    run_until(&farm, joining, "three commits", move |state| commits(state) == 3);
    assert_eq!(farm.state().committed.len(), 1);
    assert!(farm.state().failures.is_empty());
}

#[test]
fn lost_lease_stops_the_task_and_nothing_more_is_sent_for_it() {
    let farm = FakeFarm::start();
    farm.offer("t1", &[]);
    let beat = |state: &State| state.calls.iter().rposition(|call| call.ends_with("/heartbeat"));
    let running = Running::start(&farm, endless, |_| {});
    farm.wait_for("heartbeat", beats);
    farm.state().verdict = Some(Verdict::Lost);
    farm.wait_for("claim after the lost lease", |state| {
        beat(state).is_some_and(|beat| state.calls[beat..].contains(&"POST /v1/leases".to_owned()))
    });
    running.end(Level::Drain);
    let state = farm.state();
    assert!(state.committed.is_empty() && state.failures.is_empty() && state.released.is_empty());
}

#[test]
fn task_is_begun_when_the_server_has_heard_that_it_arrived() {
    let farm = FakeFarm::start();
    farm.offer("t1", &[b"x"]);
    farm.state().refuse = vec!["POST /v1/leases/t1/heartbeat"; 2];
    farm.state().lose_answers = vec!["POST /v1/leases/t1/heartbeat"];
    let running = Running::start(&farm, joining, |config| config.lease_secs = 60);
    farm.wait_for("commit", |state| state.committed.len() == 1);
    running.end(Level::Drain);
    let state = farm.state();
    let first = |end: &str| state.calls.iter().position(|call| call.contains(end)).unwrap();
    let beats = state.calls[..first("GET /v1/chunks")].iter().filter(|call| call.ends_with("/heartbeat"));
    assert_eq!(beats.count(), 4, "two refused, one unanswered, one heard: {:?}", state.calls);
}

#[test]
fn task_whose_lease_ended_before_it_arrived_is_not_begun() {
    let farm = FakeFarm::start();
    farm.state().verdict = Some(Verdict::Lost);
    farm.offer("t1", &[b"x"]);
    let run = |_: &[Artefact], _: &dyn ArtefactSource, _: &Progress| panic!("it is not its own any more");
    run_until(&farm, run, "claim after it", |state| {
        let beat = state.calls.iter().position(|call| call.ends_with("/heartbeat"));
        beat.is_some_and(|beat| state.calls[beat..].contains(&"POST /v1/leases".to_owned()))
    });
    let state = farm.state();
    assert!(state.committed.is_empty() && state.failures.is_empty() && state.released.is_empty());
}

#[test]
fn output_that_the_server_forgot_is_uploaded_again() {
    let farm = FakeFarm::start();
    farm.offer("t1", &[b"wh", b"ole"]);
    farm.state().forgetful = 2;
    run_until(&farm, joining, "commit", |state| state.committed.len() == 1);
    let state = farm.state();
    assert_eq!(state.chunks[&Digest::of(b"whole")], b"whole");
    assert!(state.failures.is_empty(), "{:?}", state.failures);
    assert_eq!(state.calls.iter().filter(|call| call.starts_with("PUT")).count(), 3);
}

#[test]
fn server_that_forgets_for_ever_is_not_waited_for() {
    let farm = FakeFarm::start();
    farm.offer("t1", &[b"whole"]);
    farm.state().forgetful = u32::MAX;
    run_until(&farm, joining, "failure", |state| state.failures.len() == 1);
    let failure = &farm.state().failures[0];
    assert!(failure.blame == Blame::Worker && failure.message.contains("on purpose"), "{failure:?}");
}

#[test]
fn task_is_given_back_although_the_server_is_away_for_a_while() {
    let farm = FakeFarm::start();
    farm.offer("t1", &[]);
    farm.state().refuse = vec!["POST /v1/leases/t1/release"; 4];
    let running = Running::start(&farm, endless, |config| {
        config.drain_grace = Duration::ZERO;
        config.lease_secs = 60;
    });
    farm.wait_for("heartbeat", beats);
    running.end(Level::Drain);
    let state = farm.state();
    assert_eq!(state.released, ["t1"]);
    assert_eq!(state.calls.iter().filter(|call| call.ends_with("/release")).count(), 5);
}

#[test]
fn worker_told_to_stop_at_once_does_not_wait_to_be_heard() {
    let farm = FakeFarm::start();
    farm.offer("t1", &[]);
    farm.state().refuse = vec!["POST /v1/leases/t1/release"; 1000];
    let running = Running::start(&farm, endless, |config| config.lease_secs = 3600);
    farm.wait_for("heartbeat", beats);
    running.end(Level::Stop);
    let state = farm.state();
    assert_eq!(state.calls.iter().filter(|call| call.ends_with("/release")).count(), 2);
}

#[test]
fn cancelled_bake_stops_the_task_and_gives_it_back() {
    let farm = FakeFarm::start();
    farm.offer("t1", &[]);
    let running = Running::start(&farm, endless, |_| {});
    farm.wait_for("heartbeat", beats);
    farm.state().verdict = Some(Verdict::Cancel);
    farm.wait_for("release", |state| state.released == ["t1"]);
    running.end(Level::Drain);
    assert!(farm.state().committed.is_empty() && farm.state().failures.is_empty());
}

#[test]
fn panic_in_a_task_is_reported_as_the_workers_fault_and_the_worker_goes_on() {
    let farm = FakeFarm::start();
    farm.offer("t1", &[]);
    farm.offer("t2", &[b"x"]);
    let run = |inputs: &[Artefact], source: &dyn ArtefactSource, progress: &Progress| {
        assert!(!inputs.is_empty(), "no inputs, on purpose");
        joining(inputs, source, progress)
    };
    run_until(&farm, run, "commit", |state| state.committed.contains_key("t2"));
    let state = farm.state();
    assert_eq!(state.failures[0].blame, Blame::Worker);
    assert!(state.failures[0].message.contains("on purpose"), "{:?}", state.failures);
}

#[test]
fn bad_input_is_blamed_on_the_task_with_its_cause() {
    let farm = FakeFarm::start();
    farm.offer("t1", &[]);
    let cause = std::io::Error::other("byte 7 is no vertex");
    let cause = Arc::new(Mutex::new(Some(cause)));
    let run = move |_: &[Artefact], _: &dyn ArtefactSource, _: &Progress| {
        let cause = cause.lock().unwrap().take().unwrap();
        Err(TaskError::bad_input_from("the scene cannot be read", cause))
    };
    run_until(&farm, run, "failure", |state| state.failures.len() == 1);
    let failure = &farm.state().failures[0];
    assert_eq!(failure.blame, Blame::Task);
    assert_eq!(failure.message, "the scene cannot be read: byte 7 is no vertex");
}

#[test]
fn artefact_read_before_comes_from_the_disk() {
    let farm = FakeFarm::start();
    let folder = tempfile::tempdir().unwrap();
    farm.offer("t1", &[b"big"]);
    farm.offer("t2", &[b"big"]);
    let cache_dir = folder.path().to_owned();
    let running = Running::start(&farm, joining, |config| config.cache_dir = Some(cache_dir));
    farm.wait_for("both commits", |state| state.committed.len() == 2);
    running.end(Level::Drain);
    let fetches = farm.state().calls.iter().filter(|call| call.starts_with("GET")).count();
    assert_eq!(fetches, 1);
}

#[test]
fn artefact_damaged_on_the_way_is_fetched_again() {
    let farm = FakeFarm::start();
    farm.state().damage_next = true;
    farm.offer("t1", &[b"whole"]);
    run_until(&farm, joining, "commit", |state| state.committed.len() == 1);
    let state = farm.state();
    assert_eq!(state.chunks[&state.committed["t1"].outputs[0].digest], b"whole");
}

#[test]
fn artefact_that_nobody_has_fails_the_attempt_by_name() {
    let farm = FakeFarm::start();
    farm.offer("t1", &[b"gone"]);
    farm.state().chunks.clear();
    run_until(&farm, joining, "failure", |state| state.failures.len() == 1);
    let failure = &farm.state().failures[0];
    assert_eq!(failure.blame, Blame::Worker);
    assert!(failure.message.contains("is not in the store"), "{failure:?}");
}

#[test]
fn draining_worker_finishes_a_task_within_the_grace_period() {
    let farm = FakeFarm::start();
    farm.offer("t1", &[b"x"]);
    farm.offer("t2", &[b"x"]);
    let shutdown = Arc::new(Mutex::new(None::<ShutdownFlag>));
    let raise = shutdown.clone();
    let run = move |inputs: &[Artefact], source: &dyn ArtefactSource, progress: &Progress| {
        raise.lock().unwrap().as_ref().unwrap().raise(Level::Drain);
        joining(inputs, source, progress)
    };
    let mut held = shutdown.lock().unwrap();
    let running = Running::start(&farm, run, |config| config.drain_grace = LIMIT);
    *held = Some(running.shutdown.clone());
    drop(held);
    running.thread.join().unwrap().unwrap();
    let state = farm.state();
    assert_eq!((state.committed.len(), state.leases.len()), (1, 1), "the second task must not be claimed");
}

#[test]
fn draining_worker_gives_a_long_task_back() {
    let farm = FakeFarm::start();
    farm.offer("t1", &[]);
    let running = Running::start(&farm, endless, |config| config.drain_grace = Duration::ZERO);
    farm.wait_for("heartbeat", beats);
    running.end(Level::Drain);
    assert_eq!(farm.state().released, ["t1"]);
}

#[test]
fn task_that_comes_after_the_order_to_stop_is_given_back_untouched() {
    let farm = FakeFarm::start();
    let config = WorkerConfig::new(farm.url(), "worker");
    let worker = Worker::new(config, Arc::new(FakeRunner(Box::new(joining)))).unwrap();
    let shutdown = ShutdownFlag::new();
    shutdown.raise(Level::Drain);
    farm.offer("late", &[]);
    let leases =
        claim::claim(&worker.farm, worker.claim_request(&Shift::new(None, None)), &shutdown).unwrap();
    assert_eq!(leases, []);
    farm.wait_for("release", |state| state.released == ["late"]);
}

#[test]
fn stopped_worker_gives_its_task_back_at_once() {
    let farm = FakeFarm::start();
    farm.offer("t1", &[]);
    let running = Running::start(&farm, endless, |config| config.drain_grace = LIMIT);
    farm.wait_for("heartbeat", beats);
    running.end(Level::Stop);
    assert_eq!(farm.state().released, ["t1"]);
}
