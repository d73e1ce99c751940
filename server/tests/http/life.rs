//! Starting, running and stopping a server.

use lightkiln_proto::api::{Bake, BakeState, ClaimRequest, NewBake};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::problem::ProblemCode;
use lightkiln_server::{Config, Server, ServerError};

use crate::bakes::{claim_one, commit, new_bake, request, submit};
use crate::parts::kind::kinds;
use crate::support::{start, start_in};

#[tokio::test]
async fn state_folder_is_opened_by_one_server_only() {
    let server = start().await;
    let second = Server::open(Config::new(server.folder.path())).await;
    assert!(matches!(second, Err(ServerError::StateInUse { .. })));
    let folder = server.stop().await;
    Server::open(Config::new(folder.path())).await.unwrap();
}

#[tokio::test]
async fn restarted_server_goes_on_where_it_was() {
    let server = start().await;
    let bake = submit(&server).await;
    let lease = claim_one(&server).await;
    let server = start_in(server.stop().await).await;
    commit(&server, &lease, &[("scene", b"imported")]).await;
    let bake: Bake = server.get(&format!("/v1/bakes/{}", bake.id)).await.json(200);
    assert_eq!((bake.state, bake.tasks_run), (BakeState::Running, 1));
}

/// A server that shares its folder, and the name of its seat.
async fn seated(folder: &std::path::Path) -> (Server, String) {
    let (server, seat) = Server::open_seated(Config { kinds: kinds(), ..Config::new(folder) }).await.unwrap();
    (server, seat.name)
}

/// A bake of the same scene in each, for its own workers alone.
async fn submit_at(server: &Server, seat: &str) -> Bake {
    let scene = b"a scene".as_slice();
    let mut bake = new_bake(Digest::of(scene), serde_json::json!({}));
    bake.needs.labels.push(seat.to_owned());
    server.farm().storage.put(bake.scene, scene.into()).await.unwrap();
    server.farm().submit(NewBake { name: seat.into(), ..bake }, None, None, None).await.unwrap()
}

fn request_at(seat: &str, wait_secs: u32) -> ClaimRequest {
    ClaimRequest { worker: seat.into(), labels: vec![seat.into()], ..request(wait_secs) }
}

#[tokio::test]
async fn task_of_a_killed_bake_goes_to_another_that_waits_for_it_before_its_lease_runs_out() {
    let folder = tempfile::tempdir().unwrap();
    let (killed, killed_seat) = seated(folder.path()).await;
    let (living, living_seat) = seated(folder.path()).await;
    let left = submit_at(&killed, &killed_seat).await;
    submit_at(&living, &living_seat).await;
    let lease = killed.farm().claim(request_at(&killed_seat, 0)).await.unwrap().leases.remove(0);
    let farm = living.farm();
    assert!(farm.claim(request_at(&living_seat, 0)).await.unwrap().leases.is_empty(), "one works for both");
    let listener = living.bind("127.0.0.1:0").await.unwrap();
    let serving = tokio::spawn(living.serve(listener, std::future::pending()));
    drop(killed);
    // A third of the lease's length.
    let taken = farm.claim(request_at(&living_seat, 20)).await.unwrap().leases;
    assert_eq!(taken.iter().map(|lease| lease.task.key).collect::<Vec<_>>(), [lease.task.key]);
    assert_eq!(farm.store.show(&left.id).await.unwrap().state, BakeState::Cancelled);
    serving.abort();
}

#[tokio::test]
async fn tasks_that_a_killed_bake_left_are_free_for_the_next_in_its_seat() {
    let folder = tempfile::tempdir().unwrap();
    let (killed, killed_seat) = seated(folder.path()).await;
    let (living, living_seat) = seated(folder.path()).await;
    submit_at(&killed, &killed_seat).await;
    submit_at(&living, &living_seat).await;
    assert_eq!(killed.farm().claim(request_at(&killed_seat, 0)).await.unwrap().leases.len(), 1);
    drop(killed);
    let (next, seat) = seated(folder.path()).await;
    assert_eq!(seat, killed_seat);
    submit_at(&next, &seat).await;
    assert_eq!(next.farm().claim(request_at(&seat, 0)).await.unwrap().leases.len(), 1);
}

