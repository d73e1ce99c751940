//! Leases and bakes are those of the bearers who took or submitted them.

use lightkiln_proto::api::{
    Bake, ClaimAnswer, Commit, CommitAnswer, CommitOutcome, CommitVerdict, Commits, CommitsAnswer, Heartbeat,
    HeartbeatAnswer, TaskResult, Verdict,
};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::problem::ProblemCode;
use lightkiln_server::access::{NewBearer, Scope};
use lightkiln_server::open_store;
use lightkiln_server::store::FarmStore as _;
use serde::Serialize;
use serde_json::json;

use crate::bakes::{SCENE, new_bake, request};
use crate::support::{Answer, Running, start_in};

/// A farm with these bearers, and their tokens in that order.
async fn start_for<const N: usize>(bearers: [(&str, Scope); N]) -> (Running, [String; N]) {
    let folder = tempfile::tempdir().unwrap();
    let store = open_store(folder.path(), None).await.unwrap();
    let mut tokens = [const { String::new() }; N];
    for ((name, scope), token) in bearers.into_iter().zip(&mut tokens) {
        let new = NewBearer::named(name).unwrap();
        store.add_bearer(&new.name, new.hash(), &[scope].into()).await.unwrap();
        *token = new.token;
    }
    store.close().await;
    (start_in(folder).await, tokens)
}

async fn post(server: &Running, token: &str, path: &str, body: &impl Serialize) -> Answer {
    let (bearer, body) = (format!("Bearer {token}"), serde_json::to_vec(body).unwrap());
    server
        .call("POST", path, &[("Content-Type", "application/json"), ("Authorization", &bearer)], &body)
        .await
}

async fn submit(server: &Running, token: &str) -> Bake {
    let (bearer, scene) = (format!("Bearer {token}"), Digest::of(SCENE));
    let stored =
        server.call("PUT", &format!("/v1/scenes/{scene}"), &[("Authorization", &bearer)], SCENE).await;
    assert!(matches!(stored.status, 200 | 201), "{stored:?}");
    post(server, token, "/v1/bakes", &new_bake(scene, json!({}))).await.json(202)
}

#[tokio::test]
async fn lease_opens_for_the_bearer_that_claimed_it_alone() {
    let bearers =
        [("anna", Scope::Submit), ("oven", Scope::Worker), ("thief", Scope::Worker), ("chief", Scope::Admin)];
    let (server, [anna, oven, thief, chief]) = start_for(bearers).await;
    submit(&server, &anna).await;
    let claimed: ClaimAnswer = post(&server, &oven, "/v1/leases", &request(0)).await.json(200);
    let token = &claimed.leases[0].token;
    let call = |who: &str, what: &str, body: serde_json::Value| {
        let (who, path) = (who.to_owned(), format!("/v1/leases/{token}/{what}"));
        let server = &server;
        async move { post(server, &who, &path, &body).await }
    };
    // Not even a bearer who may do everything: it is not his attempt.
    for other in [&thief, &chief] {
        let answer: HeartbeatAnswer =
            call(other, "heartbeat", json!(Heartbeat { progress: 0.5 })).await.json(200);
        assert_eq!(answer.verdict, Verdict::Lost);
        let answer: CommitAnswer = call(other, "commit", json!(TaskResult::default())).await.json(200);
        assert_eq!(answer.verdict, CommitVerdict::Stale);
        assert_eq!(call(other, "release", json!({})).await.status, 204);
        assert_eq!(call(other, "fail", json!({ "blame": "task", "message": "theft" })).await.status, 204);
    }
    let answer: HeartbeatAnswer =
        call(&oven, "heartbeat", json!(Heartbeat { progress: 0.5 })).await.json(200);
    assert_eq!(answer.verdict, Verdict::Keep);
    for wanted in [CommitVerdict::Committed, CommitVerdict::AlreadyCommitted] {
        let answer: CommitAnswer = call(&oven, "commit", json!(TaskResult::default())).await.json(200);
        assert_eq!(answer.verdict, wanted);
    }
}

#[tokio::test]
async fn results_that_go_together_are_taken_from_the_bearer_that_claimed_each() {
    let bearers = [("anna", Scope::Submit), ("oven", Scope::Worker), ("thief", Scope::Worker)];
    let (server, [anna, oven, thief]) = start_for(bearers).await;
    submit(&server, &anna).await;
    let claimed: ClaimAnswer = post(&server, &oven, "/v1/leases", &request(0)).await.json(200);
    let commit = |token: &str| Commit { token: token.to_owned(), result: TaskResult::default() };
    let commits = Commits { commits: vec![commit(&claimed.leases[0].token), commit(&"0".repeat(32))] };
    let stale = CommitOutcome::Verdict(CommitVerdict::Stale);
    let path = "/v1/leases/commit";
    let answer: CommitsAnswer = post(&server, &thief, path, &commits).await.json(200);
    assert_eq!(answer.answers, [stale.clone(), stale.clone()]);
    post(&server, &anna, path, &commits).await.problem(ProblemCode::Forbidden);
    for verdict in [CommitVerdict::Committed, CommitVerdict::AlreadyCommitted] {
        let answer: CommitsAnswer = post(&server, &oven, path, &commits).await.json(200);
        assert_eq!(answer.answers, [CommitOutcome::Verdict(verdict), stale.clone()]);
    }
    // To the bearer whose it is not, a token that has committed is none.
    let answer: CommitsAnswer = post(&server, &thief, path, &commits).await.json(200);
    assert_eq!(answer.answers, [stale.clone(), stale]);
}

#[tokio::test]
async fn bake_is_changed_by_the_bearer_who_submitted_it_and_admins_alone() {
    let bearers = [("anna", Scope::Submit), ("bert", Scope::Submit), ("chief", Scope::Admin)];
    let (server, [anna, bert, chief]) = start_for(bearers).await;
    let bake = submit(&server, &anna).await;
    assert_eq!(bake.owner.as_deref(), Some("anna"));
    let path = format!("/v1/bakes/{}", bake.id);
    for what in ["cancel", "pause", "resume"] {
        let refused = post(&server, &bert, &format!("{path}/{what}"), &json!({})).await;
        let detail = refused.problem(ProblemCode::Forbidden).detail;
        assert!(detail.contains("'anna'") && detail.contains("'bert'"), "{detail}");
    }
    let refused = post(&server, &bert, &format!("{path}/priority"), &json!({ "priority": 9 })).await;
    refused.problem(ProblemCode::Forbidden);
    let file = format!("{path}/evaluation/files/{}", Digest::of(b"x"));
    for (method, path) in
        [("DELETE", path.as_str()), ("DELETE", &format!("{path}/blocklist")), ("PUT", &file)]
    {
        let bearer = format!("Bearer {bert}");
        let refused = server.call(method, path, &[("Authorization", &bearer)], b"x").await;
        refused.problem(ProblemCode::Forbidden);
    }
    let paused: Bake = post(&server, &anna, &format!("{path}/pause"), &json!({})).await.json(200);
    assert_eq!(paused.priority, 0);
    post(&server, &chief, &format!("{path}/resume"), &json!({})).await.json::<Bake>(200);
    post(&server, &anna, &format!("{path}/cancel"), &json!({})).await.json::<Bake>(200);
}
