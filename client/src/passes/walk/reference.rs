//! Walks of a picture on the processor.

use glam::{Vec3, Vec4};
use lightkiln_proto::voxels::{
    Bundle, IRRADIANCE_WALKS, OCCLUSION_WALKS, REFLECTION_WALKS, Seen, Start, WalkLight, ambient_occlusion,
    irradiance, reflection, walk,
};
use rayon::prelude::*;

use super::Walks;
use crate::passes::shade::specular::Gloss;
use crate::passes::shade::{ShadeView, Surface};

/// Walks of the pixels of a sample.
#[derive(Clone, Copy, Debug)]
pub struct Walked<'a> {
    /// Light of the elements.
    pub light: &'a WalkLight<'a>,
    /// Parts that walks make.
    pub walks: Walks,
    /// Columns of the picture.
    pub width: u32,
    /// Identity of the sample, see [`super::sample_identity`].
    pub turn: u32,
}

/// What the walks of a pixel find.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// Mean radiance of what is reflected; `None` without walks for it.
    pub reflected: Option<Vec3>,
    /// Share that is open; 1 without walks for it.
    pub open: f32,
    /// Irradiance; `None` without walks for it.
    pub irradiance: Option<Vec3>,
}

impl Found {
    /// No walks.
    pub const NOTHING: Self = Self { reflected: None, open: 1.0, irradiance: None };
}

impl Walked<'_> {
    /// At a surface in a pixel.
    pub(in crate::passes) fn at(&self, [x, y]: [u32; 2], surface: &Surface, gloss: &Gloss) -> Found {
        let Self { light, walks, width, turn } = self;
        let (table, start) = (light.table(), Start::on(surface.position, surface.facet));
        let identity = (x + width * y).wrapping_add(*turn);
        let normal = surface.towards;
        let radiance = |seen: &Seen| light.radiance(seen);
        let reflected = (walks.reflections && gloss.is_specular()).then(|| {
            let bundle = Bundle::new(REFLECTION_WALKS, identity);
            reflection(table, &start, (normal, gloss.eye, gloss.alpha), &bundle, radiance)
        });
        let open = walks.occlusion_m.map_or(1.0, |reach_m| {
            ambient_occlusion(table, &start, normal, &Bundle::new(OCCLUSION_WALKS, identity), reach_m)
        });
        let irradiance = walks
            .irradiance
            .then(|| irradiance(table, &start, normal, &Bundle::new(IRRADIANCE_WALKS, identity), radiance));
        Found { reflected, open, irradiance }
    }
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
