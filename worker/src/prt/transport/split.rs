//! From the rows of a cell to factorised clusters: components apart, split until the rank suffices.

use glam::Vec3;
use lightkiln_proto::prt::{
    BasisKind, ClusterTransport, EmitterIrradiance, PatchKey, ProbeKey, Receivers, Settings,
};
use lightkiln_proto::sh::band_of;

use rayon::prelude::*;

use super::alpha::Row;
use super::components::components;
use super::near::{self, NearHit};
use crate::prt::factor::{Factors, Matrix, factorise};
use crate::prt::prepare::halves;
use crate::prt::stage::{ClusterCell, Receiver};
use crate::prt::world::World;
use crate::rays::sampling::seed_of;

/// How many times its noise the square of a singular value must be to count: those of noise alone are above the mean, as
/// the decomposition looks for the largest.
const NOISE_FACTOR: f64 = 2.0;
/// Least share of a matrix that is taken for signal, in squares: of single rays nobody knows.
const SIGNAL_MIN: f64 = 1e-6;

/// A factorised cluster and how right it is.
#[derive(Clone, Debug)]
pub struct Piece {
    /// What the chunk will hold.
    pub transport: ClusterTransport,
    /// √(Σ_{i>k} s² / Σ s²) of the weighted matrix; with patches, of what is signal in it.
    pub truncation_error: f32,
    /// Upper bound of S1's own criterion, of the weighted matrix.
    pub s1_criterion_bound: f32,
    /// Share of `lit` that no probe sees.
    pub uncovered_fraction: f32,
}

struct Splitter<'a> {
    world: &'a World,
    settings: &'a Settings,
    /// What the groups of columns stand for, ascending; the sky's group follows.
    keys: &'a [ProbeKey],
    /// Ascending receiver indices of the cell, one per row.
    receivers: &'a [u32],
    rows: &'a [Row],
    /// With patches: what is truncated of each row, and the noise in it.
    weighed: [Vec<Vec<f32>>; 2],
}

/// Factorised clusters of a cell, in a fixed order.
pub fn pieces(
    world: &World,
    settings: &Settings,
    keys: &[ProbeKey],
    cell: &ClusterCell,
    rows: &[Row],
) -> Vec<Piece> {
    let weighed = match settings.basis {
        BasisKind::Sh => [(); 2].map(|()| Vec::new()),
        BasisKind::Patches => weighed(settings, keys, rows),
    };
    let splitter = Splitter { world, settings, keys, receivers: &cell.receivers, rows, weighed };
    // Dead receivers are left out: their texels are filled from their neighbours, which keeps edges from turning dark.
    let live: Vec<usize> = (0..rows.len()).filter(|&row| !rows[row].is_dead()).collect();
    let (links, linking) = splitter.links(&live);
    let parts: Vec<Vec<Piece>> = components(&links, linking)
        .into_par_iter()
        .map(|group| {
            let receivers = group.iter().map(|&index| cell.receivers[live[index]]).collect();
            splitter.pieces_of(ClusterCell { bounds_m: cell.bounds_m, receivers })
        })
        .collect();
    parts.into_iter().flatten().collect()
}

/// Index of the first key that stands for a part of the sky; all of them come last.
fn first_sky(settings: &Settings, keys: &[ProbeKey]) -> usize {
    match settings.basis {
        BasisKind::Sh => keys.len(),
        BasisKind::Patches => keys.partition_point(|&key| PatchKey(key).sky().is_none()),
    }
}

