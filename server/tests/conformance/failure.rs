//! Attempts that fail, and who is to blame.

use std::slice::from_ref;

use lightkiln_proto::api::{BakeState, Blame, CommitVerdict, EventKind, Lease, Verdict};
use lightkiln_server::clock::Clock as _;
use lightkiln_server::store::{
    BACKOFF_MAX_MS, FailVerdict, LOST_WORKERS, MAX_ATTEMPTS, MAX_PARDONS, POISON_WORKERS, WAIT_MAX_MS,
    backoff_ms,
};

use crate::support::{TTL_MS, World, task};

async fn fail(world: &World, lease: &Lease, blame: Blame) -> FailVerdict {
    world.store.fail(&lease.token, blame, "out of memory").await.unwrap()
}

pub async fn task_fault_fails_every_bake_that_wants_it(world: World) {
    let shared = task("shared", &[]);
    let bakes = [
        world.submit("first", from_ref(&shared)).await,
        world.submit("second", &[shared.clone(), task("other", &[])]).await,
    ];
    let lease = world.claim_one("w").await;
    assert_eq!(fail(&world, &lease, Blame::Task).await, FailVerdict::GivenUp);
    for bake in &bakes {
        let bake = world.show(bake).await;
        assert_eq!(bake.state, BakeState::Failed);
        assert_eq!(bake.failure.as_deref(), Some("shared (work) failed on worker w: out of memory"));
        let events = world.events(&bake).await;
        let told = |event: &EventKind| matches!(event, EventKind::TaskFailed { retry: false, .. });
        assert!(events.iter().any(|event| told(&event.event)));
    }
    assert!(world.claim("w", 10).await.is_empty());
}

pub async fn worker_fault_is_retried_by_another_worker_after_a_wait(world: World) {
    let bake = world.submit("bake", &[task("a", &[])]).await;
    assert!(world.claim("other", 0).await.is_empty());
    let lease = world.claim_one("w").await;
    assert_eq!(fail(&world, &lease, Blame::Worker).await, FailVerdict::Retry);
    assert_eq!(world.show(&bake).await.stages[0].leased, 0);
    assert!(world.claim("other", 1).await.is_empty(), "too early");
    world.clock.advance_ms(backoff_ms(1));
    assert!(world.claim("w", 1).await.is_empty(), "another worker is there");
    let lease = world.claim_one("other").await;
    assert_eq!(world.commit(&lease).await, CommitVerdict::Committed);
    assert_eq!(world.state(&bake).await, BakeState::Done);
}

pub async fn only_worker_may_try_its_task_again(world: World) {
    world.submit("bake", &[task("a", &[])]).await;
    let lease = world.claim_one("w").await;
    fail(&world, &lease, Blame::Worker).await;
    assert!(world.claim("w", 1).await.is_empty(), "too early");
    world.clock.advance_ms(backoff_ms(1));
    assert_eq!(world.claim("w", 1).await.len(), 1);
}

pub async fn task_goes_back_when_all_others_failed_at_it_too(world: World) {
    world.submit("bake", &[task("a", &[])]).await;
    world.claim("v", 0).await;
    for worker in ["w", "v"] {
        let lease = world.claim_one(worker).await;
        fail(&world, &lease, Blame::Worker).await;
        world.clock.advance_ms(BACKOFF_MAX_MS / 4);
    }
    world.claim("v", 0).await;
    assert_eq!(world.claim("w", 1).await.len(), 1);
}

pub async fn third_worker_that_fails_makes_it_poison(world: World) {
    let bake = world.submit("bake", &[task("a", &[])]).await;
    for worker in 1..=POISON_WORKERS {
        world.clock.advance_ms(BACKOFF_MAX_MS);
        let lease = world.claim_one(&format!("w{worker}")).await;
        let wanted = if worker < POISON_WORKERS { FailVerdict::Retry } else { FailVerdict::GivenUp };
        assert_eq!(fail(&world, &lease, Blame::Worker).await, wanted);
    }
    let failure = world.show(&bake).await.failure.unwrap();
    assert!(failure.contains("failed on 3 workers in 3 attempts"), "{failure}");
}

pub async fn attempts_are_limited(world: World) {
    let bake = world.submit("bake", &[task("a", &[])]).await;
    for attempt in 1..=MAX_ATTEMPTS {
        world.clock.advance_ms(BACKOFF_MAX_MS);
        let lease = world.claim_one("w").await;
        let wanted = if attempt < MAX_ATTEMPTS { FailVerdict::Retry } else { FailVerdict::GivenUp };
        assert_eq!(fail(&world, &lease, Blame::Worker).await, wanted);
    }
    assert_eq!(world.state(&bake).await, BakeState::Failed);
}

