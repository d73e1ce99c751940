//! Parts of a request, with problems for those that are malformed.

use std::str::FromStr;
use std::sync::Arc;

use axum::Json;
use axum::extract::{FromRequest, FromRequestParts, Path, Query, Request, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, header};
use futures::StreamExt;
use serde::de::DeserializeOwned;

use crate::access::Bearer;
use crate::bake_ids::whole_id;
use crate::error::{Result, ServerError};
use crate::farm::Farm;

/// The farm that a call is about.
pub(super) type FarmState = State<Arc<Farm>>;
/// A JSON answer.
pub(super) type Answer<T> = Result<Json<T>>;

/// A JSON body of at most `LIMIT` bytes.
pub(super) struct JsonBody<T, const LIMIT: usize>(pub(super) T);

impl<S: Send + Sync, T: DeserializeOwned, const LIMIT: usize> FromRequest<S> for JsonBody<T, LIMIT> {
    type Rejection = ServerError;

    async fn from_request(request: Request, _state: &S) -> Result<Self> {
        // Pages of other sites can post forms and plain text to this server, but not JSON.
        let is_json = |value: &str| {
            value.split(';').next().is_some_and(|kind| kind.trim().eq_ignore_ascii_case("application/json"))
        };
        if !text_header(request.headers(), header::CONTENT_TYPE).is_some_and(is_json) {
            return Err(ServerError::bad_request("the body must have the Content-Type application/json"));
        }
        let body = read_body(request, LIMIT).await?;
        if has_escaped_nul(&body) {
            return Err(ServerError::bad_request(
                "the body has the character U+0000 (\\u0000), which no text may have",
            ));
        }
        let parsed = serde_json::from_slice(&body);
        parsed.map(Self).map_err(|error| {
            ServerError::bad_request(format!("the body is not what this call takes: {error}"))
        })
    }
}

/// Whether a JSON text says U+0000 anywhere: databases cannot keep it. Unescaped it is no JSON at all.
fn has_escaped_nul(json: &[u8]) -> bool {
    let mut rest = json;
    // A backslash stands in texts only, and escapes the next character.
    while let Some(at) = rest.iter().position(|&byte| byte == b'\\') {
        rest = &rest[at + 1..];
        if rest.starts_with(b"u0000") {
            return true;
        }
        rest = rest.get(1..).unwrap_or_default();
    }
    false
}

/// Errs if a decoded part of the URL has U+0000.
pub(super) fn without_nul(what: &str, encoded: &str) -> Result<()> {
    if encoded.contains("%00") {
        return Err(ServerError::bad_request(format!(
            "the {what} has the character U+0000 (%00), which no text may have"
        )));
    }
    Ok(())
}

async fn read_body(request: Request, limit: usize) -> Result<Vec<u8>> {
    let too_large = || ServerError::BodyTooLarge { limit: limit as u64 };
    if content_length(request.headers()).is_some_and(|length| length > limit as u64) {
        return Err(too_large());
    }
    let mut pieces = request.into_body().into_data_stream();
    let mut body = Vec::new();
    while let Some(piece) = pieces.next().await {
        let piece = piece.map_err(|error| ServerError::BodyBrokeOff(error.into()))?;
        if body.len() + piece.len() > limit {
            return Err(too_large());
        }
        body.extend_from_slice(&piece);
    }
    Ok(body)
}

/// The one parameter of the path.
pub(super) struct PathParam<T>(pub(super) T);

impl<S: Send + Sync, T> FromRequestParts<S> for PathParam<T>
where
    T: FromStr<Err: std::fmt::Display>,
{
    type Rejection = ServerError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self> {
        without_nul("path", parts.uri.path())?;
        let text = Path::<String>::from_request_parts(parts, state).await;
        let Path(text) = text.map_err(|error| ServerError::bad_request(error.body_text()))?;
        text.parse().map(Self).map_err(|error: T::Err| ServerError::bad_request(error.to_string()))
    }
}

/// The id of the bake that the path names by it, or by a beginning of it that no other bake's has.
pub(super) struct BakeId(pub(super) String);

impl FromRequestParts<Arc<Farm>> for BakeId {
    type Rejection = ServerError;

    async fn from_request_parts(parts: &mut Parts, farm: &Arc<Farm>) -> Result<Self> {
        let PathParam(text) = PathParam::from_request_parts(parts, farm).await?;
        whole_id(&*farm.store, text).await.map(Self)
    }
}

/// The bearer whose token opened the call, where one was needed.
#[derive(Clone, Debug, Default)]
pub(super) struct Caller(pub(super) Option<Bearer>);

impl<S: Send + Sync> FromRequestParts<S> for Caller {
    type Rejection = ServerError;

    async fn from_request_parts(parts: &mut Parts, _state: &S) -> Result<Self> {
        Ok(parts.extensions.get::<Self>().cloned().unwrap_or_default())
    }
}

/// As [`BakeId`], of a bake that the caller may change: his own, one that is nobody's, or any with the scope admin.
pub(super) struct OwnBakeId(pub(super) String);

impl FromRequestParts<Arc<Farm>> for OwnBakeId {
    type Rejection = ServerError;

    async fn from_request_parts(parts: &mut Parts, farm: &Arc<Farm>) -> Result<Self> {
        let BakeId(id) = BakeId::from_request_parts(parts, farm).await?;
        let Caller(caller) = Caller::from_request_parts(parts, farm).await?;
        farm.require_owner(&id, caller.as_ref()).await?;
        Ok(Self(id))
    }
}

/// The query of the URL.
pub(super) struct UrlQuery<T>(pub(super) T);

impl<S: Send + Sync, T: DeserializeOwned> FromRequestParts<S> for UrlQuery<T> {
    type Rejection = ServerError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self> {
        without_nul("query", parts.uri.query().unwrap_or_default())?;
        let query = Query::<T>::from_request_parts(parts, state).await;
        query.map(|Query(query)| Self(query)).map_err(|error| ServerError::bad_request(error.body_text()))
    }
}

/// A header's value, if it is there once and is text.
pub(super) fn text_header(headers: &HeaderMap, name: header::HeaderName) -> Option<&str> {
    headers.get(name).and_then(|value| value.to_str().ok())
}

/// The body's length, if the caller says it.
pub(super) fn content_length(headers: &HeaderMap) -> Option<u64> {
    text_header(headers, header::CONTENT_LENGTH)?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_escape_of_nul_is_found() {
        for with in [r#"{"a":"\u0000"}"#, r#""x\\\u0000""#, r#""\n\u0000""#] {
            assert!(has_escaped_nul(with.as_bytes()), "{with}");
        }
        for without in ["", r#""\\u0000""#, r#""u0000""#, r#""\u0001""#, r#""\\\\u0000""#, "\\", r#""\u000"#]
        {
            assert!(!has_escaped_nul(without.as_bytes()), "{without}");
        }
    }
}
