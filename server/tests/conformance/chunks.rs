//! Stored bytes: their references, their end, and their loss.

use std::collections::BTreeSet;
use std::slice::from_ref;
use std::sync::Arc;

use bytes::Bytes;
use futures::{StreamExt, TryStreamExt};
use lightkiln_proto::api::{BakeFilter, BakeState, CommitVerdict};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{Artefact, TaskInput, TaskResult, TaskSpec};
use lightkiln_proto::problem::ProblemCode;
use lightkiln_server::chunks::{ChunkStore, ObjectChunks};
use lightkiln_server::storage::Storage;
use lightkiln_server::store::StoreError;
use lightkiln_server::store::chunk::{CollectRules, Collected, Kept, Usage};

use crate::support::{SCENE, World, chunk, chunks_in_memory, output, result, submission, task};

/// Grace of the tests' collections.
pub const GRACE_MS: i64 = 3_600_000;
pub const RULES: CollectRules = CollectRules { grace_ms: GRACE_MS, keep_bakes_ms: None, max: 100 };

fn digest(name: &str) -> Digest {
    Digest::of(name.as_bytes())
}

async fn keep(world: &World, digest: Digest, generation: u64) -> Kept {
    world.store.keep_chunk(chunk(digest, generation), None, None).await.unwrap()
}

pub async fn is_kept(world: &World, digest: Digest) -> bool {
    !world.store.find_chunks(&[digest]).await.unwrap().is_empty()
}

/// Collects once the grace of everything is over.
pub async fn collect_all(world: &World) -> Collected {
    world.clock.advance_ms(GRACE_MS);
    world.store.collect(&RULES).await.unwrap()
}

/// Claims a task and commits it with those outputs.
pub async fn run_with(world: &World, outputs: &[Digest]) -> Result<CommitVerdict, StoreError> {
    let lease = world.claim_one("w").await;
    let artefact = |(index, digest): (usize, &Digest)| Artefact {
        name: format!("out{index}"),
        digest: *digest,
        bytes: 32,
    };
    let outputs = outputs.iter().enumerate().map(artefact).collect();
    world.store.commit(&lease.token, &TaskResult { outputs, ..TaskResult::default() }).await
}

pub async fn first_of_equal_bytes_is_kept(world: World) {
    let a = digest("a");
    assert_eq!(keep(&world, a, 7).await, Kept::Fresh);
    assert_eq!(keep(&world, a, 8).await, Kept::Known(chunk(a, 7)));
    assert_eq!(keep(&world, a, 7).await, Kept::Known(chunk(a, 7)));
    assert_eq!(world.store.find_chunks(&[digest("b"), a]).await.unwrap(), [chunk(a, 7)]);
    assert_eq!(world.store.touch_chunk(digest("b")).await.unwrap(), None);
}

pub async fn replaced_bytes_are_condemned(world: World) {
    let a = digest("a");
    keep(&world, a, 7).await;
    let before = world.store.usage().await.unwrap();
    let replace = |by, old| world.store.keep_chunk(chunk(a, by), Some(old), None);
    assert_eq!(replace(8, 6).await.unwrap(), Kept::Known(chunk(a, 7)));
    assert_eq!(replace(8, 7).await.unwrap(), Kept::Fresh);
    assert_eq!(replace(9, 7).await.unwrap(), Kept::Known(chunk(a, 8)));
    let now = world.store.usage().await.unwrap();
    assert_eq!((now.chunks, now.bytes), (before.chunks + 1, before.bytes + 32));
    assert_eq!(world.store.collect(&RULES).await.unwrap().to_remove, [chunk(a, 7).name]);
    world.store.purge(&[chunk(a, 7).name]).await.unwrap();
    assert_eq!(world.store.usage().await.unwrap(), before);
}

