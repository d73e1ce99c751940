//! Clusters and their factors: λ → b → irradiance at receivers, or whatever else their rows stand for.

use glam::Vec4;

use super::{Columns, Inconsistent, Parallel};
use crate::content::{EmitterIrradiance, TransportFactors};

/// Highest rank of a cluster that is read.
pub const MAX_RANK: u32 = 256;

/// A cluster's share of the flat arrays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cluster {
    /// First row: the slot of its first receiver where rows are receivers.
    pub first_row: usize,
    /// Rows.
    pub row_count: usize,
    /// First entry in [`ClusterTable::support`].
    pub first_support: usize,
    /// Patches or probes that support it, the sky included.
    pub support_count: usize,
    /// Coefficients of each, J of this cluster.
    pub coefficients: usize,
    /// Rank k.
    pub rank: usize,
    /// First of its k entries in the array b.
    pub first_b: usize,
    /// First element of U in [`ClusterTable::u`], row-major.
    pub first_u: usize,
    /// First element of ΣVᵀ in [`ClusterTable::vt`], rank-major.
    pub first_vt: usize,
}

impl Cluster {
    /// Columns n of ΣVᵀ.
    pub fn columns(&self) -> usize {
        self.support_count * self.coefficients
    }

    /// Its rows.
    pub fn rows(&self) -> std::ops::Range<usize> {
        self.first_row..self.first_row + self.row_count
    }
}

/// Clusters and their factors.
#[derive(Debug, Default)]
pub struct ClusterTable {
    /// Clusters in the manifest's order.
    pub clusters: Vec<Cluster>,
    /// U of all clusters.
    pub u: Vec<f32>,
    /// ΣVᵀ of all clusters.
    pub vt: Vec<f32>,
    /// Index in λ of each supporting patch or probe, in units of J, cluster after cluster.
    pub support: Vec<u32>,
    /// Length of the array b: Σ k.
    pub b_len: usize,
}

impl ClusterTable {
    /// Joins clusters, each given by its factors and the number of its rows, whose columns read `columns`.
    pub fn join<'a>(
        clusters: impl IntoIterator<Item = (&'a TransportFactors, usize)>,
        columns: &impl Columns,
    ) -> Result<Self, Inconsistent> {
        let (mut table, mut first_row) = (Self::default(), 0);
        for (index, (factors, rows)) in clusters.into_iter().enumerate() {
            check(factors, rows, columns)
                .and_then(|()| table.push(factors, columns, first_row, rows))
                .map_err(|problem| Inconsistent::new(format!("cluster {index}"), problem))?;
            first_row += rows;
        }
        Ok(table)
    }

    fn push(
        &mut self,
        factors: &TransportFactors,
        columns: &impl Columns,
        first_row: usize,
        row_count: usize,
    ) -> Result<(), String> {
        let first_support = self.support.len();
        for &key in &factors.keys {
            let found = columns.index(key);
            self.support.push(found.ok_or_else(|| format!("column {key:016x} is in no chunk"))?);
        }
        if factors.sky {
            self.support.push(columns.sky_index().ok_or("has columns of a sky that the bake lacks")?);
        }
        self.clusters.push(Cluster {
            first_row,
            row_count,
            first_support,
            support_count: self.support.len() - first_support,
            coefficients: factors.coefficients(),
            rank: factors.rank as usize,
            first_b: self.b_len,
            first_u: self.u.len(),
            first_vt: self.vt.len(),
        });
        self.b_len += factors.rank as usize;
        self.u.extend_from_slice(&factors.u);
        self.vt.extend_from_slice(&factors.vt);
        Ok(())
    }

    /// `b_c = (ΣVᵀ) λ|_c`, all clusters' k numbers one after the other.
    ///
    /// `lambda[p·J + j]` with `coefficients` = J. A cluster of fewer bands, as a prefix of its chunk has, reads the first
    /// of each.
    pub fn basis(&self, parallel: &impl Parallel, lambda: &[Vec4], coefficients: usize) -> Vec<Vec4> {
        let of_cluster = |index: usize| -> Vec<Vec4> {
            let cluster = &self.clusters[index];
            (0..cluster.rank).map(|row| self.basis_row(cluster, row, lambda, coefficients)).collect()
        };
        parallel.map(self.clusters.len(), of_cluster).concat()
    }

