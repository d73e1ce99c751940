//! Rims that lie oblique to the texel lattice, or between its lines, look right at every pixel: no notches along the foot of a
//! box, no ragged edge around a lamp, no steps on a dark face.

use glam::{DVec3, Vec3};
use lightkiln_proto::scene::LightKind;
use lightkiln_tests::harness::bake;
use lightkiln_tests::scenes::{
    self, BOX_BESIDE_LAMP_M, BOX_HALF_M, CLAMP_ALONG_M, LAMP_HALF_M, ROUND_COLUMN_M, UNDER_CLAMP_M,
};
use lightkiln_worker::evaluate::{Evaluated, EvaluationError, Relit};
use lightkiln_worker::geometry::Site;
use lightkiln_worker::kinds::BakeKinds;
use lightkiln_worker::rays::Hit;
use lightkiln_worker::reference::{Lighting, Precision, Reference};
use lightkiln_worker::task::Progress;

use super::setup::{careful, lamp_at, only};

const TEXEL_M: f32 = 0.1;
/// Half the width of the box.
const HALF_M: f32 = 0.5 * BOX_HALF_M;
const YAWS_DEG: [f32; 3] = [7.0, 20.0, 45.0];

/// Least and most light of the floor beside the box, over the reference: in its corners light changes within a texel. Measured
/// are 0.38 and 2.2; texels that show the light inside of the box give 0.
const FLOOR: [f64; 2] = [0.25, 3.0];

/// Largest step of light over half a degree of a round column, over the light's mean.
const ROUND_STEP_MAX: f64 = 0.04;

/// Light at a pixel by a picture and by the reference, W·m⁻².
struct Pixel {
    shown: f64,
    reference: f64,
}

/// Pixels of a room with a lamp, each at the hit of a ray from a point along a direction.
fn pixels(evaluated: &dyn Evaluated, rays: &[[Vec3; 2]]) -> Vec<Pixel> {
    pixels_under(&emitters(), evaluated, rays)
}

/// The lamp of the scene alone.
fn emitters() -> Lighting {
    Lighting { emitter_scale: 1.0, ..Lighting::default() }
}

/// Light that a picture shows where rays meet surface.
fn shown_under(lighting: &Lighting, evaluated: &dyn Evaluated, rays: &[[Vec3; 2]]) -> Vec<f64> {
    let reference = Reference::new(evaluated.geometry(), lighting).unwrap();
    let relit: Box<dyn Relit> = evaluated.relit(&reference, lighting, &Progress::new()).unwrap();
    let shown = |&[from_m, direction]: &[Vec3; 2]| {
        let hit = evaluated.geometry().tracer.closest(from_m, direction, f32::INFINITY).unwrap();
        relit.shown_at(&hit).map_or(0.0, luminance)
    };
    rays.iter().map(shown).collect()
}

/// Number of pixels that are not dark.
fn lit(shown: &[f64]) -> usize {
    shown.iter().filter(|light| **light > 3e-4).count()
}

fn luminance(light: DVec3) -> f64 {
    light.dot(DVec3::new(0.2126, 0.7152, 0.0722))
}

fn pixels_under(lighting: &Lighting, evaluated: &dyn Evaluated, rays: &[[Vec3; 2]]) -> Vec<Pixel> {
    let progress = Progress::new();
    let geometry = evaluated.geometry();
    let reference = Reference::new(geometry, lighting).unwrap();
    let relit: Box<dyn Relit> = evaluated.relit(&reference, lighting, &progress).unwrap();
    let hits: Vec<(Hit, Site)> = rays
        .iter()
        .map(|&[from_m, direction]| {
            let hit = geometry.tracer.closest(from_m, direction, f32::INFINITY).unwrap();
            let normal = geometry.side_normal(&hit);
            (hit, Site { position_m: from_m + direction * hit.t, normal, face_normal: normal })
        })
        .collect();
    let sites: Vec<Site> = hits.iter().map(|(_, site)| *site).collect();
    let precision = Precision { rel_error: 0.05, ..Precision::default() };
    let estimates = reference.irradiance(&sites, &precision, &progress).unwrap();
    hits.iter()
        .zip(estimates)
        .map(|((hit, _), estimate)| Pixel {
            shown: relit.shown_at(hit).map_or(0.0, luminance),
            reference: estimate.indirect.luminance(),
        })
        .collect()
}

