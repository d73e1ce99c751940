//! What a point of a drawn triangle looks like: the parts of `shade.wgsl` about materials.

use glam::{Vec2, Vec3, Vec4};
use lightkiln_proto::manifest::TextureUse;

use crate::bake::{LoadedBake, LoadedDraw, Vertex};
use crate::raster::ScreenTriangle;

/// Coordinates of a texture from a draw's `uv`.
pub fn mapped_uv(used: &TextureUse, uv: [f32; 2]) -> [f32; 2] {
    match used.transform {
        None => uv,
        Some(rows) => rows.map(|row| row[0] * uv[0] + row[1] * uv[1] + row[2]),
    }
}

/// A drawn point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surface {
    pub position: Vec3,
    /// Shading normal on the seen side.
    pub normal: Vec3,
    /// The triangle's own normal on the seen side.
    pub facet: Vec3,
    pub albedo: Vec3,
    pub emission: Vec3,
    pub lightmap_texel: [f32; 2],
}

/// Values of the corners of a triangle, mixed by weights.
struct Corners<'a>([&'a Vertex; 3]);

impl Corners<'_> {
    fn mix<const N: usize>(&self, barycentric: Vec2, of: impl Fn(&Vertex) -> [f32; N]) -> [f32; N] {
        let weights = [1.0 - barycentric.x - barycentric.y, barycentric.x, barycentric.y];
        let values = self.0.map(of);
        std::array::from_fn(|axis| (0..3).map(|corner| weights[corner] * values[corner][axis]).sum())
    }
}

/// The surface seen at a pixel centre `(x, y)` of a set-up triangle of draw `mesh`.
pub(super) fn surface_at(
    bake: &LoadedBake,
    mesh: &LoadedDraw,
    triangle: &ScreenTriangle,
    (x, y): (f64, f64),
    emitter_scale: &[f32],
) -> Surface {
    let indices = mesh.triangles[triangle.source as usize];
    let corners = Corners(indices.map(|index| &mesh.vertices[index as usize]));
    let here = triangle.barycentric_at(x, y);
    let step_x = triangle.barycentric_at(x + 1.0, y);
    let step_y = triangle.barycentric_at(x, y + 1.0);
    let material = &bake.manifest.materials[mesh.material as usize];
    let texel = |used: &Option<TextureUse>| match used {
        None => Vec4::ONE,
        Some(used) => {
            let uv = |at| mapped_uv(used, corners.mix(at, |vertex| vertex.uv));
            let (uv_here, uv_x, uv_y) = (uv(here), uv(step_x), uv(step_y));
            let step = |to: [f32; 2]| [to[0] - uv_here[0], to[1] - uv_here[1]];
            let texture = &bake.textures[used.texture as usize];
            texture.sample(uv_here, used.wrap, texture.lod(step(uv_x), step(uv_y)))
        }
    };
    let colour = Vec4::from(material.base_colour)
        * Vec4::from(corners.mix(here, |vertex| vertex.colour))
        * texel(&material.base_colour_texture);
    let scale = material
        .emitter
        .map_or(1.0, |emitter| emitter_scale.get(usize::from(emitter)).copied().unwrap_or(1.0));
    let emission = match material.emissive {
        [0.0, 0.0, 0.0] => Vec3::ZERO,
        emissive => Vec3::from(emissive) * scale * texel(&material.emissive_texture).truncate(),
    };
    let side = if triangle.front { 1.0 } else { -1.0 };
    let normal = side * Vec3::from(corners.mix(here, |vertex| vertex.normal)).normalize_or(Vec3::Y);
    Surface {
        position: corners.mix(here, |vertex| vertex.position_m).into(),
        normal,
        facet: facet(&corners, normal),
        albedo: colour.truncate().clamp(Vec3::ZERO, Vec3::ONE),
        emission,
        lightmap_texel: corners.mix(here, |vertex| vertex.lightmap_texel),
    }
}

/// The triangle's own normal on the side of the shading normal.
fn facet(corners: &Corners<'_>, normal: Vec3) -> Vec3 {
    let [a, b, c] = corners.0.map(|vertex| Vec3::from(vertex.position_m));
    match (b - a).cross(c - a).try_normalize() {
        Some(facet) if facet.dot(normal) >= 0.0 => facet,
        Some(facet) => -facet,
        None => normal,
    }
}
