//! A camera for a scene whose file has none: in a room where the view is long and lit, or outside where rooms are few.

use glam::Vec3;
use lightkiln_proto::manifest::Chosen;
use lightkiln_proto::scene::{LightKind, SceneCamera, SceneLight};
use rayon::prelude::*;

use super::VantagePoint;
use super::look::{Look, in_rooms, view};
use crate::emitters::{EmissiveTriangle, emissive_triangles};
use crate::geometry::Geometry;
use crate::rays::Hit;

/// Vertical field of view, in degrees.
const FOV_DEG: f32 = 60.0;
/// Points tried, those of the widest view.
const TRIED: usize = 64;
/// Level views tried from each.
const TURNS: u32 = 16;
/// Slope of a level view: a little downwards.
const SLOPE: f32 = -0.08;
/// Cosine to the middle of the view of its rays.
const VIEW_COSINE_MIN: f32 = 0.75;
/// Weight of an unlit surface in a view.
const UNLIT: f32 = 0.1;
/// Share of the sky about a camera from which on it is in the open.
const OPEN_SKY: f32 = 0.5;
/// Share of the surfaces in sight below which light is as good as none.
const LIT_SHARE_MIN: f32 = 0.01;
/// Rays along a side of a picture that looks for light.
const PICTURE_RAYS: u32 = 48;
/// Emissive triangles that a surface is looked at from, those of most power.
const EMITTERS_MAX: usize = 32;

/// The camera, and how it was chosen.
pub fn chosen(geometry: &Geometry, points: &[VantagePoint]) -> Chosen<SceneCamera> {
    let (eye, target, note) = match inside(geometry, points) {
        Some((eye, target)) => (eye, target, "inside the scene, where lit surfaces are farthest away"),
        None => {
            let (eye, target) = outside(geometry);
            (eye, target, "outside, framing the scene's bounds")
        }
    };
    let camera = SceneCamera {
        name: "chosen".to_owned(),
        eye_m: eye.into(),
        target_m: target.into(),
        up: Vec3::Y.into(),
        fov_y_rad: FOV_DEG.to_radians(),
        orthographic_half_height_m: None,
    };
    Chosen { value: camera, note: format!("the file has no camera; chose one {note}") }
}

/// Whether a scene in the open has no light where a camera looks: of the surfaces that it sees next to none glows or has an
/// emitter in sight. In rooms light gets about, so that nothing is said of them.
pub fn sees_no_light(geometry: &Geometry, camera: &SceneCamera) -> bool {
    let eye_m = Vec3::from(camera.eye_m);
    if Look::from(geometry, eye_m).sky_share < OPEN_SKY {
        return false;
    }
    let lamps = Lamps::of(geometry);
    let (mut seen, mut lit) = (0_u32, 0_u32);
    for direction in picture(camera) {
        let Some(hit) = geometry.tracer.closest(eye_m, direction, f32::INFINITY) else { continue };
        seen += 1;
        lit +=
            u32::from(geometry.material(hit.triangle).emissive != [0.0; 3] || lamps.shine_on(geometry, &hit));
    }
    (lit as f32) < LIT_SHARE_MIN * seen as f32
}

/// Rays of a camera, evenly over a square picture; none of an orthographic one, whose eye may be anywhere.
fn picture(camera: &SceneCamera) -> impl Iterator<Item = Vec3> {
    let forward = (Vec3::from(camera.target_m) - Vec3::from(camera.eye_m)).normalize_or_zero();
    let right = forward.cross(Vec3::from(camera.up)).normalize_or_zero();
    let (up, half) = (right.cross(forward), libm::tanf(0.5 * camera.fov_y_rad));
    let side = if camera.orthographic_half_height_m.is_some() { 0 } else { PICTURE_RAYS };
    let place = move |index: u32| (2 * index + 1) as f32 / side as f32 - 1.0;
    (0..side * side).map(move |ray| {
        (forward + half * (place(ray % side) * right + place(ray / side) * up)).normalize_or_zero()
    })
}

/// Before the bounds, a little from above and from the right.
fn outside(geometry: &Geometry) -> (Vec3, Vec3) {
    let [low, high] = geometry.near_bounds_m();
    let centre = low.lerp(high, 0.5);
    let radius_m = (0.5 * (high - low).length()).max(f32::MIN_POSITIVE);
    let distance_m = radius_m / libm::sinf(0.5 * FOV_DEG.to_radians());
    (centre + Vec3::new(0.45, 0.35, 1.0).normalize() * distance_m, centre)
}

