//! From what the server says of a bake to figures that move: stage, share, rays per second, time left.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use lightkiln_proto::api::{Bake, StageCount};

use crate::summary::stage_name;

/// Rays per second are averaged over this long.
const RATE_WINDOW: Duration = Duration::from_secs(15);
/// No time left is told before this much of the work is done here, in at least this time: it would be a guess.
const SHARE_MIN: f64 = 0.02;
const SECS_MIN: f64 = 2.0;

/// A bake at one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    /// The stage being worked on.
    pub stage: String,
    /// Its tasks done.
    pub done: u64,
    /// Its tasks.
    pub total: u64,
    /// Share of the known work that is done, 0..=1.
    pub share: f64,
    /// Rays per second lately, once some were cast.
    pub rays_per_sec: Option<f64>,
    /// Time left, once it can be told.
    pub left: Option<Duration>,
}

/// Remembers what it needs of earlier moments.
pub struct Tracker {
    started: Instant,
    cost_at_plan: Option<(u64, u64, Instant)>,
    rays: VecDeque<(Instant, f64)>,
}

impl Tracker {
    /// Starts at `now`.
    pub fn new(now: Instant) -> Self {
        Self { started: now, cost_at_plan: None, rays: VecDeque::new() }
    }

    /// Figures of `bake` as it stands at `now`.
    pub fn observe(&mut self, bake: &Bake, now: Instant) -> Snapshot {
        let total: u64 = bake.stages.iter().map(|stage| stage.cost_total).sum();
        let done: u64 = bake.stages.iter().map(|stage| stage.cost_done).sum();
        let current = current_stage(&bake.stages);
        Snapshot {
            stage: current.map_or_else(|| "waiting".to_owned(), |stage| stage_name(&stage.kind)),
            done: current.map_or(0, |stage| stage.done),
            total: current.map_or(0, |stage| stage.total),
            share: done as f64 / total.max(1) as f64,
            rays_per_sec: self.rays_per_sec(bake, now),
            left: self.left(done, total, now),
        }
    }

    fn rays_per_sec(&mut self, bake: &Bake, now: Instant) -> Option<f64> {
        let counter = |name: &str| bake.counters.get(name).copied().unwrap_or(0.0);
        let rays = counter("rays_closest") + counter("rays_occlusion");
        if self.rays.is_empty() {
            self.rays.push_back((self.started, rays));
        }
        self.rays.push_back((now, rays));
        while self.rays.len() > 2 && now.duration_since(self.rays[1].0) >= RATE_WINDOW {
            self.rays.pop_front();
        }
        let (since, before) = *self.rays.front()?;
        let secs = now.duration_since(since).as_secs_f64();
        (rays > before && secs > 0.0).then(|| (rays - before) / secs)
    }

    /// The work known to be left at the pace since the plan last grew.
    fn left(&mut self, done: u64, total: u64, now: Instant) -> Option<Duration> {
        let (_, at_plan, since) = match self.cost_at_plan {
            Some(known) if known.0 == total => known,
            _ => *self.cost_at_plan.insert((total, done, now)),
        };
        let work = total.saturating_sub(at_plan) as f64;
        let share = (done.saturating_sub(at_plan)) as f64 / work.max(1.0);
        let secs = now.duration_since(since).as_secs_f64();
        (share >= SHARE_MIN && secs >= SECS_MIN && done < total)
            .then(|| Duration::from_secs_f64(secs * (1.0 - share) / share))
    }
}

/// Of the stages that workers hold tasks of, the one with the most work left; else, between two leases, the first that
/// has begun; else the first that is not done.
fn current_stage(stages: &[StageCount]) -> Option<&StageCount> {
    let held = stages.iter().filter(|stage| stage.leased > 0);
    held.max_by_key(|stage| stage.cost_total - stage.cost_done)
        .or_else(|| stages.iter().find(|stage| 0 < stage.done && stage.done < stage.total))
        .or_else(|| stages.iter().find(|stage| stage.done < stage.total))
        .or(stages.last())
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use lightkiln_proto::api::BakeState;
    use lightkiln_proto::ids::Digest;

    use super::*;

    fn stage(kind: &str, done: u64, total: u64) -> StageCount {
        StageCount {
            kind: kind.into(),
            total,
            done,
            reused: 0,
            leased: 0,
            cost_total: total * 10,
            cost_done: done * 10,
            elapsed_ms: 0,
        }
    }

    fn bake(stages: Vec<StageCount>, rays: f64) -> Bake {
        Bake {
            id: "b".into(),
            name: String::new(),
            kind: "prt".into(),
            scene: Digest::of(b""),
            settings: serde_json::Value::Null,
            priority: 0,
            needs: Default::default(),
            state: BakeState::Running,
            stages,
            tasks_run: 0,
            tasks_reused: 0,
            failure: None,
            manifest: None,
            report: None,
            created_ms: 0,
            finished_ms: None,
            counters: BTreeMap::from([("rays_closest".to_owned(), rays)]),
            counters_reused: BTreeMap::new(),
            results_lost: 0,
        }
    }

    #[test]
    fn time_left_follows_the_pace_since_the_plan() {
        let start = Instant::now();
        let mut tracker = Tracker::new(start);
        let at = |secs| start + Duration::from_secs(secs);
        let early = tracker.observe(&bake(vec![stage("scene.import", 0, 1)], 0.0), at(1));
        assert_eq!((early.stage.as_str(), early.left, early.rays_per_sec), ("import", None, None));
        let planned =
            |done, rays| bake(vec![stage("scene.import", 1, 1), stage("prt.transport", done, 9)], rays);
        assert_eq!(tracker.observe(&planned(0, 0.0), at(10)).left, None);
        let later = tracker.observe(&planned(3, 2e6), at(16));
        assert_eq!((later.stage.as_str(), later.done, later.total), ("transport", 3, 9));
        assert_eq!(later.left, Some(Duration::from_secs(12)));
        assert!((later.share - 0.4).abs() < 1e-9);
    }

    #[test]
    fn stage_that_is_worked_on_is_told_even_when_an_earlier_one_waits() {
        let held = StageCount { leased: 1, ..stage("prt.transport", 2, 9) };
        let stages = [stage("scene.import", 1, 1), stage("prt.plan", 0, 1), held];
        assert_eq!(current_stage(&stages).map(|stage| stage.kind.as_str()), Some("prt.transport"));
        assert_eq!(current_stage(&stages[..2]).map(|stage| stage.kind.as_str()), Some("prt.plan"));
        assert_eq!(current_stage(&stages[..1]).map(|stage| stage.kind.as_str()), Some("scene.import"));
    }

    #[test]
    fn rays_per_second_forgets_what_was_long_ago() {
        let start = Instant::now();
        let mut tracker = Tracker::new(start);
        let of = |rays| bake(vec![stage("prt.transport", 0, 9)], rays);
        for secs in 1..=100 {
            tracker.observe(&of(0.0), start + Duration::from_secs(secs));
        }
        let rate = tracker.observe(&of(16e6), start + Duration::from_secs(101)).rays_per_sec.unwrap();
        assert!((0.9e6..=1.2e6).contains(&rate), "{rate}");
    }
}
