//! Scopes that calls need; a call that is not named here needs the highest. Calls beyond the limits are refused here, too.

use std::net::{IpAddr, Ipv6Addr, SocketAddr};
use std::sync::Arc;

use axum::extract::{ConnectInfo, MatchedPath, Request, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, Method, header};
use axum::middleware::Next;
use axum::response::Response;

use super::extract::{Caller, content_length, text_header};
use super::limits::Limits;
use super::{leases, pages};
use crate::access::{Bearer, Scope};
use crate::error::Result;
use crate::farm::Farm;

/// Any of these scopes will do; none are needed where there are none.
fn scopes_for(method: &Method, route: &str) -> &'static [Scope] {
    let reads = matches!(*method, Method::GET | Method::HEAD);
    match route {
        "/healthz" | "/readyz" | "/openapi.json" if reads => &[],
        pages::FACE | pages::FILES if reads => &[],
        "/v1/chunks/{digest}" if reads => &[Scope::Read, Scope::Worker],
        "/v1/chunks/{digest}" if *method == Method::PUT => &[Scope::Worker],
        "/v1/scenes/{digest}" | "/v1/scenes/{digest}/parts" | "/v1/scene-parts/{digest}" => &[Scope::Submit],
        "/v1/enrolments" => &[Scope::Enrol],
        "/v1/workers" | "/metrics" if reads => &[Scope::Read],
        route if route.starts_with("/v1/leases") => &[Scope::Worker],
        route if route.starts_with("/v1/bakes") && reads => &[Scope::Read],
        "/v1/bakes/{id}/evaluation" | "/v1/bakes/{id}/evaluation/files/{digest}"
            if *method == Method::PUT =>
        {
            &[Scope::Submit]
        }
        "/v1/bakes/{id}" | "/v1/bakes/{id}/blocklist" if *method == Method::DELETE => &[Scope::Submit],
        route if route.starts_with("/v1/bakes") && *method == Method::POST => &[Scope::Submit],
        _ => &[Scope::Admin],
    }
}

/// Checks of every call, before its handler.
pub(super) struct Doorman {
    pub(super) farm: Arc<Farm>,
    pub(super) limits: Limits,
}

impl Doorman {
    /// Counts the call, and refuses it without a token that opens it; whose that is, if one was needed. Paths that do not exist are nobody's secret; calls
    /// about health and for files are answered however many they are.
    async fn check(&self, request: &Parts) -> Result<Option<Bearer>> {
        let route = request.extensions.get::<MatchedPath>().map(MatchedPath::as_str);
        if route.is_some_and(|route| is_about_health(route) || is_for_file(&request.method, route)) {
            return Ok(None);
        }
        let address = request.extensions.get::<ConnectInfo<SocketAddr>>();
        let address = address.map_or(IpAddr::V6(Ipv6Addr::UNSPECIFIED), |info| info.0.ip());
        let wanted = route.map_or(&[][..], |route| scopes_for(&request.method, route));
        let token = bearer_token(&request.headers);
        let opened = match wanted {
            [] => Ok(None),
            wanted => self.farm.guard.check(token, wanted).await,
        };
        let token = opened.as_ref().ok().and_then(Option::as_ref).map(|bearer| bearer.hash);
        self.limits.count((address, token))?;
        opened
    }
}

fn is_about_health(route: &str) -> bool {
    matches!(route, "/healthz" | "/readyz")
}

/// A page asks for a hundred files at once, and browsers do not ask again; files lie in memory.
fn is_for_file(method: &Method, route: &str) -> bool {
    matches!(*method, Method::GET | Method::HEAD) && matches!(route, pages::FACE | pages::FILES)
}

/// Lets a call through if there is room for it and its token opens it.
pub(super) async fn guard(
    State(doorman): State<Arc<Doorman>>,
    request: Request,
    next: Next,
) -> Result<Response> {
    let (mut parts, body) = request.into_parts();
    let caller = doorman.check(&parts).await?;
    parts.extensions.insert(Caller(caller));
    let request = Request::from_parts(parts, body);
    let route = request.extensions().get::<MatchedPath>();
    if route.is_some_and(|route| is_about_health(route.as_str())) {
        return Ok(next.run(request).await);
    }
    let is_heavy = route.is_some_and(|route| [leases::COMMIT, leases::COMMIT_ALL].contains(&route.as_str()));
    let place = doorman.limits.place()?;
    let room = match is_heavy {
        true => doorman.limits.room_for(content_length(request.headers())).await,
        false => None,
    };
    let request = request.map(|body| doorman.limits.paced(body, room.is_some()));
    let answer = next.run(request).await;
    drop(room);
    Ok(place.held_by(answer))
}

pub(super) fn bearer_token(headers: &HeaderMap) -> Option<&str> {
    let (kind, token) = text_header(headers, header::AUTHORIZATION)?.split_once(' ')?;
    kind.eq_ignore_ascii_case("Bearer").then(|| token.trim())
}
