//! Walks through voxels meet what rays meet: walls stop them, closed rooms keep them, and they bring the light of surfaces.

use std::f32::consts::PI;

use glam::{Quat, Vec3};
use lightkiln_proto::voxels::{Bundle, IRRADIANCE_WALKS, Start, VoxelTable, WalkLight, irradiance, walk};
use lightkiln_tests::harness::{Bakery, Held, Lighting, Recipe, bake, relit};
use lightkiln_tests::scenes::{self, Flat, flat};
use lightkiln_worker::geometry::Site;
use lightkiln_worker::rays::sampling::{R2, uniform_sphere};
use lightkiln_worker::reference::{self, luminance};
use lightkiln_worker::task::Progress;

use super::setup::{lamp_at, small, with_texels};

/// A bake with voxels.
fn with_voxels(receivers: u32) -> Recipe {
    small("prt", receivers).with("voxels", "on")
}

/// A bake of voxels alone.
fn alone(receivers: u32) -> Recipe {
    let settings = serde_json::json!({ "preset": "draft", "receivers_target": 5 * receivers });
    Recipe { kind: "voxels", settings }
}

/// E of 64 walks from a receiver, by lights that the bake is lit by.
fn walked(held: &Held, lighting: &reference::Lighting, receivers: &[u32]) -> Vec<Vec3> {
    let lit = held.under(lighting).unwrap();
    let (table, patches) = held.decoded.voxels(&held.bake).unwrap();
    let radiance = lightkiln_worker::emitters::radiance_of_emitters(&held.world.geometry.scene);
    let emitter = |emitter: u16| Vec3::from(radiance[usize::from(emitter)]) * lighting.emitter_scale;
    let light = WalkLight::new(&table, patches, &lit.light().settled.lambda, emitter);
    let of = |&receiver: &u32| {
        let Site { position_m, normal, face_normal } =
            held.world.lightmap.receivers[receiver as usize].site();
        let (start, bundle) = (Start::on(position_m, face_normal), Bundle::new(IRRADIANCE_WALKS, receiver));
        irradiance(&table, &start, normal, &bundle, |seen| light.radiance(seen))
    };
    receivers.iter().map(of).collect()
}

fn lum(light: Vec3) -> f64 {
    luminance(light.as_dvec3())
}

/// An odd angle, so that no wall lies along the lattice.
fn odd_turn() -> Quat {
    Quat::from_axis_angle(Vec3::new(0.3, -0.7, 0.64).normalize(), 0.87)
}

/// With a lamp on one side of walls of a turned scene: light of walks on the other, of its mean on the lamp's.
fn leaked(
    name: &str,
    (scene, turn): (&[u8], Quat),
    lamp_m: Vec3,
    is_dark: impl Fn(Vec3) -> bool,
) -> Vec<f64> {
    let held = Held::new(scenes::turned(scene, turn), &with_voxels(4000)).unwrap();
    let there = |dark: bool| held.receivers(|receiver| is_dark(turn.inverse() * receiver.position_m) == dark);
    let [lit, dark] = [false, true].map(|dark| {
        let found = walked(&held, &lamp_at(turn * lamp_m), &there(dark));
        assert!(found.len() > 200, "{name}: {}", found.len());
        found
    });
    let mean = lit.iter().map(|light| lum(*light)).sum::<f64>() / lit.len() as f64;
    println!("{name}: {mean:.3} where the lamp is, {} dark receivers", dark.len());
    assert!(mean > 0.002, "{name}: all is dark: the test shows nothing");
    dark.iter().map(|light| lum(*light) / mean).collect()
}

fn assert_is_dark(name: &str, of: (&[u8], Quat), lamp_m: Vec3, is_dark: impl Fn(Vec3) -> bool) {
    let found = leaked(name, of, lamp_m, is_dark);
    assert!(found.iter().all(|light| *light == 0.0), "{name}: light comes through the wall");
}

