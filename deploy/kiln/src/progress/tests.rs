//! Progress of bakes that were recorded: what a person would have read.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use lightkiln_proto::api::{Bake, BakeState, StageCount};
use lightkiln_proto::ids::Digest;

use super::tracker::{Snapshot, Tracker};

/// Recordings of whole bakes, a line for each second.
const RECORDINGS: [(&str, &str); 4] = [
    ("atrium", include_str!("recordings/atrium.txt")),
    ("cornell", include_str!("recordings/cornell.txt")),
    ("hall", include_str!("recordings/hall.txt")),
    ("rooms", include_str!("recordings/rooms.txt")),
];

/// A moment of a bake, and what was told of it.
struct Told {
    at: Duration,
    is_over: bool,
    snapshot: Snapshot,
}

/// What a tracker tells of a recording that it looks at from `from` on.
fn told(recording: &str, from: Duration) -> Vec<Told> {
    let start = Instant::now();
    let lines: Vec<&str> = recording.lines().filter(|line| !line.starts_with('#')).collect();
    assert!(lines.len() > 2, "the recording holds moments");
    let mut tracker = Tracker::new(start + from);
    let moments = lines.iter().map(|line| moment(line)).filter(|(at, _)| *at >= from);
    moments
        .map(|(at, bake)| {
            let snapshot = tracker.observe(&bake, start + at);
            Told { at, is_over: bake.state == BakeState::Done, snapshot }
        })
        .collect()
}

fn moment(line: &str) -> (Duration, Bake) {
    let mut parts = line.split('|');
    let mut head = parts.next().unwrap().split(' ').map(|number| number.parse::<f64>().unwrap());
    let (at_ms, rays) = (head.next().unwrap(), head.next().unwrap());
    let stages: Vec<StageCount> = parts.map(stage_of).collect();
    let is_done = stages.last().is_some_and(|stage| stage.kind.ends_with("assemble") && stage.done == 1);
    let state = if is_done { BakeState::Done } else { BakeState::Running };
    (Duration::from_secs_f64(at_ms / 1e3), bake(state, stages, rays))
}

fn stage_of(text: &str) -> StageCount {
    let fields: Vec<&str> = text.split(' ').collect();
    let [kind, tasks, cost, leased, elapsed] = fields[..] else { panic!("not a stage: {text}") };
    let pair = |text: &str| text.split_once('/').map(|(done, all)| (number(done), number(all))).unwrap();
    let ((done, total), (cost_done, cost_total)) = (pair(tasks), pair(cost));
    let (leased, elapsed_ms, kind) = (number(leased), number(elapsed), kind.to_owned());
    StageCount { kind, total, done, reused: 0, leased, cost_total, cost_done, elapsed_ms }
}

fn number(text: &str) -> u64 {
    text.parse().unwrap()
}

fn bake(state: BakeState, stages: Vec<StageCount>, rays: f64) -> Bake {
    Bake {
        id: "b".into(),
        name: String::new(),
        kind: "prt".into(),
        scene: Digest::of(b""),
        settings: serde_json::Value::Null,
        priority: 0,
        needs: Default::default(),
        limits: Default::default(),
        verify_share: 0.0,
        state,
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
        attempts_failed: 0,
        attempts_lost: 0,
        alarms: 0,
        owner: None,
        evaluation: None,
    }
}

fn stage(kind: &str, done: u64, total: u64) -> StageCount {
    stage_of(&format!("{kind} {done}/{total} {}/{} 0 0", 10 * done, 10 * total))
}

#[test]
fn share_never_falls_and_is_whole_at_the_end_alone() {
    for (name, recording) in RECORDINGS {
        let told = told(recording, Duration::ZERO);
        let mut before = 0.0;
        for Told { at, is_over, snapshot } in &told {
            let share = snapshot.estimate.share;
            assert!(share >= before, "{name} fell from {before} to {share} at {at:?}");
            assert_eq!(share == 1.0, *is_over, "{name} shows {share} at {at:?}");
            assert!(*is_over || share <= 0.99, "{name} shows {share} at {at:?}");
            before = share;
        }
        assert!(told.last().is_some_and(|last| last.is_over), "{name} was recorded to its end");
    }
}

#[test]
fn no_time_is_told_before_the_plan_is_done() {
    for (name, recording) in RECORDINGS {
        let told = told(recording, Duration::ZERO);
        let told = told.iter().filter(|told| told.snapshot.estimate.left.is_some());
        let shares: Vec<f64> = told.map(|told| told.snapshot.estimate.share).collect();
        assert!(shares.iter().all(|share| *share > 0.1), "{name}: {shares:?}");
    }
}

#[test]
fn time_left_is_right_within_a_factor_once_half_of_the_work_is_done() {
    for (name, recording) in RECORDINGS {
        let told = told(recording, Duration::ZERO);
        let end = told.last().unwrap().at;
        for Told { at, snapshot, .. } in told.iter().filter(|told| told.snapshot.estimate.share >= 0.5) {
            let true_secs = (end - *at).as_secs_f64();
            let Some(left) = snapshot.estimate.left else { continue };
            // The hall's machine was taken by others half-way, which nobody could have told.
            let factor = if name == "hall" { 2.5 } else { 1.6 };
            // A few seconds more or less are nobody's harm.
            let (low, high) = (true_secs / factor - 4.0, true_secs * factor + 4.0);
            assert!(
                (low..=high).contains(&left.as_secs_f64()),
                "{name} tells {left:?} of {true_secs} at {at:?}"
            );
        }
    }
    let long = told(RECORDINGS[2].1, Duration::ZERO);
    assert!(long.iter().filter(|told| told.snapshot.estimate.left.is_some()).count() > 30);
}

