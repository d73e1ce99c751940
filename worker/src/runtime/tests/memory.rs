//! A worker whose memory is used up, by itself or by others.

use std::convert::Infallible;

use lightkiln_proto::api::Failure;

use super::super::memory::tests::{Script, machine};
use super::*;

/// MiB of a worker, of 4096 of its machine.
const MOST: u64 = 3000;
const LITTLE: u64 = 100;

/// Works for ever without inputs, and joins them where there are some.
fn endless_or_joining(
    inputs: &[Artefact],
    source: &dyn ArtefactSource,
    progress: &Progress,
) -> Result<TaskOutput, TaskError> {
    if inputs.is_empty() { endless(inputs, source, progress) } else { joining(inputs, source, progress) }
}

/// A worker whose machine is full when `is_full` says so, and that has so many MiB.
fn start(
    farm: &FakeFarm,
    own_mib: u64,
    is_full: impl Fn(&State) -> bool + Send + Sync + 'static,
    change: impl FnOnce(&mut WorkerConfig),
) -> Running {
    let seen = farm.clone();
    let gauge = Script::new(move || machine(is_full(&seen.state()), own_mib));
    let runner = Arc::new(FakeRunner(Box::new(endless_or_joining)));
    Running::start_with(farm, runner, gauge, |config| {
        config.lease_secs = 60;
        change(config);
    })
}

fn is_begun(state: &State, token: &str) -> bool {
    state.calls.contains(&format!("POST /v1/leases/{token}/heartbeat"))
}

fn claims(state: &State) -> usize {
    state.calls.iter().filter(|call| *call == "POST /v1/leases").count()
}

/// The report when memory is used up by one task, of a worker that has so much of it.
fn failure_of_one_task(own_mib: u64) -> (Blame, String) {
    let farm = FakeFarm::start();
    farm.offer("t1", &[]);
    let is_full = |state: &State| is_begun(state, "t1") && state.failures.is_empty();
    let running = start(&farm, own_mib, is_full, |_| ());
    farm.wait_for("failure", |state| state.failures.len() == 1);
    let worker = running.worker.clone();
    running.end(Level::Drain);
    assert_eq!(worker.crowd.allowed(), 1);
    let failure = farm.state().failures[0].clone();
    (failure.blame, failure.message)
}

#[test]
fn task_that_uses_up_memory_alone_is_to_blame_and_says_so() {
    let (blame, message) = failure_of_one_task(MOST);
    assert!(blame == Blame::Worker && message.starts_with("out of memory: "), "{message}");
}

#[test]
fn task_whose_memory_others_took_is_lost_and_says_so() {
    let (blame, message) = failure_of_one_task(LITTLE);
    assert!(blame == Blame::Lost && message.starts_with("out of memory: "), "{message}");
    assert!(message.contains("100 by this worker") && message.contains("close other programs"), "{message}");
}

#[test]
fn tasks_that_use_up_memory_together_are_lost_and_come_one_at_a_time_then() {
    let farm = FakeFarm::start();
    ["t1", "t2"].iter().for_each(|token| farm.offer(token, &[]));
    let is_full = |state: &State| is_begun(state, "t1") && is_begun(state, "t2") && state.failures.len() < 2;
    let running = start(&farm, MOST, is_full, |config| config.tasks = 2);
    farm.wait_for("both failures", |state| state.failures.len() == 2);
    assert_eq!(running.worker.crowd.allowed(), 1);
    farm.offer("t3", &[b"x"]);
    farm.wait_for("commit", |state| state.committed.contains_key("t3"));
    running.end(Level::Drain);
    for failure in &farm.state().failures {
        let Failure { blame, message } = failure;
        assert!(*blame == Blame::Lost && message.starts_with("out of memory: "), "{message}");
    }
}

#[test]
fn worker_claims_nothing_while_as_many_tasks_are_in_hand_as_may_be() {
    let farm = FakeFarm::start();
    let running = start(&farm, LITTLE, |_| false, |config| (config.tasks, config.lease_secs) = (2, 1));
    running.worker.crowd.squeeze();
    farm.offer("t1", &[]);
    let beats = |state: &State| state.calls.iter().filter(|call| call.ends_with("/heartbeat")).count();
    farm.wait_for("the task", |state| beats(state) == 1);
    let before = claims(&farm.state());
    // A server that has nothing is asked again after a fiftieth of a second.
    farm.wait_for("three heartbeats", |state| beats(state) == 3);
    assert_eq!(claims(&farm.state()), before);
    running.end(Level::Stop);
    assert_eq!(farm.state().released, ["t1"]);
}

