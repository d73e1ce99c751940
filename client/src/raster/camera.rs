//! Projections with reversed depth, shared by cameras and shadow maps.

use glam::{Mat4, Vec3, Vec4};
use lightkiln_proto::scene::SceneCamera;

use crate::error::{ClientError, Result};

/// View matrix: x right, y up, z **forward**, as the projections below expect.
pub fn look_along(eye: Vec3, forward: Vec3, up: Vec3) -> Mat4 {
    let right = forward.cross(up).normalize();
    let up = right.cross(forward);
    let rows = Mat4::from_cols(right.extend(0.0), up.extend(0.0), forward.extend(0.0), Vec4::W).transpose();
    rows * Mat4::from_translation(-eye)
}

/// Perspective with depth near/z: `tan_x`, `tan_y` are half extents at distance 1.
pub fn perspective(tan_x: f32, tan_y: f32, near: f32) -> Mat4 {
    Mat4::from_cols(
        Vec4::new(1.0 / tan_x, 0.0, 0.0, 0.0),
        Vec4::new(0.0, 1.0 / tan_y, 0.0, 0.0),
        Vec4::new(0.0, 0.0, 0.0, 1.0),
        Vec4::new(0.0, 0.0, near, 0.0),
    )
}

/// Parallel projection with depth 1 − z/far and half extents in metres.
pub fn parallel(half_x: f32, half_y: f32, far: f32) -> Mat4 {
    Mat4::from_cols(
        Vec4::new(1.0 / half_x, 0.0, 0.0, 0.0),
        Vec4::new(0.0, 1.0 / half_y, 0.0, 0.0),
        Vec4::new(0.0, 0.0, -1.0 / far, 0.0),
        Vec4::new(0.0, 0.0, 1.0, 1.0),
    )
}

/// Clip space of a camera for a picture of `size` pixels; `bounds_m` of the scene set near and far.
pub fn camera_clip_from_world(camera: &SceneCamera, size: [u32; 2], bounds_m: [[f32; 3]; 2]) -> Result<Mat4> {
    let wrong = |problem: &str| ClientError::Argument {
        what: format!("camera '{}'", camera.name),
        problem: problem.to_owned(),
    };
    let (eye, target, up) = (Vec3::from(camera.eye_m), Vec3::from(camera.target_m), Vec3::from(camera.up));
    let forward = (target - eye).try_normalize().ok_or_else(|| wrong("eye and target are the same point"))?;
    // A camera that is not a number fails the comparison too.
    let upright = forward.cross(up).length() > 1e-5;
    if !upright {
        return Err(wrong("up points along the view"));
    }
    let view = look_along(eye, forward, up);
    let [low, high] = bounds_m.map(Vec3::from);
    let diagonal = (high - low).length().max(f32::MIN_POSITIVE);
    let aspect = size[0] as f32 / size[1] as f32;
    if let Some(half) = camera.orthographic_half_height_m {
        if !(half > 0.0 && half.is_finite()) {
            return Err(wrong("its orthographic half height is not a positive number"));
        }
        let far = eye.distance(low.lerp(high, 0.5)) + diagonal;
        return Ok(parallel(half * aspect, half, far) * view);
    }
    let tan = (0.5 * camera.fov_y_rad).tan();
    if !(tan > 1e-4 && tan < 1e3) {
        return Err(wrong("its field of view is not between 0 and 180 degrees"));
    }
    let near = 1e-4 * diagonal;
    Ok(perspective(tan * aspect, tan, near) * view)
}
