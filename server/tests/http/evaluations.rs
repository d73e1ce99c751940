//! Evaluations of bakes over HTTP.

use lightkiln_proto::api::Bake;
use lightkiln_proto::evaluation::{
    EvaluationFile, EvaluationIndex, EvaluationMedia, FIGURES, MAX_EVALUATION_FILE_BYTES,
};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::problem::ProblemCode;
use serde_json::json;

use crate::bakes::{run, submit};
use crate::support::{Answer, Running, start};

const PNG: &[u8] = b"\x89PNG a picture";
const NUMBERS: &[u8] = b"{\"rel_rmse\":0.1}";

fn file(name: &str, media_type: EvaluationMedia, bytes: &[u8]) -> EvaluationFile {
    EvaluationFile { name: name.into(), media_type, digest: Digest::of(bytes), bytes: bytes.len() as u64 }
}

fn index() -> EvaluationIndex {
    let figures = file(FIGURES, EvaluationMedia::Json, NUMBERS);
    EvaluationIndex { files: vec![figures, file("pictures/0-0.png", EvaluationMedia::Png, PNG)] }
}

async fn put_file(server: &Running, bake: &Bake, bytes: &[u8]) -> Answer {
    let path = format!("/v1/bakes/{}/evaluation/files/{}", bake.id, Digest::of(bytes));
    server.call("PUT", &path, &[], bytes).await
}

async fn attach(server: &Running, bake: &Bake, index: &EvaluationIndex) -> Answer {
    let body = serde_json::to_vec(index).unwrap();
    let json = [("Content-Type", "application/json")];
    server.call("PUT", &format!("/v1/bakes/{}/evaluation", bake.id), &json, &body).await
}

#[tokio::test]
async fn evaluation_is_attached_shown_and_goes_with_its_bake() {
    let server = start().await;
    let bake = submit(&server).await;
    let path = format!("/v1/bakes/{}/evaluation", bake.id);
    put_file(&server, &bake, PNG).await.problem(ProblemCode::StateConflict);
    attach(&server, &bake, &index()).await.problem(ProblemCode::StateConflict);
    run(&server).await;
    let none = server.get(&path).await.problem(ProblemCode::StateConflict);
    assert!(none.detail.contains("kiln evaluate") && none.detail.contains("--attach"), "{}", none.detail);
    attach(&server, &bake, &index()).await.problem(ProblemCode::NotStored);
    for bytes in [PNG, NUMBERS] {
        assert_eq!(put_file(&server, &bake, bytes).await.status, 201);
        assert_eq!(put_file(&server, &bake, bytes).await.status, 200);
    }
    for _ in 0..2 {
        assert_eq!(attach(&server, &bake, &index()).await.status, 204);
    }
    // The bake's short id will do.
    let shown: EvaluationIndex =
        server.get(&format!("/v1/bakes/{}/evaluation", &bake.id[..8])).await.json(200);
    assert_eq!(shown, index());
    let now: Bake = server.get(&format!("/v1/bakes/{}", bake.id)).await.json(200);
    assert_eq!(now.evaluation, Some(Digest::of(&serde_json::to_vec(&index()).unwrap())));
    for file in &shown.files {
        let answer = server.get(&format!("{path}/files/{}", file.digest)).await;
        assert_eq!((answer.status, answer.body.len() as u64), (200, file.bytes));
        assert_eq!(answer.header("content-type"), Some(file.media_type.name()));
        assert_eq!(answer.header("x-content-type-options"), Some("nosniff"));
        let policy = answer.header("content-security-policy").unwrap();
        assert!(policy.contains("default-src 'none'") && policy.contains("sandbox"), "{policy}");
    }
    // Other chunks of the farm are no files of it.
    let manifest = now.manifest.unwrap();
    server.get(&format!("{path}/files/{manifest}")).await.problem(ProblemCode::NotFound);
    assert_eq!(server.call("DELETE", &format!("/v1/bakes/{}", bake.id), &[], b"").await.status, 204);
    server.get(&path).await.problem(ProblemCode::NotFound);
    server.get(&format!("{path}/files/{}", Digest::of(PNG))).await.problem(ProblemCode::NotFound);
}

#[tokio::test]
async fn evaluation_beyond_its_limits_is_refused() {
    let server = start().await;
    let bake = submit(&server).await;
    run(&server).await;
    for bytes in [PNG, NUMBERS] {
        put_file(&server, &bake, bytes).await;
    }
    let refused = async |index: &EvaluationIndex, told: &str| {
        let problem = attach(&server, &bake, index).await.problem(ProblemCode::BadEvaluation);
        assert!(problem.detail.contains(told), "{}", problem.detail);
    };
    refused(&EvaluationIndex::default(), FIGURES).await;
    let mut other = index();
    other.files[1].name = "../page.png".into();
    refused(&other, "'../page.png'").await;
    let mut other = index();
    other.files[1].bytes += 1;
    refused(&other, "that the index names").await;
    let path = format!("/v1/bakes/{}/evaluation", bake.id);
    let html = json!({ "files": [{ "name": "a.html", "media_type": "text/html", "digest": Digest::of(PNG), "bytes": 15 }] });
    let json = [("Content-Type", "application/json")];
    server.call("PUT", &path, &json, html.to_string().as_bytes()).await.problem(ProblemCode::BadRequest);
    let long = [("Content-Type", "application/json"), ("Content-Length", "1048577")];
    server.call("PUT", &path, &long, b"").await.problem(ProblemCode::TooLarge);
    let length = (MAX_EVALUATION_FILE_BYTES + 1).to_string();
    let too_large = format!("{path}/files/{}", Digest::of(b"large"));
    server.call("PUT", &too_large, &[("Content-Length", &length)], b"").await.problem(ProblemCode::TooLarge);
    let wrong = server.call("PUT", &too_large, &[], b"other").await;
    wrong.problem(ProblemCode::DigestMismatch);
    for path in [format!("{path}/files/abc"), format!("{path}/files/%00")] {
        server.get(&path).await.problem(ProblemCode::BadRequest);
    }
    server.get(&path).await.problem(ProblemCode::StateConflict);
}
