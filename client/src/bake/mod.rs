//! A bake in memory: chunks decoded into flat arrays that the passes and their references share.
//!
//! Receivers have **slots**: the clusters' receivers one after the other, in the manifest's order. Every name of a
//! receiver (block, texel) is resolved to its slot here, once.

mod atlas;
mod clusters;
mod draws;
mod load;
mod near;
mod patches;
mod probes;
#[cfg(test)]
mod tests;
mod texture;

use glam::Vec4;
use lightkiln_proto::manifest::Manifest;
use lightkiln_proto::prt::{BasisKind, ClusterTransport, Geometry, PatchSet, ProbeBatch};

use crate::error::{ClientError, Result};

pub use atlas::{AtlasLayout, AtlasTexel, EXTENSION_TEXELS, NO_RECEIVER, PlacedBlock};
pub use clusters::{Cluster, ClusterTable, EmitterPart, ReceiverTable};
pub use draws::{DrawTable, LoadedDraw, NO_BLOCK, Vertex};
pub use near::{NearRow, NearTable};
pub use patches::{PatchRow, PatchTable};
pub use probes::{HIT_DARK, HIT_SKY, ProbeTable};
pub use texture::Texture;
pub(crate) use texture::srgb_of_linear;

/// Most receivers that a bake may have.
pub const MAX_RECEIVERS: usize = 1 << 26;
/// Most texels of all atlas pages together.
pub const MAX_ATLAS_TEXELS: u64 = 1 << 27;
/// Most atlas pages, and the longest side of one.
pub const MAX_PAGES: usize = 256;
/// Longest side of an atlas page in texels.
pub const MAX_PAGE_SIDE: u32 = 1 << 14;

/// A whole bake, ready to be lit.
#[derive(Debug)]
pub struct LoadedBake {
    /// What the bake says about itself.
    pub manifest: Manifest,
    /// Receivers by slot.
    pub receivers: ReceiverTable,
    /// Clusters and their factors.
    pub clusters: ClusterTable,
    /// Probes and what their relight rays meet.
    pub probes: ProbeTable,
    /// Surface patches; empty unless the basis is patches.
    pub patches: PatchTable,
    /// What receivers in narrow places meet close by.
    pub near: NearTable,
    /// Where receivers lie in the atlas, and how its edges are extended.
    pub atlas: AtlasLayout,
    /// Meshes to draw.
    pub draws: DrawTable,
    /// Textures, with mip levels.
    pub textures: Vec<Texture>,
    /// Things that were left out, in words.
    pub warnings: Vec<String>,
}

/// Decoded chunks of a bake, in the manifest's order.
#[derive(Debug, Default)]
pub struct Contents {
    /// Clusters.
    pub clusters: Vec<ClusterTransport>,
    /// Probe batches.
    pub probes: Vec<ProbeBatch>,
    /// Surface patches: one set when the basis is patches.
    pub patches: Vec<PatchSet>,
    /// Geometry.
    pub geometry: Vec<Geometry>,
    /// Textures.
    pub textures: Vec<Texture>,
}

impl LoadedBake {
    /// Joins decoded chunks; whatever contradicts the manifest or another chunk is an error.
    pub fn assemble(manifest: Manifest, contents: Contents) -> Result<Self> {
        let mut warnings = Vec::new();
        let mut atlas = AtlasLayout::place(&manifest)?;
        let (receivers, mut clusters) = clusters::join(&manifest, &contents.clusters, &mut atlas)?;
        let mut near = NearTable::default();
        for (index, (content, cluster)) in contents.clusters.iter().zip(&clusters.clusters).enumerate() {
            near.add(&content.near, cluster.first_receiver, &receivers, &atlas)
                .map_err(|problem| ClientError::inconsistent(format!("cluster {index}"), problem))?;
        }
        let probes = probes::join(&manifest, contents.probes, &atlas)?;
        let patches = match (manifest.settings.basis, &contents.patches[..]) {
            (BasisKind::Sh, _) => PatchTable::default(),
            (BasisKind::Patches, [set]) => PatchTable::new(set, &atlas)
                .map_err(|problem| ClientError::inconsistent("patches", problem))?,
            (BasisKind::Patches, sets) => {
                let problem = format!("a bake with basis patches has one set of them, not {}", sets.len());
                return Err(ClientError::inconsistent("patches", problem));
            }
        };
        match manifest.settings.basis {
            BasisKind::Sh => {
                clusters.resolve_support("probe", probes.len() as u32, |key| probes.index(key))?;
            }
            BasisKind::Patches => {
                clusters.resolve_support("patch", patches.len() as u32, |key| patches.index(key))?;
            }
        }
        atlas.extend_edges(&receivers.links);
        let draws = draws::join(&manifest, contents.geometry, &atlas, &mut warnings)?;
        let textures = contents.textures;
        check_textures(&manifest, textures.len())?;
        Ok(Self { manifest, receivers, clusters, probes, patches, near, atlas, draws, textures, warnings })
    }

    /// Entries of λ: probes and the sky times their coefficients, or patches and parts of the sky.
    pub fn lambda_count(&self) -> usize {
        match self.manifest.settings.basis {
            BasisKind::Sh => (self.probes.len() + 1) * self.coefficients(),
            BasisKind::Patches => self.patches.len(),
        }
    }

    /// Coefficients per probe J, of the manifest's bands; 1 per patch.
    pub fn coefficients(&self) -> usize {
        self.manifest.settings.coefficients()
    }

    /// Irradiance straight from emissive surfaces, per slot in W·m⁻²; `scale` is one factor per emitter, 1 if absent.
    pub fn emitter_irradiance(&self, scale: &[f32]) -> Vec<Vec4> {
        let mut sum = vec![Vec4::ZERO; self.receivers.len()];
        for part in &self.clusters.emitters {
            let factor = scale.get(usize::from(part.emitter)).copied().unwrap_or(1.0);
            let slots = sum[part.first_receiver..].iter_mut();
            for (slot, irradiance) in slots.zip(&part.irradiance) {
                *slot += Vec4::new(irradiance[0], irradiance[1], irradiance[2], 0.0) * factor;
            }
        }
        sum
    }
}

fn check_textures(manifest: &Manifest, count: usize) -> Result<()> {
    for (index, material) in manifest.materials.iter().enumerate() {
        let uses = [&material.base_colour_texture, &material.emissive_texture];
        if let Some(bad) = uses.into_iter().flatten().find(|used| used.texture as usize >= count) {
            let problem = format!("names texture {} of {count}", bad.texture);
            return Err(ClientError::inconsistent(format!("material {index}"), problem));
        }
    }
    Ok(())
}
