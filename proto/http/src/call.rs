//! One call and its answer.

use std::time::Duration;

use serde::Serialize;
use serde::de::DeserializeOwned;
use ureq::http::{HeaderMap, Method, Response, header};
use ureq::{Body, Error};

use crate::error::CallError;

/// Largest JSON answer that is read, in bytes: a lease with all its inputs fits many times.
const JSON_BYTES_MAX: u64 = 256 << 20;

/// A call: method, path under the server's base URL, headers, body, and the longest time until its answer is read.
#[derive(Debug)]
pub struct Call<'a> {
    pub(crate) method: Method,
    pub(crate) path: String,
    pub(crate) headers: Vec<(&'static str, &'a str)>,
    pub(crate) body: Payload<'a>,
    pub(crate) patience: Option<Duration>,
}

/// Body of a call.
#[derive(Debug)]
pub(crate) enum Payload<'a> {
    /// Nothing; methods that have no body.
    None,
    /// Bytes of the caller.
    Bytes(&'a [u8]),
    /// A JSON text.
    Json(Vec<u8>),
}

impl<'a> Call<'a> {
    fn new(method: Method, path: impl Into<String>, body: Payload<'a>) -> Self {
        Self { method, path: path.into(), headers: Vec::new(), body, patience: None }
    }

    /// `DELETE path`.
    pub fn delete(path: impl Into<String>) -> Self {
        Self::new(Method::DELETE, path, Payload::None)
    }

    /// `GET path`.
    pub fn get(path: impl Into<String>) -> Self {
        Self::new(Method::GET, path, Payload::None)
    }

    /// `HEAD path`.
    pub fn head(path: impl Into<String>) -> Self {
        Self::new(Method::HEAD, path, Payload::None)
    }

    /// `POST path` with an empty body.
    pub fn post(path: impl Into<String>) -> Self {
        Self::new(Method::POST, path, Payload::Bytes(&[]))
    }

    /// `POST path` with a JSON body.
    pub fn post_json(path: impl Into<String>, body: &impl Serialize) -> Result<Self, CallError> {
        let path = path.into();
        let json = serde_json::to_vec(body)
            .map_err(|source| CallError::Json { call: format!("the body of POST {path}"), source })?;
        Ok(Self::new(Method::POST, path, Payload::Json(json)).header("content-type", "application/json"))
    }

    /// `PUT path` with a JSON body.
    pub fn put_json(path: impl Into<String>, body: &impl Serialize) -> Result<Self, CallError> {
        let path = path.into();
        let json = serde_json::to_vec(body)
            .map_err(|source| CallError::Json { call: format!("the body of PUT {path}"), source })?;
        Ok(Self::new(Method::PUT, path, Payload::Json(json)).header("content-type", "application/json"))
    }

    /// `PUT path` with plain bytes.
    pub fn put(path: impl Into<String>, bytes: &'a [u8]) -> Self {
        Self::new(Method::PUT, path, Payload::Bytes(bytes)).header("content-type", "application/octet-stream")
    }

    /// The same call with one more header.
    #[must_use]
    pub fn header(mut self, name: &'static str, value: &'a str) -> Self {
        self.headers.push((name, value));
        self
    }

    /// The same call; it fails where its answer is not read within `patience`.
    #[must_use]
    pub fn within(mut self, patience: Duration) -> Self {
        self.patience = Some(patience);
        self
    }
}

/// A successful answer whose body is not read yet.
#[derive(Debug)]
pub struct Answer {
    pub(crate) call: String,
    pub(crate) response: Response<Body>,
}

impl Answer {
    /// The length that the server names, of the body or, after `HEAD`, of what `GET` would give.
    pub fn content_length(&self) -> Option<u64> {
        number_in(self.response.headers(), header::CONTENT_LENGTH)
    }

    /// The body, at most `limit` bytes.
    pub fn bytes(mut self, limit: u64) -> Result<Vec<u8>, CallError> {
        let too_large =
            |bytes| CallError::TooLarge { body: format!("the answer to {}", self.call), bytes, limit };
        if let Some(bytes) = self.content_length().filter(|bytes| *bytes > limit) {
            return Err(too_large(bytes));
        }
        // ureq refuses a body that reaches its limit, ours is inclusive.
        match self.response.body_mut().with_config().limit(limit.saturating_add(1)).read_to_vec() {
            Ok(bytes) if bytes.len() as u64 > limit => Err(too_large(bytes.len() as u64)),
            Ok(bytes) => Ok(bytes),
            Err(Error::BodyExceedsLimit(_)) => Err(too_large(limit + 1)),
            Err(source) => Err(CallError::Network { call: self.call, source: Box::new(source) }),
        }
    }

    /// The body as JSON.
    pub fn json<T: DeserializeOwned>(self) -> Result<T, CallError> {
        let call = self.call.clone();
        let bytes = self.bytes(JSON_BYTES_MAX)?;
        serde_json::from_slice(&bytes).map_err(|source| CallError::Json { call, source })
    }
}

/// The whole number in a header, if it is one.
pub(crate) fn number_in(headers: &HeaderMap, name: header::HeaderName) -> Option<u64> {
    headers.get(name)?.to_str().ok()?.trim().parse().ok()
}
