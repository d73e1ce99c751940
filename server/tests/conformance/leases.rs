//! Claims, heartbeats, commits, releases, expiry.

use std::collections::BTreeSet;

use lightkiln_proto::api::{BakeState, Blame, CommitVerdict, EventKind, Verdict};
use lightkiln_server::store::rules::WORKER_PRESENT_MS;
use lightkiln_server::store::{FailVerdict, Reaped};

use crate::support::{TTL_MS, World, request, result, submission, task, task_of};

pub async fn claimed_task_is_not_handed_out_again(world: World) {
    world.submit("bake", &[task("a", &[])]).await;
    let lease = world.claim_one("w").await;
    assert_eq!(lease.expires_ms, 1_000_000 + TTL_MS);
    assert!(world.claim("w", 1).await.is_empty());
    assert!(world.claim("other", 1).await.is_empty());
}

pub async fn lease_names_the_trace_of_its_bake(world: World) {
    let mut traced = submission("traced", &[task("a", &[])]);
    traced.traceparent = Some("00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01".to_owned());
    world.store.submit(&traced).await.unwrap();
    assert_eq!(world.claim_one("w").await.traceparent, traced.traceparent);
    world.submit("untraced", &[task("b", &[])]).await;
    assert_eq!(world.claim_one("w").await.traceparent, None);
}

pub async fn claims_respect_kind_and_number(world: World) {
    let tasks = ["a", "b", "c"].map(|name| task(name, &[]));
    world.submit("bake", &tasks).await;
    world.submit("odd", &[task_of("odd", "odd", &[], 100)]).await;
    assert_eq!(world.claim("w", 2).await.len(), 2);
    assert_eq!(world.claim("w", 2).await.len(), 1);
    let mut odd = request("w", 5);
    odd.kinds = vec!["odd".into()];
    assert_eq!(world.store.claim(&odd).await.unwrap().len(), 1);
}

pub async fn heartbeat_prolongs_the_lease(world: World) {
    world.submit("bake", &[task("a", &[])]).await;
    let lease = world.claim_one("w").await;
    for _ in 0..3 {
        world.clock.advance_ms(TTL_MS - 1);
        let answer = world.store.heartbeat(&lease.token, 0.5).await.unwrap();
        assert_eq!(answer.verdict, Verdict::Keep);
        assert_eq!(world.store.reap().await.unwrap(), Reaped::default());
    }
    assert_eq!(world.commit(&lease).await, CommitVerdict::Committed);
}

pub async fn expired_lease_is_refused_before_and_after_the_reaper(world: World) {
    let bake = world.submit("bake", &[task("a", &[])]).await;
    let old = world.claim_one("w").await;
    world.clock.advance_ms(TTL_MS);
    assert_eq!(world.commit(&old).await, CommitVerdict::Stale);
    assert_eq!(world.store.heartbeat(&old.token, 0.9).await.unwrap().verdict, Verdict::Lost);
    assert!(world.claim("w", 1).await.is_empty(), "not before the reaper has seen it");
    assert_eq!(world.store.reap().await.unwrap().expired, 1);
    assert_eq!(world.commit(&old).await, CommitVerdict::Stale);
    let new = world.claim_one("w").await;
    assert_ne!(new.token, old.token);
    assert_eq!(world.commit(&old).await, CommitVerdict::Stale);
    assert_eq!(world.commit(&new).await, CommitVerdict::Committed);
    assert_eq!(world.commit(&old).await, CommitVerdict::Stale);
    assert_eq!(world.show(&bake).await.tasks_run, 1);
}

pub async fn lost_lease_requeues_task_once(world: World) {
    let bake = world.submit("bake", &[task("a", &[])]).await;
    world.claim_one("w").await;
    assert_eq!(world.expire_leases().await, 1);
    assert_eq!(world.store.reap().await.unwrap(), Reaped::default());
    assert_eq!(world.claim("other", 10).await.len(), 1);
    let lost = |event: &&_| matches!(event, EventKind::LeaseExpired { worker, .. } if worker == "w");
    let events = world.events(&bake).await;
    assert_eq!(events.iter().map(|event| &event.event).filter(lost).count(), 1);
}

