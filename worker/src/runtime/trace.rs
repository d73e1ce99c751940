//! What a worker does for a task, as spans of the trace that the bake's submission began; calls name the span they are
//! made in, so that the server's part follows it.

use lightkiln_proto::api::Lease;
use lightkiln_proto::trace::{TARGET, TRACEPARENT};
use opentelemetry::global::get_text_map_propagator;
use opentelemetry_http::{HeaderExtractor, HeaderInjector};
use tracing::Span;
use tracing::field::Empty;
use tracing_opentelemetry::OpenTelemetrySpanExt;
use ureq::http::{HeaderMap, HeaderValue, Request, Response};
use ureq::middleware::MiddlewareNext;
use ureq::{Body, SendBody};

use super::attempt::Outcome;

/// The span of an attempt; none for a bake that belongs to no trace.
pub(super) fn attempt_span(lease: &Lease, worker: &str) -> Span {
    let parent = lease.traceparent.as_deref().and_then(|parent| HeaderValue::from_str(parent).ok());
    let Some(parent) = parent else { return Span::none() };
    let task = &lease.task;
    let span = tracing::info_span!(
        target: TARGET,
        "task",
        otel.name = format!("task {}", task.kind),
        otel.status_code = Empty,
        bake = lease.bake,
        kind = task.kind,
        label = task.label,
        key = %task.key,
        worker,
        outcome = Empty,
    );
    let headers = HeaderMap::from_iter([(ureq::http::HeaderName::from_static(TRACEPARENT), parent)]);
    let parent = get_text_map_propagator(|propagator| propagator.extract(&HeaderExtractor(&headers)));
    // Where nothing records traces there is nobody to tell.
    let _ = span.set_parent(parent);
    span
}

/// A step of an attempt; none where the attempt has no span.
pub(super) fn step(make: impl FnOnce() -> Span) -> Span {
    if Span::current().is_none() { Span::none() } else { make() }
}

/// Notes how an attempt ended.
pub(super) fn note_outcome(span: &Span, outcome: Outcome) {
    span.record("outcome", format!("{outcome:?}"));
    if let Outcome::Failed(_) = outcome {
        span.record("otel.status_code", "ERROR");
    }
}

/// Names the span that a call is made in, if that is one of a trace.
pub(super) fn name_span(
    mut request: Request<SendBody<'_>>,
    next: MiddlewareNext<'_>,
) -> Result<Response<Body>, ureq::Error> {
    let context = Span::current().context();
    get_text_map_propagator(|propagator| {
        propagator.inject_context(&context, &mut HeaderInjector(request.headers_mut()));
    });
    next.handle(request)
}
