//! Glass: energy, closed forms behind panes, and the same light by every way to find it.

use glam::Vec3;
use lightkiln_proto::scene::{LightKind, SceneLight};

use super::rooms::{site, sites_on_walls};
use super::*;

const SIZE: Vec3 = Vec3::new(2.0, 2.0, 3.0);

fn light(name: &str, kind: LightKind, strength: f32) -> SceneLight {
    SceneLight { name: name.into(), kind, strength: [strength; 3] }
}

#[test]
fn furnace_with_panes_in_it_stays_a_furnace() {
    let (albedo, alphas) = (0.6_f32, [0.25, 0.7, 0.02]);
    let mut room = Room::new().walls(SIZE, albedo, 1.0);
    for (index, alpha) in alphas.into_iter().enumerate() {
        let corner = Vec3::new(0.3, 0.2, 0.6 + 0.8 * index as f32);
        room = room.pane([corner, Vec3::X * 1.4, Vec3::Y * 1.5], alpha, albedo, 1.0);
    }
    let room = room.built();
    let mut sites = sites_on_walls(SIZE, 0.5);
    sites.push(site(Vec3::new(1.0, 1.0, 0.6), Vec3::Z));
    let precision = Precision { rel_error: 0.005, paths_max: 1 << 14 };
    let wanted = PI / (1.0 - f64::from(albedo));
    for estimate in irradiance(&room, &emitters(), &sites, precision) {
        assert_sure(&estimate.indirect, wanted, 5.0, "a site among panes");
    }
}

/// A lamp, a pane before the floor, and a part of the floor beside the pane's shadow.
#[test]
fn three_quarters_of_a_lamps_light_come_through_a_pane_that_is_there_to_a_quarter() {
    let corner = Vec3::new(0.0, 1.0, 0.0);
    let floor = |room: Room| room.rectangle(Vec3::ZERO, Vec3::Z * 4.0, Vec3::X * 4.0, 0.5, 0.0);
    let open = floor(Room::new()).built();
    let glazed = floor(Room::new()).pane([corner, Vec3::X * 2.0, Vec3::Z * 4.0], 0.25, 0.0, 0.0).built();
    let twice = floor(Room::new())
        .pane([corner, Vec3::X * 2.0, Vec3::Z * 4.0], 0.25, 0.0, 0.0)
        .pane([corner + Vec3::Y * 0.1, Vec3::X * 2.0, Vec3::Z * 4.0], 0.5, 0.0, 0.0)
        .built();
    let lamp = light("lamp", LightKind::Point { position_m: [2.0, 2.0, 2.0], range_m: None }, 10.0);
    let lighting = Lighting { lights: vec![lamp], ..Lighting::default() };
    let at = |room: &Room, x: f32| {
        room.under(&lighting).direct_irradiance(&site(Vec3::new(x, 0.0, 1.7), Vec3::Y), 1).y
    };
    for (room, share) in [(&glazed, 0.75), (&twice, 0.375)] {
        assert!((at(room, 0.5) / at(&open, 0.5) - share).abs() < 1e-6, "{}", at(room, 0.5));
        assert_eq!(at(room, 3.5), at(&open, 3.5));
    }
}

/// An even sky L over a black pane of alpha s in a black floor: E below the pane is (1 − s) π L.
#[test]
fn even_sky_through_a_wide_black_pane_is_that_sky_by_the_share_that_passes() {
    let wide = 4000.0;
    let corner = Vec3::new(-0.5 * wide, 1.0, -0.5 * wide);
    let room = Room::new().pane([corner, Vec3::Z * wide, Vec3::X * wide], 0.3, 0.0, 0.0).built();
    let sky = light("sky", LightKind::Sky { zenith: [1.0; 3], horizon: [1.0; 3] }, 2.0);
    let lighting = Lighting { lights: vec![sky], ..Lighting::default() };
    let precision = Precision { rel_error: 0.004, paths_max: 1 << 16 };
    for strategy in [Strategy::Both, Strategy::Lamps, Strategy::Directions] {
        let reference = room.under(&lighting).with_strategy(strategy);
        let found = reference.irradiance(&[site(Vec3::ZERO, Vec3::Y)], &precision, &Progress::new()).unwrap();
        assert_sure(&found[0].indirect, 0.7 * 2.0 * PI, 4.0, "below the pane");
    }
}

#[test]
fn every_way_to_find_light_finds_as_much_of_it_behind_glass() {
    // A room without its wall at z = 3, which is a pane; within it a lamp of glass.
    let mut room = Room::new();
    for (index, (corner, u, v)) in Room::sides(SIZE).into_iter().enumerate() {
        room = if index == 3 {
            room.pane([corner, u, v], 0.4, 0.5, 0.0)
        } else {
            room.rectangle(corner, u, v, 0.6, 0.0)
        };
    }
    let lamp_corner = Vec3::new(0.5, 1.4, 0.5);
    let room = room.pane([lamp_corner, Vec3::X * 0.8, Vec3::Z * 0.8], 0.5, 0.3, 4.0).built();
    let rect = rect([1.0, 1.0, 3.6], [0.0, 0.0, -1.0], [0.8, 0.8], 6.0);
    let sky = LightKind::Sky { zenith: [2.0; 3], horizon: [1.0; 3] };
    let sun = LightKind::Sun { direction: [0.2, -0.5, -0.8] };
    let lights = vec![light("sky", sky, 1.0), light("sun", sun, 6.0), rect];
    let lighting = Lighting { lights, emitter_scale: 1.0, ..Lighting::default() };
    let sites = [
        site(Vec3::new(1.0, 0.0, 1.0), Vec3::Y),
        site(Vec3::new(2.0, 1.2, 0.7), -Vec3::X),
        site(Vec3::new(1.0, 1.0, 3.0), -Vec3::Z),
    ];
    let precision = Precision { rel_error: 0.006, paths_max: 1 << 17 };
    let by = |strategy| {
        let reference = room.under(&lighting).with_strategy(strategy);
        reference.irradiance(&sites, &precision, &Progress::new()).unwrap()
    };
    let both = by(Strategy::Both);
    for strategy in [Strategy::Lamps, Strategy::Directions] {
        for (one, other) in both.iter().zip(by(strategy)) {
            // As many paths are taken as indirect light asks for; the rectangle is small.
            for (a, b, sure) in [(one.direct, other.direct, 0.1), (one.indirect, other.indirect, 0.02)] {
                let error = a.luminance_error.hypot(b.luminance_error);
                assert!(error <= sure * a.luminance().max(b.luminance()), "{error} of {a:?} hides anything");
                let off = (a.luminance() - b.luminance()).abs();
                assert!(off <= 4.0 * error + 1e-9, "{strategy:?}: {a:?}, {b:?}");
            }
        }
    }
}
