//! Calls on threads of their own: one that finds no answer keeps no worker that is to end.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use lightkiln_http::{Level, ShutdownFlag};

/// A call under way. Dropped, it goes on by itself, and nobody hears its answer.
pub(super) struct Aside<'a, T> {
    answer: Arc<Mutex<Option<thread::Result<T>>>>,
    shutdown: &'a ShutdownFlag,
}

impl<'a, T: Send + 'static> Aside<'a, T> {
    /// Begins `call`, as a part of what is traced here; whoever waits on `shutdown` is woken by its answer.
    pub(super) fn begin(shutdown: &'a ShutdownFlag, call: impl FnOnce() -> T + Send + 'static) -> Self {
        let answer = Arc::new(Mutex::new(None));
        let (slot, flag, span) = (answer.clone(), shutdown.clone(), tracing::Span::current());
        thread::spawn(move || {
            let answer = catch_unwind(AssertUnwindSafe(|| span.in_scope(call)));
            *lock(&slot) = Some(answer);
            flag.wake();
        });
        Self { answer, shutdown }
    }

    /// The answer, unless `is_over` or the end of `patience` comes first.
    pub(super) fn wait(&self, patience: Duration, is_over: impl Fn(Level) -> bool) -> Option<T> {
        self.shutdown.wait(patience, |level| lock(&self.answer).is_some() || is_over(level));
        let answer = lock(&self.answer).take();
        answer.map(|answer| answer.unwrap_or_else(|panic| resume_unwind(panic)))
    }
}

fn lock<T>(held: &Mutex<T>) -> MutexGuard<'_, T> {
    held.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::super::tests::fake_farm::LIMIT;
    use super::*;

    #[test]
    fn call_without_an_answer_is_left_when_it_is_over_and_may_be_waited_for_again() {
        let shutdown = ShutdownFlag::new();
        let (answer, answers) = channel();
        let aside = Aside::begin(&shutdown, move || answers.recv().ok());
        assert_eq!(aside.wait(Duration::ZERO, |_| false), None);
        shutdown.raise(Level::Drain);
        assert_eq!(aside.wait(LIMIT, |level| level > Level::Run), None);
        answer.send(7).unwrap();
        assert_eq!(aside.wait(LIMIT, |_| false), Some(Some(7)));
    }
}