pub async fn chunk_that_nobody_needs_goes_after_the_grace(world: World) {
    let [a, b] = [digest("a"), digest("b")];
    keep(&world, a, 1).await;
    keep(&world, b, 1).await;
    world.clock.advance_ms(GRACE_MS - 1);
    assert_eq!(world.store.collect(&RULES).await.unwrap(), Collected::default());
    // Somebody asks whether it need be uploaded, and relies on the answer.
    world.store.touch_chunk(a).await.unwrap();
    world.clock.advance_ms(GRACE_MS - 1);
    let collected = world.store.collect(&RULES).await.unwrap();
    assert!(is_kept(&world, a).await && !is_kept(&world, b).await);
    assert!(collected.to_remove.contains(&chunk(b, 1).name) && collected.condemned > 0);
    // Until they are purged they are named again: the process that was to remove them may have died.
    let again = world.store.collect(&RULES).await.unwrap();
    assert_eq!((again.condemned, &again.to_remove), (0, &collected.to_remove));
    world.store.purge(&collected.to_remove).await.unwrap();
    assert_eq!(world.store.collect(&RULES).await.unwrap(), Collected::default());
    assert_eq!(world.store.usage().await.unwrap(), Usage { chunks: 1, bytes: 32 });
}

pub async fn what_a_bake_needs_stays_until_it_is_deleted(world: World) {
    let [out, named, other] = [digest("out"), digest("named"), digest("other")];
    for digest in [out, named, other] {
        keep(&world, digest, 1).await;
    }
    let mut reads = task("reads", &[]);
    reads.inputs = vec![TaskInput::Artefact { name: "in".into(), digest: named }];
    reads.key = reads.computed_key();
    let bake = world.submit("bake", &[reads]).await;
    run_with(&world, &[out, out]).await.unwrap();
    assert_eq!(world.state(&bake).await, BakeState::Done);
    collect_all(&world).await;
    for (digest, stays) in [(out, true), (named, true), (Digest::of(SCENE), true), (other, false)] {
        assert_eq!(is_kept(&world, digest).await, stays);
    }
    world.store.delete_bake(&bake.id).await.unwrap();
    assert!(matches!(world.store.show(&bake.id).await, Err(StoreError::NoSuchBake { .. })));
    assert!(world.store.list(&BakeFilter::default(), None, 10).await.unwrap().bakes.is_empty());
    assert!(world.store.stats().await.unwrap().tasks.is_empty(), "its results go with it");
    collect_all(&world).await;
    assert!(world.store.chunk_rows(None, 10).await.unwrap().is_empty());
}

pub async fn result_of_two_bakes_stays_until_both_are_deleted(world: World) {
    let out = digest("out");
    keep(&world, out, 1).await;
    let first = world.submit("first", &[task("a", &[])]).await;
    run_with(&world, &[out]).await.unwrap();
    let second = world.submit("second", &[task("a", &[])]).await;
    assert_eq!(second.tasks_reused, 1);
    world.store.delete_bake(&first.id).await.unwrap();
    collect_all(&world).await;
    assert!(is_kept(&world, out).await);
    assert_eq!(world.submit("third", &[task("a", &[])]).await.tasks_reused, 1);
    for bake in world.store.list(&BakeFilter::default(), None, 10).await.unwrap().bakes {
        world.store.delete_bake(&bake.id).await.unwrap();
    }
    collect_all(&world).await;
    assert!(!is_kept(&world, out).await);
    assert!(!is_kept(&world, Digest::of(SCENE)).await);
}

pub async fn live_bake_cannot_be_deleted(world: World) {
    let bake = world.submit("bake", &[task("a", &[])]).await;
    let refused = world.store.delete_bake(&bake.id).await.unwrap_err();
    assert_eq!(refused.code(), ProblemCode::StateConflict, "{refused}");
    world.store.cancel(&bake.id).await.unwrap();
    world.store.delete_bake(&bake.id).await.unwrap();
    let refused = world.store.delete_bake(&bake.id).await.unwrap_err();
    assert_eq!(refused.code(), ProblemCode::NotFound, "{refused}");
}

