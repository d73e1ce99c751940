//! Results of one task that differ: noted once, and told to every bake that holds the task; the one that counts stays.

use std::slice::from_ref;

use lightkiln_proto::api::{Bake, BakeState, CommitVerdict, EventKind, Lease};
use lightkiln_proto::jobs::{Artefact, TaskResult};
use lightkiln_server::store::rules::{MAX_ALARMS_TOLD, MAX_EXPIRED};

use crate::support::{TTL_MS, World, output, outputs, result, task};

/// A result of which the output is not that of the task.
fn otherwise(lease: &Lease) -> TaskResult {
    let digest = (0..2).map(output).find(|other| *other != outputs(lease.task.key)[0].digest).unwrap();
    TaskResult { outputs: vec![Artefact { name: "out".into(), digest, bytes: 32 }], ..TaskResult::default() }
}

/// Workers whose other results a bake was told of.
async fn told(world: &World, bake: &Bake) -> Vec<String> {
    let events = world.events(bake).await.into_iter();
    let told = events.filter_map(|event| match event.event {
        EventKind::ResultDiffers { worker, output, kept, found, .. } => {
            assert!(output == "out" && kept.is_some() && found.is_some() && kept != found);
            Some(worker)
        }
        _ => None,
    });
    told.collect()
}

async fn assert_alarms(world: &World, bake: &Bake, workers: &[&str]) {
    assert_eq!(told(world, bake).await, workers);
    assert_eq!(world.show(bake).await.alarms, workers.len() as u64);
}

pub async fn result_that_is_handed_in_again_with_other_outputs_is_an_alarm(world: World) {
    let a = task("a", &[]);
    let bakes = [world.submit("one", from_ref(&a)).await, world.submit("two", from_ref(&a)).await];
    let lease = world.claim_one("w").await;
    assert_eq!(world.commit(&lease).await, CommitVerdict::Committed);
    assert_eq!(world.commit(&lease).await, CommitVerdict::AlreadyCommitted);
    assert_alarms(&world, &bakes[0], &[]).await;
    for _ in 0..3 {
        let verdict = world.store.commit(&lease.token, &otherwise(&lease)).await.unwrap();
        assert_eq!(verdict, CommitVerdict::AlreadyCommitted);
    }
    for bake in &bakes {
        assert_alarms(&world, bake, &["w"]).await;
        let results = world.store.results_after(&bake.id, None, 0, 10).await.unwrap().results;
        assert_eq!(results[0].outputs, outputs(a.key), "the first result stays");
        assert_eq!(world.state(bake).await, BakeState::Done);
    }
    assert_eq!(world.store.stats().await.unwrap().alarms, 1);
}

pub async fn token_that_comes_twice_at_once_with_other_outputs_is_an_alarm_and_the_first_counts(
    world: World,
) {
    let bake = world.submit("bake", &[task("a", &[]), task("b", &[])]).await;
    let leases = world.claim("w", 2).await;
    let results = [result(&leases[0], &[]), result(&leases[1], &[]), otherwise(&leases[0])];
    let commits = [0, 1, 0].map(|lease| leases[lease].token.as_str());
    let commits: Vec<_> = commits.into_iter().zip(&results).collect();
    let verdicts = world.store.commit_all(&commits).await.into_iter().map(Result::unwrap);
    assert_eq!(
        verdicts.collect::<Vec<_>>(),
        [CommitVerdict::Committed, CommitVerdict::Committed, CommitVerdict::AlreadyCommitted]
    );
    assert_alarms(&world, &bake, &["w"]).await;
    let kept = world.store.results_after(&bake.id, None, 0, 10).await.unwrap().results;
    for lease in &leases {
        let result = kept.iter().find(|result| result.key == lease.task.key).unwrap();
        assert_eq!(result.outputs, outputs(lease.task.key));
    }
}

