//! Rate limits of one caller, and a limit of all calls at a time: calls beyond are answered 429 at once.

use std::net::IpAddr;
use std::num::NonZeroU32;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::body::{Body, HttpBody};
use axum::response::Response;
use bytes::Bytes;
use governor::clock::{Clock as _, DefaultClock};
use governor::state::keyed::HashMapStateStore;
use governor::{Quota, RateLimiter};
use lightkiln_proto::ids::Digest;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::error::{Result, ServerError};

/// Callers that were not heard for a while are forgotten after this many calls.
const CALLS_BETWEEN_SWEEPS: u32 = 4096;
/// Seconds after which a caller may come again when all places are taken: how long is not known.
const BUSY_RETRY_SECS: u64 = 1;

/// Limits of calls.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LimitConfig {
    /// Calls a second of one caller, in the long run; twice as many at once. A caller is a token at an address, or an
    /// address without one; files for browsers are not counted. Fewer → a caller gone wild costs less; busy workers behind one address need more. 0 is no limit.
    pub calls_per_sec: u32,
    /// Calls under way at a time, those that wait for work or events and answers still being sent included. Fewer → less
    /// memory at worst; a worker or a watched bake takes one. 0 is no limit.
    pub calls_at_a_time: u32,
}

impl Default for LimitConfig {
    fn default() -> Self {
        Self { calls_per_sec: 1000, calls_at_a_time: 10_000 }
    }
}

/// A caller: an address, with the token that opened the call if one did.
pub(super) type Caller = (IpAddr, Option<Digest>);

/// The limits of one server.
pub(crate) struct Limits {
    rate: Option<RateLimiter<Caller, HashMapStateStore<Caller>, DefaultClock>>,
    clock: DefaultClock,
    calls: AtomicU32,
    places: Option<Arc<Semaphore>>,
}

impl Limits {
    pub(crate) fn new(config: LimitConfig) -> Self {
        let quota = NonZeroU32::new(config.calls_per_sec);
        let quota = quota.map(|rate| Quota::per_second(rate).allow_burst(rate.saturating_mul(TWO)));
        let places = (config.calls_at_a_time > 0).then(|| Semaphore::new(config.calls_at_a_time as usize));
        Self {
            rate: quota.map(RateLimiter::hashmap),
            clock: DefaultClock::default(),
            calls: AtomicU32::new(0),
            places: places.map(Arc::new),
        }
    }

    /// Counts a call of a caller.
    pub(super) fn count(&self, caller: Caller) -> Result<()> {
        let Some(rate) = &self.rate else { return Ok(()) };
        if self.calls.fetch_add(1, Ordering::Relaxed) % CALLS_BETWEEN_SWEEPS == CALLS_BETWEEN_SWEEPS - 1 {
            rate.retain_recent();
        }
        rate.check_key(&caller).map_err(|not_until| {
            let wait = not_until.wait_time_from(self.clock.now());
            ServerError::TooManyCalls { retry_after_secs: whole_secs(wait) }
        })
    }

    /// A place for one call, held until its answer has been sent.
    pub(super) fn place(&self) -> Result<Place> {
        let Some(places) = &self.places else { return Ok(Place { _permit: None }) };
        match places.clone().try_acquire_owned() {
            Ok(permit) => Ok(Place { _permit: Some(permit) }),
            Err(_) => Err(ServerError::Busy { retry_after_secs: BUSY_RETRY_SECS }),
        }
    }
}

/// The burst is this many seconds' worth.
const TWO: NonZeroU32 = NonZeroU32::new(2).expect("two is not zero");

/// Rounded up, at least one.
fn whole_secs(wait: Duration) -> u64 {
    (wait.as_secs() + u64::from(wait.subsec_nanos() > 0)).max(1)
}

/// A place among the calls under way.
pub(super) struct Place {
    /// Held, not read.
    _permit: Option<OwnedSemaphorePermit>,
}

impl Place {
    /// The answer, which holds the place until it has been sent or its caller is gone.
    pub(super) fn held_by(self, answer: Response) -> Response {
        answer.map(|body| Body::new(Held { body, _place: self }))
    }
}

struct Held {
    body: Body,
    _place: Place,
}

impl HttpBody for Held {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<http_body::Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> http_body::SizeHint {
        self.body.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HERE: IpAddr = IpAddr::V4(std::net::Ipv4Addr::LOCALHOST);

    fn refused(limits: &Limits, caller: Caller, calls: u32) -> Option<u64> {
        (0..calls).find_map(|_| match limits.count(caller) {
            Err(ServerError::TooManyCalls { retry_after_secs }) => Some(retry_after_secs),
            _ => None,
        })
    }

    #[test]
    fn caller_is_refused_after_a_burst_and_others_are_not() {
        let limits = Limits::new(LimitConfig { calls_per_sec: 1, ..LimitConfig::default() });
        assert_eq!(refused(&limits, (HERE, None), 2), None, "two at once");
        assert_eq!(refused(&limits, (HERE, None), 2), Some(1));
        let token = (HERE, Some(Digest::of(b"token")));
        assert_eq!(refused(&limits, token, 2), None, "another caller has a count of its own");
    }

    #[test]
    fn callers_that_went_quiet_are_forgotten() {
        let limits = Limits::new(LimitConfig { calls_per_sec: 1_000_000, ..LimitConfig::default() });
        for index in 0..3 * CALLS_BETWEEN_SWEEPS {
            limits.count((HERE, Some(Digest::of(&index.to_le_bytes())))).unwrap();
        }
        let known = limits.rate.as_ref().unwrap().len();
        assert!(known <= CALLS_BETWEEN_SWEEPS as usize, "{known} callers are remembered");
    }

    #[test]
    fn place_is_free_again_when_the_answer_is_gone() {
        let limits = Limits::new(LimitConfig { calls_at_a_time: 1, ..LimitConfig::default() });
        let answer = limits.place().unwrap().held_by(Response::new(Body::from("four")));
        assert_eq!(answer.body().size_hint().exact(), Some(4), "its length is still known");
        assert!(matches!(limits.place(), Err(ServerError::Busy { .. })));
        drop(answer);
        assert!(limits.place().is_ok());
    }

    #[test]
    fn zero_is_no_limit() {
        let limits = Limits::new(LimitConfig { calls_per_sec: 0, calls_at_a_time: 0 });
        assert_eq!(refused(&limits, (HERE, None), 10_000), None);
        let places: Vec<Place> = (0..1000).map(|_| limits.place().unwrap()).collect();
        assert_eq!(places.len(), 1000);
    }

    #[test]
    fn waits_are_told_in_whole_seconds() {
        for (millis, secs) in [(0, 1), (1, 1), (1000, 1), (1001, 2)] {
            assert_eq!(whole_secs(Duration::from_millis(millis)), secs);
        }
    }
}
