//! Checks of the storage: their findings, their repairs, and lost results of bakes.

use std::slice::from_ref;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use futures::{StreamExt, TryStreamExt};
use lightkiln_proto::api::BakeState;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{Artefact, TaskInput, TaskResult};
use lightkiln_server::chunks::{ChunkName, ChunkStore, ObjectChunks};
use lightkiln_server::fsck::{self, Checks, Findings, Flaw, Incomplete};
use lightkiln_server::storage::Storage;
use object_store::memory::InMemory;
use object_store::{ObjectStore, ObjectStoreExt};

use crate::chunks::{GRACE_MS, RULES, collect_all, is_kept, put, run_with, storage};
use crate::support::{SCENE, World, task};

/// Puts other bytes of the same length in the place of a chunk's.
async fn damage(raw: &InMemory, digest: Digest) {
    let hex = digest.to_string();
    let start = format!("{}/{}", &hex[..2], &hex[2..]);
    let objects: Vec<_> = raw.list(None).try_collect().await.unwrap();
    let found = objects.iter().find(|object| object.location.as_ref().starts_with(&start)).unwrap();
    raw.put(&found.location, vec![b'x'; found.size as usize].into()).await.unwrap();
}

pub async fn check_finds_what_is_wrong_and_makes_it_good(world: World) {
    let raw = Arc::new(InMemory::new());
    let objects = Arc::new(ObjectChunks::over(raw.clone()));
    let storage = Storage::new(world.store.clone(), objects.clone(), None);
    // The stocked chunks have no bytes: away with them.
    collect_all(&world).await;
    put(&storage, SCENE).await;
    let [whole, missing, corrupt] =
        [put(&storage, b"whole").await, put(&storage, b"missing").await, put(&storage, b"corrupt").await];
    let tasks = ["a", "b", "c"].map(|name| task(name, &[]));
    let bake = world
        .submit("bake", &[&tasks[..], &[task("after", &[&tasks[0], &tasks[1], &tasks[2]])]].concat())
        .await;
    for output in [whole, missing, corrupt] {
        run_with(&world, &[output]).await.unwrap();
    }
    let orphan = Digest::of(b"orphan");
    objects.put_if_absent(ChunkName::fresh(orphan), Bytes::from_static(b"orphan")).await.unwrap();
    let check = async |reads, repairs, grace| {
        let checks = Checks { reads, repairs, grace };
        fsck::check(&*world.store, &*objects, &storage, checks).await.unwrap()
    };
    let day = Duration::from_secs(86_400);
    assert_eq!(check(true, false, day).await, Findings { chunks: 4, bytes: 24, ..Findings::default() });
    let name = world.store.find_chunks(&[missing]).await.unwrap()[0].name;
    objects.delete(name).await.unwrap();
    damage(&raw, corrupt).await;
    let flaw = |digest, bytes, references| vec![Flaw { digest, bytes, references }];
    let quick = check(false, false, day).await;
    assert_eq!((quick.missing, quick.corrupt, quick.orphaned), (flaw(missing, 7, 1), vec![], vec![]));
    let found = check(true, false, Duration::ZERO).await;
    assert!(!found.is_sound());
    assert_eq!((&found.missing, &found.corrupt), (&flaw(missing, 7, 1), &flaw(corrupt, 7, 1)));
    assert_eq!((&found.orphaned, found.lost.len()), (&flaw(orphan, 6, 0), 0));
    let repaired = check(true, true, Duration::ZERO).await;
    assert!(repaired.is_sound() && repaired.results_forgotten == 2, "{repaired:?}");
    assert!(objects.list().all(|chunk| async move { chunk.unwrap().name.digest != orphan }).await);
    // Two of the three run again.
    for content in [b"missing", b"corrupt"] {
        run_with(&world, &[put(&storage, content).await]).await.unwrap();
    }
    run_with(&world, &[whole]).await.unwrap();
    assert_eq!(world.state(&bake).await, BakeState::Done);
    world.clock.advance_ms(GRACE_MS);
    storage.collect(&RULES).await.unwrap();
    let sound = check(true, false, Duration::ZERO).await;
    assert_eq!(sound, Findings { chunks: 4, bytes: 24, ..Findings::default() });
}

/// Makes the farm's bytes real, and gives the names that checks look at.
async fn checked_farm(world: &World) -> (Storage, Arc<ObjectChunks>) {
    let (storage, objects) = storage(world, None);
    collect_all(world).await;
    put(&storage, SCENE).await;
    (storage, objects)
}

