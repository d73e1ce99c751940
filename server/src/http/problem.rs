//! Errors as RFC 9457 problems.

use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use lightkiln_proto::problem::{Problem, ProblemCode};

use crate::error::ServerError;

/// Media type of a problem.
pub(super) const PROBLEM_JSON: &str = "application/problem+json";

/// An error as callers are told it.
pub(super) fn problem_of(error: &ServerError) -> Problem {
    let code = error.code();
    let chain = error.chain();
    let detail = match code {
        // Told when it began, and known since.
        _ if matches!(error, ServerError::NotReady { .. } | ServerError::NotOpen) => chain,
        // Inner causes are for the log, not for callers.
        ProblemCode::Internal | ProblemCode::Unavailable | ProblemCode::StorageFull => {
            tracing::error!(error = chain, "a request failed");
            error.to_string()
        }
        _ => chain,
    };
    Problem::new(code, detail)
}

impl IntoResponse for ServerError {
    fn into_response(self) -> Response {
        let mut response = problem_response(&problem_of(&self));
        if let Self::Unauthorized { .. } = self {
            response.headers_mut().insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
        }
        if let Self::TooManyCalls { retry_after_secs } | Self::Busy { retry_after_secs } = self {
            response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from(retry_after_secs));
        }
        if let Self::NotOpen = self {
            response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from(1));
        }
        if let Self::Range { length } = self
            && let Ok(range) = HeaderValue::try_from(format!("bytes */{length}"))
        {
            response.headers_mut().insert(header::CONTENT_RANGE, range);
        }
        response
    }
}

fn problem_response(problem: &Problem) -> Response {
    let status = StatusCode::from_u16(problem.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
    // A struct of texts and numbers always has its JSON.
    let body = serde_json::to_vec(problem).unwrap_or_default();
    (status, [(header::CONTENT_TYPE, PROBLEM_JSON)], body).into_response()
}
