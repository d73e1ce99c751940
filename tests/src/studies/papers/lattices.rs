//! \[Luo2022\]: probes on a dense lattice, walls, costs, and seams of octahedral maps.

use std::time::Instant;

use anyhow::Result;
use glam::{Vec2, Vec3};
use lightkiln_client::export::{TILE_SIDE, direction_in_tile, texel_behind_border};
use lightkiln_proto::harmonics::{ShBasis, relight_direction};
use lightkiln_proto::kinds::captured::tasks;
use lightkiln_proto::kinds::field::PROBE_ROWS;
use lightkiln_worker::geometry::Site;

use super::scene::{CapturedScene, Reading, error, mean};
use super::{Table, percent};
use crate::scenes;

/// Points on either side of a wall.
const POINTS: usize = 200;

/// Rooms under one roof, of which the left one has a lamp.
fn rooms(bundle: &[u8]) -> Result<CapturedScene> {
    CapturedScene::new(bundle, &[("field_spacing_m", 1.5), ("probe_rays", 1024.0)])
}

/// Figures 5.1 to 5.4: leaks and errors behind a whole wall and behind one with an opening.
pub fn walls() -> Result<Table> {
    let mut table = Table::new(
        "[Luo2022] figures 5.1 to 5.4: walls",
        "Probes 1.5 m apart on a lattice, moved out of walls (the paper has 16). *Beyond* is the light of 200 points beyond the wall, 2 cm and more off surfaces, over that of 200 on the lamp's side; \
         error that of all against paths. The paper shows pictures alone.",
        &["scene", "probes", "read by", "beyond", "error"],
    );
    let half = 0.01;
    let whole = (scenes::two_rooms(2.0 * half), "rooms behind a wall of 2 cm");
    let part = (scenes::u_corridor(), "corridor around the end of a wall");
    for (bundle, name) in [whole, part] {
        let scene = rooms(&bundle)?;
        let [low_m, high_m] = scene.geometry.near_bounds_m();
        let middle = 0.5 * (low_m.x + high_m.x);
        let lit_m = scene.free_points([low_m, Vec3::new(middle - half, high_m.y, high_m.z)], POINTS)?;
        let dark_m = scene.free_points([Vec3::new(middle + half, low_m.y, low_m.z), high_m], POINTS)?;
        let sites: Vec<Site> = lit_m
            .iter()
            .chain(&dark_m)
            .zip(0..)
            .map(|(&position_m, index)| {
                let normal = relight_direction(index % 256, 256);
                Site { position_m, normal, face_normal: normal }
            })
            .collect();
        let traced = scene.traced(&sites)?;
        let mut add = |how: &str, found: &[f64]| {
            let [lit, dark] = [&found[..POINTS], &found[POINTS..]].map(|of| of.iter().sum::<f64>());
            let probes = scene.field.len().to_string();
            table.row([
                name.to_owned(),
                probes,
                how.to_owned(),
                percent(dark / lit),
                percent(error(found, &traced)),
            ]);
        };
        let all = |light: &dyn Fn(Vec3, Vec3) -> f64| -> Vec<f64> {
            sites.iter().map(|site| light(site.position_m, site.normal)).collect()
        };
        for (how, reading) in [
            ("trilinear weights alone (5.1, 5.3)", Reading::Valid),
            ("moments (5.2, 5.4)", Reading::Chebyshev),
        ] {
            add(how, &all(&|point_m, normal| scene.read(reading, point_m, normal)));
        }
        add("depth maps", &all(&|point_m, normal| scene.light(point_m, normal)));
        add("paths", &traced);
    }
    Ok(table)
}

/// Figure 5.5: light on the outer faces of a box whose probes are all inside.
pub fn outer_faces() -> Result<Table> {
    let mut table = Table::new(
        "[Luo2022] figure 5.5: outer faces",
        "Light within 20 cm outside of the rooms' walls over that inside. The paper's is visible, as all of its probes are inside. By depth maps what lies behind all of them is lit to 0.06 h, 9 cm here, as corners are that maps round off.",
        &["read by", "light outside"],
    );
    let scene = rooms(&scenes::two_rooms(0.02))?;
    let [low_m, high_m] = scene.geometry.near_bounds_m();
    let inside_m = scene.free_points([low_m, Vec3::new(-0.01, high_m.y, high_m.z)], POINTS)?;
    let outside_m: Vec<Vec3> = inside_m
        .iter()
        .zip(0u16..)
        .map(|(inside_m, index)| inside_m.with_x(low_m.x - 0.02 - 0.18 * f32::from(index % 10) / 9.0))
        .collect();
    let mut add = |how: &str, light: &dyn Fn(Vec3, Vec3) -> f64| {
        table.row([how.to_owned(), percent(mean(&outside_m, light) / mean(&inside_m, light))]);
    };
    add("trilinear weights alone", &|point_m, normal| scene.read(Reading::Valid, point_m, normal));
    add("moments", &|point_m, normal| scene.read(Reading::Chebyshev, point_m, normal));
    add("depth maps", &|point_m, normal| scene.light(point_m, normal));
    Ok(table)
}

