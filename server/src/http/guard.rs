//! Which scopes a call needs; a call that is not named here needs the highest.

use std::sync::Arc;

use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderMap, Method, header};
use axum::middleware::Next;
use axum::response::Response;

use super::extract::text_header;
use crate::access::Scope;
use crate::error::ServerError;
use crate::farm::Farm;

/// Any of these scopes will do; none are needed where there are none.
fn scopes_for(method: &Method, route: &str) -> &'static [Scope] {
    let reads = matches!(*method, Method::GET | Method::HEAD);
    match route {
        "/healthz" | "/readyz" | "/openapi.json" if reads => &[],
        "/v1/chunks/{digest}" if reads => &[Scope::Read, Scope::Worker],
        "/v1/chunks/{digest}" if *method == Method::PUT => &[Scope::Worker],
        "/v1/scenes/{digest}" => &[Scope::Submit],
        "/v1/workers" | "/metrics" if reads => &[Scope::Read],
        route if route.starts_with("/v1/leases") => &[Scope::Worker],
        route if route.starts_with("/v1/bakes") && reads => &[Scope::Read],
        "/v1/bakes/{id}" | "/v1/bakes/{id}/blocklist" if *method == Method::DELETE => &[Scope::Submit],
        route if route.starts_with("/v1/bakes") && *method == Method::POST => &[Scope::Submit],
        _ => &[Scope::Admin],
    }
}

/// Lets a call through if its token opens it. Paths that do not exist are nobody's secret.
pub(super) async fn guard(
    State(farm): State<Arc<Farm>>,
    request: Request,
    next: Next,
) -> Result<Response, ServerError> {
    if let Some(route) = request.extensions().get::<MatchedPath>() {
        let wanted = scopes_for(request.method(), route.as_str());
        if !wanted.is_empty() {
            farm.guard.check(bearer_token(request.headers()), wanted).await?;
        }
    }
    Ok(next.run(request).await)
}

fn bearer_token(headers: &HeaderMap) -> Option<&str> {
    let (kind, token) = text_header(headers, header::AUTHORIZATION)?.split_once(' ')?;
    kind.eq_ignore_ascii_case("Bearer").then(|| token.trim())
}
