//! Irradiance of receivers into lightmap texels, on the processor; and bilinear reads of them.

use glam::{Vec3, Vec4};
use lightkiln_proto::relight::{TexelKind, tap_weights, taps_around};

use super::AtlasTexels;
use crate::passes::shade::Surface;
use crate::scene::{LightmapLayout, LoadedScene};

/// Lightmap pages: irradiance in rgb; the fourth component is a [`TexelKind`].
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
        pages[page][index] = (sum / texel.count() as f32).truncate().extend(texel.kind);
    }
    AtlasPages { sizes: layout.pages.clone(), pages }
}

/// Indirect light of a surface, W·m⁻²: twin of `indirect_irradiance` in `lightmap.wgsl`.
pub fn read(scene: &LoadedScene, pages: &AtlasPages, surface: &Surface) -> Vec3 {
    let draw = &scene.draws.draws[surface.draw as usize];
    let block = if surface.front { draw.front } else { draw.back };
    let (texel, before) = (surface.lightmap_texel, surface.lightmap_before);
    seen(&scene.lightmap, pages, block, texel, before).unwrap_or_default()
}

/// Irradiance at lightmap coordinates of a block, W·m⁻², read as [`tap_weights`] says; black where there is none.
pub fn sample(layout: &LightmapLayout, atlas: &AtlasPages, block: u32, texel: [f32; 2]) -> Vec3 {
    shown(layout, atlas, block, texel).unwrap_or_default()
}

/// As [`sample`]; `None` where no texel around the place holds light.
pub fn shown(layout: &LightmapLayout, atlas: &AtlasPages, block: u32, texel: [f32; 2]) -> Option<Vec3> {
    seen(layout, atlas, block, texel, texel)
}

/// As [`shown`] to an eye, which a place before is nearer to: it tells on which side of edges the point lies.
fn seen(
    layout: &LightmapLayout,
    atlas: &AtlasPages,
    block: u32,
    texel: [f32; 2],
    before: [f32; 2],
) -> Option<Vec3> {
    let block = layout.block(block)?;
    let page = &atlas.pages[block.page as usize];
    let width = atlas.sizes[block.page as usize][0];
    let (texels, share) = taps_around(block.size, texel);
    let taps: [Vec4; 4] = texels.map(|texel| {
        let [column, row] = [0, 1].map(|axis| block.origin[axis] + u32::from(texel[axis]));
        page[row as usize * width as usize + column as usize]
    });
    let before = [0, 1].map(|axis| share[axis] + (before[axis] - texel[axis]));
    let weights = tap_weights(taps.map(|tap| TexelKind(tap.w)), share, before);
    let sum = taps.iter().zip(weights).map(|(tap, weight)| tap.truncate() * weight).sum();
    weights.iter().any(|weight| *weight > 0.0).then_some(sum)
}