#[test]
fn task_that_comes_when_memory_is_used_up_is_given_back_untried() {
    let farm = FakeFarm::start();
    farm.offer("t1", &[]);
    farm.offer("t2", &[b"x"]);
    let is_full = |state: &State| claims(state) > 0 && state.released.is_empty();
    let running = start(&farm, MOST, is_full, |config| config.max_tasks = Some(1));
    running.thread.join().unwrap().unwrap();
    let state = farm.state();
    assert_eq!((state.released.as_slice(), state.committed.len()), (&["t1".to_owned()][..], 1));
    assert!(state.failures.is_empty() && !is_begun(&state, "t1"), "{:?}", state.calls);
}

/// Keeps a value in the cache, and is done when that has gone.
struct Caching(Arc<AtomicBool>);

/// A value, and whether it is there.
struct Kept(Arc<AtomicBool>);

impl Drop for Kept {
    fn drop(&mut self) {
        self.0.store(false, Ordering::Release);
    }
}

impl TaskRunner for Caching {
    fn kinds(&self) -> Vec<String> {
        vec!["test".into()]
    }

    fn run(
        &self,
        _task: &TaskSpec,
        inputs: &[Artefact],
        _: &[Vec<Artefact>],
        source: &dyn ArtefactSource,
        memory: &MemoryCache,
        progress: &Progress,
    ) -> Result<TaskOutput, TaskError> {
        let keep = || {
            self.0.store(true, Ordering::Release);
            Ok::<_, Infallible>((Kept(self.0.clone()), 1))
        };
        drop(memory.get_or_insert(inputs[0].digest, keep));
        let started = Instant::now();
        while self.0.load(Ordering::Acquire) {
            progress.check()?;
            assert!(started.elapsed() < LIMIT, "the cache was not cleared");
            std::thread::park_timeout(Duration::from_millis(5));
        }
        joining(inputs, source, progress)
    }
}

#[test]
fn cache_is_cleared_before_a_task_fails_whoever_has_the_memory() {
    for own_mib in [LITTLE, MOST] {
        let farm = FakeFarm::start();
        farm.offer("t1", &[b"x"]);
        let is_kept = Arc::new(AtomicBool::new(false));
        let runner = Arc::new(Caching(is_kept.clone()));
        let gauge = Script::new(move || machine(is_kept.load(Ordering::Acquire), own_mib));
        let running = Running::start_with(&farm, runner, gauge, |config| config.lease_secs = 60);
        farm.wait_for("an end", |state| state.committed.len() + state.failures.len() == 1);
        running.end(Level::Drain);
        assert!(farm.state().failures.is_empty(), "{:?}", farm.state().failures);
    }
}

#[test]
fn worker_waits_for_memory_that_others_have_and_goes_on_when_it_is_free() {
    let farm = FakeFarm::start();
    farm.offer("t1", &[b"x"]);
    let is_full = Arc::new(AtomicBool::new(true));
    let full = is_full.clone();
    let running = start(&farm, LITTLE, move |_| full.load(Ordering::Acquire), |_| ());
    let started = Instant::now();
    let words = loop {
        assert!(started.elapsed() < LIMIT, "it does not say that it waits");
        if let Some(words) = running.worker.waits_for_memory() {
            break words;
        }
        std::thread::park_timeout(Duration::from_millis(5));
    };
    assert_eq!(words, "4096 of 4096 MiB of this machine were in use, 100 by this worker");
    assert_eq!(claims(&farm.state()), 0);
    is_full.store(false, Ordering::Release);
    farm.wait_for("commit", |state| state.committed.len() == 1);
    assert_eq!(running.worker.waits_for_memory(), None);
    running.end(Level::Drain);
}

#[test]
fn worker_whose_patience_is_over_ends_with_the_reason_and_all_its_threads() {
    let farm = FakeFarm::start();
    farm.offer("t1", &[b"x"]);
    let impatient = |config: &mut WorkerConfig| {
        (config.tasks, config.memory_patience) = (3, Some(Duration::ZERO));
    };
    let Running { shutdown, thread, .. } = start(&farm, LITTLE, |_| true, impatient);
    let ended = thread.join().unwrap();
    assert!(matches!(&ended, Err(WorkerError::Memory { seen, is_own: false }) if seen.contains("machine")));
    assert_eq!((shutdown.level(), claims(&farm.state())), (Level::Drain, 0));
}
