//! The worker's side of the HTTP API (`lightkiln_proto::api`), one blocking call per method.

use std::error::Error as StdError;
use std::time::Duration;

use lightkiln_proto::address::is_loopback;
use lightkiln_proto::api::{
    ClaimAnswer, ClaimRequest, CommitAnswer, CommitVerdict, Enrolled, Enrolment, Failure, Heartbeat,
    HeartbeatAnswer, MAX_CHUNK_BYTES, TaskResult, Verdict,
};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::problem::{Problem, ProblemCode, RetryClass};
use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;
use ureq::http::{HeaderValue, Request, Response, header};
use ureq::middleware::MiddlewareNext;
use ureq::tls::{PemItem, RootCerts, TlsConfig, parse_pem};
use ureq::{Agent, Body, SendBody};

use super::trace::name_span;

/// Longest time for a small call to be answered.
const CALL_TIMEOUT: Duration = Duration::from_secs(15);
/// Longest time for an artefact to cross.
const TRANSFER_TIMEOUT: Duration = Duration::from_secs(600);
/// Largest JSON answer that is read: a lease with all its inputs fits many times.
const ANSWER_BYTES_MAX: u64 = 256 << 20;
/// Largest error body that is read.
const PROBLEM_BYTES_MAX: u64 = 64 << 10;

/// A call to the server that gave no answer of use.
#[derive(Debug, Error)]
pub enum CallError {
    /// No answer came.
    #[error("{url} does not answer")]
    NoAnswer {
        /// What was called.
        url: String,
        /// Why.
        #[source]
        source: Box<dyn StdError + Send + Sync>,
    },
    /// The server refused the call and said why.
    #[error("{url} refused: {} (status {})", .problem.detail, .problem.status)]
    Refused {
        /// What was called.
        url: String,
        /// What the server said.
        problem: Box<Problem>,
    },
    /// Something answered that does not speak this API.
    #[error("{url} answered status {status} in words that are not Lightkiln's; check the server's address")]
    Foreign {
        /// What was called.
        url: String,
        /// HTTP status.
        status: u16,
    },
    /// No server takes so much under one digest.
    #[error("{bytes} bytes are more than the {MAX_CHUNK_BYTES} that a server takes")]
    TooLarge {
        /// Bytes to store.
        bytes: u64,
    },
}

impl CallError {
    /// Whether the same call may succeed later.
    pub fn retry_class(&self) -> RetryClass {
        match self {
            Self::NoAnswer { .. } => RetryClass::Backoff,
            Self::Refused { problem, .. } => problem.code.row().1,
            Self::Foreign { status: 408 | 429 | 500.., .. } => RetryClass::Backoff,
            Self::Foreign { .. } | Self::TooLarge { .. } => RetryClass::Never,
        }
    }

    /// Whether what was sent is more than the server takes.
    pub fn is_too_large(&self) -> bool {
        matches!(self, Self::TooLarge { .. }) || self.is_status(413)
    }

    /// Whether bytes that the call names have to be uploaded again: the server lost sight of them since they were.
    pub(super) fn is_about_missing_bytes(&self) -> bool {
        matches!(self, Self::Refused { problem, .. } if problem.code == ProblemCode::NotStored)
    }

    /// Whether the server wants a token, or another one.
    pub fn is_about_tokens(&self) -> bool {
        self.is_status(401) || self.is_status(403)
    }

    fn is_status(&self, wanted: u16) -> bool {
        match self {
            Self::NoAnswer { .. } | Self::TooLarge { .. } => false,
            Self::Refused { problem, .. } => problem.status == wanted,
            Self::Foreign { status, .. } => *status == wanted,
        }
    }
}

/// A server at a base URL.
#[derive(Debug)]
pub(super) struct Farm {
    agent: Agent,
    base_url: String,
}

impl Farm {
    #[cfg(test)]
    pub(super) fn new(server_url: &str, token: Option<&str>) -> Self {
        Self::trusting(RootCerts::WebPki, server_url, token)
    }

