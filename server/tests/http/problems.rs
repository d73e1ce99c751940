//! Every refusal is a problem.

use lightkiln_proto::api::ClaimRequest;
use lightkiln_proto::problem::ProblemCode;
use serde_json::json;

use crate::bakes::request;
use crate::support::start;

#[tokio::test]
async fn unknown_paths_and_methods_are_problems() {
    let server = start().await;
    for path in ["/", "/v1", "/v1/bakes/", "/v1/none", "/v1/leases/x/y/z", "/%00"] {
        server.get(path).await.problem(ProblemCode::NotFound);
    }
    for (method, path) in [
        ("DELETE", "/v1/bakes"),
        ("GET", "/v1/leases"),
        ("POST", "/healthz"),
        ("GET", "/v1/bakes/x/cancel"),
        ("POST", "/v1/chunks/x"),
    ] {
        let answer = server.call(method, path, &[], b"").await;
        answer.problem(ProblemCode::MethodNotAllowed);
        assert!(answer.header("allow").is_some(), "{method} {path}");
    }
}

#[tokio::test]
async fn malformed_parts_of_requests_are_problems() {
    let server = start().await;
    const JSON: &[(&str, &str)] = &[("Content-Type", "application/json")];
    type Case = (&'static str, &'static str, &'static [(&'static str, &'static str)], &'static [u8]);
    let cases: [Case; 11] = [
        ("GET", "/v1/chunks/abc", &[], b""),
        ("PUT", "/v1/scenes/%ff", &[], b""),
        ("GET", "/v1/bakes/%ff", &[], b""),
        ("POST", "/v1/bakes", JSON, b"{"),
        ("POST", "/v1/bakes", JSON, b"{}"),
        ("POST", "/v1/bakes", JSON, b"\xff"),
        ("POST", "/v1/bakes", &[("Content-Type", "text/plain")], b"{}"),
        ("POST", "/v1/leases", &[], b"{}"),
        ("GET", "/v1/bakes?limit=x", &[], b""),
        ("GET", "/v1/bakes?limit=0", &[], b""),
        ("GET", "/v1/bakes?unknown=1", &[], b""),
    ];
    for (method, path, headers, body) in cases {
        server.call(method, path, headers, body).await.problem(ProblemCode::BadRequest);
    }
    let with_nul: [(&str, &str, &[u8]); 3] = [
        ("GET", "/v1/bakes/a%00b", b""),
        ("GET", "/v1/bakes?after=%00", b""),
        (
            "POST",
            "/v1/leases",
            br#"{"worker":"a\u0000","kinds":[],"threads":1,"max":1,"ttl_secs":5,"wait_secs":0}"#,
        ),
    ];
    for (method, path, body) in with_nul {
        let problem = server.call(method, path, JSON, body).await.problem(ProblemCode::BadRequest);
        assert!(problem.detail.contains("U+0000"), "{}", problem.detail);
    }
    for path in [
        "/v1/bakes?after=none",
        "/v1/bakes?after=9223372036854775808",
        "/v1/bakes/x/events?after=9223372036854775808",
        "/v1/bakes/x/events?wait_secs=61",
        "/v1/bakes/x/results?after=-1",
        "/v1/bakes/x/results?after=9223372036854775808",
        "/v1/bakes/x/results?limit=0",
        "/v1/bakes/x/results?limit=501",
        "/v1/bakes/x/results?wait_secs=61",
        "/v1/bakes/x/results?kind=",
        "/v1/bakes/x/results?since=1",
    ] {
        server.get(path).await.problem(ProblemCode::BadRequest);
    }
}

#[tokio::test]
async fn oversized_bodies_are_refused() {
    let server = start().await;
    let digest = "0".repeat(64);
    let huge = [("Content-Type", "application/json"), ("Content-Length", "99999999999999")];
    for (method, path) in [
        ("POST", "/v1/bakes".to_owned()),
        ("POST", "/v1/leases".to_owned()),
        ("POST", format!("/v1/leases/{}/commit", "0".repeat(32))),
        ("PUT", format!("/v1/chunks/{digest}")),
        ("PUT", format!("/v1/scenes/{digest}")),
    ] {
        server.call(method, &path, &huge, b"").await.problem(ProblemCode::TooLarge);
    }
    // Without a length, the body is counted as it comes.
    let piece = format!("{:x}\r\n{}\r\n", 2 << 20, "x".repeat(2 << 20));
    let headers = [("Content-Type", "application/json"), ("Transfer-Encoding", "chunked")];
    let answer = server.call("POST", "/v1/bakes", &headers, piece.as_bytes()).await;
    answer.problem(ProblemCode::TooLarge);
}

#[tokio::test]
async fn leases_are_checked() {
    let server = start().await;
    server
        .post("/v1/leases/short/heartbeat", &json!({ "progress": 0.5 }))
        .await
        .problem(ProblemCode::NotFound);
    let heartbeat = format!("/v1/leases/{}/heartbeat", "0".repeat(32));
    let beat = server.post(&heartbeat, &json!({ "progress": 0.5 })).await;
    assert_eq!(beat.json::<serde_json::Value>(200)["verdict"], "lost");
    server.post(&heartbeat, &json!({ "progress": 2.0 })).await.problem(ProblemCode::BadRequest);
    let wrong: [fn(&mut ClaimRequest); 7] = [
        |claim| claim.worker.clear(),
        |claim| claim.max = 65,
        |claim| claim.max = 0,
        |claim| claim.ttl_secs = 4,
        |claim| claim.wait_secs = 61,
        |claim| claim.machine = "x".repeat(201),
        |claim| claim.kinds = vec!["x".into(); 65],
    ];
    for change in wrong {
        let mut claim = request(0);
        change(&mut claim);
        server.post("/v1/leases", &claim).await.problem(ProblemCode::BadRequest);
    }
}

#[tokio::test]
async fn counters_that_no_sum_can_hold_are_refused() {
    let server = start().await;
    let commit = format!("/v1/leases/{}/commit", "0".repeat(32));
    let many: serde_json::Map<_, _> = (0..257).map(|index| (format!("c{index}"), json!(1.0))).collect();
    for (counters, told) in [
        (json!({ "secs": 1e300 }), "'secs' must be within"),
        (json!({ "x".repeat(201): 1.0 }), "more than 200 bytes"),
        (many.into(), "at most 256"),
    ] {
        let result = json!({ "outputs": [], "plan": [], "counters": counters });
        let problem = server.post(&commit, &result).await.problem(ProblemCode::BadRequest);
        assert!(problem.detail.contains(told), "{}", problem.detail);
    }
}

#[tokio::test]
async fn result_with_a_missing_output_is_refused() {
    let server = start().await;
    let output = json!({ "name": "out", "digest": "0".repeat(64), "bytes": 1 });
    let commit = format!("/v1/leases/{}/commit", "0".repeat(32));
    let result = json!({ "outputs": [output], "plan": [] });
    let problem = server.post(&commit, &result).await.problem(ProblemCode::NotStored);
    assert!(problem.detail.contains("not stored"), "{}", problem.detail);
}
