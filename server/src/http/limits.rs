//! Rate limits of one caller, and a limit of all calls at a time: calls beyond are answered 429 at once.

use std::net::IpAddr;
use std::num::NonZeroU32;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use axum::body::Body;
use axum::response::Response;
use governor::clock::{Clock as _, DefaultClock};
use governor::state::keyed::HashMapStateStore;
use governor::{Quota, RateLimiter};
use lightkiln_proto::ids::Digest;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::leases::MAX_RESULT_BYTES;
use super::pace::{Haste, Line, Pace};
use crate::error::{Result, ServerError};
use crate::held::hold;

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
    /// Bytes a second that a body must bring in the long run. More → slow callers hold memory for less long, and those on
    /// bad lines are cut off. 0 is no limit; plans, which hold room that others wait for, then have that of the default.
    pub body_bytes_per_sec: u32,
    /// Time that a body may fall behind that rate, or be silent.
    pub body_patience: Duration,
}

impl Default for LimitConfig {
    fn default() -> Self {
        Self {
            calls_per_sec: 1000,
            calls_at_a_time: 10_000,
            body_bytes_per_sec: 1024,
            body_patience: Duration::from_secs(30),
        }
    }
}

impl LimitConfig {
    /// The same on a server of so many connections at a time; a few of them are left for calls about health. 0 is no limit.
    pub(crate) fn beside(self, connections: u32) -> Self {
        let most = connections.saturating_sub(CONNECTIONS_FOR_HEALTH).max(1);
        let calls_at_a_time = match (self.calls_at_a_time, connections) {
            (calls, 0) => calls,
            (0, _) => most,
            (calls, _) => calls.min(most),
        };
        Self { calls_at_a_time, ..self }
    }
}

/// Calls that bring much JSON, in whose parsed form each byte takes some ten, stand in line for so much of it at a time.
/// More → big plans go in beside each other, in more memory.
pub const HEAVY_BYTES: u64 = MAX_RESULT_BYTES as u64;
/// JSON up to this size stands in no line.
const LIGHT_BYTES: u64 = 1 << 20;
/// Unit of the line.
const KIB: u64 = 1 << 10;
/// While others wait in the line, those who have room must send so many times as fast.
const HEAVY_HASTE: u32 = 64;
/// Connections that calls about health have for themselves.
const CONNECTIONS_FOR_HEALTH: u32 = 8;

/// A caller: an address, with the token that opened the call if one did.
pub(super) type Caller = (IpAddr, Option<Digest>);

/// The limits of one server.
pub(crate) struct Limits {
    rate: Option<RateLimiter<Caller, HashMapStateStore<Caller>, DefaultClock>>,
    clock: DefaultClock,
    calls: AtomicU32,
    places: Option<Arc<Semaphore>>,
    heavy: Arc<Semaphore>,
    line: Line,
    pace: Pace,
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
            heavy: Arc::new(Semaphore::new((HEAVY_BYTES / KIB) as usize)),
            line: Line::default(),
            pace: Pace { bytes_per_sec: config.body_bytes_per_sec, patience: config.body_patience },
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

impl Limits {
    /// Waits until there is memory for a call whose JSON has so many bytes, if its caller says how many; the room is held
    /// until the call has ended. None is needed for little.
    pub(super) async fn room_for(&self, json_bytes: Option<u64>) -> Option<OwnedSemaphorePermit> {
        let bytes = json_bytes.unwrap_or(HEAVY_BYTES).min(HEAVY_BYTES);
        if bytes <= LIGHT_BYTES {
            return None;
        }
        let kib = u32::try_from(bytes / KIB).unwrap_or(u32::MAX);
        if let Ok(room) = self.heavy.clone().try_acquire_many_owned(kib) {
            return Some(room);
        }
        let _waiting = self.line.join();
        // It is never closed.
        self.heavy.clone().acquire_many_owned(kib).await.ok()
    }

    /// The body, which has to keep coming. One that holds room does so whatever the limit: its caller may have vanished.
    pub(super) fn paced(&self, body: Body, is_heavy: bool) -> Body {
        if !is_heavy {
            return self.pace.kept_by(body, None);
        }
        let bytes_per_sec = match self.pace.bytes_per_sec {
            0 => LimitConfig::default().body_bytes_per_sec,
            rate => rate,
        };
        let haste = Haste { line: self.line.clone(), times: HEAVY_HASTE };
        Pace { bytes_per_sec, ..self.pace }.kept_by(body, Some(haste))
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
        hold(answer, self)
    }
}

#[cfg(test)]
mod tests {
    use axum::body::HttpBody as _;

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

    #[tokio::test]
    async fn much_json_stands_in_line_and_little_does_not() {
        let limits = Limits::new(LimitConfig::default());
        assert!(limits.room_for(Some(LIGHT_BYTES)).await.is_none());
        let half = limits.room_for(Some(HEAVY_BYTES / 2)).await.expect("half of the room");
        let waits = |bytes| tokio::time::timeout(Duration::from_millis(20), limits.room_for(bytes));
        assert!(waits(None).await.is_err(), "who knows how much it is");
        assert!(waits(Some(HEAVY_BYTES / 2)).await.is_ok());
        drop(half);
        assert!(limits.room_for(Some(u64::MAX)).await.is_some(), "its size is refused later");
    }

    #[tokio::test]
    async fn plans_are_hurried_only_while_others_wait_for_room() {
        let limits = Limits::new(LimitConfig::default());
        let room = limits.room_for(None).await;
        assert!(!limits.line.is_there());
        let mut next = Box::pin(limits.room_for(None));
        assert!(futures::poll!(&mut next).is_pending() && limits.line.is_there());
        drop(room);
        assert!(next.await.is_some() && !limits.line.is_there());
    }

    #[tokio::test]
    async fn caller_that_vanished_holds_no_room_even_without_a_limit() {
        let body_patience = Duration::from_millis(20);
        let limits =
            Limits::new(LimitConfig { body_bytes_per_sec: 0, body_patience, ..LimitConfig::default() });
        let silent = || Body::from_stream(futures::stream::pending::<std::io::Result<bytes::Bytes>>());
        let read = |is_heavy| axum::body::to_bytes(limits.paced(silent(), is_heavy), usize::MAX);
        assert!(read(true).await.is_err());
        let light = tokio::time::timeout(5 * body_patience, read(false)).await;
        assert!(light.is_err(), "without room, silence has no limit");
    }

    #[test]
    fn calls_leave_connections_for_those_about_health() {
        let beside = |calls_at_a_time, connections| {
            LimitConfig { calls_at_a_time, ..LimitConfig::default() }.beside(connections).calls_at_a_time
        };
        assert_eq!(beside(10_000, 480), 472);
        assert_eq!((beside(100, 480), beside(0, 480), beside(0, 0), beside(7, 0)), (100, 472, 0, 7));
        assert_eq!(beside(10_000, 3), 1);
    }

    #[test]
    fn zero_is_no_limit() {
        let limits =
            Limits::new(LimitConfig { calls_per_sec: 0, calls_at_a_time: 0, ..LimitConfig::default() });
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
