//! What makes a bake right (METHOD.md §4), on scenes of our own at small size.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking, helpers of tests too")]

use std::f32::consts::PI;

use glam::Vec3;
use lightkiln_tests::harness::{Lighting, LocalBake, RelitReceiver, bake, relit};
use lightkiln_tests::scenes;
use lightkiln_worker::rays::Tracer;
use lightkiln_worker::scene::{Bundle, Limits, import};
use serde_json::json;

fn luminance([r, g, b]: [f32; 3]) -> f32 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

/// Settings for about so many receivers in a scene of few triangles.
fn small(receivers: u32) -> serde_json::Value {
    json!({ "preset": "draft", "receivers_target": receivers * 5, "transport_rays": 128 })
}

/// Rays against the scene's own triangles.
fn tracer(bundle: &[u8]) -> Tracer {
    let limits = Limits::default();
    let bundle = Bundle::from_bytes(bundle.to_vec(), &limits).unwrap();
    let scene = import(&bundle, &limits).unwrap().scene;
    let corners: Vec<_> = scene
        .instances
        .iter()
        .flat_map(|i| i.triangles.iter().map(|t| t.map(|v| i.positions_m[v as usize])))
        .collect();
    Tracer::new(&corners, None)
}

fn mean(receivers: &[&RelitReceiver]) -> f32 {
    receivers.iter().map(|receiver| luminance(receiver.indirect)).sum::<f32>() / receivers.len() as f32
}

#[test]
fn white_furnace_converges_to_emission_over_one_minus_albedo() {
    for albedo in [0.2, 0.5, 0.8] {
        let bake = bake(scenes::furnace(albedo, 1.0, 4.0), &small(1500)).unwrap();
        let receivers = relit(&bake, &Lighting::NONE).unwrap();
        assert!(receivers.len() > 500);
        // L = e + ρ/π·E = e/(1 − ρ), hence E = π·e/(1 − ρ).
        let wanted = PI / (1.0 - albedo);
        let all: Vec<_> = receivers.iter().collect();
        let found = mean(&all);
        assert!((found / wanted - 1.0).abs() < 0.01, "albedo {albedo}: mean {found}, wanted {wanted}");
        let worst = all.iter().map(|r| (luminance(r.indirect) / wanted - 1.0).abs()).fold(0.0, f32::max);
        assert!(worst < 0.06, "albedo {albedo}: a receiver is off by {worst}");
    }
}

#[test]
fn sealed_box_in_full_sun_and_sky_is_exactly_dark_inside() {
    let scene = scenes::sealed_box(0.1);
    let bake = bake(scene.clone(), &small(3000)).unwrap();
    let rays = tracer(&scene);
    let to_sun = Vec3::new(0.3, 0.8, 0.2).normalize();
    let direct = |position: Vec3, normal: Vec3| {
        let cosine = normal.dot(to_sun).max(0.0);
        let start = position + normal * 1e-4;
        [if rays.is_occluded(start, start + to_sun * 100.0) { 0.0 } else { 1000.0 * cosine }; 3]
    };
    let receivers = relit(&bake, &Lighting { direct: &direct, sky: [[100.0; 3]; 2] }).unwrap();
    let (inside, outside): (Vec<_>, Vec<_>) = receivers.iter().partition(|r| is_enclosed(&rays, r));
    assert!(inside.len() > 100 && outside.len() > 100, "{} in, {} out", inside.len(), outside.len());
    assert!(mean(&outside) > 1.0, "the outside is dark: the test shows nothing");
    for receiver in inside {
        assert_eq!(receiver.indirect, [0.0; 3], "light inside at {}", receiver.position_m);
    }
}

/// No ray leaves the scene from there.
fn is_enclosed(rays: &Tracer, receiver: &RelitReceiver) -> bool {
    (0..256).all(|ray| {
        let direction = lightkiln_proto::sh::relight_direction(ray, 256);
        let up = if direction.dot(receiver.normal) < 0.0 { -direction } else { direction };
        rays.closest(receiver.position_m + receiver.normal * 1e-4, up, f32::INFINITY).is_some()
    })
}

/// A point light in the left room of two; gives the mean of both rooms, of receivers clear of the wall.
fn two_rooms(thickness_m: f32, wall_x_m: f32) -> (f32, f32) {
    let scene = scenes::two_rooms_with_wall_at(thickness_m, wall_x_m);
    let bake = bake(scene.clone(), &small(4000)).unwrap();
    let rays = tracer(&scene);
    let light = bake.manifest.probes.len(); // a bake without probes would show nothing
    assert!(light > 0);
    let direct = |position: Vec3, normal: Vec3| {
        let lamp = Vec3::new(-2.0, 1.5, 0.3);
        let to_lamp = lamp - position;
        let cosine = normal.dot(to_lamp.normalize()).max(0.0);
        let hidden = rays.is_occluded(position + normal * 1e-4, lamp);
        [if hidden { 0.0 } else { 50.0 * cosine / to_lamp.length_squared() }; 3]
    };
    let receivers = relit(&bake, &Lighting { direct: &direct, sky: [[0.0; 3]; 2] }).unwrap();
    let clear = thickness_m * 0.5 + bake.manifest.texel_m;
    let left: Vec<_> = receivers.iter().filter(|r| r.position_m.x < wall_x_m - clear).collect();
    let right: Vec<_> = receivers.iter().filter(|r| r.position_m.x > wall_x_m + clear).collect();
    assert!(left.len() > 300 && right.len() > 300);
    (mean(&left), mean(&right))
}

#[test]
fn dark_room_behind_a_wall_of_two_centimetres_stays_dark() {
    let (lit, dark) = two_rooms(0.02, 0.0);
    assert!(lit > 0.1, "the lit room is dark: the test shows nothing");
    assert!(dark <= 1e-4 * lit, "{dark} against {lit}");
}

#[test]
fn dark_room_stays_dark_where_the_wall_cuts_texels_in_two() {
    for wall_x_m in [0.07, -0.07, 0.03] {
        let (lit, dark) = two_rooms(0.02, wall_x_m);
        assert!(lit > 0.1, "the lit room is dark: the test shows nothing");
        assert!(dark <= 1e-4 * lit, "wall at {wall_x_m}: {dark} against {lit}");
    }
}

#[test]
fn dark_room_behind_a_sheet_without_thickness_stays_dark() {
    let (lit, dark) = two_rooms(0.0, 0.0);
    assert!(lit > 0.1, "the lit room is dark: the test shows nothing");
    assert!(dark <= 1e-4 * lit, "{dark} against {lit}");
}

#[test]
fn bake_has_the_same_bytes_on_one_and_on_four_threads() {
    let on = |threads: usize| -> LocalBake {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| bake(scenes::two_rooms(0.02), &small(1000)).unwrap())
    };
    let (one, four) = (on(1), on(4));
    assert_eq!(one.manifest_bytes, four.manifest_bytes);
    assert!(one.manifest.clusters.len() > 2);
}
