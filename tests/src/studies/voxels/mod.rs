//! Voxel cone tracing as \[Drinovsky2013\] has it, beside walks through elements: an octree of bricks whose light is of six axes or of lobes, filtered upwards, and cones
//! through its levels. As written, and mended.
//!
//! ```text
//! diameter 2 l tan(α/2)    depth log₂(w_s/diameter)    I += (1−a) I_s,  a += α_s    I_s = Σ|ω_i| I_±i,  α_s = Σ|ω_i| α_i
//! ```
//! Mended: weights |ω_i|/Σ|ω_i|, opacities composited, filters that count all neighbours, starts two voxels off the surface, the sky in the share that is left, 1/π;
//! all surfaces of a voxel have their light.

mod brick;
mod build;
mod cone;
mod corner;
mod fill;
mod filter;
mod inject;
mod leaks;
mod measure;
mod pictures;
mod shade;
mod steps;
#[cfg(test)]
mod tests;
mod tree;

pub use build::Build;
pub use leaks::leaks;
pub use measure::{Options, measured};
pub use pictures::pictures;
pub use steps::steps;

/// The light of a voxel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Model {
    /// Light towards six axes.
    Axes,
    /// Albedo, incoming light, and lobes of normals and of directions to the light.
    Lobes,
}

/// How the paper's system is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Manner {
    /// As the paper has it.
    Written,
    /// All faults mended that are not of the model.
    Mended,
}

/// Places of samples along cones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sampling {
    /// As written: one sample a level in wide cones, a diameter apart in narrow ones. Mended: a diameter apart.
    #[default]
    Paper,
    /// One sample a level.
    Levels,
    /// A diameter apart.
    Diameters,
}

/// A model made in a manner.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kind {
    /// The light of its voxels.
    pub model: Model,
    /// How it is made.
    pub manner: Manner,
}

impl Model {
    /// Bytes of a node's bricks in the paper's format: 3³ corners of 4 B a value, of colour, opacity and six axes, or of those two, normal, direction and
    /// incoming light.
    pub fn node_bytes(self) -> usize {
        let values = match self {
            Self::Axes => 8,
            Self::Lobes => 5,
        };
        brick::BRICK * 4 * values
    }
}

impl Kind {
    /// All four.
    pub const ALL: [Self; 4] = [
        Self { model: Model::Axes, manner: Manner::Written },
        Self { model: Model::Axes, manner: Manner::Mended },
        Self { model: Model::Lobes, manner: Manner::Written },
        Self { model: Model::Lobes, manner: Manner::Mended },
    ];

    /// In words.
    pub fn words(self) -> String {
        let model = match self.model {
            Model::Axes => "axes",
            Model::Lobes => "lobes",
        };
        let manner = match self.manner {
            Manner::Written => "written",
            Manner::Mended => "mended",
        };
        format!("{model}, {manner}")
    }
}
