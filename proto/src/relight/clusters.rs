//! Clusters and their factors: λ → b → irradiance at receivers.

use glam::Vec4;

use super::{Columns, Inconsistent, Parallel};
use crate::content::ClusterTransport;

/// Highest rank of a cluster that is read.
pub const MAX_RANK: u32 = 256;

/// A cluster's share of the flat arrays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cluster {
    /// First slot.
    pub first_receiver: usize,
    /// Receivers.
    pub receiver_count: usize,
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
    /// First element of U in [`ClusterTable::u`], receiver-major.
    pub first_u: usize,
    /// First element of ΣVᵀ in [`ClusterTable::vt`], rank-major.
    pub first_vt: usize,
}

impl Cluster {
    /// Columns n of ΣVᵀ.
    pub fn columns(&self) -> usize {
        self.support_count * self.coefficients
    }

    /// Its slots.
    pub fn slots(&self) -> std::ops::Range<usize> {
        self.first_receiver..self.first_receiver + self.receiver_count
    }
}

/// Irradiance straight from one emitter at one cluster's receivers.
#[derive(Clone, Debug, PartialEq)]
pub struct EmitterPart {
    /// Emitter.
    pub emitter: u16,
    /// First slot.
    pub first_receiver: usize,
    /// W·m⁻² at scale 1, one per receiver.
    pub irradiance: Vec<[f32; 3]>,
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
    /// Irradiance straight from emissive surfaces.
    pub emitters: Vec<EmitterPart>,
}

impl ClusterTable {
    /// Joins clusters of a bake of so many emitters, whose columns read `columns`.
    pub fn join(
        contents: &[ClusterTransport],
        columns: &impl Columns,
        emitters: usize,
    ) -> Result<Self, Inconsistent> {
        let mut table = Self::default();
        let mut first_receiver = 0;
        for (index, content) in contents.iter().enumerate() {
            check(content, columns, emitters)
                .and_then(|()| table.push(content, columns, first_receiver))
                .map_err(|problem| Inconsistent::new(format!("cluster {index}"), problem))?;
            first_receiver += content.receivers.len();
        }
        Ok(table)
    }

    fn push(
        &mut self,
        content: &ClusterTransport,
        columns: &impl Columns,
        first_receiver: usize,
    ) -> Result<(), String> {
        let first_support = self.support.len();
        for &key in &content.keys {
            let found = columns.index(key);
            self.support.push(found.ok_or_else(|| format!("column {key:016x} is in no chunk"))?);
        }
        if content.sky {
            self.support.push(columns.sky_index().ok_or("has columns of a sky that the bake lacks")?);
        }
        self.clusters.push(Cluster {
            first_receiver,
            receiver_count: content.receivers.len(),
            first_support,
            support_count: self.support.len() - first_support,
            coefficients: content.coefficients(),
            rank: content.rank as usize,
            first_b: self.b_len,
            first_u: self.u.len(),
            first_vt: self.vt.len(),
        });
        self.b_len += content.rank as usize;
        self.u.extend_from_slice(&content.u);
        self.vt.extend_from_slice(&content.vt);
        self.emitters.extend(content.emitters.iter().map(|part| EmitterPart {
            emitter: part.emitter,
            first_receiver,
            irradiance: part.irradiance.clone(),
        }));
        Ok(())
    }

    /// Irradiance straight from emissive surfaces at `receivers` slots, W·m⁻²; `scale` is one factor per emitter, 1 if
    /// absent.
    pub fn emitter_irradiance(&self, receivers: usize, scale: &[f32]) -> Vec<Vec4> {
        let mut sum = vec![Vec4::ZERO; receivers];
        for part in &self.emitters {
            let factor = scale.get(usize::from(part.emitter)).copied().unwrap_or(1.0);
            let slots = sum[part.first_receiver..].iter_mut();
            for (slot, irradiance) in slots.zip(&part.irradiance) {
                *slot += super::four(*irradiance) * factor;
            }
        }
        sum
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

    /// `E_ind(r) = max(N(r) + U_r · b_c, −E_emit(r))` in W·m⁻², by slot.
    ///
    /// Truncation and ringing can make a sum slightly negative. The whole, E_emit + E_ind, is clamped at 0, not its parts, so
    /// that no light is gained.
    pub fn reconstruct(
        &self,
        parallel: &impl Parallel,
        b: &[Vec4],
        near: &[Vec4],
        emit: &[Vec4],
    ) -> Vec<Vec4> {
        let of_cluster = |index: usize| -> Vec<Vec4> {
            let cluster = &self.clusters[index];
            let b = &b[cluster.first_b..][..cluster.rank];
            let at = |slot: usize| {
                let row = cluster.first_u + (slot - cluster.first_receiver) * cluster.rank;
                let u = &self.u[row..][..cluster.rank];
                u.iter().zip(b).fold(near[slot], |sum, (u, b)| sum + *u * *b).max(-emit[slot])
            };
            cluster.slots().map(at).collect()
        };
        parallel.map(self.clusters.len(), of_cluster).concat()
    }
}

fn check(content: &ClusterTransport, columns: &impl Columns, emitters: usize) -> Result<(), String> {
    let count = content.receivers.len();
    if content.bands > columns.bands() {
        return Err(format!("has {} bands, the bake {}", content.bands, columns.bands()));
    }
    if content.rank > MAX_RANK {
        return Err(format!("has rank {}, at most {MAX_RANK}", content.rank));
    }
    let rank = content.rank as usize;
    if content.u.len() != count * rank || content.vt.len() != content.columns() * rank {
        return Err("its factors do not have the lengths that rank, receivers and columns ask for".to_owned());
    }
    if !content.u.iter().chain(&content.vt).all(|value| value.is_finite()) {
        return Err("a factor is not a finite number".to_owned());
    }
    for part in &content.emitters {
        if part.irradiance.len() != count || usize::from(part.emitter) >= emitters {
            return Err(format!("its light from emitter {} has a wrong length or no emitter", part.emitter));
        }
    }
    Ok(())
}
