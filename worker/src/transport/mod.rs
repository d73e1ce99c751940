//! Rows of the transport matrix, as kinds gather them: cosine-distributed rays of receivers with emitters beside them, and
//! sums of any rays' hits over surface patches.

mod cut;
mod expectation;
mod hemisphere;
mod patch_rows;

pub use cut::{FINE_LEVEL, stepped_area};
pub use hemisphere::{Hemisphere, HemisphereRay, Surroundings};
pub use patch_rows::{CutBounds, Met, PatchRow, PatchRows, RayHit, RowHits, Sources, patch_rows};

/// Free path, in texels, below which a place that no light can reach misses nothing: the inside of a column, say.
pub const DEAD_PATH_TEXELS: f32 = 4.0;

/// One receiver's row, and what became of its rays.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Row {
    /// α, in the order of the columns' keys; then the sky's coefficients, where the sky has no keys.
    pub alpha: Vec<f32>,
    /// Irradiance straight from each emitter of the scene, W·m⁻².
    pub emitters: Vec<[f32; 3]>,
    /// Rays that light can come along: those to the sky, and those to surfaces, by weights of the kind's.
    pub lit: f32,
    /// The part of `lit` whose light no column carries rightly.
    pub uncovered: f32,
    /// The part of `uncovered` that is left out altogether.
    pub left_out: f32,
    /// Mean length of the rays that met something, in metres.
    pub mean_path_m: f32,
}

impl Row {
    /// No column and no emitter gives it any light.
    pub fn is_dark(&self) -> bool {
        self.alpha.iter().all(|alpha| *alpha == 0.0) && self.emitters.iter().flatten().all(|e| *e == 0.0)
    }

    /// Takes over the hemisphere's own findings.
    pub fn add_surroundings(&mut self, found: Surroundings) {
        (self.emitters, self.mean_path_m) = (found.emitters, found.mean_path_m);
    }
}

#[cfg(test)]
mod tests;
