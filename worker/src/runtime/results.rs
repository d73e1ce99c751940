//! Results on their way to the server: those that come while a call is under way go together with the next one.
//!
//! A worker of many short tasks would otherwise make a call for each, and the server a transaction. Nobody waits long for the calls of
//! others: one that gets no answer keeps its own results back, and no others.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use lightkiln_http::CallError;
use lightkiln_proto::api::{Commit, CommitOutcome, CommitVerdict, Commits, MAX_COMMITS, TaskResult};

use super::farm::Farm;

/// Time after which a call without an answer holds up no other. Shorter → more calls where the server is slow.
const PATIENCE: Duration = Duration::from_secs(5);

/// The answer to one of the results that went together.
#[derive(Clone, Copy)]
enum Answer {
    Verdict(CommitVerdict),
    /// There was none, or a refusal: it asks again by itself, and hears why.
    AskAlone,
}

type Slot = Arc<Mutex<Option<Answer>>>;

/// The results of one worker.
pub(super) struct Results {
    line: Mutex<Line>,
    /// Answers have come, or the next call may begin.
    moved: Condvar,
    patience: Duration,
}

#[derive(Default)]
struct Line {
    waiting: Vec<(Commit, Slot)>,
    /// The call under way for which others wait: its number, and its begin.
    sending: Option<(u64, Instant)>,
    calls: u64,
}

impl Line {
    fn has(&self, slot: &Slot) -> bool {
        self.waiting.iter().any(|(_, waiting)| Arc::ptr_eq(waiting, slot))
    }

    /// Begins a call with those that came first.
    fn begin(&mut self) -> (u64, Vec<(Commit, Slot)>) {
        self.calls += 1;
        self.sending = Some((self.calls, Instant::now()));
        let count = self.waiting.len().min(MAX_COMMITS);
        (self.calls, self.waiting.drain(..count).collect())
    }
}

/// A call under way; over when dropped.
struct Sending<'a> {
    results: &'a Results,
    number: u64,
}

impl Drop for Sending<'_> {
    fn drop(&mut self) {
        let mut line = lock(&self.results.line);
        // Unless it took so long that another one began.
        line.sending = line.sending.filter(|(number, _)| *number != self.number);
        self.results.moved.notify_all();
    }
}

impl Default for Results {
    fn default() -> Self {
        Self { line: Mutex::default(), moved: Condvar::new(), patience: PATIENCE }
    }
}

impl Results {
    /// Hands a result in, together with others if there are any.
    pub(super) fn hand_in(
        &self,
        farm: &Farm,
        token: &str,
        result: &TaskResult,
    ) -> Result<CommitVerdict, CallError> {
        // A plan is long: nobody waits for its way.
        if !result.plan.is_empty() {
            return farm.commit(token, result);
        }
        let slot = Slot::default();
        let began = Instant::now();
        let mut line = lock(&self.line);
        line.waiting.push((Commit { token: token.to_owned(), result: result.clone() }, slot.clone()));
        loop {
            match *lock(&slot) {
                Some(Answer::Verdict(verdict)) => return Ok(verdict),
                Some(Answer::AskAlone) => break,
                None => (),
            }
            let since = line.sending.map(|(_, since)| since);
            if line.has(&slot) && since.is_none_or(|since| since.elapsed() >= self.patience) {
                let (number, together) = line.begin();
                drop(line);
                let _sending = Sending { results: self, number };
                if together.len() == 1 {
                    return farm.commit(token, result);
                }
                send(farm, together);
            } else if began.elapsed() >= 2 * self.patience {
                // It went with a call that hangs. The same token commits once, whichever call brings it.
                line.waiting.retain(|(_, waiting)| !Arc::ptr_eq(waiting, &slot));
                break;
            } else {
                drop(
                    self.moved.wait_timeout(line, self.patience / 4).unwrap_or_else(PoisonError::into_inner),
                );
            }
            line = lock(&self.line);
        }
        drop(line);
        farm.commit(token, result)
    }
}

/// Sends several results, and answers each.
fn send(farm: &Farm, together: Vec<(Commit, Slot)>) {
    let (commits, slots): (Vec<Commit>, Vec<Slot>) = together.into_iter().unzip();
    let count = commits.len();
    let outcomes = match farm.commit_all(&Commits { commits }) {
        Ok(answer) if answer.answers.len() == count => answer.answers,
        Ok(_) => {
            tracing::warn!("a server answered other results than it was given; each asks alone");
            Vec::new()
        }
        Err(error) => {
            tracing::debug!(%error, "results that went together found no answer");
            Vec::new()
        }
    };
    let mut outcomes = outcomes.into_iter();
    for slot in slots {
        *lock(&slot) = Some(match outcomes.next() {
            Some(CommitOutcome::Verdict(verdict)) => Answer::Verdict(verdict),
            Some(CommitOutcome::Problem(_)) | None => Answer::AskAlone,
        });
    }
}