/// Machines go, one after the other, each with the one task that cannot be split.
pub async fn twenty_five_lost_workers_fail_no_bake(world: World) {
    let bake = world.submit("bake", &[task("prepare", &[])]).await;
    let mut waits = Vec::new();
    for number in 0..25 {
        let before = world.clock.now_ms();
        while world.store.look(&[], 1).await.unwrap().openings.is_empty() {
            world.clock.advance_ms(100);
        }
        waits.push(world.clock.now_ms() - before);
        world.begin_one(&format!("w{number}")).await;
        world.clock.advance_ms(TTL_MS);
        let reaped = world.store.reap().await.unwrap();
        assert_eq!((reaped.expired, reaped.lost, reaped.given_up), (1, 1, 0));
    }
    assert!(
        waits[1] == 0 && waits[24] > waits[4] && waits[4] > 0,
        "each loss costs more than the one before: {waits:?}"
    );
    world.clock.advance_ms(WAIT_MAX_MS);
    assert_eq!(world.drain("last").await, 1);
    let bake = world.show(&bake).await;
    assert_eq!((bake.state, bake.attempts_lost, bake.attempts_failed), (BakeState::Done, 25, 0));
    assert_eq!(world.store.blocklist(&bake.id).await.unwrap().workers, [], "nobody is to blame");
}

pub async fn task_that_is_always_lost_fails_its_bake_by_that_word(world: World) {
    let bake = world.submit("bake", &[task("a", &[])]).await;
    for number in 1..=LOST_WORKERS {
        assert_eq!(world.state(&bake).await, BakeState::Running, "loss {number}");
        let lease = world.begin_one(&format!("w{}", number % 3)).await;
        // The next start of the worker tells, or the lease runs out.
        if number % 2 == 0 {
            let wanted = if number < LOST_WORKERS { FailVerdict::Retry } else { FailVerdict::GivenUp };
            assert_eq!(fail(&world, &lease, Blame::Lost).await, wanted);
        } else {
            world.expire_leases().await;
        }
        world.clock.advance_ms(WAIT_MAX_MS);
    }
    let bake = world.show(&bake).await;
    assert_eq!((bake.state, bake.attempts_lost), (BakeState::Failed, u64::from(LOST_WORKERS)));
    let failure = bake.failure.clone().unwrap();
    assert!(failure.contains("was lost 50 times") && !failure.contains("failed on"), "{failure}");
    let told =
        |event: &EventKind| matches!(event, EventKind::TaskFailed { blame: Blame::Lost, retry: false, .. });
    assert!(world.events(&bake).await.iter().any(|event| told(&event.event)));
}

pub async fn lost_workers_and_failures_are_counted_apart(world: World) {
    let bake = world.submit("bake", &[task("a", &[])]).await;
    for number in 1..MAX_ATTEMPTS {
        for is_lost in [true, false] {
            let lease = world.begin_one("w").await;
            let blame = if is_lost { Blame::Lost } else { Blame::Worker };
            assert_eq!(fail(&world, &lease, blame).await, FailVerdict::Retry, "attempt {number}");
            world.clock.advance_ms(WAIT_MAX_MS);
        }
    }
    let shown = world.show(&bake).await;
    let each = u64::from(MAX_ATTEMPTS) - 1;
    assert_eq!((shown.attempts_failed, shown.attempts_lost), (each, each));
    let lease = world.begin_one("w").await;
    assert_eq!(fail(&world, &lease, Blame::Worker).await, FailVerdict::GivenUp);
    let failure = world.show(&bake).await.failure.unwrap();
    assert!(
        failure.contains("failed on 1 worker in 5 attempts") && !failure.contains("was lost"),
        "{failure}"
    );
}

/// The answers to its claims are lost, or it goes before they come.
pub async fn leases_that_nobody_was_heard_about_count_no_attempt(world: World) {
    let bake = world.submit("bake", &[task("a", &[])]).await;
    for number in 0..3 * MAX_ATTEMPTS {
        world.claim_one(&format!("w{}", number % 4)).await;
        assert_eq!(world.expire_leases().await, 1);
    }
    assert_eq!(world.store.blocklist(&bake.id).await.unwrap().workers, []);
    let stages = world.show(&bake).await.stages;
    assert_eq!((stages[0].leased, stages[0].done), (0, 0));
    // Heard once is heard: silence after it is a loss.
    assert_eq!(world.show(&bake).await.attempts_lost, 0);
    world.begin_one("w").await;
    world.expire_leases().await;
    assert_eq!(world.show(&bake).await.attempts_lost, 1);
}

