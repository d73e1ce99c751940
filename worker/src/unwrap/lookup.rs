//! From a hit on a triangle to its texel.

use glam::{Vec2, Vec3};

use super::{Unwrap, UnwrappedTriangle};

/// A place in an unwrap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TexelLocation {
    /// Index into [`Unwrap::blocks`].
    pub block: u32,
    /// Chart there.
    pub chart: u32,
    /// Texel units.
    pub uv_texels: Vec2,
}

/// Finds unwrapped triangles by source triangle.
#[derive(Clone, Debug)]
pub struct UnwrapLookup<'a> {
    unwrap: &'a Unwrap,
    /// First entry of each source triangle, and the end.
    starts: Vec<u32>,
    /// (block, index there).
    entries: Vec<(u32, u32)>,
}

impl<'a> UnwrapLookup<'a> {
    /// Indexes an unwrap of a mesh with this many triangles.
    pub fn new(unwrap: &'a Unwrap, triangle_count: usize) -> Self {
        let mut starts = vec![0_u32; triangle_count + 1];
        let all = || unwrap.blocks.iter().flat_map(|block| &block.triangles);
        for triangle in all().filter(|t| (t.source_triangle as usize) < triangle_count) {
            starts[triangle.source_triangle as usize + 1] += 1;
        }
        for i in 0..triangle_count {
            starts[i + 1] += starts[i];
        }
        let mut next = starts.clone();
        let mut entries = vec![(0, 0); starts[triangle_count] as usize];
        for (block_index, block) in unwrap.blocks.iter().enumerate() {
            for (index, triangle) in block.triangles.iter().enumerate() {
                if let Some(slot) = next[..triangle_count].get_mut(triangle.source_triangle as usize) {
                    entries[*slot as usize] = (block_index as u32, index as u32);
                    *slot += 1;
                }
            }
        }
        Self { unwrap, starts, entries }
    }

    /// Where the point with barycentric weights `weights` of a source triangle lies; `None` when the triangle was
    /// left out. Of a triangle cut in parts, the part nearest to containing the point answers.
    pub fn locate(&self, source_triangle: u32, weights: Vec3) -> Option<TexelLocation> {
        let from = *self.starts.get(source_triangle as usize)?;
        let to = *self.starts.get(source_triangle as usize + 1)?;
        let parts = self.entries[from as usize..to as usize].iter().map(|&(block, index)| {
            let triangle = &self.unwrap.blocks[block as usize].triangles[index as usize];
            let inner = weights_in_part(triangle, weights);
            (inner.min_element(), block, triangle, inner)
        });
        let (_, block, triangle, inner) = parts.max_by(|a, b| a.0.total_cmp(&b.0))?;
        let [a, b, c] = triangle.uv_texels;
        let uv_texels = a * inner.x + b * inner.y + c * inner.z;
        Some(TexelLocation { block, chart: triangle.chart, uv_texels })
    }
}

/// Weights of a part's corners from weights of the whole's: solves `corners · inner = weights`.
pub(crate) fn weights_in_part(triangle: &UnwrappedTriangle, weights: Vec3) -> Vec3 {
    let Some(corners) = &triangle.piece_corners else { return weights };
    let [a, b, c] = corners.map(|corner| corner.as_dvec3());
    let point = weights.as_dvec3();
    let normal = (b - a).cross(c - a);
    let doubled = normal.length_squared();
    if doubled == 0.0 {
        return Vec3::new(f32::NEG_INFINITY, 0.0, 0.0);
    }
    let [x, y, z] = [(b, c), (c, a), (a, b)].map(|(p, q)| (p - point).cross(q - point).dot(normal) / doubled);
    Vec3::new(x as f32, y as f32, z as f32)
}
