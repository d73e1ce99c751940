//! A bake from upload to result, as a person and a worker see it.

use std::path::Path;

use lightkiln_proto::api::{
    Bake, BakeLimits, BakePage, BakeState, Blame, ClaimAnswer, ClaimRequest, Commit, CommitAnswer,
    CommitOutcome, CommitVerdict, Commits, CommitsAnswer, Failure, Heartbeat, HeartbeatAnswer, Lease,
    MAX_COMMITS, Needs, NewBake, NewPriority, SceneStored, Verdict, WorkerPage,
};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{Artefact, MANIFEST_OUTPUT, REPORT_OUTPUT, TaskResult};
use lightkiln_proto::problem::ProblemCode;
use serde_json::{Value, json};

use crate::support::{Answer, Running, start};

pub const SCENE: &[u8] = b"a scene";

pub fn new_bake(scene: Digest, settings: Value) -> NewBake {
    NewBake {
        name: "bake".into(),
        scene,
        kind: "two".into(),
        settings,
        priority: 0,
        needs: Needs::default(),
        attempt_limit_secs: None,
        limits: Default::default(),
        verify_share: 0.0,
    }
}

pub async fn put_scene(server: &Running) -> Answer {
    server.call("PUT", &format!("/v1/scenes/{}", Digest::of(SCENE)), &[], SCENE).await
}

/// Uploads the scene and submits a bake of it.
pub async fn submit(server: &Running) -> Bake {
    put_scene(server).await;
    server.post("/v1/bakes", &new_bake(Digest::of(SCENE), json!({}))).await.json(202)
}

pub fn request(wait_secs: u32) -> ClaimRequest {
    let kinds = ["two.first", "two.second"].map(str::to_owned).to_vec();
    ClaimRequest {
        worker: "w".into(),
        kinds,
        threads: 2,
        memory_mib: 0,
        labels: Vec::new(),
        machine: String::new(),
        max: 4,
        ttl_secs: 60,
        wait_secs,
    }
}

pub async fn claim_one(server: &Running) -> Lease {
    let mut answer: ClaimAnswer = server.post("/v1/leases", &request(0)).await.json(200);
    assert_eq!(answer.leases.len(), 1);
    answer.leases.remove(0)
}

/// Uploads outputs and commits them.
pub async fn commit(server: &Running, lease: &Lease, outputs: &[(&str, &[u8])]) -> CommitVerdict {
    let mut result = TaskResult::default();
    for (name, bytes) in outputs {
        let digest = server.put_chunk(bytes).await;
        result.outputs.push(Artefact { name: (*name).into(), digest, bytes: bytes.len() as u64 });
    }
    let answer = server.post(&format!("/v1/leases/{}/commit", lease.token), &result).await;
    answer.json::<CommitAnswer>(200).verdict
}

/// Runs the bake's two tasks.
pub async fn run(server: &Running) {
    let import = claim_one(server).await;
    commit(server, &import, &[("scene", b"imported")]).await;
    let prepare = claim_one(server).await;
    commit(server, &prepare, &[(MANIFEST_OUTPUT, b"{\"a\":1}"), (REPORT_OUTPUT, b"{\"b\":2}")]).await;
}

