//! The whole frame on the adapter.

use glam::Vec4;
use lightkiln_proto::relight::Settled;

use super::{Prepared, jitters};
use crate::bake::LightPasses;
use crate::error::Result;
use crate::passes::gpu::Gpu;
use crate::passes::meshes::Meshes;
use crate::passes::shade::{ShadePass, ShadeView};
use crate::passes::shadow::ShadowPass;
use crate::picture::{Film, Picture};

/// Bounces between two looks at how much E_ind still changes.
const BOUNCES_PER_LOOK: u32 = 4;

/// All passes of a view, with their buffers.
pub(crate) struct Frame {
    pub meshes: Meshes,
    pub shadow: ShadowPass,
    pub light: Box<dyn LightPasses>,
    pub shade: ShadePass,
}

impl Frame {
    pub fn new(gpu: &Gpu, prepared: &Prepared<'_>) -> Result<Self> {
        let Prepared { bake, view, plan, .. } = prepared;
        let (scene, unshadowed) = (&bake.scene, prepared.unshadowed());
        let meshes = Meshes::new(gpu, scene)?;
        let shadow = ShadowPass::new(gpu, scene, &meshes, plan)?;
        let light = bake.light.passes(gpu, scene, &shadow, unshadowed, view.size())?;
        let shading = (&bake.light.shading(), &light.bindings()[..]);
        let scale = unshadowed.emitter_scale;
        let shade = ShadePass::new(gpu, scene, &meshes, &shadow, shading, scale, view.size())?;
        gpu.check()?;
        Ok(Self { meshes, shadow, light, shade })
    }

    /// Shadow maps, and all that depends on lights alone.
    pub fn relit(&self, gpu: &Gpu) {
        gpu.submit(|encoder| {
            self.shadow.record(encoder, &self.meshes);
            self.light.relit(encoder, &self.shadow);
        });
    }

    /// One bounce: E_ind of the bounce before → E_ind.
    pub fn bounce(&self, gpu: &Gpu) {
        gpu.submit(|encoder| self.light.bounce(encoder));
    }

    /// The bounces' result to the bindings of shading.
    pub fn publish(&self, gpu: &Gpu) {
        gpu.submit(|encoder| self.light.publish(encoder));
    }

    /// One sample per pixel of a view, read back: rgb radiance, alpha 1 on surfaces.
    pub fn draw(&self, gpu: &Gpu, view: &ShadeView) -> Result<Vec<Vec4>> {
        gpu.submit(|encoder| self.light.prepare_view(gpu, encoder, view));
        self.shade.draw(gpu, &self.meshes, &self.shadow, view)
    }
}

/// Draws the picture.
pub(super) fn render(gpu: &Gpu, prepared: &Prepared<'_>) -> Result<Picture> {
    let Prepared { bake, view, sky, .. } = prepared;
    let frame = Frame::new(gpu, prepared)?;
    frame.relit(gpu);
    let (bounces, converged) = settle(gpu, &frame, prepared)?;
    frame.publish(gpu);
    let bounds_m = bake.scene.manifest.bounds_m;
    let mut film: Option<Film> = None;
    for jitter in jitters(view.samples) {
        let shade_view = ShadeView::new(&view.camera, view.size(), bounds_m, *sky, jitter)?;
        let radiance = frame.draw(gpu, &shade_view)?;
        film.get_or_insert_with(|| Film::new(view.size(), view.tone, view.exposure, &radiance))
            .add(&radiance);
    }
    let film = film.unwrap_or_else(|| Film::new(view.size(), view.tone, view.exposure, &[]));
    Ok(Picture { bounces, converged, ..film.develop() })
}

/// Feeds bounces back until E_ind changes by less than the view's limit; bounces, and whether they converged.
fn settle(gpu: &Gpu, frame: &Frame, prepared: &Prepared<'_>) -> Result<(u32, bool)> {
    let limit = prepared.view.limit;
    let Some((e_ind, count)) = frame.light.feedback() else { return Ok((0, true)) };
    let read = || gpu.read::<Vec4>(e_ind, count);
    let mut bounces = 0;
    while bounces < limit.bounces_max {
        for _ in 1..BOUNCES_PER_LOOK.min(limit.bounces_max - bounces) {
            frame.bounce(gpu);
            bounces += 1;
        }
        let last = read()?;
        frame.bounce(gpu);
        bounces += 1;
        if Settled::change(&last, &read()?) < limit.change_max {
            return Ok((bounces, true));
        }
    }
    Ok((bounces, false))
}
