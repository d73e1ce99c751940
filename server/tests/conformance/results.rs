//! Results of a bake in the order in which they landed.

use lightkiln_proto::api::{Bake, BakeResult, BakeState, CommitVerdict, Lease};
use lightkiln_proto::jobs::{Artefact, TaskResult, TaskSpec};
use lightkiln_server::store::StoreError;
use lightkiln_server::store::rules::RESULTS_PAGE_BYTES;

use crate::support::{World, output, outputs, task, task_of};

/// Results of a bake behind a place.
async fn after(world: &World, bake: &Bake, after: u64) -> Vec<BakeResult> {
    world.store.results_after(&bake.id, None, after, 100).await.unwrap().results
}

fn told(results: &[BakeResult]) -> Vec<(u64, &str)> {
    results.iter().map(|result| (result.place, result.label.as_str())).collect()
}

/// Claims the tasks that are ready, and commits those of these labels in that order.
async fn land(world: &World, labels: &[&str]) {
    let leases = world.claim("w", 16).await;
    for label in labels {
        let lease = leases.iter().find(|lease| lease.task.label == *label).expect("it is ready");
        assert_eq!(world.commit(lease).await, CommitVerdict::Committed);
    }
    for lease in leases.iter().filter(|lease| !labels.contains(&lease.task.label.as_str())) {
        world.store.release(&lease.token).await.unwrap();
    }
}

pub async fn results_come_in_the_order_in_which_they_landed(world: World) {
    let [a, b, c] = ["a", "b", "c"].map(|name| task(name, &[]));
    let bake = world.submit("bake", &[a.clone(), b, c.clone(), task("last", &[&c])]).await;
    let page = world.store.results_after(&bake.id, None, 0, 10).await.unwrap();
    assert_eq!((page.results.len(), page.bake.state), (0, BakeState::Running));
    land(&world, &["c", "a"]).await;
    let landed = after(&world, &bake, 0).await;
    assert_eq!(told(&landed), [(1, "c"), (2, "a")]);
    let first =
        BakeResult { place: 1, key: c.key, kind: "work".into(), label: "c".into(), outputs: outputs(c.key) };
    assert_eq!(landed[0], first);
    assert_eq!(told(&after(&world, &bake, 1).await), [(2, "a")]);
    land(&world, &["last", "b"]).await;
    assert_eq!(told(&after(&world, &bake, 2).await), [(3, "last"), (4, "b")]);
    let page = world.store.results_after(&bake.id, None, 1, 2).await.unwrap();
    assert_eq!((told(&page.results), page.bake.state), (vec![(2, "a"), (3, "last")], BakeState::Done));
    for beyond in [4, 5, u64::MAX] {
        assert_eq!(after(&world, &bake, beyond).await, []);
    }
    let unknown = world.store.results_after("none", None, 0, 10).await.unwrap_err();
    assert!(matches!(unknown, StoreError::NoSuchBake { .. }), "{unknown:?}");
}

pub async fn results_of_one_kind_are_told_alone(world: World) {
    let plan = ["work", "more", "work", "more"];
    let plan: Vec<TaskSpec> =
        plan.iter().zip(["a", "b", "c", "d"]).map(|(kind, name)| task_of(kind, name, &[], 1)).collect();
    let bake = world.submit("bake", &plan).await;
    land(&world, &["d", "c", "b", "a"]).await;
    let of_kind = async |kind, after| {
        let page = world.store.results_after(&bake.id, Some(kind), after, 10).await.unwrap();
        page.results.iter().map(|result| (result.place, result.label.clone())).collect::<Vec<_>>()
    };
    assert_eq!(of_kind("more", 0).await, [(1, "d".to_owned()), (3, "b".to_owned())]);
    assert_eq!(of_kind("work", 2).await, [(4, "a".to_owned())]);
    assert_eq!(of_kind("other", 0).await, []);
}

/// A page tells where the next begins, past all that it left out: whoever polls in vain looks at no place twice.
pub async fn page_of_results_tells_where_the_next_begins(world: World) {
    let plan: Vec<TaskSpec> = ["a", "b", "c", "d"]
        .iter()
        .map(|name| task_of(["work", "more"][usize::from(*name == "b")], name, &[], 1))
        .collect();
    let bake = world.submit("bake", &plan).await;
    let next = async |kind, after, limit| {
        let page = world.store.results_after(&bake.id, kind, after, limit).await.unwrap();
        (page.results.len(), page.next_after)
    };
    assert_eq!(next(None, 0, 10).await, (0, 0));
    land(&world, &["a", "b", "c"]).await;
    assert_eq!(next(Some("other"), 0, 10).await, (0, 3), "nothing of the kind is up to there");
    assert_eq!(next(Some("more"), 0, 10).await, (1, 3));
    assert_eq!(next(Some("more"), 0, 1).await, (1, 2), "a full page ends at its last result");
    assert_eq!(next(None, 1, 10).await, (2, 3));
    assert_eq!(next(None, 7, 10).await, (0, 7), "it never goes back");
    world.store.forget(&[plan[2].key]).await.unwrap();
    assert_eq!(next(None, 0, 10).await, (2, 3));
    land(&world, &["c"]).await;
    assert_eq!(next(None, 3, 10).await, (1, 4), "what lands again is behind it");
}

