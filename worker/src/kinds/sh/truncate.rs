//! From the rows of a cell to factorised clusters, with columns weighted by band.

use glam::Vec3;
use lightkiln_proto::content::{NearHits, TransportFactors};
use lightkiln_proto::harmonics::band_of;

use super::{ProbeTransport, TracedSettings};
use crate::factors::{ClusterCell, Factored, Matrix, Part, Piece, Truncation, factorise, split};
use crate::lightmap::{Lightmap, Numbering};
use crate::rays::sampling::seed_of;
use crate::task::{Cancelled, Progress};
use crate::transport::Row;

/// A cell while it is factorised.
struct Cell<'a> {
    lightmap: &'a Lightmap,
    settings: &'a TracedSettings,
    /// Probes of the groups of columns, ascending; the sky's group follows.
    keys: &'a [u64],
    receivers: Numbering<u32>,
    /// One per receiver.
    rows: &'a [Row],
}

/// Factorised clusters of a cell, in a fixed order.
pub fn pieces(
    transport: &ProbeTransport,
    keys: &[u64],
    cell: &ClusterCell,
    rows: &[Row],
    progress: &Progress,
) -> Result<Vec<Piece>, Cancelled> {
    let own = Cell {
        lightmap: &transport.world.lightmap,
        settings: &transport.settings,
        keys,
        receivers: Numbering::of(cell.receivers.iter().copied()),
        rows,
    };
    // Leave dead receivers out: their texels are filled from their neighbours, which keeps edges from turning dark.
    let live = cell.receivers.iter().zip(rows).filter(|(_, row)| !row.is_dark());
    let receivers: Vec<u32> = live.map(|(&receiver, _)| receiver).collect();
    // Factorise receivers apart that share no probe. The sky joins none: it is above rooms that have nothing else in common.
    let links: Vec<Vec<u32>> = receivers.iter().map(|&receiver| own.probes_used(receiver)).collect();
    let parts =
        split(&own, &ClusterCell { bounds_m: cell.bounds_m, receivers }, &links, keys.len(), progress)?;
    Ok(parts.into_iter().map(|part| own.piece(part)).collect())
}

impl Truncation for Cell<'_> {
    fn factored(&self, receivers: &[u32]) -> (Factored, bool) {
        let (matrix, groups) = self.matrix(receivers);
        let TracedSettings { factors, probes, .. } = self.settings;
        let (rank_max, error_max) = (factors.rank_max as usize, probes.rank_error);
        let mut factors = factorise(&matrix, rank_max, error_max, &self.seeds(&groups));
        self.unweigh(&mut factors.vt);
        let suffices = factors.truncation_error <= error_max;
        (Factored { factors, groups }, suffices)
    }

    fn has_columns(&self, receiver: u32) -> bool {
        self.row_of(receiver).alpha.iter().any(|alpha| *alpha != 0.0)
    }

    fn position_m(&self, receiver: u32) -> Vec3 {
        self.lightmap.receivers[receiver as usize].position_m
    }

    fn may_split(&self, receivers: usize, size_m: f32) -> bool {
        receivers > self.settings.factors.split_receivers_min as usize && size_m > self.lightmap.texel_m
    }

    fn rank_max(&self) -> usize {
        self.settings.factors.rank_max as usize
    }
}

/// Expected size of a coefficient of a radiance field against that of band 0: fields of a few edges fall off about so. We
/// differ from METHOD's plain Frobenius norm: with columns weighted so, the truncation error is an error of irradiance, and
/// the sampling noise of high bands does not ask for rank.
fn expected(coefficient: usize) -> f32 {
    1.0 / (band_of(coefficient) + 1) as f32
}

impl Cell<'_> {
    fn coefficients(&self) -> usize {
        self.settings.probes.coefficients()
    }

    fn row_of(&self, receiver: u32) -> &Row {
        &self.rows[self.receivers.place(receiver)]
    }

    /// α of a receiver's group of columns.
    fn group(&self, receiver: u32, group: u32) -> &[f32] {
        let count = self.coefficients();
        &self.row_of(receiver).alpha[group as usize * count..][..count]
    }

    /// Probes that give a receiver any light.
    fn probes_used(&self, receiver: u32) -> Vec<u32> {
        let is_used = |group: &u32| self.group(receiver, *group).iter().any(|alpha| *alpha != 0.0);
        (0..self.keys.len() as u32).filter(is_used).collect()
    }

    /// A of some receivers with weighted columns, of groups that hold anything, the sky's being `keys.len()`.
    fn matrix(&self, receivers: &[u32]) -> (Matrix, Vec<u32>) {
        let is_used =
            |group: &u32| receivers.iter().any(|&r| self.group(r, *group).iter().any(|alpha| *alpha != 0.0));
        let groups: Vec<u32> = (0..=self.keys.len() as u32).filter(is_used).collect();
        let columns = groups.len() * self.coefficients();
        let mut values = Vec::with_capacity(receivers.len() * columns);
        for &receiver in receivers {
            for &group in &groups {
                let alpha = self.group(receiver, group);
                values.extend(alpha.iter().enumerate().map(|(j, alpha)| alpha * expected(j)));
            }
        }
        (Matrix { rows: receivers.len(), columns, values }, groups)
    }

    /// ΣVᵀ of the weighted matrix to that of A itself.
    fn unweigh(&self, vt: &mut [f32]) {
        for coefficients in vt.chunks_exact_mut(self.coefficients()) {
            coefficients.iter_mut().enumerate().for_each(|(j, value)| *value /= expected(j));
        }
    }

    /// One seed per column, from the identity of its probe.
    fn seeds(&self, groups: &[u32]) -> Vec<u64> {
        let key = |group: u32| self.keys.get(group as usize).copied().unwrap_or(0);
        let count = self.coefficients() as u64;
        groups.iter().flat_map(|&group| (0..count).map(move |j| seed_of(&[key(group), j, 5]))).collect()
    }

    fn piece(&self, Part { receivers, factored: Factored { factors, groups } }: Part) -> Piece {
        let rows: Vec<&Row> = receivers.iter().map(|&receiver| self.row_of(receiver)).collect();
        let columns = TransportFactors {
            keys: groups.iter().filter_map(|&group| self.keys.get(group as usize).copied()).collect(),
            bands: self.settings.probes.bands,
            sky: groups.last() == Some(&(self.keys.len() as u32)),
            ..TransportFactors::default()
        };
        Piece::of(self.lightmap, &receivers, &rows, columns, factors, NearHits::default())
    }
}
