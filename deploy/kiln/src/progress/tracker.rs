//! From what the server says of a bake to figures that move: stage, share, rays per second, time left.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use lightkiln_proto::api::{Bake, BakeState, StageCount};

use super::estimate::{Estimate, Estimator};
use crate::summary::stage_name;

/// Rays per second are averaged over at least this long.
const RATE_WINDOW: Duration = Duration::from_secs(15);

/// A bake at one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    /// The stage being worked on.
    pub stage: String,
    /// Its tasks done.
    pub done: u64,
    /// Its tasks.
    pub total: u64,
    /// Share of the whole bake, and the time left.
    pub estimate: Estimate,
    /// Rays per second lately, once some were cast.
    pub rays_per_sec: Option<f64>,
}

/// Remembers what it needs of earlier moments.
pub struct Tracker {
    started: Instant,
    estimator: Estimator,
    /// Kind of the stage that was told last.
    stage: Option<String>,
    /// Moments at which the count of rays was found changed.
    rays: VecDeque<(Instant, f64)>,
}

impl Tracker {
    /// Starts at `now`.
    pub fn new(now: Instant) -> Self {
        Self { started: now, estimator: Estimator::default(), stage: None, rays: VecDeque::new() }
    }

    /// Figures of `bake` as it stands at `now`.
    pub fn observe(&mut self, bake: &Bake, now: Instant) -> Snapshot {
        let current = current_stage(&bake.stages, self.stage.as_deref());
        self.stage = current.map(|stage| stage.kind.clone());
        let stage = match (bake.state, current) {
            (BakeState::Paused, _) => "paused".to_owned(),
            (_, Some(stage)) => stage_name(&stage.kind),
            (_, None) => "waiting".to_owned(),
        };
        Snapshot {
            stage,
            done: current.map_or(0, |stage| stage.done),
            total: current.map_or(0, |stage| stage.total),
            estimate: self.estimator.observe(bake, now.saturating_duration_since(self.started)),
            rays_per_sec: self.rays_per_sec(bake, now),
        }
    }

    /// Rays are counted when a task is done, so they are averaged from one such moment to another: between two the rate
    /// stays, unless nothing came for longer than what it is averaged over.
    fn rays_per_sec(&mut self, bake: &Bake, now: Instant) -> Option<f64> {
        let counter = |name: &str| bake.counters.get(name).copied().unwrap_or(0.0);
        let rays = counter("rays_closest") + counter("rays_occlusion") + counter("rays_linking");
        if self.rays.is_empty() {
            self.rays.push_back((self.started, rays));
        }
        if self.rays.back().is_some_and(|(_, before)| rays > *before) {
            self.rays.push_back((now, rays));
        }
        let (last, _) = *self.rays.back()?;
        while self.rays.len() > 2 && last.duration_since(self.rays[1].0) >= RATE_WINDOW {
            self.rays.pop_front();
        }
        let (since, before) = *self.rays.front()?;
        let window = last.duration_since(since);
        let silence = now.saturating_duration_since(last);
        let secs = if silence > window.max(RATE_WINDOW) { window + silence } else { window }.as_secs_f64();
        (rays > before && secs > 0.0).then(|| (rays - before) / secs)
    }
}

/// The stage told before for as long as workers hold tasks of it, or short ones that come between its own; else, of those that
/// they hold tasks of, the one with the most work left; else, between two leases, the first that has begun; else the first
/// that is not done.
fn current_stage<'a>(stages: &'a [StageCount], before: Option<&str>) -> Option<&'a StageCount> {
    let left = |stage: &StageCount| stage.cost_total.saturating_sub(stage.cost_done);
    let held = stages.iter().filter(|stage| stage.leased > 0).max_by_key(|stage| left(stage));
    let goes_on = |stage: &&StageCount| stage.leased > 0 || held.is_some_and(|held| left(held) < left(stage));
    let told = stages.iter().find(|stage| Some(stage.kind.as_str()) == before);
    told.filter(goes_on)
        .or(held)
        .or_else(|| stages.iter().find(|stage| 0 < stage.done && stage.done < stage.total))
        .or_else(|| stages.iter().find(|stage| stage.done < stage.total))
        .or(stages.last())
}
