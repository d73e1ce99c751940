//! Files for browsers.

use lightkiln_proto::ids::Digest;
use lightkiln_proto::problem::ProblemCode;
use lightkiln_server::access::Scope;
use lightkiln_server::{Config, Pages};

use crate::access::make;
use crate::support::{Running, start, start_config};

async fn server() -> Running {
    let pages = Pages::default()
        .with("/", "<!doctype html>")
        .with("/web/a/b.js", "export {};")
        .with("/web/LICENSE", "MIT");
    let folder = tempfile::tempdir().unwrap();
    make(folder.path(), Scope::Admin).await;
    start_config(folder, |config| Config { pages, ..config }).await
}

#[tokio::test]
async fn files_need_no_token_and_come_with_type_tag_and_policy() {
    let server = server().await;
    for (path, media_type, bytes) in [
        ("/", "text/html; charset=utf-8", &b"<!doctype html>"[..]),
        ("/web/a/b.js", "text/javascript; charset=utf-8", b"export {};"),
        ("/web/LICENSE", "text/plain; charset=utf-8", b"MIT"),
    ] {
        let etag = format!("\"{}\"", Digest::of(bytes));
        let (whole, head) = (server.get(path).await, server.call("HEAD", path, &[], b"").await);
        assert_eq!((whole.status, &whole.body[..], head.status), (200, bytes, 200), "{path}");
        for answer in [&whole, &head] {
            assert_eq!(answer.header("content-type"), Some(media_type));
            assert_eq!(answer.header("etag"), Some(etag.as_str()));
            assert_eq!(answer.header("x-content-type-options"), Some("nosniff"));
            let policy = answer.header("content-security-policy").unwrap();
            assert!(policy.contains("default-src 'none'") && !policy.contains("unsafe"), "{policy}");
        }
        let again = server.call("GET", path, &[("If-None-Match", etag.as_str())], b"").await;
        assert_eq!((again.status, again.body.len()), (304, 0), "{path}");
        let changed = server.call("GET", path, &[("If-None-Match", "\"other\"")], b"").await;
        assert_eq!(changed.status, 200);
    }
    assert_eq!(server.get("/v1/bakes").await.status, 401, "calls keep their tokens");
}

#[tokio::test]
async fn files_that_are_not_there_and_other_methods_are_problems() {
    let server = server().await;
    for path in ["/web/none.js", "/web/", "/web/a/../a/b.js", "/web/a%2fb.js", "/index.html"] {
        let answer = server.get(path).await;
        assert_eq!(answer.status, 404, "{path}");
        answer.problem(ProblemCode::NotFound);
    }
    assert_eq!(
        server.call("POST", "/", &[], b"").await.status,
        401,
        "who writes needs a token, even where nothing is written"
    );
    let without = start().await;
    assert_eq!(without.call("POST", "/", &[], b"").await.status, 405);
    assert_eq!(without.get("/").await.status, 404, "a server that was given none has none");
}
