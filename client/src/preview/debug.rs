//! Pictures for finding faults: the irradiance atlas, and clusters coloured.

use glam::{Vec3, Vec4};

use super::cpu::settle;
use super::{Prepared, View};
use crate::bake::LoadedBake;
use crate::error::Result;
use crate::lights::{Caster, Sky};
use crate::passes::atlas::reference::spread;
use crate::passes::shadow::ShadowPlan;
use crate::passes::shadow::reference::draw;
use crate::picture::{Film, Picture};

/// One atlas page as a picture of total irradiance (direct, emitters', indirect) in W·m⁻²; on the processor.
pub fn atlas_picture(bake: &LoadedBake, view: &View, page: usize) -> Result<Picture> {
    let plan = ShadowPlan::new(&Caster::of(&view.lights), bake.manifest.bounds_m, view.shadow_side)?;
    let prepared = Prepared { bake, view, plan, sky: Sky::of(&view.lights) };
    let maps = draw(bake, &prepared.plan);
    let settled = settle(&prepared, &maps);
    let straight: Vec<Vec4> = settled.dir.iter().zip(&settled.emit).map(|(dir, emit)| *dir + *emit).collect();
    let picture = page_picture(bake, view, page, &straight, &settled.ind);
    Ok(Picture { frames: settled.frames, converged: settled.converged, ..picture })
}

/// One atlas page with a colour of its own for each cluster.
pub fn cluster_picture(bake: &LoadedBake, view: &View, page: usize) -> Picture {
    let mut colours = vec![Vec4::ZERO; bake.receivers.len()];
    for (index, cluster) in bake.clusters.clusters.iter().enumerate() {
        let slots = &mut colours[cluster.first_receiver..][..cluster.receiver_count];
        slots.fill(hue(index as u32).extend(0.0));
    }
    let black = vec![Vec4::ZERO; colours.len()];
    page_picture(bake, view, page, &colours, &black)
}

/// Colours far apart for neighbouring numbers: golden-angle hues.
fn hue(index: u32) -> Vec3 {
    let turn = (f64::from(index) * 0.618_033_988_749_895).fract() as f32;
    let channel = |offset: f32| 0.55 + 0.45 * (std::f32::consts::TAU * (turn + offset)).cos();
    Vec3::new(channel(0.0), channel(1.0 / 3.0), channel(2.0 / 3.0))
}

fn page_picture(bake: &LoadedBake, view: &View, page: usize, first: &[Vec4], second: &[Vec4]) -> Picture {
    let atlas = spread(&bake.atlas, first, second);
    let size = atlas.sizes.get(page).copied().unwrap_or([0, 0]);
    let texels = atlas.pages.get(page).map_or(&[][..], Vec::as_slice);
    let mut film = Film::new(size, view.tone, view.exposure, texels);
    film.add(texels);
    Picture { drawn_by: "the processor".to_owned(), by_reference: true, ..film.develop() }
}