fn baked(yaw_rad: f32) -> Box<dyn Evaluated> {
    evaluated(scenes::lamp_close_to_a_ceiling(yaw_rad), TEXEL_M)
}

fn evaluated(scene: Vec<u8>, texel_m: f32) -> Box<dyn Evaluated> {
    let bake = bake(scene, &careful("prt", texel_m)).unwrap();
    let bytes = |digest| {
        bake.chunk(digest).map_err(|error| EvaluationError::Missing { digest, source: error.into() })
    };
    let scene = bake.artefacts[&bake.scene].as_ref().clone();
    BakeKinds::new().evaluated(&bake.manifest, scene, &bytes, &Progress::new()).unwrap()
}

/// Panics where a pixel has less than `least` of its light, or more than `most`.
fn assert_within(what: &str, found: &[Pixel], least: f64, most: f64) {
    let ratio = |pixel: &Pixel| pixel.shown / pixel.reference;
    let (low, high) =
        found.iter().map(ratio).fold((f64::INFINITY, 0.0_f64), |(a, b), r| (a.min(r), b.max(r)));
    println!("{what}: {low:.2} to {high:.2} of the reference, {} pixels", found.len());
    assert!(low > least && high < most, "{what}: {low} to {high} of the reference");
}

/// A ray for each step along the four sides of a turned square around a point.
fn around(middle_m: Vec3, half_m: f32, yaw_rad: f32, direction: Vec3) -> Vec<[Vec3; 2]> {
    let along = (0..48).map(|step| (step as f32 + 0.5) / 48.0 * 2.0 - 1.0);
    let square = along.flat_map(|t| [(t, 1.0), (t, -1.0), (1.0, t), (-1.0, t)]);
    let turn = glam::Quat::from_rotation_y(yaw_rad);
    square.map(|(x, z)| [turn * Vec3::new(x * half_m, 0.0, z * half_m) + middle_m, direction]).collect()
}

#[test]
fn rims_show_the_light_that_falls_on_them() {
    for degrees in YAWS_DEG {
        let yaw_rad = degrees.to_radians();
        let evaluated = baked(yaw_rad);
        // The foot of the box, from 4 to 40 mm outside of it.
        for away_m in [0.004, 0.015, 0.04] {
            let foot = pixels(
                evaluated.as_ref(),
                &around(BOX_BESIDE_LAMP_M + Vec3::Y, HALF_M + away_m, yaw_rad, Vec3::NEG_Y),
            );
            assert_within(&format!("{degrees}°: floor {away_m} m from the box"), &foot, FLOOR[0], FLOOR[1]);
        }
        if degrees > YAWS_DEG[0] {
            continue;
        }
        // The ceiling beside the lamp, which is very bright behind it.
        for away_m in [0.03, 0.06, 0.1] {
            let ceiling =
                pixels(evaluated.as_ref(), &around(2.4 * Vec3::Y, LAMP_HALF_M + away_m, 0.0, Vec3::Y));
            assert_within(&format!("ceiling {away_m} m from the lamp"), &ceiling, 0.5, 2.2);
        }
    }
}

