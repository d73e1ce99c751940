//! Bodies that must keep coming: whoever sends one byte a minute would hold memory and a connection for days.

use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::body::{Body, HttpBody};
use bytes::Bytes;
use http_body::{Frame, SizeHint};
use tokio::time::{Instant, Sleep};

/// Least pace of a body.
///
/// A caller has some patience of the server to use up. Time that the server waits for bytes takes from it, bytes give
/// back the time that they take at the least rate; time in which the server itself is busy does not count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Pace {
    /// Least rate in the long run.
    pub(super) bytes_per_sec: u32,
    /// Longest silence.
    pub(super) patience: Duration,
}

/// Callers that wait until there is room for their bodies.
#[derive(Clone, Debug, Default)]
pub(super) struct Line(Arc<AtomicUsize>);

impl Line {
    /// One more waits, until what is given is dropped.
    pub(super) fn join(&self) -> Waiting {
        self.0.fetch_add(1, Ordering::Relaxed);
        Waiting(self.clone())
    }

    /// Whether somebody waits.
    pub(super) fn is_there(&self) -> bool {
        self.0.load(Ordering::Relaxed) > 0
    }
}

/// A caller in the line.
#[derive(Debug)]
pub(super) struct Waiting(Line);

impl Drop for Waiting {
    fn drop(&mut self) {
        self.0.0.fetch_sub(1, Ordering::Relaxed);
    }
}

/// A pace that grows while others wait.
#[derive(Clone, Debug)]
pub(super) struct Haste {
    pub(super) line: Line,
    /// So many times as fast.
    pub(super) times: u32,
}

/// A body that came too slowly.
#[derive(Debug, thiserror::Error)]
#[error("less than {bytes_per_sec} bytes a second came, and nothing or little for {} s", patience.as_secs_f32())]
struct TooSlow {
    bytes_per_sec: u32,
    patience: Duration,
}

impl Pace {
    /// The body, which ends in an error when it comes more slowly.
    pub(super) fn kept_by(self, body: Body, haste: Option<Haste>) -> Body {
        if self.bytes_per_sec == 0 || body.is_end_stream() {
            return body;
        }
        Body::new(Paced { body, pace: self, haste, left: self.patience, wait: None })
    }

    /// The pace at this moment.
    fn with(self, haste: Option<&Haste>) -> Self {
        let times = haste.filter(|haste| haste.line.is_there()).map_or(1, |haste| haste.times);
        Self { bytes_per_sec: self.bytes_per_sec.saturating_mul(times), ..self }
    }

    /// Patience that is left after a wait that ended with so many bytes.
    fn left(self, before: Duration, waited: Duration, bytes: usize) -> Duration {
        let earned = Duration::from_secs_f64(bytes as f64 / f64::from(self.bytes_per_sec));
        (before.saturating_sub(waited) + earned).min(self.patience)
    }
}

struct Paced {
    body: Body,
    pace: Pace,
    haste: Option<Haste>,
    /// Patience that is left.
    left: Duration,
    /// Begin of the wait for more bytes, and the end of patience.
    wait: Option<(Instant, Pin<Box<Sleep>>)>,
}

impl HttpBody for Paced {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let polled = Pin::new(&mut self.body).poll_frame(context);
        let pace = self.pace.with(self.haste.as_ref());
        match &polled {
            Poll::Ready(Some(Ok(frame))) => {
                let waited = self.wait.take().map_or(Duration::ZERO, |(since, _)| since.elapsed());
                self.left = pace.left(self.left, waited, frame.data_ref().map_or(0, Bytes::len));
            }
            Poll::Ready(_) => (),
            Poll::Pending => {
                let left = self.left;
                let begin = || (Instant::now(), Box::pin(tokio::time::sleep(left)));
                let (_, sleep) = self.wait.get_or_insert_with(begin);
                if sleep.as_mut().poll(context).is_ready() {
                    let Pace { bytes_per_sec, patience } = pace;
                    return Poll::Ready(Some(Err(axum::Error::new(TooSlow { bytes_per_sec, patience }))));
                }
            }
        }
        polled
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use axum::body::to_bytes;
    use futures::StreamExt;

    use super::*;

    /// Seconds until patience ends, of a body in pieces of so many bytes with waits of so long before each; none if it
    /// does not within a day.
    fn ends_after(bytes: usize, wait: Duration) -> Option<u64> {
        let pace = Pace { bytes_per_sec: 100, patience: Duration::from_secs(10) };
        let (mut left, mut elapsed) = (pace.patience, Duration::ZERO);
        while elapsed < Duration::from_secs(86_400) {
            if left <= wait {
                return Some((elapsed + left).as_secs());
            }
            elapsed += wait;
            left = pace.left(left, wait, bytes);
        }
        None
    }

    #[test]
    fn body_that_keeps_the_pace_may_take_as_long_as_it_takes() {
        assert_eq!(ends_after(200, Duration::from_secs(1)), None);
        assert_eq!(ends_after(900, Duration::from_secs(9)), None, "with long pauses");
        assert_eq!(ends_after(1, Duration::from_millis(10)), None, "just so");
    }

    #[test]
    fn body_that_drips_ends_when_patience_does() {
        // A tenth of each second is given back.
        assert_eq!(ends_after(1, Duration::from_millis(100)), Some(11));
        assert_eq!(ends_after(1_000_000, Duration::from_secs(11)), Some(10));
    }

    #[test]
    fn pace_grows_only_while_others_wait() {
        let pace = Pace { bytes_per_sec: 100, patience: Duration::from_secs(10) };
        let haste = Haste { line: Line::default(), times: 64 };
        assert_eq!(pace.with(Some(&haste)), pace);
        let waiting = haste.line.join();
        assert_eq!(pace.with(Some(&haste)).bytes_per_sec, 6400);
        assert_eq!(pace.with(None), pace);
        drop(waiting);
        assert_eq!(pace.with(Some(&haste)), pace);
    }

    const HASTY: Pace = Pace { bytes_per_sec: 100, patience: Duration::from_millis(30) };

    #[tokio::test]
    async fn silence_ends_in_an_error_that_names_the_pace() {
        let body = Body::from_stream(futures::stream::pending::<std::io::Result<Bytes>>());
        let error = to_bytes(HASTY.kept_by(body, None), usize::MAX).await.unwrap_err();
        assert!(error.to_string().contains("100 bytes a second"), "{error}");
    }

    #[tokio::test]
    async fn time_that_the_server_takes_is_not_the_callers() {
        let pieces = (0..5).map(|_| Ok::<_, std::io::Error>(Bytes::from_static(b"x")));
        let mut pieces =
            HASTY.kept_by(Body::from_stream(futures::stream::iter(pieces)), None).into_data_stream();
        let mut count = 0;
        while let Some(piece) = pieces.next().await {
            piece.unwrap();
            tokio::time::sleep(HASTY.patience).await;
            count += 1;
        }
        assert_eq!(count, 5);
    }
}
