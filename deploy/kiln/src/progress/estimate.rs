//! One estimate for a whole bake: the share that is done, and the time that is left.
//!
//! The tasks of a bake are known in two steps: those that prepare, with its plan as their last, from the start; the rest,
//! which is most of the work, once the plan is done. So the share goes to [`PREPARED_SHARE`] by the cost of the first,
//! and from there to the end by the cost of the others. Time left is told of the others alone, by the pace at which
//! their cost is worked off.

use std::time::Duration;

use lightkiln_proto::api::{Bake, BakeState, StageCount};

/// Share that is shown when the plan is done. A bake's true one is between a twentieth and a third.
const PREPARED_SHARE: f64 = 0.1;
/// Highest share before the end.
const UNFINISHED_MAX: f64 = 0.99;
/// Seconds after which what was seen counts half for the pace. More → steadier; less → sooner right when workers come
/// and go.
const PACE_HALF_LIFE_SECS: f64 = 120.0;
/// No time left is told before this much of the work was done at a pace that was seen, in at least this time: it would
/// be a guess.
const SEEN_SHARE_MIN: f64 = 0.02;
const SEEN_SECS_MIN: f64 = 2.0;
/// The time left runs down with the clock and follows the pace within this time, or within a share of itself. More →
/// steadier; less → sooner right.
const FOLLOW_SECS_MIN: f64 = 4.0;
const FOLLOW_SHARE: f64 = 0.125;

/// A bake's progress at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimate {
    /// Share that is done, 0..=1. It never falls, and is 1 only once the bake is done.
    pub share: f64,
    /// Time left, once it can be told; never 0 before the end.
    pub left: Option<Duration>,
}

/// Estimates one bake's progress from what the server says of it, again and again. It knows no clock of its own.
#[derive(Clone, Debug, Default)]
pub struct Estimator {
    share: f64,
    left_secs: Option<f64>,
    seen: Option<Seen>,
}

/// The moment last looked at, and the pace until then.
#[derive(Clone, Copy, Debug)]
struct Seen {
    at: Duration,
    done: u64,
    /// Cost worked off, and the seconds that it took; both count less the longer ago they were.
    run: f64,
    secs: f64,
}

/// The cost of a bake's tasks.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Work {
    /// Of tasks up to the plan: done, and all.
    first: [u64; 2],
    /// Of those that it planned.
    rest: [u64; 2],
    /// Every task is known.
    is_planned: bool,
    /// Cost of the rest that was run for this bake, and the seconds in which it was.
    run: f64,
    run_secs: f64,
}

impl Estimator {
    /// The progress of `bake` at `at`, a time since any fixed moment.
    pub fn observe(&mut self, bake: &Bake, at: Duration) -> Estimate {
        let work = Work::of(&bake.stages);
        self.share = match bake.state {
            BakeState::Done => 1.0,
            _ => self.share.max(work.share().min(UNFINISHED_MAX)),
        };
        self.left_secs = match bake.state {
            BakeState::Running if work.is_planned => self.follow(&work, at),
            // Nothing runs, and the time in which nothing does is no part of the pace.
            _ => {
                self.seen = self.seen.map(|seen| Seen { at, done: work.rest[0], ..seen });
                None
            }
        };
        Estimate {
            share: self.share,
            left: self.left_secs.map(|secs| Duration::from_secs_f64(secs.max(1.0))),
        }
    }

    /// The time left before, less the time gone, drawn towards what the pace says now.
    fn follow(&mut self, work: &Work, at: Duration) -> Option<f64> {
        let [done, total] = work.rest;
        // What ran before the first look counts, too: who comes late is told at once.
        let before = self.seen.unwrap_or(Seen { at, done, run: work.run, secs: work.run_secs });
        let gone_secs = at.saturating_sub(before.at).as_secs_f64();
        let keep = (-gone_secs / PACE_HALF_LIFE_SECS).exp2();
        let seen = Seen {
            at,
            done,
            run: before.run * keep + done.saturating_sub(before.done) as f64,
            secs: before.secs * keep + gone_secs,
        };
        self.seen = Some(seen);
        let to_do = total.saturating_sub(done) as f64;
        let is_guess = seen.run < SEEN_SHARE_MIN * total as f64 || seen.secs < SEEN_SECS_MIN;
        let by_clock = self.left_secs.map(|secs| (secs - gone_secs).max(0.0));
        if is_guess || to_do == 0.0 {
            return by_clock;
        }
        let by_pace = to_do * seen.secs / seen.run;
        let Some(by_clock) = by_clock else { return Some(by_pace) };
        let follow_secs = FOLLOW_SECS_MIN.max(FOLLOW_SHARE * by_clock);
        let drawn = 1.0 - (-gone_secs / follow_secs).exp();
        Some(by_clock + drawn * (by_pace - by_clock))
    }
}

impl Work {
    fn of(stages: &[StageCount]) -> Self {
        let plan = stages.iter().rposition(|stage| is_plan(&stage.kind));
        let (first, rest) = stages.split_at(plan.map_or(0, |plan| plan + 1));
        let cost = |stages: &[StageCount]| {
            let sum = |cost: fn(&StageCount) -> u64| stages.iter().map(cost).sum();
            [sum(|stage| stage.cost_done), sum(|stage| stage.cost_total)]
        };
        Self {
            first: cost(first),
            rest: cost(rest),
            is_planned: !rest.is_empty() && first.iter().all(|stage| stage.done == stage.total),
            run: rest.iter().map(cost_run).sum(),
            run_secs: rest.iter().map(|stage| stage.elapsed_ms as f64 / 1e3).fold(0.0, f64::max),
        }
    }

    fn share(&self) -> f64 {
        let of = |[done, total]: [u64; 2]| done as f64 / total.max(1) as f64;
        match self.first {
            [_, 0] => of(self.rest),
            first if self.is_planned => PREPARED_SHARE * of(first) + (1.0 - PREPARED_SHARE) * of(self.rest),
            first => PREPARED_SHARE * of(first),
        }
    }
}

/// Whether tasks of this kind plan others. Planning tasks of all kinds of bake are named so.
fn is_plan(kind: &str) -> bool {
    kind.ends_with(".plan")
}

/// Cost of a stage's tasks that were run for the bake: those that were done before took it no time.
fn cost_run(stage: &StageCount) -> f64 {
    let run = stage.done.saturating_sub(stage.reused) as f64;
    stage.cost_done as f64 * run / stage.done.max(1) as f64
}
