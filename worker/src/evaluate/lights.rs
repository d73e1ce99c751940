//! Lights to measure with, chosen from the scene: deterministic, and none of them was known while baking.

use std::cmp::Reverse;
use std::sync::Arc;

use glam::Vec3;
use lightkiln_proto::harmonics::relight_direction;
use lightkiln_proto::rectangle::{RECT_POINTS, Rectangle};
use lightkiln_proto::relight::Panorama;
use lightkiln_proto::scene::{LightKind, SceneLight};
use rayon::prelude::*;

use super::EvaluationError;
use super::solid::{check_place, is_free};
use crate::geometry::Geometry;
use crate::reference::Lighting;
use crate::vantage::{Openness, VantagePoint, in_rooms, vantage_points};

/// Rays among which a spot's aim is sought.
const AIM_RAYS: u32 = 512;
/// Suns tried.
const SUNS: u32 = 64;
/// Lowest sun tried, as the sine of its height.
const SUN_LOWEST: f32 = 0.2;
/// A rectangle's half sides as shares of the free space around its centre; the largest that fits is taken.
const RECT_SHARES: [f32; 4] = [0.5, 0.35, 0.2, 0.1];

/// Some light under which a bake is measured.
#[derive(Clone, Debug, PartialEq)]
pub struct TestLight {
    /// Short name, unique in an evaluation.
    pub name: String,
    /// Its kind and place, for people.
    pub words: String,
    /// The light.
    pub lighting: Lighting,
}

/// Lights chosen, and notes on those that were not.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Chosen {
    /// Lights in a fixed order.
    pub lights: Vec<TestLight>,
    /// Kinds left out, in words.
    pub notes: Vec<String>,
}

/// Chooses the lights of a scene.
pub fn default_lights(geometry: &Geometry) -> Chosen {
    let openness = Openness::of(geometry);
    let mut chosen = Chosen::default();
    let places = vantage_points(geometry);
    if places.is_empty() {
        chosen.notes.push("no point, spot or rectangle: no place in free space was found".into());
    }
    chosen.lights.extend(point(&places));
    chosen.lights.extend(spot(geometry, &places));
    chosen.lights.extend(rect(geometry, &places));
    if openness.has_opening() {
        match sun(geometry, &openness) {
            Some(light) => chosen.lights.push(light),
            None => chosen.notes.push("no sun: no direction tried reaches a surface".into()),
        }
        chosen.lights.extend([
            sky("sky-uniform", [1.0; 3], [1.0; 3]),
            sky("sky-gradient", [0.4, 0.8, 2.0], [1.0, 0.8, 0.6]),
        ]);
    } else {
        chosen.notes.push("no sun and no sky: the scene has no opening".into());
    }
    if has_emitters(geometry) {
        let lighting = Lighting { emitter_scale: 1.0, ..Lighting::default() };
        let words = "the scene's own emissive surfaces".to_owned();
        chosen.lights.push(TestLight { name: "emitters".into(), words, lighting });
    }
    chosen
}

/// A panorama as the only light.
pub fn panorama_light(panorama: Arc<Panorama>) -> TestLight {
    let words = format!(
        "the panorama {}, turned by {} degrees, times {}",
        panorama.image().name(),
        panorama.turn_deg(),
        panorama.strength()
    );
    let lighting = Lighting { panorama: Some(panorama), ..Lighting::default() };
    TestLight { name: "panorama".into(), words, lighting }
}

/// Refuses lights that stand inside solids; leaves out suns and skies where the scene has no opening, and says so.
///
/// Errors when that leaves none.
pub fn usable_lights(geometry: &Geometry, lights: Vec<TestLight>) -> Result<Chosen, EvaluationError> {
    let mut openness = None;
    let mut usable = Chosen::default();
    for light in lights {
        check_place(geometry, &light)?;
        let from_outside = |kind: &LightKind| matches!(kind, LightKind::Sky { .. } | LightKind::Sun { .. });
        let is_from_outside = light.lighting.lights.iter().any(|lamp| from_outside(&lamp.kind));
        let needs_opening = light.lighting.panorama.is_some() || is_from_outside;
        let openness = openness.get_or_insert_with(|| Openness::of(geometry));
        if needs_opening && !openness.has_opening() {
            let note = format!("light '{}' is left out: the scene has no opening to the sky", light.name);
            usable.notes.push(note);
        } else if light.lighting.emitter_scale > 0.0 && !has_emitters(geometry) {
            usable.notes.push(format!("light '{}' is left out: nothing in the scene emits", light.name));
        } else {
            usable.lights.push(light);
        }
    }
    if usable.lights.is_empty() {
        return Err(EvaluationError::NoLight { problem: usable.notes.join("; ") });
    }
    Ok(usable)
}

fn has_emitters(geometry: &Geometry) -> bool {
    geometry.scene.materials.iter().any(|material| material.emissive != [0.0; 3])
}

