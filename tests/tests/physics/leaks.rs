//! Light does not pass through walls, and passes through gaps as much as it should.

use glam::Vec3;
use lightkiln_tests::harness::{Held, Lighting, LocalBake, RelitReceiver, bake, clusters, relit};
use lightkiln_tests::scenes;
use lightkiln_worker::rays::Tracer;
use lightkiln_worker::reference::luminance;

use super::setup::{
    assert_same_energy, careful, in_both_kinds, lamp_at, mean, small, spread, tracer, with_texels,
};

in_both_kinds!(
    sealed_box_in_full_sun_and_sky_is_exactly_dark_inside,
    dark_room_behind_a_wall_of_two_centimetres_stays_dark,
    dark_room_stays_dark_where_the_wall_cuts_texels_in_two,
    dark_room_behind_a_sheet_without_thickness_stays_dark,
    lamp_in_a_closet_lights_the_room_through_the_gap_of_the_door_alone,
);

fn sealed_box_in_full_sun_and_sky_is_exactly_dark_inside(kind: &'static str) {
    let scene = scenes::sealed_box(0.1);
    assert_is_dark_inside(&scene, &bake(scene.clone(), &small(kind, 3000)).unwrap());
}

/// Insides of small boxes have few receivers, which see nothing in common: they lie in clusters of one another and of the
/// lit outside, and no light of these comes to them. Patches alone: no probe is in so small a box.
#[test]
fn small_sealed_boxes_share_clusters_and_are_exactly_dark_inside() {
    let scene = scenes::small_sealed_boxes();
    let bake = bake(scene.clone(), &with_texels("prt", 0.0625, 128)).unwrap();
    assert_is_dark_inside(&scene, &bake);
    let clusters = clusters(&bake).unwrap();
    let receivers: usize = clusters.iter().map(|cluster| cluster.receivers.len()).sum();
    println!("{receivers} receivers in {} clusters", clusters.len());
    assert!(clusters.len() * 64 <= receivers, "{receivers} receivers in {} clusters", clusters.len());
    assert!(clusters.iter().all(|cluster| cluster.factors.rank > 0), "a cluster has no factors");
}

/// Insides are so narrow that light is read at the points that rays meet, and these are stored in steps of 1 mm: beside a
/// wall without thickness the nearest step may be outside.
#[test]
fn flat_sealed_boxes_of_sheets_are_exactly_dark_inside() {
    let scene = scenes::flat_sealed_boxes();
    let mut recipe = with_texels("prt", 0.125, 128);
    recipe.settings["near_hits"] = 16.into();
    let bake = bake(scene.clone(), &recipe).unwrap();
    let near: usize = clusters(&bake).unwrap().iter().map(|cluster| cluster.near.len()).sum();
    assert!(near > 1000, "{near} near hits");
    assert_is_dark_inside(&scene, &bake);
}

fn assert_is_dark_inside(scene: &[u8], bake: &LocalBake) {
    let rays = tracer(scene);
    let to_sun = Vec3::new(0.3, 0.8, 0.2).normalize();
    let direct = |position: Vec3, normal: Vec3| {
        let cosine = normal.dot(to_sun).max(0.0);
        let start = position + normal * 1e-4;
        [if rays.is_occluded(start, start + to_sun * 100.0) { 0.0 } else { 1000.0 * cosine }; 3]
    };
    let receivers = relit(bake, &Lighting { direct: &direct, sky: [[100.0; 3]; 2] }).unwrap();
    let (inside, outside): (Vec<_>, Vec<_>) = receivers.iter().partition(|r| is_enclosed(&rays, r));
    assert!(inside.len() > 100 && outside.len() > 100, "{} in, {} out", inside.len(), outside.len());
    assert!(mean(&outside) > 1.0, "the outside is dark: the test shows nothing");
    for receiver in inside {
        assert_eq!(receiver.indirect, [0.0; 3], "light inside at {}", receiver.position_m);
    }
}

/// No ray leaves the scene from there.
pub fn is_enclosed(rays: &Tracer, receiver: &RelitReceiver) -> bool {
    (0..256).all(|ray| {
        let direction = lightkiln_proto::harmonics::relight_direction(ray, 256);
        let up = if direction.dot(receiver.normal) < 0.0 { -direction } else { direction };
        rays.closest(receiver.position_m + receiver.normal * 1e-4, up, f32::INFINITY).is_some()
    })
}

/// A point light in the left room of two; panics when the right one gets more than 1e-4 of what the left one has, both
/// by receivers clear of the wall.
fn assert_right_room_is_dark(kind: &'static str, scene: Vec<u8>, thickness_m: f32, wall_x_m: f32) {
    let bake = bake(scene.clone(), &small(kind, 4000)).unwrap();
    let rays = tracer(&scene);
    let direct = |position: Vec3, normal: Vec3| {
        let lamp = Vec3::new(-2.0, 1.5, 0.3);
        let to_lamp = lamp - position;
        let cosine = normal.dot(to_lamp.normalize()).max(0.0);
        let hidden = rays.is_occluded(position + normal * 1e-4, lamp);
        [if hidden { 0.0 } else { 50.0 * cosine / to_lamp.length_squared() }; 3]
    };
    let receivers = relit(&bake, &Lighting { direct: &direct, sky: [[0.0; 3]; 2] }).unwrap();
    let clear = thickness_m * 0.5 + bake.manifest.layout().unwrap().texel_m;
    let left: Vec<_> = receivers.iter().filter(|r| r.position_m.x < wall_x_m - clear).collect();
    let right: Vec<_> = receivers.iter().filter(|r| r.position_m.x > wall_x_m + clear).collect();
    assert!(left.len() > 300 && right.len() > 300);
    let (lit, dark) = (mean(&left), mean(&right));
    println!("{kind}, wall at {wall_x_m}: {dark} against {lit}");
    assert!(lit > 0.1, "the lit room is dark: the test shows nothing");
    assert!(dark <= 1e-4 * lit, "wall at {wall_x_m}: {dark} against {lit}");
}