/// Commits with outputs whose JSON has at least so many bytes; their names have letters of two bytes.
async fn commit_long(world: &World, lease: &Lease, bytes: u64) {
    let name = "ä".repeat(1000);
    let count = bytes.div_ceil(2 * 1000) as usize;
    let output = |number| Artefact { name: format!("{name}{number}"), digest: output(0), bytes: 32 };
    let result = TaskResult { outputs: (0..count).map(output).collect(), ..TaskResult::default() };
    world.store.commit(&lease.token, &result).await.unwrap();
}

pub async fn page_of_results_ends_where_it_is_full(world: World) {
    let plan = ["a", "b", "c", "d"].map(|name| task(name, &[]));
    let bake = world.submit("bake", &plan).await;
    let leases = world.claim("w", 16).await;
    for (lease, bytes) in leases.iter().zip([200, RESULTS_PAGE_BYTES, 200, 200]) {
        commit_long(&world, lease, bytes).await;
    }
    let places = async |after_place| {
        after(&world, &bake, after_place).await.iter().map(|result| result.place).collect::<Vec<_>>()
    };
    assert_eq!(places(0).await, [1, 2]);
    assert_eq!(places(1).await, [2]);
    assert_eq!(places(2).await, [3, 4]);
}

pub async fn reused_results_land_with_the_plan_that_asks_for_them(world: World) {
    let planner = task("plan", &[]);
    let planned = ["x", "y"].map(|name| task(name, &[]));
    let [own, second] = ["own", "second"].map(|name| task(name, &[]));
    world.submit("first", &[planner.clone(), second.clone()]).await;
    let leases = world.claim("w", 2).await;
    for lease in &leases {
        let plan = if lease.task.key == planner.key { &planned[..] } else { &[] };
        world.commit_plan(lease, plan).await;
    }
    land(&world, &["y"]).await;
    // Its own task comes first, as the plan behind it is added once that has been done.
    let bake = world.submit("bake", &[own]).await;
    let lease = world.claim("w", 2).await.into_iter().find(|lease| lease.task.label == "own").unwrap();
    world.commit_plan(&lease, &[second, planner]).await;
    let landed = after(&world, &bake, 0).await;
    assert_eq!(told(&landed), [(1, "own"), (2, "second"), (3, "plan"), (4, "y")]);
    world.expire_leases().await;
    land(&world, &["x"]).await;
    assert_eq!(told(&after(&world, &bake, 4).await), [(5, "x")]);
    assert_eq!(world.state(&bake).await, BakeState::Done);
}

/// Whoever has read to a place finds behind it all that landed since, also where the last result was lost.
pub async fn result_that_lands_again_comes_behind_all_others(world: World) {
    let plan = ["a", "b", "c"].map(|name| task(name, &[]));
    let bake = world.submit("bake", &plan).await;
    land(&world, &["a", "b"]).await;
    world.store.forget(&[plan[1].key]).await.unwrap();
    assert_eq!(told(&after(&world, &bake, 0).await), [(1, "a")]);
    land(&world, &["c"]).await;
    assert_eq!(told(&after(&world, &bake, 2).await), [(3, "c")]);
    land(&world, &["b"]).await;
    assert_eq!(told(&after(&world, &bake, 3).await), [(4, "b")]);
    assert_eq!(told(&after(&world, &bake, 0).await), [(1, "a"), (3, "c"), (4, "b")]);
}

pub async fn result_that_an_ended_bake_lost_lands_again(world: World) {
    let plan = ["a", "b"].map(|name| task(name, &[]));
    let ended = world.submit("ended", &plan).await;
    land(&world, &["b", "a"]).await;
    world.store.forget(&[plan[0].key]).await.unwrap();
    assert_eq!(told(&after(&world, &ended, 0).await), [(1, "b")]);
    let again = world.submit("again", &plan).await;
    assert_eq!(told(&after(&world, &again, 0).await), [(1, "b")]);
    land(&world, &["a"]).await;
    for bake in [&again, &ended] {
        let place = if bake.id == ended.id { 3 } else { 2 };
        assert_eq!(told(&after(&world, bake, 0).await), [(1, "b"), (place, "a")]);
    }
}
