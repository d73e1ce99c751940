//! Calls and tasks as parts of a trace (W3C Trace Context).

use lightkiln_proto::trace::TRACEPARENT;
use opentelemetry::global::get_text_map_propagator;
use opentelemetry_http::{HeaderExtractor, HeaderInjector};
use tracing::Span;
use tracing_opentelemetry::OpenTelemetrySpanExt;
use ureq::http::{HeaderMap, HeaderName, HeaderValue, Request, Response};
use ureq::middleware::MiddlewareNext;
use ureq::{Body, SendBody};

/// Makes `span` a child of the one that a traceparent names. Without a recorder of traces nothing changes.
pub fn follow(span: &Span, traceparent: &str) {
    let Ok(parent) = HeaderValue::from_str(traceparent) else { return };
    let headers = HeaderMap::from_iter([(HeaderName::from_static(TRACEPARENT), parent)]);
    let parent = get_text_map_propagator(|propagator| propagator.extract(&HeaderExtractor(&headers)));
    let _ = span.set_parent(parent);
}

/// Names the span that a call is made in, if that is one of a trace.
pub(crate) fn name_span(
    mut request: Request<SendBody<'_>>,
    next: MiddlewareNext<'_>,
) -> Result<Response<Body>, ureq::Error> {
    let context = Span::current().context();
    get_text_map_propagator(|propagator| {
        propagator.inject_context(&context, &mut HeaderInjector(request.headers_mut()));
    });
    next.handle(request)
}
