//! Pictures by the adapter.

use super::{Prepared, Reel, jitters};
use crate::error::Result;
use crate::frame::{Frame, FrameRoom};
use crate::passes::gpu::Gpu;
use crate::passes::shadow::ShadowRoom;
use crate::picture::{Film, Picture};

/// Draws pictures of one size, those that the reel has not yet.
pub(super) fn render(gpu: &Gpu, all: &[Prepared<'_>], reel: &mut Reel<'_>) -> Result<()> {
    let Some(mut frame) = frame(gpu, all)? else { return Ok(()) };
    for prepared in &all[reel.done..] {
        let view = prepared.view;
        set(&mut frame, prepared)?;
        let (bounces, converged) = frame.settle(view.limit)?;
        let mut film: Option<Film> = None;
        for jitter in jitters(view.samples) {
            frame.draw(jitter)?;
            let radiance = frame.read()?;
            let exposure = reel.exposure_of(view);
            film.get_or_insert_with(|| Film::new(view.size(), view.tone, exposure, &radiance)).add(&radiance);
        }
        let film = film.unwrap_or_else(|| Film::new(view.size(), view.tone, view.exposure, &[]));
        reel.push(Picture { drawn_by: gpu.name.clone(), bounces, converged, ..film.develop() })?;
    }
    Ok(())
}

/// A frame with room for views of one size and no more; `None` without any.
fn frame<'a>(gpu: &'a Gpu, all: &[Prepared<'a>]) -> Result<Option<Frame<'a>>> {
    let rooms = all.iter().map(|prepared| prepared.plan.room());
    let of_all = |a: ShadowRoom, b: ShadowRoom| ShadowRoom {
        lights: a.lights.max(b.lights),
        faces: a.faces.max(b.faces),
        side: a.side.min(b.side),
    };
    let Some((first, shadows)) = all.first().zip(rooms.reduce(of_all)) else { return Ok(None) };
    let room = FrameRoom { size: first.view.size(), shadows };
    Frame::new(gpu, first.bake, room, first.view.camera.clone()).map(Some)
}

/// Sets what a view has different.
fn set(frame: &mut Frame<'_>, Prepared { view, .. }: &Prepared<'_>) -> Result<()> {
    frame.set_lights(&view.lights)?;
    frame.set_emitters(&view.emitter_scale);
    frame.set_camera(view.camera.clone())
}

/// A frame of one view.
#[cfg(test)]
pub(crate) fn frame_of<'a>(gpu: &'a Gpu, prepared: Prepared<'a>) -> Result<Frame<'a>> {
    let all = [prepared];
    let mut frame = frame(gpu, &all)?.unwrap_or_else(|| unreachable!("there is a view"));
    set(&mut frame, &all[0])?;
    Ok(frame)
}
