//! When a failed call is made again: growing waits with half jitter, none shorter than the server asks for.

use std::time::Duration;

use backon::{BackoffBuilder as _, ExponentialBuilder};
use lightkiln_proto::problem::RetryClass;

use crate::error::CallError;

/// Number and longest lengths of the waits between tries.
pub type RetryPolicy = ExponentialBuilder;

/// Some seconds in all: a person or a step of a longer work waits.
pub const USUAL: RetryPolicy = RetryPolicy::new()
    .with_min_delay(Duration::from_millis(250))
    .with_max_delay(Duration::from_secs(8))
    .with_max_times(6);

/// Until it works or fails for good: nobody waits, and the caller's `pause` says when to give up.
pub const FOREVER: RetryPolicy = RetryPolicy::new()
    .with_min_delay(Duration::from_millis(200))
    .with_max_delay(Duration::from_secs(15))
    .without_max_times();

/// Longest wait that a server may ask for.
const RETRY_AFTER_MAX: Duration = Duration::from_secs(60);

/// Makes `call` until it succeeds, fails for good, or the policy's waits are used up. `pause` waits before the next try,
/// or ends the series with an error of its own.
///
/// A wait is uniform between half the policy's and all of it, so that callers that were cut off together come back one by
/// one, and none gives up at once; it is added to the time that the server asks for. We differ from `backon`'s own loop: its waits can
/// neither be cut short nor depend on the error.
pub fn retry<T>(
    policy: RetryPolicy,
    mut call: impl FnMut() -> Result<T, CallError>,
    mut pause: impl FnMut(&CallError, Duration) -> Result<(), CallError>,
) -> Result<T, CallError> {
    let mut waits = policy.build();
    loop {
        let error = match call() {
            Err(error) if error.retry_class() == RetryClass::Backoff => error,
            outcome => return outcome,
        };
        let Some(longest) = waits.next() else { return Err(error) };
        pause(&error, wait_after(&error, longest))?;
    }
}

/// Length of a wait of at most `longest`, beside that which the server asks for.
pub(crate) fn wait_after(error: &CallError, longest: Duration) -> Duration {
    let asked = error.retry_after().unwrap_or_default().min(RETRY_AFTER_MAX);
    asked + longest.mul_f64(0.5 + 0.5 * fastrand::f64())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn busy(retry_after: Option<Duration>) -> CallError {
        CallError::Foreign { call: "GET /".to_owned(), status: 503, retry_after }
    }

    /// The waits of a series whose calls all fail with `error`, until it ends.
    fn waits(policy: RetryPolicy, error: impl Fn() -> CallError) -> Vec<Duration> {
        let mut waits = Vec::new();
        let pause = |_: &CallError, wait| {
            waits.push(wait);
            if waits.len() < 1000 { Ok(()) } else { Err(CallError::Stopped) }
        };
        retry::<()>(policy, || Err(error()), pause).unwrap_err();
        waits
    }

    #[test]
    fn waits_lie_between_half_the_longest_and_the_longest() {
        let policy = RetryPolicy::new().with_max_delay(Duration::from_secs(4)).with_max_times(500);
        let waits = waits(policy, || busy(None));
        assert_eq!(waits.len(), 500);
        assert!(waits[0] <= Duration::from_secs(1) && waits[1] <= Duration::from_secs(2));
        let later = &waits[5..];
        let bounds = Duration::from_secs(2)..=Duration::from_secs(4);
        assert!(later.iter().all(|wait| bounds.contains(wait)), "{waits:?}");
        let mean = later.iter().sum::<Duration>().as_secs_f64() / later.len() as f64;
        assert!((2.8..3.2).contains(&mean), "{mean:?}");
    }

    #[test]
    fn wait_is_as_long_as_the_server_asks_within_reason() {
        let policy = RetryPolicy::new().with_min_delay(Duration::ZERO).with_max_times(1);
        let of = |secs| waits(policy, || busy(Some(Duration::from_secs(secs))));
        assert_eq!((of(7), of(86400)), (vec![Duration::from_secs(7)], vec![RETRY_AFTER_MAX]));
    }

    #[test]
    fn failure_for_good_and_a_pause_that_ends_are_the_last() {
        let refused = || CallError::Foreign { call: "GET /".to_owned(), status: 404, retry_after: None };
        assert!(waits(FOREVER, refused).is_empty());
        assert_eq!(waits(FOREVER, || busy(None)).len(), 1000);
        let mut calls = 0;
        let third = || {
            calls += 1;
            if calls == 3 { Ok(calls) } else { Err(busy(None)) }
        };
        assert_eq!(retry(FOREVER, third, |_, _| Ok(())).unwrap(), 3);
    }
}