/// The face that sees no lamp is lit by bounces alone: between neighbours 1 cm apart nothing jumps.
#[test]
fn dark_face_of_a_box_has_no_steps() {
    let yaw_rad = YAWS_DEG[1].to_radians();
    let evaluated = baked(yaw_rad);
    let turn = glam::Quat::from_rotation_y(yaw_rad);
    for row in [0.1, 0.3, 0.5] {
        let rays: Vec<[Vec3; 2]> = (0..50)
            .map(|step| {
                let x = (step as f32 + 0.5) / 50.0 * 2.0 - 1.0;
                let before_m = turn * Vec3::new(x * HALF_M, row, HALF_M + 0.2) + BOX_BESIDE_LAMP_M;
                [before_m, turn * Vec3::NEG_Z]
            })
            .collect();
        let shown = shown_under(&emitters(), evaluated.as_ref(), &rays);
        let jump =
            shown.windows(2).map(|pair| (pair[1] - pair[0]).abs() / pair[0].max(pair[1])).fold(0.0, f64::max);
        println!("{row} m up: largest jump {jump:.3}");
        assert!(jump < 0.1, "{row} m up: a jump by {jump}");
    }
}

/// A box without bottom in the open. In coarse texels its inside is a hollow, and all outside of it has the light of the sky;
/// in fine ones a room, and nothing inside of it has any: no hit reads a texel beyond the wall. Of single texels that a wall
/// cuts the receiver lies outside, and no texel beside them has a wall of its own that could tell.
#[test]
fn corners_of_hollows_are_not_dark_outside_and_rooms_not_light_inside() {
    let sky = only(LightKind::Sky { zenith: [1.0; 3], horizon: [1.0; 3] }, 1.0);
    for degrees in YAWS_DEG {
        let yaw_rad = degrees.to_radians();
        let hollow = evaluated(scenes::hollow_box_on_floor(yaw_rad), 0.125);
        for away_m in [0.002, 0.01, 0.03] {
            let rays = around(2.0 * Vec3::Y, BOX_HALF_M + away_m, yaw_rad, Vec3::NEG_Y);
            let shown = shown_under(&sky, hollow.as_ref(), &rays);
            let least = shown.into_iter().fold(f64::INFINITY, f64::min);
            println!("{degrees}°, {away_m} m outside: at least {least:.3} W/m²");
            assert!(least > 2.0, "{degrees}°, {away_m} m outside: {least} W/m²");
        }
        let room = evaluated(scenes::hollow_box_on_floor(yaw_rad), 0.06);
        for away_m in [0.03, 0.05] {
            let rays = around(0.5 * Vec3::Y, BOX_HALF_M - away_m, yaw_rad, Vec3::NEG_Y);
            let lit = lit(&shown_under(&sky, room.as_ref(), &rays));
            println!("{degrees}°, {away_m} m inside: {lit} of {} pixels are lit", rays.len());
            assert!(lit <= 4, "{degrees}°, {away_m} m inside: {lit} of {} pixels are lit", rays.len());
        }
    }
}

/// A clamp stands out by millimetres before the edge of a board. Of the texels behind it only a strip is seen, narrower than
/// the distance between the points that are looked at in a texel: their receivers stand in that strip, and not in the gap.
#[test]
fn strip_under_a_clamp_is_not_dark() {
    let sky = only(LightKind::Sky { zenith: [1.0; 3], horizon: [1.0; 3] }, 1.0);
    let ([low, high], [near, far]) = (UNDER_CLAMP_M, CLAMP_ALONG_M);
    for texel_m in [0.0625, 0.125] {
        let evaluated = evaluated(scenes::clamp_on_board(), texel_m);
        let rays: Vec<[Vec3; 2]> = (0..48)
            .map(|step| {
                let z = near + (far - near) * (step as f32 + 0.5) / 48.0;
                [Vec3::new(-0.5, low.midpoint(high), z), Vec3::X]
            })
            .collect();
        let found = pixels_under(&sky, evaluated.as_ref(), &rays);
        assert_within(&format!("strip under the clamp, texels of {texel_m} m"), &found, 0.5, 1.5);
    }
}