/// Table 6.1 and figures 5.6 to 5.9: bytes and time.
pub fn costs() -> Result<Table> {
    let mut table = Table::new(
        "[Luo2022] table 6.1, figures 5.6 to 5.9: costs",
        "The paper has 149.25 KB a probe without visibility, 576 KB with, and 1.1 ms a frame for either on its adapter. Ours are stored bytes, and \
         the time to read light at points on one thread, each of its own place and normal.",
        &["scene", "probes", "bytes a probe", "seconds of gathering a probe", "million points a second"],
    );
    for (name, bundle, spacing_m) in [("Cornell", scenes::cornell(), 0.75), ("atrium", scenes::atrium(), 2.0)]
    {
        let scene = CapturedScene::new(&bundle, &[("field_spacing_m", spacing_m)])?;
        let [low_m, high_m] = scene.geometry.near_bounds_m();
        let points_m = scene.free_points([low_m, high_m], 1000)?;
        let started = Instant::now();
        let rounds = 20;
        let mut sum = 0.0;
        for round in 0..rounds {
            for (&point_m, index) in points_m.iter().zip(round..) {
                sum += scene.light(point_m, relight_direction(index % 256, 256));
            }
        }
        let secs = started.elapsed().as_secs_f64();
        anyhow::ensure!(sum > 0.0, "{name} is dark");
        let probes = scene.field.len() as f64;
        let million = f64::from(rounds) * points_m.len() as f64 / secs / 1e6;
        table.row([
            name.to_owned(),
            format!("{probes}"),
            format!("{:.0}", scene.bake.manifest.bytes_light() as f64 / probes),
            format!("{:.4}", scene.seconds(tasks::GATHER.name) / probes),
            format!("{million:.2}"),
        ]);
    }
    Ok(table)
}

/// Figures 4.7 and 4.8: bilinear reads across the edges of octahedral tiles.
pub fn seams() -> Result<Table> {
    let mut table = Table::new(
        "[Luo2022] figures 4.7 and 4.8: seams of tiles",
        "Irradiance of a probe in tiles of `kiln export --probes ddgi`, read bilinearly on either side of 10⁵ points of the edges of the octahedron's square; \
         largest difference over the mean.",
        &["border", "largest difference"],
    );
    let scene = CapturedScene::new(&scenes::cornell(), &[("field_spacing_m", 1.5)])?;
    let basis = ShBasis::new(2);
    let rows = &scene.rows[..PROBE_ROWS];
    let light = |direction: Vec3| -> f32 {
        let mut harmonics = [0.0; PROBE_ROWS];
        basis.evaluate(direction, &mut harmonics);
        rows.iter().zip(harmonics).map(|(row, harmonic)| row.y * harmonic).sum()
    };
    let inside = TILE_SIDE as i32 - 2;
    let middle = |at: i32| (2 * at + 1) as f32 / inside as f32 - 1.0;
    let texel = |[x, y]: [i32; 2]| light(direction_in_tile(Vec2::new(middle(x), middle(y))));
    let padded = |at: [i32; 2]| {
        let source = texel_behind_border(TILE_SIDE, at.map(|at| (at + 1) as usize));
        texel(source.map(|at| at as i32))
    };
    let clamped = |at: [i32; 2]| texel(at.map(|at| at.clamp(0, inside - 1)));
    let bilinear = |square: Vec2, at: &dyn Fn([i32; 2]) -> f32| {
        let place = (square + 1.0) * 0.5 * inside as f32 - 0.5;
        let (corner, share) = (place.floor().as_ivec2(), place.fract_gl());
        let row = |y: i32| {
            let [a, b] = [0, 1].map(|x| at([corner.x + x, corner.y + y]));
            a + (b - a) * share.x
        };
        row(0) + (row(1) - row(0)) * share.y
    };
    let count = 100_000;
    let mean = (0..256).map(|at| light(relight_direction(at, 256)).abs()).sum::<f32>() / 256.0;
    let borders = [("of the other side, as written", true), ("none: reads stop at the edge", false)];
    for (name, is_padded) in borders {
        let read = |at: [i32; 2]| if is_padded { padded(at) } else { clamped(at) };
        let jump = |at: u32| {
            // A point of an edge of the square, and the one that it is folded onto.
            let along = 2.0 * (at / 4) as f32 / (count / 4) as f32 - 1.0;
            let pair = [Vec2::new(1.0, along), Vec2::new(1.0, -along)];
            let pair = if at & 1 == 0 { pair } else { pair.map(|on| -on) };
            let [a, b] = if at & 2 == 0 { pair } else { pair.map(|on| Vec2::new(on.y, on.x)) };
            (bilinear(a, &read) - bilinear(b, &read)).abs()
        };
        let worst = (0..count).map(jump).fold(0.0, f32::max);
        table.row([name.to_owned(), percent(f64::from(worst / mean))]);
    }
    Ok(table)
}
