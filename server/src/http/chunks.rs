//! Stored bytes: chunks and scenes.

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, Method, StatusCode, header};
use axum::response::{IntoResponse, Response};
use futures::{StreamExt, TryStreamExt};
use lightkiln_proto::api::{MAX_CHUNK_BYTES, MAX_SCENE_PART_BYTES, SceneParts, SceneProgress, SceneStored};
use lightkiln_proto::ids::Digest;
use utoipa::openapi::RefOr;
use utoipa::openapi::schema::{KnownFormat, ObjectBuilder, Schema, SchemaFormat, Type};
use utoipa::{IntoParams, PartialSchema, ToSchema};

use super::extract::{Answer, FarmState, JsonBody, PathParam, content_length, text_header};
use super::ranges::{Wanted, is_known, range_applies, wanted};
use crate::chunks::{ChunkError, Stored};
use crate::error::{Result, ServerError};
use crate::farm::Farm;

/// Largest list of parts.
const MAX_JSON_BYTES: usize = 1 << 20;
/// Bytes under a digest never change.
const FOREVER: &str = "public, max-age=31536000, immutable";
/// The same of bytes that a token opened: no cache that callers share may keep them.
const FOREVER_PRIVATE: &str = "private, max-age=31536000, immutable";

/// Plain bytes, as the description has them.
pub(super) enum Binary {}

impl PartialSchema for Binary {
    fn schema() -> RefOr<Schema> {
        let binary = Some(SchemaFormat::KnownFormat(KnownFormat::Binary));
        ObjectBuilder::new().schema_type(Type::String).format(binary).into()
    }
}

impl ToSchema for Binary {}

/// Headers with which a GET asks for a part, or for nothing that the caller has.
#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
#[expect(dead_code, reason = "it describes headers; handlers read them from the map")]
pub(super) struct Conditions {
    /// One range of bytes.
    #[param(rename = "Range")]
    range: Option<String>,
    /// Serve the range only if this is the entity tag.
    #[param(rename = "If-Range")]
    if_range: Option<String>,
    /// Answer 304 if this is the entity tag.
    #[param(rename = "If-None-Match")]
    if_none_match: Option<String>,
}

/// Stores a chunk.
#[utoipa::path(put, path = "/v1/chunks/{digest}", tag = "chunks",
    params(("digest" = Digest, Path, description = "blake3 digest of the bytes")),
    request_body(content = inline(Binary), content_type = "application/octet-stream", description = "At most 2 GiB"),
    responses(
        (status = 201, description = "Stored"),
        (status = 200, description = "Was stored already"),
        (status = 413, description = "Too large"),
        (status = 422, description = "The bytes have another digest")))]
pub(super) async fn put_chunk(
    State(farm): FarmState,
    PathParam(digest): PathParam<Digest>,
    headers: HeaderMap,
    body: Body,
) -> Result<StatusCode> {
    Ok(status_of(store(&farm, digest, &headers, body).await?))
}

/// Stores a scene bundle: .glb, or .zip with a .gltf and its files.
#[utoipa::path(put, path = "/v1/scenes/{digest}", tag = "scenes",
    params(("digest" = Digest, Path, description = "blake3 digest of the bundle")),
    request_body(content = inline(Binary), content_type = "application/octet-stream", description = "At most 2 GiB"),
    responses(
        (status = 201, description = "Stored", body = SceneStored),
        (status = 200, description = "Was stored already", body = SceneStored),
        (status = 413, description = "Too large"),
        (status = 422, description = "The bytes have another digest")))]
pub(super) async fn put_scene(
    State(farm): FarmState,
    PathParam(digest): PathParam<Digest>,
    headers: HeaderMap,
    body: Body,
) -> Result<(StatusCode, Json<SceneStored>)> {
    let stored = store(&farm, digest, &headers, body).await?;
    Ok((status_of(stored), Json(SceneStored { scene: digest, bytes: stored.bytes })))
}

/// Stores a part of a scene; it stays as long as any chunk that nobody needs.
#[utoipa::path(put, path = "/v1/scene-parts/{digest}", tag = "scenes",
    params(("digest" = Digest, Path, description = "blake3 digest of the part")),
    request_body(content = inline(Binary), content_type = "application/octet-stream", description = "At most 64 MiB"),
    responses(
        (status = 201, description = "Stored"),
        (status = 200, description = "Was stored already"),
        (status = 413, description = "Too large"),
        (status = 422, description = "The bytes have another digest")))]
pub(super) async fn put_scene_part(
    State(farm): FarmState,
    PathParam(digest): PathParam<Digest>,
    headers: HeaderMap,
    body: Body,
) -> Result<StatusCode> {
    Ok(status_of(store_up_to(&farm, digest, &headers, body, MAX_SCENE_PART_BYTES).await?))
}

/// Says which parts of a scene are missing. If none is, stores the scene that they make. Safe to try again.
#[utoipa::path(post, path = "/v1/scenes/{digest}/parts", tag = "scenes", request_body = SceneParts,
    params(("digest" = Digest, Path, description = "blake3 digest of the bundle")),
    responses(
        (status = 200, description = "What is missing, or that the scene is stored", body = SceneProgress),
        (status = 413, description = "Too large"),
        (status = 422, description = "The parts make other bytes")))]
pub(super) async fn put_scene_together(
    State(farm): FarmState,
    PathParam(digest): PathParam<Digest>,
    JsonBody(parts): JsonBody<SceneParts, MAX_JSON_BYTES>,
) -> Answer<SceneProgress> {
    Ok(Json(farm.put_scene_together(digest, parts).await?))
}