fn lock<T>(held: &Mutex<T>) -> MutexGuard<'_, T> {
    held.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use std::thread::{Scope, ScopedJoinHandle};

    use super::super::tests::fake_farm::{FakeFarm, LIMIT};
    use super::*;

    /// Hands results in while a call is under way; the verdicts, and the calls that were made.
    fn hand_in_together(farm: &FakeFarm, tokens: &[&str]) -> (Vec<CommitVerdict>, Vec<String>) {
        let results = Results { patience: LIMIT, ..Results::default() };
        let client = Farm::new(farm.url(), None, None).unwrap();
        let verdicts = std::thread::scope(|scope| {
            let sending = Sending { results: &results, number: lock(&results.line).begin().0 };
            let threads: Vec<_> =
                tokens.iter().map(|token| hand_in(scope, &results, &client, token)).collect();
            wait_until(|| lock(&results.line).waiting.len() == tokens.len());
            drop(sending);
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        });
        let calls = farm.state().calls.clone();
        (verdicts, calls)
    }

    fn hand_in<'scope>(
        scope: &'scope Scope<'scope, '_>,
        results: &'scope Results,
        client: &'scope Farm,
        token: &str,
    ) -> ScopedJoinHandle<'scope, CommitVerdict> {
        let token = token.to_owned();
        scope.spawn(move || results.hand_in(client, &token, &TaskResult::default()).unwrap())
    }

    fn wait_until(done: impl Fn() -> bool) {
        let started = Instant::now();
        while !done() {
            assert!(started.elapsed() < LIMIT);
            std::thread::yield_now();
        }
    }

    #[test]
    fn results_that_come_during_a_call_go_together_with_the_next() {
        let farm = FakeFarm::start();
        let (verdicts, calls) = hand_in_together(&farm, &["a", "b", "c"]);
        assert_eq!(verdicts, [CommitVerdict::Committed; 3]);
        assert_eq!(calls, ["POST /v1/leases/commit"]);
        assert_eq!(farm.state().committed.len(), 3);
    }

    #[test]
    fn results_whose_common_call_fails_ask_alone() {
        let farm = FakeFarm::start();
        farm.state().refuse.push("POST /v1/leases/commit");
        let (verdicts, calls) = hand_in_together(&farm, &["a", "b"]);
        assert_eq!(verdicts, [CommitVerdict::Committed; 2]);
        assert_eq!(calls.len(), 3, "{calls:?}");
    }

    #[test]
    fn result_whose_answer_was_lost_on_the_common_way_is_committed_once() {
        let farm = FakeFarm::start();
        farm.state().lose_answers.push("POST /v1/leases/commit");
        let (verdicts, _) = hand_in_together(&farm, &["a", "b"]);
        assert_eq!(verdicts, [CommitVerdict::AlreadyCommitted; 2]);
    }
    #[test]
    fn call_that_hangs_holds_up_neither_later_results_nor_for_long_those_that_went_with_it() {
        let farm = FakeFarm::start();
        // Long enough for two results to meet.
        let results = Results { patience: Duration::from_secs(1), ..Results::default() };
        let client = Farm::new(farm.url(), None, None).unwrap();
        farm.state().hang = Some("POST /v1/leases/commit");
        std::thread::scope(|scope| {
            let sending = Sending { results: &results, number: lock(&results.line).begin().0 };
            let together = ["a", "b"].map(|token| hand_in(scope, &results, &client, token));
            wait_until(|| lock(&results.line).waiting.len() == 2 || !farm.state().calls.is_empty());
            drop(sending);
            farm.wait_for("the call that hangs", |state| !state.calls.is_empty());
            let later = hand_in(scope, &results, &client, "c");
            farm.wait_for("a later result", |state| state.committed.contains_key("c"));
            later.join().unwrap();
            farm.wait_for("one that went with the call", |state| state.committed.len() == 2);
            farm.let_go();
            for thread in together {
                thread.join().unwrap();
            }
        });
        let tokens: Vec<String> = farm.state().committed.keys().cloned().collect();
        assert_eq!(tokens, ["a", "b", "c"]);
    }
}
