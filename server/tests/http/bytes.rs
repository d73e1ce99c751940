//! Chunks and scenes.

use lightkiln_proto::api::SceneStored;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::problem::ProblemCode;

use lightkiln_server::Config;

use crate::bakes::{run, submit};
use crate::support::{start, start_config};

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