#[tokio::test]
async fn waiting_claim_is_answered_when_the_server_stops() {
    let server = start().await;
    let body = serde_json::to_vec(&request(60)).unwrap();
    let json = [("Content-Type", "application/json")];
    let mut waiting = server.open("POST", "/v1/leases", &json, &body).await;
    // The claim has arrived when its worker is known.
    while !String::from_utf8(server.get("/v1/workers").await.body).unwrap().contains("\"w\"") {}
    let answer = crate::support::read_head(&mut waiting);
    let ((status, _), _) = futures::future::join(answer, server.stop()).await;
    assert_eq!(status, 200);
}

#[tokio::test]
async fn address_that_others_can_reach_needs_to_be_allowed() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::open(Config::new(folder.path())).await.unwrap();
    let refused = server.bind("0.0.0.0:0").await.unwrap_err();
    assert_eq!(refused.code(), ProblemCode::Unavailable);
    assert!(refused.to_string().contains("127.0.0.1"), "{refused}");
    let listener = tokio::net::TcpListener::bind("0.0.0.0:0").await.unwrap();
    let refused = server.serve(listener, std::future::pending()).await;
    assert!(matches!(refused, Err(ServerError::NotLoopback { .. })));
    let config = Config { allow_non_loopback: true, ..Config::new(folder.path()) };
    Server::open(config).await.unwrap().bind("0.0.0.0:0").await.unwrap();
}

#[tokio::test]
async fn health_and_readiness_are_told() {
    let server = start().await;
    assert_eq!(server.get("/healthz").await.body, b"ok\n");
    assert_eq!(server.get("/readyz").await.body, b"ready\n");
}

#[tokio::test]
async fn readiness_tells_the_truth_about_the_chunk_store() {
    let server = start().await;
    std::fs::remove_dir_all(server.folder.path().join("chunks")).unwrap();
    std::fs::write(server.folder.path().join("chunks"), b"not a folder").unwrap();
    server.get("/readyz").await.problem(ProblemCode::Unavailable);
}

#[tokio::test]
async fn readiness_tells_the_truth_about_a_damaged_database() {
    let server = start().await;
    assert_eq!(server.get("/readyz").await.status, 200);
    let bake = submit(&server).await;
    let folder = server.stop().await;
    let file = folder.path().join("farm.sqlite");
    let mut bytes = std::fs::read(&file).unwrap();
    let page = usize::from(u16::from_be_bytes([bytes[16], bytes[17]]));
    // The heads of those pages alone that tell of the bake: what there is, and the row that is written, are whole.
    let tells = |page: &[u8]| page.windows(bake.id.len()).any(|text| text == bake.id.as_bytes());
    let damaged = bytes.chunks_mut(page).filter(|page| tells(page)).map(|page| page[..8].fill(0xee)).count();
    assert!(damaged > 0, "no page of {page} bytes tells of the bake");
    std::fs::write(&file, bytes).unwrap();
    let server = start_in(folder).await;
    let problem = server.get("/readyz").await.problem(ProblemCode::Unavailable);
    assert!(problem.detail.contains("cannot be used"), "{}", problem.detail);
    assert_eq!(server.get("/healthz").await.status, 200, "it is alive");
}

#[tokio::test]
async fn checked_in_description_is_what_the_server_says() {
    let server = start().await;
    let said = String::from_utf8(server.get("/openapi.json").await.body).unwrap();
    assert_eq!(said, lightkiln_server::openapi_json());
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/openapi.json");
    let kept = std::fs::read_to_string(path).unwrap_or_default();
    assert!(
        kept == said,
        "server/openapi.json is out of date; run `cargo run -p lightkiln-server --example openapi` in the workspace"
    );
    assert!(said.contains("/v1/leases/{token}/commit") && said.contains("BakePage"));
}

#[test]
fn every_reference_in_the_description_leads_somewhere() {
    let text = lightkiln_server::openapi_json();
    let description: serde_json::Value = serde_json::from_str(&text).unwrap();
    let references: Vec<&str> =
        text.split("\"$ref\": \"#").skip(1).map(|rest| rest.split('"').next().unwrap()).collect();
    assert!(references.len() > 50, "only {} references found", references.len());
    for reference in references {
        assert!(description.pointer(reference).is_some(), "{reference}");
    }
}
