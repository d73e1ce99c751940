//! Shadow maps on the processor.

use std::ops::Range;

use glam::{IVec2, Mat4};
use lightkiln_proto::manifest::TextureUse;
use rayon::prelude::*;

use super::ShadowPlan;
use crate::passes::shade::surface::mapped_uv;
use crate::raster::{ScreenTriangle, projected, set_up};
use crate::scene::{LoadedDraw, LoadedScene, Vertex};

/// Shadow maps: reversed depth, face after face, row after row; 0 where nothing is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ShadowMaps {
    /// Texels along a side.
    pub side: u32,
    /// `faces · side · side` depths of what stops all light.
    pub depth: Vec<f32>,
    /// As many depths of the glass nearest to the light; none in a scene without glass.
    pub pane_depth: Vec<f32>,
    /// Shares of light that pass all glass before the next opaque surface; none in a scene without glass.
    pub passed: Vec<f32>,
}

impl ShadowMaps {
    /// Depth of a texel of a face; beyond the rim that of the rim.
    pub(in crate::passes) fn depth_at(&self, face_index: u32, texel: IVec2) -> f32 {
        let side = self.side as usize;
        let inside = texel.clamp(IVec2::ZERO, IVec2::splat(self.side as i32 - 1)).as_uvec2();
        self.depth[(face_index as usize * side + inside.y as usize) * side + inside.x as usize]
    }

    /// Share of the light that passes the glass before a depth, of a texel by its index. Between two panes it is that of
    /// both.
    pub(in crate::passes) fn passed(&self, index: usize, depth: f32) -> f32 {
        match self.pane_depth.get(index) {
            Some(pane) if *pane > depth => self.passed[index],
            _ => 1.0,
        }
    }
}

/// Rows that one thread draws at a time.
const BAND_ROWS: usize = 128;

/// Draws all faces of a plan.
pub fn draw(scene: &LoadedScene, plan: &ShadowPlan) -> ShadowMaps {
    draw_first(scene, plan, scene.draws.draws.len())
}

/// Likewise, of the bake's own meshes alone.
pub fn draw_own(scene: &LoadedScene, plan: &ShadowPlan) -> ShadowMaps {
    draw_first(scene, plan, scene.own_draws())
}

/// Likewise, of the first so many meshes.
fn draw_first(scene: &LoadedScene, plan: &ShadowPlan, meshes: usize) -> ShadowMaps {
    let side = plan.count.side;
    let area = side as usize * side as usize;
    let count = area * plan.faces.len();
    let of_panes = if scene.has_glass() { count } else { 0 };
    let mut maps = ShadowMaps {
        side,
        depth: vec![0.0; count],
        pane_depth: vec![0.0; of_panes],
        passed: vec![1.0; of_panes],
    };
    let rows = BAND_ROWS * side as usize;
    for (index, face) in plan.faces.iter().enumerate() {
        let set_up = |of_glass| set_up_scene((scene, meshes), face.projection(), side, of_glass);
        let texels = index * area..(index + 1) * area;
        let depth = &mut maps.depth[texels.clone()];
        let triangles = set_up(false);
        depth.par_chunks_mut(rows).enumerate().for_each(|(band, depth)| {
            draw_band(scene, &triangles, side, rows_of(band, depth.len(), side), depth);
        });
        if of_panes > 0 {
            let panes = set_up(true);
            let pane_depth = maps.pane_depth[texels.clone()].par_chunks_mut(rows);
            let passed = maps.passed[texels].par_chunks_mut(rows);
            depth.par_chunks(rows).zip(pane_depth.zip(passed)).enumerate().for_each(
                |(band, (depth, (pane_depth, passed)))| {
                    let rows = rows_of(band, depth.len(), side);
                    draw_panes(scene, &panes, side, rows, (depth, pane_depth, passed));
                },
            );
        }
    }
    maps
}

fn rows_of(band: usize, texels: usize, side: u32) -> Range<u32> {
    let first = (band * BAND_ROWS) as u32;
    first..first + (texels / side as usize) as u32
}

/// Triangles of one draw on the screen.
struct DrawnMesh {
    draw: usize,
    triangles: Vec<ScreenTriangle>,
}

fn set_up_scene(
    (scene, meshes): (&LoadedScene, usize),
    clip_from_world: Mat4,
    side: u32,
    of_glass: bool,
) -> Vec<DrawnMesh> {
    let clip_of = projected(clip_from_world);
    let set_up_draw = |(draw, mesh): (usize, &LoadedDraw)| {
        let clip = |index: u32| clip_of(mesh.vertices[index as usize].position_m);
        let mut triangles = Vec::new();
        for (index, corners) in mesh.triangles.iter().enumerate() {
            set_up(corners.map(clip), [side, side], index as u32, &mut triangles);
        }
        DrawnMesh { draw, triangles }
    };
    let draws = scene.draws.draws[..meshes].par_iter().enumerate();
    draws.filter(|(_, mesh)| scene.glass_of(mesh).is_some() == of_glass).map(set_up_draw).collect()
}

