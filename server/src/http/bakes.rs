//! Bakes as people see them.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, Method, StatusCode};
use axum::response::Response;
use lightkiln_proto::api::{
    Bake, BakeFilter, BakePage, BakeState, Blocklist, NewBake, NewPriority, WorkerPage,
};
use lightkiln_proto::filter::MAX_FILTER_CHARS;
use serde::Deserialize;
use utoipa::IntoParams;

use super::chunks::{Binary, Conditions, serve_bytes};
use super::events::MAX_SEQ;
use super::extract::{Answer, BakeId, Caller, FarmState, JsonBody, OwnBakeId, UrlQuery};
use super::trace::traceparent;
use crate::error::{Result, ServerError};

/// Largest JSON body of people's calls.
const MAX_JSON_BYTES: usize = 1 << 20;
/// Bakes on a page unless asked otherwise.
const PAGE_BAKES: u32 = 50;
/// Most bakes on a page.
const MAX_PAGE_BAKES: u32 = 500;
/// A finished bake's results are fixed, but who may see them could change.
const REVALIDATE: &str = "no-cache";

/// Query of the list of bakes.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct ListQuery {
    /// `next` of the page before.
    #[param(maximum = 9223372036854775807_i64)]
    after: Option<u64>,
    /// Bakes on the page, 1..=500; 50 unless set.
    #[param(minimum = 1, maximum = 500)]
    limit: Option<u32>,
    /// States that a bake may have, with commas between them; all unless set.
    #[param(style = Form, explode = false, min_items = 1, max_items = 5, required = false, value_type = Vec<BakeState>)]
    state: Option<String>,
    /// Text that a bake's name has in it, whatever the case of ASCII letters.
    #[param(max_length = 200)]
    name: Option<String>,
    /// Earliest submission, Unix milliseconds.
    #[param(maximum = 9223372036854775807_i64)]
    since_ms: Option<u64>,
}

impl ListQuery {
    fn filter(&self) -> Result<BakeFilter> {
        let states = self.state.as_deref().map(BakeFilter::states_of).transpose();
        let name = self.name.clone().unwrap_or_default();
        if name.chars().count() > MAX_FILTER_CHARS {
            return Err(ServerError::bad_request(format!(
                "name must have {MAX_FILTER_CHARS} characters at most"
            )));
        }
        let since_ms = self.since_ms.map(|since_ms| {
            i64::try_from(since_ms)
                .map_err(|_| ServerError::bad_request(format!("since_ms must be within 0..={}", i64::MAX)))
        });
        Ok(BakeFilter {
            states: states.map_err(ServerError::bad_request)?.unwrap_or_default(),
            name,
            since_ms: since_ms.transpose()?,
        })
    }
}

/// Headers of a submission.
#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
#[expect(dead_code, reason = "it describes headers; the handler reads them from the map")]
pub(super) struct SubmitHeaders {
    /// Makes trying again safe; 1 to 200 characters of ASCII.
    #[param(rename = "Idempotency-Key", min_length = 1, max_length = 200, pattern = "^[!-~]([ -~]*[!-~])?$")]
    idempotency_key: Option<String>,
    /// Trace that the bake's tasks will belong to (W3C Trace Context).
    traceparent: Option<String>,
}

/// Asks for a bake. The scene must be stored. The same Idempotency-Key with the same body gives the same bake.
#[utoipa::path(post, path = "/v1/bakes", tag = "bakes", request_body = NewBake,
    params(SubmitHeaders),
    responses(
        (status = 202, description = "Accepted", body = Bake),
        (status = 404, description = "The scene is not stored"),
        (status = 409, description = "The key belongs to another request"),
        (status = 422, description = "A setting is wrong")))]
pub(super) async fn submit(
    State(farm): FarmState,
    Caller(caller): Caller,
    headers: HeaderMap,
    JsonBody(bake): JsonBody<NewBake, MAX_JSON_BYTES>,
) -> Result<(StatusCode, Json<Bake>)> {
    let key = headers.get("Idempotency-Key").map(|value| {
        value
            .to_str()
            .map(str::to_owned)
            .map_err(|_| ServerError::bad_request("Idempotency-Key must be visible ASCII"))
    });
    let owner = caller.map(|bearer| bearer.name);
    let bake = farm.submit(bake, key.transpose()?, traceparent(&headers), owner).await?;
    Ok((StatusCode::ACCEPTED, Json(bake)))
}