/// Where the lamp of two rooms is, and the other one.
const LAMP_M: Vec3 = Vec3::new(-2.0, 1.5, 0.3);

fn is_right(at_m: Vec3) -> bool {
    at_m.x > 0.02
}

#[test]
fn walks_bring_no_light_through_a_wall_or_a_sheet() {
    let straight = Quat::IDENTITY;
    assert_is_dark("2 cm", (&scenes::two_rooms(0.02), straight), LAMP_M, is_right);
    for wall_x_m in [0.07, -0.013] {
        let scene = scenes::two_rooms_with_wall_at(0.02, wall_x_m);
        assert_is_dark("2 cm in texels", (&scene, straight), LAMP_M, |at_m| at_m.x > wall_x_m + 0.011);
    }
    assert_is_dark("a sheet", (&scenes::two_rooms(0.0), straight), LAMP_M, is_right);
}

/// A sub-voxel that a thin wall parts has the patch of one side of what runs through under it: walks from the other may meet that there.
#[test]
fn walks_bring_next_to_no_light_through_thin_walls_that_are_turned() {
    for (name, thickness_m, wall_x_m) in
        [("a sheet", 0.0, 0.0), ("2 cm", 0.02, 0.0), ("2 cm", 0.02, 0.07), ("2 cm", 0.02, -0.013)]
    {
        let scene = scenes::two_rooms_with_wall_at(thickness_m, wall_x_m);
        let is_right = |at_m: Vec3| at_m.x > wall_x_m + 0.02;
        let found = leaked(name, (&scene, odd_turn()), LAMP_M, is_right);
        let (count, sum) = (found.iter().filter(|light| **light > 0.0).count(), found.iter().sum::<f64>());
        println!("{count} of {} receivers, {:.6} in the mean", found.len(), sum / found.len() as f64);
        assert!(500 * count <= found.len() && sum / (found.len() as f64) < 1e-4, "{name}");
    }
}

#[test]
fn walks_bring_no_light_into_a_sealed_box() {
    let inside = |at_m: Vec3| (at_m - Vec3::Y * 2.25).abs().max_element() < 1.95;
    let scene = scenes::sealed_box(0.1);
    for turn in [Quat::IDENTITY, odd_turn()] {
        assert_is_dark("a sealed box", (&scene, turn), Vec3::new(3.0, 5.0, 4.0), inside);
    }
}

/// Random walks from inside a closed scene.
fn escaped(table: &VoxelTable, inside: impl Fn(u32) -> Vec3, walks: u32) -> usize {
    let points = R2::new(3);
    let is_out = |index: &u32| {
        let [u, v] = points.point(*index);
        let direction = uniform_sphere(u, v);
        let tangent = [0.0, 0.05, 0.5, 1.0][*index as usize % 4];
        walk(table, &Start::free(inside(*index)), direction, tangent).is_none()
    };
    (0..walks).filter(is_out).count()
}

#[test]
fn no_walk_leaves_a_closed_room() {
    for (name, scene, half) in [
        ("furnace", scenes::furnace(0.5, 1.0, 4.0), Vec3::splat(1.9)),
        ("two rooms", scenes::two_rooms(0.02), Vec3::new(3.9, 1.2, 1.9)),
    ] {
        let held = Held::new(scene, &with_voxels(1500)).unwrap();
        let (table, _) = held.decoded.voxels(&held.bake).unwrap();
        let [low, high] = held.bake.manifest.bounds_m.map(Vec3::from);
        let middle = low.lerp(high, 0.5);
        let points = R2::new(9);
        let inside = |index: u32| {
            let [x, y] = points.point(index);
            middle
                + half.min(0.45 * (high - low)) * (2.0 * Vec3::new(x, y, (7.0 * x + 3.0 * y).fract()) - 1.0)
        };
        let found = escaped(&table, inside, 40_000);
        assert_eq!(found, 0, "{name}: walks reach the sky");
    }
}