/// The rows' weighed values and their noise. The sky's columns count for no more than the others: where most of the
/// hemisphere is sky, the rest is what is seen when it is dark.
fn weighed(settings: &Settings, keys: &[ProbeKey], rows: &[Row]) -> [Vec<Vec<f32>>; 2] {
    let first_sky = first_sky(settings, keys) + 1;
    let mut weighed = [0, 1].map(|which: usize| rows.iter().map(|row| row.weighed[which].clone()).collect());
    let squares = |row: &[f32]| row.iter().map(|value| f64::from(*value).powi(2)).sum::<f64>();
    let of_patches: f64 = rows.iter().map(|row| squares(&row.weighed[0][..first_sky])).sum();
    let of_sky: f64 = rows.iter().map(|row| squares(&row.weighed[0][first_sky..])).sum();
    if of_patches > 0.0 && of_sky > of_patches {
        let scale = (of_patches / of_sky).sqrt() as f32;
        let all = weighed.iter_mut().flat_map(|rows: &mut Vec<Vec<f32>>| rows);
        all.flat_map(|row| &mut row[first_sky..]).for_each(|value| *value *= scale);
    }
    weighed
}

impl Splitter<'_> {
    /// The cell's cluster, or those of its halves where `rank_max` does not suffice.
    fn pieces_of(&self, cell: ClusterCell) -> Vec<Piece> {
        if cell.receivers.is_empty() {
            return Vec::new();
        }
        let settings = self.settings;
        let (matrix, columns) = self.matrix(&cell.receivers);
        let (factors, error_max) = match settings.basis {
            BasisKind::Sh => self.factors_of_probes(&matrix, &columns),
            BasisKind::Patches => self.factors_of_patches(&matrix, &cell.receivers),
        };
        let size = cell.bounds_m[1] - cell.bounds_m[0];
        let may_split = cell.receivers.len() > settings.split_receivers_min as usize
            && size.max_element() > self.world.stage.texel_m;
        if factors.truncation_error > error_max && may_split {
            let position_m = |receiver: u32| self.world.stage.receivers[receiver as usize].position_m;
            let [a, b] = halves(&cell, position_m);
            let (mut pieces, others) = rayon::join(|| self.pieces_of(a), || self.pieces_of(b));
            pieces.extend(others);
            return pieces;
        }
        vec![self.piece(&cell.receivers, &columns, factors)]
    }

    /// Factors of a matrix with columns weighted by band, and the error that it may have.
    fn factors_of_probes(&self, matrix: &Matrix, columns: &[u32]) -> (Factors, f32) {
        let error_max = self.settings.rank_error;
        let seeds = self.seeds(columns);
        let mut factors = factorise(matrix, self.settings.rank_max as usize, error_max, &seeds);
        self.unweigh(&mut factors.vt);
        (factors, error_max)
    }

    /// Factors of a matrix over patches: U of A L with a column for the sum, and ΣVᵀ = UᵀA, so that a cluster's energy is
    /// right under every light. The rank is the smallest for which what is left out of the signal is within what is
    /// set: noise, which the two halves of the rays do not share, is not worth a rank.
    fn factors_of_patches(&self, matrix: &Matrix, receivers: &[u32]) -> (Factors, f32) {
        let rows: Vec<usize> = receivers
            .iter()
            .map(|receiver| self.receivers.binary_search(receiver).unwrap_or_default())
            .collect();
        let [weighed, noise] = [0, 1].map(|which: usize| Matrix {
            rows: rows.len(),
            columns: self.keys.len() + 2,
            values: rows.iter().flat_map(|&row| &self.weighed[which][row]).copied().collect(),
        });
        let squares = |values: &[f32]| values.iter().map(|value| f64::from(*value).powi(2)).sum::<f64>();
        let rank_max = self.settings.rank_max as usize;
        let mut factors = factorise(&weighed, rank_max, 0.0, &self.weighed_seeds());
        if factors.rank == 0 {
            return (factors, self.settings.rank_error);
        }
        let values = squares(&weighed.values);
        let total = (values - squares(&noise.values)).max(SIGNAL_MIN * values);
        let columns = weighed.columns.max(1);
        let noise_of = factors.projected(&noise);
        let of_ranks: Vec<[f64; 2]> = factors
            .vt
            .chunks_exact(columns)
            .zip(noise_of.chunks_exact(columns))
            .map(|(values, noise)| [squares(values), squares(noise)])
            .collect();
        let known: f64 = of_ranks.iter().map(|[values, noise]| values - noise).sum();
        let mut left_out = (total - known).max(0.0);
        let allowed = f64::from(self.settings.rank_error).powi(2) * total;
        let mut rank = factors.rank;
        while rank > 0 {
            let [values, noise] = of_ranks[rank - 1];
            let signal = (values - NOISE_FACTOR * noise).max(0.0);
            if left_out + signal > allowed && rank < rank_max {
                break;
            }
            (left_out, rank) = (left_out + signal, rank - 1);
        }
        (factors.rank, factors.u) = factors.with_sum(rank, rows.len());
        factors.vt = factors.projected(matrix);
        factors.truncation_error = (left_out / total).sqrt() as f32;
        (factors, self.settings.rank_error)
    }

    fn row_of(&self, receiver: u32) -> &Row {
        let index = self.receivers.binary_search(&receiver).unwrap_or_default();
        &self.rows[index]
    }

    /// What rows have in common with others: column groups, and texels that are met close by, which have no columns; and the
    /// number of both.
    fn links(&self, live: &[usize]) -> (Vec<Vec<u32>>, usize) {
        let mut texels: Vec<u32> =
            self.rows.iter().flat_map(|row| &row.near).filter_map(NearHit::texel).collect();
        texels.sort_unstable();
        texels.dedup();
        let node = |texel: u32| Some((self.keys.len() + texels.binary_search(&texel).ok()?) as u32);
        let of_row = |&row: &usize| {
            let met = self.rows[row].near.iter().filter_map(NearHit::texel);
            let mut links = self.groups_used(&self.rows[row]);
            links.extend(met.chain([self.receivers[row]]).filter_map(node));
            links
        };
        (live.iter().map(of_row).collect(), self.keys.len() + texels.len())
    }

    /// Column groups but the sky's with anything in them: the sky is above rooms that have nothing else in common.
    fn groups_used(&self, row: &Row) -> Vec<u32> {
        let count = self.settings.coefficients();
        let used = |probe: &u32| {
            let from = *probe as usize * count;
            row.alpha[from..from + count].iter().any(|alpha| *alpha != 0.0)
        };
        let first_sky = first_sky(self.settings, self.keys);
        (0..first_sky as u32).filter(used).collect()
    }

    /// What a coefficient of band l of a radiance field is expected to be, against band 0: fields of a few edges fall
    /// off about so. We differ from METHOD's plain Frobenius norm: with columns weighted so, the truncation error is
    /// an error of irradiance, and the sampling noise of high bands does not ask for rank.
    fn expected(coefficient: usize) -> f32 {
        1.0 / (band_of(coefficient) + 1) as f32
    }

    /// ΣVᵀ of the weighted matrix to that of A itself.
    fn unweigh(&self, vt: &mut [f32]) {
        for coefficients in vt.chunks_exact_mut(self.settings.coefficients()) {
            coefficients.iter_mut().enumerate().for_each(|(j, value)| *value /= Self::expected(j));
        }
    }

    /// A of some receivers with weighted columns, only with columns that hold anything; columns as indices of groups, the sky's being
    /// `keys.len()`.
    fn matrix(&self, receivers: &[u32]) -> (Matrix, Vec<u32>) {
        let count = self.settings.coefficients();
        let groups = 0..=self.keys.len() as u32;
        let is_used = |group: &u32| {
            let range = *group as usize * count..(*group as usize + 1) * count;
            receivers.iter().any(|&r| self.row_of(r).alpha[range.clone()].iter().any(|alpha| *alpha != 0.0))
        };
        let columns: Vec<u32> = groups.filter(is_used).collect();
        let mut values = Vec::with_capacity(receivers.len() * columns.len() * count);
        for &receiver in receivers {
            let row = self.row_of(receiver);
            for &group in &columns {
                let alpha = &row.alpha[group as usize * count..(group as usize + 1) * count];
                values.extend(alpha.iter().enumerate().map(|(j, alpha)| alpha * Self::expected(j)));
            }
        }
        (Matrix { rows: receivers.len(), columns: columns.len() * count, values }, columns)
    }

    /// One seed per column, from the identity of what it stands for.
    fn seeds(&self, columns: &[u32]) -> Vec<u64> {
        let key = |group: u32| self.keys.get(group as usize).copied().unwrap_or(0);
        let count = self.settings.coefficients() as u64;
        columns.iter().flat_map(|&group| (0..count).map(move |j| seed_of(&[key(group), j, 5]))).collect()
    }

    /// One seed per weighed column, likewise.
    fn weighed_seeds(&self) -> Vec<u64> {
        let first_sky = first_sky(self.settings, self.keys);
        let common = |which: u64| seed_of(&[which, 6]);
        let mut seeds: Vec<u64> = self.keys.iter().map(|&key| seed_of(&[key, 5])).collect();
        seeds.insert(first_sky, common(0));
        seeds.push(common(1));
        seeds
    }

    fn piece(&self, receivers: &[u32], columns: &[u32], factors: Factors) -> Piece {
        let rows: Vec<&Row> = receivers.iter().map(|&receiver| self.row_of(receiver)).collect();
        let lit: f32 = rows.iter().map(|row| row.lit).sum();
        let uncovered: f32 = rows.iter().map(|row| row.uncovered).sum();
        let stage = &self.world.stage;
        let transport = ClusterTransport {
            bounds_m: bounds(receivers.iter().map(|&r| stage.receivers[r as usize].position_m)),
            receivers: self.attributes(receivers),
            probes: columns.iter().filter_map(|&group| self.keys.get(group as usize).copied()).collect(),
            bands: self.settings.coefficient_bands(),
            sky: columns.last() == Some(&(self.keys.len() as u32)),
            rank: factors.rank as u32,
            u: factors.u,
            vt: factors.vt,
            emitters: emitters(&rows),
            near: near::of_rows(stage, self.settings, receivers, &rows),
        };
        let uncovered_fraction = if lit > 0.0 { uncovered / lit } else { 0.0 };
        Piece {
            transport,
            truncation_error: factors.truncation_error,
            s1_criterion_bound: factors.s1_criterion_bound,
            uncovered_fraction,
        }
    }

    fn attributes(&self, receivers: &[u32]) -> Receivers {
        let stage = &self.world.stage;
        let all: Vec<&Receiver> = receivers.iter().map(|&r| &stage.receivers[r as usize]).collect();
        let mut blocks: Vec<u32> = all.iter().map(|receiver| receiver.block).collect();
        blocks.sort_unstable();
        blocks.dedup();
        let block_index =
            |receiver: &&Receiver| blocks.binary_search(&receiver.block).unwrap_or_default() as u16;
        Receivers {
            block: all.iter().map(block_index).collect(),
            texel: all.iter().map(|receiver| receiver.texel).collect(),
            position_m: all.iter().map(|receiver| receiver.position_m.to_array()).collect(),
            normal: all.iter().map(|receiver| receiver.normal.to_array()).collect(),
            albedo: all.iter().map(|receiver| receiver.albedo).collect(),
            emission: all.iter().map(|receiver| receiver.emission).collect(),
            links: all.iter().map(|receiver| receiver.links).collect(),
            blocks: blocks.iter().map(|&block| stage.blocks[block as usize].key).collect(),
        }
    }
}

/// Irradiance of the emitters that reach any of the rows.
fn emitters(rows: &[&Row]) -> Vec<EmitterIrradiance> {
    let count = rows.first().map_or(0, |row| row.emitters.len());
    (0..count)
        .map(|emitter| EmitterIrradiance {
            emitter: emitter as u16,
            irradiance: rows.iter().map(|row| row.emitters[emitter]).collect(),
        })
        .filter(|column| column.irradiance.iter().flatten().any(|channel| *channel > 0.0))
        .collect()
}

fn bounds(positions: impl Iterator<Item = Vec3>) -> [[f32; 3]; 2] {
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for position in positions {
        (low, high) = (low.min(position), high.max(position));
    }
    [low.to_array(), high.to_array()]
}
