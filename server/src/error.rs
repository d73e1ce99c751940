//! The one error at this crate's edge.

use std::net::SocketAddr;
use std::path::PathBuf;

use lightkiln_proto::api::MIN_ID_CHARS;
use lightkiln_proto::evaluation::EvaluationError;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::kinds::BakeError;
use lightkiln_proto::problem::{ProblemCode, RetryClass, chain};
use thiserror::Error;

use crate::access::AccessError;
use crate::chunks::ChunkError;
use crate::occupant::Occupant;
use crate::store::StoreError;

/// Result of a server's call.
pub type Result<T, E = ServerError> = std::result::Result<T, E>;

/// Everything that can go wrong in a server.
#[derive(Debug, Error)]
pub enum ServerError {
    /// The call does not take such a request.
    #[error("{what}")]
    BadRequest {
        /// The fault, where it is, and the way out.
        what: String,
    },
    /// The bake cannot be planned from its settings.
    #[error("the bake cannot be planned")]
    BadBake(#[from] BakeError),
    /// The scene was never uploaded.
    #[error("there is no scene {scene}; upload it with PUT /v1/scenes/{scene} first")]
    NoSuchScene {
        /// The scene asked for.
        scene: Digest,
    },
    /// A result names bytes that were never uploaded, or are no more.
    #[error("output '{name}' is not stored; PUT /v1/chunks/{digest} first, then hand the result in again")]
    NoSuchOutput {
        /// The output.
        name: String,
        /// Digest of its bytes.
        digest: Digest,
    },
    /// The body stopped coming.
    #[error("the request's body broke off; send it again")]
    BodyBrokeOff(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// The call needs a token that it does not have.
    #[error(
        "{why}; send 'Authorization: Bearer TOKEN' (kiln: set KILN_TOKEN), \
         with a token that the farm's owner makes with 'kiln token create'"
    )]
    Unauthorized {
        /// The fault of the token.
        why: &'static str,
    },
    /// The token is good for other calls.
    #[error("the token does not open this call; it needs one with the scope {wanted}")]
    Forbidden {
        /// Scopes that would do.
        wanted: String,
    },
    /// The bake is another bearer's.
    #[error(
        "bake '{bake}' was submitted with the token of '{owner}', this one is that of '{caller}'; it takes that token to change it, or \
         one with the scope admin"
    )]
    NotOwner {
        /// The bake.
        bake: String,
        /// The bearer who submitted it.
        owner: String,
        /// The bearer who calls.
        caller: String,
    },
    /// A bearer's name or scopes are malformed.
    #[error(transparent)]
    Access(#[from] AccessError),
    /// So few characters of a bake's id that a slip would mean another bake.
    #[error("'{text}' is too little of a bake's id; give {MIN_ID_CHARS} characters or more")]
    ShortId {
        /// The text given.
        text: String,
    },
    /// The beginning of several bakes' ids.
    #[error("'{text}' is the beginning of several ids; give more of the one that is meant:{candidates}")]
    AmbiguousId {
        /// The text given.
        text: String,
        /// The bakes, a line each.
        candidates: String,
    },
    /// No such lease.
    #[error("there is no such lease")]
    NoSuchLease,
    /// A result of a bake that has none yet, or never will.
    #[error("bake '{bake}' has no {what}: {why}")]
    NoResult {
        /// The bake.
        bake: String,
        /// The result asked for.
        what: &'static str,
        /// Its state, in words.
        why: String,
    },
    /// A file that no evaluation of the bake names.
    #[error(
        "the evaluation of bake '{bake}' has no file {digest}; GET /v1/bakes/{bake}/evaluation names those that it has"
    )]
    NoSuchEvaluationFile {
        /// The bake.
        bake: String,
        /// The file asked for.
        digest: Digest,
    },
    /// An index of an evaluation that names other lengths than those stored.
    #[error("file '{name}' has {stored} bytes, not the {named} that the index names")]
    EvaluationFileLength {
        /// The file.
        name: String,
        /// Its length.
        stored: u64,
        /// The length in the index.
        named: u64,
    },
    /// An evaluation's index breaks its rules.
    #[error(transparent)]
    Evaluation(#[from] EvaluationError),
    /// The range lies outside the bytes.
    #[error("the range lies outside the {length} bytes")]
    Range {
        /// Length of the whole.
        length: u64,
    },
    /// The path is none of this server's.
    #[error("there is nothing at {path}; see /openapi.json")]
    NoSuchPath {
        /// The path.
        path: String,
    },
    /// The path exists, the method does not.
    #[error("{path} does not take {method}; see /openapi.json")]
    MethodNotAllowed {
        /// The path.
        path: String,
        /// The method.
        method: String,
    },
    /// The body is longer than the call allows.
    #[error("the body is larger than {limit} bytes")]
    BodyTooLarge {
        /// Limit in bytes.
        limit: u64,
    },
    /// One caller calls too often.
    #[error("this caller calls too often; come again in {retry_after_secs} s (the server's --calls-per-sec)")]
    TooManyCalls {
        /// Seconds after which there is room.
        retry_after_secs: u64,
    },
    /// Too many calls are under way.
    #[error(
        "too many calls are under way; come again in {retry_after_secs} s (the server's --calls-at-a-time)"
    )]
    Busy {
        /// Seconds after which to try again.
        retry_after_secs: u64,
    },
    /// The queue refused or failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The chunk store refused or failed.
    #[error(transparent)]
    Chunks(#[from] ChunkError),
    /// A file or folder of the state cannot be used.
    #[error("cannot {action} {}", path.display())]
    State {
        /// The action tried.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// Why not.
        #[source]
        source: std::io::Error,
    },
    /// Another program has the state folder open.
    #[error("{} is in use by {by}", path.display())]
    StateInUse {
        /// The folder.
        path: PathBuf,
        /// Who that is.
        by: Occupant,
    },
    /// The address can be reached from other machines, and nobody has a token.
    #[error(
        "{address} can be reached from other machines and nobody has a token of this farm; \
         make one with 'kiln token create', or listen on 127.0.0.1"
    )]
    NotLoopback {
        /// The address.
        address: SocketAddr,
    },
    /// Listening failed.
    #[error("cannot listen on {address}")]
    Listen {
        /// The address.
        address: String,
        /// Why not.
        #[source]
        source: std::io::Error,
    },
    /// The certificate or its key cannot be used.
    #[error("the certificate {} with the key {} cannot be used; both are PEM files", cert.display(), key.display())]
    Tls {
        /// File of the certificate.
        cert: PathBuf,
        /// File of its key.
        key: PathBuf,
        /// Why not.
        #[source]
        source: std::io::Error,
    },
    /// Webhooks that cannot be.
    #[error("webhooks cannot be delivered: {what}")]
    Webhook {
        /// Their fault.
        what: String,
    },
    /// The farm cannot work now.
    #[error("{why}")]
    NotReady {
        /// The hindrance.
        why: String,
        /// It is a full disk.
        is_full: bool,
    },
    /// The server has started before its database.
    #[error("the server waits for its database; come again in a moment")]
    NotOpen,
    /// A bug.
    #[error("the server has a bug and could not answer; its log says where")]
    Panicked,
    /// Serving failed.
    #[error("serving ended with an error")]
    Serve(#[source] std::io::Error),
}

