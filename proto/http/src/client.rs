//! A server as its callers see it: base URL, agent, token, patience.

use std::time::Duration;

use lightkiln_proto::address::is_loopback;
use lightkiln_proto::problem::Problem;
use serde::de::DeserializeOwned;
use ureq::http::{HeaderValue, Request, Response, Uri, header};
use ureq::middleware::MiddlewareNext;
use ureq::tls::{PemItem, RootCerts, TlsConfig, parse_pem};
use ureq::{Agent, AsSendBody, Body, SendBody};

use crate::call::{Answer, Call, Payload, number_in};
use crate::error::CallError;
use crate::patience::Patience;
use crate::retry::{RetryPolicy, USUAL, retry};
use crate::shutdown::{Level, ShutdownFlag};
use crate::trace::name_span;

/// Connections to a server that are kept for later calls, and so the most calls at a time that make none anew. More → faster over long
/// lines, as overviews are of hundreds of small chunks.
pub const CONNECTIONS: usize = 32;

/// Longest time for a connection to come about.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(10);
/// Longest time for a body to cross, where a call has no patience of its own.
const BODY_TIMEOUT: Duration = Duration::from_secs(3600);
/// Longest time between a call and its answer's head, where a call has no patience of its own.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(120);
/// Largest problem document that is read, in bytes.
const PROBLEM_BYTES_MAX: u64 = 1 << 20;

/// A server at a base URL, for example `https://farm.local:7410`. Clones share connections.
#[derive(Clone, Debug)]
pub struct HttpClient {
    base: String,
    agent: Agent,
    retry: RetryPolicy,
    /// In place of the policy.
    patience: Option<Patience>,
    shutdown: ShutdownFlag,
}

impl HttpClient {
    /// A server by its base URL, with a bearer token if it wants one. A server with TLS must have a certificate signed
    /// by one of `ca_pem`, or by an authority of the web where that is `None`.
    pub fn new(base: &str, token: Option<&str>, ca_pem: Option<&[u8]>) -> Result<Self, CallError> {
        let base = checked_base(base)?;
        let roots = ca_pem.map_or(Ok(RootCerts::WebPki), certificates)?;
        Ok(Self {
            base: base.to_owned(),
            agent: agent(base, token, roots),
            retry: USUAL,
            patience: None,
            shutdown: ShutdownFlag::new(),
        })
    }

    /// The same server with other patience.
    #[must_use]
    pub fn with_retry(self, retry: RetryPolicy) -> Self {
        Self { retry, ..self }
    }

    /// The same server, waited for while it is away, whatever the policy.
    #[must_use]
    pub fn with_patience(self, patience: Patience) -> Self {
        Self { patience: Some(patience), ..self }
    }

    /// The same server; waits between tries end when `shutdown` is raised.
    #[must_use]
    pub fn with_shutdown(self, shutdown: ShutdownFlag) -> Self {
        Self { shutdown, ..self }
    }

    /// Base URL, without a slash at its end.
    pub fn base(&self) -> &str {
        &self.base
    }

    /// Fails where the caller was told to stop.
    pub fn check_shutdown(&self) -> Result<(), CallError> {
        if self.shutdown.level() > Level::Run { Err(CallError::Stopped) } else { Ok(()) }
    }

    /// Makes `call` until it succeeds, fails for good or patience ends; gives the answer as `read` has it.
    pub fn call<T>(
        &self,
        call: &Call<'_>,
        read: impl Fn(Answer) -> Result<T, CallError>,
    ) -> Result<T, CallError> {
        self.try_again(|| self.once(call).and_then(&read))
    }

    /// Makes `call` until it succeeds, fails for good or patience ends.
    pub(crate) fn try_again<T>(&self, call: impl FnMut() -> Result<T, CallError>) -> Result<T, CallError> {
        let pause = |error: &CallError, wait| self.pause(error, wait);
        match &self.patience {
            Some(patience) => patience.insist(call, pause),
            None => retry(self.retry, call, pause),
        }
    }

    /// Waits before the next try, unless the caller is told to stop.
    fn pause(&self, error: &CallError, wait: Duration) -> Result<(), CallError> {
        tracing::debug!(%error, ?wait, "trying again");
        self.shutdown.wait(wait, |level| level > Level::Run);
        self.check_shutdown()
    }

    /// The answer to `call` as JSON, tried again while that makes sense.
    pub fn json<T: DeserializeOwned>(&self, call: &Call<'_>) -> Result<T, CallError> {
        self.call(call, Answer::json)
    }