pub async fn same_token_commits_once(world: World) {
    let a = task("a", &[]);
    let bake = world.submit("bake", &[a.clone(), task("b", &[&a])]).await;
    let lease = world.claim_one("w").await;
    assert_eq!(world.commit(&lease).await, CommitVerdict::Committed);
    let after = world.show(&bake).await;
    world.clock.advance_ms(TTL_MS * 10);
    assert_eq!(world.commit(&lease).await, CommitVerdict::AlreadyCommitted);
    assert_eq!(world.show(&bake).await, after);
    assert_eq!(world.claim_labels("w", 10).await, ["b"]);
}

pub async fn released_task_is_ready_and_costs_no_attempt(world: World) {
    let bake = world.submit("bake", &[task("a", &[])]).await;
    for _ in 0..20 {
        let lease = world.claim_one("w").await;
        assert!(world.store.release(&lease.token).await.unwrap());
        assert_eq!(world.commit(&lease).await, CommitVerdict::Stale);
    }
    assert_eq!(world.show(&bake).await.stages[0].leased, 0);
    assert_eq!(world.drain("w").await, 1);
}

pub async fn release_and_fail_of_a_lost_lease_change_nothing(world: World) {
    let bake = world.submit("bake", &[task("a", &[])]).await;
    let lease = world.claim_one("w").await;
    world.clock.advance_ms(TTL_MS);
    assert!(!world.store.release(&lease.token).await.unwrap());
    let failed = world.store.fail(&lease.token, Blame::Task, "too late").await.unwrap();
    assert_eq!(failed, FailVerdict::Stale);
    assert_eq!(world.state(&bake).await, BakeState::Running);
    assert_eq!(world.store.reap().await.unwrap().expired, 1);
}

pub async fn unknown_token_is_lost_and_stale(world: World) {
    world.submit("bake", &[task("a", &[])]).await;
    let mut lease = world.claim_one("w").await;
    lease.token = "0".repeat(32);
    assert_eq!(world.store.heartbeat(&lease.token, 0.0).await.unwrap().verdict, Verdict::Lost);
    assert_eq!(world.commit(&lease).await, CommitVerdict::Stale);
    assert_eq!(world.store.fail(&lease.token, Blame::Task, "").await.unwrap(), FailVerdict::Stale);
    assert!(!world.store.release(&lease.token).await.unwrap());
}

/// How far the clock was ahead: an hour or two, as a machine whose clock nobody keeps.
const AHEAD_MS: i64 = 7_200_000;

pub async fn lease_of_a_clock_that_was_set_back_lasts_no_longer_than_its_length(world: World) {
    world.clock.advance_ms(AHEAD_MS);
    world.submit("bake", &[task("a", &[]), task("b", &[])]).await;
    let [alive, dead] = [world.begin_one("alive").await, world.begin_one("dead").await];
    world.clock.advance_ms(-AHEAD_MS);
    assert_eq!(world.store.reap().await.unwrap(), Reaped::default());
    // Nobody who is there loses his lease for it.
    world.clock.advance_ms(TTL_MS / 2);
    let answer = world.store.heartbeat(&alive.token, 0.5).await.unwrap();
    assert_eq!((answer.verdict, answer.expires_ms), (Verdict::Keep, 1_000_000 + TTL_MS / 2 + TTL_MS));
    world.clock.advance_ms(TTL_MS / 2);
    let reaped = world.store.reap().await.unwrap();
    assert_eq!((reaped.expired, reaped.lost), (1, 1));
    assert_eq!(world.claim_one("other").await.task.key, dead.task.key);
    assert_eq!(world.commit(&dead).await, CommitVerdict::Stale);
    assert_eq!(world.commit(&alive).await, CommitVerdict::Committed);
}

pub async fn wait_of_a_clock_that_was_set_back_is_over(world: World) {
    world.clock.advance_ms(AHEAD_MS);
    world.submit("bake", &[task("a", &[])]).await;
    let lease = world.claim_one("w").await;
    world.store.fail(&lease.token, Blame::Worker, "why").await.unwrap();
    world.clock.advance_ms(-AHEAD_MS);
    world.store.reap().await.unwrap();
    assert_eq!(world.claim_one("w").await.task.key, lease.task.key);
}

