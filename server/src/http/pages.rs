//! Files for browsers. They are nobody's secret, so no token is asked for; the calls of a page ask for one.

use std::sync::Arc;

use axum::Router;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;

use super::extract::text_header;
use super::ranges::is_known;
use crate::error::{Result, ServerError};
use crate::pages::Pages;

/// Path of the first page.
pub(super) const FACE: &str = "/";
/// Route of all other files.
pub(super) const FILES: &str = "/web/{*path}";
/// A page runs the server's own modules, Workers and styles alone, calls this server alone, and stands in nobody's frame. Pictures of a
/// bake are made from bytes.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; \
                      worker-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
/// Kept, but asked for anew each time: another server has other files.
const CACHE: &str = "no-cache";

/// The calls for files.
pub(super) fn router<S: Clone + Send + Sync + 'static>(pages: Pages) -> Router<S> {
    Router::new().route(FACE, get(show)).route(FILES, get(show)).with_state(Arc::new(pages))
}

async fn show(State(pages): State<Arc<Pages>>, uri: Uri, headers: HeaderMap) -> Result<Response> {
    let absent = || ServerError::NoSuchPath { path: super::cut(uri.path()) };
    let page = pages.at(uri.path()).ok_or_else(absent)?;
    let is_known = is_known(text_header(&headers, header::IF_NONE_MATCH), &page.etag);
    let (status, body) = if is_known {
        (StatusCode::NOT_MODIFIED, Body::empty())
    } else {
        (StatusCode::OK, page.bytes.clone().into())
    };
    let mut answer = (status, body).into_response();
    let of_answer = answer.headers_mut();
    for (name, value) in [
        (header::CONTENT_TYPE, page.media_type),
        (header::CACHE_CONTROL, CACHE),
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
    ] {
        of_answer.insert(name, HeaderValue::from_static(value));
    }
    if let Ok(etag) = HeaderValue::from_str(&page.etag) {
        of_answer.insert(header::ETAG, etag);
    }
    Ok(answer)
}