#[tokio::test]
async fn bake_goes_from_upload_to_manifest() {
    let server = start().await;
    let stored: SceneStored = put_scene(&server).await.json(201);
    assert_eq!((stored.scene, stored.bytes), (Digest::of(SCENE), 7));
    let bake = submit(&server).await;
    assert_eq!((bake.state, bake.stages.len()), (BakeState::Running, 2));
    let path = format!("/v1/bakes/{}", bake.id);

    let import = claim_one(&server).await;
    assert_eq!((import.task.kind.as_str(), &import.bake), ("two.first", &bake.id));
    assert_eq!((import.inputs[0].name.as_str(), import.inputs[0].bytes), ("bundle", 7));
    let heartbeat = format!("/v1/leases/{}/heartbeat", import.token);
    let answer: HeartbeatAnswer = server.post(&heartbeat, &Heartbeat { progress: 0.5 }).await.json(200);
    assert_eq!(answer.verdict, Verdict::Keep);
    let workers: WorkerPage = server.get("/v1/workers").await.json(200);
    assert_eq!(workers.workers[0].holds, ["scene"]);
    assert_eq!(commit(&server, &import, &[("scene", b"imported")]).await, CommitVerdict::Committed);
    assert_eq!(commit(&server, &import, &[("scene", b"imported")]).await, CommitVerdict::AlreadyCommitted);

    let refused = server.get(&format!("{path}/manifest")).await.problem(ProblemCode::StateConflict);
    assert!(refused.detail.contains("not done yet"), "{}", refused.detail);
    let prepare = claim_one(&server).await;
    assert_eq!(prepare.inputs[0].name, "first/scene");
    commit(&server, &prepare, &[(MANIFEST_OUTPUT, b"{\"a\":1}"), (REPORT_OUTPUT, b"{\"b\":2}")]).await;
    let done: Bake = server.get(&path).await.json(200);
    assert_eq!((done.state, done.tasks_run), (BakeState::Done, 2));
    assert_eq!(server.get(&format!("{path}/manifest")).await.json::<Value>(200), json!({ "a": 1 }));
    assert_eq!(server.get(&format!("{path}/report")).await.json::<Value>(200), json!({ "b": 2 }));

    let again = submit(&server).await;
    assert_eq!((again.state, again.tasks_run, again.tasks_reused), (BakeState::Done, 0, 2));
    let page: BakePage = server.get("/v1/bakes?limit=1").await.json(200);
    assert_eq!(page.bakes[0].id, again.id);
    let page: BakePage = server.get(&format!("/v1/bakes?after={}", page.next.unwrap())).await.json(200);
    assert_eq!((page.bakes[0].id.as_str(), page.next), (bake.id.as_str(), None));
}

#[tokio::test]
async fn idempotency_key_gives_the_same_bake_or_a_conflict() {
    let server = start().await;
    put_scene(&server).await;
    let headers = [("Content-Type", "application/json"), ("Idempotency-Key", "commit 1")];
    let body = serde_json::to_vec(&new_bake(Digest::of(SCENE), json!({}))).unwrap();
    let first: Bake = server.call("POST", "/v1/bakes", &headers, &body).await.json(202);
    let again: Bake = server.call("POST", "/v1/bakes", &headers, &body).await.json(202);
    assert_eq!(first, again);
    let other = serde_json::to_vec(&new_bake(Digest::of(SCENE), json!({ "preset": "draft" }))).unwrap();
    let refused = server.call("POST", "/v1/bakes", &headers, &other).await;
    refused.problem(ProblemCode::IdempotencyConflict);
}

#[tokio::test]
async fn limits_of_a_bake_are_kept_and_have_bounds() {
    let server = start().await;
    put_scene(&server).await;
    let limits = |max_workers, attempts, lost_workers| BakeLimits { max_workers, attempts, lost_workers };
    let submit = async |limits| {
        let bake = NewBake { limits, ..new_bake(Digest::of(SCENE), json!({})) };
        server.post("/v1/bakes", &bake).await
    };
    for (out, words) in [
        (limits(Some(0), None, None), "limits.max_workers must be within 1..=100000, not 0"),
        (limits(Some(100_001), None, None), "limits.max_workers"),
        (limits(None, Some(0), None), "limits.attempts must be within 1..=1000, not 0"),
        (limits(None, Some(1_001), None), "limits.attempts"),
        (limits(None, None, Some(0)), "limits.lost_workers must be within 1..=1000000, not 0"),
        (limits(None, None, Some(1_000_001)), "limits.lost_workers"),
    ] {
        let refused = submit(out).await.problem(ProblemCode::BadRequest);
        assert!(refused.detail.contains(words), "{out:?}: {}", refused.detail);
    }
    for kept in [
        limits(Some(1), Some(2), Some(3)),
        limits(Some(100_000), Some(1_000), Some(1_000_000)),
        limits(None, None, None),
    ] {
        let bake: Bake = submit(kept).await.json(202);
        let shown: Bake = server.get(&format!("/v1/bakes/{}", bake.id)).await.json(200);
        assert_eq!((bake.limits, shown.limits), (kept, kept));
    }
}

