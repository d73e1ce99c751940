//! Results that are made once more on another machine: chosen by the key, given where there is nothing else to do, and compared.

use std::slice::from_ref;
use std::sync::Arc;

use lightkiln_proto::api::{
    Bake, BakeState, Blame, ClaimRequest, CommitVerdict, EventKind, Lease, Needs, Verdict,
};
use lightkiln_proto::jobs::{Artefact, TaskInput, TaskResult, TaskSpec};
use lightkiln_server::store::verify::{RERUN_LAPSES_MS, RERUN_TRIES, is_chosen};
use lightkiln_server::store::{FailVerdict, FarmStore, Maker};

use crate::clock::ManualClock;
use crate::crash::open_file;
use crate::support::{TTL_MS, World, chunk, output, outputs, request, result, submission, task};

/// A claim by a worker that is named after its machine: `oven 2` is on `oven`.
fn on(worker: &str) -> ClaimRequest {
    let machine = worker.split(' ').next().unwrap_or_default().to_owned();
    ClaimRequest { machine, ..request(worker, 4) }
}

async fn submit(world: &World, name: &str, share: f64, plan: &[TaskSpec]) -> Bake {
    let mut submission = submission(name, plan);
    submission.bake.verify_share = share;
    let bake = world.store.submit(&submission).await.unwrap().bake;
    assert_eq!(bake.verify_share.to_bits(), share.to_bits());
    bake
}

async fn claim(world: &World, worker: &str) -> Vec<Lease> {
    world.store.claim(&on(worker)).await.unwrap()
}

/// Claims until there is no task left that is not done, and commits each.
async fn work(world: &World, worker: &str) {
    loop {
        let leases = claim(world, worker).await;
        if leases.is_empty() {
            return;
        }
        for lease in leases {
            assert_eq!(world.commit(&lease).await, CommitVerdict::Committed);
        }
    }
}

/// The one rerun that a worker is given.
async fn rerun(world: &World, worker: &str) -> Lease {
    let mut leases = claim(world, worker).await;
    assert_eq!(leases.len(), 1, "one at a time");
    leases.pop().unwrap()
}

async fn is_given_none(world: &World, worker: &str) {
    assert_eq!(claim(world, worker).await, []);
}

/// Results that were verified, that wait, and that lapsed.
async fn counts(world: &World) -> [u64; 3] {
    let stats = world.store.stats().await.unwrap();
    [stats.verified, stats.reruns_waiting, stats.reruns_lapsed]
}

/// A bake of one task that is done, by a worker of the machine `oven`, and whose result is to be verified.
async fn baked(world: &World, name: &str) -> (Bake, TaskSpec) {
    let a = task(name, &[]);
    let bake = submit(world, name, 1.0, from_ref(&a)).await;
    work(world, "oven 1").await;
    assert_eq!(world.state(&bake).await, BakeState::Done, "its end waits for nobody");
    (world.show(&bake).await, a)
}

/// Outputs that are not the task's.
fn otherwise(lease: &Lease) -> TaskResult {
    let digest = (0..2).map(output).find(|other| *other != outputs(lease.task.key)[0].digest).unwrap();
    TaskResult { outputs: vec![Artefact { name: "out".into(), digest, bytes: 32 }], ..TaskResult::default() }
}

pub async fn result_is_made_once_more_on_another_machine(world: World) {
    let (bake, a) = baked(&world, "a").await;
    assert_eq!(counts(&world).await, [0, 1, 0]);
    for same in ["oven 1", "oven 2"] {
        is_given_none(&world, same).await;
    }
    let lease = rerun(&world, "hob 1").await;
    assert_eq!((&lease.task, &lease.bake, lease.alike.len()), (&a, &bake.id, 0));
    is_given_none(&world, "pot 1").await;
    let workers = world.store.workers().await.unwrap();
    assert!(workers.iter().any(|worker| worker.name == "hob 1" && worker.holds == ["a"]));
    assert_eq!(world.store.heartbeat(&lease.token, 0.5).await.unwrap().verdict, Verdict::Keep);
    assert_eq!(world.commit(&lease).await, CommitVerdict::Committed);
    assert_eq!(counts(&world).await, [1, 0, 0]);
    assert_eq!((world.show(&bake).await, world.store.stats().await.unwrap().alarms), (bake, 0));
    is_given_none(&world, "pot 1").await;
    assert_eq!(world.commit(&lease).await, CommitVerdict::Stale, "it is over");
}