/// A rim of a plate beside a hollow pier that stands on it, both between the lattice's lines: of the texels that hold the rim the
/// most lies in the pier, and so do those that could stand for them.
#[test]
fn narrow_rim_beside_a_hollow_pier_is_not_as_dark_as_the_hollow() {
    const TEXEL_M: f32 = 0.125;
    const PIER_HALF_M: f32 = 5.3 * TEXEL_M;
    const RIM_M: f32 = 0.1 * TEXEL_M;
    let sky = only(LightKind::Sky { zenith: [1.0; 3], horizon: [1.0; 3] }, 1.0);
    let evaluated = evaluated(scenes::hollow_pier_on_plate(PIER_HALF_M + RIM_M, PIER_HALF_M), TEXEL_M);
    for share in [0.2, 0.5, 0.8] {
        let rays = around(2.0 * Vec3::Y, PIER_HALF_M + share * RIM_M, 0.0, Vec3::NEG_Y);
        let found = pixels_under(&sky, evaluated.as_ref(), &rays);
        assert_within(&format!("rim, {share} of it from the pier"), &found, 0.5, 1.5);
    }
    let inside = around(0.5 * Vec3::Y, PIER_HALF_M - 0.1 * TEXEL_M, 0.0, Vec3::NEG_Y);
    let lit = lit(&shown_under(&sky, evaluated.as_ref(), &inside));
    assert!(lit <= 4, "{lit} of {} pixels in the pier are lit", inside.len());
}

/// A room of sheets whose floor goes on for a little beyond its walls, which are a little oblique to the lattice: beyond them it is
/// open and dark, and the room is no hollow. A strip beyond may be so narrow that the middle of a texel lies in it, but none of the
/// texel's points.
#[test]
fn floor_at_the_walls_of_a_room_has_the_light_of_the_room() {
    let yaw_rad = 1.4_f32.to_radians();
    for (half_m, beyond_m) in [(1.2, 0.03), (1.25, 0.004)] {
        let evaluated = evaluated(scenes::room_of_sheets(half_m, beyond_m, yaw_rad), TEXEL_M);
        let lamp = lamp_at(Vec3::new(0.2, 1.4, -0.1));
        for away_m in [0.004, 0.02, 0.05] {
            let mut rays = around(Vec3::Y, half_m - away_m, yaw_rad, Vec3::NEG_Y);
            // In a corner two walls cut one texel, which no straight edge can tell apart.
            rays.retain(|[from_m, _]| from_m.x.abs().min(from_m.z.abs()) < half_m - TEXEL_M);
            let found = pixels_under(&lamp, evaluated.as_ref(), &rays);
            let place = format!("floor {away_m} m from walls that it goes {beyond_m} m beyond");
            assert_within(&place, &found, 0.7, 1.4);
        }
    }
}

/// Light on a column that is shaded as one changes evenly around it, also where its charts meet.
#[test]
fn round_column_shows_no_seam() {
    const STEPS: u32 = 720;
    let evaluated = evaluated(scenes::round_column(), TEXEL_M);
    let lamp = lamp_at(Vec3::new(1.6, 1.2, 0.9));
    for height_m in [0.62, 1.3] {
        let ray = |step: u32| {
            let towards =
                glam::Quat::from_rotation_y(step as f32 / STEPS as f32 * std::f32::consts::TAU) * Vec3::X;
            [Vec3::Y * height_m + 2.0 * ROUND_COLUMN_M * towards, -towards]
        };
        let shown = shown_under(&lamp, evaluated.as_ref(), &(0..STEPS).map(ray).collect::<Vec<_>>());
        let mean = shown.iter().sum::<f64>() / f64::from(STEPS);
        let steps =
            shown.iter().zip(shown.iter().cycle().skip(1)).map(|(one, next)| (one - next).abs() / mean);
        let mut steps: Vec<f64> = steps.collect();
        steps.sort_by(f64::total_cmp);
        println!("{height_m} m: mean {mean:.3}, largest steps {:.3?}", &steps[steps.len() - 12..]);
        assert!(steps[steps.len() - 1] < ROUND_STEP_MAX, "{:?}", &steps[steps.len() - 12..]);
    }
}
