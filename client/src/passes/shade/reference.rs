//! The picture on the processor: visibility by the software rasteriser, then every pixel's radiance.

use std::f32::consts::PI;
use std::ops::Range;

use glam::Vec4;
use rayon::prelude::*;

use super::lamps::seen_light;
use super::panes::Panes;
use super::specular::Gloss;
use super::surface::surface_at;
use super::{IndirectIrradiance, ShadeView, Surface};
use crate::lights::Panorama;
use crate::passes::fog::reference::Froxels;
use crate::passes::shadow::ShadowPlan;
use crate::passes::shadow::reference::{ShadowMaps, masked_out};
use crate::passes::walk::reference::{Found, Walked};
use crate::raster::{ScreenTriangle, projected, set_up};
use crate::scene::LoadedScene;

/// Rows that one thread draws at a time.
const BAND_ROWS: usize = 32;
/// Marks a pixel in which nothing is seen.
const NOTHING: u32 = u32::MAX;

/// Everything that shading reads.
#[derive(Clone, Copy)]
pub struct Lit<'a> {
    /// The scene.
    pub scene: &'a LoadedScene,
    /// Lights.
    pub plan: &'a ShadowPlan,
    /// Their shadow maps.
    pub maps: &'a ShadowMaps,
    /// Indirect light.
    pub indirect: &'a dyn IndirectIrradiance,
    /// A panorama behind the scene, on top of the view's sky.
    pub panorama: Option<&'a Panorama>,
    /// One factor per emitter, 1 if absent.
    pub emitter_scale: &'a [f32],
    /// A medium between surfaces.
    pub fog: Option<&'a Froxels>,
    /// Parts that walks make.
    pub walked: Option<&'a Walked<'a>>,
}

/// A triangle on the screen and its draw.
struct Drawn {
    draw: u32,
    triangle: ScreenTriangle,
}

/// Radiance per pixel (rgb, W·m⁻²·sr⁻¹) and whether a surface is seen (alpha 1) or the sky (0), row after row; of glass
/// before the sky, alpha is the share that it stops.
pub fn shade(lit: Lit<'_>, view: &ShadeView, size: [u32; 2]) -> Vec<Vec4> {
    let opaque = set_up_opaque(lit.scene, view, size);
    let panes = set_up_panes(lit.scene, view, size);
    let width = size[0] as usize;
    let mut picture = vec![Vec4::ZERO; width * size[1] as usize];
    picture.par_chunks_mut(BAND_ROWS * width).enumerate().for_each(|(band, pixels)| {
        let first = (band * BAND_ROWS) as u32;
        let rows = first..first + (pixels.len() / width) as u32;
        let (depth, seen) = visible(lit.scene, &opaque, size[0], rows.clone());
        for (index, (pixel, seen)) in pixels.iter_mut().zip(seen).enumerate() {
            let at = [(index % width) as f64 + 0.5, f64::from(first) + (index / width) as f64 + 0.5];
            *pixel = match opaque.get(seen as usize) {
                Some(drawn) => radiance(lit, view, drawn, at).truncate().extend(1.0),
                None => view.sky_at(at, size, lit.panorama).extend(0.0),
            };
        }
        blend_over(lit, view, &panes, size[0], rows, &depth, pixels);
        let Some(fog) = lit.fog else { return };
        for (index, (pixel, z)) in pixels.iter_mut().zip(depth).enumerate() {
            let at = [(index % width) as f32 + 0.5, (first as usize + index / width) as f32 + 0.5];
            *pixel = fog.over(*pixel, at, z);
        }
    });
    picture
}

/// Draws glass over the pixels of some rows, from behind: what it stops is replaced by its own radiance.
fn blend_over(
    lit: Lit<'_>,
    view: &ShadeView,
    panes: &[Drawn],
    width: u32,
    rows: Range<u32>,
    depth: &[f32],
    pixels: &mut [Vec4],
) {
    // Walks are of what is behind.
    let lit = Lit { walked: None, ..lit };
    for drawn in panes {
        drawn.triangle.rasterise(width, rows.clone(), |x, y, fragment| {
            let pixel = ((y - rows.start) * width + x) as usize;
            let nearer = fragment.depth > depth[pixel];
            if nearer
                && !masked_out(lit.scene, drawn.draw as usize, drawn.triangle.source, fragment.barycentric)
            {
                let own = radiance(lit, view, drawn, [f64::from(x) + 0.5, f64::from(y) + 0.5]);
                pixels[pixel] = own.truncate().extend(1.0) * own.w + pixels[pixel] * (1.0 - own.w);
            }
        });
    }
}