fn draw_band(scene: &LoadedScene, meshes: &[DrawnMesh], side: u32, rows: Range<u32>, depth: &mut [f32]) {
    for mesh in meshes {
        for triangle in &mesh.triangles {
            triangle.rasterise(side, rows.clone(), |x, y, fragment| {
                let texel = &mut depth[((y - rows.start) * side + x) as usize];
                let opaque = || !masked_out(scene, mesh.draw, triangle.source, fragment.barycentric);
                if fragment.depth > *texel && opaque() {
                    *texel = fragment.depth;
                }
            });
        }
    }
}

/// Depth of the nearest glass, and the share of light that passes all that is before the opaque `depth`.
fn draw_panes(
    scene: &LoadedScene,
    meshes: &[DrawnMesh],
    side: u32,
    rows: Range<u32>,
    (depth, pane_depth, passed): (&[f32], &mut [f32], &mut [f32]),
) {
    for mesh in meshes {
        for triangle in &mesh.triangles {
            triangle.rasterise(side, rows.clone(), |x, y, fragment| {
                let texel = ((y - rows.start) * side + x) as usize;
                let stopped = stopped_at(scene, mesh.draw, triangle.source, fragment.barycentric);
                if stopped <= 0.0 {
                    return;
                }
                pane_depth[texel] = pane_depth[texel].max(fragment.depth);
                if fragment.depth > depth[texel] {
                    passed[texel] *= 1.0 - stopped;
                }
            });
        }
    }
}

/// Whether the alpha mask of a draw leaves a point of a triangle out.
pub(in crate::passes) fn masked_out(
    scene: &LoadedScene,
    draw: usize,
    triangle: u32,
    barycentric: glam::Vec2,
) -> bool {
    let mesh = &scene.draws.draws[draw];
    let material = &scene.manifest.materials[mesh.material as usize];
    material.alpha_cutoff.is_some_and(|cutoff| {
        let point = PointOf::new(scene, mesh, triangle, barycentric);
        material.base_colour[3] * point.colour()[3] * point.texel(&material.base_colour_texture)[3] < cutoff
    })
}

/// Share of light that glass stops at a point of a triangle.
fn stopped_at(scene: &LoadedScene, draw: usize, triangle: u32, barycentric: glam::Vec2) -> f32 {
    let mesh = &scene.draws.draws[draw];
    let material = &scene.manifest.materials[mesh.material as usize];
    let Some(glass) = &material.glass else { return 1.0 };
    let point = PointOf::new(scene, mesh, triangle, barycentric);
    let (vertex, texel) = (point.colour(), point.texel(&material.base_colour_texture));
    let colour = [0, 1, 2, 3].map(|channel| material.base_colour[channel] * vertex[channel] * texel[channel]);
    if material.alpha_cutoff.is_some_and(|cutoff| colour[3] < cutoff) {
        return 0.0;
    }
    glass.stopped(colour, point.texel(&glass.transmission_texture)[3]).share
}

/// A point of a triangle whose textures are read at their finest level.
struct PointOf<'a> {
    scene: &'a LoadedScene,
    corners: [&'a Vertex; 3],
    weights: [f32; 3],
}

impl<'a> PointOf<'a> {
    fn new(scene: &'a LoadedScene, mesh: &'a LoadedDraw, triangle: u32, barycentric: glam::Vec2) -> Self {
        let corners = mesh.triangles[triangle as usize].map(|index| &mesh.vertices[index as usize]);
        let weights = [1.0 - barycentric.x - barycentric.y, barycentric.x, barycentric.y];
        Self { scene, corners, weights }
    }

    fn mix(&self, of: impl Fn(&Vertex) -> f32) -> f32 {
        (0..3).map(|corner| self.weights[corner] * of(self.corners[corner])).sum()
    }

    fn colour(&self) -> [f32; 4] {
        [0, 1, 2, 3].map(|channel| self.mix(|vertex| vertex.colour[channel]))
    }

    fn texel(&self, used: &Option<TextureUse>) -> [f32; 4] {
        let Some(used) = used else { return [1.0; 4] };
        let uv = [0, 1].map(|axis| self.mix(|vertex| vertex.uv[axis]));
        self.scene.textures[used.texture as usize].sample(mapped_uv(used, uv), used.wrap, 0.0).to_array()
    }
}