/// A check that repairs, of bytes and lengths.
async fn repair(world: &World, storage: &Storage, objects: &ObjectChunks) -> Findings {
    let checks = Checks { reads: true, repairs: true, grace: Duration::ZERO };
    fsck::check(&*world.store, objects, storage, checks).await.unwrap()
}

async fn remove(world: &World, objects: &ObjectChunks, digest: Digest) {
    let name = world.store.find_chunks(&[digest]).await.unwrap()[0].name;
    objects.delete(name).await.unwrap();
}

pub async fn scene_is_lost_only_while_a_live_bake_needs_it(world: World) {
    let (storage, objects) = checked_farm(&world).await;
    let ended = world.submit("ended", &[]).await;
    assert_eq!(world.state(&ended).await, BakeState::Done);
    remove(&world, &objects, Digest::of(SCENE)).await;
    let repaired = repair(&world, &storage, &objects).await;
    assert!(repaired.is_sound() && repaired.missing.len() == 1, "the next bake uploads it: {repaired:?}");
    put(&storage, SCENE).await;
    world.submit("live", &[task("a", &[])]).await;
    remove(&world, &objects, Digest::of(SCENE)).await;
    for _ in 0..2 {
        let repaired = repair(&world, &storage, &objects).await;
        assert!(!repaired.is_sound() && repaired.lost.len() == 1, "no task makes a scene: {repaired:?}");
    }
    put(&storage, SCENE).await;
    assert!(repair(&world, &storage, &objects).await.is_sound());
}

/// One task makes an artefact, another one names it; after the bake has ended the artefact is lost.
pub async fn artefact_that_an_ended_bake_names_is_made_again_by_the_next(world: World) {
    let (storage, objects) = checked_farm(&world).await;
    let made = put(&storage, b"made").await;
    let mut reads = task("reads", &[]);
    reads.inputs = vec![TaskInput::Artefact { name: "in".into(), digest: made }];
    reads.key = reads.computed_key();
    let plan = [task("makes", &[]), reads];
    let first = world.submit("first", &plan).await;
    for lease in world.claim("w", 2).await {
        let digest = if lease.task.label == "makes" { made } else { put(&storage, b"read").await };
        let outputs = vec![Artefact { name: "out".into(), digest, bytes: 4 }];
        let result = TaskResult { outputs, ..TaskResult::default() };
        world.store.commit(&lease.token, &result).await.unwrap();
    }
    assert_eq!((world.state(&first).await, world.show(&first).await.results_lost), (BakeState::Done, 0));
    remove(&world, &objects, made).await;
    let repaired = repair(&world, &storage, &objects).await;
    assert!(repaired.is_sound() && repaired.results_forgotten == 1, "{repaired:?}");
    // Lost results stay with the bake, and are no fault of the storage.
    let again = repair(&world, &storage, &objects).await;
    assert!(again.is_sound(), "{again:?}");
    let incomplete = Incomplete { bake: first.id.clone(), name: "first".into(), results_lost: 1 };
    assert_eq!((again.incomplete, again.missing), (vec![incomplete], vec![]));
    // The next bake makes it again, for the first one as well, which then holds it.
    assert_eq!(put(&storage, b"made").await, made);
    let second = world.submit("second", &plan).await;
    assert_eq!((second.state, second.tasks_reused), (BakeState::Running, 1));
    run_with(&world, &[made]).await.unwrap();
    assert_eq!(world.show(&first).await.results_lost, 0);
    world.store.delete_bake(&second.id).await.unwrap();
    collect_all(&world).await;
    assert!(is_kept(&world, made).await);
    assert_eq!(repair(&world, &storage, &objects).await.incomplete, vec![]);
}

/// Two bakes share a task; its result is lost while one of them is live, which is then cancelled.
pub async fn ended_bake_says_what_it_lost_also_when_a_live_one_gives_up(world: World) {
    let a = task("a", &[]);
    let ended = world.submit("ended", from_ref(&a)).await;
    world.drain("w").await;
    let live = world.submit("live", &[a.clone(), task("b", &[])]).await;
    world.store.forget(&[a.key]).await.unwrap();
    assert_eq!((world.show(&ended).await.results_lost, world.show(&live).await.results_lost), (1, 0));
    world.store.cancel(&live.id).await.unwrap();
    assert_eq!(world.show(&ended).await.results_lost, 1);
    world.submit("third", &[a]).await;
    world.drain("w").await;
    assert_eq!(world.show(&ended).await.results_lost, 0);
}
