//! Light in a lightmap: receivers on texels, lit by factorised transport whose columns a kind gives.

mod debug;
mod moved;
mod passes;
#[cfg(test)]
mod tests;

use std::sync::OnceLock;

use glam::{Vec3, Vec4};
use lightkiln_proto::content::ClusterTransport;
use lightkiln_proto::manifest::Manifest;
use lightkiln_proto::relight::{
    Columns, Incoming, Inconsistent, LOD_LEVELS, LevelCount, Limit, Lod, LodEye, LodPlan, LodTable, NO_PATCH,
    PatchTable, Settled, SkyRows, SlotTable, Transport,
};
use lightkiln_proto::transfer::TransferTable;
use lightkiln_proto::voxels::VoxelTable;
use wgpu::TextureViewDimension as Dimension;

use crate::bake::{
    Among, DebugPage, IncomingDirect, Light, LightPasses, LitScene, Overlay, ReceiverLight, SettledLight,
    SettledReceivers, SettledWalks, Unshadowed, UnshadowedArrays, emitter_radiance,
};
use crate::error::{ClientError, Result};
use crate::passes::atlas::reference::{AtlasPages, read, spread};
use crate::passes::atlas::{AtlasTexels, INDIRECT, Lightmap};
use crate::passes::direct::TexelPoints;
use crate::passes::direct::reference::{direct, direct_texels};
use crate::passes::gpu::{Gpu, storage_read, texture};
use crate::passes::resident::{ColumnsPass, Resident};
use crate::passes::shade::{IndirectIrradiance, Shading, Surface};
use crate::passes::shadow::ShadowPass;
use crate::scene::{LoadedScene, Tints};
use crate::threads::Threads;

pub use debug::{ATLAS, CLUSTERS};
pub use passes::LightmapPasses;

/// Colours of levels of detail, as [Sedlacek2019] fig. 5.29 has them.
const LEVEL_COLOURS: [Vec3; LOD_LEVELS] = [
    Vec3::new(0.7, 0.1, 0.05),
    Vec3::new(0.1, 0.6, 0.15),
    Vec3::new(0.1, 0.2, 0.8),
    Vec3::new(0.75, 0.65, 0.1),
];

/// Columns with their pass on the adapter.
pub trait ClientColumns: Columns + 'static {
    /// Uploads the pass that makes λ of the light at receivers.
    fn pass(&self, gpu: &Gpu, resident: &Resident) -> Result<Box<dyn ColumnsPass>>;

    /// Surface patches, where columns are those.
    fn patches(&self) -> Option<&PatchTable> {
        None
    }

    /// The finest patch of each of so many slots, [`NO_PATCH`] of those in none; `None` for columns without patches.
    fn patch_of_slots(&self, slots: usize) -> Option<Vec<u32>> {
        let _ = slots;
        None
    }
}

/// Light in a lightmap, its columns read from `C`.
#[derive(Debug)]
pub struct LightmapLight<C> {
    /// Receivers, clusters, near hits and columns.
    pub transport: Transport<C>,
    /// Lightmap texels that hold irradiance.
    pub texels: AtlasTexels,
    /// Points of receivers' texels.
    pub points: TexelPoints,
    /// Elements, of a bake that has some.
    pub voxels: Option<VoxelTable>,
    /// Volume of a bake that is an object's.
    pub volume: Option<TransferTable>,
    /// Made when it is first asked for.
    lod: OnceLock<LodTable>,
    /// Likewise.
    sky_rows: OnceLock<SkyRows>,
}

impl<C: Columns> LightmapLight<C> {
    /// Joins decoded clusters with the scene's layout; `columns` makes the columns, with all receivers in their slots.
    pub fn assemble(
        scene: &LoadedScene,
        clusters: &[ClusterTransport],
        columns: impl FnOnce(&SlotTable) -> std::result::Result<C, Inconsistent>,
    ) -> Result<Self> {
        Self::assemble_some(scene, clusters, |_| Ok(()), columns)
    }

    /// As [`LightmapLight::assemble`], of some of a bake's clusters: `stand_in` says which receivers stand for those that are
    /// not there.
    pub fn assemble_some(
        scene: &LoadedScene,
        clusters: &[ClusterTransport],
        stand_in: impl FnOnce(&mut SlotTable) -> std::result::Result<(), Inconsistent>,
        columns: impl FnOnce(&SlotTable) -> std::result::Result<C, Inconsistent>,
    ) -> Result<Self> {
        let Manifest { emitters, .. } = &scene.manifest;
        let layout = scene.manifest.layout()?;
        let blocks = layout.blocks.iter().map(|block| (block.key, block.size));
        let transport = Transport::join_some(blocks, emitters.len(), clusters, stand_in, columns)
            .map_err(|Inconsistent { place, problem }| ClientError::inconsistent(place, problem))?;
        let texels = AtlasTexels::new(&scene.lightmap, &transport.slots, &transport.receivers);
        let points =
            TexelPoints::new((&scene.draws, &scene.lightmap), &transport.slots, &transport.receivers);
        let (lod, sky_rows) = (OnceLock::new(), OnceLock::new());
        Ok(Self { transport, texels, points, voxels: None, volume: None, lod, sky_rows })
    }

