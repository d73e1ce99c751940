//! Codes for tokens.

use axum::Json;
use axum::extract::State;
use axum::http::HeaderMap;
use lightkiln_proto::api::{Enrolled, Enrolment};

use super::extract::{Answer, FarmState, JsonBody};
use super::guard::bearer_token;

/// Largest body: one digest fits many times.
const MAX_JSON_BYTES: usize = 4 << 10;

/// Exchanges a code, given as bearer token, for the right to work with a token whose digest the body has. A code is good
/// for an hour and for one token; the same call again gives the same answer.
#[utoipa::path(post, path = "/v1/enrolments", tag = "workers", request_body = Enrolment,
    responses((status = 200, description = "The token is good from now on", body = Enrolled),
        (status = 401, description = "The code is unknown, too old, or was used")))]
pub(super) async fn enrol(
    State(farm): FarmState,
    headers: HeaderMap,
    JsonBody(enrolment): JsonBody<Enrolment, MAX_JSON_BYTES>,
) -> Answer<Enrolled> {
    let code = bearer_token(&headers).unwrap_or_default();
    Ok(Json(Enrolled { name: farm.guard.enrol(code, enrolment.token).await? }))
}
