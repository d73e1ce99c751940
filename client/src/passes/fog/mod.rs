//! A medium between surfaces: it stops light, and scatters what comes from lights, past their shadows, and from probes. Froxels, columns
//! through squares of pixels cut into slices, sum what is scattered towards the eye (\[Wronski2014\]); each pixel reads those up to its depth.
//!
//! Light that is scattered once is told, and no surface is darker for it: light on its way to surfaces is not stopped.

mod pass;
pub mod reference;

use std::fmt;

use glam::Vec3;
use lightkiln_proto::scene::SceneCamera;

use crate::error::{ClientError, Result};
use crate::passes::shade::ShadeView;

pub use pass::FogPass;

/// Largest difference from the reference, relative to the picture's mean, for all but [`OUTLIERS`].
pub const TOLERANCE: f32 = 2e-2;
/// Share of pixels that may differ more: outlines, where depths are another surface's.
pub const OUTLIERS: f32 = 1e-2;

/// The shader of froxels, but for the function that tells the mean radiance.
pub const FILL_SHADER: &str = concat!(
    include_str!("../shared/light.wgsl"),
    include_str!("../shared/rect.wgsl"),
    include_str!("../shared/shadow_map.wgsl"),
    include_str!("../shared/whole_maps.wgsl"),
    include_str!("numbers.wgsl"),
    include_str!("fog.wgsl")
);
/// The shader of the picture behind the medium.
pub const OVER_SHADER: &str = concat!(include_str!("numbers.wgsl"), include_str!("over.wgsl"));
/// Mean radiance of a kind without probes in free space: none.
pub const NO_RADIANCE: &str = "fn mean_radiance(point: vec3f) -> vec3f { return vec3f(0.0); }\n";

/// Side of a column in pixels. More → less time, coarser edges of shafts.
const SIDE: u32 = 8;
/// Slices of a column. More → finer shafts, more time and memory.
const SLICES: u32 = 64;

/// A medium of even density, or one that thins with height.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fog {
    /// Extinction: share of light that is stopped per metre, by a medium so thin that it stops little.
    pub per_m: f32,
    /// Share of it that is scattered and not absorbed.
    pub albedo: f32,
    /// Mean cosine of the angle by which light is turned: above 0 most goes on forwards.
    pub g: f32,
    /// Height in metres over which the medium thins by a factor of e, above the scene's floor; even without one.
    pub height_m: Option<f32>,
}

impl Default for Fog {
    /// Thin mist that scatters alike all around.
    fn default() -> Self {
        Self { per_m: 0.05, albedo: 0.9, g: 0.0, height_m: None }
    }
}

impl fmt::Display for Fog {
    /// Words that [`Fog::from_text`] reads.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { per_m, albedo, g, height_m } = self;
        write!(f, "density={per_m} albedo={albedo} g={g}")?;
        height_m.map_or(Ok(()), |height_m| write!(f, " height={height_m}"))
    }
}

impl Fog {
    /// Reads `density=0.05`, per metre, and perhaps `albedo=0.9`, `g=0.3` and `height=2`, in metres.
    pub fn from_text(text: &str) -> Result<Self> {
        let wrong = |problem: String| ClientError::Argument { what: format!("\"{text:.200}\""), problem };
        let mut fog = Self { per_m: f32::NAN, ..Self::default() };
        for word in text.split_whitespace() {
            let (name, value) =
                word.split_once('=').ok_or_else(|| wrong(format!("'{word}' is not name=value")))?;
            let number = value.parse::<f32>().ok().filter(|number| number.is_finite());
            let number = number.ok_or_else(|| wrong(format!("'{value}' of {name} is no number")))?;
            match name {
                "density" => fog.per_m = number,
                "albedo" => fog.albedo = number,
                "g" => fog.g = number,
                "height" => fog.height_m = Some(number),
                _ => return Err(wrong(format!("'{name}' is none of density, albedo, g and height"))),
            }
        }
        if fog.per_m.is_nan() {
            return Err(wrong("'density' is missing: density=0.05 stops 5 % of light a metre".to_owned()));
        }
        fog.check().map(|()| fog)
    }

