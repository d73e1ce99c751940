//! Meshes to draw, checked and interleaved for the adapter and the software rasteriser alike.

use lightkiln_proto::content::{BlockKey, Draw, Geometry};
use lightkiln_proto::manifest::Manifest;

use super::lightmap::{LightmapLayout, NO_BLOCK};
use crate::error::{ClientError, Result};

/// A vertex, in world space.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Vertex {
    /// Position in metres.
    pub position_m: [f32; 3],
    /// Unit normal towards the front.
    pub normal: [f32; 3],
    /// Texture coordinates.
    pub uv: [f32; 2],
    /// Linear colour.
    pub colour: [f32; 4],
    /// Lightmap coordinates in texels of the block.
    pub lightmap_texel: [f32; 2],
}

/// A mesh to draw.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadedDraw {
    /// Index into the manifest's materials.
    pub material: u32,
    /// Index of the front's block, or [`NO_BLOCK`].
    pub front: u32,
    /// Index of the back's block, or [`NO_BLOCK`].
    pub back: u32,
    /// Vertices.
    pub vertices: Vec<Vertex>,
    /// Triangles, counter-clockwise from the front.
    pub triangles: Vec<[u32; 3]>,
}

/// All meshes.
#[derive(Clone, Debug, Default)]
pub struct DrawTable {
    /// One per mesh instance and material.
    pub draws: Vec<LoadedDraw>,
}

impl DrawTable {
    /// Triangles of all draws.
    pub fn triangle_count(&self) -> usize {
        self.draws.iter().map(|draw| draw.triangles.len()).sum()
    }
}

/// Checks and interleaves the geometry.
pub(super) fn join(
    manifest: &Manifest,
    contents: Vec<Geometry>,
    lightmap: &LightmapLayout,
    warnings: &mut Vec<String>,
) -> Result<DrawTable> {
    let mut table = DrawTable::default();
    let mut without_block = 0;
    for draw in contents.into_iter().flat_map(|geometry| geometry.draws) {
        let index = table.draws.len();
        check(&draw, manifest)
            .map_err(|problem| ClientError::inconsistent(format!("draw {index}"), problem))?;
        let index_of =
            |key: Option<BlockKey>| key.and_then(|key| lightmap.block_index(key)).unwrap_or(NO_BLOCK);
        let (front, back) = (index_of(draw.front), index_of(draw.back));
        without_block += usize::from(front == NO_BLOCK);
        let vertices = (0..draw.position_m.len()).map(|vertex| interleave(&draw, vertex)).collect();
        let material = draw.material;
        table.draws.push(LoadedDraw { material, front, back, vertices, triangles: draw.triangles });
    }
    if without_block > 0 && !lightmap.blocks.is_empty() {
        warnings
            .push(format!("{without_block} meshes have no receivers and are drawn without indirect light"));
    }
    Ok(table)
}

fn interleave(draw: &Draw, vertex: usize) -> Vertex {
    Vertex {
        position_m: draw.position_m[vertex],
        normal: draw.normal[vertex],
        uv: draw.uv.get(vertex).copied().unwrap_or_default(),
        colour: draw.colour.get(vertex).copied().unwrap_or([1.0; 4]),
        lightmap_texel: draw.lightmap_texel.get(vertex).copied().unwrap_or_default(),
    }
}

fn check(draw: &Draw, manifest: &Manifest) -> std::result::Result<(), String> {
    let count = draw.position_m.len();
    let optional = |length: usize| length == 0 || length == count;
    let texels = if draw.front.is_some() { count } else { 0 };
    if draw.normal.len() != count
        || draw.lightmap_texel.len() != texels
        || !optional(draw.uv.len())
        || !optional(draw.colour.len())
    {
        return Err("its vertex arrays differ in length".to_owned());
    }
    if draw.material as usize >= manifest.materials.len() {
        return Err(format!("names material {} of {}", draw.material, manifest.materials.len()));
    }
    if draw.triangles.iter().flatten().any(|index| *index as usize >= count) {
        return Err(format!("a triangle names a vertex above {count}"));
    }
    let finite = draw.position_m.iter().chain(&draw.normal).flatten().all(|value| value.is_finite())
        && draw.lightmap_texel.iter().chain(&draw.uv).flatten().all(|value| value.is_finite())
        && draw.colour.iter().flatten().all(|value| value.is_finite());
    if finite { Ok(()) } else { Err("a vertex has a number that is not finite".to_owned()) }
}
