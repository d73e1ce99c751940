//! Transfer volumes: what each part of an object covers, as seen from the points around it (\[Giuffrida2016\] stores light instead). A moving
//! object then changes the irradiance of what is near it: its own radiance comes in place of what it hides.
//!
//! ```text
//! F_p(x) = ∫ ω dω, Ω_p(x) = ∫ dω     over the directions in which x sees part p of the object first
//! ΔE(x, n) = v Σ_p (n·F_p)₊ (λ_p − L_p)
//! ```
//! λ_p is the mean radiance of the part, L_p that of the directions which it hides, and v whether x is seen from the object. F_p and Ω_p hang
//! on shape alone: no light, no colour and no place in a scene is in them.

mod chunk;
mod content;
mod hidden;
mod lattice;
mod surroundings;
mod table;
mod viewpoints;

#[cfg(test)]
mod tests;

pub use chunk::{NEAREST, ROW, TRANSFER_CHUNK, decode_transfer, encode_transfer};
pub use content::{
    GLOWS_MAX, LEVELS, NODES_MAX, NODES_MIN, PARTS_MAX, PATCHES_MAX, PartGlow, PartPatch, TransferLevel,
    TransferPart, node_codes,
};
pub use hidden::{HIDDEN_SIDE, HIDDEN_WIDTHS, Hidden, NARROWEST, RIM, hidden_axes, hidden_cosine};
pub use lattice::{Axis, FADE_H, Lattice, REACH_H};
pub use surroundings::{Surroundings, WALKS_OF_PART, directions_of_walks, tangent_of_walks};
pub use table::{Cap, Covered, PartRadiance, Standing, TransferTable};
pub use viewpoints::{VIEWPOINTS_A_SIDE, ViewpointLattice, Viewpoints};

/// Role of the chunks of volumes, the coarsest first.
pub const TRANSFER: &str = "transfer";