pub async fn old_bakes_are_deleted_when_they_are_not_to_be_kept(world: World) {
    let rules = CollectRules { keep_bakes_ms: Some(1_000), ..RULES };
    let old = world.submit("old", &[task("a", &[])]).await;
    world.drain("w").await;
    world.clock.advance_ms(1);
    let young = world.submit("young", &[task("b", &[])]).await;
    let live = world.submit("live", &[task("c", &[])]).await;
    let lease = world.claim_one("w").await;
    assert_eq!(world.commit(&lease).await, CommitVerdict::Committed);
    world.clock.advance_ms(999);
    assert_eq!(world.store.collect(&rules).await.unwrap().bakes, 1);
    assert!(world.store.show(&old.id).await.is_err());
    assert_eq!(world.state(&young).await, BakeState::Done);
    world.clock.advance_ms(GRACE_MS);
    assert_eq!(world.store.collect(&rules).await.unwrap().bakes, 1);
    assert_eq!(world.state(&live).await, BakeState::Running);
}

pub async fn result_whose_output_went_is_refused_until_it_is_stored_again(world: World) {
    let out = digest("out");
    keep(&world, out, 1).await;
    let bake = world.submit("bake", &[task("a", &[])]).await;
    let collected = collect_all(&world).await;
    assert!(collected.to_remove.contains(&chunk(out, 1).name));
    let lease = world.claim_one("w").await;
    let outputs = vec![Artefact { name: "out".into(), digest: out, bytes: 32 }];
    let result = TaskResult { outputs, ..TaskResult::default() };
    let refused = world.store.commit(&lease.token, &result).await.unwrap_err();
    assert!(matches!(refused, StoreError::MissingChunk { digest } if digest == out), "{refused}");
    assert_eq!(world.show(&bake).await.tasks_run, 0);
    // A condemned name is dead, another one is not, and a late burial does not touch it.
    assert_eq!(keep(&world, out, 1).await, Kept::Condemned);
    assert_eq!(keep(&world, out, 2).await, Kept::Fresh);
    world.store.purge(&collected.to_remove).await.unwrap();
    assert_eq!(world.store.commit(&lease.token, &result).await.unwrap(), CommitVerdict::Committed);
    assert_eq!(world.store.find_chunks(&[out]).await.unwrap(), [chunk(out, 2)]);
}

pub async fn bake_without_its_scene_or_artefacts_is_refused(world: World) {
    let mut unknown = submission("bake", &[task("a", &[])]);
    unknown.bake.scene = digest("never stored");
    let refused = world.store.submit(&unknown).await.unwrap_err();
    assert!(matches!(refused, StoreError::MissingChunk { .. }), "{refused}");
    let mut reads = task("reads", &[]);
    reads.inputs = vec![TaskInput::Artefact { name: "in".into(), digest: digest("never stored") }];
    reads.key = reads.computed_key();
    let refused = world.store.submit(&submission("bake", from_ref(&reads))).await.unwrap_err();
    assert!(matches!(refused, StoreError::MissingChunk { .. }), "{refused}");
    let bake = world.submit("bake", &[task("plan", &[])]).await;
    let lease = world.claim_one("w").await;
    let refused = world.store.commit(&lease.token, &result(&lease, &[reads])).await.unwrap_err();
    assert!(matches!(refused, StoreError::MissingChunk { .. }), "{refused}");
    assert_eq!(world.store.stats().await.unwrap().bakes_total, 1);
    assert_eq!(world.commit(&lease).await, CommitVerdict::Committed);
    assert_eq!(world.state(&bake).await, BakeState::Done);
}