#[test]
fn time_left_runs_down_with_the_clock_and_does_not_jump() {
    for (name, recording) in RECORDINGS {
        let told = told(recording, Duration::ZERO);
        for pair in told.windows(2) {
            let [before, after] = [0, 1].map(|which: usize| pair[which].snapshot.estimate.left);
            let (Some(before), Some(after)) = (before, after) else { continue };
            let gone = pair[1].at - pair[0].at;
            let expected = before.saturating_sub(gone).as_secs_f64().max(1.0);
            let jump = (after.as_secs_f64() - expected).abs();
            assert!(jump <= 2.0 + 0.1 * expected, "{name}: {before:?}, then {after:?} at {:?}", pair[1].at);
        }
    }
}

#[test]
fn who_comes_late_is_told_the_time_at_once() {
    let (from, recording) = (Duration::from_secs(60), RECORDINGS[2].1);
    let early = told(recording, Duration::ZERO);
    let late = told(recording, from);
    let left = |told: &[Told]| {
        let at = told.iter().find(|told| told.at >= from).unwrap();
        at.snapshot.estimate.left.map(|left| left.as_secs_f64())
    };
    let (early, late) = (left(&early).unwrap(), left(&late).unwrap());
    assert!((0.7..=1.4).contains(&(late / early)), "{late} against {early}");
}

#[test]
fn rate_stays_from_one_finished_task_to_the_next() {
    let told = told(RECORDINGS[2].1, Duration::ZERO);
    let rates: Vec<Option<f64>> = told.iter().map(|told| told.snapshot.rays_per_sec).collect();
    let first = rates.iter().position(Option::is_some).unwrap();
    assert!(rates[first..].iter().all(Option::is_some), "a rate that was told does not vanish: {rates:?}");
}

#[test]
fn paused_bake_tells_no_time_and_goes_on_as_before() {
    let start = Instant::now();
    let mut tracker = Tracker::new(start);
    let mut secs = 0;
    let mut observe = |state, done| {
        secs += 10;
        let stages = vec![stage("prt.plan", 1, 1), stage("prt.transport", done, 100)];
        tracker.observe(&bake(state, stages, 0.0), start + Duration::from_secs(secs))
    };
    for done in [0, 10, 20] {
        observe(BakeState::Running, done);
    }
    assert!(observe(BakeState::Running, 30).estimate.left.is_some());
    let paused = observe(BakeState::Paused, 30);
    assert_eq!((paused.stage.as_str(), paused.estimate.left), ("paused", None));
    observe(BakeState::Running, 30);
    let left = observe(BakeState::Running, 40).estimate.left.unwrap().as_secs();
    assert!((50..=90).contains(&left), "600 of cost at 8 to 10 a second: {left}");
}

#[test]
fn results_that_were_lost_do_not_turn_the_share_back() {
    let start = Instant::now();
    let mut tracker = Tracker::new(start);
    let mut share = |done| {
        let stages = vec![stage("prt.plan", 1, 1), stage("prt.transport", done, 100)];
        tracker.observe(&bake(BakeState::Running, stages, 0.0), start).estimate.share
    };
    let before = share(60);
    assert_eq!(share(40), before);
    assert!(share(80) > before);
}

#[test]
fn stage_that_is_worked_on_is_told_until_its_tasks_are_handed_in() {
    let start = Instant::now();
    let mut tracker = Tracker::new(start);
    let mut told = |stages: &[(&str, u64, u64, u64)]| {
        let stages = stages
            .iter()
            .map(|(kind, done, total, leased)| StageCount { leased: *leased, ..stage(kind, *done, *total) });
        tracker.observe(&bake(BakeState::Running, stages.collect(), 0.0), start).stage
    };
    assert_eq!(told(&[]), "waiting");
    assert_eq!(told(&[("scene.import", 0, 1, 0)]), "import");
    assert_eq!(told(&[("scene.draw", 0, 1, 1), ("scene.place", 0, 1, 0)]), "draw");
    assert_eq!(told(&[("scene.draw", 0, 1, 1), ("scene.place", 0, 9, 1)]), "draw");
    assert_eq!(told(&[("scene.draw", 1, 1, 0), ("scene.place", 0, 9, 1)]), "place");
    assert_eq!(told(&[("prt.plan", 0, 1, 0), ("prt.transport", 2, 9, 1)]), "transport");
    assert_eq!(told(&[("prt.transport", 3, 9, 0), ("prt.colour", 7, 9, 1)]), "transport");
    assert_eq!(told(&[("prt.transport", 9, 9, 0), ("prt.colour", 8, 9, 1)]), "colour");
}

#[test]
fn rays_per_second_forgets_what_was_long_ago() {
    let start = Instant::now();
    let mut tracker = Tracker::new(start);
    let mut rate = |secs, rays| {
        let bake = bake(BakeState::Running, vec![stage("prt.transport", 0, 9)], rays);
        tracker.observe(&bake, start + Duration::from_secs(secs)).rays_per_sec
    };
    for secs in 1..=100 {
        rate(secs, 9e6 * secs as f64);
    }
    for secs in 101..=130 {
        rate(secs, 900e6 + 1e6 * (secs - 100) as f64);
    }
    let now = rate(131, 931e6).unwrap();
    assert!((0.9e6..=1.1e6).contains(&now), "{now}");
}
