//! The camera and sky as the shaders read them.

use glam::{Mat4, Vec3};
use lightkiln_proto::scene::SceneCamera;

use crate::error::Result;
use crate::lights::{Panorama, Sky};
use crate::raster::camera_clip_from_world;

/// Pixels by which shadows are looked up nearer to the eye. More → fewer lit pixels at corners in shade, and shadows' edges
/// as much aside.
const BEFORE_PIXELS: f32 = 1.0;

/// Looks of surfaces that pictures show and transport does not know (METHOD.md §2.15).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SurfaceDetails {
    /// Normal maps are shown.
    pub normal_maps: bool,
    /// Surfaces reflect as their metallic and roughness say; without, all reflection is diffuse.
    pub specular: bool,
}

impl Default for SurfaceDetails {
    fn default() -> Self {
        Self { normal_maps: true, specular: true }
    }
}

impl SurfaceDetails {
    /// None: pictures of the surfaces that light is baked for, which can be held against the path tracer.
    pub const NONE: Self = Self { normal_maps: false, specular: false };
}

/// Camera and sky of a picture; twin of `ShadeView` in `view.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct ShadeView {
    /// Columns of the projection.
    pub clip_from_world: [[f32; 4]; 4],
    /// Radiance straight up; then 1 where specular reflection is left out.
    pub zenith: [f32; 4],
    /// Radiance at the horizon; then 1 where surfaces show irradiance in place of radiance.
    pub horizon: [f32; 4],
    /// World direction through the picture's middle; then 1 where normal maps are left out.
    pub ray: [f32; 4],
    /// Its change per unit of ndc x; then the parts of light that walks make, a bit each, and eight times their step in pixels.
    pub ray_per_x: [f32; 4],
    /// Its change per unit of ndc y; then the side of a pixel in metres where clip w is 1.
    pub ray_per_y: [f32; 4],
}

impl ShadeView {
    /// A view whose samples lie `jitter` pixels (right, down) from the pixels' centres.
    pub fn new(
        camera: &SceneCamera,
        size: [u32; 2],
        bounds_m: [[f32; 3]; 2],
        sky: Sky,
        jitter: [f32; 2],
    ) -> Result<Self> {
        let steady = camera_clip_from_world(camera, size, bounds_m)?;
        let shift_x = -2.0 * jitter[0] / size[0] as f32;
        let shift_y = 2.0 * jitter[1] / size[1] as f32;
        // ndc shifts by a constant: clip.xy += shift · clip.w.
        let mut shift = Mat4::IDENTITY;
        shift.w_axis.x = shift_x;
        shift.w_axis.y = shift_y;
        let clip_from_world = shift * steady;
        // Per ndc, the second row grows by the reciprocal of half the picture's height in metres.
        let pixel_at_unit_w = 2.0 / (steady.row(1).truncate().length() * size[1] as f32);
        let [ray, ray_per_x, ray_per_y] = rays(camera, size, [shift_x, shift_y]);
        Ok(Self {
            clip_from_world: clip_from_world.to_cols_array_2d(),
            zenith: sky.zenith.extend(0.0).into(),
            horizon: sky.horizon.extend(0.0).into(),
            ray: ray.extend(0.0).into(),
            ray_per_x: ray_per_x.extend(0.0).into(),
            ray_per_y: ray_per_y.extend(pixel_at_unit_w).into(),
        })
    }

    /// The view with irradiance alone in place of radiance, or radiance again.
    #[must_use]
    pub fn showing_irradiance(mut self, shows: bool) -> Self {
        self.horizon[3] = f32::from(u8::from(shows));
        self
    }

    /// The view with these details of surfaces.
    #[must_use]
    pub fn with_details(mut self, details: SurfaceDetails) -> Self {
        let left_out = |shown: bool| f32::from(u8::from(!shown));
        (self.ray[3], self.zenith[3]) = (left_out(details.normal_maps), left_out(details.specular));
        self
    }

    /// The view with parts of light that walks of its pixels make, see [`crate::passes::walk::Walks::parts`], of each, every second … one.
    #[must_use]
    pub fn with_walked(mut self, parts: u32, step: u32) -> Self {
        self.ray_per_x[3] = (parts | step << 3) as f32;
        self
    }

