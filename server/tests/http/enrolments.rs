//! Codes that workers exchange for tokens.

use lightkiln_proto::api::{Enrolled, Enrolment};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::problem::ProblemCode;
use lightkiln_server::access::{NewBearer, Scope};
use lightkiln_server::open_store;
use lightkiln_server::store::FarmStore;

use crate::bakes::request;
use crate::support::{Answer, Running, start_in};

/// A server and a code for a worker of that name.
async fn with_code(worker: &str) -> (Running, String) {
    let folder = tempfile::tempdir().unwrap();
    let store = open_store(folder.path(), None).await.unwrap();
    let new = NewBearer::code_for(worker).unwrap();
    store.add_bearer(&new.name, new.hash(), &[Scope::Enrol].into()).await.unwrap();
    store.close().await;
    (start_in(folder).await, new.token)
}

async fn post(server: &Running, path: &str, bearer: &str, body: Vec<u8>) -> Answer {
    let bearer = format!("Bearer {bearer}");
    let headers = [("Authorization", bearer.as_str()), ("Content-Type", "application/json")];
    server.call("POST", path, &headers, &body).await
}

async fn enrol(server: &Running, code: &str, token: &str) -> Answer {
    let body = serde_json::to_vec(&Enrolment { token: Digest::of(token.as_bytes()) }).unwrap();
    post(server, "/v1/enrolments", code, body).await
}

async fn claim_status(server: &Running, token: &str) -> u16 {
    post(server, "/v1/leases", token, serde_json::to_vec(&request(0)).unwrap()).await.status
}

#[tokio::test]
async fn code_is_good_for_one_token_however_often_the_call_is_tried() {
    let (server, code) = with_code("oven").await;
    assert_eq!(claim_status(&server, &code).await, 403, "a code is no token");
    for _ in 0..2 {
        let enrolled: Enrolled = enrol(&server, &code, "mine").await.json(200);
        assert_eq!(enrolled.name, "oven");
    }
    let refused = enrol(&server, &code, "another's").await.problem(ProblemCode::Unauthorized);
    assert!(refused.detail.contains("used before"), "{}", refused.detail);
    assert_eq!(claim_status(&server, "mine").await, 200, "the token is good as soon as the answer is there");
    assert_eq!(claim_status(&server, "another's").await, 401);
}

#[tokio::test]
async fn many_who_use_one_code_at_once_are_one_worker() {
    let (server, code) = with_code("oven").await;
    let tokens: Vec<String> = (0..8).map(|index| format!("token {index}")).collect();
    let answers = futures::future::join_all(tokens.iter().map(|token| enrol(&server, &code, token))).await;
    let enrolled = answers.iter().filter(|answer| answer.status == 200).count();
    let refused = answers.iter().filter(|answer| answer.status == 401).count();
    assert_eq!((enrolled, refused), (1, 7), "{answers:?}");
}

#[tokio::test]
async fn what_is_no_code_is_refused() {
    let (server, code) = with_code("oven").await;
    let store = open_store(server.folder.path(), None).await.unwrap();
    let admin = NewBearer::named("admin").unwrap();
    store.add_bearer(&admin.name, admin.hash(), &[Scope::Admin].into()).await.unwrap();
    enrol(&server, "kilncode_0000", "mine").await.problem(ProblemCode::Unauthorized);
    let known = async { while enrol(&server, &admin.token, "mine").await.status != 401 {} };
    tokio::time::timeout(std::time::Duration::from_secs(60), known).await.unwrap();
    let refused = enrol(&server, &admin.token, "mine").await.problem(ProblemCode::Unauthorized);
    assert!(refused.detail.contains("code"), "{}", refused.detail);
    let codes = store.bearers().await.unwrap();
    let code_name = &codes.iter().find(|bearer| bearer.name.starts_with("oven.code-")).unwrap().name;
    store.revoke_bearer(code_name).await.unwrap();
    enrol(&server, &code, "mine").await.problem(ProblemCode::Unauthorized);
    assert!(!store.bearers().await.unwrap().iter().any(|bearer| bearer.name == "oven"));
}

#[tokio::test]
async fn worker_whose_token_was_revoked_does_not_get_it_back_with_its_code() {
    let (server, code) = with_code("oven").await;
    let _: Enrolled = enrol(&server, &code, "mine").await.json(200);
    let store = open_store(server.folder.path(), None).await.unwrap();
    store.revoke_bearer("oven").await.unwrap();
    let refused = enrol(&server, &code, "mine").await.problem(ProblemCode::Unauthorized);
    assert!(refused.detail.contains("revoked"), "{}", refused.detail);
}
