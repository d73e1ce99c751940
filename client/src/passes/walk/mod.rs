//! Walks through voxels in pictures: reflections, ambient occlusion, indirect light of walks, and what walks from the eye meet.

/// `fn walk` and all that it needs.
macro_rules! walks_source {
    () => {
        concat!(
            include_str!("../shared/octahedral.wgsl"),
            include_str!("../walk/table.wgsl"),
            include_str!("../walk/path.wgsl"),
            include_str!("../walk/candidates.wgsl"),
            include_str!("../walk/walk.wgsl")
        )
    };
}

pub(in crate::passes) use walks_source;

mod pass;
pub mod reference;
#[cfg(test)]
mod tests;

pub use pass::{WalkNumbers, WalkPass, WalkPixels, WalkTable, walked_texture};

/// The shader of walks of pixels, and of pictures of what walks from the eye meet.
pub const SHADER: &str = concat!(
    include_str!("../shade/view.wgsl"),
    walks_source!(),
    include_str!("seen.wgsl"),
    include_str!("cones.wgsl"),
    include_str!("pixels.wgsl")
);

/// Parts of a picture that are made by walks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Walks {
    /// What surfaces reflect as their roughness says is that of walks, of bakes that have voxels.
    pub reflections: bool,
    /// Reach R of ambient occlusion in metres, by which indirect light is multiplied; none without.
    pub occlusion_m: Option<f32>,
    /// Indirect light of surfaces is that of walks, not of the bake.
    pub irradiance: bool,
    /// The picture is what walks from the eye meet, with no mesh.
    pub eye: bool,
    /// Pixels along a side of those that walks are of: 1 all, 2 a quarter. On the adapter; the processor walks from all.
    pub step: u32,
}

impl Default for Walks {
    fn default() -> Self {
        Self { reflections: true, occlusion_m: None, irradiance: false, eye: false, step: 1 }
    }
}

impl Walks {
    /// Bit of reflections in [`Walks::parts`]; twin of the shaders'.
    pub const REFLECTIONS: u32 = 1;
    /// Of occlusion.
    pub const OCCLUSION: u32 = 2;
    /// Of irradiance.
    pub const IRRADIANCE: u32 = 4;

    /// Some are asked for that only bakes with voxels have.
    pub fn asks_for_voxels(&self) -> bool {
        self.occlusion_m.is_some() || self.irradiance || self.eye
    }

    /// Parts of light at pixels, a bit each.
    pub fn parts(&self) -> u32 {
        let bit = |is: bool, bit: u32| if is { bit } else { 0 };
        bit(self.reflections, Self::REFLECTIONS)
            | bit(self.occlusion_m.is_some(), Self::OCCLUSION)
            | bit(self.irradiance, Self::IRRADIANCE)
    }

    /// What is wrong with it, if anything.
    pub fn problem(&self) -> Option<&'static str> {
        if self.occlusion_m.is_some_and(|reach_m| !(reach_m.is_finite() && reach_m > 0.0)) {
            return Some("a reach of ambient occlusion is more than 0 m");
        }
        (!(1..=4).contains(&self.step)).then_some("walks are of each, or of every second to fourth, pixel")
    }
}

/// Identity of a sample of a picture, whose pixels' directions it shifts: that of its jitter.
pub fn sample_identity(jitter: [f32; 2]) -> u32 {
    jitter.iter().fold(0, |hash: u32, at| (hash ^ at.to_bits()).wrapping_mul(0x9e37_79b1).rotate_left(13))
}
