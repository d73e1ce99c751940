//! Shadow maps on the processor.

use std::ops::Range;

use glam::{IVec2, Mat4};
use lightkiln_proto::manifest::Wrap;
use rayon::prelude::*;

use super::ShadowPlan;
use crate::passes::shade::surface::mapped_uv;
use crate::raster::{ScreenTriangle, projected, set_up};
use crate::scene::{LoadedDraw, LoadedScene};

/// Shadow maps: reversed depth, face after face, row after row; 0 where nothing is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ShadowMaps {
    /// Texels along a side.
    pub side: u32,
    /// `faces · side · side` depths.
    pub depth: Vec<f32>,
}

impl ShadowMaps {
    /// Depth of a texel of a face; beyond the rim that of the rim.
    pub(in crate::passes) fn depth_at(&self, face_index: u32, texel: IVec2) -> f32 {
        let side = self.side as usize;
        let inside = texel.clamp(IVec2::ZERO, IVec2::splat(self.side as i32 - 1)).as_uvec2();
        self.depth[(face_index as usize * side + inside.y as usize) * side + inside.x as usize]
    }
}

/// Rows that one thread draws at a time.
const BAND_ROWS: usize = 128;

/// Draws all faces of a plan.
pub fn draw(scene: &LoadedScene, plan: &ShadowPlan) -> ShadowMaps {
    let side = plan.count.side;
    let area = side as usize * side as usize;
    let mut depth = vec![0.0; area * plan.faces.len()];
    for (face, map) in plan.faces.iter().zip(depth.chunks_mut(area)) {
        let triangles = set_up_scene(scene, face.projection(), side);
        map.par_chunks_mut(BAND_ROWS * side as usize).enumerate().for_each(|(band, rows)| {
            let first = (band * BAND_ROWS) as u32;
            let last = first + (rows.len() / side as usize) as u32;
            draw_band(scene, &triangles, side, first..last, rows);
        });
    }
    ShadowMaps { side, depth }
}

/// Triangles of one draw on the screen.
struct DrawnMesh {
    draw: usize,
    triangles: Vec<ScreenTriangle>,
}

fn set_up_scene(scene: &LoadedScene, clip_from_world: Mat4, side: u32) -> Vec<DrawnMesh> {
    let clip_of = projected(clip_from_world);
    let set_up_draw = |(draw, mesh): (usize, &LoadedDraw)| {
        let clip = |index: u32| clip_of(mesh.vertices[index as usize].position_m);
        let mut triangles = Vec::new();
        for (index, corners) in mesh.triangles.iter().enumerate() {
            set_up(corners.map(clip), [side, side], index as u32, &mut triangles);
        }
        DrawnMesh { draw, triangles }
    };
    scene.draws.draws.par_iter().enumerate().map(set_up_draw).collect()
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

/// Whether the alpha mask of a draw leaves a point of a triangle out.
pub(in crate::passes) fn masked_out(
    scene: &LoadedScene,
    draw: usize,
    triangle: u32,
    barycentric: glam::Vec2,
) -> bool {
    let mesh = &scene.draws.draws[draw];
    let material = &scene.manifest.materials[mesh.material as usize];
    let Some(cutoff) = material.alpha_cutoff else { return false };
    let corners = mesh.triangles[triangle as usize].map(|index| &mesh.vertices[index as usize]);
    let weights = [1.0 - barycentric.x - barycentric.y, barycentric.x, barycentric.y];
    let mix = |of: fn(&crate::scene::Vertex) -> f32| (0..3).map(|i| weights[i] * of(corners[i])).sum::<f32>();
    let mut alpha = material.base_colour[3] * mix(|vertex| vertex.colour[3]);
    if let Some(used) = &material.base_colour_texture {
        let uv = [mix(|vertex| vertex.uv[0]), mix(|vertex| vertex.uv[1])];
        let wrap: [Wrap; 2] = used.wrap;
        alpha *= scene.textures[used.texture as usize].sample(mapped_uv(used, uv), wrap, 0.0).w;
    }
    alpha < cutoff
}
