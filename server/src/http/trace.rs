//! Spans of calls that belong to somebody's trace, as W3C Trace Context says it in their headers.

use axum::extract::{MatchedPath, Request};
use axum::http::{HeaderMap, HeaderName};
use lightkiln_proto::trace::{TARGET, TRACEPARENT, is_traceparent};
use opentelemetry::global::get_text_map_propagator;
use opentelemetry_http::{HeaderExtractor, HeaderInjector};
use tracing::Span;
use tracing::field::Empty;
use tracing_opentelemetry::OpenTelemetrySpanExt;

use super::extract::text_header;

/// Calls that only ask whether there is news: hours of them would drown a trace.
const POLLS: [&str; 4] =
    ["/v1/bakes/{id}/events", "/v1/bakes/{id}/results", "/v1/leases/{token}/heartbeat", "/v1/leases"];

/// The span of a request in log and trace: it has the route, as paths hold tokens. Calls of no trace begin none.
pub(super) fn span(request: &Request) -> Span {
    let route = request.extensions().get::<MatchedPath>().map_or("none", MatchedPath::as_str);
    let method = request.method();
    if !request.headers().contains_key(TRACEPARENT) || POLLS.contains(&route) {
        return tracing::debug_span!("request", %method, route);
    }
    let span = tracing::info_span!(
        target: TARGET,
        "request",
        otel.name = format!("{method} {route}"),
        otel.kind = "server",
        http.request.method = %method,
        http.route = route,
        http.response.status_code = Empty,
    );
    let parent =
        get_text_map_propagator(|propagator| propagator.extract(&HeaderExtractor(request.headers())));
    // Where nothing records traces there is nobody to tell.
    let _ = span.set_parent(parent);
    span
}

/// Notes how a call of a trace ended.
pub(super) fn note_status(status: u16) {
    Span::current().record("http.response.status_code", status);
}

/// Parent of the spans that this call leads to: this call's span, or the caller's where nothing records here.
pub(super) fn traceparent(headers: &HeaderMap) -> Option<String> {
    let mut own = HeaderMap::new();
    let context = Span::current().context();
    get_text_map_propagator(|propagator| {
        propagator.inject_context(&context, &mut HeaderInjector(&mut own));
    });
    let found = [&own, headers]
        .into_iter()
        .filter_map(|headers| text_header(headers, HeaderName::from_static(TRACEPARENT)));
    found.filter(|text| is_traceparent(text)).map(str::to_owned).next()
}
