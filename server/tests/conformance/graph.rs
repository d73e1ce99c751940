//! Dependencies and plans.

use std::slice::from_ref;

use lightkiln_proto::api::{BakeFilter, BakeState, CommitVerdict};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{TaskInput, TaskResult, TaskSpec};
use lightkiln_server::store::{PlanError, StoreError};

use crate::support::{SCENE, World, output, outputs, result, submission, task, task_of};

pub async fn dependants_start_only_after_commit(world: World) {
    let a = task("a", &[]);
    let b = task("b", &[]);
    let both = task("both", &[&a, &b]);
    // Order in the plan is free.
    let bake = world.submit("bake", &[both, a, b]).await;
    let leases = world.claim("w", 10).await;
    assert_eq!(leases.len(), 2);
    assert_eq!(world.commit(&leases[0]).await, CommitVerdict::Committed);
    assert!(world.claim("w", 10).await.is_empty());
    assert_eq!(world.commit(&leases[1]).await, CommitVerdict::Committed);
    assert_eq!(world.claim_labels("w", 10).await, ["both"]);
    assert_eq!(world.state(&bake).await, BakeState::Running);
}

pub async fn lease_carries_the_outputs_of_dependencies(world: World) {
    let (a, b) = (task("a", &[]), task("b", &[]));
    let mut both = task("both", &[&b, &a]);
    let scene = TaskInput::Artefact { name: "scene".into(), digest: Digest::of(SCENE) };
    both.inputs.insert(1, scene);
    both.key = both.computed_key();
    let bake = world.submit("bake", &[a.clone(), b.clone(), both.clone()]).await;
    for lease in world.claim("w", 2).await {
        world.commit(&lease).await;
    }
    let lease = world.claim_one("w").await;
    assert_eq!((lease.bake, lease.task), (bake.id, both));
    let inputs: Vec<_> = lease.inputs.iter().map(|input| (input.name.as_str(), input.digest)).collect();
    let out = |key| outputs(key)[0].digest;
    assert_eq!(inputs, [("in0/out", out(b.key)), ("scene", Digest::of(SCENE)), ("in1/out", out(a.key))]);
    assert_eq!(lease.inputs[0].bytes, 32);
}

pub async fn plan_of_a_result_is_added_once(world: World) {
    let bake = world.submit("bake", &[task("plan", &[]), task("known", &[])]).await;
    let leases = world.claim("w", 10).await;
    let plan = [task("known", &[]), task("new", &[]), task("new", &[])];
    let planner = leases.iter().find(|lease| lease.task.label == "plan").unwrap();
    assert_eq!(world.commit_plan(planner, &plan).await, CommitVerdict::Committed);
    assert_eq!(world.commit_plan(planner, &plan).await, CommitVerdict::AlreadyCommitted);
    assert_eq!(world.show(&bake).await.stages[0].total, 3);
    assert_eq!(world.claim_labels("w", 10).await, ["new"]);
}

pub async fn plan_may_depend_on_its_own_planner(world: World) {
    let planner = task("plan", &[]);
    world.submit("bake", from_ref(&planner)).await;
    let lease = world.claim_one("w").await;
    let first = task("first", &[&planner]);
    let second = task("second", &[&first, &planner]);
    world.commit_plan(&lease, &[second, first]).await;
    assert_eq!(world.claim_labels("w", 10).await, ["first"]);
}

pub async fn plan_with_an_unknown_dependency_changes_nothing(world: World) {
    let stranger = task("stranger", &[]);
    let orphan = task("orphan", &[&stranger]);
    let error = world.store.submit(&submission("bad", from_ref(&orphan))).await.unwrap_err();
    let wanted = PlanError::UnknownDependency { needs: stranger.key };
    assert!(matches!(&error, StoreError::Plan(found) if *found == wanted), "{error}");
    assert!(world.store.list(&BakeFilter::default(), None, 10).await.unwrap().bakes.is_empty());

    let bake = world.submit("bake", &[task("plan", &[])]).await;
    let lease = world.claim_one("w").await;
    let before = world.show(&bake).await;
    let refused = world.store.commit(&lease.token, &result(&lease, &[task("fine", &[]), orphan])).await;
    assert!(matches!(refused, Err(StoreError::Plan(_))));
    assert_eq!(world.show(&bake).await, before);
    assert!(world.claim("w", 10).await.is_empty());
    // The lease is still good for a better result.
    assert_eq!(world.commit(&lease).await, CommitVerdict::Committed);
}

