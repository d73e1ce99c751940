//! A camera and a sun for scenes whose file has none.

use glam::Vec3;
use lightkiln_proto::scene::{LightKind, SceneCamera, SceneLight};
use lightkiln_proto::sh::relight_direction;
use lightkiln_proto::words::upright;

use crate::bake::{HIT_SKY, LoadedBake};

/// Vertical field of view of chosen cameras, in degrees.
const FOV_DEG: f32 = 60.0;
/// Irradiance of a chosen sun on a surface that faces it, in W·m⁻².
const SUN_IRRADIANCE: f32 = 10.0;
/// Share of a probe's rays that meet the sky up to which it is in a room.
const ROOM_SKY: f32 = 0.15;
/// Share of probes in rooms from which on a scene is looked at from inside.
const ROOM_PROBES: f32 = 0.125;

/// A camera for a bake whose file has none: from a probe in a room with a wide view, or from outside where rooms are few.
///
/// Returns the camera and a note that says how it was chosen.
pub fn default_camera(bake: &LoadedBake) -> (SceneCamera, String) {
    let (eye, target, note) = match best_inside(bake) {
        Some((eye, target)) => {
            (eye, target, "inside the scene, where a probe sees lit surfaces farthest away")
        }
        None => {
            let (eye, target) = outside(bake);
            (eye, target, "outside, framing the scene's bounds")
        }
    };
    let forward = (target - eye).try_normalize().unwrap_or(Vec3::NEG_Z);
    let camera = SceneCamera {
        name: "chosen".to_owned(),
        eye_m: eye.into(),
        target_m: target.into(),
        up: upright(forward).into(),
        fov_y_rad: FOV_DEG.to_radians(),
        orthographic_half_height_m: None,
    };
    let words = |v: Vec3| format!("{:.3},{:.3},{:.3}", v.x, v.y, v.z);
    let note = format!(
        "the file has no camera; chose one {note}: --camera \"eye={} target={} fov={FOV_DEG}\"",
        words(eye),
        words(target)
    );
    (camera, note)
}

/// A sun for a bake whose file has neither lights nor emissive surfaces, and a note that says so.
///
/// In a closed scene a sun would light nothing: there, a lamp at the probe nearest to the top of the middle.
pub fn default_sun(bake: &LoadedBake) -> (SceneLight, String) {
    let lamp = if sky_share(&bake.probes.hits) < 0.01 { lamp_position(bake) } else { None };
    if let Some(position) = lamp {
        let [low, high] = corners(bake);
        let size = (high - low).length();
        let light = SceneLight {
            name: "chosen".to_owned(),
            kind: LightKind::Point { position_m: position.into(), range_m: None },
            strength: [0.25 * size * size; 3],
        };
        let note = format!(
            "the file has no light and the scene is closed; chose a lamp at {:.2},{:.2},{:.2}; --light sets others",
            position.x, position.y, position.z
        );
        return (light, note);
    }
    let direction = Vec3::new(-0.35, -0.9, -0.25).normalize().into();
    let kind = LightKind::Sun { direction };
    let light = SceneLight { name: "chosen".to_owned(), kind, strength: [SUN_IRRADIANCE; 3] };
    (light, "the file has no light; chose a sun from above; --light sets others".to_owned())
}

fn corners(bake: &LoadedBake) -> [Vec3; 2] {
    bake.manifest.bounds_m.map(Vec3::from)
}

fn sky_share(hits: &[u32]) -> f32 {
    if hits.is_empty() {
        return 1.0;
    }
    hits.iter().filter(|hit| **hit == HIT_SKY).count() as f32 / hits.len() as f32
}

fn lamp_position(bake: &LoadedBake) -> Option<Vec3> {
    let [low, high] = corners(bake);
    let wanted = low.lerp(high, 0.5) + Vec3::Y * (0.3 * (high.y - low.y));
    let distance = |probe: &&Vec3| probe.distance(wanted);
    bake.probes.position_m.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).copied()
}

fn outside(bake: &LoadedBake) -> (Vec3, Vec3) {
    let [low, high] = corners(bake);
    let centre = low.lerp(high, 0.5);
    let radius = (0.5 * (high - low).length()).max(1e-3);
    let distance = radius / (0.5 * FOV_DEG.to_radians()).sin();
    (centre + Vec3::new(0.45, 0.35, 1.0).normalize() * distance, centre)
}

/// The probe in a room, and a point straight ahead, whose level view meets lit receivers farthest away on average; none
/// when rooms are few.
fn best_inside(bake: &LoadedBake) -> Option<(Vec3, Vec3)> {
    let probes = &bake.probes.position_m;
    let rooms: Vec<usize> =
        (0..probes.len()).filter(|&probe| sky_share(bake.probes.hits_of(probe)) < ROOM_SKY).collect();
    if (rooms.len() as f32) < ROOM_PROBES * probes.len() as f32 {
        return None;
    }
    let lit = lit_receivers(bake);
    let mut best: Option<(f32, Vec3, Vec3)> = None;
    for probe in rooms {
        let (eye, hits) = (probes[probe], bake.probes.hits_of(probe));
        for turn in 0..16 {
            let angle = turn as f32 * std::f32::consts::TAU / 16.0;
            let forward = Vec3::new(angle.cos(), -0.08, angle.sin()).normalize();
            let score = view_score(bake, &lit, hits, eye, forward);
            if best.is_none_or(|(known, ..)| score > known) {
                best = Some((score, eye, eye + forward));
            }
        }
    }
    best.map(|(_, eye, target)| (eye, target))
}

/// Whether each receiver is lit by an emissive surface, or faces one of the file's lights.
fn lit_receivers(bake: &LoadedBake) -> Vec<bool> {
    let emitted = bake.emitter_irradiance(&[]);
    let faces = |slot: usize, light: &SceneLight| {
        let (position, normal) =
            (bake.receivers.position_m[slot].truncate(), bake.receivers.normal[slot].truncate());
        match &light.kind {
            LightKind::Point { position_m, .. } | LightKind::Spot { position_m, .. } => {
                normal.dot(Vec3::from(*position_m) - position) > 0.0
            }
            LightKind::Sun { direction } => normal.dot(Vec3::from(*direction)) < 0.0,
            LightKind::Sky { .. } => true,
        }
    };
    let by_light = |slot| bake.manifest.lights.iter().any(|light| faces(slot, light));
    emitted.iter().enumerate().map(|(slot, e)| e.max_element() > 0.0 || by_light(slot)).collect()
}

/// Mean of √distance to the receivers that the view's rays meet, a tenth of it for unlit ones; nothing for sky and backs.
fn view_score(bake: &LoadedBake, lit: &[bool], hits: &[u32], eye: Vec3, forward: Vec3) -> f32 {
    let rays = bake.probes.relight_rays;
    let (mut sum, mut count) = (0.0, 0);
    for (ray, hit) in hits.iter().enumerate() {
        if relight_direction(ray as u32, rays).dot(forward) < 0.75 {
            continue;
        }
        count += 1;
        if let Some(position) = bake.receivers.position_m.get(*hit as usize) {
            let weight = if lit[*hit as usize] { 1.0 } else { 0.1 };
            sum += weight * position.truncate().distance(eye).sqrt();
        }
    }
    sum / count.max(1) as f32
}
