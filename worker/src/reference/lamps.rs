//! All light sources of a traced scene.

use super::emitters::Emitters;
use super::lighting::{Lighting, LightingError};
use super::panel::Panel;
use super::punctual::Punctual;
use super::sky::Sky;
use crate::geometry::Geometry;

/// Light sources, ready to be sampled.
#[derive(Clone, Debug)]
pub(super) struct Lamps {
    pub punctual: Vec<Punctual>,
    pub panels: Vec<Panel>,
    pub sky: Sky,
    pub emitters: Emitters,
}

impl Lamps {
    pub fn new(geometry: &Geometry, lighting: &Lighting) -> Result<Self, LightingError> {
        lighting.check()?;
        Ok(Self {
            punctual: lighting.lights.iter().filter_map(Punctual::new).collect(),
            panels: lighting.panels.iter().filter_map(Panel::new).collect(),
            sky: Sky::of(&lighting.lights),
            emitters: Emitters::new(geometry, lighting.emitter_scale),
        })
    }
}
