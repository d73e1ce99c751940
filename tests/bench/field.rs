//! Light at points in free space on one thread: points a second, and bytes of a probe.

use std::time::{Duration, Instant};

use glam::Vec3;
use lightkiln_proto::kinds::field::{FIELD, PROBE_ROWS};
use lightkiln_proto::kinds::{cloud, grid};
use lightkiln_tests::harness::{Held, Recipe};
use lightkiln_tests::scenes;
use lightkiln_worker::factors::Threads;
use lightkiln_worker::rays::sampling::{Sequence, seed_of};
use lightkiln_worker::reference::Lighting;
use serde_json::json;

use crate::report::{quantile, row};

/// Points that are timed together, and how often.
const POINTS: usize = 1 << 17;
const ROUNDS: usize = 5;

/// Measures fields of both kinds in a box.
pub fn measure() {
    for kind in [grid::NAME, cloud::NAME] {
        let settings = json!({ "preset": "draft", "receivers_target": 20_000, "field_probes": 500 });
        let held = Held::new(scenes::cornell(), &Recipe { kind, settings }).unwrap();
        let table = held.decoded.field(&held.bake).unwrap();
        let lit = held.under(&Lighting { emitter_scale: 1.0, ..Lighting::default() }).unwrap();
        let light = lit.light();
        let start = Instant::now();
        let rows = table.relit(&Threads, &light.settled.lambda, &light.emitter_scale);
        let relit = start.elapsed();
        let [low_m, high_m] = held.world.geometry.near_bounds_m();
        let mut numbers = Sequence::new(seed_of(&[90]));
        let mut point = || low_m + (high_m - low_m) * Vec3::from([(); 3].map(|()| numbers.next_f32()));
        let points: Vec<Vec3> = (0..POINTS).map(|_| point()).collect();
        let mut sum = Vec3::ZERO;
        let mut times: Vec<Duration> = (0..ROUNDS)
            .map(|_| {
                let start = Instant::now();
                sum += points.iter().map(|&point_m| table.irradiance(&rows, point_m, Vec3::Y)).sum::<Vec3>();
                start.elapsed()
            })
            .collect();
        assert!(sum.is_finite() && sum.max_element() > 0.0, "the box is dark");
        let best = quantile(&mut times, 0.0).as_secs_f64();
        let probes = rows.len() / PROBE_ROWS;
        let bytes: u64 = held.bake.manifest.chunks(FIELD).iter().map(|chunk| chunk.bytes).sum();
        let place = format!("kind {kind}, {probes} probes, {} bytes each", bytes / probes as u64);
        row(
            "points in free space, one thread",
            &place,
            &format!("{:.2} million a second", POINTS as f64 / best / 1e6),
        );
        row("light at probes anew, all threads", &place, &format!("{:.2} ms", relit.as_secs_f64() * 1000.0));
    }
}