#[test]
fn walks_in_a_furnace_bring_emission_over_one_minus_albedo() {
    for albedo in [0.2, 0.8] {
        let held = Held::new(scenes::furnace(albedo, 1.0, 4.0), &with_voxels(1500)).unwrap();
        let all = held.receivers(|_| true);
        let found = walked(&held, &reference::Lighting { emitter_scale: 1.0, ..Default::default() }, &all);
        let wanted = f64::from(PI / (1.0 - albedo));
        let mean = found.iter().map(|light| lum(*light)).sum::<f64>() / found.len() as f64 / wanted;
        println!("albedo {albedo}: {mean:.4} of what is wanted");
        assert!((mean - 1.0).abs() < 0.01, "albedo {albedo}: {mean}");
    }
}

#[test]
fn chair_that_is_moved_leaves_voxels_elsewhere_alone_and_bytes_are_those_of_a_whole_bake() {
    let recipe = with_texels("prt", 0.125, 16).with("voxels", "on").with("voxel_texels", 1);
    let progress = Progress::new();
    let mut bakery = Bakery::new(&recipe, &progress);
    let mut of = Flat::default();
    bakery.bake(flat(&of)).unwrap();
    of.things[0].at_m += Vec3::new(0.3, 0.0, -0.1);
    let moved = bakery.bake(flat(&of)).unwrap();
    let regions =
        moved.notes.iter().filter(|(label, _)| label.starts_with("voxels ") && label != "voxels top");
    let (kept, again): (Vec<_>, Vec<_>) = regions.partition(|(_, note)| note.starts_with("as before"));
    println!("{} regions of {} ran again", again.len(), kept.len() + again.len());
    assert!(!again.is_empty() && 2 * again.len() < kept.len(), "{again:#?}");
    let whole = bake(flat(&of), &recipe).unwrap();
    assert!(whole.manifest_bytes == moved.manifest_bytes, "other bytes than those of a whole bake");
}

#[test]
fn voxels_alone_have_the_light_of_a_furnace_and_the_same_bytes_on_any_number_of_threads() {
    let recipe = alone(1500).with("cluster_receivers", 64);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| bake(scenes::furnace(0.5, 1.0, 4.0), &recipe).unwrap())
    };
    let (one, four) = (on(1), on(4));
    assert!(one.manifest_bytes == four.manifest_bytes, "other bytes");
    assert!(one.manifest.clusters.len() > 2 && one.manifest.clusters.iter().all(|row| row.rank == 0));
    let receivers = relit(&one, &Lighting::NONE).unwrap();
    let wanted = 2.0 * PI;
    let all: Vec<f64> =
        receivers.iter().map(|receiver| lum(Vec3::from(receiver.indirect)) / f64::from(wanted)).collect();
    let mean = all.iter().sum::<f64>() / all.len() as f64;
    let worst = all.iter().map(|light| (light - 1.0).abs()).fold(0.0, f64::max);
    println!("mean {mean:.4} of what is wanted, worst {worst:.4}");
    assert!(all.len() > 500 && (mean - 1.0).abs() < 0.01 && worst < 0.06, "mean {mean}, worst {worst}");
}

#[test]
fn voxels_alone_are_dark_behind_a_wall() {
    let held = Held::new(scenes::two_rooms(0.02), &alone(4000)).unwrap();
    let lit = held.under(&lamp_at(LAMP_M)).unwrap();
    let of = |is_dark: bool| -> Vec<f64> {
        let there = held.receivers(|receiver| is_right(receiver.position_m) == is_dark);
        there.iter().map(|receiver| luminance(lit.baked(*receiver))).collect()
    };
    let (dark, bright) = (of(true), of(false));
    assert!(dark.len() > 500 && bright.len() > 500, "{} and {}", dark.len(), bright.len());
    assert!(dark.iter().all(|light| *light == 0.0));
    // Outer sides of the walls are dark.
    assert!(bright.iter().filter(|light| **light > 0.0).count() > 500);
}