    /// Calls go to `server_url`, for example `https://farm.local:7410`, with a bearer token if there is one. A server
    /// with TLS must have a certificate that is signed by one of `roots`.
    pub(super) fn trusting(roots: RootCerts, server_url: &str, token: Option<&str>) -> Self {
        let mut config = Agent::config_builder()
            .http_status_as_error(false)
            .tls_config(TlsConfig::builder().root_certs(roots).build())
            .timeout_connect(Some(CALL_TIMEOUT))
            .timeout_global(Some(CALL_TIMEOUT))
            .middleware(name_span);
        if is_loopback(server_url) {
            config = config.proxy(None);
        }
        // One that no header can hold is left out, and the server says that it is missing.
        let authorization = token.map(|token| HeaderValue::try_from(format!("Bearer {token}")));
        if let Some(Ok(mut authorization)) = authorization {
            authorization.set_sensitive(true);
            config = config.middleware(move |mut request: Request<SendBody>, next: MiddlewareNext| {
                request.headers_mut().insert(header::AUTHORIZATION, authorization.clone());
                next.handle(request)
            });
        }
        let base_url = server_url.trim_end_matches('/').to_owned();
        Self { agent: config.build().new_agent(), base_url }
    }

    /// Exchanges the code that this was made with for the right to work with the token of that digest.
    pub(super) fn enrol(&self, token: Digest) -> Result<Enrolled, CallError> {
        self.post("/v1/enrolments", &Enrolment { token }, CALL_TIMEOUT)
    }

    /// Asks for tasks; the server may take `wait_secs` to answer.
    pub(super) fn claim(&self, request: &ClaimRequest) -> Result<ClaimAnswer, CallError> {
        let patience = CALL_TIMEOUT + Duration::from_secs(request.wait_secs.into());
        self.post("/v1/leases", request, patience)
    }

    /// Keeps a lease, waiting at most `patience` for the answer; a lease that the server does not know is lost.
    pub(super) fn heartbeat(
        &self,
        token: &str,
        progress: f32,
        patience: Duration,
    ) -> Result<HeartbeatAnswer, CallError> {
        let path = format!("/v1/leases/{token}/heartbeat");
        match self.post(&path, &Heartbeat { progress }, patience.min(CALL_TIMEOUT)) {
            Err(error) if error.is_status(404) => {
                Ok(HeartbeatAnswer { verdict: Verdict::Lost, expires_ms: 0 })
            }
            answer => answer,
        }
    }

    /// Hands in a result; a lease that the server does not know makes it stale.
    pub(super) fn commit(&self, token: &str, result: &TaskResult) -> Result<CommitVerdict, CallError> {
        let path = format!("/v1/leases/{token}/commit");
        match self.post::<CommitAnswer>(&path, result, TRANSFER_TIMEOUT) {
            Ok(answer) => Ok(answer.verdict),
            Err(error) if error.is_status(404) => Ok(CommitVerdict::Stale),
            Err(error) => Err(error),
        }
    }

    /// Reports a failed attempt; a lease that is gone needs no report.
    pub(super) fn fail(&self, token: &str, failure: &Failure) -> Result<(), CallError> {
        self.post_for_nothing(&format!("/v1/leases/{token}/fail"), failure)
    }

    /// Gives a task back unharmed; a lease that is gone needs no release.
    pub(super) fn release(&self, token: &str) -> Result<(), CallError> {
        self.post_for_nothing(&format!("/v1/leases/{token}/release"), &serde_json::Map::new())
    }

    /// The bytes of an artefact as they came, not yet checked; `None` if the server has none.
    pub(super) fn artefact(&self, digest: Digest) -> Result<Option<Vec<u8>>, CallError> {
        let url = self.chunk_url(digest);
        let request = self.agent.get(&url).config().timeout_global(Some(TRANSFER_TIMEOUT)).build();
        let mut response = request.call().map_err(|source| no_answer(&url, source))?;
        match response.status().as_u16() {
            404 => Ok(None),
            200 => {
                // ureq refuses a body that reaches its limit, ours is inclusive.
                let body = response.body_mut().with_config().limit(MAX_CHUNK_BYTES + 1);
                body.read_to_vec().map(Some).map_err(|source| no_answer(&url, source))
            }
            _ => Err(refusal(url, response)),
        }
    }

