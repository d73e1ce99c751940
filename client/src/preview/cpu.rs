//! The whole frame on the processor, by the passes' references.

use super::{Prepared, jitters};
use crate::bake::{SettledLight, SettledWalks};
use crate::error::{ClientError, Result};
use crate::movers::Standings;
use crate::passes::fog::FogNumbers;
use crate::passes::fog::reference::Froxels;
use crate::passes::shade::ShadeView;
use crate::passes::shade::reference::{Lit, shade};
use crate::passes::shadow::reference::draw;
use crate::passes::walk::reference::{Walked, seen};
use crate::passes::walk::sample_identity;
use crate::picture::{Exposure, Film, Picture};
use crate::scene::LoadedScene;

/// Draws the picture.
pub(super) fn render(prepared: &Prepared<'_>, exposure: Exposure) -> Result<Picture> {
    let Prepared { bake, scene, bounds_m, view, plan, sky, lod } = prepared;
    let scene: &LoadedScene = scene;
    let maps = draw(scene, plan);
    let standings = Standings::new(bake, &view.objects, &view.emitter_scale)?;
    let lit = prepared.lit(&maps);
    let SettledLight { mut indirect, walks, bounces, converged } = standings.settle(&lit, view.limit);
    if view.walks.asks_for_voxels() && walks.is_none() {
        let problem = "need a bake with voxels; bake it with --set voxels=on".to_owned();
        return Err(ClientError::Argument { what: "walks".to_owned(), problem });
    }
    let light = walks.as_ref().map(SettledWalks::light);
    let fog = view.fog.map(|fog| {
        let steady = ShadeView::new(&view.camera, view.size(), *bounds_m, *sky, [0.0; 2])?;
        let numbers = FogNumbers::new(&fog, &view.camera, &steady, view.size(), *bounds_m);
        let mean_radiance = |point| indirect.mean_radiance(point);
        Ok::<_, ClientError>(Froxels::new(numbers, (plan, &maps), &mean_radiance))
    });
    let fog = fog.transpose()?;
    let mut film: Option<Film> = None;
    for jitter in jitters(view.samples) {
        let shade_view = ShadeView::new(&view.camera, view.size(), *bounds_m, *sky, jitter)?;
        let shade_view = shade_view.with_details(view.details);
        indirect.prepare_view(&shade_view, view.size());
        let (indirect, emitter_scale) = (&*indirect, &view.emitter_scale[..]);
        let panorama = view.panorama.as_deref();
        let (width, turn) = (view.width, sample_identity(jitter));
        let walked = light.as_ref().map(|light| Walked { light, walks: view.walks, width, turn });
        let (walked, fog) = (walked.as_ref(), fog.as_ref());
        let lit = Lit { scene, plan, maps: &maps, indirect, panorama, emitter_scale, fog, walked };
        let radiance = match light.as_ref().filter(|_| view.walks.eye) {
            Some(light) => seen(light, &shade_view, view.size()),
            None => shade(lit, &shade_view, view.size()),
        };
        film.get_or_insert_with(|| Film::new(view.size(), view.tone, exposure, &radiance)).add(&radiance);
    }
    let film = film.unwrap_or_else(|| Film::new(view.size(), view.tone, exposure, &[]));
    let lod = lod.as_ref().and_then(|plan| bake.light.count_lod(plan));
    Ok(Picture { by_reference: true, bounces, converged, lod, ..film.develop() })
}