/// Lists bakes, newest first; where filters are set, those that pass all of them.
#[utoipa::path(get, path = "/v1/bakes", tag = "bakes", params(ListQuery),
    responses((status = 200, description = "A page", body = BakePage)))]
pub(super) async fn list(State(farm): FarmState, UrlQuery(query): UrlQuery<ListQuery>) -> Answer<BakePage> {
    let limit = query.limit.unwrap_or(PAGE_BAKES);
    if !(1..=MAX_PAGE_BAKES).contains(&limit) {
        return Err(ServerError::bad_request(format!(
            "limit must be within 1..={MAX_PAGE_BAKES}, not {limit}"
        )));
    }
    if query.after.is_some_and(|after| after > MAX_SEQ) {
        return Err(ServerError::bad_request(format!("after must be within 0..={MAX_SEQ}")));
    }
    Ok(Json(farm.store.list(&query.filter()?, query.after, limit).await?))
}

/// Shows a bake.
#[utoipa::path(get, path = "/v1/bakes/{id}", tag = "bakes",
    params(("id" = String, Path, description = "The bake: its id, or a beginning of it that is no other bake's")),
    responses((status = 200, description = "The bake", body = Bake),
        (status = 404, description = "No such bake")))]
pub(super) async fn show(State(farm): FarmState, BakeId(id): BakeId) -> Answer<Bake> {
    Ok(Json(farm.store.show(&id).await?))
}

/// Deletes a bake that has ended, with the results that no other bake holds.
#[utoipa::path(delete, path = "/v1/bakes/{id}", tag = "bakes",
    params(("id" = String, Path, description = "The bake: its id, or a beginning of it that is no other bake's")),
    responses((status = 204, description = "Deleted"),
        (status = 404, description = "No such bake"),
        (status = 409, description = "It has not ended")))]
pub(super) async fn delete(State(farm): FarmState, OwnBakeId(id): OwnBakeId) -> Result<StatusCode> {
    farm.store.delete_bake(&id).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Cancels a bake; tasks that no other bake wants are dropped.
#[utoipa::path(post, path = "/v1/bakes/{id}/cancel", tag = "bakes",
    params(("id" = String, Path, description = "The bake: its id, or a beginning of it that is no other bake's")),
    responses((status = 200, description = "The bake", body = Bake),
        (status = 409, description = "It has ended")))]
pub(super) async fn cancel(State(farm): FarmState, OwnBakeId(id): OwnBakeId) -> Answer<Bake> {
    Ok(Json(farm.change(farm.store.cancel(&id)).await?))
}

/// Holds a bake's tasks back; those under way go on.
#[utoipa::path(post, path = "/v1/bakes/{id}/pause", tag = "bakes",
    params(("id" = String, Path, description = "The bake: its id, or a beginning of it that is no other bake's")),
    responses((status = 200, description = "The bake", body = Bake),
        (status = 409, description = "It has ended")))]
pub(super) async fn pause(State(farm): FarmState, OwnBakeId(id): OwnBakeId) -> Answer<Bake> {
    Ok(Json(farm.change(farm.store.pause(&id)).await?))
}

/// Ends a pause.
#[utoipa::path(post, path = "/v1/bakes/{id}/resume", tag = "bakes",
    params(("id" = String, Path, description = "The bake: its id, or a beginning of it that is no other bake's")),
    responses((status = 200, description = "The bake", body = Bake),
        (status = 409, description = "It has ended")))]
pub(super) async fn resume(State(farm): FarmState, OwnBakeId(id): OwnBakeId) -> Answer<Bake> {
    Ok(Json(farm.change(farm.store.resume(&id)).await?))
}

/// Changes a bake's priority.
#[utoipa::path(post, path = "/v1/bakes/{id}/priority", tag = "bakes", request_body = NewPriority,
    params(("id" = String, Path, description = "The bake: its id, or a beginning of it that is no other bake's")),
    responses((status = 200, description = "The bake", body = Bake),
        (status = 409, description = "It has ended")))]