pub async fn worker_without_a_machine_verifies_what_another_worker_gave(world: World) {
    let a = task("a", &[]);
    submit(&world, "bake", 1.0, from_ref(&a)).await;
    assert_eq!(world.commit(&world.claim_one("w").await).await, CommitVerdict::Committed);
    assert_eq!(world.claim("w", 1).await, []);
    assert_eq!(world.commit(&world.claim_one("v").await).await, CommitVerdict::Committed);
    assert_eq!(counts(&world).await, [1, 0, 0]);
}

pub async fn result_that_comes_out_otherwise_is_one_alarm_and_the_first_stays(world: World) {
    let (bake, a) = baked(&world, "a").await;
    let lease = rerun(&world, "hob 1").await;
    for verdict in [CommitVerdict::Committed, CommitVerdict::Stale] {
        assert_eq!(world.store.commit(&lease.token, &otherwise(&lease)).await.unwrap(), verdict);
    }
    let shown = world.show(&bake).await;
    assert_eq!((shown.alarms, shown.state), (1, BakeState::Done));
    assert_eq!((shown.tasks_run, shown.attempts_failed, shown.attempts_lost), (1, 0, 0));
    assert_eq!((counts(&world).await, world.store.stats().await.unwrap().alarms), ([1, 0, 0], 1));
    let results = world.store.results_after(&bake.id, None, 0, 10).await.unwrap().results;
    assert_eq!(results[0].outputs, outputs(a.key));
    let events = world.events(&bake).await;
    let told = events.iter().filter_map(|event| match &event.event {
        EventKind::ResultDiffers { worker, .. } => Some(worker.as_str()),
        _ => None,
    });
    assert_eq!(told.collect::<Vec<_>>(), ["hob 1"]);
    // Who asks for it next reuses the first one.
    assert_eq!(world.submit("again", from_ref(&a)).await.tasks_reused, 1);
    assert_eq!(counts(&world).await, [1, 0, 0], "a result that is reused is not verified again");
}

pub async fn tasks_that_are_ready_come_before_results_to_verify(world: World) {
    baked(&world, "first").await;
    let urgent = submit(&world, "second", 0.0, &[task("b", &[]), task("c", &[])]).await;
    let leases = claim(&world, "hob 1").await;
    let labels: Vec<&str> = leases.iter().map(|lease| lease.task.label.as_str()).collect();
    assert!(labels.len() == 2 && !labels.contains(&"first"), "{labels:?}");
    assert!(leases.iter().all(|lease| lease.bake == urgent.id));
    assert_eq!(rerun(&world, "hob 1").await.task.label, "first");
}

pub async fn share_chooses_by_the_key_alone(world: World) {
    const SHARE: f64 = 0.5;
    let plan: Vec<TaskSpec> = (0..40).map(|number| task(&format!("task {number}"), &[])).collect();
    let none = submit(&world, "none", 0.0, &plan[..4]).await;
    work(&world, "oven 1").await;
    assert_eq!((world.state(&none).await, counts(&world).await), (BakeState::Done, [0, 0, 0]));
    submit(&world, "half", SHARE, &plan[4..]).await;
    work(&world, "oven 1").await;
    let mut made = Vec::new();
    loop {
        let leases = claim(&world, "hob 1").await;
        let Some(lease) = leases.first() else { break };
        made.push(lease.task.key);
        assert_eq!(world.commit(lease).await, CommitVerdict::Committed);
    }
    made.sort_unstable();
    let mut chosen: Vec<_> =
        plan[4..].iter().map(|task| task.key).filter(|key| is_chosen(*key, SHARE)).collect();
    chosen.sort_unstable();
    assert!(chosen.len() > 5 && chosen.len() < 31, "{}", chosen.len());
    assert_eq!(made, chosen);
}

pub async fn biggest_share_of_the_bakes_that_want_a_task_counts(world: World) {
    let a = task("a", &[]);
    submit(&world, "none", 0.0, from_ref(&a)).await;
    let all = submit(&world, "all", 1.0, from_ref(&a)).await;
    work(&world, "oven 1").await;
    assert_eq!(rerun(&world, "hob 1").await.bake, all.id);
}

