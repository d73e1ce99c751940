//! Evaluations attached to bakes: which bakes take them, and which chunks they hold for how long.

use std::collections::BTreeSet;

use lightkiln_proto::ids::Digest;
use lightkiln_server::store::StoreError;

use crate::chunks::{collect_all, is_kept};
use crate::support::{SCENE, World, chunk, task};

fn digest(name: &str) -> Digest {
    Digest::of(name.as_bytes())
}

async fn set(world: &World, bake: &str, index: &str, files: &[Digest]) -> Result<(), StoreError> {
    let files: BTreeSet<Digest> = files.iter().copied().collect();
    world.store.set_evaluation(bake, digest(index), &files).await
}

async fn refs(world: &World, digest: Digest) -> u64 {
    let rows = world.store.chunk_rows(None, 100).await.unwrap();
    rows.iter().find(|row| row.digest == digest).map_or(0, |row| row.refs)
}

pub async fn evaluation_holds_its_files_until_it_is_replaced_or_its_bake_deleted(world: World) {
    let names = ["index 1", "index 2", "a", "b", "c"];
    for name in names {
        world.store.keep_chunk(chunk(digest(name), 1), None, None).await.unwrap();
    }
    let bake = world.submit("bake", &[task("t", &[])]).await;
    world.drain("w").await;
    assert_eq!(world.show(&bake).await.evaluation, None);
    // The scene is a file here, too: the bake needs it for itself when the evaluation goes.
    let scene = Digest::of(SCENE);
    for _ in 0..2 {
        set(&world, &bake.id, "index 1", &[digest("a"), digest("b"), scene]).await.unwrap();
        assert_eq!(world.show(&bake).await.evaluation, Some(digest("index 1")));
        assert_eq!((refs(&world, digest("a")).await, refs(&world, scene).await), (1, 2));
    }
    set(&world, &bake.id, "index 2", &[digest("b"), digest("c")]).await.unwrap();
    assert_eq!(refs(&world, scene).await, 1);
    collect_all(&world).await;
    let mut kept = Vec::new();
    for name in names {
        kept.push(is_kept(&world, digest(name)).await);
    }
    assert_eq!(kept, [false, true, false, true, true], "what was replaced went");
    assert!(is_kept(&world, scene).await);
    world.store.delete_bake(&bake.id).await.unwrap();
    collect_all(&world).await;
    for name in names {
        assert!(!is_kept(&world, digest(name)).await, "{name} went with the bake");
    }
}

pub async fn evaluation_is_refused_unless_the_bake_is_done_and_its_files_are_kept(world: World) {
    for name in ["index", "a"] {
        world.store.keep_chunk(chunk(digest(name), 1), None, None).await.unwrap();
    }
    let absent = set(&world, "none", "index", &[]).await;
    assert!(matches!(absent, Err(StoreError::NoSuchBake { .. })), "{absent:?}");
    let bake = world.submit("bake", &[task("t", &[])]).await;
    let cancelled = world.submit("other", &[task("u", &[])]).await;
    world.store.cancel(&cancelled.id).await.unwrap();
    for id in [&bake.id, &cancelled.id] {
        let refused = set(&world, id, "index", &[digest("a")]).await;
        assert!(matches!(refused, Err(StoreError::StateConflict { .. })), "{refused:?}");
    }
    world.drain("w").await;
    set(&world, &bake.id, "index", &[digest("a")]).await.unwrap();
    for (index, file) in [("index", "never stored"), ("never stored", "a")] {
        let refused = set(&world, &bake.id, index, &[digest(file)]).await;
        let missing = digest("never stored");
        assert!(
            matches!(refused, Err(StoreError::MissingChunk { digest }) if digest == missing),
            "{refused:?}"
        );
    }
    assert_eq!(world.show(&bake).await.evaluation, Some(digest("index")), "a refusal changes nothing");
    assert_eq!(refs(&world, digest("a")).await, 1);
}
