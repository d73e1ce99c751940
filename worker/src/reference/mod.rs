//! The reference: a unidirectional path tracer over the same triangles and materials as the bake, which bakes are held
//! against.
//!
//! ```text
//! E(x) = ∫_H L(ω) K(ω) dω        L(y) = Lₑ(y) + ρ(y)/π · E(y)        K(ω) = max(0, n·ω) + max(0, n·ω')
//! ```
//! ω' is ω mirrored at the face: where the shading normal n leans, directions below the face are mirrored above it, as in
//! the bake, so K is cosθ wherever the two normals agree. Lamps (punctual lights, rectangles, emissive triangles) count by
//! max(0, n·ω) alone, as in any renderer. Each vertex samples its lamps and the sky (next-event estimation) and one
//! direction with density K/π; the two are joined by the balance heuristic (\[Veach1995\]). Lamps without extent (points,
//! spots, suns) are met by no ray; surfaces that they light are found by directions, and by rays of the lamp along which
//! light was found to come before (`guide.rs`), joined likewise. Paths end by Russian roulette, which changes no mean.
//!
//! The material model is METHOD.md §1's, so that error means error: diffuse albedo below 1, alpha-masked texels let rays
//! through, glass lets a share of them through (rays towards lamps carry the product of shares, others pass or stop by
//! chance), a double-sided face is lit on the side that is met, the back of a single-sided one blocks light and returns
//! none. Nothing here knows of probes, texels or clusters.
//!
//! Random numbers come from the position or the pixel that they serve, sums run in f64 in a fixed order: the result is
//! the same on any number of threads.

mod beams;
mod emitters;
mod guide;
mod irradiance;
mod lamps;
mod learn;
mod lighting;
mod neighbours;
mod panorama;
mod path;
mod picture;
mod punctual;
mod rect;
mod sky;
mod tally;
#[cfg(test)]
mod tests;

use std::sync::OnceLock;

use crate::geometry::Geometry;

pub use crate::geometry::Site;
pub use irradiance::{IrradianceEstimate, Precision, Target};
pub use lighting::{Lighting, LightingError};
pub use picture::{EyeSurface, PictureSize, TracedPicture, camera_ray};
pub use tally::{Estimate, luminance};

use guide::Guide;
use lamps::Lamps;

/// Technique by which emitters, rectangles, the sky and what lamps without extent light are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Strategy {
    /// By both of the following, each weighted by the balance heuristic.
    #[default]
    Both,
    /// By sampling emitters, rectangles and the sky alone; what lamps light, by directions.
    Lamps,
    /// By directions with density K/π alone.
    Directions,
}

impl Strategy {
    /// Weight of a sample of density `own` that the other technique takes with density `other`, `from_lamps` telling
    /// which of the two it is.
    fn weight(self, from_lamps: bool, own: f64, other: f64) -> f64 {
        match self {
            Self::Both if own > 0.0 => own / (own + other),
            Self::Both => 0.0,
            Self::Lamps => f64::from(u8::from(from_lamps)),
            Self::Directions => f64::from(u8::from(!from_lamps)),
        }
    }
}

/// A scene under some light, ready to be traced.
pub struct Reference<'a> {
    geometry: &'a Geometry,
    lamps: Lamps,
    strategy: Strategy,
    /// A distance that leaves the scene from anywhere in it, in metres.
    far_m: f32,
    /// Learned when first it is needed.
    guide: OnceLock<Guide>,
}

impl<'a> Reference<'a> {
    /// Checks the lights and finds the scene's own emitters.
    ///
    /// Errors with the first light that has a number out of range.
    pub fn new(geometry: &'a Geometry, lighting: &Lighting) -> Result<Self, LightingError> {
        let lamps = Lamps::new(geometry, lighting)?;
        let far_m = 2.0 * geometry.diagonal_m() + 1.0;
        Ok(Self { geometry, lamps, strategy: Strategy::default(), far_m, guide: OnceLock::new() })
    }

    /// The same with another way to find lamps; all give the same mean.
    #[must_use]
    pub fn with_strategy(mut self, strategy: Strategy) -> Self {
        self.strategy = strategy;
        self
    }
}
