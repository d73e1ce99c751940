//! Artefacts that are lost while tasks wait to read them: their makers run again, and the readers wait.

use std::slice::from_ref;

use lightkiln_proto::api::{Bake, BakeState, Blame, CommitVerdict, EventKind};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{Artefact, TaskInput, TaskResult, TaskSpec};
use lightkiln_server::store::{FailVerdict, MAX_ATTEMPTS};

use crate::support::{World, chunk, result, task};

fn digest(name: &str) -> Digest {
    Digest::of(name.as_bytes())
}

/// A task that names an artefact by its digest, and depends on others as well.
fn reader(name: &str, digest: Digest, needs: &[&TaskSpec]) -> TaskSpec {
    let mut task = task(name, needs);
    task.inputs.push(TaskInput::Artefact { name: "made".into(), digest });
    TaskSpec::new(&task.kind, 1, name, task.params, task.inputs, 1)
}

/// Claims the one task that can be claimed, which is of that label, and commits it with an output and a plan.
async fn make(world: &World, label: &str, output: Digest, plan: &[TaskSpec]) {
    let lease = world.claim("w", 10).await.pop().expect("a task is ready");
    assert_eq!(lease.task.label, label);
    let outputs = vec![Artefact { name: "out".into(), digest: output, bytes: 32 }];
    let result = TaskResult { outputs, ..result(&lease, plan) };
    assert_eq!(world.store.commit(&lease.token, &result).await.unwrap(), CommitVerdict::Committed);
}

async fn keep(world: &World, digest: Digest, generation: u64) {
    world.store.keep_chunk(chunk(digest, generation), None, None).await.unwrap();
}

async fn lose(world: &World, digest: Digest, generation: u64) -> u64 {
    world.store.lose_chunk(chunk(digest, generation).name).await.unwrap()
}

/// A live bake in which `makes` has made an artefact, and a planner has planned two tasks that name it.
async fn bake_with_readers(world: &World) -> (Bake, Digest) {
    let made = digest("made");
    keep(world, made, 1).await;
    let makes = task("makes", &[]);
    let plans = task("plans", &[&makes]);
    let bake = world.submit("bake", &[makes, plans]).await;
    make(world, "makes", made, &[]).await;
    make(world, "plans", digest_of_stock(), &["first", "second"].map(|name| reader(name, made, &[]))).await;
    (bake, made)
}

/// Something that every world has.
fn digest_of_stock() -> Digest {
    crate::support::output(0)
}

async fn attempts(world: &World, bake: &Bake, wanted: &str) -> Vec<u32> {
    let started = |event: EventKind| match event {
        EventKind::TaskStarted { label, attempt, .. } if label == wanted => Some(attempt),
        _ => None,
    };
    world.events(bake).await.into_iter().filter_map(|event| started(event.event)).collect()
}

pub async fn readers_of_a_lost_artefact_wait_until_it_is_made_again(world: World) {
    let (bake, made) = bake_with_readers(&world).await;
    let holder = world.begin_one("w").await;
    assert_eq!(lose(&world, made, 1).await, 1);
    for _ in 0..2 * MAX_ATTEMPTS {
        let leases = world.claim("w", 10).await;
        assert_eq!(leases.iter().map(|lease| lease.task.label.as_str()).collect::<Vec<_>>(), ["makes"]);
        world.store.release(&leases[0].token).await.unwrap();
        world.clock.advance_ms(1);
    }
    // The one that was under way finds nothing, and that is not its worker's fault.
    let failed = world.store.fail(&holder.token, Blame::Worker, "not in the store").await.unwrap();
    assert_eq!(failed, FailVerdict::Retry);
    assert_eq!(world.store.blocklist(&bake.id).await.unwrap().workers, []);
    // The bytes alone are not enough: the row is the commit point.
    keep(&world, made, 2).await;
    let leases = world.claim("w", 10).await;
    assert_eq!(leases.len(), 1, "{leases:?}");
    let outputs = vec![Artefact { name: "out".into(), digest: made, bytes: 32 }];
    let again = TaskResult { outputs, ..TaskResult::default() };
    assert_eq!(world.store.commit(&leases[0].token, &again).await.unwrap(), CommitVerdict::Committed);
    assert_eq!(world.drain("w").await, 2);
    assert_eq!(world.state(&bake).await, BakeState::Done);
    assert_eq!(attempts(&world, &bake, &holder.task.label).await, [1, 1]);
}

pub async fn attempt_that_lost_its_input_counts_for_nobody_also_after_it_is_made_again(world: World) {
    let (bake, made) = bake_with_readers(&world).await;
    for generation in 1..=u64::from(MAX_ATTEMPTS) + 1 {
        let holder = world.begin_one("w").await;
        lose(&world, made, generation).await;
        let other = holder.task.label.clone();
        keep(&world, made, generation + 1).await;
        make(&world, "makes", made, &[]).await;
        let failed = world.store.fail(&holder.token, Blame::Worker, "not in the store").await.unwrap();
        assert_eq!(failed, FailVerdict::Retry);
        assert!(attempts(&world, &bake, &other).await.iter().all(|attempt| *attempt == 1));
    }
    assert_eq!(world.drain("w").await, 2);
    assert_eq!(world.state(&bake).await, BakeState::Done);
}