pub async fn late_result_with_other_outputs_is_an_alarm_whichever_came_first(world: World) {
    for (name, is_late_first) in [("first", true), ("second", false)] {
        for is_noticed in [true, false] {
            let name = format!("{name} {is_noticed}");
            let bake = world.submit(&name, &[task(&name, &[])]).await;
            let late = world.begin_one("late").await;
            world.clock.advance_ms(TTL_MS);
            if is_noticed || !is_late_first {
                world.store.reap().await.unwrap();
            }
            let hand_in_late = async || {
                let verdict = world.store.commit(&late.token, &otherwise(&late)).await.unwrap();
                assert_eq!(verdict, CommitVerdict::Stale);
            };
            if is_late_first {
                hand_in_late().await;
                assert_alarms(&world, &bake, &[]).await;
            }
            world.store.reap().await.unwrap();
            let lease = world.claim_one("w").await;
            assert_eq!(world.commit(&lease).await, CommitVerdict::Committed);
            if !is_late_first {
                hand_in_late().await;
            }
            hand_in_late().await;
            assert_alarms(&world, &bake, &["late"]).await;
            assert_eq!(world.state(&bake).await, BakeState::Done);
        }
    }
}

pub async fn bake_is_told_of_the_first_alarms_and_counts_all(world: World) {
    const MORE: usize = MAX_ALARMS_TOLD as usize + 2;
    let plan: Vec<_> = (0..MORE).map(|number| task(&number.to_string(), &[])).collect();
    let bake = world.submit("bake", &plan).await;
    let leases = world.claim("w", MORE as u32).await;
    assert_eq!(leases.len(), MORE);
    for lease in &leases {
        assert_eq!(world.commit(lease).await, CommitVerdict::Committed);
        let verdict = world.store.commit(&lease.token, &otherwise(lease)).await.unwrap();
        assert_eq!(verdict, CommitVerdict::AlreadyCommitted);
    }
    assert_eq!(told(&world, &bake).await.len(), MAX_ALARMS_TOLD as usize);
    assert_eq!(world.show(&bake).await.alarms, MORE as u64);
    assert_eq!(world.store.stats().await.unwrap().alarms, MORE as u64);
}

pub async fn leases_that_ran_out_and_were_not_begun_are_remembered_up_to_a_number(world: World) {
    let bake = world.submit("bake", &[task("a", &[])]).await;
    let (mut first, mut beyond) = (None, None);
    for number in 0..=MAX_EXPIRED {
        let lease = world.claim_one(&format!("w{number}")).await;
        world.clock.advance_ms(TTL_MS);
        assert_eq!(world.store.reap().await.unwrap().expired, 1);
        first.get_or_insert_with(|| lease.clone());
        beyond = Some(lease);
    }
    let lost = world.begin_one("lost").await;
    world.clock.advance_ms(TTL_MS);
    assert_eq!(world.store.reap().await.unwrap().lost, 1);
    for late in [first.unwrap(), beyond.unwrap(), lost] {
        let verdict = world.store.commit(&late.token, &otherwise(&late)).await.unwrap();
        assert_eq!(verdict, CommitVerdict::Stale);
    }
    let lease = world.claim_one("w").await;
    assert_eq!(world.commit(&lease).await, CommitVerdict::Committed);
    assert_alarms(&world, &bake, &["lost", "w0"]).await;
}

pub async fn late_result_with_the_same_outputs_is_none(world: World) {
    let bake = world.submit("bake", &[task("a", &[])]).await;
    let late = world.begin_one("late").await;
    world.clock.advance_ms(TTL_MS);
    assert_eq!(world.commit(&late).await, CommitVerdict::Stale);
    world.store.reap().await.unwrap();
    let lease = world.claim_one("w").await;
    assert_eq!(world.commit(&lease).await, CommitVerdict::Committed);
    assert_eq!(world.commit(&late).await, CommitVerdict::Stale);
    assert_alarms(&world, &bake, &[]).await;
}

pub async fn result_that_is_made_anew_with_other_outputs_is_an_alarm(world: World) {
    let a = task("a", &[]);
    let bake = world.submit("bake", &[a.clone(), task("b", &[&a])]).await;
    let lease = world.claim_one("w").await;
    assert_eq!(world.commit(&lease).await, CommitVerdict::Committed);
    world.store.forget(&[a.key]).await.unwrap();
    let lease = world.claim_one("again").await;
    let verdict = world.store.commit(&lease.token, &otherwise(&lease)).await.unwrap();
    assert_eq!(verdict, CommitVerdict::Committed);
    assert_alarms(&world, &bake, &["again"]).await;
}
