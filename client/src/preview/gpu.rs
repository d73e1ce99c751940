//! Pictures by the adapter.

use super::{Reel, View, Views, jitters};
use crate::bake::LoadedBake;
use crate::error::Result;
use crate::frame::{Frame, FrameRoom};
use crate::passes::gpu::Gpu;
use crate::passes::shadow::ShadowRoom;
use crate::picture::{Film, Picture};

/// Draws the pictures that the reel has not yet, with room for the shadow maps of each.
pub(super) fn render(
    gpu: &Gpu,
    bake: &LoadedBake,
    ((count, view_of), shadows): (Views<'_>, ShadowRoom),
    reel: &mut Reel<'_>,
) -> Result<()> {
    let mut kept: Option<Frame<'_>> = None;
    for index in reel.done..count {
        let view = view_of(index);
        let frame = match &mut kept {
            Some(frame) => frame,
            None => kept.insert(frame(gpu, bake, &view, shadows)?),
        };
        set(frame, &view)?;
        let (bounces, converged) = frame.settle(view.limit)?;
        let mut film: Option<Film> = None;
        for jitter in jitters(view.samples) {
            frame.draw(jitter)?;
            let radiance = frame.read()?;
            let exposure = reel.exposure_of(&view);
            film.get_or_insert_with(|| Film::new(view.size(), view.tone, exposure, &radiance)).add(&radiance);
        }
        let film = film.unwrap_or_else(|| Film::new(view.size(), view.tone, view.exposure, &[]));
        frame.hear_times()?;
        let pass_times = frame.pass_times().map(<[_]>::to_vec);
        let drawn_by = gpu.name.clone();
        let lod = frame.lod_counts();
        reel.push(Picture { drawn_by, bounces, converged, pass_times, lod, ..film.develop() })?;
    }
    Ok(())
}

fn frame<'a>(gpu: &'a Gpu, bake: &'a LoadedBake, view: &View, shadows: ShadowRoom) -> Result<Frame<'a>> {
    Frame::new(gpu, bake, FrameRoom { size: view.size(), shadows }, view.camera.clone())
}

/// Sets what a view has different.
fn set(frame: &mut Frame<'_>, view: &View) -> Result<()> {
    frame.set_lights(&view.lights)?;
    frame.set_sky(view.panorama.as_ref())?;
    frame.set_emitters(&view.emitter_scale)?;
    frame.set_fog(view.fog)?;
    frame.set_details(view.details);
    frame.set_walks(view.walks)?;
    frame.set_objects(&view.objects)?;
    // A plan of the picture before would keep levels within their margin: each has its own, as the processor's.
    frame.set_lod(None)?;
    frame.set_camera(view.camera.clone())?;
    frame.set_lod(view.lod)
}

/// A frame with room for a view and no more, under its lights.
#[cfg(test)]
pub(crate) fn frame_of<'a>(gpu: &'a Gpu, bake: &'a LoadedBake, view: &View) -> Result<Frame<'a>> {
    let prepared = super::Prepared::new(bake, view)?;
    let mut frame = frame(gpu, bake, view, prepared.plan.room())?;
    set(&mut frame, view)?;
    Ok(frame)
}
