//! Bearer tokens and their scopes.

use std::time::Duration;

use lightkiln_proto::ids::Digest;
use lightkiln_proto::problem::ProblemCode;
use lightkiln_server::access::{NewBearer, Scope};
use lightkiln_server::store::FarmStore;
use lightkiln_server::{Config, Server, open_store};
use serde_json::Value;

use crate::bakes::request;
use crate::support::{Answer, Running, start, start_in};

/// Longest that a change may take to be noticed, however busy the machine is.
const LIMIT: Duration = Duration::from_secs(60);

/// Makes a token, beside a server that may be running.
pub async fn make(folder: &std::path::Path, scope: Scope) -> String {
    let store = open_store(folder, None).await.unwrap();
    let new = NewBearer::named(scope.name()).unwrap();
    store.add_bearer(&new.name, new.hash(), &[scope].into()).await.unwrap();
    store.close().await;
    new.token
}

/// A call with a token, and with a body that its handler refuses.
async fn call(server: &Running, method: &str, path: &str, token: Option<&str>) -> Answer {
    let authorization = token.map(|token| format!("Bearer {token}"));
    let headers: Vec<_> = authorization.iter().map(|value| ("Authorization", value.as_str())).collect();
    server.call(method, path, &headers, b"").await
}

/// Method and path of every call in the API's description.
async fn all_calls(server: &Running) -> Vec<(String, String)> {
    let description: Value = server.get("/openapi.json").await.json(200);
    let digest = Digest::of(b"nothing").to_string();
    let mut calls = Vec::new();
    for (path, methods) in description["paths"].as_object().unwrap() {
        let path = path.replace("{digest}", &digest).replace("{id}", "none").replace("{token}", "none");
        let methods = methods.as_object().unwrap().keys();
        calls.extend(methods.map(|method| (method.to_uppercase(), path.clone())));
    }
    assert!(calls.len() > 20, "{calls:?}");
    calls
}

#[tokio::test]
async fn every_call_but_those_about_health_asks_for_a_token() {
    let folder = tempfile::tempdir().unwrap();
    let admin = make(folder.path(), Scope::Admin).await;
    let server = start_in(folder).await;
    let mut open = Vec::new();
    for (method, path) in all_calls(&server).await {
        for token in [None, Some("kiln_0000"), Some("")] {
            let answer = call(&server, &method, &path, token).await;
            if answer.status == 200 {
                open.push(path.clone());
                continue;
            }
            assert_eq!(
                (answer.status, answer.header("www-authenticate")),
                (401, Some("Bearer")),
                "{method} {path}"
            );
            if method != "HEAD" {
                let detail = answer.problem(ProblemCode::Unauthorized).detail;
                assert!(detail.contains("kiln token create"), "{detail}");
            }
        }
        let answer = call(&server, &method, &path, Some(&admin)).await;
        assert!(!matches!(answer.status, 401 | 403), "{method} {path} with an admin's token: {answer:?}");
    }
    open.dedup();
    assert_eq!(open, ["/healthz", "/openapi.json", "/readyz"]);
}

#[tokio::test]
async fn scope_opens_its_calls_and_no_others() {
    use Scope::{Read, Submit, Worker};
    let folder = tempfile::tempdir().unwrap();
    let mut tokens = Vec::new();
    for scope in [Read, Submit, Worker] {
        tokens.push((scope, make(folder.path(), scope).await));
    }
    let server = start_in(folder).await;
    let chunk = format!("/v1/chunks/{}", Digest::of(b"nothing"));
    let scene = format!("/v1/scenes/{}", Digest::of(b"nothing"));
    let evaluation_file = format!("/v1/bakes/none/evaluation/files/{}", Digest::of(b"nothing"));
    for (method, path, who) in [
        ("GET", "/v1/bakes", &[Read, Submit][..]),
        ("GET", "/v1/bakes/none/events", &[Read, Submit]),
        ("GET", "/v1/bakes/none/results", &[Read, Submit]),
        ("GET", "/v1/workers", &[Read, Submit]),
        ("GET", "/metrics", &[Read, Submit]),
        ("GET", &chunk, &[Read, Submit, Worker]),
        ("HEAD", &chunk, &[Read, Submit, Worker]),
        ("PUT", &chunk, &[Worker]),
        ("HEAD", &scene, &[Submit]),
        ("PUT", &scene, &[Submit]),
        ("POST", &format!("{scene}/parts"), &[Submit]),
        ("PUT", &format!("/v1/scene-parts/{}", Digest::of(b"nothing")), &[Submit]),
        ("POST", "/v1/bakes", &[Submit]),
        ("POST", "/v1/bakes/none/cancel", &[Submit]),
        ("GET", "/v1/bakes/none/evaluation", &[Read, Submit]),
        ("PUT", "/v1/bakes/none/evaluation", &[Submit]),
        ("GET", &evaluation_file, &[Read, Submit]),
        ("PUT", &evaluation_file, &[Submit]),
        ("POST", "/v1/leases", &[Worker]),
        ("POST", "/v1/leases/none/commit", &[Worker]),
        ("POST", "/v1/leases/commit", &[Worker]),
        ("POST", "/v1/enrolments", &[]),
        ("DELETE", "/v1/bakes", &[]),
    ] {
        for (scope, token) in &tokens {
            let answer = call(&server, method, path, Some(token)).await;
            assert_eq!(answer.status != 403, who.contains(scope), "{method} {path} as {scope}: {answer:?}");
            assert_ne!(answer.status, 401);
        }
    }
    let answer = call(&server, "POST", "/v1/leases", Some(&tokens[0].1)).await;
    let detail = answer.problem(ProblemCode::Forbidden).detail;
    assert!(detail.contains("worker"), "{detail}");
}

#[tokio::test]
async fn first_token_closes_a_running_farm_and_revoking_it_does_not_open_it() {
    let server = start().await;
    let claim = serde_json::to_vec(&request(0)).unwrap();
    let json = ("Content-Type", "application/json");
    assert_eq!(server.call("POST", "/v1/leases", &[json], &claim).await.status, 200);
    let token = make(server.folder.path(), Scope::Worker).await;
    wait_for(&server, None).await;
    let bearer = format!("Bearer {token}");
    let with_token = [json, ("Authorization", bearer.as_str())];
    assert_eq!(server.call("POST", "/v1/leases", &with_token, &claim).await.status, 200);
    let store = open_store(server.folder.path(), None).await.unwrap();
    store.revoke_bearer("worker").await.unwrap();
    wait_for(&server, Some(&token)).await;
    assert_eq!(server.call("POST", "/v1/leases", &[json], &claim).await.status, 401);
}

/// Waits until a token opens nothing.
async fn wait_for(server: &Running, token: Option<&str>) {
    let refused = async { while call(server, "POST", "/v1/leases", token).await.status != 401 {} };
    tokio::time::timeout(LIMIT, refused).await.unwrap();
}

#[tokio::test]
async fn address_that_others_can_reach_is_served_once_there_is_a_token() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::open(Config::new(folder.path())).await.unwrap();
    let refused = server.bind("0.0.0.0:0").await.unwrap_err();
    assert!(refused.to_string().contains("kiln token create"), "{refused}");
    make(folder.path(), Scope::Admin).await;
    server.bind("0.0.0.0:0").await.unwrap();
    let store = open_store(folder.path(), None).await.unwrap();
    store.revoke_bearer("admin").await.unwrap();
    server.bind("0.0.0.0:0").await.unwrap_err();
}
