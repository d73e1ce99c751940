//! Walks through voxels in pictures: ambient occlusion, indirect light of walks, and what walks from the eye meet. On the processor
//! alone so far.

pub mod reference;

/// Parts of a picture that are made by walks.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Walks {
    /// Reach R of ambient occlusion in metres, by which indirect light is multiplied; none without.
    pub occlusion_m: Option<f32>,
    /// Indirect light of surfaces is that of walks, not of the bake.
    pub irradiance: bool,
    /// The picture is what walks from the eye meet, with no mesh.
    pub eye: bool,
}

impl Walks {
    /// There are some.
    pub fn any(&self) -> bool {
        self.occlusion_m.is_some() || self.irradiance || self.eye
    }
}