async fn store(farm: &Farm, digest: Digest, headers: &HeaderMap, body: Body) -> Result<Stored> {
    store_up_to(farm, digest, headers, body, MAX_CHUNK_BYTES).await
}

pub(super) async fn store_up_to(
    farm: &Farm,
    digest: Digest,
    headers: &HeaderMap,
    body: Body,
    limit: u64,
) -> Result<Stored> {
    if content_length(headers).is_some_and(|length| length > limit) {
        return Err(ChunkError::TooLarge { limit }.into());
    }
    let bytes = body.into_data_stream().map_err(|error| ChunkError::Broken(error.into()));
    let stored = farm.storage.put_stream(digest, bytes.boxed(), limit, content_length(headers)).await?;
    farm.metrics.received_bytes.inc_by(stored.bytes);
    Ok(stored)
}

pub(super) fn status_of(stored: Stored) -> StatusCode {
    if stored.is_new { StatusCode::CREATED } else { StatusCode::OK }
}

/// Says whether a scene is stored, so that it need not be uploaded again.
#[utoipa::path(head, path = "/v1/scenes/{digest}", tag = "scenes",
    params(("digest" = Digest, Path, description = "blake3 digest of the bundle")),
    responses((status = 200, description = "It is stored"), (status = 404, description = "It is not")))]
pub(super) async fn head_scene(
    State(farm): FarmState,
    PathParam(digest): PathParam<Digest>,
    headers: HeaderMap,
) -> Result<Response> {
    serve_bytes(&farm, digest, &Method::HEAD, &headers, "application/octet-stream", forever(&headers)).await
}

/// Gives a chunk, whole or in part.
#[utoipa::path(get, path = "/v1/chunks/{digest}", tag = "chunks",
    params(
        ("digest" = Digest, Path, description = "blake3 digest of the bytes"),
        Conditions),
    responses(
        (status = 200, description = "All bytes", body = inline(Binary), content_type = "application/octet-stream"),
        (status = 206, description = "The range", body = inline(Binary), content_type = "application/octet-stream"),
        (status = 304, description = "The caller has the bytes"),
        (status = 404, description = "Not stored"),
        (status = 416, description = "The range lies outside")))]
pub(super) async fn get_chunk(
    State(farm): FarmState,
    PathParam(digest): PathParam<Digest>,
    method: Method,
    headers: HeaderMap,
) -> Result<Response> {
    serve_bytes(&farm, digest, &method, &headers, "application/octet-stream", forever(&headers)).await
}

/// Says whether a chunk is stored, and how long it is.
#[utoipa::path(head, path = "/v1/chunks/{digest}", tag = "chunks",
    params(("digest" = Digest, Path, description = "blake3 digest of the bytes")),
    responses((status = 200, description = "It is stored"), (status = 404, description = "It is not")))]
pub(super) async fn head_chunk(
    State(farm): FarmState,
    PathParam(digest): PathParam<Digest>,
    headers: HeaderMap,
) -> Result<Response> {
    serve_bytes(&farm, digest, &Method::HEAD, &headers, "application/octet-stream", forever(&headers)).await
}

pub(super) fn forever(headers: &HeaderMap) -> &'static str {
    if headers.contains_key(header::AUTHORIZATION) { FOREVER_PRIVATE } else { FOREVER }
}

/// Answers GET or HEAD of stored bytes, with conditions and ranges.
pub(super) async fn serve_bytes(
    farm: &Farm,
    digest: Digest,
    method: &Method,
    headers: &HeaderMap,
    content_type: &'static str,
    cache_control: &'static str,
) -> Result<Response> {
    let length = farm.storage.length(digest).await?.ok_or(ChunkError::NotFound { digest })?;
    let etag = format!("\"{digest}\"");
    let fixed = [
        (header::ETAG, etag.clone()),
        (header::CACHE_CONTROL, cache_control.to_owned()),
        (header::ACCEPT_RANGES, "bytes".to_owned()),
    ];
    if is_known(text_header(headers, header::IF_NONE_MATCH), &etag) {
        return Ok((StatusCode::NOT_MODIFIED, fixed).into_response());
    }
    let applies = method == Method::GET && range_applies(text_header(headers, header::IF_RANGE), &etag);
    let range = text_header(headers, header::RANGE).filter(|_| applies);
    let (status, part) = match wanted(range, length) {
        Wanted::All => (StatusCode::OK, 0..length),
        Wanted::Part(part) => (StatusCode::PARTIAL_CONTENT, part),
        Wanted::Nothing => return Err(ServerError::Range { length }),
    };
    let body = if method == Method::HEAD {
        Body::empty()
    } else {
        let sent = farm.metrics.sent_bytes.clone();
        let bytes = farm.storage.read(digest, part.clone()).await?;
        Body::from_stream(bytes.inspect_ok(move |piece| {
            sent.inc_by(piece.len() as u64);
        }))
    };
    let size = (part.end - part.start).to_string();
    let sized = [(header::CONTENT_TYPE, content_type.to_owned()), (header::CONTENT_LENGTH, size)];
    let mut response = (status, fixed, sized, body).into_response();
    if status == StatusCode::PARTIAL_CONTENT
        && let Ok(range) = format!("bytes {}-{}/{length}", part.start, part.end - 1).parse()
    {
        response.headers_mut().insert(header::CONTENT_RANGE, range);
    }
    Ok(response)
}
