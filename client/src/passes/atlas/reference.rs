//! Irradiance of receivers into lightmap texels, on the processor; and bilinear reads of them.

use glam::{Vec3, Vec4};

use super::AtlasTexels;
use crate::passes::shade::Surface;
use crate::scene::{LightmapLayout, LoadedScene};

/// Lightmap pages: irradiance in rgb; the fourth component is 0 in empty texels, else [`super::AtlasTexel::kind`].
#[derive(Clone, Debug, PartialEq)]
pub struct AtlasPages {
    /// Width and height of every page.
    pub sizes: Vec<[u32; 2]>,
    /// Texels of every page, row after row.
    pub pages: Vec<Vec<Vec4>>,
}

/// Writes `E_emit + E_ind` of receivers (by slot, W·m⁻²) to their texels and extends chart edges.
pub fn spread(layout: &LightmapLayout, texels: &AtlasTexels, e_emit: &[Vec4], e_ind: &[Vec4]) -> AtlasPages {
    let blank = |size: &[u32; 2]| vec![Vec4::ZERO; size[0] as usize * size[1] as usize];
    let mut pages: Vec<Vec<Vec4>> = layout.pages.iter().map(blank).collect();
    for texel in &texels.texels {
        let sources = &texels.sources[texel.first as usize..][..texel.count() as usize];
        let sum: Vec4 = sources.iter().map(|slot| e_emit[*slot as usize] + e_ind[*slot as usize]).sum();
        let page = texel.page() as usize;
        let index = texel.y as usize * layout.pages[page][0] as usize + texel.x as usize;
        pages[page][index] = (sum / texel.count() as f32).truncate().extend(texel.kind());
    }
    AtlasPages { sizes: layout.pages.clone(), pages }
}

/// Indirect light of a surface, W·m⁻²: twin of `indirect_irradiance` in `lightmap.wgsl`.
pub fn read(scene: &LoadedScene, pages: &AtlasPages, surface: &Surface) -> Vec3 {
    let draw = &scene.draws.draws[surface.draw as usize];
    let block = if surface.front { draw.front } else { draw.back };
    sample(&scene.lightmap, pages, block, surface.lightmap_texel)
}

/// Irradiance at lightmap coordinates of a block, W·m⁻²: bilinear over the receivers that no wall parts from the
/// nearest one; over filled texels where there is no receiver.
pub fn sample(layout: &LightmapLayout, atlas: &AtlasPages, block: u32, texel: [f32; 2]) -> Vec3 {
    let Some(block) = layout.block(block) else { return Vec3::ZERO };
    let page = &atlas.pages[block.page as usize];
    let width = atlas.sizes[block.page as usize][0];
    let (x, y) = (texel[0] - 0.5, texel[1] - 0.5);
    let (x0, y0) = (x.floor(), y.floor());
    let (share_x, share_y) = (x - x0, y - y0);
    let (mut taps, mut weights) = ([Vec4::ZERO; 4], [0.0; 4]);
    for tap in 0..4 {
        let (dx, dy) = ((tap & 1) as f32, (tap >> 1) as f32);
        let column = block.origin[0] + inside(x0 + dx, block.size[0]);
        let row = block.origin[1] + inside(y0 + dy, block.size[1]);
        let weight_x = if dx == 0.0 { 1.0 - share_x } else { share_x };
        let weight_y = if dy == 0.0 { 1.0 - share_y } else { share_y };
        // Never quite 0, so that a lone receiver counts wherever it lies.
        weights[tap] = weight_x * weight_y + 1e-6;
        taps[tap] = page[row as usize * width as usize + column as usize];
    }
    blend(taps, weights)
}

/// Taps in the order (0,0), (1,0), (0,1), (1,1); their w is [`super::AtlasTexel::kind`].
fn blend(taps: [Vec4; 4], weights: [f32; 4]) -> Vec3 {
    let mut home = 4;
    for tap in 0..4 {
        if taps[tap].w > 0.0 && (home == 4 || weights[tap] > weights[home]) {
            home = tap;
        }
    }
    let (mut sum, mut total) = (Vec3::ZERO, 0.0);
    for tap in 0..4 {
        let counts = if home == 4 { taps[tap].w < 0.0 } else { tap == home || linked(taps, home, tap) };
        if counts {
            sum += weights[tap] * taps[tap].truncate();
            total += weights[tap];
        }
    }
    if total > 0.0 { sum / total } else { Vec3::ZERO }
}

/// Whether no wall stands between two taps that are receivers; each link is a bit of the earlier tap.
fn linked(taps: [Vec4; 4], one: usize, other: usize) -> bool {
    let (first, second) = (one.min(other), one.max(other));
    if taps[first].w <= 0.0 || taps[second].w <= 0.0 {
        return false;
    }
    let bit = match (first, second) {
        (0, 1) | (2, 3) => 0,
        (0, 2) | (1, 3) => 1,
        (0, 3) => 2,
        _ => 3,
    };
    (taps[first].w as u32 - 1) >> bit & 1 == 1
}

fn inside(index: f32, size: u32) -> u32 {
    index.clamp(0.0, size as f32 - 1.0) as u32
}
