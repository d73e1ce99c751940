//! Lists of bakes by filters, and bakes by beginnings of their ids.

use lightkiln_proto::api::{Bake, BakePage, BakeState, NewBake};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::problem::ProblemCode;
use serde_json::json;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{Connection as _, Executor as _, SqliteConnection};

use crate::bakes::{new_bake, run, submit};
use crate::support::{Running, start};

/// Gives bakes ids that tests choose, as the farm's own are random.
async fn rename(server: &Running, ids: &[(&str, &str)]) {
    let path = server.folder.path().join("farm.sqlite");
    let mut farm = SqliteConnection::connect_with(&SqliteConnectOptions::new().filename(path)).await.unwrap();
    for (old, new) in ids {
        let renamed = sqlx::query("UPDATE bakes SET id = $1 WHERE id = $2").bind(new).bind(old);
        assert_eq!(farm.execute(renamed).await.unwrap().rows_affected(), 1);
    }
    farm.close().await.unwrap();
}

async fn submit_named(server: &Running, name: &str) -> Bake {
    let new = NewBake { name: name.into(), ..new_bake(Digest::of(b"a scene"), json!({})) };
    server.post("/v1/bakes", &new).await.json(202)
}

#[tokio::test]
async fn list_is_filtered_by_state_name_and_age() {
    let server = start().await;
    let first = submit(&server).await;
    run(&server).await;
    let cancelled = submit_named(&server, "Ölofen & co").await;
    // Done at once, as all of its tasks are.
    assert_eq!(cancelled.state, BakeState::Done);
    let names = async |query: &str| -> Vec<String> {
        let page: BakePage = server.get(&format!("/v1/bakes?{query}")).await.json(200);
        page.bakes.into_iter().map(|bake| bake.name).collect()
    };
    assert_eq!(names("").await, ["Ölofen & co", "bake"]);
    assert_eq!(names("state=done,failed").await, ["Ölofen & co", "bake"]);
    assert!(names("state=running").await.is_empty());
    assert_eq!(names("name=%C3%96LOFEN%20%26").await, ["Ölofen & co"]);
    assert_eq!(names(&format!("since_ms={}&state=done&name=AKE", first.created_ms)).await, ["bake"]);
    assert!(names(&format!("since_ms={}", i64::MAX)).await.is_empty());
    let long = format!("name={}", "x".repeat(201));
    let wrong = [
        ("state=gone", "paused"),
        ("state=", "no state"),
        ("state=done,", "no state"),
        (&long, "200 characters"),
        ("since_ms=-1", "invalid digit"),
        ("since_ms=9223372036854775808", "since_ms"),
        ("since=1", "unknown field"),
    ];
    for (query, told) in wrong {
        let refused = server.get(&format!("/v1/bakes?{query}")).await.problem(ProblemCode::BadRequest);
        assert!(refused.detail.contains(told), "{query}: {}", refused.detail);
    }
}

#[tokio::test]
async fn every_call_about_a_bake_takes_the_beginning_of_its_id() {
    let server = start().await;
    let bake = submit(&server).await;
    let other = submit_named(&server, "other").await;
    let (id, beside) = ("0123456789abcdef", "0124000000000000");
    rename(&server, &[(&bake.id, id), (&other.id, beside)]).await;
    let call = async |method: &str, rest: &str| {
        let json = [("Content-Type", "application/json")];
        let body = if rest == "/priority" { &b"{\"priority\":3}"[..] } else { b"" };
        server.call(method, &format!("/v1/bakes/0123{rest}"), &json, body).await
    };
    for (method, rest) in
        [("GET", ""), ("POST", "/pause"), ("POST", "/resume"), ("POST", "/priority"), ("POST", "/cancel")]
    {
        assert_eq!(call(method, rest).await.json::<Bake>(200).id, id, "{method} {rest}");
    }
    for (method, rest) in
        [("GET", "/blocklist"), ("DELETE", "/blocklist"), ("GET", "/events"), ("GET", "/results")]
    {
        assert_eq!(call(method, rest).await.status, 200, "{method} {rest}");
    }
    for rest in ["/manifest", "/report"] {
        let refused = call("GET", rest).await.problem(ProblemCode::StateConflict);
        assert!(refused.detail.contains(id), "{}", refused.detail);
    }
    assert_eq!(call("DELETE", "").await.status, 204);
    let left: BakePage = server.get("/v1/bakes").await.json(200);
    assert_eq!(left.bakes.iter().map(|bake| bake.id.as_str()).collect::<Vec<_>>(), [beside]);
}

#[tokio::test]
async fn ambiguous_beginning_lists_the_bakes_that_it_may_mean_and_changes_none() {
    let server = start().await;
    submit(&server).await;
    for number in 1..10 {
        submit_named(&server, &format!("ofen {number}")).await;
    }
    let page: BakePage = server.get("/v1/bakes").await.json(200);
    let new: Vec<String> = (0..10).map(|number| format!("abcd00000000000{number}")).collect();
    let ids: Vec<(&str, &str)> =
        page.bakes.iter().map(|bake| bake.id.as_str()).zip(new.iter().map(String::as_str)).collect();
    rename(&server, &ids).await;
    let refused = server.call("POST", "/v1/bakes/abcd0/cancel", &[], b"").await;
    let told = refused.problem(ProblemCode::BadRequest).detail;
    for id in &new[..8] {
        assert!(told.contains(id.as_str()), "{told}");
    }
    assert!(
        !told.contains(new[8].as_str()) && told.contains("and more") && told.contains("running"),
        "{told}"
    );
    assert!(told.contains("ofen 3"), "{told}");
    let running: BakePage = server.get("/v1/bakes?state=running").await.json(200);
    assert_eq!(running.bakes.len(), 10);
    assert_eq!(server.get("/v1/bakes/abcd000000000003").await.json::<Bake>(200).id, new[3]);
    let short = server.get("/v1/bakes/abc").await.problem(ProblemCode::NotFound);
    assert!(short.detail.contains("4 characters"), "{}", short.detail);
    for none in ["abce", "ABCD0", "abcd%25", "abcd0000000000030"] {
        let refused = server.get(&format!("/v1/bakes/{none}")).await.problem(ProblemCode::NotFound);
        assert!(refused.detail.contains("no bake"), "{}", refused.detail);
    }
}
