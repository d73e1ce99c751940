//! Rules of all chunk stores: one suite, run over files, memory and S3.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

#[path = "../clock/mod.rs"]
mod clock;
#[path = "../model/mod.rs"]
mod model;
#[path = "../parts/mod.rs"]
mod parts;

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use std::time::Duration;

use bytes::Bytes;
use futures::{StreamExt, TryStreamExt};
use lightkiln_proto::api::{ScenePart, SceneParts, SceneProgress};
use lightkiln_proto::ids::Digest;
use lightkiln_server::chunks::{ByteStream, ChunkError, ChunkName, ChunkStore, Listed, ObjectChunks, Stored};
use lightkiln_server::farm::Farm;
use lightkiln_server::places::ChunksPlace;
use lightkiln_server::storage::Storage;
use lightkiln_server::store::chunk::CollectRules;
use lightkiln_server::wakeup::LocalWakeup;
use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey};
use object_store::local::LocalFileSystem;
use object_store::memory::InMemory;
use object_store::path::Path;
use object_store::prefix::PrefixStore;
use object_store::{ObjectStore, ObjectStoreExt};

use clock::ManualClock;
use model::MemoryStore;

/// A store, and another way to its objects.
struct Kind {
    chunks: ObjectChunks,
    objects: Arc<dyn ObjectStore>,
    _folder: Option<tempfile::TempDir>,
}

impl Kind {
    fn memory() -> Self {
        let objects: Arc<dyn ObjectStore> = Arc::new(InMemory::new());
        Self { chunks: ObjectChunks::over(objects.clone()), objects, _folder: None }
    }

    fn files() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let place = ChunksPlace::Folder(folder.path().join("chunks"));
        let chunks = ObjectChunks::open(&place).unwrap();
        let objects = Arc::new(LocalFileSystem::new_with_prefix(folder.path().join("chunks")).unwrap());
        Self { chunks, objects, _folder: Some(folder) }
    }

    fn s3() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let prefix = format!("test/{}", COUNT.fetch_add(1, Ordering::Relaxed));
        let settings = parts::s3::server().settings();
        let chunks = ObjectChunks::in_s3(parts::s3::BUCKET, &prefix, settings.clone()).unwrap();
        let mut raw = AmazonS3Builder::new().with_bucket_name(parts::s3::BUCKET).with_allow_http(true);
        for (name, value) in settings {
            raw = raw.with_config(name.to_lowercase().parse::<AmazonS3ConfigKey>().unwrap(), value);
        }
        let objects = Arc::new(PrefixStore::new(raw.build().unwrap(), Path::from(prefix)));
        Self { chunks, objects, _folder: None }
    }

    fn path(digest: Digest) -> Path {
        let hex = digest.to_string();
        Path::from(format!("{}/{}", &hex[..2], &hex[2..]))
    }

    /// Puts other bytes in the place of a chunk's.
    async fn damage(&self, digest: Digest, bytes: &[u8]) {
        self.objects.put(&Self::path(digest), bytes.to_vec().into()).await.unwrap();
    }

    /// Objects of the store, under any name.
    async fn all_objects(&self) -> Vec<Path> {
        self.objects.list(None).map_ok(|meta| meta.location).try_collect().await.unwrap()
    }
}

