//! The HTTP calls; `lightkiln_proto::api` lists them.

mod bakes;
mod chunks;
mod enrolments;
mod evaluations;
mod events;
mod extract;
mod guard;
mod health;
mod leases;
mod limits;
mod openapi;
mod pace;
mod pages;
mod problem;
pub mod ranges;
mod results;
mod trace;

use std::sync::Arc;
use std::time::Instant;

use axum::extract::{MatchedPath, Request, State};
use axum::http::{Method, StatusCode, Uri};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, head, post, put};
use axum::{Extension, Router};
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::trace::TraceLayer;

use crate::error::ServerError;
use crate::farm::Farm;
use crate::pages::Pages;
use crate::readiness::Readiness;

use guard::Doorman;
use limits::Limits;

pub(crate) use health::healthz;
pub use leases::MAX_RESULT_BYTES;
pub use limits::{HEAVY_BYTES, LimitConfig};
pub use openapi::openapi_json;

/// All calls over a farm, and files for browsers.
pub(crate) fn router(farm: Arc<Farm>, limits: LimitConfig, pages: Pages) -> Router {
    let doorman = Arc::new(Doorman { farm: farm.clone(), limits: Limits::new(limits) });
    Router::new()
        .route("/v1/scenes/{digest}", put(chunks::put_scene).head(chunks::head_scene))
        .route("/v1/scenes/{digest}/parts", post(chunks::put_scene_together))
        .route("/v1/scene-parts/{digest}", put(chunks::put_scene_part))
        .route("/v1/chunks/{digest}", head(chunks::head_chunk).get(chunks::get_chunk).put(chunks::put_chunk))
        .route("/v1/bakes", get(bakes::list).post(bakes::submit))
        .route("/v1/bakes/{id}", get(bakes::show).delete(bakes::delete))
        .route("/v1/bakes/{id}/cancel", post(bakes::cancel))
        .route("/v1/bakes/{id}/pause", post(bakes::pause))
        .route("/v1/bakes/{id}/resume", post(bakes::resume))
        .route("/v1/bakes/{id}/priority", post(bakes::reprioritise))
        .route("/v1/bakes/{id}/blocklist", get(bakes::blocklist).delete(bakes::clear_blocklist))
        .route("/v1/bakes/{id}/events", get(events::events))
        .route("/v1/bakes/{id}/results", get(results::results))
        .route("/v1/bakes/{id}/manifest", get(bakes::manifest))
        .route("/v1/bakes/{id}/report", get(bakes::report))
        .route("/v1/bakes/{id}/evaluation", get(evaluations::show).put(evaluations::attach))
        .route("/v1/bakes/{id}/evaluation/files/{digest}", get(evaluations::file).put(evaluations::put_file))
        .route("/v1/workers", get(bakes::workers))
        .route("/v1/leases", post(leases::claim))
        .route(leases::COMMIT_ALL, post(leases::commit_all))
        .route("/v1/leases/{token}/heartbeat", post(leases::heartbeat))
        .route(leases::COMMIT, post(leases::commit))
        .route("/v1/leases/{token}/fail", post(leases::fail))
        .route("/v1/leases/{token}/release", post(leases::release))
        .route("/v1/enrolments", post(enrolments::enrol))
        .route("/healthz", get(health::healthz))
        .route("/readyz", get(health::readyz))
        .route("/metrics", get(health::metrics))
        .route("/openapi.json", get(openapi::show))
        .merge(pages::router(pages))
        .fallback(no_such_path)
        .method_not_allowed_fallback(method_not_allowed)
        .layer(Extension(Arc::new(Readiness::default())))
        .layer(axum::middleware::from_fn_with_state(doorman, guard::guard))
        .layer(axum::middleware::from_fn_with_state(farm.clone(), measure))
        .layer(CatchPanicLayer::custom(panicked))
        // Failures are told where they arise, once and with their cause.
        .layer(TraceLayer::new_for_http().make_span_with(trace::span).on_failure(()))
        .with_state(farm)
}

/// Notes how long a request took until its answer began.
async fn measure(State(farm): State<Arc<Farm>>, request: Request, next: Next) -> Response {
    let method = request.method().clone();
    let route = request.extensions().get::<MatchedPath>().map_or("none", MatchedPath::as_str).to_owned();
    let started = Instant::now();
    let response = next.run(request).await;
    // Methods come from outside; those that no route has are counted as one.
    let is_known = [Method::GET, Method::HEAD, Method::POST, Method::PUT, Method::DELETE].contains(&method);
    let method = if is_known { method.as_str() } else { "other" };
    trace::note_status(response.status().as_u16());
    if response.status() == StatusCode::INSUFFICIENT_STORAGE {
        farm.metrics.full_refusals.inc();
    }
    farm.metrics.note_latency(method, &route, response.status().as_u16(), started.elapsed());
    response
}

/// A bug ends one request, not the server; the log has the panic's place.
fn panicked(_: Box<dyn std::any::Any + Send>) -> Response {
    ServerError::Panicked.into_response()
}

async fn no_such_path(uri: Uri) -> ServerError {
    ServerError::NoSuchPath { path: cut(uri.path()) }
}

async fn method_not_allowed(method: Method, uri: Uri) -> ServerError {
    ServerError::MethodNotAllowed { path: cut(uri.path()), method: method.to_string() }
}

/// Paths come from outside: a problem repeats only their beginning.
fn cut(path: &str) -> String {
    path.chars().take(200).collect()
}