pub async fn result_is_verified_by_a_worker_that_can_do_its_task(world: World) {
    let mut submission = submission("bake", &[task("a", &[])]);
    submission.bake.verify_share = 1.0;
    submission.bake.needs = Needs { threads: 2, labels: vec!["gpu".into()], ..Needs::default() };
    world.store.submit(&submission).await.unwrap();
    let able = |worker: &str| ClaimRequest { labels: vec!["gpu".into()], ..on(worker) };
    let lease = world.store.claim(&able("oven 1")).await.unwrap().pop().unwrap();
    assert_eq!(world.commit(&lease).await, CommitVerdict::Committed);
    let others = [
        on("hob 1"),
        ClaimRequest { threads: 1, ..able("hob 1") },
        ClaimRequest { kinds: vec!["more".into()], ..able("hob 1") },
    ];
    for other in others {
        assert_eq!(world.store.claim(&other).await.unwrap(), [], "{other:?}");
    }
    let openings = world.store.look(&[], 100).await.unwrap().openings;
    assert_eq!(openings.len(), 1);
    assert_eq!(
        (openings[0].kind.as_str(), &openings[0].needs, openings[0].ready),
        ("work", &submission.bake.needs, 1)
    );
    let maker = Maker { worker: "oven 1".into(), machine: "oven".into() };
    assert_eq!(openings[0].maker, Some(maker));
    assert_eq!(world.store.claim(&able("hob 1")).await.unwrap().len(), 1);
    assert_eq!(world.store.look(&[], 100).await.unwrap().openings, []);
}

pub async fn look_tells_of_results_by_who_may_verify_them(world: World) {
    let plan: Vec<TaskSpec> = (0..7).map(|number| task(&format!("task {number}"), &[])).collect();
    submit(&world, "bake", 1.0, &plan).await;
    for (worker, count) in [("oven 1", 3), ("hob 1", 4)] {
        let leases = world.store.claim(&ClaimRequest { max: count, ..on(worker) }).await.unwrap();
        for lease in leases {
            assert_eq!(world.commit(&lease).await, CommitVerdict::Committed);
        }
    }
    let look = async |enough| {
        let openings = world.store.look(&[], enough).await.unwrap().openings;
        let told = openings.into_iter().map(|opening| (opening.maker.unwrap().worker, opening.ready));
        let mut told: Vec<_> = told.collect();
        told.sort();
        told
    };
    assert_eq!(look(100).await, [("hob 1".to_owned(), 4), ("oven 1".to_owned(), 3)]);
    let lease = rerun(&world, "hob 2").await;
    assert_eq!(look(100).await, [("hob 1".to_owned(), 4), ("oven 1".to_owned(), 2)]);
    world.store.release(&lease.token).await.unwrap();
    assert_eq!(look(100).await, [("hob 1".to_owned(), 4), ("oven 1".to_owned(), 3)]);
}

pub async fn result_that_nobody_verifies_in_time_lapses(world: World) {
    baked(&world, "a").await;
    world.clock.advance_ms(RERUN_LAPSES_MS - 1);
    world.store.reap().await.unwrap();
    assert_eq!(counts(&world).await, [0, 1, 0]);
    world.clock.advance_ms(1);
    is_given_none(&world, "hob 1").await;
    assert_eq!(world.store.look(&[], 100).await.unwrap().openings, []);
    world.store.reap().await.unwrap();
    assert_eq!(counts(&world).await, [0, 0, 1]);
    // Once it is under way it may end.
    baked(&world, "b").await;
    let lease = rerun(&world, "hob 1").await;
    for _ in 0..RERUN_LAPSES_MS / (TTL_MS / 2) + 2 {
        world.clock.advance_ms(TTL_MS / 2);
        assert_eq!(world.store.heartbeat(&lease.token, 0.5).await.unwrap().verdict, Verdict::Keep);
        world.store.reap().await.unwrap();
    }
    assert_eq!(world.commit(&lease).await, CommitVerdict::Committed);
    assert_eq!(counts(&world).await, [1, 0, 1]);
}

pub async fn wait_of_a_result_under_a_clock_that_was_set_back_is_no_longer(world: World) {
    baked(&world, "a").await;
    world.clock.advance_ms(-RERUN_LAPSES_MS);
    world.store.reap().await.unwrap();
    world.clock.advance_ms(RERUN_LAPSES_MS);
    world.store.reap().await.unwrap();
    assert_eq!(counts(&world).await, [0, 0, 1]);
}