pub async fn lost_chunk_makes_its_task_run_again(world: World) {
    let out = digest("out");
    keep(&world, out, 1).await;
    let a = task("a", &[]);
    let bake = world.submit("bake", &[a.clone(), task("b", &[&a])]).await;
    run_with(&world, &[out]).await.unwrap();
    assert_eq!(world.store.lose_chunk(chunk(out, 9).name).await.unwrap(), 0, "that is not what counts");
    assert_eq!(world.store.lose_chunk(chunk(out, 1).name).await.unwrap(), 1);
    assert_eq!(world.store.lose_chunk(chunk(out, 1).name).await.unwrap(), 0);
    assert!(!is_kept(&world, out).await);
    assert_eq!(world.claim_labels("w", 10).await, ["a"], "the other waits again");
    world.expire_leases().await;
    assert!(matches!(run_with(&world, &[out]).await, Err(StoreError::MissingChunk { .. })));
    world.expire_leases().await;
    assert_eq!(keep(&world, out, 2).await, Kept::Fresh);
    assert_eq!(run_with(&world, &[out]).await.unwrap(), CommitVerdict::Committed);
    assert_eq!(run_with(&world, &[output(0)]).await.unwrap(), CommitVerdict::Committed);
    assert_eq!(world.state(&bake).await, BakeState::Done);
}

pub async fn lost_scene_can_be_uploaded_again(world: World) {
    let scene = Digest::of(SCENE);
    world.submit("bake", &[task("a", &[])]).await;
    assert_eq!(world.store.lose_chunk(chunk(scene, 1).name).await.unwrap(), 0);
    assert!(!is_kept(&world, scene).await);
    assert_eq!(keep(&world, scene, 2).await, Kept::Fresh);
    collect_all(&world).await;
    assert!(is_kept(&world, scene).await, "the bake still refers to it");
}

pub async fn quota_refuses_what_would_exceed_it(world: World) {
    let used = world.store.usage().await.unwrap().bytes;
    let keep = |name: &str| world.store.keep_chunk(chunk(digest(name), 1), None, Some(used + 40));
    assert_eq!(keep("a").await.unwrap(), Kept::Fresh);
    let refused = keep("b").await.unwrap_err();
    assert_eq!(refused.code(), ProblemCode::StorageFull, "{refused}");
    assert!(!is_kept(&world, digest("b")).await);
    assert_eq!(world.store.usage().await.unwrap().bytes, used + 32);
    // Equal bytes take no room.
    assert_eq!(keep("a").await.unwrap(), Kept::Known(chunk(digest("a"), 1)));
    let collected = collect_all(&world).await;
    keep("b").await.unwrap_err();
    world.store.purge(&collected.to_remove).await.unwrap();
    assert_eq!(keep("b").await.unwrap(), Kept::Fresh);
}

pub async fn orphans_are_condemned_and_others_are_not(world: World) {
    let [a, b] = [digest("a"), digest("b")];
    keep(&world, a, 1).await;
    let all = [chunk(a, 1), chunk(a, 2), chunk(b, 0)];
    let names = all.map(|chunk| chunk.name);
    let sorted = BTreeSet::from([names[1], names[2]]);
    assert_eq!(world.store.orphans(&names).await.unwrap(), names[1..]);
    assert_eq!(world.store.condemn_orphans(&all).await.unwrap(), names[1..]);
    assert_eq!(world.store.orphans(&names).await.unwrap(), []);
    assert!(world.store.condemn_orphans(&all).await.unwrap().is_empty());
    // An upload that ends only now is told that its bytes are dead.
    assert_eq!(keep(&world, b, 0).await, Kept::Condemned);
    let to_remove = world.store.collect(&RULES).await.unwrap().to_remove;
    assert_eq!(to_remove, sorted.into_iter().collect::<Vec<_>>());
    assert_eq!(world.store.find_chunks(&[a]).await.unwrap(), [all[0]]);
}

/// A storage over the world's store, and its bytes.
pub fn storage(world: &World, quota_bytes: Option<u64>) -> (Storage, Arc<ObjectChunks>) {
    let objects = Arc::new(chunks_in_memory());
    (Storage::new(world.store.clone(), objects.clone(), quota_bytes), objects)
}

