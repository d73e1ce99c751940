//! Submitting, pausing, cancelling, priorities.

use std::slice::from_ref;

use lightkiln_proto::api::{BakeFilter, BakeState, CommitVerdict, Verdict};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::TaskSpec;
use lightkiln_server::store::StoreError;

use crate::support::{World, submission, task, task_of};

pub async fn same_key_and_body_give_the_same_bake(world: World) {
    let mut submission = submission("bake", &[task("a", &[])]);
    submission.idempotency_key = Some("key".into());
    let first = world.store.submit(&submission).await.unwrap();
    let again = world.store.submit(&submission).await.unwrap();
    assert!(first.is_new && !again.is_new);
    assert_eq!(first.bake, again.bake);
    assert_eq!(world.claim("w", 10).await.len(), 1);
}

pub async fn same_key_with_another_body_is_refused(world: World) {
    let mut submission = submission("bake", &[task("a", &[])]);
    submission.idempotency_key = Some("key".into());
    world.store.submit(&submission).await.unwrap();
    submission.body_hash = Digest::of(b"other body");
    let error = world.store.submit(&submission).await.unwrap_err();
    assert!(matches!(error, StoreError::IdempotencyConflict { .. }), "{error}");
    assert_eq!(world.store.list(&BakeFilter::default(), None, 10).await.unwrap().bakes.len(), 1);
}

pub async fn without_a_key_every_submission_is_a_bake(world: World) {
    let first = world.submit("bake", &[task("a", &[])]).await;
    let second = world.submit("bake", &[task("a", &[])]).await;
    assert_ne!(first.id, second.id);
}

pub async fn paused_bake_holds_its_tasks_back_until_resumed(world: World) {
    let bake = world.submit("bake", &[task("a", &[]), task("b", &[])]).await;
    let held = world.claim_one("w").await;
    assert_eq!(world.store.pause(&bake.id).await.unwrap().state, BakeState::Paused);
    assert_eq!(world.store.pause(&bake.id).await.unwrap().state, BakeState::Paused);
    assert!(world.claim("w", 10).await.is_empty());
    assert_eq!(world.commit(&held).await, CommitVerdict::Committed);
    assert_eq!(world.store.resume(&bake.id).await.unwrap().state, BakeState::Running);
    assert_eq!(world.drain("w").await, 1);
    assert_eq!(world.state(&bake).await, BakeState::Done);
}

pub async fn cancelled_bake_tells_holders_to_stop_and_refuses_their_results(world: World) {
    let bake = world.submit("bake", &[task("a", &[]), task("b", &[])]).await;
    let held = world.claim_one("w").await;
    let cancelled = world.store.cancel(&bake.id).await.unwrap();
    assert_eq!((cancelled.state, cancelled.stages[0].leased), (BakeState::Cancelled, 0));
    assert_eq!(cancelled.finished_ms, Some(1_000_000));
    let answer = world.store.heartbeat(&held.token, 0.5).await.unwrap();
    assert_eq!(answer.verdict, Verdict::Cancel);
    assert_eq!(world.commit(&held).await, CommitVerdict::Stale);
    assert!(world.claim("w", 10).await.is_empty());
    assert_eq!(world.show(&bake).await.tasks_run, 0);
    // The same task in a new bake starts afresh.
    let again = world.submit("again", &[task("a", &[])]).await;
    assert_eq!(world.drain("w").await, 1);
    assert_eq!(world.state(&again).await, BakeState::Done);
}

pub async fn cancel_keeps_what_another_bake_wants(world: World) {
    let (shared, own) = (task("shared", &[]), task("own", &[]));
    let first = world.submit("first", &[shared.clone(), own]).await;
    let second = world.submit("second", from_ref(&shared)).await;
    let leases = world.claim("w", 10).await;
    world.store.cancel(&first.id).await.unwrap();
    for lease in leases {
        let is_shared = lease.task.key == shared.key;
        let verdict = world.store.heartbeat(&lease.token, 0.5).await.unwrap().verdict;
        assert_eq!(verdict, if is_shared { Verdict::Keep } else { Verdict::Cancel });
        let wanted = if is_shared { CommitVerdict::Committed } else { CommitVerdict::Stale };
        assert_eq!(world.commit(&lease).await, wanted);
    }
    assert_eq!(world.state(&second).await, BakeState::Done);
    assert_eq!(world.state(&first).await, BakeState::Cancelled);
}