    /// Bounces until they converge, E_dir from shadow maps.
    pub fn settled(&self, lit: &LitScene<'_>, among: &Among<'_>, limit: Limit) -> Lit {
        let IncomingDirect { receivers, near } = self.direct(lit, among);
        let Unshadowed { sky, panorama, emitter_scale } = lit.unshadowed;
        let Among { around, moved, .. } = *among;
        let incoming = Incoming { dir: &receivers, near: &near, sky, panorama, around, moved, emitter_scale };
        let detail = lit.lod.map(|plan| (self.lod(), plan));
        let light = self.transport.settle_in(&Threads, &incoming, limit, detail);
        Lit { dir: receivers, light }
    }

    /// Bounds of clusters, and stand-ins of receivers.
    pub fn lod(&self) -> &LodTable {
        let Transport { slots, receivers, clusters, .. } = &self.transport;
        self.lod.get_or_init(|| LodTable::new(slots, receivers, clusters))
    }

    /// E_dir of receivers and near hits from shadow maps.
    fn direct(&self, lit: &LitScene<'_>, among: &Among<'_>) -> IncomingDirect {
        let Transport { receivers, near, .. } = &self.transport;
        let [positions_m, normals] = near.surfaces(receivers);
        IncomingDirect {
            receivers: direct_texels(receivers, &self.points, &among.world_from_scene, lit.plan, lit.maps),
            near: direct(&positions_m, &normals, &among.world_from_scene, lit.plan, lit.maps),
        }
    }
}

impl<C: ClientColumns> LightmapLight<C> {
    /// Voxels with the λ of the last bounce.
    pub fn walks(&self, lit: &LitScene<'_>, lambda: Vec<Vec4>) -> Option<SettledWalks<'_>> {
        let (voxels, patches) = self.elements()?;
        let emitters = emitter_radiance(&lit.scene.manifest, lit.unshadowed.emitter_scale);
        Some(SettledWalks { voxels, patches, lambda, emitters })
    }

    /// Its voxels, of a bake that has some, and the patches that they name.
    pub fn elements(&self) -> Option<(&VoxelTable, &PatchTable)> {
        Some((self.voxels.as_ref()?, self.transport.columns.patches()?))
    }

    /// Each of the finest patches in a colour of its own; grey where there is none.
    fn by_patch(&self) -> Option<Vec<Vec4>> {
        let patches = self.transport.columns.patch_of_slots(self.transport.receivers.len())?;
        let colour = |patch: &u32| if *patch == NO_PATCH { Vec3::splat(0.2) } else { debug::hue(*patch) };
        Some(patches.iter().map(|patch| colour(patch).extend(0.0)).collect())
    }
}

/// Light at receivers by slot.
#[derive(Clone, Debug)]
pub struct Lit {
    /// E_dir, W·m⁻².
    pub dir: Vec<Vec4>,
    /// Everything else.
    pub light: Settled,
}

impl Lit {
    /// It, with the light that probes have under it.
    pub fn at_receivers(self, probes: Vec<Vec4>) -> SettledReceivers {
        let Self { dir: direct, light: Settled { emit, ind: indirect, bounces, converged, .. } } = self;
        SettledReceivers { light: ReceiverLight { direct, emit, indirect, probes }, bounces, converged }
    }
}

/// Pages with irradiance, and the scene whose surfaces read them.
struct LitPages<'a> {
    scene: &'a LoadedScene,
    pages: AtlasPages,
}

impl IndirectIrradiance for LitPages<'_> {
    fn indirect_irradiance(&self, surface: &Surface) -> Vec3 {
        read(self.scene, &self.pages, surface)
    }
}

impl<C: ClientColumns> Light for LightmapLight<C> {
    fn shading(&self) -> Shading {
        let pages = texture(wgpu::TextureSampleType::Float { filterable: false }, Dimension::D2Array);
        Shading { snippet: INDIRECT, bindings: vec![pages, storage_read()] }
    }

