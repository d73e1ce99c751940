//! Leases as workers see them.

use axum::Json;
use axum::extract::{FromRequestParts, State};
use axum::http::StatusCode;
use axum::http::request::Parts;
use lightkiln_proto::api::{
    ClaimAnswer, ClaimRequest, CommitAnswer, CommitOutcome, Commits, CommitsAnswer, Failure, Heartbeat,
    HeartbeatAnswer, TaskResult,
};

use super::extract::{Answer, Caller, FarmState, JsonBody, PathParam};
use super::problem::problem_of;
use crate::access::bound_to;
use crate::error::{Result, ServerError};

/// Largest JSON body of small calls.
const MAX_JSON_BYTES: usize = 1 << 20;
/// Largest result: a plan of some hundred thousand tasks. A server takes ten times as much memory for it; deploy/ gives as
/// much.
pub const MAX_RESULT_BYTES: usize = 64 << 20;
/// The call that brings a result.
pub(super) const COMMIT: &str = "/v1/leases/{token}/commit";
/// The call that brings several.
pub(super) const COMMIT_ALL: &str = "/v1/leases/commit";

/// The lease that the path names: nobody's but the bearer's that claimed it.
pub(super) struct LeaseToken(String);

impl<S: Send + Sync> FromRequestParts<S> for LeaseToken {
    type Rejection = ServerError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self> {
        let PathParam(token) = PathParam::<String>::from_request_parts(parts, state).await?;
        let Caller(caller) = Caller::from_request_parts(parts, state).await?;
        Ok(Self(bound_to(caller.as_ref(), &token)))
    }
}

/// Claims tasks. Waits up to `wait_secs` for some.
#[utoipa::path(post, path = "/v1/leases", tag = "leases", request_body = ClaimRequest,
    responses((status = 200, description = "Leases, perhaps none", body = ClaimAnswer)))]
pub(super) async fn claim(
    State(farm): FarmState,
    Caller(caller): Caller,
    JsonBody(request): JsonBody<ClaimRequest, MAX_JSON_BYTES>,
) -> Answer<ClaimAnswer> {
    let mut answer = farm.claim(request).await?;
    for lease in &mut answer.leases {
        lease.token = bound_to(caller.as_ref(), &lease.token);
    }
    Ok(Json(answer))
}

/// Says that a task is still being worked on.
#[utoipa::path(post, path = "/v1/leases/{token}/heartbeat", tag = "leases", request_body = Heartbeat,
    params(("token" = String, Path, description = "The lease's token: 32 lower-case hex digits", pattern = "^[0-9a-f]{32}$")),
    responses((status = 200, description = "What to do", body = HeartbeatAnswer)))]
pub(super) async fn heartbeat(
    State(farm): FarmState,
    LeaseToken(token): LeaseToken,
    JsonBody(heartbeat): JsonBody<Heartbeat, MAX_JSON_BYTES>,
) -> Answer<HeartbeatAnswer> {
    Ok(Json(farm.heartbeat(&token, heartbeat.progress).await?))
}

/// Hands in a result. Safe to try again with the same token.
#[utoipa::path(post, path = "/v1/leases/{token}/commit", tag = "leases", request_body = TaskResult,
    params(("token" = String, Path, description = "The lease's token: 32 lower-case hex digits", pattern = "^[0-9a-f]{32}$")),
    responses((status = 200, description = "What became of it", body = CommitAnswer),
        (status = 400, description = "The plan is none"),
        (status = 409, description = "An output is not stored, or no more: upload it and hand the result in again")))]
pub(super) async fn commit(
    State(farm): FarmState,
    LeaseToken(token): LeaseToken,
    JsonBody(result): JsonBody<TaskResult, MAX_RESULT_BYTES>,
) -> Answer<CommitAnswer> {
    Ok(Json(CommitAnswer { verdict: farm.commit(&token, result).await? }))
}

/// Hands in results of several leases. Each is taken in or refused by itself; safe to try again with the same tokens.
#[utoipa::path(post, path = "/v1/leases/commit", tag = "leases", request_body = Commits,
    responses((status = 200, description = "What became of each", body = CommitsAnswer)))]
pub(super) async fn commit_all(
    State(farm): FarmState,
    Caller(caller): Caller,
    JsonBody(commits): JsonBody<Commits, MAX_RESULT_BYTES>,
) -> Answer<CommitsAnswer> {
    let commits = commits.commits.into_iter();
    let commits = commits.map(|commit| (bound_to(caller.as_ref(), &commit.token), commit.result));
    let outcomes = farm.commit_all(commits.collect()).await?.into_iter().map(|outcome| match outcome {
        Ok(verdict) => CommitOutcome::Verdict(verdict),
        Err(error) => CommitOutcome::Problem(problem_of(&error)),
    });
    Ok(Json(CommitsAnswer { answers: outcomes.collect() }))
}

/// Ends an attempt without a result. A lease that is gone already is no error.
#[utoipa::path(post, path = "/v1/leases/{token}/fail", tag = "leases", request_body = Failure,
    params(("token" = String, Path, description = "The lease's token: 32 lower-case hex digits", pattern = "^[0-9a-f]{32}$")),
    responses((status = 204, description = "Noted")))]
pub(super) async fn fail(
    State(farm): FarmState,
    LeaseToken(token): LeaseToken,
    JsonBody(failure): JsonBody<Failure, MAX_JSON_BYTES>,
) -> Result<StatusCode> {
    farm.fail(&token, failure.blame, &failure.message).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Gives a task back; no attempt is counted. A lease that is gone already is no error.
#[utoipa::path(post, path = "/v1/leases/{token}/release", tag = "leases",
    params(("token" = String, Path, description = "The lease's token: 32 lower-case hex digits", pattern = "^[0-9a-f]{32}$")),
    responses((status = 204, description = "Noted")))]
pub(super) async fn release(State(farm): FarmState, LeaseToken(token): LeaseToken) -> Result<StatusCode> {
    farm.release(&token).await?;
    Ok(StatusCode::NO_CONTENT)
}
