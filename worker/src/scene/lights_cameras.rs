//! Lights (KHR_lights_punctual) and cameras under nodes, in world space.

use std::f32::consts::{FRAC_PI_2, FRAC_PI_4, PI};

use glam::{DAffine3, DVec3, Vec3};
use gltf::json::Camera;
use gltf::json::camera::Type as CameraType;
use gltf::json::extensions::scene::khr_lights_punctual::{Light, Type as LightType};
use gltf::json::validation::Checked;
use lightkiln_proto::scene::{LightKind, SceneCamera, SceneLight};

use super::context::Context;
use super::document::{self, node_place};
use super::error::{Result, place_of};

/// Smallest and largest vertical field of view taken as stated, in radians.
const FOV_Y_RANGE_RAD: [f32; 2] = [1e-3, PI - 1e-3];

/// Smallest difference kept between a spot's cones, in radians: the falloff between them divides by it.
const MIN_CONE_GAP_RAD: f32 = 1e-4;

/// The light under a node, if it has one.
pub(super) fn read_light(
    context: &mut Context<'_>,
    node_index: usize,
    world_from_object: DAffine3,
) -> Result<Option<SceneLight>> {
    let root = context.root;
    let node = &root.nodes[node_index];
    let Some(stated) = node.extensions.as_ref().and_then(|e| e.khr_lights_punctual.as_ref()) else {
        return Ok(None);
    };
    let index = stated.light.value();
    let light = document::get(root, stated.light, "light", || node_place(root, node_index))?;
    let Checked::Valid(kind) = light.type_ else {
        context
            .warnings
            .add("light-skipped", || format!("light {index} is of a kind that glTF does not have"));
        return Ok(None);
    };
    let axes = Axes::of(context, node_index, world_from_object);
    let position_m = axes.position_m.to_array();
    let direction = axes.forward.to_array();
    let range_m = light.range.filter(|range| range.is_finite() && *range > 0.0);
    let kind = match kind {
        LightType::Directional => LightKind::Sun { direction },
        LightType::Point => LightKind::Point { position_m, range_m },
        LightType::Spot => {
            let (inner_rad, outer_rad) = spot_cones(context, light, index);
            LightKind::Spot { position_m, direction, inner_rad, outer_rad, range_m }
        }
    };
    let strength = light_strength(context, light, index);
    let name = light.name.as_deref().or(node.name.as_deref());
    Ok(Some(SceneLight {
        name: name.map_or_else(|| format!("light {index}"), str::to_owned),
        kind,
        strength,
    }))
}

/// Colour × intensity, without numbers that are negative or not finite.
fn light_strength(context: &mut Context<'_>, light: &Light, index: usize) -> [f32; 3] {
    let stated = light.color.map(|channel| channel * light.intensity);
    let usable = stated.map(|channel| if channel.is_finite() { channel.max(0.0) } else { 0.0 });
    if usable != stated {
        context.warnings.add("light-strength-clamped", || {
            format!("light {index} has a negative or infinite colour or intensity")
        });
    }
    usable
}

/// Inner and outer half angle of a spot; 0 and 45° where the file states none.
fn spot_cones(context: &mut Context<'_>, light: &Light, index: usize) -> (f32, f32) {
    let stated = light.spot.as_ref().map_or((0.0, FRAC_PI_4), |s| (s.inner_cone_angle, s.outer_cone_angle));
    let (inner, outer) = stated;
    let outer = if outer.is_finite() { outer.clamp(MIN_CONE_GAP_RAD, FRAC_PI_2) } else { FRAC_PI_4 };
    let inner = if inner.is_finite() { inner.clamp(0.0, outer - MIN_CONE_GAP_RAD) } else { 0.0 };
    let is_changed = (inner - stated.0).abs() > MIN_CONE_GAP_RAD * 1.5 || outer != stated.1;
    if is_changed {
        context.warnings.add("spot-cone-clamped", || {
            format!("light {index} has cone angles outside 0 ≤ inner < outer ≤ 90°")
        });
    }
    (inner, outer)
}

/// The camera under a node, if it has one that can be used.
pub(super) fn read_camera(
    context: &mut Context<'_>,
    node_index: usize,
    world_from_object: DAffine3,
) -> Result<Option<SceneCamera>> {
    let root = context.root;
    let node = &root.nodes[node_index];
    let Some(camera_index) = node.camera else { return Ok(None) };
    let index = camera_index.value();
    let camera = document::get(root, camera_index, "camera", || node_place(root, node_index))?;
    let Some((fov_y_rad, orthographic_half_height_m)) = projection(camera) else {
        context.warnings.add("camera-skipped", || {
            format!("{} has no usable projection", place_of("camera", index, camera.name.as_deref()))
        });
        return Ok(None);
    };
    let axes = Axes::of(context, node_index, world_from_object);
    let name = camera.name.as_deref().or(node.name.as_deref());
    Ok(Some(SceneCamera {
        name: name.map_or_else(|| format!("camera {index}"), str::to_owned),
        eye_m: axes.position_m.to_array(),
        target_m: (axes.position_m + axes.forward).to_array(),
        up: axes.up.to_array(),
        fov_y_rad,
        orthographic_half_height_m,
    }))
}

/// Vertical field of view, and half height if the camera is orthographic.
fn projection(camera: &Camera) -> Option<(f32, Option<f32>)> {
    let [min_rad, max_rad] = FOV_Y_RANGE_RAD;
    match (&camera.type_, &camera.perspective, &camera.orthographic) {
        (Checked::Valid(CameraType::Perspective), Some(perspective), _) => {
            let fov_y_rad = perspective.yfov;
            (fov_y_rad.is_finite() && fov_y_rad > 0.0).then(|| (fov_y_rad.clamp(min_rad, max_rad), None))
        }
        (Checked::Valid(CameraType::Orthographic), _, Some(orthographic)) => {
            let half_height_m = orthographic.ymag.abs();
            (half_height_m.is_finite() && half_height_m > 0.0).then_some((FRAC_PI_4, Some(half_height_m)))
        }
        _ => None,
    }
}

/// A node's origin and the directions of its −z and +y; scale and shear do not count.
struct Axes {
    position_m: Vec3,
    forward: Vec3,
    up: Vec3,
}

impl Axes {
    fn of(context: &mut Context<'_>, node_index: usize, world_from_object: DAffine3) -> Self {
        let m = world_from_object.matrix3;
        let forward = (-m.z_axis).try_normalize();
        if forward.is_none() {
            context.warnings.add("direction-unknown", || {
                format!(
                    "{} is scaled to 0, so its direction is lost; -z is used",
                    node_place(context.root, node_index)
                )
            });
        }
        let forward = forward.unwrap_or(DVec3::NEG_Z);
        let upright = m.y_axis - forward * m.y_axis.dot(forward);
        let up = upright.try_normalize().unwrap_or_else(|| forward.any_orthonormal_vector());
        let position_m = world_from_object.translation.as_vec3();
        Self { position_m, forward: forward.as_vec3(), up: up.as_vec3() }
    }
}