pub async fn put(storage: &Storage, content: &'static [u8]) -> Digest {
    let digest = Digest::of(content);
    storage.put(digest, Bytes::from_static(content)).await.unwrap();
    digest
}

async fn read(storage: &Storage, digest: Digest, length: u64) -> Result<Vec<u8>, ProblemCode> {
    let stream = storage.read(digest, 0..length).await.map_err(|error| error.code())?;
    let pieces: Vec<Bytes> = stream.try_collect().await.map_err(|error| error.code())?;
    Ok(pieces.concat())
}

async fn objects_count(objects: &ObjectChunks) -> usize {
    objects.list().count().await
}

pub async fn equal_bytes_are_stored_once_and_removed_when_nobody_needs_them(world: World) {
    let (storage, objects) = storage(&world, None);
    let a = put(&storage, b"aaaa").await;
    assert!(!storage.put(a, Bytes::from_static(b"aaaa")).await.unwrap().is_new);
    assert_eq!((storage.length(a).await.unwrap(), objects_count(&objects).await), (Some(4), 1));
    assert_eq!(
        storage.put(a, Bytes::from_static(b"bbbb")).await.unwrap_err().code(),
        ProblemCode::DigestMismatch
    );
    world.clock.advance_ms(GRACE_MS);
    assert!(storage.collect(&RULES).await.unwrap().chunks > 0);
    assert_eq!((storage.length(a).await.unwrap(), objects_count(&objects).await), (None, 0));
    assert_eq!(read(&storage, a, 4).await, Err(ProblemCode::NotFound));
}

/// The collector has condemned a chunk and sleeps; somebody stores the same bytes and commits; then it wakes and removes.
pub async fn late_removal_does_not_meet_what_was_stored_meanwhile(world: World) {
    let (storage, objects) = storage(&world, None);
    let a = put(&storage, b"aaaa").await;
    let collected = collect_all(&world).await;
    assert!(collected.to_remove.iter().any(|name| name.digest == a));
    assert!(storage.put(a, Bytes::from_static(b"aaaa")).await.unwrap().is_new);
    put(&storage, SCENE).await;
    let bake = world.submit("bake", &[task("a", &[])]).await;
    assert_eq!(run_with(&world, &[a]).await.unwrap(), CommitVerdict::Committed);
    assert_eq!(objects_count(&objects).await, 3);
    storage.remove_condemned(&collected.to_remove).await.unwrap();
    // And once more, from a process that slept still longer.
    storage.remove_condemned(&collected.to_remove).await.unwrap();
    assert_eq!(objects_count(&objects).await, 2);
    assert_eq!(read(&storage, a, 4).await.unwrap(), b"aaaa");
    assert_eq!(world.state(&bake).await, BakeState::Done);
}

pub async fn uploads_beside_collections_lose_nothing(world: World) {
    let (storage, _) = storage(&world, None);
    let rules = CollectRules { grace_ms: 0, ..RULES };
    put(&storage, SCENE).await;
    let tasks: Vec<TaskSpec> = (0..6).map(|number| task(&format!("{number}"), &[])).collect();
    let bake = world.submit("bake", &tasks).await;
    for lease in world.claim("w", 6).await {
        // All have the same output, which nobody needs until the first is committed. Each is tried twice in a race
        // with a collector, and then without one if it lost both.
        for attempt in 0.. {
            let out = Digest::of(b"the same");
            let put = storage.put(out, Bytes::from_static(b"the same"));
            let outputs = vec![Artefact { name: "out".into(), digest: out, bytes: 8 }];
            let result = TaskResult { outputs, ..TaskResult::default() };
            let commit = world.store.commit(&lease.token, &result);
            let collect = async {
                if attempt < 2 {
                    storage.collect(&rules).await.unwrap();
                }
            };
            let upload = async {
                put.await.unwrap();
                commit.await
            };
            match futures::future::join(upload, collect).await.0 {
                Ok(verdict) => {
                    assert_eq!(verdict, CommitVerdict::Committed);
                    break;
                }
                Err(StoreError::MissingChunk { .. }) if attempt < 2 => (),
                Err(error) => panic!("{error}"),
            }
        }
    }
    storage.collect(&rules).await.unwrap();
    assert_eq!(world.state(&bake).await, BakeState::Done);
    assert_eq!(read(&storage, Digest::of(b"the same"), 8).await.unwrap(), b"the same");
}

