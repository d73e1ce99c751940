//! Material and geometry at a point of a drawn triangle: the parts of `shade.wgsl` before lighting.

use glam::{Vec2, Vec3, Vec4};
use lightkiln_proto::manifest::TextureUse;

use super::ShadeView;
use super::normals::mapped_normal;
use crate::raster::ScreenTriangle;
use crate::scene::{LoadedScene, Vertex};

/// Coordinates of a texture from a draw's `uv`.
pub fn mapped_uv(used: &TextureUse, uv: [f32; 2]) -> [f32; 2] {
    moved_uv(used.transform, uv)
}

/// Coordinates moved by a 2×3 map, if there is one.
pub fn moved_uv(map: Option<[[f32; 3]; 2]>, uv: [f32; 2]) -> [f32; 2] {
    match map {
        None => uv,
        Some(rows) => rows.map(|row| row[0] * uv[0] + row[1] * uv[1] + row[2]),
    }
}

/// A point that the camera sees; twin of `Surface` in `shade.wgsl`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Metres.
    pub position: Vec3,
    /// Shading normal on the seen side.
    pub normal: Vec3,
    /// The triangle's own normal on the seen side.
    pub facet: Vec3,
    /// Direction about which light is asked for: the normal that a map says, or the axis of a reflection.
    pub towards: Vec3,
    /// Number of the draw.
    pub draw: u32,
    /// Whether the front is seen.
    pub front: bool,
    /// Lightmap coordinates in texels of the side's block.
    pub lightmap_texel: [f32; 2],
    /// Those of a place on its seen side: it tells on which side of the texels' edges the point lies.
    pub lightmap_before: [f32; 2],
}

/// A drawn point and its material.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shaded {
    pub surface: Surface,
    pub albedo: Vec3,
    pub emission: Vec3,
    /// Share of light that it stops.
    pub stopped: f32,
    /// Metallic and roughness, the latter below 0 where all reflection is diffuse.
    pub metallic_roughness: [f32; 2],
}

/// Least square of the sine between two sides, or of a pixel's steps in the shader.
const STEPS_MIN: f32 = 1e-6;

/// Values of the corners of a triangle, mixed by weights.
struct Corners<'a>([&'a Vertex; 3]);

impl Corners<'_> {
    fn mix<const N: usize>(&self, barycentric: Vec2, of: impl Fn(&Vertex) -> [f32; N]) -> [f32; N] {
        let weights = [1.0 - barycentric.x - barycentric.y, barycentric.x, barycentric.y];
        let values = self.0.map(of);
        std::array::from_fn(|axis| (0..3).map(|corner| weights[corner] * values[corner][axis]).sum())
    }

    /// Two sides, each with its change of a texture's coordinates.
    fn steps(&self, used: &TextureUse) -> [(Vec3, Vec2); 2] {
        let [a, b, c] =
            self.0.map(|vertex| (Vec3::from(vertex.position_m), Vec2::from(mapped_uv(used, vertex.uv))));
        [b, c].map(|(position, uv)| (position - a.0, uv - a.1))
    }

    /// Barycentric coordinates of the point of the triangle's plane that is nearest to a point beside it; the same for a sliver.
    fn moved(&self, barycentric: Vec2, by: Vec3) -> Vec2 {
        let [a, b, c] = self.0.map(|vertex| Vec3::from(vertex.position_m));
        let (u, v) = (b - a, c - a);
        let squares = [u.dot(u), u.dot(v), v.dot(v)];
        let along = [by.dot(u), by.dot(v)];
        let area2 = squares[0] * squares[2] - squares[1] * squares[1];
        if area2 <= STEPS_MIN * squares[0] * squares[2] {
            return barycentric;
        }
        let steps =
            [squares[2] * along[0] - squares[1] * along[1], squares[0] * along[1] - squares[1] * along[0]];
        barycentric + Vec2::from(steps) / area2
    }
}

