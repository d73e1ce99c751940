//! Waiting for a server that is away, as it or its database starts again, and saying so.

use std::fmt;
use std::io::ErrorKind;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use backon::BackoffBuilder as _;
use lightkiln_proto::problem::RetryClass;

use crate::error::CallError;
use crate::retry::{RetryPolicy, wait_after};

/// Lengths of the waits: soon there again, as a restart takes seconds.
const WAITS: RetryPolicy = RetryPolicy::new()
    .with_min_delay(Duration::from_millis(250))
    .with_max_delay(Duration::from_secs(5))
    .without_max_times();
/// Tries of a call that fails in a way that waiting mends seldom.
const TRIES_OF_OTHERS: u32 = 5;
/// Waits shorter than this are told to nobody.
const SILENT_FOR: Duration = Duration::from_secs(1);
/// A wait that goes on is told again after this time.
const TOLD_AGAIN_AFTER: Duration = Duration::from_secs(60);

/// News of a wait.
#[derive(Debug)]
pub enum Notice<'a> {
    /// The server is waited for.
    Waiting {
        /// Why.
        error: &'a CallError,
        /// For so much longer.
        left: Duration,
    },
    /// It answers again.
    Back {
        /// After so long.
        after: Duration,
    },
}

/// How long a server that is away is waited for. Clones share what was told.
#[derive(Clone)]
pub struct Patience(Arc<Inner>);

struct Inner {
    longest: Duration,
    tell: Box<dyn Fn(Notice<'_>) + Send + Sync>,
    outage: Mutex<Option<Outage>>,
}

/// A time without an answer.
struct Outage {
    since: Instant,
    told: Option<Instant>,
}

impl Patience {
    /// Waits so long at most for one call's answer; `tell` hears of waits that are longer than a moment.
    pub fn new(longest: Duration, tell: impl Fn(Notice<'_>) + Send + Sync + 'static) -> Self {
        Self(Arc::new(Inner { longest, tell: Box::new(tell), outage: Mutex::new(None) }))
    }

    /// Makes `call` until it succeeds, fails for good, or patience ends, with the last error. `pause` waits before the
    /// next try, or ends the series with an error of its own.
    pub(crate) fn insist<T>(
        &self,
        mut call: impl FnMut() -> Result<T, CallError>,
        mut pause: impl FnMut(&CallError, Duration) -> Result<(), CallError>,
    ) -> Result<T, CallError> {
        let (mut waits, mut tries_of_others, mut failing_since) = (WAITS.build(), 0, None);
        loop {
            let error = match call() {
                Err(error) if error.retry_class() == RetryClass::Backoff => error,
                outcome => {
                    self.note_answer();
                    return outcome;
                }
            };
            let is_away = is_away(&error);
            tries_of_others += u32::from(!is_away);
            let failing_for = failing_since.get_or_insert_with(Instant::now).elapsed();
            let left = self.0.longest.saturating_sub(failing_for);
            let longest = waits.next().unwrap_or_default();
            if left.is_zero() || !is_away && tries_of_others >= TRIES_OF_OTHERS {
                self.forget_outage();
                return Err(error);
            }
            self.note_failure(&error, left);
            pause(&error, wait_after(&error, longest).min(left)).inspect_err(|_| self.forget_outage())?;
        }
    }

    fn note_failure(&self, error: &CallError, left: Duration) {
        let mut outage = self.outage();
        let outage = outage.get_or_insert_with(|| Outage { since: Instant::now(), told: None });
        let is_news = outage.told.is_none_or(|told| told.elapsed() >= TOLD_AGAIN_AFTER);
        if outage.since.elapsed() >= SILENT_FOR && is_news {
            outage.told = Some(Instant::now());
            (self.0.tell)(Notice::Waiting { error, left });
        }
    }

    fn note_answer(&self) {
        if let Some(Outage { since, told: Some(_) }) = self.outage().take() {
            (self.0.tell)(Notice::Back { after: since.elapsed() });
        }
    }

    /// It was given up: the next failure begins another.
    fn forget_outage(&self) {
        *self.outage() = None;
    }

    fn outage(&self) -> MutexGuard<'_, Option<Outage>> {
        self.0.outage.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Whether the server, or what it needs, may be starting again or too busy. Full disks and bugs take a person, and a
/// name without an address, a certificate that is not trusted or a server of another protocol stay so.
fn is_away(error: &CallError) -> bool {
    match error {
        CallError::Network { source, .. } => is_of_connection(source),
        error => matches!(error.status(), Some(408 | 425 | 429 | 502..=504)),
    }
}

/// Whether a connection was refused, broke or took too long.
fn is_of_connection(error: &ureq::Error) -> bool {
    use ErrorKind::{
        BrokenPipe, ConnectionAborted, ConnectionRefused, ConnectionReset, HostUnreachable, NetworkDown,
        NetworkUnreachable, NotConnected, TimedOut, UnexpectedEof, WouldBlock,
    };
    match error {
        ureq::Error::Timeout(_) | ureq::Error::ConnectionFailed | ureq::Error::BodyStalled => true,
        ureq::Error::Io(error) => matches!(
            error.kind(),
            BrokenPipe
                | ConnectionAborted
                | ConnectionRefused
                | ConnectionReset
                | HostUnreachable
                | NetworkDown
                | NetworkUnreachable
                | NotConnected
                | TimedOut
                | UnexpectedEof
                | WouldBlock
        ),
        _ => false,
    }
}

impl fmt::Debug for Patience {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Patience").field(&self.0.longest).finish()
    }
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::problem::{Problem, ProblemCode};

    use super::*;

    fn away() -> CallError {
        CallError::Foreign { call: "GET /".to_owned(), status: 503, retry_after: None }
    }

    fn full() -> CallError {
        let problem = Box::new(Problem::new(ProblemCode::StorageFull, "no room"));
        CallError::Refused { call: "PUT /".to_owned(), problem, retry_after: None }
    }

    /// Patience, and the number of waits and of returns that it told.
    fn patience(longest: Duration) -> (Patience, Arc<Mutex<[u32; 2]>>) {
        let told = Arc::new(Mutex::new([0; 2]));
        let counts = told.clone();
        let tell = move |notice: Notice<'_>| {
            counts.lock().unwrap()[usize::from(matches!(notice, Notice::Back { .. }))] += 1;
        };
        (Patience::new(longest, tell), told)
    }

