//! Chunks and scenes.

use lightkiln_proto::api::{
    MAX_SCENE_PART_BYTES, MAX_SCENE_PARTS, ScenePart, SceneParts, SceneProgress, SceneStored,
};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::problem::ProblemCode;

use lightkiln_server::Config;

use crate::bakes::{run, submit};
use crate::support::{start, start_config, start_in};

#[tokio::test]
async fn chunk_is_stored_once_and_served_for_ever() {
    let server = start().await;
    let bytes: Vec<u8> = (0..100_000_u32).map(|i| i as u8).collect();
    let digest = Digest::of(&bytes);
    let path = format!("/v1/chunks/{digest}");
    server.get(&path).await.problem(ProblemCode::NotFound);
    assert_eq!(server.call("HEAD", &path, &[], b"").await.status, 404);
    assert_eq!(server.call("PUT", &path, &[], &bytes).await.status, 201);
    assert_eq!(server.call("PUT", &path, &[], &bytes).await.status, 200);
    for method in ["GET", "HEAD"] {
        let answer = server.call(method, &path, &[], b"").await;
        assert_eq!(answer.status, 200);
        assert_eq!(answer.header("etag"), Some(format!("\"{digest}\"").as_str()));
        assert_eq!(answer.header("cache-control"), Some("public, max-age=31536000, immutable"));
        assert_eq!(answer.header("content-length"), Some("100000"));
        assert_eq!(answer.header("accept-ranges"), Some("bytes"));
        assert!(method == "HEAD" || answer.body == bytes);
        // Bytes that a token opened are for no cache that callers share.
        let opened = server.call(method, &path, &[("Authorization", "Bearer any")], b"").await;
        assert_eq!(opened.header("cache-control"), Some("private, max-age=31536000, immutable"));
    }
}

#[tokio::test]
async fn chunk_is_served_in_ranges() {
    let server = start().await;
    let digest = server.put_chunk(b"0123456789").await;
    let path = format!("/v1/chunks/{digest}");
    let etag = format!("\"{digest}\"");
    for (range, content_range, body) in [
        ("bytes=2-4", "bytes 2-4/10", "234"),
        ("bytes=7-", "bytes 7-9/10", "789"),
        ("bytes=-1", "bytes 9-9/10", "9"),
    ] {
        let answer = server.call("GET", &path, &[("Range", range)], b"").await;
        assert_eq!((answer.status, answer.header("content-range")), (206, Some(content_range)));
        assert_eq!(answer.body, body.as_bytes());
    }
    let outside = server.call("GET", &path, &[("Range", "bytes=10-")], b"").await;
    outside.problem(ProblemCode::RangeNotSatisfiable);
    assert_eq!(outside.header("content-range"), Some("bytes */10"));
    let same = server.call("GET", &path, &[("Range", "bytes=0-0"), ("If-Range", &etag)], b"").await;
    assert_eq!((same.status, same.body.as_slice()), (206, &b"0"[..]));
    let other = server.call("GET", &path, &[("Range", "bytes=0-0"), ("If-Range", "\"x\"")], b"").await;
    assert_eq!((other.status, other.body.len()), (200, 10));
    let known = server.call("GET", &path, &[("If-None-Match", &etag)], b"").await;
    assert_eq!((known.status, known.body.len()), (304, 0));
}

#[tokio::test]
async fn scene_is_negotiated_by_digest() {
    let server = start().await;
    let scene = vec![7_u8; 20 << 20];
    let digest = Digest::of(&scene);
    let path = format!("/v1/scenes/{digest}");
    assert_eq!(server.call("HEAD", &path, &[], b"").await.status, 404);
    let stored: SceneStored = server.call("PUT", &path, &[], &scene).await.json(201);
    assert_eq!(stored.bytes, 20 << 20);
    assert_eq!(server.call("HEAD", &path, &[], b"").await.status, 200);
    server.call("PUT", &path, &[], &scene).await.json::<SceneStored>(200);
    assert_eq!(Digest::of(&server.get(&format!("/v1/chunks/{digest}")).await.body), digest);
}

/// The list of a scene's parts.
fn parts_of(scene: &[u8], size: usize) -> SceneParts {
    let part = |bytes: &[u8]| ScenePart { digest: Digest::of(bytes), bytes: bytes.len() as u64 };
    SceneParts { parts: scene.chunks(size).map(part).collect() }
}

#[tokio::test]
async fn scene_in_parts_goes_on_where_it_stopped_also_on_another_server() {
    let mut server = start().await;
    // Two parts are the same.
    let mut scene: Vec<u8> = (0..1_000_u32).flat_map(u32::to_le_bytes).collect();
    scene.extend_from_within(..1_000);
    let parts = parts_of(&scene, 1_000);
    assert_eq!(parts.parts.len(), 5);
    let digest = Digest::of(&scene);
    let together = format!("/v1/scenes/{digest}/parts");
    for (number, piece) in scene.chunks(1_000).take(4).enumerate() {
        let progress: SceneProgress = server.post(&together, &parts).await.json(200);
        assert!(!progress.is_stored && progress.missing.len() == 4 - number, "{progress:?}");
        let path = format!("/v1/scene-parts/{}", Digest::of(piece));
        assert!(progress.missing.contains(&Digest::of(piece)));
        // An upload that breaks off leaves nothing of the part.
        let cut = [("Content-Length", "1000")];
        let broken = server.open("PUT", &path, &cut, &piece[..500]).await;
        drop(broken);
        assert_eq!(server.call("PUT", &path, &[], piece).await.status, 201);
        server = start_in(server.stop().await).await;
    }
    assert_eq!(server.call("HEAD", &format!("/v1/scenes/{digest}"), &[], b"").await.status, 404);
    for _ in 0..2 {
        let progress: SceneProgress = server.post(&together, &parts).await.json(200);
        assert_eq!(progress, SceneProgress { is_stored: true, missing: vec![] });
    }
    assert_eq!(server.get(&format!("/v1/chunks/{digest}")).await.body, scene);
}

