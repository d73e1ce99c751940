//! Relightable light over surface patches.

mod base;
mod edit;
mod memory;
mod only;
mod stream;

use lightkiln_proto::chunk;
use lightkiln_proto::content::{ClusterTransport, PatchSet};
use lightkiln_proto::kinds::{Kind, prt};
use lightkiln_proto::manifest::{CLUSTERS, Manifest};
use lightkiln_proto::relight::{Inconsistent, NO_PATCH, PatchTable};
use lightkiln_proto::voxels::{
    LitByWalks, VOXELS, VoxelPart, VoxelTable, decode_voxels, light_of_walks, walked_blocks,
};

use crate::bake::{ClientKind, Edited, Light, LightStream, QuickBake};
use crate::error::{ClientError, Result};
use crate::fetch::{Source, decoded};
use crate::lightmap::{ClientColumns, LightmapLight};
use crate::passes::gpu::Gpu;
use crate::passes::patches::PatchesPass;
use crate::passes::resident::{ColumnsPass, Resident};
use crate::scene::LoadedScene;
use crate::threads::Threads;

pub use only::only;
pub use stream::PrtStream;

/// The kind.
#[derive(Clone, Copy, Debug)]
pub struct Prt;

/// Decoded chunks of its light, in the manifest's order.
#[derive(Debug, Default)]
pub struct Contents {
    /// Clusters.
    pub clusters: Vec<ClusterTransport>,
    /// Surface patches, one set.
    pub patches: Vec<PatchSet>,
}

impl ClientKind for Prt {
    fn contract(&self) -> &'static dyn Kind {
        &prt::Prt
    }

    fn load(&self, source: &Source, scene: &LoadedScene) -> Result<Box<dyn Light>> {
        Ok(Box::new(load(source, scene)?))
    }

    fn is_in_browsers(&self) -> bool {
        true
    }

    fn quick_bake(&self, manifest: &Manifest) -> Result<QuickBake> {
        edit::quick(manifest)
    }

    fn edited(&self, before: &Source, after: &Source) -> Result<Edited> {
        edit::edited(before, after)
    }

    fn bytes_last(&self, manifest: &Manifest) -> u64 {
        base::bytes_last(manifest)
    }

    fn stream(&self, source: &Source, manifest: &Manifest) -> Result<Box<dyn LightStream>> {
        Ok(Box::new(PrtStream::begin(source, manifest)?))
    }
}

/// Fetches and decodes the light of a bake.
pub fn load(source: &Source, scene: &LoadedScene) -> Result<LightmapLight<PatchTable>> {
    let manifest = &scene.manifest;
    let contents = Contents {
        clusters: decoded(source, manifest, CLUSTERS, |bytes| Ok(chunk::decode_cluster(bytes)?))?,
        patches: decoded(source, manifest, prt::PATCHES, |bytes| Ok(chunk::decode_patches(bytes)?))?,
    };
    let mut light = assemble(scene, &contents)?;
    light.voxels = voxels(source, manifest, &light.transport.columns)?;
    walk(&mut light, LitByWalks::Of(&walked_blocks(manifest)))?;
    Ok(light)
}

/// Gives some receivers the light of walks, where there are voxels.
pub fn walk(light: &mut LightmapLight<PatchTable>, of: LitByWalks<'_>) -> Result<()> {
    let Some(elements) = &light.voxels else { return Ok(()) };
    light.transport.walked = light_of_walks(elements, &light.transport, of, &Threads)
        .map_err(|Inconsistent { place, problem }| ClientError::inconsistent(place, problem))?;
    Ok(())
}

/// Fetches and decodes the voxels of a bake that has some.
pub fn voxels(source: &Source, manifest: &Manifest, patches: &PatchTable) -> Result<Option<VoxelTable>> {
    joined(&decoded(source, manifest, VOXELS, |bytes| Ok(decode_voxels(bytes)?))?, patches)
}

/// Elements of parts that have come, if any.
fn joined(parts: &[VoxelPart], patches: &PatchTable) -> Result<Option<VoxelTable>> {
    if parts.is_empty() {
        return Ok(None);
    }
    let table = VoxelTable::of_bake(parts.iter(), patches)
        .map_err(|Inconsistent { place, problem }| ClientError::inconsistent(place, problem))?;
    Ok(Some(table))
}

/// Joins decoded chunks; anything that contradicts the manifest or another chunk is an error.
pub fn assemble(scene: &LoadedScene, contents: &Contents) -> Result<LightmapLight<PatchTable>> {
    let set = one_of(&contents.patches)?;
    LightmapLight::assemble(scene, &contents.clusters, |slots| PatchTable::new(set, slots))
}

fn one_of(sets: &[PatchSet]) -> Result<&PatchSet> {
    let [set] = sets else {
        let problem = format!("a bake has one set of them, not {}", sets.len());
        return Err(ClientError::inconsistent("patches", problem));
    };
    Ok(set)
}

impl ClientColumns for PatchTable {
    fn patches(&self) -> Option<&PatchTable> {
        Some(self)
    }

    fn pass(&self, gpu: &Gpu, resident: &Resident) -> Result<Box<dyn ColumnsPass>> {
        Ok(Box::new(PatchesPass::new(gpu, self, resident)?))
    }

    fn patch_of_slots(&self, slots: usize) -> Option<Vec<u32>> {
        let mut by_slot = self.finest_of_slots();
        by_slot.resize(slots, NO_PATCH);
        Some(by_slot)
    }
}
