//! Rows and factors made anew by the code of the transport tasks, to tell the classes of error apart; each is measured with
//! the same λ.
//!
//! ```text
//! transport       Σ α λ, α full-precision and full-rank  against the reference       at sampled receivers
//! factorisation   U (ΣVᵀ) λ in f32 at the bake's rank     against Σ α λ               at all receivers of some cells
//! quantisation    the decoded chunk's U (ΣVᵀ) λ           against U (ΣVᵀ) λ in f32    at the same
//! ```
//! Σ α λ is over the finest columns of the basis: the bake's own choice of columns is a part of the factorisation. The light
//! of near hits is the same in all three, as the chunk has it: its error is in that of transport.

use std::collections::BTreeMap;

use glam::DVec3;
use lightkiln_proto::content::{BlockKey, Texel};
use lightkiln_proto::prt::reconstruct::Rgb;
use rayon::prelude::*;

use super::baked::{Baked, Place, Settled, names, reconstructed};
use super::{CellRows, ClusterCell, Detail, Piece, Transport};
use crate::lightmap::Lightmap;
use crate::reference::luminance;
use crate::task::{Cancelled, Progress};
use crate::transport::Row;

/// Rows and factors made anew.
pub struct Anew {
    /// Row of each sampled receiver.
    rows: Vec<CellRows>,
    cells: Vec<CellAnew>,
}

/// A cluster cell made anew.
struct CellAnew {
    /// Ascending.
    receivers: Vec<u32>,
    rows: CellRows,
    pieces: Vec<Piece>,
}

impl Anew {
    /// Traces the rows of the sample, and all rows of `cells_max` cluster cells: those that hold every n-th receiver, so
    /// that a cell's chance is its share of the receivers.
    pub fn trace(
        transport: &dyn Transport,
        cells: &[ClusterCell],
        sample: &[u32],
        cells_max: usize,
        progress: &Progress,
    ) -> Result<Self, Cancelled> {
        let rows = sample
            .par_iter()
            .map(|&receiver| {
                progress.check()?;
                transport.rows(&[receiver], Detail::Finest, progress)
            })
            .collect::<Result<_, Cancelled>>()?;
        let cells = chosen_cells(cells, cells_max)
            .into_iter()
            .map(|index| CellAnew::trace(transport, &cells[index], progress))
            .collect::<Result<_, Cancelled>>()?;
        Ok(Self { rows, cells })
    }

    /// Cluster cells traced.
    pub fn cells(&self) -> usize {
        self.cells.len()
    }

    /// Clusters factorised.
    pub fn clusters(&self) -> usize {
        self.cells.iter().map(|cell| cell.pieces.len()).sum()
    }

    /// Full-rank E_ind of each sampled receiver; `near` is the light of its near hits.
    pub fn full_rank(&self, near: Vec<Rgb>, settled: &Settled, emitter_scale: f32) -> Vec<DVec3> {
        let of = |(found, near): (&CellRows, Rgb)| {
            full_rank(&found.rows[0], &found.keys, near, settled, emitter_scale)
        };
        self.rows.par_iter().zip(near).map(of).collect()
    }

    /// Root mean square errors of factorisation and of quantisation, W·m⁻² of luminance.
    pub fn factor_errors(
        &self,
        lightmap: &Lightmap,
        baked: &Baked,
        settled: &Settled,
        emitter_scale: f32,
    ) -> [f64; 2] {
        let mut squares = [0.0; 2];
        for cell in &self.cells {
            let of_cell = cell.squared_errors(lightmap, baked, settled, emitter_scale);
            squares = [0, 1].map(|class| squares[class] + of_cell[class] / self.cells.len() as f64);
        }
        squares.map(f64::sqrt)
    }
}

impl CellAnew {
    fn trace(transport: &dyn Transport, cell: &ClusterCell, progress: &Progress) -> Result<Self, Cancelled> {
        let (pieces, _) = transport.pieces(cell, progress)?;
        let rows = transport.rows(&cell.receivers, Detail::Finest, progress)?;
        Ok(Self { receivers: cell.receivers.clone(), rows, pieces })
    }

    /// Mean squared errors of both classes over the cell's live receivers.
    fn squared_errors(&self, lightmap: &Lightmap, baked: &Baked, settled: &Settled, scale: f32) -> [f64; 2] {
        let mut row_of: BTreeMap<(BlockKey, Texel), &Row> = BTreeMap::new();
        for (receiver, row) in self.receivers.iter().zip(&self.rows.rows) {
            row_of.insert(lightmap.name_of(*receiver), row);
        }
        let (mut sums, mut count) = ([0.0; 2], 0_u64);
        for piece in &self.pieces {
            let places = || names(&piece.transport).map(|name| baked.place(name.0, name.1));
            let near_of = |place: Option<Place>| place.map_or([0.0; 3], |(c, r)| settled.near_of(c, r));
            let near: Vec<Rgb> = places().map(near_of).collect();
            let by_factors = reconstructed(&piece.transport, settled, near.clone(), scale);
            for (((name, place), near), factored) in
                names(&piece.transport).zip(places()).zip(near).zip(&by_factors)
            {
                let Some(row) = row_of.get(&name) else { continue };
                let full = full_rank(row, &self.rows.keys, near, settled, scale);
                let decoded = place.map_or([0.0; 3], |(c, r)| settled.indirect[c][r]);
                sums[0] += (luminance(wide(*factored)) - luminance(full)).powi(2);
                sums[1] += (luminance(wide(decoded)) - luminance(wide(*factored))).powi(2);
                count += 1;
            }
        }
        sums.map(|sum| sum / count.max(1) as f64)
    }
}

/// `max(0, N + Σ_p Σ_j α_pj λ_pj + Σ_e s E_e)`, in f64.
fn full_rank(row: &Row, keys: &[u64], near: Rgb, settled: &Settled, emitter_scale: f32) -> DVec3 {
    let coefficients = row.alpha.len() / (keys.len() + 1);
    let mut sum = wide(near);
    let mut add = |alpha: &[f32], lambda: &[Rgb]| {
        for (alpha, lambda) in alpha.iter().zip(lambda) {
            sum += f64::from(*alpha) * wide(*lambda);
        }
    };
    let mut columns = row.alpha.chunks_exact(coefficients);
    for (&key, alpha) in keys.iter().zip(columns.by_ref()) {
        if let Some(lambda) = settled.lambda_of(key) {
            add(alpha, lambda);
        }
    }
    if let Some(alpha) = columns.next() {
        add(alpha, &settled.lambda_sky);
    }
    for emitter in &row.emitters {
        sum += wide(*emitter) * f64::from(emitter_scale);
    }
    sum.max(DVec3::ZERO)
}

/// Cells that hold every n-th receiver of all cells in order, each once.
fn chosen_cells(cells: &[ClusterCell], cells_max: usize) -> Vec<usize> {
    if cells.len() <= cells_max {
        return (0..cells.len()).filter(|&cell| !cells[cell].receivers.is_empty()).collect();
    }
    let total: usize = cells.iter().map(|cell| cell.receivers.len()).sum();
    let mut chosen = Vec::new();
    let (mut before, mut next) = (0, 0);
    for (index, cell) in cells.iter().enumerate() {
        before += cell.receivers.len();
        if next < cells_max && (2 * next + 1) * total < 2 * cells_max * before {
            chosen.push(index);
            while next < cells_max && (2 * next + 1) * total < 2 * cells_max * before {
                next += 1;
            }
        }
    }
    chosen
}

/// A colour in f64.
pub(super) fn wide(colour: Rgb) -> DVec3 {
    glam::Vec3::from(colour).as_dvec3()
}