    fn settle<'a>(&'a self, lit: &LitScene<'a>, among: &Among<'_>, limit: Limit) -> SettledLight<'a> {
        let Settled { emit, ind, lambda, bounces, converged, .. } = self.settled(lit, among, limit).light;
        let pages = spread(&lit.scene.lightmap, &self.texels, &emit, &ind);
        let walks = self.walks(lit, lambda);
        SettledLight { indirect: Box::new(LitPages { scene: lit.scene, pages }), walks, bounces, converged }
    }

    fn incoming(&self, lit: &LitScene<'_>) -> Option<IncomingDirect> {
        Some(self.direct(lit, &Among::default()))
    }

    fn at_receivers(&self, lit: &LitScene<'_>, among: &Among<'_>, limit: Limit) -> Option<SettledReceivers> {
        Some(self.settled(lit, among, limit).at_receivers(Vec::new()))
    }

    fn sky_rows(&self) -> Option<&SkyRows> {
        Some(self.sky_rows.get_or_init(|| self.transport.sky_rows(&Threads)))
    }

    fn passes(
        &self,
        gpu: &Gpu,
        scene: &LoadedScene,
        shadow: &ShadowPass,
        _: [u32; 2],
    ) -> Result<Box<dyn LightPasses>> {
        Ok(Box::new(LightmapPasses::new(gpu, scene, self, shadow)?))
    }

    fn unshadowed(&self, light: Unshadowed<'_>) -> UnshadowedArrays {
        let emit = self.transport.emitter_irradiance(light.emitter_scale);
        UnshadowedArrays { emit, sky: self.transport.columns.skies_lambda(light.sky, light.panorama) }
    }

    fn tinted_albedo(&self, scene: &LoadedScene, tints: &Tints) -> Option<Vec<Vec4>> {
        let Transport { receivers, slots, .. } = &self.transport;
        let mut albedo = receivers.albedo.clone();
        let blocks = tints.by_block(scene).into_iter().zip(0..);
        for (new, block) in blocks.filter_map(|(albedo, block)| Some((albedo?, block))) {
            let [width, height] = slots.size(block).unwrap_or_default();
            for texel in (0..height).flat_map(|y| (0..width).map(move |x| [x as u16, y as u16])) {
                if let Some(slot) = slots.slot(block, texel) {
                    let own = &mut albedo[slot as usize];
                    *own = new.of(own.truncate()).extend(own.w);
                }
            }
        }
        Some(albedo)
    }

    fn set_albedo(&mut self, albedo: Vec<Vec4>) {
        self.transport.receivers.albedo = albedo;
    }

    fn debug_pictures(&self, scene: &LoadedScene) -> Vec<(&'static str, usize)> {
        [ATLAS, CLUSTERS].map(|name| (name, scene.lightmap.pages.len())).into()
    }

    fn debug_page(&self, name: &str, page: usize, lit: &LitScene<'_>, limit: Limit) -> Option<DebugPage> {
        match name {
            ATLAS => self.irradiance_page(page, lit, limit),
            CLUSTERS => self.cluster_page(page, lit.scene),
            _ => None,
        }
    }

    fn overlay(&self, overlay: Overlay, lod: Option<&LodPlan>) -> Option<Vec<Vec4>> {
        match overlay {
            Overlay::Lod => Some(self.by_cluster(|index| {
                let level = lod.and_then(|plan| plan.levels.get(index)).copied().unwrap_or(0);
                LEVEL_COLOURS[usize::from(level) % LOD_LEVELS]
            })),
            Overlay::Clusters => Some(self.by_cluster(|index| debug::hue(index as u32))),
            Overlay::Patches => self.by_patch(),
            Overlay::Residency { clusters } => Some(self.by_cluster(|index| match index < clusters {
                true => Vec3::new(0.1, 0.6, 0.15),
                false => Vec3::new(0.7, 0.1, 0.05),
            })),
            // Frames have them.
            Overlay::Errors { .. } => None,
        }
    }

    fn lod_table(&self) -> Option<&LodTable> {
        Some(self.lod())
    }

    fn plan_lod(&self, lod: &Lod, eye: LodEye, before: Option<&LodPlan>) -> Option<LodPlan> {
        Some(self.lod().plan(&self.transport.clusters, lod, eye, before))
    }

    fn count_lod(&self, plan: &LodPlan) -> Option<[LevelCount; LOD_LEVELS]> {
        Some(plan.counts(&self.transport.clusters))
    }

    fn voxels(&self) -> Option<(&VoxelTable, &PatchTable)> {
        self.elements()
    }

    fn volume(&self) -> Option<&TransferTable> {
        self.volume.as_ref()
    }

    fn lightmap<'a>(&'a self, scene: &'a LoadedScene) -> Option<Lightmap<'a>> {
        let Transport { slots, receivers, .. } = &self.transport;
        Some(Lightmap { layout: &scene.lightmap, slots, receivers, texels: &self.texels })
    }
}