#[tokio::test]
async fn share_of_results_to_verify_is_kept_and_has_bounds() {
    let server = start().await;
    put_scene(&server).await;
    let submit = async |verify_share: f64| {
        let bake = NewBake { verify_share, ..new_bake(Digest::of(SCENE), json!({})) };
        server.post("/v1/bakes", &bake).await
    };
    for out in [-0.01, 1.01] {
        let refused = submit(out).await.problem(ProblemCode::BadRequest);
        assert_eq!(refused.detail, format!("verify_share must be within 0..=1, not {out}"));
    }
    for kept in [0.0, 0.01, 1.0] {
        let bake: Bake = submit(kept).await.json(202);
        let shown: Bake = server.get(&format!("/v1/bakes/{}", bake.id)).await.json(200);
        assert_eq!(
            (bake.verify_share.to_bits(), shown.verify_share.to_bits()),
            (kept.to_bits(), kept.to_bits())
        );
    }
}

#[tokio::test]
async fn bake_without_its_scene_or_with_bad_settings_is_refused() {
    let server = start().await;
    let scene = Digest::of(SCENE);
    let refused = server.post("/v1/bakes", &new_bake(scene, json!({}))).await;
    assert!(refused.problem(ProblemCode::NotFound).detail.contains(&scene.to_string()));
    put_scene(&server).await;
    for (kind, settings, hint) in [
        ("two", json!({ "no_such_setting": 1 }), "no_such_setting"),
        ("two", json!({ "preset": "huge" }), "huge"),
        ("other", json!({}), "other"),
    ] {
        let bake = NewBake { kind: kind.into(), ..new_bake(scene, settings) };
        let problem = server.post("/v1/bakes", &bake).await.problem(ProblemCode::BadSettings);
        assert!(problem.detail.contains(hint), "{}", problem.detail);
    }
    let bake = NewBake { name: "x".repeat(201), ..new_bake(scene, json!({})) };
    server.post("/v1/bakes", &bake).await.problem(ProblemCode::BadRequest);
}

#[tokio::test]
async fn bake_is_paused_resumed_hurried_and_cancelled() {
    let server = start().await;
    let bake = submit(&server).await;
    let change = |what: &str| format!("/v1/bakes/{}/{what}", bake.id);
    let state = async |what: &str| server.call("POST", &change(what), &[], b"").await.json::<Bake>(200).state;
    assert_eq!(state("pause").await, BakeState::Paused);
    assert_eq!(server.post("/v1/leases", &request(0)).await.json::<ClaimAnswer>(200).leases, []);
    assert_eq!(state("resume").await, BakeState::Running);
    let hurried: Bake = server.post(&change("priority"), &NewPriority { priority: 5 }).await.json(200);
    assert_eq!(hurried.priority, 5);
    let lease = claim_one(&server).await;
    assert_eq!(state("cancel").await, BakeState::Cancelled);
    let heartbeat = format!("/v1/leases/{}/heartbeat", lease.token);
    let answer: HeartbeatAnswer = server.post(&heartbeat, &Heartbeat { progress: 0.1 }).await.json(200);
    assert_eq!(answer.verdict, Verdict::Cancel);
    assert_eq!(commit(&server, &lease, &[]).await, CommitVerdict::Stale);
    server.call("POST", &change("resume"), &[], b"").await.problem(ProblemCode::StateConflict);
}

#[tokio::test]
async fn failed_and_released_leases_are_noted() {
    let server = start().await;
    let bake = submit(&server).await;
    let lease = claim_one(&server).await;
    let release = format!("/v1/leases/{}/release", lease.token);
    assert_eq!(server.call("POST", &release, &[], b"").await.status, 204);
    assert_eq!(server.call("POST", &release, &[], b"").await.status, 204);
    let lease = claim_one(&server).await;
    let failure = Failure { blame: Blame::Task, message: "the scene is broken".into() };
    assert_eq!(server.post(&format!("/v1/leases/{}/fail", lease.token), &failure).await.status, 204);
    let bake: Bake = server.get(&format!("/v1/bakes/{}", bake.id)).await.json(200);
    assert_eq!(bake.state, BakeState::Failed);
    assert!(bake.failure.unwrap().contains("the scene is broken"));
}