pub(super) async fn reprioritise(
    State(farm): FarmState,
    OwnBakeId(id): OwnBakeId,
    JsonBody(new): JsonBody<NewPriority, MAX_JSON_BYTES>,
) -> Answer<Bake> {
    Ok(Json(farm.change(farm.store.reprioritise(&id, new.priority)).await?))
}

/// The worker whose failures are forgotten.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct WorkerQuery {
    /// A worker's name; all unless set.
    worker: Option<String>,
}

/// Lists workers that failed at tasks of the bake. Those that are blocked get none of it while others can do them.
#[utoipa::path(get, path = "/v1/bakes/{id}/blocklist", tag = "bakes",
    params(("id" = String, Path, description = "The bake: its id, or a beginning of it that is no other bake's")),
    responses((status = 200, description = "By name", body = Blocklist),
        (status = 404, description = "No such bake")))]
pub(super) async fn blocklist(State(farm): FarmState, BakeId(id): BakeId) -> Answer<Blocklist> {
    Ok(Json(farm.store.blocklist(&id).await?))
}

/// Forgets that a worker, or any, failed at tasks of the bake.
#[utoipa::path(delete, path = "/v1/bakes/{id}/blocklist", tag = "bakes",
    params(("id" = String, Path, description = "The bake: its id, or a beginning of it that is no other bake's"), WorkerQuery),
    responses((status = 200, description = "What is left", body = Blocklist),
        (status = 404, description = "No such bake")))]
pub(super) async fn clear_blocklist(
    State(farm): FarmState,
    OwnBakeId(id): OwnBakeId,
    UrlQuery(query): UrlQuery<WorkerQuery>,
) -> Answer<Blocklist> {
    Ok(Json(farm.change(farm.store.clear_blocklist(&id, query.worker.as_deref())).await?))
}

/// Gives a finished bake's manifest.
#[utoipa::path(get, path = "/v1/bakes/{id}/manifest", tag = "bakes",
    params(("id" = String, Path, description = "The bake: its id, or a beginning of it that is no other bake's"), Conditions),
    responses((status = 200, description = "The manifest", body = serde_json::Value),
        (status = 206, description = "The range", body = inline(Binary), content_type = "application/json"),
        (status = 304, description = "The caller has the bytes"),
        (status = 416, description = "The range lies outside"),
        (status = 409, description = "The bake is not done")))]
pub(super) async fn manifest(
    State(farm): FarmState,
    BakeId(id): BakeId,
    method: Method,
    headers: HeaderMap,
) -> Result<Response> {
    let digest = farm.result_of(&id, "manifest", |bake| bake.manifest).await?;
    serve_bytes(&farm, digest, &method, &headers, "application/json", REVALIDATE).await
}

/// Gives a finished bake's report.
#[utoipa::path(get, path = "/v1/bakes/{id}/report", tag = "bakes",
    params(("id" = String, Path, description = "The bake: its id, or a beginning of it that is no other bake's"), Conditions),
    responses((status = 200, description = "The report", body = serde_json::Value),
        (status = 206, description = "The range", body = inline(Binary), content_type = "application/json"),
        (status = 304, description = "The caller has the bytes"),
        (status = 416, description = "The range lies outside"),
        (status = 409, description = "The bake is not done")))]
pub(super) async fn report(
    State(farm): FarmState,
    BakeId(id): BakeId,
    method: Method,
    headers: HeaderMap,
) -> Result<Response> {
    let digest = farm.result_of(&id, "report", |bake| bake.report).await?;
    serve_bytes(&farm, digest, &method, &headers, "application/json", REVALIDATE).await
}

/// Lists workers heard of in the last ten minutes.
#[utoipa::path(get, path = "/v1/workers", tag = "workers",
    responses((status = 200, description = "By name", body = WorkerPage)))]
pub(super) async fn workers(State(farm): FarmState) -> Answer<WorkerPage> {
    Ok(Json(WorkerPage { workers: farm.store.workers().await? }))
}
