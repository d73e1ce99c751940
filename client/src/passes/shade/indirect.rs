//! Indirect light as the shading pass reads it: a snippet of WGSL with its bindings, and the twin on the processor.

use glam::Vec3;

use super::{LIGHTS, SHADER, ShadeView, Surface, UNMOVED, UNWALKED, WALKED};
use crate::passes::transfer::PIXELS;

/// Indirect light on the processor.
pub trait IndirectIrradiance: Sync {
    /// Work that a view of `size` (width and height in pixels) asks for before it is shaded; nothing for light that looks
    /// the same from everywhere.
    fn prepare_view(&mut self, view: &ShadeView, size: [u32; 2]) {
        let _ = (view, size);
    }

    /// Irradiance at a surface that did not come straight from a light, W·m⁻²: about `surface.towards` where the kind knows light by
    /// directions, else about its normal.
    fn indirect_irradiance(&self, surface: &Surface) -> Vec3;

    /// Mean radiance over all directions at a point in free space, but for what comes straight from a light, in W·m⁻²·sr⁻¹: a medium
    /// scatters it. None of a kind without probes in free space.
    fn mean_radiance(&self, point: Vec3) -> Vec3 {
        let _ = point;
        Vec3::ZERO
    }
}

/// Indirect light on the adapter.
#[derive(Clone, Debug, PartialEq)]
pub struct Shading {
    /// Snippet with `fn indirect_irradiance(surface: Surface) -> Indirect`, joined behind `shade.wgsl`.
    pub snippet: &'static str,
    /// Kinds of its bindings, in group 1 from 1.
    pub bindings: Vec<wgpu::BindingType>,
}

impl Shading {
    /// The whole shader.
    pub fn shader(&self) -> String {
        [LIGHTS, UNMOVED, WALKED, SHADER, self.snippet].concat()
    }

    /// The whole shader where objects with bakes of their own change light.
    pub fn shader_with_objects(&self) -> String {
        [LIGHTS, PIXELS, WALKED, SHADER, self.snippet].concat()
    }

    /// The whole shader where nothing walks through voxels, as in browsers.
    pub fn shader_without_walks(&self) -> String {
        [LIGHTS, UNMOVED, UNWALKED, SHADER, self.snippet].concat()
    }
}
