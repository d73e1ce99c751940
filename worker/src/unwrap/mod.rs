//! Lightmap unwraps measured in texels of a set world size.
//!
//! A generated unwrap consists of planar charts on a **world-aligned texel lattice**: a chart is projected along
//! one axis, its in-plane axes come from the world's, and the lattice's origin is the world's. Placing a chart in
//! a block moves it by whole texels only (multiples of [`UnwrapSettings::lod_align_texels`]). Hence texels of
//! coplanar surfaces line up across meshes, a level of detail chosen from a texel's coordinates means the same
//! everywhere, and an edit of one mesh leaves the texels of all others where they were.
//!
//! Stages, each a file: `soup` welds and measures triangles, `adjacency` finds neighbours and hard edges,
//! `grow` forms charts, `overlap` keeps their projections from overlapping, `absorb` merges scraps into
//! neighbours, `cut` splits what no block can hold, `pack` places charts in blocks. `second_uv` adopts an
//! unwrap that came with the mesh.
//!
//! Everything runs in a fixed order on one thread: the same input gives the same bytes.

mod absorb;
mod adjacency;
mod cut;
mod frame;
mod grow;
mod lookup;
mod overlap;
mod pack;
mod paged_grid;
mod second_uv;
mod settings;
mod shelves;
mod skyline;
mod soup;

#[cfg(test)]
mod tests;

use glam::{Vec2, Vec3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::task::{Cancelled, Progress};
pub(crate) use lookup::weights_in_part;
pub use lookup::{TexelLocation, UnwrapLookup};
pub use second_uv::{Uv1Rejected, unwrap_from_second_uv};
pub use settings::UnwrapSettings;

/// Most texels that the surface of one instance, and all blocks of one instance, may have.
pub const MAX_INSTANCE_TEXELS: u64 = 64 << 20;

/// Largest distance of a vertex from the world origin, in texels, at which the lattice is still exact.
pub const MAX_LATTICE_TEXELS: f64 = 268_435_456.0;

/// A generated or adopted unwrap of one mesh instance.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Unwrap {
    /// Normally one; more when one would exceed [`UnwrapSettings::max_block_texels`] on a side. None when the
    /// instance has no triangle with an area.
    pub blocks: Vec<UnwrapBlock>,
}

impl Unwrap {
    /// Adds the unwrap of some of an instance's triangles, `members` in the order in which they were unwrapped.
    pub fn add_part(&mut self, part: Unwrap, members: &[u32]) {
        let charts = self.blocks.iter().flat_map(|block| &block.triangles).map(|triangle| triangle.chart + 1);
        let first_chart = charts.max().unwrap_or(0);
        for mut block in part.blocks {
            for triangle in &mut block.triangles {
                triangle.source_triangle = members[triangle.source_triangle as usize];
                triangle.chart += first_chart;
            }
            self.blocks.push(block);
        }
    }
}

/// A rectangle of texels that holds charts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnwrapBlock {
    /// Side of its texels in metres.
    pub texel_m: f32,
    /// Texels; a multiple of the level-of-detail alignment in a generated unwrap.
    pub width: u32,
    /// Texels; a multiple of the level-of-detail alignment in a generated unwrap.
    pub height: u32,
    /// By ascending source triangle.
    pub triangles: Vec<UnwrappedTriangle>,
}

/// Where a triangle of the mesh lies in its block.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnwrappedTriangle {
    /// Index into the instance's triangles.
    pub source_triangle: u32,
    /// Chart, numbered through all blocks of the instance.
    pub chart: u32,
    /// Corners in texel units: texel (x, y) covers `[x, x+1) × [y, y+1)`. Counter-clockwise like the triangle; in a
    /// generated unwrap slivers and detail below a texel may be collapsed or mirrored.
    pub uv_texels: [Vec2; 3],
    /// `None` for a whole triangle, the usual case. A chart too big for a block is cut along lattice lines, and so
    /// are its triangles: then the corners of this piece as weights of the source triangle's corners.
    pub piece_corners: Option<Box<[Vec3; 3]>>,
}

/// Why an instance cannot be unwrapped.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum UnwrapError {
    /// More texels than any instance may have.
    #[error("surface of {texels} texels at {texel_m} m each exceeds {limit}; raise the texel size")]
    TooLarge {
        /// Texels that the surface or its blocks would need.
        texels: u64,
        /// [`MAX_INSTANCE_TEXELS`].
        limit: u64,
        /// Texel size asked for.
        texel_m: f32,
    },
    /// A vertex lies where the lattice can no longer be told apart in `f32` positions.
    #[error(
        "triangle {triangle} lies {distance_m} m from the world origin, too far for texels of {texel_m} m"
    )]
    TooFar {
        /// First such triangle.
        triangle: u32,
        /// Its largest coordinate, in metres.
        distance_m: f32,
        /// Texel size asked for.
        texel_m: f32,
    },
    /// Nobody waits for it any more.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// A setting out of its range.
    #[error("unwrap setting {field}: {reason}")]
    BadSetting {
        /// Field of [`UnwrapSettings`].
        field: &'static str,
        /// The fault.
        reason: &'static str,
    },
}

/// Unwraps world-space triangles onto the world's texel lattice.
///
/// `normals` are shading normals, one per position; where they agree across an edge the edge is smooth however
/// coarse the tessellation. They may be empty: then hard edges are told from the triangles alone.
///
/// Every triangle with an area ends in exactly one chart. Triangles of zero area, with an index out of range or
/// with a vertex that is not finite are left out. Time is near-linear in triangles plus texels.
///
/// # Errors
/// [`UnwrapError::TooLarge`], [`UnwrapError::TooFar`] and [`UnwrapError::BadSetting`]; no mesh panics. And
/// [`UnwrapError::Cancelled`] soon after `progress` is.
pub fn unwrap_generated(
    positions_m: &[Vec3],
    normals: &[Vec3],
    triangles: &[[u32; 3]],
    settings: &UnwrapSettings,
    progress: &Progress,
) -> Result<Unwrap, UnwrapError> {
    settings.check()?;
    let soup = soup::Soup::new(positions_m, triangles);
    soup.check_limits(settings)?;
    let adjacency = adjacency::Adjacency::new(&soup, normals, triangles, settings);
    let mut charts = grow::grow_charts(&soup, &adjacency, settings, progress)?;
    absorb::absorb_scraps(&soup, &adjacency, settings, &mut charts, progress)?;
    let pieces = cut::pieces_of_charts(&soup, &charts, settings, progress)?;
    pack::pack_blocks(pieces, settings, progress)
}