macro_rules! suite {
    ($($test:ident)+) => {
        mod memory { $(#[tokio::test] async fn $test() { crate::$test(crate::Kind::memory()).await; })+ }
        mod files { $(#[tokio::test] async fn $test() { crate::$test(crate::Kind::files()).await; })+ }
        mod s3 { $(#[tokio::test] async fn $test() { crate::$test(crate::Kind::s3()).await; })+ }
    };
}

suite! {
    bytes_come_back_whole_and_in_ranges
    empty_chunk_is_a_chunk
    long_stream_is_stored_in_parts
    concurrent_uploads_of_the_same_bytes_all_succeed
    truncated_chunk_is_mended_by_the_next_upload
    damaged_chunk_is_not_served_as_whole
    wrong_broken_and_oversized_streams_leave_nothing
    more_chunks_than_one_page_are_listed
    generations_are_stored_beside_each_other
    scene_is_put_together_from_parts_that_are_cleared_away_later
}

fn pieces(count: usize, piece_bytes: usize) -> (Digest, u64, ByteStream) {
    let pieces: Vec<Bytes> = (0..count).map(|i| Bytes::from(vec![i as u8; piece_bytes])).collect();
    let whole = pieces.concat();
    let stream = futures::stream::iter(pieces.into_iter().map(Ok)).boxed();
    (Digest::of(&whole), whole.len() as u64, stream)
}

async fn read(
    chunks: &ObjectChunks,
    digest: Digest,
    range: std::ops::Range<u64>,
) -> Result<Vec<u8>, ChunkError> {
    let pieces: Vec<Bytes> = chunks.get_range(digest.into(), range).await?.try_collect().await?;
    Ok(pieces.concat())
}

async fn bytes_come_back_whole_and_in_ranges(kind: Kind) {
    let chunks = &kind.chunks;
    let bytes = Bytes::from_static(b"0123456789");
    let digest = Digest::of(&bytes);
    assert_eq!(chunks.head(digest.into()).await.unwrap(), None);
    assert!(chunks.put_if_absent(digest.into(), bytes.clone()).await.unwrap().is_new);
    assert!(!chunks.put_if_absent(digest.into(), bytes.clone()).await.unwrap().is_new);
    assert_eq!(chunks.head(digest.into()).await.unwrap(), Some(10));
    assert_eq!(chunks.get(digest.into(), 10).await.unwrap(), bytes);
    assert!(matches!(chunks.get(digest.into(), 9).await, Err(ChunkError::TooLarge { limit: 9 })));
    assert_eq!(read(chunks, digest, 3..7).await.unwrap(), b"3456");
    assert_eq!(read(chunks, digest, 0..10).await.unwrap(), b"0123456789");
    let listed: Vec<Listed> = chunks.list().try_collect().await.unwrap();
    assert_eq!(
        listed.iter().map(|chunk| (chunk.name, chunk.bytes)).collect::<Vec<_>>(),
        [(digest.into(), 10)]
    );
    chunks.delete(digest.into()).await.unwrap();
    chunks.delete(digest.into()).await.unwrap();
    assert!(matches!(chunks.get(digest.into(), 10).await, Err(ChunkError::NotFound { .. })));
    assert!(matches!(read(chunks, digest, 3..7).await, Err(ChunkError::NotFound { .. })));
}

async fn empty_chunk_is_a_chunk(kind: Kind) {
    let digest = Digest::of(b"");
    assert!(kind.chunks.put_if_absent(digest.into(), Bytes::new()).await.unwrap().is_new);
    assert_eq!(kind.chunks.head(digest.into()).await.unwrap(), Some(0));
    assert_eq!(kind.chunks.get(digest.into(), 0).await.unwrap(), Bytes::new());
    assert_eq!(read(&kind.chunks, digest, 0..0).await.unwrap(), b"");
}

async fn long_stream_is_stored_in_parts(kind: Kind) {
    let (digest, length, stream) = pieces(20, 1 << 20);
    let stored = kind.chunks.put_stream(digest.into(), stream, length).await.unwrap();
    assert_eq!(stored, Stored { is_new: true, bytes: length });
    assert_eq!(Digest::of(&kind.chunks.get(digest.into(), length).await.unwrap()), digest);
    assert_eq!(Digest::of(&read(&kind.chunks, digest, 0..length).await.unwrap()), digest);
    assert_eq!(kind.all_objects().await, [Kind::path(digest)]);
    let (_, _, again) = pieces(20, 1 << 20);
    assert!(!kind.chunks.put_stream(digest.into(), again, length).await.unwrap().is_new);
}

async fn concurrent_uploads_of_the_same_bytes_all_succeed(kind: Kind) {
    let uploads = (0..4).map(|_| {
        let (digest, length, stream) = pieces(9, 1 << 20);
        kind.chunks.put_stream(digest.into(), stream, length)
    });
    let stored = futures::future::try_join_all(uploads).await.unwrap();
    assert!(stored.iter().all(|stored| stored.bytes == 9 << 20));
    let (digest, length, _) = pieces(9, 1 << 20);
    assert_eq!(Digest::of(&kind.chunks.get(digest.into(), length).await.unwrap()), digest);
    assert_eq!(kind.all_objects().await, [Kind::path(digest)]);
}

async fn truncated_chunk_is_mended_by_the_next_upload(kind: Kind) {
    for count in [1, 10] {
        let (digest, length, stream) = pieces(count, 1 << 20);
        kind.chunks.put_stream(digest.into(), stream, length).await.unwrap();
        kind.damage(digest, b"the beginning alone").await;
        let (_, _, again) = pieces(count, 1 << 20);
        let stored = kind.chunks.put_stream(digest.into(), again, length).await.unwrap();
        assert_eq!(stored, Stored { is_new: true, bytes: length });
        assert_eq!(Digest::of(&kind.chunks.get(digest.into(), length).await.unwrap()), digest);
    }
}

async fn damaged_chunk_is_not_served_as_whole(kind: Kind) {
    let (digest, length, stream) = pieces(4, 1 << 20);
    kind.chunks.put_stream(digest.into(), stream, length).await.unwrap();
    let mut bytes = kind.chunks.get(digest.into(), length).await.unwrap().to_vec();
    bytes[3 << 19] ^= 1;
    kind.damage(digest, &bytes).await;
    assert!(matches!(kind.chunks.get(digest.into(), length).await, Err(ChunkError::Damaged { .. })));
    let mut stream = kind.chunks.get_range(digest.into(), 0..length).await.unwrap();
    let mut served = 0;
    let error = loop {
        match stream.next().await.expect("an error before the end") {
            Ok(piece) => served += piece.len() as u64,
            Err(error) => break error,
        }
    };
    assert!(matches!(error, ChunkError::Damaged { .. }) && served < length, "{served} bytes, {error}");
}

async fn wrong_broken_and_oversized_streams_leave_nothing(kind: Kind) {
    for count in [1, 20] {
        let (right, length, stream) = pieces(count, 1 << 20);
        let wrong = Digest::of(b"other");
        let error = kind.chunks.put_stream(wrong.into(), stream, length).await.unwrap_err();
        assert!(matches!(error, ChunkError::DigestMismatch { .. }), "{error}");
        let (_, _, stream) = pieces(count, 1 << 20);
        let error = kind.chunks.put_stream(right.into(), stream, length - 1).await.unwrap_err();
        assert!(matches!(error, ChunkError::TooLarge { .. }), "{error}");
        let (_, _, stream) = pieces(count, 1 << 20);
        let broken = futures::stream::once(async { Err(ChunkError::Broken("cut".into())) });
        let error =
            kind.chunks.put_stream(right.into(), stream.chain(broken).boxed(), length).await.unwrap_err();
        assert!(matches!(error, ChunkError::Broken(_)), "{error}");
        let error = kind.chunks.put_if_absent(wrong.into(), Bytes::from_static(b"bytes")).await.unwrap_err();
        assert!(matches!(error, ChunkError::DigestMismatch { .. }), "{error}");
        assert_eq!(kind.chunks.head(right.into()).await.unwrap(), None);
        assert_eq!(kind.all_objects().await, []);
    }
}

async fn more_chunks_than_one_page_are_listed(kind: Kind) {
    let digests: Vec<Digest> = (0_u32..1_010).map(|number| Digest::of(&number.to_le_bytes())).collect();
    let put = |number: u32| {
        let bytes = Bytes::copy_from_slice(&number.to_le_bytes());
        kind.chunks.put_if_absent(digests[number as usize].into(), bytes)
    };
    let puts = futures::stream::iter((0..1_010).map(put)).buffer_unordered(8);
    let puts: Vec<Stored> = puts.try_collect().await.unwrap();
    assert!(puts.iter().all(|stored| stored.is_new));
    // A name that is no digest is nobody's chunk.
    kind.objects.put(&Path::from("notes/readme"), b"hello".to_vec().into()).await.unwrap();
    let listed: Vec<Listed> = kind.chunks.list().try_collect().await.unwrap();
    let mut listed: Vec<_> = listed.into_iter().map(|chunk| (chunk.name.digest, chunk.bytes)).collect();
    listed.sort();
    let mut wanted: Vec<_> = digests.into_iter().map(|digest| (digest, 4)).collect();
    wanted.sort();
    assert_eq!(listed, wanted);
}

async fn generations_are_stored_beside_each_other(kind: Kind) {
    let chunks = &kind.chunks;
    let bytes = Bytes::from_static(b"0123456789");
    let first = ChunkName::from(Digest::of(&bytes));
    let (second, third) = (ChunkName::fresh(first.digest), ChunkName::fresh(first.digest));
    assert_ne!(second, third);
    for name in [first, second] {
        assert!(chunks.put_if_absent(name, bytes.clone()).await.unwrap().is_new);
    }
    assert_eq!(chunks.head(third).await.unwrap(), None);
    chunks.delete(first).await.unwrap();
    assert_eq!(chunks.get(second, 10).await.unwrap(), bytes);
    let listed: Vec<Listed> = chunks.list().try_collect().await.unwrap();
    assert_eq!(listed.iter().map(|chunk| chunk.name).collect::<Vec<_>>(), [second]);
    assert!(listed[0].written_ms > 1_600_000_000_000, "{}", listed[0].written_ms);
}

async fn scene_is_put_together_from_parts_that_are_cleared_away_later(kind: Kind) {
    let clock = Arc::new(ManualClock::at(1_000_000));
    let store = Arc::new(MemoryStore::new(clock.clone()));
    let chunks = Arc::new(kind.chunks);
    let storage = Storage::new(store.clone(), chunks.clone(), None);
    let (_closing, closing) = tokio::sync::watch::channel(false);
    let wakeup = Arc::new(LocalWakeup::default());
    let farm =
        Arc::new(Farm::new(store, storage, wakeup, parts::kind::kinds(), Duration::from_secs(1), closing));
    // Enough for several pieces as the store writes them.
    let pieces: Vec<Bytes> = (0..6).map(|i| Bytes::from(vec![i as u8; 3 << 20])).collect();
    let scene = Digest::of(&pieces.concat());
    let part = |piece: &Bytes| ScenePart { digest: Digest::of(piece), bytes: piece.len() as u64 };
    let parts = SceneParts { parts: pieces.iter().map(part).collect() };
    for (number, piece) in pieces.iter().enumerate() {
        let progress = farm.put_scene_together(scene, parts.clone()).await.unwrap();
        assert_eq!((progress.is_stored, progress.missing.len()), (false, pieces.len() - number));
        farm.storage.put(Digest::of(piece), piece.clone()).await.unwrap();
    }
    // Who asks beside each other, as after a connection that was cut, gets the same scene.
    let calls = (0..3).map(|_| farm.put_scene_together(scene, parts.clone()));
    for progress in futures::future::try_join_all(calls).await.unwrap() {
        assert_eq!(progress, SceneProgress { is_stored: true, missing: vec![] });
    }
    assert_eq!(kind.objects.list(None).count().await, pieces.len() + 1);
    let stream = farm.storage.read(scene, 0..18 << 20).await.unwrap();
    let read: Vec<Bytes> = stream.try_collect().await.unwrap();
    assert_eq!(Digest::of(&read.concat()), scene);
    // Parts, and a scene that no bake asked for, go like all that nobody needs.
    clock.advance_ms(1_000);
    let rules = CollectRules { grace_ms: 1_000, keep_bakes_ms: None, max: 100 };
    assert_eq!(farm.collect(&rules).await.unwrap().chunks, pieces.len() as u64 + 1);
    assert_eq!(kind.objects.list(None).count().await, 0);
    assert_eq!(farm.put_scene_together(scene, parts).await.unwrap().missing.len(), pieces.len());
}

/// No file of a broken upload stays in the folder, not even one that is hidden from listings.
#[tokio::test]
async fn folder_keeps_no_stages_of_broken_uploads() {
    let folder = tempfile::tempdir().unwrap();
    let chunks = ObjectChunks::in_folder(folder.path()).unwrap();
    let (_, length, stream) = pieces(20, 1 << 20);
    chunks.put_stream(Digest::of(b"other").into(), stream, length).await.unwrap_err();
    let mut folders = vec![folder.path().to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            assert!(path.is_dir(), "{} was left behind", path.display());
            folders.push(path);
        }
    }
}

#[tokio::test]
async fn store_that_is_away_is_unavailable() {
    let port = parts::keeper::free_port();
    let settings = [
        ("AWS_ENDPOINT_URL", format!("http://127.0.0.1:{port}")),
        ("AWS_ACCESS_KEY_ID", "kiln".to_owned()),
        ("AWS_SECRET_ACCESS_KEY", "kiln".to_owned()),
    ];
    let settings = settings.map(|(name, value)| (name.to_owned(), value));
    let chunks = ObjectChunks::in_s3("farm", "", settings).unwrap();
    let error = chunks.head(Digest::of(b"").into()).await.unwrap_err();
    assert!(matches!(error, ChunkError::Unavailable(_)), "{error}");
}