    fn basis_row(&self, cluster: &Cluster, row: usize, lambda: &[Vec4], coefficients: usize) -> Vec4 {
        let columns = cluster.columns();
        let vt = &self.vt[cluster.first_vt + row * columns..][..columns];
        let support = &self.support[cluster.first_support..][..cluster.support_count];
        let mut sum = Vec4::ZERO;
        for (vt, place) in vt.chunks_exact(cluster.coefficients).zip(support) {
            let lambda = &lambda[*place as usize * coefficients..][..cluster.coefficients];
            for (vt, lambda) in vt.iter().zip(lambda) {
                sum += *vt * *lambda;
            }
        }
        sum
    }

    /// `E_r = max(N_r + U_r · b_c, −F_r)` in W·m⁻², by row; without F, as for rows that have a sign, the sum itself.
    ///
    /// N is `start`. F is `beside`, light that is added to E: of receivers E_emit. Truncation and ringing can make a sum
    /// slightly negative. The whole, E + F, is clamped at 0, not its parts, so that no light is gained.
    pub fn reconstruct(
        &self,
        parallel: &impl Parallel,
        b: &[Vec4],
        start: &[Vec4],
        beside: Option<&[Vec4]>,
    ) -> Vec<Vec4> {
        let of_cluster = |index: usize| -> Vec<Vec4> {
            let cluster = &self.clusters[index];
            let b = &b[cluster.first_b..][..cluster.rank];
            let at = |row: usize| {
                let first = cluster.first_u + (row - cluster.first_row) * cluster.rank;
                let u = &self.u[first..][..cluster.rank];
                let sum = u.iter().zip(b).fold(start[row], |sum, (u, b)| sum + *u * *b);
                beside.map_or(sum, |beside| sum.max(-beside[row]))
            };
            cluster.rows().map(at).collect()
        };
        parallel.map(self.clusters.len(), of_cluster).concat()
    }
}

fn check(factors: &TransportFactors, rows: usize, columns: &impl Columns) -> Result<(), String> {
    if factors.bands > columns.bands() {
        return Err(format!("has {} bands, the bake {}", factors.bands, columns.bands()));
    }
    if factors.rank > MAX_RANK {
        return Err(format!("has rank {}, at most {MAX_RANK}", factors.rank));
    }
    let rank = factors.rank as usize;
    if factors.u.len() != rows * rank || factors.vt.len() != factors.columns() * rank {
        return Err("its factors do not have the lengths that rank, rows and columns ask for".to_owned());
    }
    if !factors.u.iter().chain(&factors.vt).all(|value| value.is_finite()) {
        return Err("a factor is not a finite number".to_owned());
    }
    Ok(())
}

/// Irradiance straight from one emitter at one cluster's rows.
#[derive(Clone, Debug, PartialEq)]
pub struct EmitterPart {
    /// Emitter.
    pub emitter: u16,
    /// First row.
    pub first_row: usize,
    /// W·m⁻² at scale 1, one per row.
    pub irradiance: Vec<[f32; 3]>,
}

/// Irradiance straight from emissive surfaces at all rows.
#[derive(Debug, Default)]
pub struct EmitterTable(pub Vec<EmitterPart>);

impl EmitterTable {
    /// Joins the parts of clusters, each with the number of its rows, of a bake of so many emitters.
    pub fn join<'a>(
        clusters: impl IntoIterator<Item = (&'a [EmitterIrradiance], usize)>,
        emitters: usize,
    ) -> Result<Self, Inconsistent> {
        let (mut table, mut first_row) = (Self::default(), 0);
        for (index, (parts, rows)) in clusters.into_iter().enumerate() {
            for EmitterIrradiance { emitter, irradiance } in parts {
                if irradiance.len() != rows || usize::from(*emitter) >= emitters {
                    let problem =
                        format!("its light from emitter {emitter} has a wrong length or no emitter");
                    return Err(Inconsistent::new(format!("cluster {index}"), problem));
                }
                table.0.push(EmitterPart { emitter: *emitter, first_row, irradiance: irradiance.clone() });
            }
            first_row += rows;
        }
        Ok(table)
    }

    /// Irradiance at `rows` rows, W·m⁻²; `scale` is one factor per emitter, 1 if absent.
    pub fn irradiance(&self, rows: usize, scale: &[f32]) -> Vec<Vec4> {
        let mut sum = vec![Vec4::ZERO; rows];
        for part in &self.0 {
            let factor = scale.get(usize::from(part.emitter)).copied().unwrap_or(1.0);
            for (row, irradiance) in sum[part.first_row..].iter_mut().zip(&part.irradiance) {
                *row += super::four(*irradiance) * factor;
            }
        }
        sum
    }
}