/// Its database was slow, or its machine slept: the worker is heard again after its lease has run out.
pub async fn attempt_of_a_worker_that_was_silent_and_is_alive_is_given_back(world: World) {
    let bake = world.submit("bake", &[task("a", &[])]).await;
    for number in 0..MAX_PARDONS {
        let lease = world.begin_one(&format!("w{number}")).await;
        world.clock.advance_ms(TTL_MS);
        let is_noticed = number % 2 == 0;
        if is_noticed {
            assert_eq!(world.store.reap().await.unwrap().lost, 1);
        }
        for _ in 0..2 {
            match number % 3 {
                0 => assert_eq!(world.commit(&lease).await, CommitVerdict::Stale),
                1 => assert!(!world.store.release(&lease.token).await.unwrap()),
                _ => {
                    let answer = world.store.heartbeat(&lease.token, 0.5).await.unwrap();
                    assert_eq!(answer.verdict, Verdict::Lost);
                }
            }
        }
        let reaped = world.store.reap().await.unwrap();
        assert_eq!((reaped.expired, reaped.lost), (u64::from(!is_noticed), 0));
    }
    // Who is silent again and again is stuck.
    for loss in 1..=LOST_WORKERS {
        assert_eq!(world.state(&bake).await, BakeState::Running, "loss {loss}");
        let lease = world.begin_one("w").await;
        assert_eq!(world.expire_leases().await, 1);
        world.store.heartbeat(&lease.token, 0.5).await.unwrap();
        world.clock.advance_ms(WAIT_MAX_MS);
    }
    assert_eq!(world.state(&bake).await, BakeState::Failed);
}

pub async fn failure_that_is_reported_late_still_counts(world: World) {
    let bake = world.submit("bake", &[task("a", &[])]).await;
    for is_noticed in [true, false] {
        let lease = world.begin_one("w").await;
        world.clock.advance_ms(TTL_MS);
        if is_noticed {
            world.store.reap().await.unwrap();
        }
        assert_eq!(fail(&world, &lease, Blame::Worker).await, FailVerdict::Stale);
        world.store.reap().await.unwrap();
    }
    let started = |event: &EventKind| match event {
        EventKind::TaskStarted { attempt, .. } => Some(*attempt),
        _ => None,
    };
    world.clock.advance_ms(WAIT_MAX_MS);
    world.claim_one("w").await;
    let events = world.events(&bake).await;
    let attempts: Vec<u32> = events.iter().filter_map(|event| started(&event.event)).collect();
    assert_eq!(attempts, [1, 2, 3]);
}

/// Attempt 2 began before the holder of attempt 1 was heard again.
pub async fn attempt_keeps_its_number_when_an_earlier_one_is_given_back(world: World) {
    let bake = world.submit("bake", &[task("a", &[])]).await;
    let late = world.begin_one("w").await;
    world.expire_leases().await;
    let lease = world.begin_one("v").await;
    world.store.heartbeat(&late.token, 0.5).await.unwrap();
    assert_eq!(world.commit(&lease).await, CommitVerdict::Committed);
    // Heard once more, when there is nothing to give back.
    assert_eq!(world.store.heartbeat(&late.token, 0.5).await.unwrap().verdict, Verdict::Lost);
    let events = world.events(&bake).await;
    let done = events.iter().find_map(|event| match &event.event {
        EventKind::TaskDone { attempt, .. } => Some(*attempt),
        _ => None,
    });
    assert_eq!(done, Some(2));
}

pub async fn failed_bake_drops_its_other_tasks(world: World) {
    world.submit("bake", &[task("a", &[]), task("b", &[]), task("c", &[])]).await;
    let leases = world.claim("w", 2).await;
    fail(&world, &leases[0], Blame::Task).await;
    let verdict = world.store.heartbeat(&leases[1].token, 0.1).await.unwrap().verdict;
    assert_eq!(verdict, Verdict::Cancel);
    assert_eq!(world.commit(&leases[1]).await, CommitVerdict::Stale);
    assert!(world.claim("w", 10).await.is_empty());
    assert!(world.store.stats().await.unwrap().tasks.is_empty());
}

pub async fn failed_task_gets_another_chance_in_a_new_bake(world: World) {
    world.submit("bake", &[task("a", &[])]).await;
    let lease = world.claim_one("w").await;
    fail(&world, &lease, Blame::Task).await;
    let again = world.submit("again", &[task("a", &[])]).await;
    assert_eq!(world.drain("w").await, 1);
    assert_eq!(world.state(&again).await, BakeState::Done);
}
