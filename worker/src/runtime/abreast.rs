//! Calls side by side: over a long line, a task with thousands of artefacts does not wait for each one's way there and back.

use std::panic::resume_unwind;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;

/// Calls of one task at a time. More → less waiting over long lines, more connections.
const CALLS_AT_ONCE: usize = 16;

/// Makes `call` for each item, many at a time; what they gave, in the order of the items. Of calls that fail, the error is that of the
/// first item; none is begun after one has failed.
pub(super) fn abreast<T: Sync, R: Send, E: Send>(
    items: &[T],
    call: impl Fn(&T) -> Result<R, E> + Sync,
) -> Result<Vec<R>, E> {
    let (next, has_failed) = (AtomicUsize::new(0), AtomicBool::new(false));
    let span = tracing::Span::current();
    let run = || {
        let _inside = span.enter();
        let mut done = Vec::new();
        while !has_failed.load(Ordering::Relaxed) {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(item) = items.get(index) else { break };
            let answer = call(item);
            has_failed.fetch_or(answer.is_err(), Ordering::Relaxed);
            done.push((index, answer));
        }
        done
    };
    let mut done = thread::scope(|scope| {
        let helpers: Vec<_> = (1..items.len().min(CALLS_AT_ONCE)).map(|_| scope.spawn(run)).collect();
        let mut done = run();
        for helper in helpers {
            done.extend(helper.join().unwrap_or_else(|panic| resume_unwind(panic)));
        }
        done
    });
    done.sort_unstable_by_key(|(index, _)| *index);
    done.into_iter().map(|(_, answer)| answer).collect()
}

#[cfg(test)]
mod tests {
    use std::sync::Barrier;

    use super::*;

    #[test]
    fn calls_are_made_side_by_side_and_answered_in_order() {
        // Each call waits until as many others are under way.
        let barrier = Barrier::new(CALLS_AT_ONCE);
        let items: Vec<usize> = (0..3 * CALLS_AT_ONCE).collect();
        let answers = abreast(&items, |item| {
            barrier.wait();
            Ok::<_, ()>(item + 1)
        });
        assert_eq!(answers.unwrap(), items.iter().map(|item| item + 1).collect::<Vec<_>>());
        assert_eq!(abreast(&[], |(): &()| Err::<(), _>("none is called")), Ok(Vec::new()));
    }

    #[test]
    fn first_failure_is_the_one_that_is_told_and_ends_the_rest() {
        let (items, calls) = ((0..10_000).collect::<Vec<usize>>(), AtomicUsize::new(0));
        let told = abreast(&items, |item| {
            calls.fetch_add(1, Ordering::Relaxed);
            if *item < 5 { Ok(()) } else { Err(*item) }
        });
        assert_eq!(told, Err(5));
        assert!(calls.into_inner() < 5 + 2 * CALLS_AT_ONCE);
    }
}