pub async fn failed_and_vanished_attempts_to_verify_count_for_no_bake_and_lapse_at_the_last_try(
    world: World,
) {
    let (bake, _) = baked(&world, "a").await;
    for attempt in 1..=RERUN_TRIES {
        assert_eq!(counts(&world).await, [0, 1, 0], "attempt {attempt}");
        let lease = rerun(&world, "hob 1").await;
        if attempt == 2 {
            world.clock.advance_ms(TTL_MS);
            assert_eq!(world.commit(&lease).await, CommitVerdict::Stale);
            let reaped = world.store.reap().await.unwrap();
            assert_eq!((reaped.expired, reaped.lost, reaped.given_up), (1, 0, 0));
        } else {
            let verdict = world.store.fail(&lease.token, Blame::Task, "why").await.unwrap();
            assert_eq!(verdict, FailVerdict::Rerun);
        }
        assert_eq!(world.store.heartbeat(&lease.token, 0.5).await.unwrap().verdict, Verdict::Lost);
        assert_eq!(world.store.fail(&lease.token, Blame::Lost, "why").await.unwrap(), FailVerdict::Stale);
    }
    is_given_none(&world, "pot 1").await;
    assert_eq!((counts(&world).await, world.show(&bake).await), ([0, 0, 1], bake));
}

pub async fn vanished_attempt_to_verify_is_the_last_like_any_other(world: World) {
    baked(&world, "a").await;
    for _ in 1..=RERUN_TRIES {
        rerun(&world, "hob 1").await;
        world.clock.advance_ms(TTL_MS);
        assert_eq!(world.store.reap().await.unwrap().expired, 1);
    }
    assert_eq!(counts(&world).await, [0, 0, 1]);
}

pub async fn attempt_to_verify_that_is_given_back_is_no_try(world: World) {
    baked(&world, "a").await;
    for _ in 0..2 * RERUN_TRIES {
        let lease = rerun(&world, "hob 1").await;
        assert!(world.store.release(&lease.token).await.unwrap());
        assert!(!world.store.release(&lease.token).await.unwrap());
    }
    assert_eq!(counts(&world).await, [0, 1, 0]);
}

pub async fn attempts_to_verify_run_on_after_the_farm_could_not_hear_anybody(world: World) {
    baked(&world, "a").await;
    let lease = rerun(&world, "hob 1").await;
    world.clock.advance_ms(TTL_MS - 1);
    assert_eq!(world.store.extend_leases().await.unwrap(), 1);
    world.clock.advance_ms(TTL_MS - 1);
    assert_eq!(world.store.reap().await.unwrap().expired, 0);
    assert_eq!(world.commit(&lease).await, CommitVerdict::Committed);
}

/// One task reads the output of another, and a third names an artefact.
pub async fn result_whose_inputs_are_lost_is_not_verified(world: World) {
    let a = task("a", &[]);
    let mut names = task("names", &[]);
    let named = (0..4).map(output).find(|digest| *digest != outputs(a.key)[0].digest).unwrap();
    names.inputs = vec![TaskInput::Artefact { name: "in".into(), digest: named }];
    names.key = names.computed_key();
    let reads = task("reads", &[&a]);
    submit(&world, "inputs", 0.0, from_ref(&a)).await;
    work(&world, "oven 1").await;
    let bake = submit(&world, "bake", 1.0, &[a.clone(), reads, names]).await;
    work(&world, "oven 1").await;
    assert_eq!((world.state(&bake).await, counts(&world).await), (BakeState::Done, [0, 2, 0]));
    // While a worker has one, it fails there, and nobody is given it again.
    let held = rerun(&world, "hob 1").await;
    world.store.forget(&[a.key]).await.unwrap();
    for generation in [1, 2] {
        world.store.lose_chunk(chunk(named, generation).name).await.unwrap();
    }
    world.store.fail(&held.token, Blame::Worker, "an input is gone").await.unwrap();
    is_given_none(&world, "hob 1").await;
    assert_eq!((counts(&world).await, world.state(&bake).await), ([0, 0, 2], BakeState::Done));
}

pub async fn result_that_is_forgotten_or_deleted_is_not_verified(world: World) {
    let (first, a) = baked(&world, "a").await;
    let lease = rerun(&world, "hob 1").await;
    world.store.forget(&[a.key]).await.unwrap();
    assert_eq!(world.store.heartbeat(&lease.token, 0.5).await.unwrap().verdict, Verdict::Lost);
    assert_eq!(world.store.commit(&lease.token, &otherwise(&lease)).await.unwrap(), CommitVerdict::Stale);
    assert_eq!((counts(&world).await, world.show(&first).await.alarms), ([0, 0, 1], 0));
    // Made again, it is verified again.
    submit(&world, "again", 1.0, from_ref(&a)).await;
    work(&world, "oven 1").await;
    assert_eq!(counts(&world).await, [0, 1, 1]);
    let (second, _) = baked(&world, "b").await;
    world.store.delete_bake(&second.id).await.unwrap();
    assert_eq!(counts(&world).await, [0, 1, 2]);
}

