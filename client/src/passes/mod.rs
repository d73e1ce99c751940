//! The steps of a frame: shadow maps → direct → patches → basis → near → walked → reconstruct → lod → change → atlas → shade → fog;
//! for a window also meter → show.
//!
//! Each pass is a folder: the shader, its caller, and `reference.rs`, which does the same on the processor over the same
//! arrays. `TOLERANCE` bounds the difference between the two, and a test holds them to it.

pub mod around;
pub mod atlas;
pub mod basis;
pub mod change;
pub mod compare;
pub mod direct;
pub mod fog;
pub mod gpu;
pub mod landings;
pub mod lod;
pub mod meshes;
pub mod meter;
pub mod near;
mod overheard;
pub mod patches;
pub mod place;
pub mod reconstruct;
pub mod resident;
mod room;
pub mod shade;
pub mod shadow;
pub mod show;
pub mod stopwatch;
pub mod transfer;
pub mod walk;
pub mod walked;

/// Shaders of the passes that stand alone: name, as a file has it, and whole source. The shading pass' is [`shade::Shading::shader`].
pub const SHADERS: &[(&str, &str)] = &[
    ("atlas", atlas::SHADER),
    ("basis", basis::SHADER),
    ("change", change::SHADER),
    ("direct-texels", direct::TEXELS_SHADER),
    ("lod-fill", lod::FILL_SHADER),
    ("lod-mark", lod::MARK_SHADER),
    ("meter", meter::SHADER),
    ("near", near::SHADER),
    ("near-lit", near::LIT_SHADER),
    ("panorama", shade::PANORAMA_SHADER),
    ("patches", patches::SHADER),
    ("reconstruct", reconstruct::SHADER),
    ("shadow", shadow::SHADER),
    ("shadow-panes", shadow::PANES_SHADER),
    ("show", show::SHADER),
];