    #[test]
    fn server_that_comes_back_is_waited_for_and_both_are_told_once() {
        let (patience, told) = patience(Duration::from_secs(3600));
        let mut calls = 0;
        let call = || {
            calls += 1;
            if calls == 40 { Ok(calls) } else { Err(away()) }
        };
        let pause = |_: &CallError, _| {
            // As if a moment had gone by.
            let mut outage = patience.outage();
            let outage = outage.as_mut().unwrap();
            outage.since = outage.since.checked_sub(SILENT_FOR).unwrap_or(outage.since);
            Ok(())
        };
        assert_eq!(patience.insist(call, pause).unwrap(), 40);
        assert_eq!(*told.lock().unwrap(), [1, 1]);
        assert_eq!(patience.insist(|| Ok(7), |_, _| Ok(())).unwrap(), 7);
        assert_eq!(*told.lock().unwrap(), [1, 1], "an answer without a wait before it is no news");
    }

    #[test]
    fn patience_ends_with_the_last_error_and_without_it_there_is_one_try() {
        let (patience, _) = patience(Duration::ZERO);
        let mut calls = 0;
        let call = || {
            calls += 1;
            Err::<(), _>(away())
        };
        let error = patience.insist(call, |_, _| Ok(())).unwrap_err();
        assert_eq!((error.status(), calls), (Some(503), 1));
    }

    #[test]
    fn only_a_server_that_is_away_is_waited_for_as_long_as_patience_lasts() {
        let of_status = |status| CallError::Foreign { call: String::new(), status, retry_after: None };
        let of_network = |source| CallError::Network { call: String::new(), source: Box::new(source) };
        let of_io = |kind: ErrorKind| of_network(ureq::Error::Io(kind.into()));
        let is_waited_for = |make: &dyn Fn() -> CallError| {
            let (patience, _) = patience(Duration::from_secs(3600));
            let mut calls = 0;
            let call = || {
                calls += 1;
                if calls == 20 { Ok(()) } else { Err(make()) }
            };
            patience.insist(call, |_, _| Ok(())).is_ok()
        };
        for status in [408, 425, 429, 502, 503, 504] {
            assert!(is_waited_for(&|| of_status(status)), "{status}");
        }
        for kind in [ErrorKind::ConnectionRefused, ErrorKind::ConnectionReset, ErrorKind::TimedOut] {
            assert!(is_waited_for(&|| of_io(kind)), "{kind}");
        }
        assert!(!is_waited_for(&|| of_status(500)) && !is_waited_for(&|| of_status(507)));
        assert!(!is_waited_for(&|| of_io(ErrorKind::InvalidData)), "a certificate that is not trusted");
        assert!(!is_waited_for(&|| of_network(ureq::Error::HostNotFound)));
    }

    #[test]
    fn failure_of_another_kind_after_a_long_outage_is_tried_again_as_often_as_any() {
        let (patience, _) = patience(Duration::from_secs(3600));
        let mut calls = 0;
        let call = || {
            calls += 1;
            match calls {
                ..40 => Err(away()),
                40 => Err(full()),
                _ => Ok(calls),
            }
        };
        assert_eq!(patience.insist(call, |_, _| Ok(())).unwrap(), 41);
    }

    #[test]
    fn outage_that_was_given_up_is_no_part_of_the_next() {
        let (patience, told) = patience(Duration::from_secs(3600));
        let stop = |_: &CallError, _| {
            patience.outage().as_mut().unwrap().told = Some(Instant::now());
            Err(CallError::Stopped)
        };
        patience.insist(|| Err::<(), _>(away()), stop).unwrap_err();
        patience.insist(|| Ok(()), |_, _| Ok(())).unwrap();
        assert_eq!(*told.lock().unwrap(), [0, 0], "a return is told of an outage that is waited for");
    }

    #[test]
    fn full_disk_and_refusal_for_good_are_not_waited_for() {
        let (patience, _) = patience(Duration::from_secs(3600));
        let mut calls = 0;
        let call = || {
            calls += 1;
            Err::<(), _>(full())
        };
        patience.insist(call, |_, _| Ok(())).unwrap_err();
        assert_eq!(calls, TRIES_OF_OTHERS);
        let refused =
            || Err::<(), _>(CallError::Foreign { call: String::new(), status: 404, retry_after: None });
        patience.insist(refused, |_, _| panic!("it fails for good")).unwrap_err();
    }
}
