//! All light sources of a traced scene.

use super::beams::Beam;
use super::emitters::Emitters;
use super::lighting::{Lighting, LightingError};
use super::punctual::Punctual;
use super::rect::Rect;
use super::sky::Sky;
use crate::geometry::Geometry;

/// Light sources, ready to be sampled.
#[derive(Clone, Debug)]
pub(super) struct Lamps {
    pub punctual: Vec<Punctual>,
    /// Rays of each of `punctual`.
    pub beams: Vec<Beam>,
    pub rects: Vec<Rect>,
    pub sky: Sky,
    pub emitters: Emitters,
}

impl Lamps {
    pub fn new(geometry: &Geometry, lighting: &Lighting) -> Result<Self, LightingError> {
        lighting.check()?;
        let punctual: Vec<Punctual> = lighting.lights.iter().filter_map(Punctual::new).collect();
        let bounds_m = geometry.bounds_m();
        Ok(Self {
            beams: punctual.iter().map(|lamp| Beam::of(lamp, bounds_m)).collect(),
            punctual,
            rects: lighting.lights.iter().filter_map(Rect::new).collect(),
            sky: Sky::of(&lighting.lights, lighting.panorama.as_ref()),
            emitters: Emitters::new(geometry, lighting.emitter_scale),
        })
    }
}