pub async fn rerun_that_a_live_bake_lost_is_chosen_anew(world: World) {
    let a = task("a", &[]);
    let bake = submit(&world, "bake", 1.0, &[a.clone(), task("b", &[&a])]).await;
    let lease = claim(&world, "oven 1").await.pop().unwrap();
    world.commit(&lease).await;
    world.store.forget(&[a.key]).await.unwrap();
    assert_eq!(counts(&world).await, [0, 0, 1]);
    let lease = claim(&world, "oven 1").await.pop().unwrap();
    assert_eq!(lease.task.key, a.key);
    world.commit(&lease).await;
    assert_eq!((counts(&world).await, world.state(&bake).await), ([0, 1, 1], BakeState::Running));
}

pub async fn results_of_a_paused_or_cancelled_bake_are_not_verified(world: World) {
    let bake = submit(&world, "bake", 1.0, &[task("a", &[]), task("b", &[])]).await;
    let leases = claim(&world, "oven 1").await;
    world.commit(&leases[0]).await;
    world.store.pause(&bake.id).await.unwrap();
    is_given_none(&world, "hob 1").await;
    assert_eq!(world.store.look(&[], 100).await.unwrap().openings, []);
    world.store.resume(&bake.id).await.unwrap();
    let lease = rerun(&world, "hob 1").await;
    world.store.release(&lease.token).await.unwrap();
    world.store.cancel(&bake.id).await.unwrap();
    is_given_none(&world, "hob 1").await;
    assert_eq!(counts(&world).await, [0, 0, 1]);
}

pub async fn result_that_lands_while_its_bake_is_paused_waits_for_its_end(world: World) {
    let bake = submit(&world, "bake", 1.0, &[task("a", &[]), task("b", &[])]).await;
    let leases = claim(&world, "oven 1").await;
    world.store.pause(&bake.id).await.unwrap();
    world.store.commit(&leases[0].token, &result(&leases[0], &[])).await.unwrap();
    is_given_none(&world, "hob 1").await;
    world.store.resume(&bake.id).await.unwrap();
    rerun(&world, "hob 1").await;
}

pub async fn results_of_a_bake_that_is_done_while_it_is_paused_are_verified(world: World) {
    let bake = submit(&world, "bake", 1.0, &[task("a", &[]), task("b", &[])]).await;
    let leases = claim(&world, "oven 1").await;
    world.commit(&leases[0]).await;
    world.store.pause(&bake.id).await.unwrap();
    world.commit(&leases[1]).await;
    assert_eq!(world.state(&bake).await, BakeState::Done);
    for worker in ["hob 1", "hob 2"] {
        rerun(&world, worker).await;
    }
}

/// Claims of many workers at the same moment.
pub async fn concurrent_claims_make_each_result_once_more(world: World) {
    let plan: Vec<TaskSpec> = (0..12).map(|number| task(&format!("task {number}"), &[])).collect();
    submit(&world, "bake", 1.0, &plan).await;
    work(&world, "oven 1").await;
    let claims = (0..12).map(|number| {
        let (store, request) = (world.store.clone(), on(&format!("hob {number}")));
        tokio::spawn(async move { store.claim(&request).await.unwrap() })
    });
    let given = futures::future::join_all(claims).await.into_iter().flat_map(Result::unwrap);
    let mut keys: Vec<_> = given.map(|lease| lease.task.key).collect();
    let count = keys.len();
    keys.sort_unstable();
    keys.dedup();
    assert_eq!((keys.len(), count), (12, 12));
}

#[tokio::test]
async fn attempts_to_verify_of_a_process_that_has_ended_are_given_back() {
    let (folder, clock) = (tempfile::tempdir().unwrap(), Arc::new(ManualClock::at(0)));
    let store = open_file(folder.path(), &clock).await;
    let mut submission = submission("bake", &[task("a", &[])]);
    submission.bake.verify_share = 1.0;
    store.submit(&submission).await.unwrap();
    let lease = store.claim(&on("oven 1")).await.unwrap().remove(0);
    store.commit(&lease.token, &result(&lease, &[])).await.unwrap();
    assert_eq!(store.claim(&on("hob 1")).await.unwrap().len(), 1);
    assert_eq!(store.claim(&on("pot 1")).await.unwrap(), []);
    assert_eq!(store.release_all("hob 1").await.unwrap(), 1);
    assert_eq!(store.claim(&on("pot 1")).await.unwrap().len(), 1);
}