#[tokio::test]
async fn parts_that_make_other_bytes_or_are_damaged_make_no_scene() {
    let server = start().await;
    let scene: Vec<u8> = (0..1_000_u32).flat_map(u32::to_le_bytes).collect();
    let mut parts = parts_of(&scene, 1_000);
    let digest = Digest::of(&scene);
    let together = format!("/v1/scenes/{digest}/parts");
    for piece in scene.chunks(1_000) {
        server.call("PUT", &format!("/v1/scene-parts/{}", Digest::of(piece)), &[], piece).await;
    }
    parts.parts.swap(0, 1);
    server.post(&together, &parts).await.problem(ProblemCode::DigestMismatch);
    assert_eq!(server.call("HEAD", &format!("/v1/scenes/{digest}"), &[], b"").await.status, 404);
    parts.parts.swap(0, 1);
    // The disk is at fault: the part is given up, missing from then on, and mended by uploading it again.
    let damaged = parts.parts[2].digest;
    std::fs::write(server.chunk_file(damaged), [b'x'; 1_000]).unwrap();
    server.post(&together, &parts).await.problem(ProblemCode::Internal);
    let progress: SceneProgress = server.post(&together, &parts).await.json(200);
    assert_eq!(progress.missing, [damaged]);
    let path = format!("/v1/scene-parts/{damaged}");
    assert_eq!(server.call("PUT", &path, &[], &scene[2_000..3_000]).await.status, 201);
    assert!(server.post(&together, &parts).await.json::<SceneProgress>(200).is_stored);
}

#[tokio::test]
async fn lists_of_parts_have_limits() {
    let server = start().await;
    let together = format!("/v1/scenes/{}/parts", Digest::of(b"scene"));
    let part = |bytes| ScenePart { digest: Digest::of(b"part"), bytes };
    for (parts, code) in [
        (vec![], ProblemCode::BadRequest),
        (vec![part(0)], ProblemCode::BadRequest),
        (vec![part(MAX_SCENE_PART_BYTES + 1)], ProblemCode::BadRequest),
        (vec![part(1), part(2)], ProblemCode::BadRequest),
        (vec![part(1); MAX_SCENE_PARTS + 1], ProblemCode::BadRequest),
        (vec![part(MAX_SCENE_PART_BYTES); 33], ProblemCode::TooLarge),
    ] {
        server.post(&together, &SceneParts { parts }).await.problem(code);
    }
    let long = (MAX_SCENE_PART_BYTES + 1).to_string();
    let path = format!("/v1/scene-parts/{}", Digest::of(b"part"));
    let refused = server.call("PUT", &path, &[("Content-Length", &long)], b"").await;
    refused.problem(ProblemCode::TooLarge);
}

#[tokio::test]
async fn wrong_bytes_are_refused_and_not_kept() {
    let server = start().await;
    let digest = Digest::of(b"right");
    for path in [format!("/v1/chunks/{digest}"), format!("/v1/scenes/{digest}")] {
        server.call("PUT", &path, &[], b"wrong").await.problem(ProblemCode::DigestMismatch);
        assert_eq!(server.call("HEAD", &path, &[], b"").await.status, 404);
    }
}

#[tokio::test]
async fn empty_chunk_is_a_chunk() {
    let server = start().await;
    let digest = server.put_chunk(b"").await;
    let answer = server.get(&format!("/v1/chunks/{digest}")).await;
    assert_eq!((answer.status, answer.body.len()), (200, 0));
}

#[tokio::test]
async fn upload_beyond_the_quota_is_refused_until_there_is_room() {
    let folder = tempfile::tempdir().unwrap();
    let config = Config { quota_bytes: Some(10), ..Config::new(folder.path()) };
    let server = start_config(folder, |_| config).await;
    let first = server.put_chunk(b"0123456789").await;
    let more = Digest::of(b"more");
    let refused = server.call("PUT", &format!("/v1/chunks/{more}"), &[], b"more").await;
    let problem = refused.problem(ProblemCode::StorageFull);
    assert_eq!(problem.status, 507);
    assert!(problem.detail.contains("10 bytes are stored, and 4 more"), "{}", problem.detail);
    assert_eq!(server.call("HEAD", &format!("/v1/chunks/{more}"), &[], b"").await.status, 404);
    assert_eq!(server.get(&format!("/v1/chunks/{first}")).await.body, b"0123456789");
    let folder = server.stop().await;
    let config = Config { quota_bytes: Some(14), ..Config::new(folder.path()) };
    let server = start_config(folder, |_| config).await;
    assert_eq!(server.put_chunk(b"more").await, more);
}

#[tokio::test]
async fn deleted_bake_is_gone_and_a_live_one_is_not_deleted() {
    let server = start().await;
    let bake = submit(&server).await;
    let path = format!("/v1/bakes/{}", bake.id);
    server.call("DELETE", &path, &[], b"").await.problem(ProblemCode::StateConflict);
    run(&server).await;
    assert_eq!(server.call("DELETE", &path, &[], b"").await.status, 204);
    server.get(&path).await.problem(ProblemCode::NotFound);
    server.call("DELETE", &path, &[], b"").await.problem(ProblemCode::NotFound);
}
