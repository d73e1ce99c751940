//! Depth of the scene as its lights see it, and the share of their light that passes its glass.

mod gpu;
pub(in crate::passes) mod look_up;
mod panes;
mod plan;
pub mod reference;
mod sights;

pub use gpu::{Mask, ShadowPass};
pub(in crate::passes) use gpu::{cleared_depth, nearer_wins};
pub use panes::Pane;
pub(in crate::passes) use panes::tested_alone;
pub use plan::{Eye, Face, Light, LightCount, MAX_SIDE, MIN_SIDE, RECT_FACES, ShadowPlan, ShadowRoom};
pub use sights::{EMITTER_POINTS, SIGHT_SIDE, SightPlaces};

/// The shader.
pub const SHADER: &str = include_str!("shadow.wgsl");
/// The shader of glass.
pub const PANES_SHADER: &str = concat!(include_str!("../shared/glass.wgsl"), include_str!("panes.wgsl"));
/// Largest difference of depth from the reference for all but [`OUTLIERS`], relative to the depth: interpolation on
/// triangles seen at a grazing angle magnifies the rounding of positions.
pub const TOLERANCE: f32 = 1e-3;
/// Share of texels that may differ more: at outlines the fill rule can fall to either side.
pub const OUTLIERS: f32 = 5e-3;