fn words(at: Vec3) -> String {
    format!("{:.2},{:.2},{:.2}", at.x, at.y, at.z)
}

fn single(name: &str, words: String, kind: LightKind, strength: f32) -> TestLight {
    let light = SceneLight { name: name.to_owned(), kind, strength: [strength; 3] };
    TestLight {
        name: name.to_owned(),
        words,
        lighting: Lighting { lights: vec![light], ..Lighting::default() },
    }
}

/// At the place with the widest view.
fn point(places: &[VantagePoint]) -> Option<TestLight> {
    let place = places.first()?;
    let kind = LightKind::Point { position_m: place.position_m.to_array(), range_m: None };
    let intensity = 10.0 * place.look.mean_m * place.look.mean_m;
    Some(single(
        "point",
        format!("a point at {}, where the view is widest", words(place.position_m)),
        kind,
        intensity,
    ))
}

/// From the widest view that is away from the point's, at the wall that is met most squarely.
fn spot(geometry: &Geometry, places: &[VantagePoint]) -> Option<TestLight> {
    let first = places.first()?.position_m;
    let apart_m = 0.15 * geometry.near_diagonal_m();
    let place = places.iter().find(|place| place.position_m.distance(first) > apart_m).or(places.first())?;
    let (from_m, view_m) = (place.position_m, place.look.mean_m);
    let squareness = |ray: u32| {
        let direction = relight_direction(ray, AIM_RAYS);
        let hit = geometry.tracer.closest(from_m, direction, f32::INFINITY)?;
        let normal = geometry.side_normal(&hit);
        let lit = !geometry.is_back(&hit);
        let is_wall = normal.y.abs() < 0.5 && hit.t > 0.5 * view_m && hit.t < 2.0 * view_m;
        (lit && is_wall).then(|| (-direction.dot(normal), Reverse(ray), direction, hit))
    };
    let aim = (0..AIM_RAYS).filter_map(squareness).max_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))?;
    let (_, _, direction, hit) = aim;
    let kind = LightKind::Spot {
        position_m: from_m.to_array(),
        direction: direction.to_array(),
        inner_rad: 15.0_f32.to_radians(),
        outer_rad: 25.0_f32.to_radians(),
        range_m: None,
    };
    let said = format!("a spot at {} aimed at '{}'", words(from_m), geometry.instance(hit.triangle).path);
    Some(single("spot", said, kind, 100.0 * view_m * view_m))
}

/// A square that shines downwards, where the most free space is, in a room where there are rooms: outside of them it would light
/// next to nothing.
fn rect(geometry: &Geometry, places: &[VantagePoint]) -> Option<TestLight> {
    let rooms = in_rooms(places);
    let mut roomiest = if rooms.is_empty() { places.iter().collect() } else { rooms };
    roomiest.sort_by(|a, b| b.look.nearest_m.total_cmp(&a.look.nearest_m));
    for place in roomiest.into_iter().take(16) {
        for share in RECT_SHARES {
            let half_m = share * place.look.nearest_m.min(0.2 * geometry.near_diagonal_m());
            let kind = LightKind::Rect {
                position_m: place.position_m.to_array(),
                direction: [0.0, -1.0, 0.0],
                up: [0.0, 0.0, -1.0],
                size_m: [2.0 * half_m; 2],
                points: RECT_POINTS,
            };
            if Rectangle::of(&kind).is_some_and(|rectangle| is_free(geometry, &rectangle)) {
                let said = format!(
                    "a rectangle of {:.2} m at {} that shines down",
                    2.0 * half_m,
                    words(place.position_m)
                );
                return Some(single("rect", said, kind, 10.0));
            }
        }
    }
    None
}

/// The sun that lights the places that see least sky most.
fn sun(geometry: &Geometry, openness: &Openness) -> Option<TestLight> {
    let suns: Vec<Vec3> = (0..SUNS)
        .map(|ray| relight_direction(ray, SUNS))
        .filter(|to| to.y >= SUN_LOWEST)
        .map(|to| -to)
        .collect();
    let scored: Vec<(f32, usize)> =
        suns.par_iter().map(|travel| openness.lit_by(geometry, *travel)).collect();
    let (travel, (score, _)) = suns
        .iter()
        .zip(scored)
        .max_by(|a, b| a.1.0.total_cmp(&b.1.0))
        .filter(|(_, (_, count))| *count > 0)?;
    let kind = LightKind::Sun { direction: travel.to_array() };
    let way = if score > 0.0 { "into the scene through its openings" } else { "from outside" };
    Some(single("sun", format!("a sun that travels along {}, {way}", words(*travel)), kind, 10.0))
}

fn sky(name: &str, zenith: [f32; 3], horizon: [f32; 3]) -> TestLight {
    let kind = LightKind::Sky { zenith, horizon };
    single(name, format!("a sky of {zenith:?} at the zenith and {horizon:?} at the horizon"), kind, 1.0)
}