/// The result of a reader is lost while its artefact is being made again, and the other way round.
pub async fn reader_that_runs_again_waits_too(world: World) {
    for is_reader_first in [true, false] {
        let name = |what: &str| format!("{what} {is_reader_first}");
        let [made, read] = [digest(&name("made")), digest(&name("read"))];
        keep(&world, made, 1).await;
        keep(&world, read, 1).await;
        let (makes, plans) = (task(&name("makes"), &[]), task(&name("plans"), &[]));
        let reads = reader(&name("reads"), made, &[]);
        let last = task(&name("last"), &[&reads]);
        let bake = world.submit("bake", from_ref(&makes)).await;
        make(&world, &makes.label, made, from_ref(&plans)).await;
        make(&world, &plans.label, digest_of_stock(), &[reads.clone(), last]).await;
        make(&world, &reads.label, read, &[]).await;
        for lost in if is_reader_first { [read, made] } else { [made, read] } {
            assert_eq!(lose(&world, lost, 1).await, 1);
        }
        keep(&world, made, 2).await;
        keep(&world, read, 2).await;
        make(&world, &makes.label, made, from_ref(&plans)).await;
        make(&world, &reads.label, read, &[]).await;
        assert_eq!(world.drain("w").await, 1);
        assert_eq!(world.state(&bake).await, BakeState::Done);
    }
}

/// A trivial artefact: its reader gives the same bytes. Nobody waits in a ring.
pub async fn reader_that_makes_the_same_bytes_does_not_wait_for_itself(world: World) {
    let empty = digest("[]");
    keep(&world, empty, 1).await;
    let makes = task("makes", &[]);
    let bake = world.submit("bake", from_ref(&makes)).await;
    let first = reader("first", empty, &[]);
    let second = reader("second", empty, &[&first]);
    let last = reader("last", empty, &[&second]);
    make(&world, "makes", empty, &[first, second, last]).await;
    make(&world, "first", empty, &[]).await;
    make(&world, "second", empty, &[]).await;
    assert_eq!(lose(&world, empty, 1).await, 3);
    keep(&world, empty, 2).await;
    for label in ["makes", "first", "second", "last"] {
        make(&world, label, empty, &[]).await;
    }
    assert_eq!(world.state(&bake).await, BakeState::Done);
}

/// Two bakes share a reader; only one of them holds the maker of the artefact.
pub async fn bake_does_not_wait_for_what_only_another_one_makes(world: World) {
    let (bake, made) = bake_with_readers(&world).await;
    let shared = reader("first", made, &[]);
    lose(&world, made, 1).await;
    keep(&world, made, 2).await;
    let other = world.submit("other", from_ref(&shared)).await;
    assert_eq!(world.claim_labels("w", 10).await, ["makes"]);
    world.store.cancel(&bake.id).await.unwrap();
    // Its maker has gone with its bake.
    assert_eq!(world.claim_labels("w", 10).await, ["first"]);
    world.expire_leases().await;
    // From the beginning: the second bake was there before the loss.
    let (bake, _) = (world.submit("bake", &[task("makes", &[]), shared.clone()]).await, made);
    let makes = world.claim("w", 10).await.into_iter().find(|lease| lease.task.label == "makes").unwrap();
    let outputs = vec![Artefact { name: "out".into(), digest: made, bytes: 32 }];
    let again = TaskResult { outputs, ..TaskResult::default() };
    assert_eq!(world.store.commit(&makes.token, &again).await.unwrap(), CommitVerdict::Committed);
    world.expire_leases().await;
    assert_eq!(lose(&world, made, 2).await, 1);
    world.store.pause(&bake.id).await.unwrap();
    assert_eq!(world.claim_labels("w", 10).await, ["first"], "the other bake cannot make it, and tries");
    assert_eq!(world.state(&other).await, BakeState::Running);
}

pub async fn artefact_that_is_made_otherwise_fails_the_bake_and_says_so(world: World) {
    let (bake, made) = bake_with_readers(&world).await;
    lose(&world, made, 1).await;
    make(&world, "makes", digest_of_stock(), &[]).await;
    let bake = world.show(&bake).await;
    assert_eq!(bake.state, BakeState::Failed);
    let failure = bake.failure.unwrap();
    assert!(
        failure.starts_with("makes (work) was run again") && failure.contains(&made.to_string()),
        "{failure}"
    );
    assert!(world.claim("w", 10).await.is_empty());
}

/// Nobody reads the missing bytes: other ones are no reason to stop.
pub async fn artefact_that_nobody_reads_may_be_made_otherwise(world: World) {
    let made = digest("made");
    keep(&world, made, 1).await;
    let makes = task("makes", &[]);
    let bake = world.submit("bake", &[makes.clone(), task("after", &[&makes])]).await;
    make(&world, "makes", made, &[]).await;
    lose(&world, made, 1).await;
    make(&world, "makes", digest_of_stock(), &[]).await;
    assert_eq!(world.drain("w").await, 1);
    assert_eq!(world.state(&bake).await, BakeState::Done);
}

pub async fn results_say_what_their_plans_still_need(world: World) {
    let (_, made) = bake_with_readers(&world).await;
    let makes = task("makes", &[]);
    let plan = [makes.clone(), task("plans", &[&makes])];
    let known = world.store.reusable(&plan).await.unwrap();
    let named: Vec<_> = known.iter().map(|result| result.named.iter().copied().collect::<Vec<_>>()).collect();
    assert_eq!(named, [vec![], vec![made]]);
    world.drain("w").await;
    let known = world.store.reusable(&plan).await.unwrap();
    assert!(known.iter().all(|result| result.named.is_empty()), "{known:?}");
}
