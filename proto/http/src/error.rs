//! Why a call gave no answer of use, and whether the same call may succeed later.

use std::time::Duration;

use lightkiln_proto::problem::{Problem, ProblemCode, RetryClass};
use thiserror::Error;

/// A server that cannot be called, or a call without an answer of use.
#[derive(Debug, Error)]
pub enum CallError {
    /// The text is no base URL of a server.
    #[error("'{text}' {problem}; write http://host:port")]
    Address {
        /// The text as given.
        text: String,
        /// Fault in it.
        problem: &'static str,
    },
    /// The certificates to trust cannot be used.
    #[error("the certificates to trust: {problem}; give a PEM file, with BEGIN CERTIFICATE in it")]
    Certificates {
        /// Fault in them.
        problem: &'static str,
    },
    /// The server was not reached, or the connection broke.
    #[error("{call}: no answer; check that the server runs and that the URL is right")]
    Network {
        /// Method and URL.
        call: String,
        /// Cause.
        #[source]
        source: Box<ureq::Error>,
    },
    /// The server refused the call with a problem document (RFC 9457).
    #[error("{call}: the server says {}: {}", .problem.title, .problem.detail)]
    Refused {
        /// Method and URL.
        call: String,
        /// The server's reason.
        problem: Box<Problem>,
        /// Earliest time of the next try, from the header Retry-After.
        retry_after: Option<Duration>,
    },
    /// The answer is an error without a problem document.
    #[error("{call}: answered with status {status}; is this a Lightkiln server, and is the URL right?")]
    Foreign {
        /// Method and URL.
        call: String,
        /// HTTP status.
        status: u16,
        /// Earliest time of the next try, from the header Retry-After.
        retry_after: Option<Duration>,
    },
    /// The body is no JSON of the expected shape.
    #[error("{call}: the answer is not what it should be")]
    Json {
        /// Method and URL.
        call: String,
        /// Cause.
        #[source]
        source: serde_json::Error,
    },
    /// The answer holds other bytes than the range that was asked for.
    #[error("{call}: {problem}; is there a proxy before the server that cuts answers?")]
    WrongPart {
        /// Method and URL.
        call: String,
        /// Fault of the range.
        problem: String,
    },
    /// A body, sent or received, exceeds its limit.
    #[error("{body} has {bytes} bytes, more than the {limit} that are allowed")]
    TooLarge {
        /// Name of the body.
        body: String,
        /// Its length.
        bytes: u64,
        /// The limit.
        limit: u64,
    },
    /// The caller was told to stop before an answer came.
    #[error("stopped before the server answered")]
    Stopped,
}

impl CallError {
    /// Whether the same call may succeed later.
    pub fn retry_class(&self) -> RetryClass {
        match self {
            Self::Network { source, .. } => network_retry_class(source),
            Self::Refused { problem, .. } => problem.code.row().1,
            Self::Foreign { status: 408 | 425 | 429 | 500.., .. } => RetryClass::Backoff,
            Self::Foreign { .. }
            | Self::Address { .. }
            | Self::Certificates { .. }
            | Self::Json { .. }
            | Self::WrongPart { .. }
            | Self::TooLarge { .. }
            | Self::Stopped => RetryClass::Never,
        }
    }

    /// Earliest time of the next try, where the server names one.
    pub fn retry_after(&self) -> Option<Duration> {
        match self {
            Self::Refused { retry_after, .. } | Self::Foreign { retry_after, .. } => *retry_after,
            _ => None,
        }
    }

    /// HTTP status, where the server answered with an error.
    pub fn status(&self) -> Option<u16> {
        match self {
            Self::Refused { problem, .. } => Some(problem.status),
            Self::Foreign { status, .. } => Some(*status),
            _ => None,
        }
    }

    /// Code of the problem, where the server answered with one.
    pub fn code(&self) -> Option<ProblemCode> {
        match self {
            Self::Refused { problem, .. } => Some(problem.code),
            _ => None,
        }
    }

    /// Whether the server wants a token, or another one.
    pub fn is_about_tokens(&self) -> bool {
        matches!(self.status(), Some(401 | 403))
    }

    /// Whether the body that was sent exceeds the server's limit.
    pub fn is_too_large(&self) -> bool {
        matches!(self, Self::TooLarge { .. }) || self.status() == Some(413)
    }
}

fn network_retry_class(error: &ureq::Error) -> RetryClass {
    match error {
        ureq::Error::Io(_)
        | ureq::Error::Timeout(_)
        | ureq::Error::HostNotFound
        | ureq::Error::ConnectionFailed
        | ureq::Error::ConnectProxyFailed(_)
        | ureq::Error::BodyStalled
        | ureq::Error::Protocol(_) => RetryClass::Backoff,
        _ => RetryClass::Never,
    }
}