#[tokio::test]
async fn waiting_claim_is_answered_when_work_comes() {
    let server = start().await;
    let wanted = request(60);
    let claim = server.post("/v1/leases", &wanted);
    let (answer, _) = futures::future::join(claim, submit(&server)).await;
    assert_eq!(answer.json::<ClaimAnswer>(200).leases.len(), 1);
}

#[tokio::test]
async fn result_whose_chunk_was_lost_is_run_again() {
    result_runs_again_after(|chunk| std::fs::remove_file(chunk).unwrap()).await;
}

#[tokio::test]
async fn result_whose_chunk_was_cut_short_is_run_again() {
    result_runs_again_after(|chunk| {
        std::fs::OpenOptions::new().write(true).open(chunk).unwrap().set_len(3).unwrap();
    })
    .await;
}

async fn result_runs_again_after(harm: impl FnOnce(&Path)) {
    let server = start().await;
    submit(&server).await;
    run(&server).await;
    harm(&server.chunk_file(Digest::of(b"imported")));
    let again = submit(&server).await;
    assert_eq!((again.state, again.tasks_reused), (BakeState::Running, 1));
    let lease = claim_one(&server).await;
    assert_eq!(lease.task.kind, "two.first");
    commit(&server, &lease, &[("scene", b"imported")]).await;
    let again: Bake = server.get(&format!("/v1/bakes/{}", again.id)).await.json(200);
    assert_eq!(again.state, BakeState::Done);
}

#[tokio::test]
async fn results_that_go_together_are_answered_one_by_one() {
    let server = start().await;
    submit(&server).await;
    let other = server.call("PUT", &format!("/v1/scenes/{}", Digest::of(b"other")), &[], b"other").await;
    assert_eq!(other.status, 201);
    server.post("/v1/bakes", &new_bake(Digest::of(b"other"), json!({}))).await.json::<Bake>(202);
    let leases: ClaimAnswer = server.post("/v1/leases", &request(0)).await.json(200);
    let [first, second] = &leases.leases[..] else { panic!("{leases:?}") };
    let result = |bytes: &[u8]| {
        let output = Artefact { name: "out".into(), digest: Digest::of(bytes), bytes: bytes.len() as u64 };
        TaskResult { outputs: vec![output], ..TaskResult::default() }
    };
    server.put_chunk(b"stored").await;
    let commit = |token: &str, bytes| Commit { token: token.to_owned(), result: result(bytes) };
    let commits = vec![
        commit(&first.token, b"stored"),
        commit(&second.token, b"not stored"),
        commit("no token", b"stored"),
        commit(&"0".repeat(32), b"stored"),
    ];
    let path = "/v1/leases/commit";
    let answer: CommitsAnswer = server.post(path, &Commits { commits: commits.clone() }).await.json(200);
    let told = answer.answers.iter().map(|outcome| match outcome {
        CommitOutcome::Verdict(verdict) => (Some(*verdict), None),
        CommitOutcome::Problem(problem) => (None, Some(problem.status)),
    });
    let expected = [
        (Some(CommitVerdict::Committed), None),
        (None, Some(409)),
        (None, Some(404)),
        (Some(CommitVerdict::Stale), None),
    ];
    assert_eq!(told.collect::<Vec<_>>(), expected);
    let again: CommitsAnswer = server.post(path, &Commits { commits: commits[..1].to_vec() }).await.json(200);
    assert_eq!(again.answers, [CommitOutcome::Verdict(CommitVerdict::AlreadyCommitted)]);
    let too_many = Commits { commits: vec![commits[0].clone(); MAX_COMMITS + 1] };
    server.post(path, &too_many).await.problem(ProblemCode::BadRequest);
}