/// The surface seen at a pixel centre `(x, y)` of a set-up triangle of draw `draw`.
pub(super) fn surface_at(
    scene: &LoadedScene,
    draw: u32,
    triangle: &ScreenTriangle,
    (x, y): (f64, f64),
    (view, emitter_scale): (&ShadeView, &[f32]),
) -> Shaded {
    let mesh = &scene.draws.draws[draw as usize];
    let indices = mesh.triangles[triangle.source as usize];
    let corners = Corners(indices.map(|index| &mesh.vertices[index as usize]));
    let here = triangle.barycentric_at(x, y);
    let step_x = triangle.barycentric_at(x + 1.0, y);
    let step_y = triangle.barycentric_at(x, y + 1.0);
    let material = &scene.manifest.materials[mesh.material as usize];
    let sampled = |used: &TextureUse| {
        let uv = |at| mapped_uv(used, corners.mix(at, |vertex| vertex.uv));
        let (uv_here, uv_x, uv_y) = (uv(here), uv(step_x), uv(step_y));
        let step = |to: [f32; 2]| [to[0] - uv_here[0], to[1] - uv_here[1]];
        let texture = &scene.textures[used.texture as usize];
        texture.sample(uv_here, used.wrap, texture.lod(step(uv_x), step(uv_y)))
    };
    let texel = |used: &Option<TextureUse>| used.as_ref().map_or(Vec4::ONE, sampled);
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
    let unit = Vec3::from(corners.mix(here, |vertex| vertex.normal)).normalize_or(Vec3::Y);
    let normal = side * unit;
    let towards = match material.normal_map.as_ref().filter(|_| view.details().normal_maps) {
        None => normal,
        Some(map) => {
            let bent = sampled(&map.texture).truncate() * 2.0 - 1.0;
            side * mapped_normal(unit, corners.steps(&map.texture), bent.truncate() * map.scale, bent.z)
        }
    };
    let position = corners.mix(here, |vertex| vertex.position_m).into();
    let surface = Surface {
        position,
        normal,
        facet: facet(&corners, normal),
        towards,
        draw,
        front: triangle.front,
        lightmap_texel: corners.mix(here, |vertex| vertex.lightmap_texel),
        lightmap_before: corners
            .mix(corners.moved(here, view.before(position) - position), |vertex| vertex.lightmap_texel),
    };
    let (stopped, albedo) = match &material.glass {
        None => (1.0, colour.truncate()),
        Some(glass) => {
            let met = glass.stopped(colour.to_array(), texel(&glass.transmission_texture).w);
            (met.share, Vec3::from(met.albedo))
        }
    };
    let metallic_roughness = match material.specular.as_ref().filter(|_| view.details().specular) {
        None => [0.0, -1.0],
        Some(specular) => {
            let factors = texel(&specular.texture);
            [specular.metallic * factors.z, specular.roughness * factors.y]
        }
    };
    Shaded { surface, albedo: albedo.clamp(Vec3::ZERO, Vec3::ONE), emission, stopped, metallic_roughness }
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The place before the seen one is where the point before stands over the surface: on its side of whatever stands there.
    #[test]
    fn place_before_is_the_foot_of_the_point_before() {
        let at = |position_m: [f32; 3]| Vertex { position_m, ..Vertex::default() };
        let vertices = [[4.0, 1.0, -2.0], [9.0, 1.5, -1.0], [3.0, 0.0, 5.0]].map(at);
        let corners = Corners(vertices.each_ref());
        let place = |barycentric| Vec3::from(corners.mix(barycentric, |vertex| vertex.position_m));
        let [a, b, c] = vertices.each_ref().map(|vertex| Vec3::from(vertex.position_m));
        let normal = (b - a).cross(c - a).normalize();
        let here = Vec2::new(0.3, 0.25);
        for by in [Vec3::new(0.02, 0.01, -0.03), Vec3::new(-0.4, 0.9, 0.1), normal] {
            let wanted = place(here) + by - normal * by.dot(normal);
            assert!(place(corners.moved(here, by)).abs_diff_eq(wanted, 1e-5), "{by}");
        }
        let sliver = [[0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]].map(at);
        assert_eq!(Corners(sliver.each_ref()).moved(here, Vec3::X), here);
    }
}
