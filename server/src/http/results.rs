//! Results of a bake as they land, for whoever follows it.

use std::time::Duration;

use axum::Json;
use axum::extract::State;
use lightkiln_proto::api::{MAX_PAGE_RESULTS, ResultPage};
use serde::Deserialize;
use tokio::time::Instant;
use utoipa::IntoParams;

use super::events::{MAX_SEQ, require_wait};
use super::extract::{Answer, BakeId, FarmState, UrlQuery};
use crate::error::{Result, ServerError};
use crate::farm::MAX_KIND_BYTES;

/// Query of results.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct ResultsQuery {
    /// Give results of tasks of this kind only; of all kinds unless set.
    #[param(min_length = 1, max_length = 400)]
    kind: Option<String>,
    /// Give results with a greater `place` only; 0 unless set.
    #[param(maximum = 9223372036854775807_i64)]
    after: Option<u64>,
    /// Most results on the page, 1..=500; 500 unless set. A page whose outputs are many has fewer.
    #[param(minimum = 1, maximum = 500)]
    limit: Option<u32>,
    /// Wait this long for a result, 0..=60; 0 unless set.
    #[param(maximum = 60)]
    wait_secs: Option<u32>,
}

impl ResultsQuery {
    fn check(&self) -> Result<()> {
        let wrong = |what: String| Err(ServerError::bad_request(what));
        if let Some(limit) = self.limit.filter(|limit| !(1..=MAX_PAGE_RESULTS).contains(limit)) {
            return wrong(format!("limit must be within 1..={MAX_PAGE_RESULTS}, not {limit}"));
        }
        if let Some(after) = self.after.filter(|after| *after > MAX_SEQ) {
            return wrong(format!("after must be at most {MAX_SEQ}, not {after}"));
        }
        if self.kind.as_ref().is_some_and(|kind| !(1..=MAX_KIND_BYTES).contains(&kind.len())) {
            return wrong(format!("kind must have 1 to {MAX_KIND_BYTES} bytes"));
        }
        require_wait(self.wait_secs.unwrap_or(0))
    }
}

/// Tells which of a bake's tasks are done, with their outputs, in the order in which they landed. Each `digest` is a chunk
/// that `GET /v1/chunks/{digest}` gives while the bake is kept. A bake that has ended is answered at once.
#[utoipa::path(get, path = "/v1/bakes/{id}/results", tag = "bakes",
    params(("id" = String, Path, description = "The bake: its id, or a beginning of it that is no other bake's"), ResultsQuery),
    responses((status = 200, description = "Results, perhaps none", body = ResultPage),
        (status = 404, description = "No such bake")))]
pub(super) async fn results(
    State(farm): FarmState,
    BakeId(id): BakeId,
    UrlQuery(query): UrlQuery<ResultsQuery>,
) -> Answer<ResultPage> {
    query.check()?;
    let ResultsQuery { kind, after, limit, wait_secs } = query;
    let (after, limit) = (after.unwrap_or(0), limit.unwrap_or(MAX_PAGE_RESULTS));
    let deadline = Instant::now() + Duration::from_secs(wait_secs.unwrap_or(0).into());
    Ok(Json(farm.results(&id, kind.as_deref(), after, limit, deadline).await?))
}
