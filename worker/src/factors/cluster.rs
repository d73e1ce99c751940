//! The part of a cluster that is the same for every kind: its receivers and their emitters.

use glam::Vec3;
use lightkiln_proto::content::{ClusterTransport, EmitterIrradiance, NearHits, Receivers, TransportFactors};

use super::{Factors, Piece};
use crate::lightmap::{Lightmap, Numbering, Receiver};
use crate::transport::Row;

impl Piece {
    /// Of receivers, their rows, and factors over `columns`, whose own are empty.
    pub fn of(
        lightmap: &Lightmap,
        receivers: &[u32],
        rows: &[&Row],
        columns: TransportFactors,
        factors: Factors,
        near: NearHits,
    ) -> Self {
        let lit: f32 = rows.iter().map(|row| row.lit).sum();
        let uncovered: f32 = rows.iter().map(|row| row.uncovered).sum();
        Self {
            transport: ClusterTransport {
                bounds_m: bounds_m(lightmap, receivers),
                receivers: attributes(lightmap, receivers),
                factors: TransportFactors {
                    rank: factors.rank as u32,
                    u: factors.u,
                    vt: factors.vt,
                    ..columns
                },
                emitters: emitters(rows),
                near,
            },
            truncation_error: factors.truncation_error,
            s1_criterion_bound: factors.s1_criterion_bound,
            uncovered_fraction: if lit > 0.0 { uncovered / lit } else { 0.0 },
        }
    }
}

/// Receivers as a chunk lists them, in the order given.
fn attributes(lightmap: &Lightmap, receivers: &[u32]) -> Receivers {
    let all: Vec<&Receiver> = receivers.iter().map(|&r| &lightmap.receivers[r as usize]).collect();
    let blocks = Numbering::of(all.iter().map(|receiver| receiver.block));
    Receivers {
        block: all.iter().map(|receiver| blocks.place_u16(receiver.block)).collect(),
        texel: all.iter().map(|receiver| receiver.texel).collect(),
        position_m: all.iter().map(|receiver| receiver.position_m.to_array()).collect(),
        normal: all.iter().map(|receiver| receiver.normal.to_array()).collect(),
        albedo: all.iter().map(|receiver| receiver.albedo).collect(),
        emission: all.iter().map(|receiver| receiver.emission).collect(),
        links: all.iter().map(|receiver| receiver.links).collect(),
        coverage: all.iter().map(|receiver| receiver.coverage).collect(),
        edge: all.iter().map(|receiver| receiver.edge).collect(),
        blocks: blocks.values().iter().map(|&block| lightmap.blocks[block as usize].key).collect(),
    }
}

/// Lower and upper corner of receivers in metres.
fn bounds_m(lightmap: &Lightmap, receivers: &[u32]) -> [[f32; 3]; 2] {
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for &receiver in receivers {
        let position_m = lightmap.receivers[receiver as usize].position_m;
        (low, high) = (low.min(position_m), high.max(position_m));
    }
    [low.to_array(), high.to_array()]
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
