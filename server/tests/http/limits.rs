//! Calls beyond the limits are refused at once, and told when to come again.

use lightkiln_proto::problem::ProblemCode;
use lightkiln_server::access::Scope;
use lightkiln_server::{Config, LimitConfig, Pages};

use crate::access::make;
use crate::bakes::request;
use crate::support::{Answer, Running, start_config, start_with};

async fn list(server: &Running, token: Option<&str>) -> Answer {
    let bearer = token.map(|token| format!("Bearer {token}"));
    let headers: Vec<_> = bearer.iter().map(|value| ("Authorization", value.as_str())).collect();
    server.call("GET", "/v1/bakes", &headers, b"").await
}

fn assert_too_many(answer: &Answer, told: &str) {
    let detail = answer.problem(ProblemCode::TooManyRequests).detail;
    assert!(detail.contains(told), "{detail}");
    assert_eq!(answer.status, 429);
    let secs: u64 = answer.header("retry-after").unwrap().parse().unwrap();
    assert!((1..=60).contains(&secs), "{secs}");
}

#[tokio::test]
async fn caller_that_calls_too_often_is_told_when_to_come_again_and_others_are_served() {
    let folder = tempfile::tempdir().unwrap();
    let [one, two] = [make(folder.path(), Scope::Read).await, make(folder.path(), Scope::Submit).await];
    let server = start_with(folder, LimitConfig { calls_per_sec: 1, ..LimitConfig::default() }).await;
    let mut refused = None;
    // Two at once are let through, and one more each second: twenty calls do not take twenty seconds.
    for _ in 0..20 {
        let answer = list(&server, Some(&one)).await;
        if answer.status != 200 {
            refused = Some(answer);
            break;
        }
    }
    assert_too_many(&refused.expect("twenty calls are too many"), "--calls-per-sec");
    assert_eq!(list(&server, Some(&two)).await.status, 200, "another token at the same address");
    let mut statuses = Vec::new();
    for _ in 0..20 {
        statuses.push(list(&server, Some("kiln_guess")).await.status);
    }
    assert!(
        statuses.contains(&401) && statuses.contains(&429),
        "guesses are counted by address: {statuses:?}"
    );
    for _ in 0..20 {
        assert_eq!(server.get("/readyz").await.status, 200, "health is told however often it is asked for");
    }
    let mut statuses = Vec::new();
    for _ in 0..20 {
        statuses.push(server.get("/v1/none").await.status);
    }
    assert!(statuses.contains(&429), "what there is not is counted, too: {statuses:?}");
}

#[tokio::test]
async fn files_for_browsers_are_not_counted() {
    let pages = Pages::default().with("/", "<!doctype html>").with("/web/a.js", "export {};");
    let limits = LimitConfig { calls_per_sec: 1, ..LimitConfig::default() };
    let server =
        start_config(tempfile::tempdir().unwrap(), |config| Config { pages, limits, ..config }).await;
    for _ in 0..20 {
        for path in ["/", "/web/a.js"] {
            assert_eq!(server.get(path).await.status, 200, "{path}");
        }
    }
    assert_eq!(list(&server, None).await.status, 200, "the caller has all of its calls left");
    let mut statuses = Vec::new();
    for _ in 0..20 {
        statuses.push(server.call("POST", "/", &[], b"").await.status);
    }
    assert!(statuses.contains(&429), "other methods are counted: {statuses:?}");
}

#[tokio::test]
async fn call_beyond_those_that_are_let_in_at_a_time_is_refused_until_one_has_ended() {
    let limits = LimitConfig { calls_at_a_time: 1, ..LimitConfig::default() };
    let server = start_with(tempfile::tempdir().unwrap(), limits).await;
    let claim = serde_json::to_vec(&request(30)).unwrap();
    // A worker that waits for work has the one place.
    let waiting = server.open("POST", "/v1/leases", &[("Content-Type", "application/json")], &claim).await;
    let refused = async {
        loop {
            let answer = list(&server, None).await;
            if answer.status != 200 {
                return answer;
            }
        }
    };
    let refused = tokio::time::timeout(std::time::Duration::from_secs(20), refused).await.unwrap();
    assert_too_many(&refused, "--calls-at-a-time");
    assert_eq!(server.get("/healthz").await.status, 200);
    drop(waiting);
    let served = async { while list(&server, None).await.status != 200 {} };
    tokio::time::timeout(std::time::Duration::from_secs(20), served).await.unwrap();
}
