//! The picture: every pixel's radiance, with direct light per pixel and indirect light from the bake's kind.

mod gpu;
mod indirect;
pub mod lamps;
mod looks;
mod normals;
mod objects;
mod panes;
mod panorama;
mod pipelines;
pub mod reference;
pub mod specular;
mod starts;
pub mod surface;
mod view;

pub use gpu::ShadePass;
pub use indirect::{IndirectIrradiance, Shading};
pub use looks::{ShadeDraw, details_of};
pub use objects::ObjectShading;
pub use panorama::{PANORAMA_SHADER, PanoramaNumbers};
pub use starts::StartTextures;
pub use surface::Surface;
pub use view::{ShadeView, SurfaceDetails};

/// The shader's part before [`WALKED`] or [`UNWALKED`], and [`SHADER`].
const LIGHTS: &str = concat!(
    include_str!("../shared/light.wgsl"),
    include_str!("../shared/rect.wgsl"),
    include_str!("../shared/shadow_map.wgsl"),
    include_str!("../shared/glass.wgsl"),
    include_str!("../shared/octahedral.wgsl"),
    include_str!("view.wgsl"),
    include_str!("normals.wgsl"),
    include_str!("specular.wgsl"),
    include_str!("lamps.wgsl")
);
/// Light that walks found, with its bindings; and the part that stands for it where nothing walks.
const WALKED: &str = include_str!("walked.wgsl");
const UNWALKED: &str = include_str!("unwalked.wgsl");
/// Stands for what objects change where none has a bake of its own.
const UNMOVED: &str = concat!(include_str!("../shared/whole_maps.wgsl"), include_str!("unmoved.wgsl"));
/// The shader; [`Shading::shader`] adds indirect light.
const SHADER: &str = concat!(include_str!("shade.wgsl"), include_str!("start.wgsl"));
/// Largest difference from the reference, relative to the picture's mean, for all but [`OUTLIERS`]: adapters read
/// textures with 8-bit weights and derive facet normals and mip levels from neighbouring pixels.
pub const TOLERANCE: f32 = 2e-2;
/// Share of pixels that may differ more: outlines, and shadow edges seen through another rounding.
pub const OUTLIERS: f32 = 1e-2;
