//! Meshes to draw, with their lightmap coordinates.

use super::receivers::BlockKey;

/// Meshes to draw.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Geometry {
    /// One per mesh instance and material.
    pub draws: Vec<Draw>,
}

/// One mesh to draw, in world space.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Draw {
    /// Index into the manifest's materials.
    pub material: u32,
    /// Block of the front side; `None` for a mesh outside the lightmap.
    pub front: Option<BlockKey>,
    /// Block of the back side, for double-sided materials in the lightmap.
    pub back: Option<BlockKey>,
    /// Positions in metres.
    pub position_m: Vec<[f32; 3]>,
    /// Unit normals towards the front.
    pub normal: Vec<[f32; 3]>,
    /// UV of the base-colour texture, transform applied, or of another where it has none; empty when the material has no texture.
    pub uv: Vec<[f32; 2]>,
    /// Linear vertex colours; empty when there are none.
    pub colour: Vec<[f32; 4]>,
    /// Lightmap coordinates in texels of the block; empty for a mesh outside the lightmap.
    pub lightmap_texel: Vec<[f32; 2]>,
    /// Triangles, counter-clockwise from the front.
    pub triangles: Vec<[u32; 3]>,
}
