//! A light for a scene whose file has neither lights nor emissive surfaces that light what is seen: a sun, or a lamp where no sun gets in.

use glam::Vec3;
use lightkiln_proto::manifest::Chosen;
use lightkiln_proto::scene::{LightKind, SceneLight};

use super::VantagePoint;
use super::look::ROOM_POINTS;
use crate::geometry::Geometry;

/// Irradiance of a sun on a surface that faces it, in W·m⁻².
const SUN_IRRADIANCE: f32 = 10.0;
/// Direction of a sun's light.
const SUN_DIRECTION: Vec3 = Vec3::new(-0.35, -0.9, -0.25);
/// Mean share of views that is sky up to which a scene is closed.
const CLOSED_SKY: f32 = 0.01;
/// Intensity of a lamp over the squared diagonal of the scene, in W·sr⁻¹·m⁻².
const LAMP_INTENSITY: f32 = 0.25;
/// Height of a lamp above the middle, as a share of the scene's.
const LAMP_HEIGHT: f32 = 0.3;

/// The light, and how it was chosen; `reason` says why one is. Points inside things are no places for a lamp, as nobody looks from there; a scene
/// with hardly any others is a thing itself.
pub fn chosen(geometry: &Geometry, points: &[VantagePoint], reason: &str) -> Chosen<SceneLight> {
    let places: Vec<&VantagePoint> = points.iter().filter(|point| !point.look.is_in_thing()).collect();
    let is_thing = (places.len() as f32) < ROOM_POINTS * points.len() as f32;
    let sky: f32 = places.iter().map(|point| point.look.sky_share).sum();
    let is_closed = !is_thing && sky < CLOSED_SKY * places.len() as f32;
    let (kind, strength, note) = match lamp_position(geometry, &places).filter(|_| is_closed) {
        Some(at_m) => {
            let kind = LightKind::Point { position_m: at_m.into(), range_m: None };
            let strength = LAMP_INTENSITY * geometry.near_diagonal_m() * geometry.near_diagonal_m();
            let place = format!("{:.2},{:.2},{:.2}", at_m.x, at_m.y, at_m.z);
            (kind, strength, format!("{reason} and the scene is closed; chose a lamp at {place}"))
        }
        None => {
            let kind = LightKind::Sun { direction: SUN_DIRECTION.normalize().into() };
            (kind, SUN_IRRADIANCE, format!("{reason}; chose a sun from above"))
        }
    };
    let value = SceneLight { name: "chosen".to_owned(), kind, strength: [strength; 3] };
    Chosen { value, note }
}

/// The point nearest to the top of the middle.
fn lamp_position(geometry: &Geometry, points: &[&VantagePoint]) -> Option<Vec3> {
    let [low, high] = geometry.near_bounds_m();
    let wanted_m = low.lerp(high, 0.5) + Vec3::Y * (LAMP_HEIGHT * (high.y - low.y));
    let distance = |at_m: &Vec3| at_m.distance_squared(wanted_m);
    points.iter().map(|point| point.position_m).min_by(|a, b| distance(a).total_cmp(&distance(b)))
}
