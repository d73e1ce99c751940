//! A floor of many coplanar meshes is lit as the same floor in one piece: no seam.

use glam::Vec3;
use lightkiln_tests::harness::Held;
use lightkiln_tests::scenes;
use lightkiln_worker::reference::luminance;

use super::setup::{assert_same_energy, in_both_kinds, lamp_at, spread, with_texels};

in_both_kinds!(tiles_of_one_plane_show_no_seam);

const TEXEL_M: f32 = 0.125;
const TILES: u32 = 3;

/// Distance from the nearest joint.
fn from_joint_m(position_m: Vec3) -> f32 {
    let joint_m = |index: u32| 4.0 * index as f32 / TILES as f32 - 2.0;
    let distance =
        |joint: u32| (position_m.x - joint_m(joint)).abs().min((position_m.z - joint_m(joint)).abs());
    (1..TILES).map(distance).fold(f32::INFINITY, f32::min)
}

/// Place and luminance of E_ind of a floor's receivers clear of the walls. Asserts that the floor is lit as in the reference,
/// at joints and apart from them.
fn floor(kind: &'static str, tiles: u32) -> Vec<(Vec3, f64)> {
    let held = Held::new(scenes::tiled_floor(tiles, false), &with_texels(kind, TEXEL_M, 256)).unwrap();
    let lit = held.under(&lamp_at(Vec3::new(-0.8, 1.6, 0.6))).unwrap();
    let clear = |p: Vec3| p.y.abs() < 0.01 && p.x.abs().max(p.z.abs()) < 1.7;
    let receivers = held.receivers(|r| r.normal.y > 0.9 && clear(r.position_m));
    let position_m = |receiver: u32| held.world.lightmap.receivers[receiver as usize].position_m;
    let (at, apart): (Vec<u32>, Vec<u32>) =
        receivers.iter().partition(|&&receiver| from_joint_m(position_m(receiver)) < 0.5 * TEXEL_M);
    for (place, receivers) in [("at joints", at), ("apart from joints", apart)] {
        let pairs = lit.compared(&spread(&receivers, 60), 0.05).unwrap();
        assert_same_energy(&format!("{kind}, {tiles} × {tiles} tiles, {place}"), &pairs, 0.03);
    }
    receivers.iter().map(|&receiver| (position_m(receiver), luminance(lit.baked(receiver)))).collect()
}

/// Of differences: their mean, root mean square, and how many there are.
fn figures(all: &[f64]) -> [f64; 3] {
    let count = all.len() as f64;
    [all.iter().sum::<f64>() / count, (all.iter().map(|d| d * d).sum::<f64>() / count).sqrt(), count]
}

fn tiles_of_one_plane_show_no_seam(kind: &'static str) {
    let (whole, tiled) = (floor(kind, 1), floor(kind, TILES));
    assert!(whole.len() > 400 && tiled.len() >= whole.len(), "{} and {}", whole.len(), tiled.len());
    let mean = whole.iter().map(|(_, light)| light).sum::<f64>() / whole.len() as f64;
    assert!(mean > 0.1, "the floor is dark: the test shows nothing");
    // Texels lie on one lattice in both, but for those that a joint cuts: these stand in the middle of what is left.
    let (mut at, mut apart) = (Vec::new(), Vec::new());
    for (position_m, light) in &tiled {
        let near = whole.iter().filter(|(p, _)| p.distance(*position_m) < 0.75 * TEXEL_M);
        let nearest = near.min_by(|a, b| a.0.distance(*position_m).total_cmp(&b.0.distance(*position_m)));
        let (_, same) = nearest.unwrap();
        let list = if from_joint_m(*position_m) < 0.6 * TEXEL_M { &mut at } else { &mut apart };
        list.push((light - same) / mean);
    }
    let ([bias, step, count], [bias_apart, step_apart, _]) = (figures(&at), figures(&apart));
    println!(
        "{kind}: at {count} joints {bias:.4} and rms {step:.4}, apart {bias_apart:.4} and {step_apart:.4}"
    );
    assert!(count > 60.0);
    assert!((bias - bias_apart).abs() < 0.005, "joints are off by {bias}, the rest by {bias_apart}");
    assert!(step < 1.5 * step_apart + 0.005, "noise of {step} at joints, {step_apart} elsewhere");
}