    /// Whether the server has the artefact in its whole length.
    pub(super) fn has_artefact(&self, digest: Digest, bytes: u64) -> Result<bool, CallError> {
        let url = self.chunk_url(digest);
        let response = self.agent.head(&url).call().map_err(|source| no_answer(&url, source))?;
        match response.status().as_u16() {
            // A proxy may leave the length out; what it says otherwise is of the chunk.
            200 => Ok(content_length(&response).is_none_or(|length| length == bytes)),
            404 => Ok(false),
            _ => Err(refusal(url, response)),
        }
    }

    /// Stores an artefact.
    pub(super) fn put_artefact(&self, digest: Digest, bytes: &[u8]) -> Result<(), CallError> {
        let url = self.chunk_url(digest);
        let request = self.agent.put(&url).config().timeout_global(Some(TRANSFER_TIMEOUT)).build();
        let request = request.content_type("application/octet-stream");
        let response = request.send(bytes).map_err(|source| no_answer(&url, source))?;
        if response.status().is_success() { Ok(()) } else { Err(refusal(url, response)) }
    }

    fn chunk_url(&self, digest: Digest) -> String {
        format!("{}/v1/chunks/{digest}", self.base_url)
    }

    fn post<A: DeserializeOwned>(
        &self,
        path: &str,
        body: &impl Serialize,
        patience: Duration,
    ) -> Result<A, CallError> {
        let url = format!("{}{path}", self.base_url);
        let mut response = self.send(&url, body, patience)?;
        let status = response.status().as_u16();
        let answer = response.body_mut().with_config().limit(ANSWER_BYTES_MAX).read_to_vec();
        let answer = answer.map_err(|source| no_answer(&url, source))?;
        serde_json::from_slice(&answer).map_err(|_| CallError::Foreign { url, status })
    }

    fn post_for_nothing(&self, path: &str, body: &impl Serialize) -> Result<(), CallError> {
        let url = format!("{}{path}", self.base_url);
        match self.send(&url, body, CALL_TIMEOUT) {
            Err(error) if error.is_status(404) || error.is_status(409) => Ok(()),
            answer => answer.map(|_| ()),
        }
    }

    fn send(
        &self,
        url: &str,
        body: &impl Serialize,
        patience: Duration,
    ) -> Result<Response<Body>, CallError> {
        let request = self.agent.post(url).config().timeout_global(Some(patience)).build();
        let response = request.send_json(body).map_err(|source| no_answer(url, source))?;
        if response.status().is_success() { Ok(response) } else { Err(refusal(url.to_owned(), response)) }
    }
}

/// The certificates in a PEM text; `None` if there are none or one is broken.
pub(super) fn certificates(pem: &[u8]) -> Option<RootCerts> {
    let mut roots = Vec::new();
    for item in parse_pem(pem) {
        if let PemItem::Certificate(certificate) = item.ok()? {
            roots.push(certificate);
        }
    }
    (!roots.is_empty()).then(|| RootCerts::new_with_certs(&roots))
}

fn content_length(response: &Response<Body>) -> Option<u64> {
    response.headers().get(header::CONTENT_LENGTH)?.to_str().ok()?.parse().ok()
}

fn no_answer(url: &str, source: ureq::Error) -> CallError {
    CallError::NoAnswer { url: url.to_owned(), source: Box::new(source) }
}

fn refusal(url: String, mut response: Response<Body>) -> CallError {
    let status = response.status().as_u16();
    let body = response.body_mut().with_config().limit(PROBLEM_BYTES_MAX).read_to_vec();
    match body.ok().and_then(|body| serde_json::from_slice::<Problem>(&body).ok()) {
        Some(problem) => CallError::Refused { url, problem: Box::new(problem) },
        None => CallError::Foreign { url, status },
    }
}