pub async fn damaged_bytes_are_given_up_when_they_are_read(world: World) {
    let (storage, objects) = storage(&world, None);
    put(&storage, SCENE).await;
    let out = put(&storage, b"right").await;
    let a = task("a", &[]);
    world.submit("bake", &[a.clone(), task("b", &[&a])]).await;
    run_with(&world, &[out]).await.unwrap();
    let name = world.store.find_chunks(&[out]).await.unwrap()[0].name;
    objects.delete(name).await.unwrap();
    assert_eq!(read(&storage, out, 5).await, Err(ProblemCode::NotFound));
    assert_eq!(storage.lost().get(), 1);
    assert_eq!(world.claim_labels("w", 10).await, ["a"], "it runs again");
    assert_eq!(put(&storage, b"right").await, out);
    assert_eq!(read(&storage, out, 5).await.unwrap(), b"right");
}

/// Somebody looks for bytes that are being replaced, or cleared away: they are gone, and nothing is lost.
pub async fn chunk_that_was_stored_again_meanwhile_is_not_lost(world: World) {
    let (storage, _) = storage(&world, None);
    let out = put(&storage, b"right").await;
    let now = world.store.find_chunks(&[out]).await.unwrap()[0].name;
    storage.lose(chunk(out, now.generation ^ 1).name).await.unwrap();
    storage.lose(chunk(digest("cleared away"), 1).name).await.unwrap();
    assert_eq!((storage.lost().get(), is_kept(&world, out).await), (0, true));
    storage.lose(now).await.unwrap();
    assert_eq!((storage.lost().get(), is_kept(&world, out).await), (1, false));
}

pub async fn upload_beyond_the_quota_leaves_nothing_and_works_when_there_is_room(world: World) {
    let used = world.store.usage().await.unwrap().bytes;
    let (storage, objects) = storage(&world, Some(used + 10));
    let a = put(&storage, b"0123456789").await;
    let more = Bytes::from_static(b"more");
    let refused = storage.put(Digest::of(&more), more.clone()).await.unwrap_err();
    assert_eq!(refused.code(), ProblemCode::StorageFull, "{refused}");
    // So does one that does not say how much will come.
    let stream = futures::stream::iter([Ok(more.clone())]).boxed();
    let refused = storage.put_stream(Digest::of(&more), stream, 100, None).await.unwrap_err();
    assert_eq!(refused.code(), ProblemCode::StorageFull, "{refused}");
    assert_eq!(objects_count(&objects).await, 1);
    assert_eq!(storage.length(Digest::of(&more)).await.unwrap(), None);
    assert_eq!(read(&storage, a, 10).await.unwrap(), b"0123456789");
    world.clock.advance_ms(GRACE_MS);
    storage.collect(&RULES).await.unwrap();
    assert!(storage.put(Digest::of(&more), more).await.unwrap().is_new);
}

pub async fn bytes_from_before_generations_are_found(world: World) {
    let (storage, objects) = storage(&world, None);
    let old = Digest::of(b"old");
    objects.put_if_absent(old.into(), Bytes::from_static(b"old")).await.unwrap();
    assert_eq!(storage.length(old).await.unwrap(), Some(3));
    assert_eq!(read(&storage, old, 3).await.unwrap(), b"old");
    world.clock.advance_ms(GRACE_MS);
    storage.collect(&RULES).await.unwrap();
    assert_eq!((storage.length(old).await.unwrap(), objects_count(&objects).await), (None, 0));
}
