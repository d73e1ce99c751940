//! Tasks that several bakes want, and results that are there already.

use std::slice::from_ref;

use lightkiln_proto::api::{BakeState, CommitVerdict, EventKind};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{Artefact, MAX_ALIKE, TaskResult};

use crate::support::{World, outputs, result, task};

pub async fn done_task_is_not_run_again_and_its_plan_is_followed(world: World) {
    let planner = task("plan", &[]);
    let planned = task("planned", &[&planner]);
    world.submit("first", from_ref(&planner)).await;
    let lease = world.claim_one("w").await;
    world.commit_plan(&lease, from_ref(&planned)).await;
    // The planner is done, its planned tasks are not.
    let second = world.submit("second", &[planner.clone(), task("own", &[&planned])]).await;
    assert_eq!((second.tasks_reused, second.stages[0].total), (1, 3));
    assert_eq!(world.drain("w").await, 2);
    let second = world.show(&second).await;
    assert_eq!((second.state, second.tasks_run, second.tasks_reused), (BakeState::Done, 2, 1));
    assert_eq!(second.counters["rays"], 20.0);
    assert_eq!(second.counters_reused["rays"], 10.0);
}

pub async fn bake_of_done_tasks_is_done_at_once(world: World) {
    let a = task("a", &[]);
    let plan = [a.clone(), task("b", &[&a])];
    world.submit("first", &plan).await;
    world.drain("w").await;
    let second = world.submit("second", &plan).await;
    assert_eq!((second.state, second.tasks_run, second.tasks_reused), (BakeState::Done, 0, 2));
    let events: Vec<_> = world.events(&second).await.into_iter().map(|event| event.event).collect();
    let wanted = [
        EventKind::Submitted,
        EventKind::Planned { tasks: 2, reused: 2 },
        EventKind::State { state: BakeState::Done },
    ];
    assert_eq!(events, wanted);
}

pub async fn two_bakes_share_one_run(world: World) {
    let shared = task("shared", &[]);
    let bakes = [
        world.submit("first", &[shared.clone(), task("after", &[&shared])]).await,
        world.submit("second", from_ref(&shared)).await,
    ];
    let leases = world.claim("w", 10).await;
    assert_eq!(leases.len(), 1);
    assert_eq!(leases[0].bake, bakes[0].id);
    world.commit_plan(&leases[0], &[task("planned", &[])]).await;
    assert_eq!(world.drain("w").await, 2);
    for bake in &bakes {
        let bake = world.show(bake).await;
        assert_eq!((bake.state, bake.tasks_reused), (BakeState::Done, 0));
    }
}

pub async fn bake_that_joins_late_sees_the_lease(world: World) {
    let shared = task("shared", &[]);
    world.submit("first", from_ref(&shared)).await;
    let lease = world.claim_one("w").await;
    let second = world.submit("second", &[shared]).await;
    assert_eq!((second.stages[0].leased, second.stages[0].reused), (1, 0));
    world.clock.advance_ms(7);
    assert_eq!(world.commit(&lease).await, CommitVerdict::Committed);
    let second = world.show(&second).await;
    assert_eq!((second.state, second.stages[0].elapsed_ms), (BakeState::Done, 7));
}

pub async fn forgotten_result_is_run_again(world: World) {
    let a = task("a", &[]);
    let b = task("b", &[&a]);
    world.submit("first", &[a.clone(), b.clone()]).await;
    world.drain("w").await;
    world.store.forget(&[a.key]).await.unwrap();
    let second = world.submit("second", &[a.clone(), b.clone()]).await;
    assert_eq!((second.state, second.tasks_reused), (BakeState::Running, 1));
    // The other result is lost too, while the bake is live: it waits for the first.
    world.store.forget(&[b.key]).await.unwrap();
    assert_eq!(world.show(&second).await.tasks_reused, 0);
    assert_eq!(world.claim_labels("w", 10).await, ["a"]);
    world.expire_leases().await;
    assert_eq!(world.drain("w").await, 2);
    assert_eq!(world.state(&second).await, BakeState::Done);
}

pub async fn forgotten_result_makes_dependants_wait(world: World) {
    let a = task("a", &[]);
    let bake = world.submit("bake", &[a.clone(), task("b", &[&a]), task("c", &[&a])]).await;
    let lease = world.claim_one("w").await;
    world.commit(&lease).await;
    let held = world.claim_one("w").await;
    world.store.forget(&[a.key, a.key]).await.unwrap();
    let stage = world.show(&bake).await.stages.remove(0);
    assert_eq!((stage.done, stage.total, stage.leased), (0, 3, 1));
    // An attempt under way has its inputs and may end well.
    assert_eq!(world.commit(&held).await, CommitVerdict::Committed);
    assert_eq!(world.claim_labels("w", 10).await, ["a"]);
    world.expire_leases().await;
    assert_eq!(world.drain("w").await, 2);
    assert_eq!(world.state(&bake).await, BakeState::Done);
}

pub async fn reusable_follows_plans(world: World) {
    let planner = task("plan", &[]);
    let planned = task("planned", &[]);
    world.submit("first", from_ref(&planner)).await;
    let lease = world.claim_one("w").await;
    world.commit_plan(&lease, &[planned.clone(), task("open", &[])]).await;
    let lease = world.claim("w", 2).await;
    for lease in lease.iter().filter(|lease| lease.task.key == planned.key) {
        world.commit(lease).await;
    }
    let plan = [task("unknown", &[]), planner.clone(), planner.clone()];
    let known = world.store.reusable(&plan).await.unwrap();
    let keys: Vec<_> = known.iter().map(|result| result.key).collect();
    assert_eq!(keys, [planner.key, planned.key]);
    assert_eq!(known[1].outputs, outputs(planned.key));
}

pub async fn lease_tells_of_the_newest_results_of_tasks_that_have_its_name_in_common(world: World) {
    let name = Digest::of(b"a cell");
    let named = |label: &str| task(label, &[]).alike(name);
    let mut known: Vec<Vec<Artefact>> = Vec::new();
    for number in 0..MAX_ALIKE + 2 {
        let spec = named(&format!("named {number}"));
        world.submit(&format!("bake {number}"), from_ref(&spec)).await;
        let lease = world.claim_one("w").await;
        let newest: Vec<_> = known.iter().rev().take(MAX_ALIKE).cloned().collect();
        assert_eq!(lease.alike, newest);
        world.commit_plan(&lease, &[]).await;
        known.push(outputs(spec.key));
    }
    // Tasks under way have no results, others have nothing in common.
    let plan =
        [named("under way"), task("unnamed", &[]), task("other", &[]).alike(Digest::of(b"another cell"))];
    world.submit("last", &plan).await;
    for lease in world.claim("w", 3).await {
        let wanted = if lease.task.alike == Some(name) { MAX_ALIKE } else { 0 };
        assert_eq!(lease.alike.len(), wanted, "{}", lease.task.label);
    }
}

pub async fn note_of_a_result_is_told_by_the_event_of_its_end(world: World) {
    let bake = world.submit("noted", from_ref(&task("noted", &[]))).await;
    let lease = world.claim_one("w").await;
    let result = TaskResult { note: "as before".into(), ..result(&lease, &[]) };
    assert_eq!(world.store.commit(&lease.token, &result).await.unwrap(), CommitVerdict::Committed);
    let is_told =
        |event: &EventKind| matches!(event, EventKind::TaskDone { note, .. } if note == "as before");
    assert!(world.events(&bake).await.iter().any(|event| is_told(&event.event)));
}
