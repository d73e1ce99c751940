//! Errors over HTTP: RFC 9457 problems, and one table of code → status → retry.

use std::error::Error;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Stable error codes; the `type` of a problem is `urn:lightkiln:problem:` + its kebab-case name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ProblemCode {
    /// The request's body, path or query is not what the call takes.
    BadRequest,
    /// A setting is unknown or out of range.
    BadSettings,
    /// The index of an evaluation names files that it may not have.
    BadEvaluation,
    /// The bytes are not those of the digest in the path.
    DigestMismatch,
    /// The call needs a token, and has none that is good.
    Unauthorized,
    /// The token is good for other calls.
    Forbidden,
    /// There is no such bake, scene, chunk or lease.
    NotFound,
    /// The path exists, the method does not.
    MethodNotAllowed,
    /// The Idempotency-Key was used with another body.
    IdempotencyConflict,
    /// Bytes that the request names are not stored; the same call works once they are.
    NotStored,
    /// The bake's state does not allow this call.
    StateConflict,
    /// The body stopped coming before its end.
    BrokeOff,
    /// The body is larger than the limit.
    TooLarge,
    /// The Range header cannot be satisfied.
    RangeNotSatisfiable,
    /// The caller calls too often, or too many calls are under way; the header Retry-After says when to come again.
    TooManyRequests,
    /// No room on the server's disk.
    StorageFull,
    /// The database or the chunk store does not answer now.
    Unavailable,
    /// A fault of the server.
    Internal,
}

/// Whether and when the same call may be tried again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RetryClass {
    /// The same call will fail again.
    Never,
    /// Later, with growing waits.
    Backoff,
}

impl ProblemCode {
    /// All codes, for documentation and tests.
    pub const ALL: [Self; 18] = [
        Self::BadRequest,
        Self::BadSettings,
        Self::BadEvaluation,
        Self::DigestMismatch,
        Self::Unauthorized,
        Self::Forbidden,
        Self::NotFound,
        Self::MethodNotAllowed,
        Self::IdempotencyConflict,
        Self::NotStored,
        Self::StateConflict,
        Self::BrokeOff,
        Self::TooLarge,
        Self::RangeNotSatisfiable,
        Self::TooManyRequests,
        Self::StorageFull,
        Self::Unavailable,
        Self::Internal,
    ];

    /// HTTP status, retry class and title of a code.
    pub fn row(self) -> (u16, RetryClass, &'static str) {
        use RetryClass::{Backoff, Never};
        match self {
            Self::BadRequest => (400, Never, "The request is malformed"),
            Self::BadSettings => (422, Never, "A setting is wrong"),
            Self::BadEvaluation => (422, Never, "The evaluation's index is wrong"),
            Self::DigestMismatch => (422, Never, "The bytes do not match the digest"),
            Self::Unauthorized => (401, Never, "A token is needed"),
            Self::Forbidden => (403, Never, "The token is not good for this"),
            Self::NotFound => (404, Never, "Not found"),
            Self::MethodNotAllowed => (405, Never, "Method not allowed"),
            Self::IdempotencyConflict => (409, Never, "The Idempotency-Key belongs to another request"),
            Self::NotStored => (409, Never, "Bytes that this needs are not stored"),
            Self::StateConflict => (409, Never, "The bake's state does not allow this"),
            Self::BrokeOff => (408, Backoff, "The request broke off"),
            Self::TooLarge => (413, Never, "The body is too large"),
            Self::RangeNotSatisfiable => (416, Never, "The range cannot be satisfied"),
            Self::TooManyRequests => (429, Backoff, "Too many requests"),
            Self::StorageFull => (507, Backoff, "No room left"),
            Self::Unavailable => (503, Backoff, "Not available now"),
            Self::Internal => (500, Backoff, "Internal error"),
        }
    }

    /// The problem's stable type URI.
    pub fn type_uri(self) -> String {
        let name = serde_json::to_value(self).ok();
        let name = name.as_ref().and_then(|value| value.as_str()).unwrap_or("internal");
        format!("urn:lightkiln:problem:{name}")
    }
}

/// An error and its causes, from the outermost in.
pub fn causes<'a>(error: &'a (dyn Error + 'static)) -> impl Iterator<Item = &'a (dyn Error + 'static)> {
    std::iter::successors(Some(error), |&error| error.source())
}

/// An error and its causes in one line, each told once: errors of other crates often repeat their sources.
pub fn chain(error: &(dyn Error + 'static)) -> String {
    let mut line = String::new();
    for cause in causes(error).map(ToString::to_string) {
        if !line.ends_with(&cause) {
            line += if line.is_empty() { "" } else { ": " };
            line += &cause;
        }
    }
    line
}

/// RFC 9457 problem details.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Problem {
    /// Stable type URI, `urn:lightkiln:problem:…`.
    #[serde(rename = "type")]
    pub type_uri: String,
    /// The same for every problem of the type.
    pub title: String,
    /// HTTP status.
    pub status: u16,
    /// The fault this time, its place and the remedy.
    pub detail: String,
    /// The code behind the type.
    pub code: ProblemCode,
}

impl Problem {
    /// A problem of a code with its own words.
    pub fn new(code: ProblemCode, detail: impl Into<String>) -> Self {
        let (status, _, title) = code.row();
        Self { type_uri: code.type_uri(), title: title.to_owned(), status, detail: detail.into(), code }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cause_that_an_error_repeats_is_told_once() {
        #[derive(Debug, thiserror::Error)]
        #[error("{0}")]
        struct Told(&'static str, #[source] Option<Box<Told>>);
        let disk = Told("disk is full", None);
        let database = Told("error returned from database: disk is full", Some(disk.into()));
        let error = Told("no room left", Some(database.into()));
        assert_eq!(chain(&error), "no room left: error returned from database: disk is full");
    }

    #[test]
    fn every_code_has_an_error_status_and_a_type_of_its_own() {
        let mut types: Vec<_> = ProblemCode::ALL.iter().map(|code| code.type_uri()).collect();
        types.sort();
        types.dedup();
        assert_eq!(types.len(), ProblemCode::ALL.len());
        assert!(ProblemCode::ALL.iter().all(|code| (400..600).contains(&code.row().0)));
    }
}