fn dark_room_behind_a_wall_of_two_centimetres_stays_dark(kind: &'static str) {
    assert_right_room_is_dark(kind, scenes::two_rooms(0.02), 0.02, 0.0);
}

fn dark_room_stays_dark_where_the_wall_cuts_texels_in_two(kind: &'static str) {
    for wall_x_m in [0.07, -0.07, 0.03] {
        let scene = scenes::two_rooms_with_wall_at(0.02, wall_x_m);
        assert_right_room_is_dark(kind, scene, 0.02, wall_x_m);
    }
}

/// Direct light is the mean over the points of a texel: of one that the wall cuts, over those of its receiver's room.
#[test]
fn dark_room_gets_nothing_by_points_of_texels_that_the_wall_cuts() {
    for wall_x_m in [0.07, -0.03] {
        let scene = scenes::two_rooms_with_wall_at(0.02, wall_x_m);
        let held = Held::new(scene, &small("prt", 4000)).unwrap();
        let lit = held.under(&lamp_at(Vec3::new(-2.0, 1.5, 0.3))).unwrap();
        let room = |side: f32| {
            let receivers = held.receivers(|r| (r.position_m.x - wall_x_m) * side > 0.02);
            assert!(receivers.len() > 300, "{}", receivers.len());
            receivers.iter().map(|&r| luminance(lit.baked(r))).sum::<f64>() / receivers.len() as f64
        };
        let (bright, dark) = (room(-1.0), room(1.0));
        assert!(bright > 0.1, "the lit room is dark: the test shows nothing");
        assert!(dark <= 1e-4 * bright, "wall at {wall_x_m}: {dark} against {bright}");
    }
}

fn dark_room_behind_a_sheet_without_thickness_stays_dark(kind: &'static str) {
    assert_right_room_is_dark(kind, scenes::two_rooms(0.0), 0.0, 0.0);
}

/// Parts of the sky are all that the rooms have in common. Probes above both would see into either, hence patches alone.
#[test]
fn dark_room_stays_dark_though_both_rooms_see_the_sky() {
    assert_right_room_is_dark("prt", scenes::two_rooms_under_the_sky(0.02), 0.02, 0.0);
}

/// How far the energy in the room may be from the reference. With sh, probes in front of the gap blur the lit strips that
/// they see in it, which have their whole light since receivers of cut texels stand in the middle of their side: 69 % too much
/// in the room were measured (32 % with receivers at texels' centres), and 2 % with patches.
fn room_tolerance(kind: &'static str) -> f64 {
    if kind == "prt" { 0.08 } else { 0.75 }
}

fn lamp_in_a_closet_lights_the_room_through_the_gap_of_the_door_alone(kind: &'static str) {
    let lamp = lamp_at(Vec3::new(-0.7, 1.4, 0.1));
    let settings = careful(kind, 0.125);
    let is_outside = |p: Vec3| p.x > 0.1;
    let is_inside = |p: Vec3| p.x < -0.1 && p.x > -1.19 && p.z.abs() < 0.79;

    let shut = Held::new(scenes::closet(0.0), &settings).unwrap();
    let lit = shut.under(&lamp).unwrap();
    let mean = |receivers: &[u32]| {
        assert!(receivers.len() > 150, "{} receivers", receivers.len());
        receivers.iter().map(|&r| luminance(lit.baked(r))).sum::<f64>() / receivers.len() as f64
    };
    let inside = mean(&shut.receivers(|r| is_inside(r.position_m)));
    let outside = mean(&shut.receivers(|r| is_outside(r.position_m)));
    println!("{kind}, shut: {outside} outside, {inside} inside");
    assert!(inside > 0.1, "the closet is dark: the test shows nothing");
    assert!(outside <= 1e-4 * inside, "the door is shut, and there is {outside} outside, {inside} inside");

    let ajar = Held::new(scenes::closet(0.2), &settings).unwrap();
    let lit = ajar.under(&lamp).unwrap();
    let inside = spread(&ajar.receivers(|r| is_inside(r.position_m)), 40);
    assert_same_energy(&format!("{kind}: closet"), &lit.compared(&inside, 0.05).unwrap(), 0.05);
    let outside = spread(&ajar.receivers(|r| is_outside(r.position_m)), 80);
    let outside = lit.compared(&outside, 0.05).unwrap();
    assert_same_energy(&format!("{kind}: room"), &outside, room_tolerance(kind));
}
