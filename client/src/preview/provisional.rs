//! The share of a picture's light that is provisional.

use std::sync::atomic::{AtomicU64, Ordering};

use glam::{Vec3, Vec4};

use super::{Prepared, View};
use crate::bake::Edited;
use crate::error::Result;
use crate::passes::atlas::Lightmap;
use crate::passes::atlas::reference::{AtlasPages, read, spread};
use crate::passes::shade::reference::{Lit, shade};
use crate::passes::shade::{IndirectIrradiance, ShadeView, Surface};
use crate::passes::shadow::reference::draw;
use crate::passes::walk::Walks;
use crate::scene::LoadedScene;

/// Parts that a surface counts as.
const PARTS: f32 = 1024.0;

/// Pages that hold the share of light that is provisional.
struct Marked<'a> {
    scene: &'a LoadedScene,
    pages: AtlasPages,
    /// Parts of surfaces that are provisional, and all.
    counts: [AtomicU64; 2],
}

impl IndirectIrradiance for Marked<'_> {
    fn indirect_irradiance(&self, surface: &Surface) -> Vec3 {
        let share = read(self.scene, &self.pages, surface).x.clamp(0.0, 1.0);
        self.counts[0].fetch_add((PARTS * share).round() as u64, Ordering::Relaxed);
        self.counts[1].fetch_add(PARTS as u64, Ordering::Relaxed);
        Vec3::ZERO
    }
}

/// Mean over the surfaces in a picture of the share of their light that is provisional, 0 to 1.
pub fn provisional_share(Edited { bake, provisional }: &Edited, view: &View) -> Result<f32> {
    let Some(Lightmap { layout, texels, .. }) = bake.light.lightmap(&bake.scene) else { return Ok(0.0) };
    let marks: Vec<Vec4> = provisional.iter().map(|share| Vec4::splat(*share)).collect();
    let none = vec![Vec4::ZERO; marks.len()];
    // No light is asked for.
    let dark = View { lights: Vec::new(), fog: None, lod: None, walks: Walks::default(), ..view.clone() };
    let Prepared { scene, bounds_m, view, plan, sky, .. } = &Prepared::new(bake, &dark)?;
    let marked = Marked { scene, pages: spread(layout, texels, &marks, &none), counts: Default::default() };
    let maps = draw(scene, plan);
    let shade_view = ShadeView::new(&view.camera, view.size(), *bounds_m, *sky, [0.0; 2])?;
    let lit = Lit {
        scene,
        plan,
        maps: &maps,
        indirect: &marked,
        panorama: None,
        emitter_scale: &[],
        fog: None,
        walked: None,
    };
    shade(lit, &shade_view, view.size());
    let [some, all] = marked.counts.map(AtomicU64::into_inner);
    Ok(some as f32 / all.max(1) as f32)
}