fn set_up_opaque(scene: &LoadedScene, view: &ShadeView, size: [u32; 2]) -> Vec<Drawn> {
    let opaque = scene.draws.draws.iter().zip(0..).filter(|(mesh, _)| scene.glass_of(mesh).is_none());
    let triangles = opaque.flat_map(|(mesh, draw)| {
        mesh.triangles.iter().zip(0..).map(move |(corners, triangle)| (draw, triangle, *corners))
    });
    set_up_all(scene, view, size, triangles)
}

/// Glass from the farthest to the nearest.
fn set_up_panes(scene: &LoadedScene, view: &ShadeView, size: [u32; 2]) -> Vec<Drawn> {
    let sorted = Panes::of(scene).farthest_first(view);
    let triangles = sorted.into_iter().map(|pane| (pane.draw, pane.triangle, pane.corners));
    set_up_all(scene, view, size, triangles)
}

/// The sides that are seen of triangles, each with its draw and number in it.
fn set_up_all(
    scene: &LoadedScene,
    view: &ShadeView,
    size: [u32; 2],
    triangles: impl Iterator<Item = (u32, u32, [u32; 3])>,
) -> Vec<Drawn> {
    let clip_of = projected(view.projection());
    let (mut drawn, mut set) = (Vec::new(), Vec::new());
    for (draw, triangle, corners) in triangles {
        let mesh = &scene.draws.draws[draw as usize];
        let double_sided = scene.manifest.materials[mesh.material as usize].double_sided;
        let clip = |index: u32| clip_of(mesh.vertices[index as usize].position_m);
        set_up(corners.map(clip), size, triangle, &mut set);
        let seen = set.drain(..).filter(|triangle| triangle.front || double_sided);
        drawn.extend(seen.map(|triangle| Drawn { draw, triangle }));
    }
    drawn
}

/// Depth and index of the nearest triangle per pixel of some rows, or [`NOTHING`].
fn visible(scene: &LoadedScene, drawn: &[Drawn], width: u32, rows: Range<u32>) -> (Vec<f32>, Vec<u32>) {
    let count = (rows.end - rows.start) as usize * width as usize;
    let (mut depth, mut seen) = (vec![0.0; count], vec![NOTHING; count]);
    for (index, Drawn { draw, triangle }) in drawn.iter().enumerate() {
        triangle.rasterise(width, rows.clone(), |x, y, fragment| {
            let pixel = ((y - rows.start) * width + x) as usize;
            let nearer = fragment.depth > depth[pixel];
            if nearer && !masked_out(scene, *draw as usize, triangle.source, fragment.barycentric) {
                depth[pixel] = fragment.depth;
                seen[pixel] = index as u32;
            }
        });
    }
    (depth, seen)
}

/// `L = Lₑ + ρ/π·(E_dir + E)` with indirect light E, METHOD.md §1, and what microfacets reflect, §2.15; w is the share of light that the
/// surface stops.
fn radiance(lit: Lit<'_>, view: &ShadeView, drawn: &Drawn, [x, y]: [f64; 2]) -> Vec4 {
    let shaded = surface_at(lit.scene, drawn.draw, &drawn.triangle, (x, y), (view, lit.emitter_scale));
    let surface = &shaded.surface;
    let about = |towards| lit.indirect.indirect_irradiance(&Surface { towards, ..*surface });
    if view.shows_irradiance() {
        return about(surface.normal).extend(shaded.stopped);
    }
    let eye = view.towards_eye(surface.position);
    let gloss = Gloss::of(shaded.albedo, shaded.metallic_roughness, surface.towards, eye);
    let seen = seen_light((lit.plan, lit.maps), surface, view.before(surface.position), &gloss);
    let found = lit.walked.map_or(Found::NOTHING, |walked| walked.at([x as u32, y as u32], surface, &gloss));
    let indirect = found.irradiance.unwrap_or_else(|| about(surface.towards)) * found.open;
    let mut own = shaded.emission + shaded.albedo * gloss.diffuse / PI * (seen.irradiance + indirect);
    if gloss.is_specular() {
        let mean = found.reflected.unwrap_or_else(|| about(gloss.lobe) * (found.open / PI));
        own += seen.reflected + gloss.reflectance * mean;
    }
    own.extend(shaded.stopped)
}