pub async fn plan_with_a_cycle_changes_nothing(world: World) {
    let (mut a, mut b) = (task("a", &[]), task("b", &[]));
    a.inputs = vec![TaskInput::Task { name: "in".into(), key: b.key }];
    b.inputs = vec![TaskInput::Task { name: "in".into(), key: a.key }];
    let refused = world.store.submit(&submission("bad", &[a, b])).await;
    assert!(matches!(refused, Err(StoreError::Plan(PlanError::WrongKey { .. }))));
}

pub async fn one_key_for_two_tasks_is_refused(world: World) {
    world.submit("bake", &[task("a", &[])]).await;
    let mut forged = task("b", &[]);
    forged.key = task("a", &[]).key;
    let refused = world.store.submit(&submission("forged", &[forged])).await;
    assert!(matches!(refused, Err(StoreError::Plan(PlanError::WrongKey { .. }))));
}

/// A worker that plans something else under the key of another scene's import keeps nobody from baking that scene.
pub async fn plan_cannot_take_the_key_of_a_task_that_is_not_there_yet(world: World) {
    let planner = task("planner", &[]);
    let bake = world.submit("hostile", from_ref(&planner)).await;
    let lease = world.claim_one("w").await;
    let import = task("import of another scene", &[]);
    let forgeries: [fn(&mut TaskSpec); 4] = [
        |task| task.kind = "more".into(),
        |task| task.params = serde_json::json!({ "name": "nothing" }),
        |task| task.inputs.push(TaskInput::Artefact { name: "in".into(), digest: output(0) }),
        |task| task.version += 1,
    ];
    for forge in forgeries {
        let mut forged = import.clone();
        forge(&mut forged);
        let result = TaskResult { plan: vec![forged], ..TaskResult::default() };
        let refused = world.store.commit(&lease.token, &result).await;
        assert!(matches!(refused, Err(StoreError::Plan(PlanError::WrongKey { .. }))), "{refused:?}");
    }
    // The holder keeps its lease, and the other scene is baked.
    assert_eq!(world.commit(&lease).await, CommitVerdict::Committed);
    assert_eq!(world.state(&bake).await, BakeState::Done);
    let other = world.submit("other", from_ref(&import)).await;
    assert_eq!(world.drain("w").await, 1);
    assert_eq!(world.state(&other).await, BakeState::Done);
}

pub async fn bake_is_done_when_all_tasks_are(world: World) {
    let a = task("a", &[]);
    let bake = world.submit("bake", &[a.clone(), task("b", &[&a])]).await;
    assert_eq!(world.drain("w").await, 2);
    let bake = world.show(&bake).await;
    assert_eq!((bake.state, bake.tasks_run, bake.tasks_reused), (BakeState::Done, 2, 0));
    assert_eq!(bake.finished_ms, Some(1_000_000));
}

pub async fn bake_without_tasks_is_done_at_once(world: World) {
    assert_eq!(world.submit("bake", &[]).await.state, BakeState::Done);
}

pub async fn thousand_tasks_behind_one_are_unlocked_together(world: World) {
    let first = task("first", &[]);
    let rest: Vec<_> = (0..1000).map(|i| task_of("more", &format!("{i}"), &[&first], i)).collect();
    let last = task("last", &rest.iter().collect::<Vec<_>>());
    let bake = world.submit("bake", &[first]).await;
    let lease = world.claim_one("w").await;
    let plan: Vec<_> = rest.into_iter().chain([last]).collect();
    assert_eq!(world.commit_plan(&lease, &plan).await, CommitVerdict::Committed);
    assert_eq!(world.drain("w").await, 1001);
    assert_eq!(world.state(&bake).await, BakeState::Done);
}
