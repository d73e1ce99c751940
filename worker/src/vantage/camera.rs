//! A camera for a scene whose file has none: in a room where the view is long and lit, or outside where rooms are few.

use glam::Vec3;
use lightkiln_proto::manifest::Chosen;
use lightkiln_proto::scene::{LightKind, SceneCamera, SceneLight};
use lightkiln_proto::words::camera_to_text;
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
const LIT_SHARE_MIN: f32 = 0.1;
/// Radiance of a white surface over that of the brightest emitter below which it is black beside that. Walls of a Cornell box have
/// about 0.01 before bounces.
const LIT_MIN: f32 = 0.003;
/// Width over height of the picture that a view from outside fits into.
const OUTSIDE_ASPECT: f32 = 4.0 / 3.0;
/// Distance of the eye of a view from outside over the least at which the bounds fit.
const OUTSIDE_MARGIN: f32 = 1.05;
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
    let note = format!("the file has no camera; chose one {note}: \"{}\"", camera_to_text(&camera));
    Chosen { value: camera, note }
}

/// Whether a scene in the open has no light where a camera looks: of the surfaces that it sees, but those that glow, few have so much
/// light of emitters that they are not black beside those. In rooms light gets about, so that nothing is said of them.
pub fn sees_no_light(geometry: &Geometry, camera: &SceneCamera) -> bool {
    let eye_m = Vec3::from(camera.eye_m);
    if Look::from(geometry, eye_m).sky_share < OPEN_SKY {
        return false;
    }
    let lamps = Lamps::of(geometry);
    let (mut seen, mut lit) = (0_u32, 0_u32);
    for direction in picture(camera) {
        let Some(hit) = geometry.tracer.closest(eye_m, direction, f32::INFINITY) else { continue };
        if lamps.glows(&hit) {
            continue;
        }
        seen += 1;
        lit += u32::from(lamps.share_of_brightest(geometry, &hit) > LIT_MIN);
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

/// Before the bounds, from above and from the right, as near as a picture of 4:3 shows them whole. Flat scenes are seen from higher
/// above.
fn outside(geometry: &Geometry) -> (Vec3, Vec3) {
    let [low, high] = geometry.near_bounds_m();
    let (centre, half) = (low.lerp(high, 0.5), 0.5 * (high - low));
    let width_m = half.x.max(half.z).max(f32::MIN_POSITIVE);
    let flatness = 1.0 - (half.y / width_m).min(1.0);
    let towards_eye = Vec3::new(0.45, 0.35 + 0.5 * flatness, 1.0).normalize();
    let right = Vec3::Y.cross(towards_eye).normalize();
    let slope_up = libm::tanf(0.5 * FOV_DEG.to_radians());
    let slopes = [(right, slope_up * OUTSIDE_ASPECT), (towards_eye.cross(right), slope_up)];
    // A corner is in the picture of an eye that is so far before it that its offset keeps within the slope.
    let distance_of = |corner: u32| {
        let side = |bit: u32| if corner >> bit & 1 == 1 { 1.0 } else { -1.0 };
        let to_corner = half * Vec3::new(side(0), side(1), side(2));
        let before = slopes.iter().map(|(axis, slope)| to_corner.dot(*axis).abs() / slope);
        to_corner.dot(towards_eye) + before.fold(0.0, f32::max)
    };
    let distance_m = (0..8).map(distance_of).fold(f32::MIN_POSITIVE, f32::max);
    (centre + towards_eye * (OUTSIDE_MARGIN * distance_m), centre)
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
    /// Emissive triangles of most power.
    emitters: Vec<EmissiveTriangle>,
    /// Power of all emissive triangles over that of these.
    power: f32,
    /// Triangles that are not black beside the brightest, ascending: an emissive texture may be black on most.
    glowing: Vec<u32>,
    /// The highest radiance of them, summed over the channels.
    brightest: f32,
}

impl<'a> Lamps<'a> {
    fn of(geometry: &'a Geometry) -> Self {
        let mut emitters = emissive_triangles(geometry);
        let brightest = emitters.iter().map(radiance_of).fold(f32::MIN_POSITIVE, f32::max);
        let glowing = emitters.iter().filter(|emitter| radiance_of(emitter) > LIT_MIN * brightest);
        let glowing: Vec<u32> = glowing.map(|emitter| emitter.triangle).collect();
        let power = |of: &EmissiveTriangle| of.area_m2 * radiance_of(of);
        let all: f32 = emitters.iter().map(power).sum();
        emitters.sort_by(|a, b| power(b).total_cmp(&power(a)).then(a.triangle.cmp(&b.triangle)));
        emitters.truncate(EMITTERS_MAX);
        let counted: f32 = emitters.iter().map(power).sum();
        let power = if counted > 0.0 { all / counted } else { 1.0 };
        Self { lights: &geometry.scene.lights, emitters, power, glowing, brightest }
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
            LightKind::Point { position_m, .. }
            | LightKind::Spot { position_m, .. }
            | LightKind::Rect { position_m, .. } => normal.dot(Vec3::from(*position_m) - at_m) > 0.0,
            LightKind::Sun { direction } => normal.dot(Vec3::from(*direction)) < 0.0,
            LightKind::Sky { .. } => true,
        };
        let in_sight = |emitter: &EmissiveTriangle| form_factor(geometry, (at_m, normal), emitter) > 0.0;
        self.lights.iter().any(faces) || self.emitters.iter().any(in_sight)
    }

    /// Whether the surface shines.
    fn glows(&self, hit: &Hit) -> bool {
        self.glowing.binary_search(&hit.triangle).is_ok()
    }

    /// Radiance of a white surface there by emitters, over that of the brightest emitter. Of many emitters those of most power stand
    /// for all.
    fn share_of_brightest(&self, geometry: &Geometry, hit: &Hit) -> f32 {
        let site = (geometry.point_of(hit), geometry.side_normal(hit));
        let received = |emitter| radiance_of(emitter) * form_factor(geometry, site, emitter);
        self.power * self.emitters.iter().map(received).sum::<f32>() / self.brightest
    }
}

/// Mean radiance, summed over the channels.
fn radiance_of(emitter: &EmissiveTriangle) -> f32 {
    emitter.mean_radiance.iter().sum()
}

/// Share of a cosine-weighted hemisphere that an emitter fills, by its middle; 0 where it is not in sight.
fn form_factor(geometry: &Geometry, (at_m, normal): (Vec3, Vec3), emitter: &EmissiveTriangle) -> f32 {
    let offset_m = |about_m: Vec3| geometry.tracer.ray_offset_m(about_m);
    let centre_m = emitter.corners.iter().sum::<Vec3>() / 3.0;
    let to_emitter = centre_m - at_m;
    let facing = -to_emitter.dot(emitter.normal);
    let above = normal.dot(to_emitter);
    if above <= 0.0 || (facing <= 0.0 && !emitter.double_sided) {
        return 0.0;
    }
    let lifted_m = centre_m + emitter.normal * offset_m(centre_m).copysign(facing);
    if geometry.tracer.is_occluded(at_m + normal * offset_m(at_m), lifted_m) {
        return 0.0;
    }
    let squared_m2 = to_emitter.length_squared().max(f32::MIN_POSITIVE);
    let cosines = above * facing.abs() / squared_m2;
    (cosines * emitter.area_m2 / (std::f32::consts::PI * squared_m2)).min(1.0)
}
