//! Workers that are told to end while a server has their calls and does not answer.

use super::fake_farm::{FakeFarm, LIMIT};
use super::*;

/// Does a task, drains while the call hangs whose text begins so, and gives the farm's state once the worker has ended.
fn drain_while_hanging(
    call: &'static str,
    run: fn(&[Artefact], &dyn ArtefactSource, &Progress) -> Done,
) -> FakeFarm {
    let farm = FakeFarm::start();
    farm.state().hang = Some(call);
    farm.offer("t1", &[b"x"]);
    let running = Running::start(&farm, run, |config| config.drain_grace = Duration::ZERO);
    if call.ends_with("/release") {
        farm.wait_for("heartbeat", beats);
    } else {
        farm.wait_for("a call that hangs", |state| state.calls.iter().any(|made| made.starts_with(call)));
    }
    running.shutdown.raise(Level::Drain);
    let began = Instant::now();
    while !running.thread.is_finished() {
        assert!(began.elapsed() < LIMIT, "it waits for the call");
        std::thread::park_timeout(Duration::from_millis(5));
    }
    running.thread.join().unwrap().unwrap();
    farm
}

type Done = Result<TaskOutput, TaskError>;

#[test]
fn draining_worker_does_not_wait_for_a_server_that_takes_no_result() {
    let farm = drain_while_hanging("POST /v1/leases/t1/commit", joining);
    let state = farm.state();
    assert!(state.committed.is_empty() && state.failures.is_empty());
    assert_eq!(state.released, ["t1"], "another worker need not wait for the lease's end");
}

#[test]
fn draining_worker_does_not_wait_for_a_server_that_takes_no_output() {
    let making = |_: &[Artefact], _: &dyn ArtefactSource, _: &Progress| {
        let artefacts = vec![("new".into(), b"new".to_vec())];
        Ok(TaskOutput { artefacts, ..TaskOutput::default() })
    };
    assert_eq!(drain_while_hanging("PUT /v1/chunks/", making).state().released, ["t1"]);
}

#[test]
fn draining_worker_does_not_wait_for_a_server_that_gives_no_input() {
    assert_eq!(drain_while_hanging("GET /v1/chunks/", joining).state().released, ["t1"]);
}

#[test]
fn draining_worker_leaves_a_task_to_its_leases_end_that_the_server_does_not_take_back() {
    let farm = drain_while_hanging("POST /v1/leases/t1/release", endless);
    let calls = farm.state().calls.clone();
    assert!(farm.state().released.is_empty(), "{calls:?}");
}
