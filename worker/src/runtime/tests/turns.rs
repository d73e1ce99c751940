//! Threads of a worker that take turns to claim.

use super::*;

#[test]
fn thread_that_waits_for_its_turn_claims_nothing_after_the_order_to_end() {
    let farm = FakeFarm::start();
    farm.state().hang = Some("POST /v1/leases");
    let running = Running::start(&farm, joining, |config| config.tasks = 2);
    farm.wait_for("the claim", |state| !state.calls.is_empty());
    let started = Instant::now();
    while running.worker.idle.load(Ordering::Acquire) < 2 {
        assert!(started.elapsed() < LIMIT, "two threads have no task");
        std::thread::yield_now();
    }
    running.end(Level::Drain);
    assert_eq!(farm.state().calls, ["POST /v1/leases"]);
    farm.let_go();
}

#[test]
fn leases_that_come_together_are_noted_as_they_come_until_they_are_given_back() {
    let (farm, folder) = (FakeFarm::start(), tempfile::tempdir().unwrap());
    ["t1", "t2", "t3"].iter().for_each(|token| farm.offer(token, &[]));
    let mut config = WorkerConfig::new(farm.url(), "worker");
    (config.tasks, config.seat) = (2, Some(Arc::new(Seat::take(folder.path()).unwrap())));
    let worker = Worker::new(config, Arc::new(FakeRunner(Box::new(joining)))).unwrap();
    worker.idle.store(3, Ordering::Release);
    let (shutdown, shift) = (ShutdownFlag::new(), Shift::new(None, None));
    let held = || std::fs::read_to_string(folder.path().join("0.held")).unwrap();
    let notes = || ["t1", "t2", "t3"].map(|token| held().contains(&format!("\"{token}\"")));
    {
        let mut spare = worker.claiming.lock().unwrap();
        let next = worker.next_task(&mut spare, &shutdown, &shift).unwrap();
        assert!(matches!(next, Next::Task(lease) if lease.token == "t1") && spare.len() == 1);
    }
    assert_eq!(notes(), [true, true, false], "as many as may be in hand, before any is begun");
    worker.give_back_spare(&shutdown);
    assert_eq!((notes(), farm.state().released.as_slice()), ([true, false, false], &["t2".to_owned()][..]));
}
