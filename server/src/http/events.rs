//! Events of a bake: as pages for polling, or as a stream of server-sent events.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, header};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use futures::{Stream, StreamExt};
use lightkiln_proto::api::{BakeEvent, EventPage};
use serde::Deserialize;
use tokio::time::Instant;
use utoipa::IntoParams;

use super::extract::{BakeId, FarmState, UrlQuery, text_header};
use crate::error::{Result, ServerError};
use crate::farm::{Farm, MAX_WAIT_SECS};

/// Largest `seq` that the farm's database can hold, of a bake or an event.
pub(super) const MAX_SEQ: u64 = i64::MAX as u64;
/// Events on a page.
const PAGE_EVENTS: u32 = 1000;
/// A comment is sent when nothing happened for this long, so that proxies keep the stream open.
const KEEP_ALIVE: Duration = Duration::from_secs(15);

/// Query of events.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct EventsQuery {
    /// Give events with a greater `seq` only; 0 unless set.
    #[param(maximum = 9223372036854775807_i64)]
    after: Option<u64>,
    /// Wait this long for an event, 0..=60; 0 unless set. Has no meaning for a stream.
    #[param(maximum = 60)]
    wait_secs: Option<u32>,
}

/// Place at which a stream that was cut goes on.
#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
#[expect(dead_code, reason = "it describes a header; the handler reads it from the map")]
pub(super) struct LastEvent {
    /// Go on after this event; goes before `after`.
    #[param(rename = "Last-Event-ID", maximum = 9223372036854775807_i64)]
    last_event_id: Option<u64>,
}

/// Tells the events of a bake. With `Accept: text/event-stream` it is a stream that ends with the bake; each event's
/// `id` is its `seq`, and `Last-Event-ID` goes on after it.
#[utoipa::path(get, path = "/v1/bakes/{id}/events", tag = "bakes",
    params(("id" = String, Path, description = "The bake: its id, or a beginning of it that is no other bake's"), EventsQuery, LastEvent),
    responses(
        (status = 200, description = "Events", content((EventPage = "application/json"), (BakeEvent = "text/event-stream"))),
        (status = 404, description = "No such bake")))]
pub(super) async fn events(
    State(farm): FarmState,
    BakeId(id): BakeId,
    UrlQuery(query): UrlQuery<EventsQuery>,
    headers: HeaderMap,
) -> Result<Response> {
    let wait_secs = query.wait_secs.unwrap_or(0);
    require_wait(wait_secs)?;
    let mut after = query.after.unwrap_or(0);
    if let Some(last) = headers.get("Last-Event-ID") {
        let last = last.to_str().ok().and_then(|last| last.trim().parse().ok());
        after = last.ok_or_else(|| ServerError::bad_request("Last-Event-ID must be the seq of an event"))?;
    }
    if let Some(too_large) = [Some(after), query.after].into_iter().flatten().find(|seq| *seq > MAX_SEQ) {
        return Err(ServerError::bad_request(format!(
            "after and Last-Event-ID must be at most {MAX_SEQ}, not {too_large}"
        )));
    }
    let streams = |accept: &str| accept.contains("text/event-stream");
    if text_header(&headers, header::ACCEPT).is_some_and(streams) {
        // A stream that has begun cannot say 404 any more.
        farm.store.show(&id).await?;
        let stream = Sse::new(stream(farm, id, after));
        return Ok(stream.keep_alive(KeepAlive::new().interval(KEEP_ALIVE)).into_response());
    }
    let deadline = Instant::now() + Duration::from_secs(wait_secs.into());
    Ok(Json(farm.events(&id, after, PAGE_EVENTS, deadline).await?).into_response())
}

/// Refuses a wait that is too long.
pub(super) fn require_wait(wait_secs: u32) -> Result<()> {
    if wait_secs <= MAX_WAIT_SECS {
        return Ok(());
    }
    Err(ServerError::bad_request(format!("wait_secs must be within 0..={MAX_WAIT_SECS}, not {wait_secs}")))
}

fn stream(farm: Arc<Farm>, bake: String, after: u64) -> impl Stream<Item = Result<Event, Infallible>> {
    let pages = futures::stream::unfold(Some(after), move |after| {
        let (farm, bake) = (farm.clone(), bake.clone());
        async move { next_page(&farm, &bake, after?).await }
    });
    pages.flat_map(futures::stream::iter)
}

/// The next events and where to go on; nothing when the bake or the server has ended.
async fn next_page(
    farm: &Farm,
    bake: &str,
    after: u64,
) -> Option<(Vec<Result<Event, Infallible>>, Option<u64>)> {
    let deadline = Instant::now() + Duration::from_secs(MAX_WAIT_SECS.into());
    let page = match farm.events(bake, after, PAGE_EVENTS, deadline).await {
        Ok(page) => page,
        Err(error) => {
            tracing::error!(
                error = error.chain(),
                bake,
                "an event stream was cut; its reader will come back"
            );
            return None;
        }
    };
    if page.events.is_empty() && *farm.closing.borrow() {
        return None;
    }
    let last = page.events.last().map_or(after, |event| event.seq);
    let is_end = page.bake.state.is_final() && page.events.len() < PAGE_EVENTS as usize;
    let events = page.events.iter().filter_map(sse_event).map(Ok).collect();
    Some((events, (!is_end).then_some(last)))
}

/// An event under the name of its type.
fn sse_event(event: &BakeEvent) -> Option<Event> {
    let kind = serde_json::to_value(&event.event).ok()?;
    let named = Event::default().id(event.seq.to_string()).event(kind["type"].as_str()?);
    named.json_data(event).ok()
}
