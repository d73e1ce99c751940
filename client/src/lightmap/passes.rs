//! The passes of light in a lightmap on the adapter, with their buffers.

use glam::{Affine3A, Vec4};
use lightkiln_proto::relight::{LodPlan, LodTable, SkyRows};

use super::moved::{AroundLight, MovedLight};
use super::{ClientColumns, LightmapLight};
use crate::bake::{LightPasses, ReceiverBuffers, UnshadowedArrays};
use crate::error::Result;
use crate::passes::around::AroundPass;
use crate::passes::atlas::{AtlasPass, placements};
use crate::passes::basis::BasisPass;
use crate::passes::direct::TexelsPass;
use crate::passes::gpu::Gpu;
use crate::passes::lod::LodPass;
use crate::passes::near::NearPass;
use crate::passes::place::Place;
use crate::passes::reconstruct::{ReconstructPass, RowArrays};
use crate::passes::resident::{ColumnsPass, Resident};
use crate::passes::shadow::ShadowPass;
use crate::passes::stopwatch::Recorder;
use crate::passes::transfer::MovedBuffers;
use crate::passes::walked::WalkedPass;
use crate::scene::LoadedScene;

/// direct → columns → basis → near → walked → reconstruct → stand-ins of the level of detail → atlas.
#[derive(Debug)]
pub struct LightmapPasses {
    pub(crate) resident: Resident,
    direct: TexelsPass,
    pub(crate) columns: Box<dyn ColumnsPass>,
    pub(crate) basis: BasisPass,
    pub(crate) near: NearPass,
    pub(crate) walked: Option<WalkedPass>,
    pub(crate) reconstruct: ReconstructPass,
    pub(crate) atlas: AtlasPass,
    placements: wgpu::Buffer,
    lod: Option<LodPass>,
    pub(super) moved: Option<MovedLight>,
    pub(super) around: Option<AroundLight>,
    /// Halves of colours by slot, and the atlas pass over them twice.
    paint: Option<(wgpu::Buffer, wgpu::BindGroup)>,
}

impl LightmapPasses {
    /// Uploads the light of a bake.
    pub fn new<C: ClientColumns>(
        gpu: &Gpu,
        scene: &LoadedScene,
        light: &LightmapLight<C>,
        shadow: &ShadowPass,
    ) -> Result<Self> {
        let transport = &light.transport;
        let mut resident = Resident::new(gpu, transport)?;
        // The bake of an object.
        resident.place = light.volume.as_ref().map(|_| Place::new(gpu));
        let receivers = RowArrays {
            b: &resident.b,
            start: &resident.e_near,
            beside: Some(&resident.e_emit),
            result: &resident.e_ind,
            detail: &resident.detail,
        };
        Ok(Self {
            direct: TexelsPass::new(gpu, shadow, &resident, &light.points)?,
            columns: transport.columns.pass(gpu, &resident)?,
            basis: BasisPass::new(
                gpu,
                &transport.clusters,
                [&resident.lambda, &resident.b],
                &resident.detail,
            )?,
            near: NearPass::new(gpu, &transport.near, shadow, &resident)?,
            walked: WalkedPass::new(gpu, &transport.walked, &resident)?,
            reconstruct: ReconstructPass::new(gpu, &transport.clusters, receivers)?,
            atlas: AtlasPass::new(gpu, &scene.lightmap, &light.texels, &resident)?,
            placements: gpu.storage("placements", &placements(scene))?,
            resident,
            lod: None,
            moved: None,
            around: None,
            paint: None,
        })
    }
}

impl LightPasses for LightmapPasses {
    /// E_emit, and λ of the sky.
    fn set_unshadowed(&self, gpu: &Gpu, UnshadowedArrays { emit, sky }: &UnshadowedArrays) {
        gpu.write(&self.resident.e_emit, emit);
        self.resident.write_sky(gpu, sky);
    }

    fn set_albedo(&self, gpu: &Gpu, albedo: &[Vec4]) {
        gpu.write(&self.resident.albedo, albedo);
    }

    /// E_dir at receivers and near hits.
    fn relit(&self, encoder: &mut Recorder<'_>, shadow: &ShadowPass) {
        self.direct.record(&mut encoder.compute("direct"), shadow);
        self.near.light(&mut encoder.compute("direct at near hits"), shadow);
    }

