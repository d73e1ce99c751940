//! Clusters: receivers that share one factorised transport matrix (METHOD.md §2.9).

use serde::{Deserialize, Serialize};

use super::near::NearHits;
use super::receivers::Receivers;

/// Identity of a group of columns: a patch, a part of the sky, a probe.
pub type ColumnKey = u64;

/// Factorised transport `A ≈ U (ΣVᵀ)` of some rows: light at receivers, or anything else that is linear in the columns.
///
/// Columns of A, hence of `vt`: for each of `keys` in order, coefficients j = 0…J−1; then J columns of the sky (`sky` true)
/// or none. A kind of bake says what its keys name: surface patches and parts of the sky have one coefficient each (`bands`
/// is 0, `sky` false), probes one for each spherical harmonic.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TransportFactors {
    /// Keys of the columns, ascending.
    pub keys: Vec<ColumnKey>,
    /// Highest spherical-harmonic band.
    pub bands: u32,
    /// Whether columns of the sky follow those of the keys.
    pub sky: bool,
    /// Rank k of the factors; 0 when nothing reaches the rows.
    pub rank: u32,
    /// U, row-major: `u[r·k + i]`.
    pub u: Vec<f32>,
    /// ΣVᵀ, rank-major: `vt[i·n + column]`.
    pub vt: Vec<f32>,
    /// Steps that the numbers are multiples of, where a chunk had them.
    pub steps: FactorSteps,
}

/// Steps of factors from a chunk: `u[r·k + i]` is a whole number of `u[i]`, `vt[i·n + column]` of `vt[i] · scale[column]`. Empty for
/// factors that no chunk has stored; encoders do not read them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FactorSteps {
    /// Of U, by rank.
    pub u: Vec<f32>,
    /// Of ΣVᵀ, by rank.
    pub vt: Vec<f32>,
    /// Scale of each key's column; empty where all are 1.
    pub scale: Vec<f32>,
}

impl TransportFactors {
    /// Coefficients per key, J.
    pub fn coefficients(&self) -> usize {
        (self.bands as usize + 1) * (self.bands as usize + 1)
    }

    /// Columns of A: n.
    pub fn columns(&self) -> usize {
        (self.keys.len() + usize::from(self.sky)) * self.coefficients()
    }
}

/// One cluster: its receivers and their factorised transport.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClusterTransport {
    /// Lower and upper corner of the receivers' bounds in metres.
    pub bounds_m: [[f32; 3]; 2],
    /// Receivers, coarse levels first.
    pub receivers: Receivers,
    /// Transport to them, a row each.
    pub factors: TransportFactors,
    /// Irradiance straight from emissive surfaces, one entry per emitter that reaches the cluster.
    pub emitters: Vec<EmitterIrradiance>,
    /// Near hits of receivers in narrow places; they are not in the factors.
    pub near: NearHits,
}

/// Irradiance at a cluster's receivers straight from one emitter at scale 1, shadowed, in W·m⁻².
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EmitterIrradiance {
    /// Index into the manifest's emitters.
    pub emitter: u16,
    /// One per receiver.
    pub irradiance: Vec<[f32; 3]>,
}
