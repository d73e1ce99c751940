//! For those who run the server: health, readiness, metrics, description.

use std::sync::Arc;

use axum::Extension;
use axum::extract::State;
use axum::http::{HeaderName, header};

use super::extract::FarmState;
use crate::error::Result;
use crate::metrics::{CONTENT_TYPE, Figures};
use crate::readiness::Readiness;

/// Says that the process runs.
#[utoipa::path(get, path = "/healthz", tag = "operation",
    responses((status = 200, description = "It runs", body = String, content_type = "text/plain")))]
pub(crate) async fn healthz() -> &'static str {
    "ok\n"
}

/// Says, within a second, that the database can be written and is whole, and that the chunk store can be written and read.
#[utoipa::path(get, path = "/readyz", tag = "operation",
    responses((status = 200, description = "It is ready", body = String, content_type = "text/plain"),
        (status = 503, description = "It is not"),
        (status = 507, description = "The disk is full")))]
pub(super) async fn readyz(
    State(farm): FarmState,
    Extension(readiness): Extension<Arc<Readiness>>,
) -> Result<&'static str> {
    readiness.check(&farm.store, &farm.storage).await?;
    Ok("ready\n")
}

/// Metrics of this server and its farm, for Prometheus.
#[utoipa::path(get, path = "/metrics", tag = "operation",
    responses((status = 200, description = "The text format of OpenMetrics", body = String,
        content_type = "application/openmetrics-text")))]
pub(super) async fn metrics(State(farm): FarmState) -> Result<([(HeaderName, &'static str); 1], String)> {
    let figures = Figures {
        farm: farm.store.stats().await?,
        workers: farm.store.workers().await?.len() as u64,
        usage: farm.store.usage().await?,
        quota_bytes: farm.storage.quota_bytes(),
    };
    Ok(([(header::CONTENT_TYPE, CONTENT_TYPE)], farm.metrics.render(figures)))
}
