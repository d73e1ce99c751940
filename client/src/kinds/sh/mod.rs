//! Relightable light over spherical harmonics at probes.

pub mod relight;

use lightkiln_proto::chunk;
use lightkiln_proto::content::ClusterTransport;
use lightkiln_proto::kinds::Kind;
use lightkiln_proto::kinds::sh::{self, ProbeBatch, ProbeTable};
use lightkiln_proto::manifest::CLUSTERS;

use crate::bake::{ClientKind, Light};
use crate::error::Result;
use crate::fetch::{Source, decoded};
use crate::lightmap::{ClientColumns, LightmapLight};
use crate::passes::gpu::Gpu;
use crate::passes::resident::{ColumnsPass, Resident};
use crate::scene::LoadedScene;

/// The kind.
#[derive(Clone, Copy, Debug)]
pub struct Sh;

/// Decoded chunks of its light, in the manifest's order.
#[derive(Debug, Default)]
pub struct Contents {
    /// Clusters.
    pub clusters: Vec<ClusterTransport>,
    /// Probe batches.
    pub probes: Vec<ProbeBatch>,
}

impl ClientKind for Sh {
    fn contract(&self) -> &'static dyn Kind {
        &sh::Sh
    }

    fn load(&self, source: &Source, scene: &LoadedScene) -> Result<Box<dyn Light>> {
        Ok(Box::new(load(source, scene)?))
    }
}

/// Fetches and decodes the light of a bake.
pub fn load(source: &Source, scene: &LoadedScene) -> Result<LightmapLight<ProbeTable>> {
    let manifest = &scene.manifest;
    let contents = Contents {
        clusters: decoded(source, manifest, CLUSTERS, |bytes| Ok(chunk::decode_cluster(bytes)?))?,
        probes: decoded(source, manifest, sh::PROBES, |bytes| Ok(sh::decode_probe_batch(bytes)?))?,
    };
    assemble(scene, &contents)
}

/// Joins decoded chunks; anything that contradicts the manifest or another chunk is an error.
pub fn assemble(scene: &LoadedScene, contents: &Contents) -> Result<LightmapLight<ProbeTable>> {
    let settings: sh::Settings = scene.manifest.settings()?;
    let sh::ProbeSettings { relight_rays, bands, .. } = settings.probes;
    LightmapLight::assemble(scene, &contents.clusters, |slots| {
        ProbeTable::join(&contents.probes, relight_rays, bands, slots)
    })
}

impl ClientColumns for ProbeTable {
    fn pass(&self, gpu: &Gpu, resident: &Resident) -> Result<Box<dyn ColumnsPass>> {
        Ok(Box::new(relight::RelightPass::new(gpu, self, resident)?))
    }
}
