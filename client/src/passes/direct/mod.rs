//! Irradiance from lights by shadow maps: at points, and of receivers as the mean over the points of their texels.

pub mod points;
mod rect;
pub mod reference;
mod texels;

pub use points::TexelPoints;
pub use texels::{PLACED_TEXELS_SHADER, TEXELS_SHADER, TexelNumbers, TexelsPass};

/// Largest difference from the reference on the same shadow maps, relative to the largest value, for all but
/// [`OUTLIERS`]: positions are projected in f32, and the filter's weights follow the projected position.
pub const TOLERANCE: f32 = 2e-3;
/// Share of points that may differ more: a texel's depth comparison can fall to either side by one rounding.
pub const OUTLIERS: f32 = 2e-3;
