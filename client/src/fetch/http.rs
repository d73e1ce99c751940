//! HTTP calls with limits, problems decoded, and retry with growing waits.

use std::sync::Arc;
use std::time::Duration;

use lightkiln_proto::address::is_loopback;
use lightkiln_proto::problem::{Problem, RetryClass};
use opentelemetry::global::get_text_map_propagator;
use opentelemetry_http::HeaderInjector;
use tracing_opentelemetry::OpenTelemetrySpanExt;
use ureq::http::{Request, Response, header};
use ureq::middleware::MiddlewareNext;
use ureq::tls::{PemItem, RootCerts, TlsConfig, parse_pem};
use ureq::{Agent, Body, SendBody};

use super::stop::Stop;
use crate::error::{ClientError, Result};

/// Largest JSON answer that is read, in bytes.
const MAX_JSON_BYTES: u64 = 64 << 20;
/// Largest problem document that is read, in bytes.
const MAX_PROBLEM_BYTES: u64 = 1 << 20;

/// How often and when a failed call is tried again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RetryPolicy {
    /// Tries in all, at least 1. More → survives longer outages.
    pub attempts: u32,
    /// Wait after the first failure; it doubles each time. Longer → gentler on the server.
    pub first_wait: Duration,
    /// Longest wait.
    pub longest_wait: Duration,
}

impl Default for RetryPolicy {
    fn default() -> Self {
        Self { attempts: 6, first_wait: Duration::from_millis(250), longest_wait: Duration::from_secs(8) }
    }
}

impl RetryPolicy {
    /// Wait after failed try number `failed` (1, 2, …).
    pub fn wait_after(&self, failed: u32) -> Duration {
        let doubled = 1_u32.checked_shl(failed.saturating_sub(1)).unwrap_or(u32::MAX);
        self.first_wait.saturating_mul(doubled).min(self.longest_wait)
    }
}

/// A base URL and how to call it.
#[derive(Clone)]
pub(super) struct Http {
    pub base: String,
    pub agent: Agent,
    pub token: Option<String>,
    pub retry: RetryPolicy,
    pub stop: Arc<Stop>,
}

/// One call: method, path under the base, headers and body.
#[derive(Clone, Copy)]
pub(super) struct Call<'a> {
    pub method: Method,
    pub path: &'a str,
    pub headers: &'a [(&'static str, &'a str)],
    pub body: &'a [u8],
}

/// The methods that the API uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Method {
    Delete,
    Get,
    Head,
    Post,
    Put,
}

impl<'a> Call<'a> {
    pub fn new(method: Method, path: &'a str) -> Self {
        Self { method, path, headers: &[], body: &[] }
    }

    fn words(&self, base: &str) -> String {
        format!("{} {base}{}", format!("{:?}", self.method).to_uppercase(), self.path)
    }
}

fn agent(base: &str, roots: RootCerts) -> Agent {
    let mut config = Agent::config_builder()
        .http_status_as_error(false)
        .tls_config(TlsConfig::builder().root_certs(roots).build())
        .timeout_connect(Some(Duration::from_secs(10)))
        .timeout_send_body(Some(Duration::from_secs(3600)))
        .timeout_recv_response(Some(Duration::from_secs(120)))
        .timeout_recv_body(Some(Duration::from_secs(3600)))
        .user_agent(concat!("lightkiln/", env!("CARGO_PKG_VERSION")))
        .middleware(name_trace);
    if is_loopback(base) {
        config = config.proxy(None);
    }
    config.build().into()
}

/// Says which trace a call belongs to, if the caller is in one.
fn name_trace(
    mut request: Request<SendBody<'_>>,
    next: MiddlewareNext<'_>,
) -> std::result::Result<Response<Body>, ureq::Error> {
    let context = tracing::Span::current().context();
    get_text_map_propagator(|propagator| {
        propagator.inject_context(&context, &mut HeaderInjector(request.headers_mut()));
    });
    next.handle(request)
}

impl Http {
    pub fn new(base: &str, token: Option<String>) -> Result<Self> {
        let wrong =
            |problem: &str| ClientError::Source { text: base.to_owned(), problem: problem.to_owned() };
        let trimmed = base.trim_end_matches('/');
        let uri: ureq::http::Uri =
            trimmed.parse().map_err(|_| wrong("is not a URL; write http://host:port"))?;
        if !matches!(uri.scheme_str(), Some("http" | "https")) || uri.host().is_none_or(str::is_empty) {
            return Err(wrong("is not a server's URL; write http://host:port"));
        }
        if uri.query().is_some() {
            return Err(wrong("has a query; write http://host:port"));
        }
        Ok(Self {
            base: trimmed.to_owned(),
            agent: agent(trimmed, RootCerts::WebPki),
            token,
            retry: RetryPolicy::default(),
            stop: Arc::default(),
        })
    }

