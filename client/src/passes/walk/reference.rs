//! Walks of a picture on the processor.

use glam::{Vec3, Vec4};
use lightkiln_proto::kinds::voxels::{
    Bundle, IRRADIANCE_WALKS, OCCLUSION_WALKS, Seen, Start, WalkLight, ambient_occlusion, irradiance, walk,
};
use rayon::prelude::*;

use super::Walks;
use crate::passes::shade::{IndirectIrradiance, ShadeView, Surface};

/// Indirect light of a bake as walks change it.
pub struct Walked<'a> {
    /// Of the bake.
    pub indirect: Box<dyn IndirectIrradiance + 'a>,
    /// Light of its elements.
    pub light: &'a WalkLight<'a>,
    /// Parts that walks make.
    pub walks: Walks,
}

impl IndirectIrradiance for Walked<'_> {
    fn prepare_view(&mut self, view: &ShadeView, size: [u32; 2]) {
        self.indirect.prepare_view(view, size);
    }

    fn indirect_irradiance(&self, surface: &Surface) -> Vec3 {
        let (table, start) = (self.light.table(), Start::on(surface.position, surface.facet));
        let bundle = |walks: u32| Bundle::new(walks, identity(surface.position));
        let found = if self.walks.irradiance {
            let bundle = bundle(IRRADIANCE_WALKS);
            irradiance(table, &start, surface.normal, &bundle, |seen| self.light.radiance(seen))
        } else {
            self.indirect.indirect_irradiance(surface)
        };
        let open =
            |reach_m| ambient_occlusion(table, &start, surface.normal, &bundle(OCCLUSION_WALKS), reach_m);
        found * self.walks.occlusion_m.map_or(1.0, open)
    }

    fn mean_radiance(&self, point: Vec3) -> Vec3 {
        self.indirect.mean_radiance(point)
    }
}

/// Identity of a point, by which its directions are shifted.
fn identity(position: Vec3) -> u32 {
    position
        .to_array()
        .iter()
        .fold(0, |hash, axis| (hash ^ axis.to_bits()).wrapping_mul(0x9e37_79b1).rotate_left(13))
}

/// Radiance along the rays of a view's pixels, row after row: that of the elements that walks half a pixel wide meet, alpha 1; or of
/// the sky, alpha 0.
pub fn seen(light: &WalkLight<'_>, view: &ShadeView, size: [u32; 2]) -> Vec<Vec4> {
    let pixels = size[0] as usize * size[1] as usize;
    let of_pixel = |index: usize| {
        let at = [(index as u32 % size[0]) as f32 + 0.5, (index as u32 / size[0]) as f32 + 0.5];
        let (eye_m, direction, tangent) = view.ray_of_pixel(at, size);
        match walk(light.table(), &Start::free(eye_m), direction, tangent) {
            Some(hit) => light.radiance(&Seen::Hit(hit)).extend(1.0),
            None => light.of_sky(direction).extend(0.0),
        }
    };
    (0..pixels).into_par_iter().map(of_pixel).collect()
}