    /// Parts of light that walks make.
    pub fn parts_walked(&self) -> u32 {
        self.ray_per_x[3] as u32 & 7
    }

    /// Details of surfaces that it shows; none over irradiance.
    pub(super) fn details(&self) -> SurfaceDetails {
        let is_shown = |left_out: f32| left_out != 1.0 && !self.shows_irradiance();
        SurfaceDetails { normal_maps: is_shown(self.ray[3]), specular: is_shown(self.zenith[3]) }
    }

    /// Surfaces show irradiance in place of radiance.
    pub(super) fn shows_irradiance(&self) -> bool {
        self.horizon[3] == 1.0
    }

    /// Clip space of the view.
    pub fn projection(&self) -> Mat4 {
        Mat4::from_cols_array_2d(&self.clip_from_world)
    }

    /// A point before one that is seen, a pixel nearer to the eye; twin of `before` in the shader.
    pub(super) fn before(&self, position: Vec3) -> Vec3 {
        let clip = self.projection() * position.extend(1.0);
        let ray = self.ray_through(clip.x / clip.w, clip.y / clip.w);
        position - ray * (BEFORE_PIXELS * self.ray_per_y[3] * clip.w)
    }

    /// Unit vector from a point that is seen towards the eye.
    pub(super) fn towards_eye(&self, position: Vec3) -> Vec3 {
        let clip = self.projection() * position.extend(1.0);
        -self.ray_through(clip.x / clip.w, clip.y / clip.w).normalize_or(Vec3::NEG_Z)
    }

    /// World direction through a point of the picture in ndc, of length 1 along the view.
    fn ray_through(&self, x: f32, y: f32) -> Vec3 {
        let vector = |four: [f32; 4]| Vec3::new(four[0], four[1], four[2]);
        vector(self.ray) + vector(self.ray_per_x) * x + vector(self.ray_per_y) * y
    }

    /// Ray through a point of the picture, in pixels from its upper left corner: where it begins in metres, its unit direction, and the
    /// tangent of half the angle of a pixel.
    pub fn ray_of_pixel(&self, at: [f32; 2], size: [u32; 2]) -> (Vec3, Vec3, f32) {
        let ndc = [at[0] / size[0] as f32 * 2.0 - 1.0, 1.0 - at[1] / size[1] as f32 * 2.0];
        let world_from_clip = self.projection().inverse();
        // Depth is 1 at the near plane.
        let begin = world_from_clip.project_point3(Vec3::new(ndc[0], ndc[1], 1.0));
        let along = self.ray_through(ndc[0], ndc[1]);
        (begin, along.normalize_or(Vec3::NEG_Z), 0.5 * self.ray_per_y[3] / along.length().max(1.0))
    }

    /// Radiance of the sky at a point of the picture, in pixels from its upper left corner.
    pub(super) fn sky_at(&self, at: [f64; 2], size: [u32; 2], panorama: Option<&Panorama>) -> Vec3 {
        let x = (at[0] / f64::from(size[0])) as f32 * 2.0 - 1.0;
        let y = 1.0 - (at[1] / f64::from(size[1])) as f32 * 2.0;
        let vector = |four: [f32; 4]| Vec3::new(four[0], four[1], four[2]);
        let sky = Sky { zenith: vector(self.zenith), horizon: vector(self.horizon) };
        let direction = self.ray_through(x, y).normalize_or(Vec3::Y);
        sky.radiance(direction) + panorama.map_or(Vec3::ZERO, |panorama| panorama.shown(direction))
    }
}

/// Direction through the middle, and its change per ndc x and y; parallel cameras look one way everywhere.
fn rays(camera: &SceneCamera, size: [u32; 2], shift: [f32; 2]) -> [Vec3; 3] {
    let forward = (Vec3::from(camera.target_m) - Vec3::from(camera.eye_m)).normalize_or(Vec3::NEG_Z);
    if camera.orthographic_half_height_m.is_some() {
        return [forward, Vec3::ZERO, Vec3::ZERO];
    }
    let right = forward.cross(camera.up.into()).normalize_or(Vec3::X);
    let up = right.cross(forward);
    let tan = (0.5 * camera.fov_y_rad).tan();
    let (per_x, per_y) = (right * tan * size[0] as f32 / size[1] as f32, up * tan);
    [forward - per_x * shift[0] - per_y * shift[1], per_x, per_y]
}
