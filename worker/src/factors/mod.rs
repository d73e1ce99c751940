//! From rows to factorised clusters: cells by place, groups that share columns, factors, halves where the rank does not
//! suffice, small ones joined, chunks. Shared by all kinds whose light comes to receivers through a matrix.

mod anew;
mod baked;
mod cells;
mod cluster;
mod components;
mod encode;
mod evaluated;
mod join;
mod patch_matrix;
mod split;
mod svd;

use lightkiln_proto::content::ClusterTransport;

use crate::task::{Cancelled, Progress};
use crate::transport::Row;

pub use baked::{Baked, Light, Threads, decoded};
pub use cells::{CELLS_ARTEFACT, ClusterCell, cell_names, cell_of_task, cells, cells_of_task, encoded_cells};
pub use components::components;
pub use encode::{CellIndex, encoded, stored, stored_as};
pub use evaluated::{ERROR_CLASSES, FactoredBake};
pub use join::Part;
pub use patch_matrix::{PatchMatrix, TruncationBounds};
pub use split::{Factored, Truncation, split};
pub use svd::{Factors, Matrix, factorise};

/// A factorised cluster and its errors.
#[derive(Clone, Debug)]
pub struct Piece {
    /// Contents of the chunk.
    pub transport: ClusterTransport,
    /// √(Σ_{i>k} s² / Σ s²) of the weighted matrix, or of its signal where its noise is known.
    pub truncation_error: f32,
    /// Upper bound of S1's own criterion, of the weighted matrix.
    pub s1_criterion_bound: f32,
    /// Share of `lit` whose light no column carries rightly.
    pub uncovered_fraction: f32,
}

/// The transport matrix of some receivers.
pub struct CellRows {
    /// Identity of each group of columns, ascending; the sky's group follows where the sky has no keys.
    pub keys: Vec<u64>,
    /// One row per receiver, in order.
    pub rows: Vec<Row>,
}

/// Fineness of columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// As the bake has it.
    AsBaked,
    /// As finely as the kind can: the bake's own choice of columns approximates it.
    Finest,
}

/// A kind's transport from its columns to receivers.
pub trait Transport: Send + Sync {
    /// Traces the rows of some receivers of one cell.
    fn rows(&self, receivers: &[u32], detail: Detail, progress: &Progress) -> Result<CellRows, Cancelled>;

    /// Traces a cell and factorises it, in a fixed order.
    fn pieces(&self, cell: &ClusterCell, progress: &Progress) -> Result<(Vec<Piece>, CellIndex), Cancelled>;
}
