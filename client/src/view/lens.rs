//! Between places in the scene and pixels of the picture.

use glam::{Mat4, Vec2, Vec3};
use lightkiln_proto::scene::SceneCamera;

use crate::error::Result;
use crate::raster::camera_clip_from_world;

/// A camera with a picture's size.
#[derive(Clone, Copy, Debug)]
pub struct Lens {
    clip_from_world: Mat4,
    size: Vec2,
    eye_m: Vec3,
    forward: Vec3,
    /// Half of the picture to the right and up: metres of a parallel camera, else as seen at a distance of 1.
    half: [Vec3; 2],
    is_parallel: bool,
}

/// A ray from the eye through a pixel.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// Metres.
    pub origin_m: Vec3,
    /// Unit direction.
    pub direction: Vec3,
}

impl Lens {
    /// The camera for pictures of `size` pixels of a scene with those bounds.
    pub fn new(camera: &SceneCamera, size: [u32; 2], bounds_m: [[f32; 3]; 2]) -> Result<Self> {
        let clip_from_world = camera_clip_from_world(camera, size, bounds_m)?;
        let [eye_m, target_m] = [camera.eye_m, camera.target_m].map(Vec3::from);
        let forward = (target_m - eye_m).normalize();
        let right = forward.cross(camera.up.into()).normalize();
        let half = camera.orthographic_half_height_m.unwrap_or_else(|| (0.5 * camera.fov_y_rad).tan());
        let aspect = size[0] as f32 / size[1] as f32;
        Ok(Self {
            clip_from_world,
            size: Vec2::new(size[0] as f32, size[1] as f32),
            eye_m,
            forward,
            half: [right * half * aspect, right.cross(forward) * half],
            is_parallel: camera.orthographic_half_height_m.is_some(),
        })
    }

    /// Unit direction of the view.
    pub fn forward(&self) -> Vec3 {
        self.forward
    }

    /// Pixel of a place, from the upper left corner; none for one behind the eye.
    pub fn pixel(&self, place_m: Vec3) -> Option<Vec2> {
        let clip = self.clip_from_world * place_m.extend(1.0);
        let ndc = clip.truncate().truncate() / clip.w;
        let pixel = (ndc * Vec2::new(0.5, -0.5) + 0.5) * self.size;
        (clip.w > 0.0 && pixel.is_finite()).then_some(pixel)
    }

    /// The ray through a pixel.
    pub fn ray(&self, pixel: Vec2) -> Ray {
        let ndc = (pixel / self.size - 0.5) * Vec2::new(2.0, -2.0);
        let aside = self.half[0] * ndc.x + self.half[1] * ndc.y;
        match self.is_parallel {
            true => Ray { origin_m: self.eye_m + aside, direction: self.forward },
            false => Ray { origin_m: self.eye_m, direction: (self.forward + aside).normalize() },
        }
    }

    /// The place of a pixel in the plane through `through_m` that faces the camera; none where the ray runs along it.
    pub fn on_plane(&self, pixel: Vec2, through_m: Vec3) -> Option<Vec3> {
        let Ray { origin_m, direction } = self.ray(pixel);
        let along = direction.dot(self.forward);
        let distance = (through_m - origin_m).dot(self.forward) / along;
        (along > 1e-4 && distance.is_finite()).then(|| origin_m + direction * distance)
    }

    /// Metres that a pixel spans at a place.
    pub fn metres_a_pixel(&self, place_m: Vec3) -> f32 {
        let w = (self.clip_from_world * place_m.extend(1.0)).w.abs();
        2.0 * w / (self.clip_from_world.row(1).truncate().length() * self.size.y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cameras() -> [SceneCamera; 2] {
        let eye = SceneCamera {
            name: String::new(),
            eye_m: [1.0, 2.0, 6.0],
            target_m: [0.5, 1.0, 0.0],
            up: [0.0, 1.0, 0.0],
            fov_y_rad: 0.9,
            orthographic_half_height_m: None,
        };
        [SceneCamera { orthographic_half_height_m: Some(2.0), ..eye.clone() }, eye]
    }

    #[test]
    fn place_and_pixel_are_each_others() {
        for camera in cameras() {
            let lens = Lens::new(&camera, [640, 360], [[-4.0; 3], [4.0; 3]]).unwrap();
            for place in [Vec3::ZERO, Vec3::new(1.0, 0.5, 2.0), Vec3::new(-1.0, 2.0, -3.0)] {
                let pixel = lens.pixel(place).unwrap();
                let back = lens.on_plane(pixel, place).unwrap();
                assert!(back.distance(place) < 1e-3, "{place} {back}");
                let aside = lens.on_plane(pixel + Vec2::X, place).unwrap();
                let side_m = aside.distance(place);
                assert!((side_m / lens.metres_a_pixel(place) - 1.0).abs() < 0.01, "{side_m}");
            }
            let middle = lens.pixel(camera.target_m.into()).unwrap();
            assert!(middle.distance(Vec2::new(320.0, 180.0)) < 0.05, "{middle}");
        }
        let [_, eye] = cameras();
        let lens = Lens::new(&eye, [640, 360], [[-4.0; 3], [4.0; 3]]).unwrap();
        assert_eq!(lens.pixel(Vec3::new(1.5, 3.0, 12.0)), None, "behind the eye");
    }
}