    /// Errs where a number is out of its range.
    pub fn check(&self) -> Result<()> {
        let Self { per_m, albedo, g, height_m } = *self;
        let wrong = |what: String, range: &str| {
            Err(ClientError::Argument {
                what: format!("fog of {what}"),
                problem: format!("{range} are possible"),
            })
        };
        if !(0.0..=1e3).contains(&per_m) {
            return wrong(format!("density {per_m}"), "0 to 1000 per metre");
        }
        if !(0.0..=1.0).contains(&albedo) {
            return wrong(format!("albedo {albedo}"), "0 to 1");
        }
        if !(-0.95..=0.95).contains(&g) {
            return wrong(format!("g {g}"), "-0.95 to 0.95");
        }
        match height_m {
            Some(height_m) if !(1e-3..=1e6).contains(&height_m) => {
                wrong(format!("height {height_m}"), "0.001 to 1000000 metres")
            }
            _ => Ok(()),
        }
    }
}

/// Numbers of the medium and of a view's froxels; twin of `Fog` in `numbers.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct FogNumbers {
    /// Columns, rows and slices; side of a column in pixels.
    pub size: [u32; 4],
    /// Width and height of the picture in pixels, depth of the last slice's end and height of the medium in metres, 0 for an even one.
    pub picture: [f32; 4],
    /// Eye in metres, at the middle of a parallel camera's picture, and the height above which the medium thins.
    pub eye: [f32; 4],
    /// Its change per unit of ndc x; then extinction per metre.
    pub eye_per_x: [f32; 4],
    /// Its change per unit of ndc y; then the share of light that is scattered of what is stopped.
    pub eye_per_y: [f32; 4],
    /// World direction through the picture's middle, of length 1 along the view; then g.
    pub ray: [f32; 4],
    /// Its change per unit of ndc x.
    pub ray_per_x: [f32; 4],
    /// Its change per unit of ndc y.
    pub ray_per_y: [f32; 4],
    /// View depth of a depth d of the picture, `(x − d·z)/(d·w − y)`.
    pub by_depth: [f32; 4],
}

impl FogNumbers {
    /// Of a view without jitter, in a scene of those bounds.
    pub fn new(
        fog: &Fog,
        camera: &SceneCamera,
        view: &ShadeView,
        size: [u32; 2],
        bounds_m: [[f32; 3]; 2],
    ) -> Self {
        let eye = Vec3::from(camera.eye_m);
        let forward = (Vec3::from(camera.target_m) - eye).normalize_or(Vec3::NEG_Z);
        let [low, high] = bounds_m.map(Vec3::from);
        // As far in all directions, so that the sky stays as it is when the camera turns.
        let farthest = (eye - low).abs().max((eye - high).abs()).length();
        let far_m = farthest.max(f32::MIN_POSITIVE);
        let [eye_per_x, eye_per_y] = match camera.orthographic_half_height_m {
            None => [Vec3::ZERO; 2],
            Some(half_m) => {
                let right = forward.cross(camera.up.into()).normalize_or(Vec3::X);
                let aspect = size[0] as f32 / size[1] as f32;
                [right * half_m * aspect, right.cross(forward) * half_m]
            }
        };
        let projection = view.projection().as_dmat4();
        let at = |depth: f64| projection * (eye.as_dvec3() + forward.as_dvec3() * depth).extend(1.0);
        let (start, end) = (at(0.0), at(1.0));
        let with = |xyz: Vec3, w: f32| xyz.extend(w).to_array();
        let three = |[x, y, z, _]: [f32; 4]| Vec3::new(x, y, z);
        Self {
            size: [size[0].div_ceil(SIDE), size[1].div_ceil(SIDE), SLICES, SIDE],
            picture: [size[0] as f32, size[1] as f32, far_m, fog.height_m.unwrap_or(0.0)],
            eye: with(eye, low.y),
            eye_per_x: with(eye_per_x, fog.per_m),
            eye_per_y: with(eye_per_y, fog.albedo),
            ray: with(three(view.ray), fog.g),
            ray_per_x: view.ray_per_x,
            ray_per_y: with(three(view.ray_per_y), 0.0),
            by_depth: [start.z, end.z - start.z, start.w, end.w - start.w].map(|number| number as f32),
        }
    }

    /// Froxels.
    pub fn froxels(&self) -> usize {
        self.size[..3].iter().map(|along| *along as usize).product()
    }
}

#[cfg(test)]
mod tests;