pub async fn cancel_again_changes_nothing(world: World) {
    let bake = world.submit("bake", &[task("a", &[])]).await;
    let first = world.store.cancel(&bake.id).await.unwrap();
    world.clock.advance_ms(5);
    assert_eq!(world.store.cancel(&bake.id).await.unwrap(), first);
}

pub async fn ended_bake_refuses_changes(world: World) {
    let bake = world.submit("bake", &[task("a", &[])]).await;
    world.drain("w").await;
    let is_conflict = |outcome| matches!(outcome, Err(StoreError::StateConflict { .. }));
    assert!(is_conflict(world.store.cancel(&bake.id).await));
    assert!(is_conflict(world.store.pause(&bake.id).await));
    assert!(is_conflict(world.store.resume(&bake.id).await));
    assert!(is_conflict(world.store.reprioritise(&bake.id, 3).await));
}

pub async fn priority_then_share_then_age_then_cost_then_key_decide_the_order(world: World) {
    let cheap = [task_of("work", "cheap 1", &[], 1), task_of("work", "cheap 2", &[], 1)];
    let mut by_key = cheap.clone();
    by_key.sort_by_key(|task| task.key);
    let dear = task_of("work", "dear", &[], 9);
    world.submit_at("old", 0, &[cheap[0].clone(), dear, cheap[1].clone()]).await;
    world.submit_at("young", 0, &[task_of("work", "young", &[], 99)]).await;
    world.submit_at("urgent", 1, &[task("urgent", &[])]).await;
    let wanted = ["urgent", "dear", "young", &by_key[0].label, &by_key[1].label];
    assert_eq!(world.claim_labels("w", 10).await, wanted);
}

pub async fn task_is_claimed_right_after_the_costlier_one_that_it_waited_for(world: World) {
    let pair = |cost: u64| {
        let dear = task_of("work", &format!("dear {cost}"), &[], cost);
        let after = task_of("work", &format!("after {cost}"), &[&dear], 1);
        [after, dear]
    };
    let mut plan: Vec<TaskSpec> = [7, 9, 8].into_iter().flat_map(pair).collect();
    plan.push(task_of("work", "large", &[&plan[1]], 20));
    let order = async |count: usize| {
        let mut labels = Vec::new();
        for _ in 0..count {
            let lease = world.claim_one("w").await;
            world.commit(&lease).await;
            labels.push(lease.task.label);
        }
        labels
    };
    world.submit("first", &plan).await;
    let wanted = ["dear 9", "after 9", "dear 8", "after 8", "dear 7"];
    assert_eq!(order(5).await, wanted);
    // A worker that gives it back, and a bake that finds the dear one done, find the same order.
    let held = world.claim("w", 10).await;
    assert_eq!(held.iter().map(|lease| lease.task.label.as_str()).collect::<Vec<_>>(), ["large", "after 7"]);
    for lease in held {
        world.store.release(&lease.token).await.unwrap();
    }
    world.submit("second", &[plan.clone(), vec![task_of("work", "between", &[], 7)]].concat()).await;
    world
        .store
        .cancel(&world.store.list(&BakeFilter::default(), None, 2).await.unwrap().bakes[1].id)
        .await
        .unwrap();
    assert_eq!(order(3).await, ["large", "after 7", "between"]);
}

pub async fn changed_priority_changes_the_order(world: World) {
    world.submit("first", &[task("first", &[])]).await;
    let second = world.submit("second", &[task("second", &[])]).await;
    assert_eq!(world.store.reprioritise(&second.id, 1).await.unwrap().priority, 1);
    assert_eq!(world.claim_labels("w", 10).await, ["second", "first"]);
}

pub async fn unknown_bake_is_an_error(world: World) {
    let is_unknown = |outcome: Result<_, _>| matches!(outcome, Err(StoreError::NoSuchBake { .. }));
    assert!(is_unknown(world.store.show("none").await.map(drop)));
    assert!(is_unknown(world.store.cancel("none").await.map(drop)));
    assert!(is_unknown(world.store.pause("none").await.map(drop)));
    assert!(is_unknown(world.store.events_after("none", 0, 1).await.map(drop)));
}