impl ServerError {
    /// A request that its call does not take, and why.
    pub(crate) fn bad_request(what: impl Into<String>) -> Self {
        Self::BadRequest { what: what.into() }
    }

    /// The problem that a caller sees.
    pub fn code(&self) -> ProblemCode {
        match self {
            Self::BadRequest { .. } | Self::AmbiguousId { .. } => ProblemCode::BadRequest,
            Self::BadBake(_) => ProblemCode::BadSettings,
            Self::Evaluation(_) | Self::EvaluationFileLength { .. } => ProblemCode::BadEvaluation,
            Self::Unauthorized { .. } => ProblemCode::Unauthorized,
            Self::Forbidden { .. } | Self::NotOwner { .. } => ProblemCode::Forbidden,
            Self::Access(_) => ProblemCode::BadRequest,
            Self::NoSuchOutput { .. } => ProblemCode::NotStored,
            Self::BodyBrokeOff(_) => ProblemCode::BrokeOff,
            Self::NoSuchEvaluationFile { .. }
            | Self::NoSuchScene { .. }
            | Self::NoSuchLease
            | Self::NoSuchPath { .. }
            | Self::ShortId { .. } => ProblemCode::NotFound,
            Self::NoResult { .. } => ProblemCode::StateConflict,
            Self::Range { .. } => ProblemCode::RangeNotSatisfiable,
            Self::MethodNotAllowed { .. } => ProblemCode::MethodNotAllowed,
            Self::BodyTooLarge { .. } => ProblemCode::TooLarge,
            Self::TooManyCalls { .. } | Self::Busy { .. } => ProblemCode::TooManyRequests,
            Self::Store(error) => error.code(),
            Self::Chunks(error) => error.code(),
            Self::State { .. }
            | Self::Tls { .. }
            | Self::Webhook { .. }
            | Self::Serve(_)
            | Self::Panicked => ProblemCode::Internal,
            Self::NotReady { is_full: true, .. } => ProblemCode::StorageFull,
            Self::NotReady { is_full: false, .. }
            | Self::NotOpen
            | Self::StateInUse { .. }
            | Self::NotLoopback { .. }
            | Self::Listen { .. } => ProblemCode::Unavailable,
        }
    }

    /// Whether the same call may be tried again.
    pub fn retry_class(&self) -> RetryClass {
        self.code().row().1
    }

    /// The error and its causes in one line.
    pub fn chain(&self) -> String {
        chain(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chain_names_every_cause_once() {
        let error = ServerError::from(StoreError::Unavailable("locked".into()));
        assert_eq!(error.chain(), "the farm's database does not answer: locked");
        assert_eq!(error.code(), ProblemCode::Unavailable);
        assert_eq!(error.retry_class(), RetryClass::Backoff);
    }
}