    /// Trusts servers whose certificates are signed by one of these (PEM), and no others.
    pub fn trust(&mut self, pem: &[u8]) -> Result<()> {
        let wrong = |problem: &str| ClientError::Argument {
            what: "the certificates to trust".to_owned(),
            problem: format!("{problem}; give a PEM file, with BEGIN CERTIFICATE in it"),
        };
        let mut roots = Vec::new();
        for item in parse_pem(pem) {
            if let PemItem::Certificate(certificate) = item.map_err(|_| wrong("they are broken"))? {
                roots.push(certificate);
            }
        }
        if roots.is_empty() {
            return Err(wrong("there are none"));
        }
        self.agent = agent(&self.base, RootCerts::new_with_certs(&roots));
        Ok(())
    }

    /// The answer's body, at most `limit` bytes; tried again while that makes sense.
    pub fn bytes(&self, call: Call<'_>, limit: u64) -> Result<Vec<u8>> {
        self.again_and_again(call, |answer| self.read(call, answer, limit))
    }

    /// The answer's body as JSON.
    pub fn json<T: serde::de::DeserializeOwned>(&self, call: Call<'_>) -> Result<T> {
        let bytes = self.bytes(call, MAX_JSON_BYTES)?;
        let place = || format!("the answer to {}", call.words(&self.base));
        serde_json::from_slice(&bytes).map_err(|source| ClientError::Json { place: place(), source })
    }

    /// Whether the thing is there: a HEAD that may say 404.
    pub fn exists(&self, path: &str) -> Result<bool> {
        let call = Call::new(Method::Head, path);
        match self.again_and_again(call, |_| Ok(())) {
            Ok(()) => Ok(true),
            Err(ClientError::Status { status: 404, .. }) => Ok(false),
            Err(ClientError::Server { problem, .. }) if problem.status == 404 => Ok(false),
            Err(error) => Err(error),
        }
    }

    fn again_and_again<T>(&self, call: Call<'_>, read: impl Fn(Response<Body>) -> Result<T>) -> Result<T> {
        let mut failed = 0;
        loop {
            let error = match self.once(call).and_then(&read) {
                Ok(value) => return Ok(value),
                Err(error) => error,
            };
            failed += 1;
            if error.retry_class() == RetryClass::Never || failed >= self.retry.attempts {
                return Err(error);
            }
            let wait = self.retry.wait_after(failed);
            tracing::debug!(%error, ?wait, "trying again");
            if self.stop.wait(wait) {
                return Err(ClientError::Stopped { call: call.words(&self.base) });
            }
        }
    }

    fn once(&self, call: Call<'_>) -> Result<Response<Body>> {
        let failed = |source| ClientError::Network { call: call.words(&self.base), source: Box::new(source) };
        let url = format!("{}{}", self.base, call.path);
        let answer = match call.method {
            Method::Delete => self.with_headers(self.agent.delete(url), call).call(),
            Method::Get => self.with_headers(self.agent.get(url), call).call(),
            Method::Head => self.with_headers(self.agent.head(url), call).call(),
            Method::Post => self.with_headers(self.agent.post(url), call).send(call.body),
            Method::Put => self.with_headers(self.agent.put(url), call).send(call.body),
        };
        let answer = answer.map_err(failed)?;
        if answer.status().is_success() { Ok(answer) } else { Err(self.refusal(call, answer)) }
    }

    fn with_headers<B>(&self, request: ureq::RequestBuilder<B>, call: Call<'_>) -> ureq::RequestBuilder<B> {
        let request = match &self.token {
            Some(token) => request.header(header::AUTHORIZATION, format!("Bearer {token}")),
            None => request,
        };
        call.headers.iter().fold(request, |request, (name, value)| request.header(*name, *value))
    }

    fn refusal(&self, call: Call<'_>, mut answer: Response<Body>) -> ClientError {
        let status = answer.status().as_u16();
        let body = answer.body_mut().with_config().limit(MAX_PROBLEM_BYTES).read_to_vec().unwrap_or_default();
        let words = call.words(&self.base);
        match serde_json::from_slice::<Problem>(&body) {
            Ok(problem) => ClientError::Server { call: words, problem: Box::new(problem) },
            Err(_) => ClientError::Status { call: words, status },
        }
    }

    fn read(&self, call: Call<'_>, mut answer: Response<Body>, limit: u64) -> Result<Vec<u8>> {
        let too_large = |bytes| ClientError::TooLarge { what: call.words(&self.base), bytes, limit };
        if let Some(bytes) = answer.body().content_length().filter(|bytes| *bytes > limit) {
            return Err(too_large(bytes));
        }
        // ureq refuses a body that reaches its limit, ours is inclusive.
        match answer.body_mut().with_config().limit(limit + 1).read_to_vec() {
            Ok(bytes) if bytes.len() as u64 > limit => Err(too_large(bytes.len() as u64)),
            Ok(bytes) => Ok(bytes),
            Err(ureq::Error::BodyExceedsLimit(_)) => Err(too_large(limit + 1)),
            Err(source) => {
                Err(ClientError::Network { call: call.words(&self.base), source: Box::new(source) })
            }
        }
    }
}
