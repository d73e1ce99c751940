//! The worker's side of the HTTP API (`lightkiln_proto::api`), one blocking call per method, made once.

use std::time::Duration;

use lightkiln_http::{Call, CallError, HttpClient};
use lightkiln_proto::api::{
    ClaimAnswer, ClaimRequest, CommitAnswer, CommitVerdict, Commits, CommitsAnswer, Enrolled, Enrolment,
    Failure, Heartbeat, HeartbeatAnswer, MAX_CHUNK_BYTES, TaskResult, Verdict,
};
use lightkiln_proto::ids::Digest;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Longest time for a small call to be answered.
const CALL_TIMEOUT: Duration = Duration::from_secs(15);
/// Longest time for an artefact to cross.
const TRANSFER_TIMEOUT: Duration = Duration::from_secs(600);

/// A server that gives out tasks. Clones share connections.
#[derive(Clone, Debug)]
pub(super) struct Farm(HttpClient);

impl Farm {
    /// A server by its base URL, as [`HttpClient::new`] has it.
    pub(super) fn new(
        server_url: &str,
        token: Option<&str>,
        ca_pem: Option<&[u8]>,
    ) -> Result<Self, CallError> {
        HttpClient::new(server_url, token, ca_pem).map(Self)
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
        let answer = self.post(&path, &Heartbeat { progress }, patience.min(CALL_TIMEOUT));
        Ok(unless_gone(answer)?.unwrap_or(HeartbeatAnswer { verdict: Verdict::Lost, expires_ms: 0 }))
    }

    /// Hands in a result; a lease that the server does not know makes it stale.
    pub(super) fn commit(&self, token: &str, result: &TaskResult) -> Result<CommitVerdict, CallError> {
        let answer = self.post(&format!("/v1/leases/{token}/commit"), result, TRANSFER_TIMEOUT);
        Ok(unless_gone(answer)?.map_or(CommitVerdict::Stale, |answer: CommitAnswer| answer.verdict))
    }

    /// Hands in several results at once.
    pub(super) fn commit_all(&self, commits: &Commits) -> Result<CommitsAnswer, CallError> {
        self.post("/v1/leases/commit", commits, CALL_TIMEOUT)
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
        let call = Call::get(chunk_path(digest)).within(TRANSFER_TIMEOUT);
        unless_gone(self.0.once(&call).and_then(|answer| answer.bytes(MAX_CHUNK_BYTES)))
    }

    /// Whether the server has the artefact in its whole length.
    pub(super) fn has_artefact(&self, digest: Digest, bytes: u64) -> Result<bool, CallError> {
        let answer = unless_gone(self.0.once(&Call::head(chunk_path(digest)).within(CALL_TIMEOUT)))?;
        // A proxy may leave the length out; any other is the chunk's.
        Ok(answer.is_some_and(|answer| answer.content_length().is_none_or(|length| length == bytes)))
    }

    /// Stores an artefact.
    pub(super) fn put_artefact(&self, digest: Digest, bytes: &[u8]) -> Result<(), CallError> {
        self.0.once(&Call::put(chunk_path(digest), bytes).within(TRANSFER_TIMEOUT)).map(|_| ())
    }

    fn post<A: DeserializeOwned>(
        &self,
        path: &str,
        body: &impl Serialize,
        patience: Duration,
    ) -> Result<A, CallError> {
        self.0.once(&Call::post_json(path, body)?.within(patience))?.json()
    }

    fn post_for_nothing(&self, path: &str, body: &impl Serialize) -> Result<(), CallError> {
        match self.0.once(&Call::post_json(path, body)?.within(CALL_TIMEOUT)) {
            Err(error) if matches!(error.status(), Some(404 | 409)) => Ok(()),
            answer => answer.map(|_| ()),
        }
    }
}

fn chunk_path(digest: Digest) -> String {
    format!("/v1/chunks/{digest}")
}

/// `None` for what the server does not know.
fn unless_gone<T>(answer: Result<T, CallError>) -> Result<Option<T>, CallError> {
    match answer {
        Err(error) if error.status() == Some(404) => Ok(None),
        answer => answer.map(Some),
    }
}
