//! A worker's steps for a task, as spans of the trace that the bake's submission began.

use lightkiln_http::trace::follow;
use lightkiln_proto::api::Lease;
use lightkiln_proto::trace::TARGET;
use tracing::Span;
use tracing::field::Empty;

use super::attempt::Outcome;

/// The span of an attempt; none for a bake that belongs to no trace.
pub(super) fn attempt_span(lease: &Lease, worker: &str) -> Span {
    let Some(traceparent) = &lease.traceparent else { return Span::none() };
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
    follow(&span, traceparent);
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
