//! The whole frame on the adapter.

use glam::Vec4;
use lightkiln_proto::prt::BasisKind;

use super::cpu::change;
use super::{Prepared, jitters};
use crate::error::Result;
use crate::passes::atlas::AtlasPass;
use crate::passes::basis::BasisPass;
use crate::passes::direct::{DirectPass, Points};
use crate::passes::gpu::Gpu;
use crate::passes::meshes::Meshes;
use crate::passes::near::NearPass;
use crate::passes::patches::PatchesPass;
use crate::passes::reconstruct::ReconstructPass;
use crate::passes::relight::{RelightPass, RelightTable};
use crate::passes::resident::Resident;
use crate::passes::shade::{ShadePass, ShadeView};
use crate::passes::shadow::ShadowPass;
use crate::picture::{Film, Picture};

/// Frames between two looks at how much E_ind still changes.
const FRAMES_PER_LOOK: u32 = 4;

/// What turns irradiance into λ, by the bake's basis.
pub(crate) enum LightPass {
    /// Spherical harmonics at probes.
    Probes(RelightPass),
    /// Means of patches.
    Patches(PatchesPass),
}

impl LightPass {
    /// Records the pass.
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>) {
        match self {
            Self::Probes(probes) => probes.record(pass),
            Self::Patches(patches) => patches.record(pass),
        }
    }
}

/// All passes of a view, with their buffers.
pub(crate) struct Frame {
    pub resident: Resident,
    pub meshes: Meshes,
    pub shadow: ShadowPass,
    pub direct: DirectPass,
    pub relight: LightPass,
    pub basis: BasisPass,
    pub near: NearPass,
    pub reconstruct: ReconstructPass,
    pub atlas: AtlasPass,
    pub shade: ShadePass,
}

impl Frame {
    pub fn new(gpu: &Gpu, prepared: &Prepared<'_>) -> Result<Self> {
        let Prepared { bake, view, plan, sky } = prepared;
        let emit = bake.emitter_irradiance(&view.emitter_scale);
        let resident = Resident::new(gpu, bake, &emit)?;
        let meshes = Meshes::new(gpu, bake)?;
        let shadow = ShadowPass::new(gpu, bake, &meshes, plan)?;
        let points = Points {
            count: resident.receiver_count as u32,
            positions: &resident.positions,
            normals: &resident.normals,
            e_dir: &resident.e_dir,
        };
        let direct = DirectPass::new(gpu, &shadow, points);
        let relight = match bake.manifest.settings.basis {
            BasisKind::Sh => {
                LightPass::Probes(RelightPass::new(gpu, bake, &RelightTable::new(bake, *sky), &resident)?)
            }
            BasisKind::Patches => LightPass::Patches(PatchesPass::new(gpu, bake, *sky, &resident)?),
        };
        let basis = BasisPass::new(gpu, bake, &resident)?;
        let near = NearPass::new(gpu, bake, &shadow, &resident)?;
        let reconstruct = ReconstructPass::new(gpu, bake, &resident)?;
        let atlas = AtlasPass::new(gpu, bake, &resident)?;
        let scale = &view.emitter_scale;
        let shade = ShadePass::new(gpu, bake, &meshes, &shadow, &atlas.texture, scale, view.size())?;
        gpu.check()?;
        Ok(Self { resident, meshes, shadow, direct, relight, basis, near, reconstruct, atlas, shade })
    }

    /// Shadow maps and E_dir.
    pub fn light(&self, gpu: &Gpu) {
        gpu.submit(|encoder| {
            self.shadow.record(encoder, &self.meshes);
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            self.direct.record(&mut pass, &self.shadow);
            self.near.light(&mut pass, &self.shadow);
        });
    }

    /// One bounce: E_ind of the frame before → E_ind.
    pub fn bounce(&self, gpu: &Gpu) {
        gpu.submit(|encoder| {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            self.relight.record(&mut pass);
            self.basis.record(&mut pass);
            self.near.record(&mut pass);
            self.reconstruct.record(&mut pass);
        });
    }

    /// E_emit + E_ind into the atlas.
    pub fn spread(&self, gpu: &Gpu) {
        gpu.submit(|encoder| {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            self.atlas.record(&mut pass);
        });
    }
}

/// Draws the picture.
pub(super) fn render(gpu: &Gpu, prepared: &Prepared<'_>) -> Result<Picture> {
    let Prepared { bake, view, sky, .. } = prepared;
    let frame = Frame::new(gpu, prepared)?;
    frame.light(gpu);
    let (frames, converged) = settle(gpu, &frame, prepared)?;
    frame.spread(gpu);
    let mut film: Option<Film> = None;
    for jitter in jitters(view.samples) {
        let shade_view = ShadeView::new(&view.camera, view.size(), bake.manifest.bounds_m, *sky, jitter)?;
        let radiance = frame.shade.draw(gpu, &frame.meshes, &frame.shadow, &shade_view)?;
        film.get_or_insert_with(|| Film::new(view.size(), view.tone, view.exposure, &radiance))
            .add(&radiance);
    }
    let film = film.unwrap_or_else(|| Film::new(view.size(), view.tone, view.exposure, &[]));
    Ok(Picture { frames, converged, ..film.develop() })
}

/// Feeds bounces back until E_ind changes by less than the view's limit; frames, and whether it settled.
fn settle(gpu: &Gpu, frame: &Frame, prepared: &Prepared<'_>) -> Result<(u32, bool)> {
    let view = prepared.view;
    let read = || gpu.read::<Vec4>(&frame.resident.e_ind, frame.resident.receiver_count);
    let mut frames = 0;
    while frames < view.frames_max {
        for _ in 1..FRAMES_PER_LOOK.min(view.frames_max - frames) {
            frame.bounce(gpu);
            frames += 1;
        }
        let last = read()?;
        frame.bounce(gpu);
        frames += 1;
        if change(&last, &read()?) < view.change_max {
            return Ok((frames, true));
        }
    }
    Ok((frames, false))
}
