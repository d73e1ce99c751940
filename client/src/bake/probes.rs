//! Probe batches joined; relight hits resolved to receiver slots.

use std::collections::HashMap;

use glam::Vec3;
use lightkiln_proto::manifest::Manifest;
use lightkiln_proto::prt::{ProbeBatch, ProbeKey, RelightHit};

use super::atlas::AtlasLayout;
use super::clusters::block_indices;
use crate::error::{ClientError, Result};

/// A hit that is the sky.
pub const HIT_SKY: u32 = u32::MAX;
/// A hit that returns no radiance.
pub const HIT_DARK: u32 = u32::MAX - 1;

/// Probes and what their relight rays meet.
#[derive(Debug, Default)]
pub struct ProbeTable {
    /// Position in metres.
    pub position_m: Vec<Vec3>,
    /// Relight rays per probe K, a power of two.
    pub relight_rays: u32,
    /// Receiver slots, [`HIT_SKY`] or [`HIT_DARK`], probe-major: `hits[p·K + k]`.
    pub hits: Vec<u32>,
    by_key: HashMap<ProbeKey, u32>,
}

impl ProbeTable {
    /// How many there are.
    pub fn len(&self) -> usize {
        self.position_m.len()
    }

    /// There are none.
    pub fn is_empty(&self) -> bool {
        self.position_m.is_empty()
    }

    /// Index of a probe by its key.
    pub fn index(&self, key: ProbeKey) -> Option<u32> {
        self.by_key.get(&key).copied()
    }

    /// The K hits of probe `probe`.
    pub fn hits_of(&self, probe: usize) -> &[u32] {
        let rays = self.relight_rays as usize;
        &self.hits[probe * rays..(probe + 1) * rays]
    }
}

/// Joins batches, which must share one number of rays.
pub(super) fn join(manifest: &Manifest, batches: Vec<ProbeBatch>, atlas: &AtlasLayout) -> Result<ProbeTable> {
    let rays = batches.first().map_or(manifest.settings.relight_rays, |batch| batch.relight_rays);
    let mut table = ProbeTable { relight_rays: rays, ..ProbeTable::default() };
    if !rays.is_power_of_two() || manifest.settings.bands as usize > lightkiln_proto::sh::MAX_BANDS {
        let problem = format!("{rays} relight rays and {} bands", manifest.settings.bands);
        return Err(ClientError::inconsistent("settings", problem));
    }
    for (index, batch) in batches.into_iter().enumerate() {
        push(&mut table, &batch, atlas)
            .map_err(|problem| ClientError::inconsistent(format!("probe batch {index}"), problem))?;
    }
    Ok(table)
}

fn push(table: &mut ProbeTable, batch: &ProbeBatch, atlas: &AtlasLayout) -> std::result::Result<(), String> {
    if batch.relight_rays != table.relight_rays {
        return Err(format!("has {} rays per probe, the bake {}", batch.relight_rays, table.relight_rays));
    }
    if batch.hits.len() != batch.probes.len() * batch.relight_rays as usize {
        return Err(format!("has {} hits for {} probes", batch.hits.len(), batch.probes.len()));
    }
    for probe in &batch.probes {
        if probe.position_m.iter().any(|value| !value.is_finite()) {
            return Err(format!("probe {:016x} has no finite position", probe.key));
        }
        if table.by_key.insert(probe.key, table.position_m.len() as u32).is_some() {
            return Err(format!("probe {:016x} is there twice", probe.key));
        }
        table.position_m.push(probe.position_m.into());
    }
    let blocks = block_indices(&batch.blocks, atlas)?;
    let resolve = |hit: &RelightHit| -> std::result::Result<u32, String> {
        match hit {
            RelightHit::Sky => Ok(HIT_SKY),
            RelightHit::Dark => Ok(HIT_DARK),
            RelightHit::Receiver { block, texel } => {
                let found =
                    blocks.get(usize::from(*block)).ok_or_else(|| format!("a ray hits block {block}"))?;
                // The baker leaves out receivers that no light can reach.
                Ok(atlas.slot(*found, *texel).unwrap_or(HIT_DARK))
            }
        }
    };
    for hit in &batch.hits {
        table.hits.push(resolve(hit)?);
    }
    Ok(())
}
