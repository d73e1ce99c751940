//! Evaluations of bakes: figures, pictures and stills, for pages that show them.

use std::sync::Arc;

use axum::Json;
use axum::body::Body;
use axum::extract::{FromRequestParts, Path, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::response::Response;
use lightkiln_proto::evaluation::{EvaluationIndex, MAX_EVALUATION_FILE_BYTES};
use lightkiln_proto::ids::Digest;

use super::chunks::{Binary, Conditions, forever, serve_bytes, status_of, store_up_to};
use super::extract::{Answer, BakeId, Caller, FarmState, JsonBody, OwnBakeId, without_nul};
use crate::bake_ids::whole_id;
use crate::error::{Result, ServerError};
use crate::evaluations::MAX_INDEX_BYTES;
use crate::farm::Farm;
use crate::store::require_done;

/// A browser takes a file for nothing but its type, and runs nothing in it.
const HARMLESS: [(HeaderName, &str); 2] = [
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::CONTENT_SECURITY_POLICY, "default-src 'none'; frame-ancestors 'none'; sandbox"),
];

/// A file of a bake's evaluation, as the path names it.
pub(super) struct FileOfBake {
    bake: String,
    digest: Digest,
}

impl FromRequestParts<Arc<Farm>> for FileOfBake {
    type Rejection = ServerError;

    async fn from_request_parts(parts: &mut Parts, farm: &Arc<Farm>) -> Result<Self> {
        without_nul("path", parts.uri.path())?;
        let named = Path::<(String, String)>::from_request_parts(parts, farm).await;
        let Path((bake, digest)) = named.map_err(|error| ServerError::bad_request(error.body_text()))?;
        let digest = digest.parse::<Digest>().map_err(|error| ServerError::bad_request(error.to_string()))?;
        Ok(Self { bake: whole_id(&*farm.store, bake).await?, digest })
    }
}

/// Names the files of the evaluation attached to a bake.
#[utoipa::path(get, path = "/v1/bakes/{id}/evaluation", tag = "bakes", operation_id = "evaluation",
    params(("id" = String, Path, description = "The bake: its id, or a beginning of it that is no other bake's")),
    responses((status = 200, description = "The files", body = EvaluationIndex),
        (status = 404, description = "No such bake"),
        (status = 409, description = "No evaluation is attached")))]
pub(super) async fn show(State(farm): FarmState, BakeId(id): BakeId) -> Answer<EvaluationIndex> {
    Ok(Json(farm.evaluation_index(&id).await?))
}

/// Attaches an evaluation to a finished bake, in place of the one before. Its files must be stored.
#[utoipa::path(put, path = "/v1/bakes/{id}/evaluation", tag = "bakes", operation_id = "attach_evaluation",
    request_body = EvaluationIndex,
    params(("id" = String, Path, description = "The bake: its id, or a beginning of it that is no other bake's")),
    responses((status = 204, description = "Attached"),
        (status = 404, description = "No such bake"),
        (status = 409, description = "The bake is not done, or a file is not stored"),
        (status = 422, description = "The index names files that it may not have")))]
pub(super) async fn attach(
    State(farm): FarmState,
    OwnBakeId(id): OwnBakeId,
    JsonBody(index): JsonBody<EvaluationIndex, MAX_INDEX_BYTES>,
) -> Result<StatusCode> {
    farm.attach_evaluation(&id, &index).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Gives a file of the evaluation attached to a bake: JSON, or a PNG.
#[utoipa::path(get, path = "/v1/bakes/{id}/evaluation/files/{digest}", tag = "bakes", operation_id = "evaluation_file",
    params(("id" = String, Path, description = "The bake: its id, or a beginning of it that is no other bake's"),
        ("digest" = Digest, Path, description = "blake3 digest of the file"), Conditions),
    responses(
        (status = 200, description = "All bytes, of the type that the index names", content((inline(Binary) = "image/png"), (serde_json::Value = "application/json"))),
        (status = 206, description = "The range", content((inline(Binary) = "image/png"), (inline(Binary) = "application/json"))),
        (status = 304, description = "The caller has the bytes"),
        (status = 404, description = "The evaluation has no such file"),
        (status = 409, description = "No evaluation is attached"),
        (status = 416, description = "The range lies outside")))]
pub(super) async fn file(
    State(farm): FarmState,
    FileOfBake { bake, digest }: FileOfBake,
    method: Method,
    headers: HeaderMap,
) -> Result<Response> {
    let index = farm.evaluation_index(&bake).await?;
    let found = index.file(digest).ok_or(ServerError::NoSuchEvaluationFile { bake, digest })?;
    let mut answer =
        serve_bytes(&farm, digest, &method, &headers, found.media_type.name(), forever(&headers)).await?;
    for (name, value) in HARMLESS {
        answer.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    Ok(answer)
}

/// Stores a file of an evaluation that is to be attached; it stays as long as any chunk that nobody needs.
#[utoipa::path(put, path = "/v1/bakes/{id}/evaluation/files/{digest}", tag = "bakes", operation_id = "put_evaluation_file",
    params(("id" = String, Path, description = "The bake: its id, or a beginning of it that is no other bake's"),
        ("digest" = Digest, Path, description = "blake3 digest of the file")),
    request_body(content = inline(Binary), content_type = "application/octet-stream", description = "At most 32 MiB"),
    responses(
        (status = 201, description = "Stored"),
        (status = 200, description = "Was stored already"),
        (status = 404, description = "No such bake"),
        (status = 409, description = "The bake is not done"),
        (status = 413, description = "Too large"),
        (status = 422, description = "The bytes have another digest")))]
pub(super) async fn put_file(
    State(farm): FarmState,
    FileOfBake { bake, digest }: FileOfBake,
    Caller(caller): Caller,
    headers: HeaderMap,
    body: Body,
) -> Result<StatusCode> {
    farm.require_owner(&bake, caller.as_ref()).await?;
    require_done(&bake, farm.store.show(&bake).await?.state, "given an evaluation")?;
    Ok(status_of(store_up_to(&farm, digest, &headers, body, MAX_EVALUATION_FILE_BYTES).await?))
}
