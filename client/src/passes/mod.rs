//! The steps of a frame: shadow maps → direct → relight or patches → basis → near → reconstruct → atlas → shade.
//!
//! Each pass is a folder: the shader, what calls it, and `reference.rs`, which does the same on the processor over the
//! same arrays. `TOLERANCE` says how far the two may differ, and a test holds them to it.

pub mod atlas;
pub mod basis;
pub mod compare;
pub mod direct;
pub mod gpu;
pub mod meshes;
pub mod near;
pub mod patches;
pub mod reconstruct;
pub mod relight;
pub mod resident;
pub mod shade;
pub mod shadow;

#[cfg(test)]
pub(crate) mod tests;

/// Every shader: name and whole source, as the adapter compiles it.
pub const SHADERS: &[(&str, &str)] = &[
    ("atlas", atlas::SHADER),
    ("basis", basis::SHADER),
    ("direct", direct::SHADER),
    ("near", near::SHADER),
    ("patches", patches::SHADER),
    ("reconstruct", reconstruct::SHADER),
    ("relight", relight::SHADER),
    ("shade", shade::SHADER),
    ("shadow", shadow::SHADER),
];