    /// The body of the answer to `call`, at most `limit` bytes, tried again while that makes sense.
    pub fn bytes(&self, call: &Call<'_>, limit: u64) -> Result<Vec<u8>, CallError> {
        self.call(call, |answer| answer.bytes(limit))
    }

    /// Makes `call` once.
    pub fn once(&self, call: &Call<'_>) -> Result<Answer, CallError> {
        let sent = match &call.body {
            Payload::None => self.send(call, ()),
            Payload::Bytes(bytes) => self.send(call, *bytes),
            Payload::Json(text) => self.send(call, text),
        };
        let name = format!("{} {}{}", call.method, self.base, call.path);
        match sent {
            Ok(response) if response.status().is_success() => Ok(Answer { call: name, response }),
            Ok(response) => Err(refusal(name, response)),
            Err(source) => Err(CallError::Network { call: name, source: Box::new(source) }),
        }
    }

    fn send(&self, call: &Call<'_>, body: impl AsSendBody) -> Result<Response<Body>, ureq::Error> {
        let mut request = Request::builder().method(&call.method).uri(format!("{}{}", self.base, call.path));
        for (name, value) in &call.headers {
            request = request.header(*name, *value);
        }
        let request = self.agent.configure_request(request.body(body)?);
        let request = match call.patience {
            // It bounds the answer's head as well, which a slow server may give late.
            Some(patience) => request.timeout_global(Some(patience)).timeout_recv_response(None),
            None => request,
        };
        self.agent.run(request.build())
    }
}

fn checked_base(text: &str) -> Result<&str, CallError> {
    let wrong = |problem| CallError::Address { text: text.to_owned(), problem };
    let base = text.trim_end_matches('/');
    let uri: Uri = base.parse().map_err(|_| wrong("is not a URL"))?;
    if !matches!(uri.scheme_str(), Some("http" | "https")) || uri.host().is_none_or(str::is_empty) {
        return Err(wrong("is not a server's URL"));
    }
    if uri.query().is_some() { Err(wrong("has a query")) } else { Ok(base) }
}

fn certificates(pem: &[u8]) -> Result<RootCerts, CallError> {
    let mut roots = Vec::new();
    for item in parse_pem(pem) {
        if let Ok(PemItem::Certificate(certificate)) = item {
            roots.push(certificate);
        } else if item.is_err() {
            return Err(CallError::Certificates { problem: "they are broken" });
        }
    }
    if roots.is_empty() {
        return Err(CallError::Certificates { problem: "there are none" });
    }
    Ok(RootCerts::new_with_certs(&roots))
}

fn agent(base: &str, token: Option<&str>, roots: RootCerts) -> Agent {
    let mut config = Agent::config_builder()
        .http_status_as_error(false)
        .tls_config(TlsConfig::builder().root_certs(roots).build())
        .timeout_connect(Some(CONNECT_TIMEOUT))
        .timeout_send_body(Some(BODY_TIMEOUT))
        .timeout_recv_response(Some(ANSWER_TIMEOUT))
        .timeout_recv_body(Some(BODY_TIMEOUT))
        .max_idle_connections(CONNECTIONS)
        .max_idle_connections_per_host(CONNECTIONS)
        .user_agent(concat!("lightkiln/", env!("CARGO_PKG_VERSION")))
        .middleware(name_span);
    // A proxy set for the outside world must not come between.
    if is_loopback(base) {
        config = config.proxy(None);
    }
    // A token that no header can hold is left out; the server says that it is missing.
    let authorization = token.map(|token| HeaderValue::try_from(format!("Bearer {token}")));
    if let Some(Ok(mut authorization)) = authorization {
        authorization.set_sensitive(true);
        config = config.middleware(move |mut request: Request<SendBody>, next: MiddlewareNext| {
            request.headers_mut().insert(header::AUTHORIZATION, authorization.clone());
            next.handle(request)
        });
    }
    config.build().new_agent()
}

fn refusal(call: String, mut response: Response<Body>) -> CallError {
    let status = response.status().as_u16();
    let retry_after = number_in(response.headers(), header::RETRY_AFTER).map(Duration::from_secs);
    let body = response.body_mut().with_config().limit(PROBLEM_BYTES_MAX).read_to_vec();
    match body.ok().and_then(|body| serde_json::from_slice::<Problem>(&body).ok()) {
        Some(problem) => CallError::Refused { call, problem: Box::new(problem), retry_after },
        None => CallError::Foreign { call, status, retry_after },
    }
}
