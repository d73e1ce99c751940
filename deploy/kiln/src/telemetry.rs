//! Traces by OpenTelemetry, exported over OTLP/HTTP where the standard variables ask for them
//! (<https://opentelemetry.io/docs/specs/otel/protocol/exporter/>): `OTEL_EXPORTER_OTLP_ENDPOINT` says where to, and
//! `OTEL_SERVICE_NAME`, `OTEL_RESOURCE_ATTRIBUTES`, `OTEL_TRACES_SAMPLER`, `OTEL_BSP_…` and the like work as usual.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use async_trait::async_trait;
use lightkiln_http::foreign;
use lightkiln_proto::trace::TARGET;
use opentelemetry::trace::TracerProvider as _;
use opentelemetry_http::{Bytes, HttpClient, HttpError, Request, Response};
use opentelemetry_otlp::{SpanExporter, WithHttpConfig as _};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::propagation::TraceContextPropagator;
use opentelemetry_sdk::trace::SdkTracerProvider;
use tracing::{Span, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::filter::filter_fn;
use tracing_subscriber::registry::LookupSpan;

/// Longest time of one export; a longer one is dropped.
const EXPORT_TIMEOUT: Duration = Duration::from_secs(10);
/// Longest time that a process stays for its last export.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(5);
/// Largest answer of a collector that is read.
const ANSWER_BYTES_MAX: u64 = 1 << 20;

/// The export of traces, if there is one; spans that are not exported yet go when it is dropped.
pub struct Telemetry {
    provider: Option<SdkTracerProvider>,
    /// Why there is none although one was asked for.
    trouble: Option<String>,
}

impl Telemetry {
    /// Exports if the environment names a place to.
    pub fn from_environment(role: &str) -> Self {
        let is_set = |name: &str| std::env::var_os(name).is_some_and(|value| !value.is_empty());
        let says = |name: &str, word: &str| {
            std::env::var(name).is_ok_and(|value| value.trim().eq_ignore_ascii_case(word))
        };
        let has_place = is_set("OTEL_EXPORTER_OTLP_ENDPOINT") || is_set("OTEL_EXPORTER_OTLP_TRACES_ENDPOINT");
        if !has_place || says("OTEL_SDK_DISABLED", "true") || says("OTEL_TRACES_EXPORTER", "none") {
            return Self { provider: None, trouble: None };
        }
        let exporter =
            match SpanExporter::builder().with_http().with_http_client(Collector::default()).build() {
                Ok(exporter) => exporter,
                Err(error) => return Self { provider: None, trouble: Some(error.to_string()) },
            };
        let mut resource = Resource::builder();
        if !is_set("OTEL_SERVICE_NAME") {
            resource = resource.with_service_name(format!("kiln-{role}"));
        }
        let provider = SdkTracerProvider::builder()
            .with_resource(resource.build())
            .with_batch_exporter(exporter)
            .build();
        opentelemetry::global::set_text_map_propagator(TraceContextPropagator::new());
        Self { provider: Some(provider), trouble: None }
    }

    /// The layer that hands spans of traces to the export.
    pub fn layer<S>(&self) -> Option<impl Layer<S> + use<S>>
    where
        S: Subscriber + for<'span> LookupSpan<'span>,
    {
        let tracer = self.provider.as_ref()?.tracer("lightkiln");
        let layer = tracing_opentelemetry::layer()
            .with_tracer(tracer)
            .with_location(false)
            .with_threads(false)
            .with_tracked_inactivity(false);
        Some(layer.with_filter(filter_fn(|metadata| metadata.is_span() && metadata.target() == TARGET)))
    }

    /// Logs that there are no traces although somebody wants them.
    pub fn warn(&self) {
        if let Some(trouble) = &self.trouble {
            tracing::warn!(trouble, "traces are not exported; check the OTEL_EXPORTER_OTLP_… variables");
        }
    }
}

impl Drop for Telemetry {
    fn drop(&mut self) {
        let ended = self.provider.take().map(|provider| provider.shutdown_with_timeout(SHUTDOWN_TIMEOUT));
        if let Some(Err(error)) = ended {
            tracing::debug!(%error, "the last traces were not exported");
        }
    }
}

/// The span of a whole command, under which all that it does is traced.
pub fn command_span(role: &str) -> Span {
    tracing::info_span!(target: TARGET, "command", otel.name = format!("kiln {role}"))
}

/// Brings spans to a collector, from the export's own thread.
#[derive(Debug, Default)]
struct Collector {
    /// The log has it; one line is enough.
    has_failed: AtomicBool,
}

#[async_trait]
impl HttpClient for Collector {
    async fn send_bytes(&self, request: Request<Bytes>) -> Result<Response<Bytes>, HttpError> {
        let sent = foreign::send(request.map(Into::into), EXPORT_TIMEOUT, ANSWER_BYTES_MAX);
        let failure = match &sent {
            Ok(answer) if answer.status().is_success() => None,
            Ok(answer) => Some(format!("the collector answered {}", answer.status())),
            Err(error) => Some(error.to_string()),
        };
        match failure {
            Some(failure) if !self.has_failed.swap(true, Ordering::Relaxed) => {
                tracing::warn!(
                    failure,
                    "traces could not be exported; they are dropped until that works again"
                );
            }
            None => self.has_failed.store(false, Ordering::Relaxed),
            Some(_) => (),
        }
        Ok(sent?.map(Into::into))
    }
}