pub async fn limit_of_a_clock_that_was_set_back_is_kept(world: World) {
    world.clock.advance_ms(AHEAD_MS);
    let mut limited = submission("bake", &[task("a", &[])]);
    limited.bake.attempt_limit_secs = Some(100);
    let bake = world.store.submit(&limited).await.unwrap().bake;
    let lease = world.begin_one("stuck").await;
    world.clock.advance_ms(-AHEAD_MS);
    world.store.reap().await.unwrap();
    for _ in 0..9 {
        world.clock.advance_ms(10_000);
        assert_eq!(world.store.heartbeat(&lease.token, 0.5).await.unwrap().verdict, Verdict::Keep);
    }
    world.clock.advance_ms(10_000);
    assert_eq!(world.store.heartbeat(&lease.token, 0.5).await.unwrap().verdict, Verdict::Lost);
    let reaped = world.store.reap().await.unwrap();
    assert_eq!((reaped.expired, reaped.lost), (1, 0));
    assert_eq!(world.show(&bake).await.attempts_failed, 1);
}

/// A task is left to others who are there; one who was there two hours ahead is not.
pub async fn worker_seen_by_a_clock_that_was_set_back_is_not_there_for_ever(world: World) {
    world.clock.advance_ms(AHEAD_MS);
    world.claim("gone", 0).await;
    world.clock.advance_ms(-AHEAD_MS);
    world.submit("bake", &[task("a", &[])]).await;
    let lease = world.claim_one("w").await;
    world.store.fail(&lease.token, Blame::Worker, "why").await.unwrap();
    world.store.reap().await.unwrap();
    world.clock.advance_ms(WORKER_PRESENT_MS);
    assert_eq!(world.claim_one("w").await.task.key, lease.task.key);
}

pub async fn concurrent_claims_hand_every_task_out_once(world: World) {
    let tasks: Vec<_> = (0..60).map(|i| task(&format!("{i}"), &[])).collect();
    world.submit("bake", &tasks).await;
    let mut claims = Vec::new();
    for worker in 0..20 {
        let store = world.store.clone();
        claims.push(tokio::spawn(async move { store.claim(&request(&format!("w{worker}"), 4)).await }));
    }
    let mut keys = BTreeSet::new();
    let mut count = 0;
    for claim in claims {
        for lease in claim.await.unwrap().unwrap() {
            keys.insert(lease.task.key);
            count += 1;
        }
    }
    assert_eq!((count, keys.len()), (60, 60));
}

pub async fn results_that_come_together_are_each_taken_in_or_refused(world: World) {
    let tasks: Vec<_> = ["a", "b", "c", "d"].iter().map(|name| task(name, &[])).collect();
    let after = task("after", &[&tasks[0], &tasks[1]]);
    let planned = task("planned", &[&tasks[2]]);
    let plan: Vec<_> = tasks.iter().chain([&after]).cloned().collect();
    let bake = world.submit("bake", &plan).await;
    let other = world.submit("other", &tasks[..2]).await;
    let leases = world.claim("w", 4).await;
    let lease = |name: &str| leases.iter().find(|lease| lease.task.label == name).unwrap();
    assert_eq!(world.commit(lease("d")).await, CommitVerdict::Committed);
    let mut commits = Vec::new();
    for name in ["a", "b", "c", "d", "a"] {
        let plan = if name == "c" { std::slice::from_ref(&planned) } else { &[] };
        commits.push((lease(name).token.clone(), result(lease(name), plan)));
    }
    commits.push(("0".repeat(32), result(lease("a"), &[])));
    let together: Vec<_> = commits.iter().map(|(token, result)| (token.as_str(), result)).collect();
    let verdicts: Vec<_> =
        world.store.commit_all(&together).await.into_iter().map(|verdict| verdict.unwrap()).collect();
    use CommitVerdict::{AlreadyCommitted, Committed, Stale};
    assert_eq!(verdicts[1..4], [Committed, Committed, AlreadyCommitted]);
    assert_eq!((verdicts[0], verdicts[4], verdicts[5]), (Committed, AlreadyCommitted, Stale));
    // Their dependants are ready, their plan is taken in, and each bake has counted its own.
    let mut labels = world.claim_labels("w", 10).await;
    labels.sort_unstable();
    assert_eq!(labels, ["after", "planned"]);
    let (bake, other) = (world.show(&bake).await, world.show(&other).await);
    assert_eq!((bake.tasks_run, bake.stages[0].done, bake.stages[0].leased), (4, 4, 2));
    assert_eq!(bake.counters["rays"], 40.0);
    assert_eq!((other.tasks_run, other.state), (2, BakeState::Done));
    let done = world
        .events(&bake)
        .await
        .into_iter()
        .filter(|event| matches!(event.event, EventKind::TaskDone { .. }));
    assert_eq!(done.count(), 4);
}