/// The point in a room, and a point straight ahead, of the level view of highest score; none where rooms are few.
fn inside(geometry: &Geometry, points: &[VantagePoint]) -> Option<(Vec3, Vec3)> {
    let rooms = in_rooms(points);
    if rooms.is_empty() {
        return None;
    }
    let lamps = Lamps::of(geometry);
    let best_of = |place: &&VantagePoint| {
        let eye_m = place.position_m;
        let rays: Vec<(Vec3, f32)> = view(geometry, eye_m)
            .map(|(direction, hit)| (direction, hit.map_or(0.0, |hit| lamps.interest(geometry, &hit))))
            .collect();
        let turns = (0..TURNS).map(|turn| {
            let angle = turn as f32 * std::f32::consts::TAU / TURNS as f32;
            let forward = Vec3::new(libm::cosf(angle), SLOPE, libm::sinf(angle)).normalize();
            (score(&rays, forward), eye_m, eye_m + forward)
        });
        // Of equal views the first.
        turns.reduce(|best, next| if next.0 > best.0 { next } else { best })
    };
    let tried: Vec<_> = rooms.par_iter().take(TRIED).filter_map(best_of).collect();
    let best = tried.into_iter().reduce(|best, next| if next.0 > best.0 { next } else { best });
    best.map(|(_, eye_m, target_m)| (eye_m, target_m))
}

/// Mean interest of the rays of a view.
fn score(rays: &[(Vec3, f32)], forward: Vec3) -> f32 {
    let seen = rays.iter().filter(|(direction, _)| direction.dot(forward) >= VIEW_COSINE_MIN);
    let (sum, count) = seen.fold((0.0, 0_u32), |(sum, count), (_, interest)| (sum + interest, count + 1));
    sum / count.max(1) as f32
}

/// The scene's own sources of light.
struct Lamps<'a> {
    lights: &'a [SceneLight],
    emitters: Vec<EmissiveTriangle>,
}

impl<'a> Lamps<'a> {
    fn of(geometry: &'a Geometry) -> Self {
        let mut emitters = emissive_triangles(geometry);
        let power = |of: &EmissiveTriangle| of.area_m2 * of.mean_radiance.iter().sum::<f32>();
        emitters.sort_by(|a, b| power(b).total_cmp(&power(a)).then(a.triangle.cmp(&b.triangle)));
        emitters.truncate(EMITTERS_MAX);
        Self { lights: &geometry.scene.lights, emitters }
    }

    /// √distance of a hit, a part of it where nothing shines on it; nothing for backs.
    fn interest(&self, geometry: &Geometry, hit: &Hit) -> f32 {
        if geometry.is_back(hit) {
            return 0.0;
        }
        hit.t.sqrt() * if self.shine_on(geometry, hit) { 1.0 } else { UNLIT }
    }

    /// A light of the file is before the surface, or an emitter in sight of it.
    fn shine_on(&self, geometry: &Geometry, hit: &Hit) -> bool {
        let (at_m, normal) = (geometry.point_of(hit), geometry.side_normal(hit));
        let faces = |light: &SceneLight| match &light.kind {
            LightKind::Point { position_m, .. } | LightKind::Spot { position_m, .. } => {
                normal.dot(Vec3::from(*position_m) - at_m) > 0.0
            }
            LightKind::Sun { direction } => normal.dot(Vec3::from(*direction)) < 0.0,
            LightKind::Sky { .. } => true,
        };
        let offset_m = |about_m: Vec3| geometry.tracer.ray_offset_m(about_m);
        let in_sight = |emitter: &EmissiveTriangle| {
            let centre_m = emitter.corners.iter().sum::<Vec3>() / 3.0;
            let to_emitter = centre_m - at_m;
            let facing = -to_emitter.dot(emitter.normal);
            let above = normal.dot(to_emitter) > 0.0 && (facing > 0.0 || emitter.double_sided);
            let lifted_m = centre_m + emitter.normal * offset_m(centre_m).copysign(facing);
            above && !geometry.tracer.is_occluded(at_m + normal * offset_m(at_m), lifted_m)
        };
        self.lights.iter().any(faces) || self.emitters.iter().any(in_sight)
    }
}
