//! Rows and factors made anew by the code of the transport tasks, to tell the classes of error apart; each is measured with
//! the same λ.
//!
//! ```text
//! transport       Σ α λ, α full-precision and full-rank  against the reference       at sampled receivers
//! factorisation   U (ΣVᵀ) λ in f32 at the bake's rank     against Σ α λ               at all receivers of some cells
//! quantisation    the decoded chunk's U (ΣVᵀ) λ           against U (ΣVᵀ) λ in f32    at the same
//! ```
//! Σ α λ is over the finest columns of the kind: the bake's own choice of columns is a part of the factorisation. The light
//! of near hits is the same in all three, as the chunk has it: its error is in that of transport.

use std::collections::BTreeMap;

use glam::{DVec3, Vec4};
use lightkiln_proto::content::{BlockKey, Texel};
use lightkiln_proto::relight::{ClusterTable, Columns, EmitterTable};
use rayon::prelude::*;

use super::baked::{Baked, Light, Threads};
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

    /// Full-rank E_ind of each sampled receiver, by its slot.
    pub fn full_rank<C: Columns>(
        &self,
        slots: &[Option<u32>],
        baked: &Baked<C>,
        light: &Light,
    ) -> Vec<DVec3> {
        let of = |(found, slot): (&CellRows, &Option<u32>)| {
            full_rank(&found.rows[0], &places(&found.keys, baked), *slot, baked, light)
        };
        self.rows.par_iter().zip(slots).map(of).collect()
    }

    /// Root mean square errors of factorisation and of quantisation, W·m⁻² of luminance.
    pub fn factor_errors<C: Columns>(
        &self,
        lightmap: &Lightmap,
        baked: &Baked<C>,
        light: &Light,
    ) -> [f64; 2] {
        let of_cells: Vec<[f64; 2]> =
            self.cells.par_iter().map(|cell| cell.squared_errors(lightmap, baked, light)).collect();
        let sum = |class: usize| of_cells.iter().map(|squares| squares[class]).sum::<f64>();
        [0, 1].map(|class| (sum(class) / of_cells.len().max(1) as f64).sqrt())
    }
}

impl CellAnew {
    fn trace(transport: &dyn Transport, cell: &ClusterCell, progress: &Progress) -> Result<Self, Cancelled> {
        let (pieces, _) = transport.pieces(cell, progress)?;
        let rows = transport.rows(&cell.receivers, Detail::Finest, progress)?;
        Ok(Self { receivers: cell.receivers.clone(), rows, pieces })
    }

    /// Mean squared errors of both classes over the cell's live receivers.
    fn squared_errors<C: Columns>(&self, lightmap: &Lightmap, baked: &Baked<C>, light: &Light) -> [f64; 2] {
        let names = self.receivers.iter().map(|&receiver| lightmap.name_of(receiver));
        let row_of: BTreeMap<(BlockKey, Texel), &Row> = names.zip(&self.rows.rows).collect();
        let places = places(&self.rows.keys, baked);
        let (mut sums, mut count) = ([0.0; 2], 0_u64);
        for piece in &self.pieces {
            let receivers = &piece.transport.receivers;
            let names = receivers.block.iter().zip(&receivers.texel);
            let names: Vec<(BlockKey, Texel)> =
                names.map(|(block, texel)| (receivers.blocks[usize::from(*block)], *texel)).collect();
            let slots: Vec<Option<u32>> =
                names.iter().map(|&(block, texel)| baked.transport.slots.slot_of(block, texel)).collect();
            let by_factors = factored(piece, &slots, baked, light);
            for ((name, slot), factored) in names.iter().zip(slots).zip(by_factors) {
                let full = full_rank(row_of[name], &places, slot, baked, light);
                let decoded = slot.map_or(Vec4::ZERO, |slot| light.settled.indirect(slot));
                sums[0] += (luminance(wide(factored)) - luminance(full)).powi(2);
                sums[1] += (luminance(wide(decoded)) - luminance(wide(factored))).powi(2);
                count += 1;
            }
        }
        sums.map(|sum| sum / count.max(1) as f64)
    }
}

/// Light of near hits at a slot, as the chunk has it.
fn near_of(slot: Option<u32>, light: &Light) -> Vec4 {
    slot.and_then(|slot| light.settled.near.get(slot as usize).copied()).unwrap_or(Vec4::ZERO)
}

/// E_emit + E_ind of a piece's receivers by its unquantised factors, under the λ of the decoded bake.
fn factored<C: Columns>(piece: &Piece, slots: &[Option<u32>], baked: &Baked<C>, light: &Light) -> Vec<Vec4> {
    let columns = &baked.transport.columns;
    let own = "a piece made anew has columns and emitters of its own bake";
    let table = ClusterTable::join([(&piece.transport.factors, slots.len())], columns).expect(own);
    let emitters =
        EmitterTable::join([(&piece.transport.emitters[..], slots.len())], light.emitter_scale.len());
    let b = table.basis(&Threads, &light.settled.lambda);
    let emit = emitters.expect(own).irradiance(slots.len(), &light.emitter_scale);
    let near: Vec<Vec4> = slots.iter().map(|&slot| near_of(slot, light)).collect();
    let ind = table.reconstruct(&Threads, &b, &near, Some(&emit));
    emit.into_iter().zip(ind).map(|(emit, ind)| emit + ind).collect()
}

/// Places of keys' carriers in λ, and that of the sky's; `None` of carriers that the bake lacks.
fn places<C: Columns>(keys: &[u64], baked: &Baked<C>) -> Vec<Option<u32>> {
    let columns = &baked.transport.columns;
    keys.iter().map(|&key| columns.index(key)).chain([columns.sky_index()]).collect()
}

/// `max(0, N + Σ_p Σ_j α_pj λ_pj + Σ_e s_e E_e)`, in f64.
fn full_rank<C: Columns>(
    row: &Row,
    places: &[Option<u32>],
    slot: Option<u32>,
    baked: &Baked<C>,
    light: &Light,
) -> DVec3 {
    let lambda = &light.settled.lambda;
    let coefficients = baked.transport.columns.coefficients();
    let mut sum = wide(near_of(slot, light));
    for (&place, alpha) in places.iter().zip(row.alpha.chunks_exact(coefficients)) {
        // A carrier that the bake lacks, as it was left out of its chunks, carries no light.
        let Some(place) = place else { continue };
        let lambda = &lambda[place as usize * coefficients..][..coefficients];
        for (alpha, lambda) in alpha.iter().zip(lambda) {
            sum += f64::from(*alpha) * wide(*lambda);
        }
    }
    for (emitter, scale) in row.emitters.iter().zip(&light.emitter_scale) {
        sum += glam::Vec3::from(*emitter).as_dvec3() * f64::from(*scale);
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
pub(super) fn wide(colour: Vec4) -> DVec3 {
    colour.truncate().as_dvec3()
}