    /// E_ind of the bounce before → E_ind.
    fn bounce(&self, encoder: &mut Recorder<'_>) {
        if let Some(moved) = &self.moved {
            moved.add(encoder, &self.resident);
        }
        if let Some(around) = &self.around {
            around.begin(encoder, &self.resident);
        }
        self.columns.record(&mut encoder.compute("columns"));
        self.basis.record(&mut encoder.compute("basis"));
        if let Some(lod) = &self.lod {
            lod.mark(&mut encoder.compute("level of detail"));
        }
        self.near.record(&mut encoder.compute("near"));
        if let Some(walked) = &self.walked {
            walked.record(&mut encoder.compute("walks of receivers"));
        }
        if let Some(around) = &self.around {
            around.add(encoder);
        }
        if let Some(moved) = &self.moved {
            moved.take_away(encoder, &self.resident);
        }
        self.reconstruct.record(&mut encoder.compute("reconstruct"));
        if let Some(lod) = &self.lod {
            lod.fill(&mut encoder.compute("level of detail"));
        }
    }

    fn set_place(&self, gpu: &Gpu, world_from_own: &Affine3A) {
        if let Some(place) = &self.resident.place {
            place.set(gpu, world_from_own);
        }
    }

    fn make_moved(&mut self, gpu: &Gpu) -> Result<()> {
        self.moved = Some(MovedLight::new(gpu, &self.resident)?);
        Ok(())
    }

    fn moved(&self) -> Option<MovedBuffers<'_>> {
        let Resident { positions, normals, receiver_count: count, .. } = &self.resident;
        let moved = &self.moved.as_ref()?.moved;
        Some(MovedBuffers { positions, normals, moved, count: *count })
    }

    fn make_around(&mut self, gpu: &Gpu, around: &AroundPass, rows: &SkyRows) -> Result<()> {
        self.around = Some(AroundLight::new(gpu, &self.resident, around, rows)?);
        Ok(())
    }

    fn light_around(&self, encoder: &mut Recorder<'_>) {
        self.around.iter().for_each(|around| around.record(encoder));
    }

    fn make_lod(&mut self, gpu: &Gpu, table: &LodTable) -> Result<()> {
        self.lod = Some(LodPass::new(gpu, table, &self.resident)?);
        Ok(())
    }

    fn set_lod(&mut self, gpu: &Gpu, plan: Option<&LodPlan>) {
        if let Some(lod) = &mut self.lod {
            lod.set(gpu, &self.resident, plan);
        }
    }

    fn set_turn(&self, gpu: &Gpu, bounce: u32) {
        if let Some(lod) = &self.lod {
            lod.set_turn(gpu, &self.resident, bounce);
        }
    }

    /// E_emit + E_ind into the pages.
    fn publish(&self, encoder: &mut Recorder<'_>) {
        self.atlas.record(&mut encoder.compute("atlas"));
    }

    fn make_paint(&mut self, gpu: &Gpu) -> Result<()> {
        let colours = gpu.blank("colours", (self.resident.receiver_count * size_of::<Vec4>()) as u64)?;
        let group = self.atlas.bind(gpu, [&colours, &colours]);
        self.paint = Some((colours, group));
        Ok(())
    }

    fn paint(&self, gpu: &Gpu, encoder: &mut Recorder<'_>, colours: &[Vec4]) {
        let Some((halves, group)) = &self.paint else { return };
        let values: Vec<Vec4> = colours.iter().map(|colour| *colour * 0.5).collect();
        gpu.write(halves, &values);
        self.atlas.record_of(&mut encoder.compute("atlas"), group);
    }

    fn feedback(&self) -> Option<(&wgpu::Buffer, usize)> {
        Some((&self.resident.e_ind, self.resident.receiver_count))
    }

    fn at_receivers(&self) -> Option<ReceiverBuffers<'_>> {
        let Resident { e_dir: direct, e_emit: emit, e_ind: indirect, receiver_count: count, .. } =
            &self.resident;
        Some(ReceiverBuffers { direct, emit, indirect, count: *count, probes: None })
    }

    fn lambda(&self) -> Option<&wgpu::Buffer> {
        Some(&self.resident.lambda)
    }

    fn bindings(&self) -> Vec<wgpu::BindingResource<'_>> {
        vec![wgpu::BindingResource::TextureView(&self.atlas.view), self.placements.as_entire_binding()]
    }
}
