//! Albedo and emission at a point of the scene's surface: factor × texture × vertex colour.

use glam::{DVec3, Vec3};
use lightkiln_proto::glass::{self, Stopped};

use super::model::{Glass, Material, MeshInstance, Scene, TextureUse};
use super::texture::DecodedImages;

/// Largest albedo. A closed white room of albedo ρ gathers 1/(1 − ρ) times its emission, so at 1 bounces never end;
/// 0.98 is whiter than any paint, and ends.
pub const MAX_ALBEDO: f32 = 0.98;

/// Reflectance, emission and opacity at a point or over a footprint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceSample {
    /// Diffuse albedo ρ of what is stopped, linear Rec.709, in 0..=[`MAX_ALBEDO`].
    pub albedo: [f32; 3],
    /// Radiance Lₑ in W·m⁻²·sr⁻¹ that a surface emits which stops all light.
    pub emission: [f32; 3],
    /// The share of the material's `emissive` that this is, by its texture.
    pub glow: [f32; 3],
    /// Share s of light that does not pass straight through: 1 but for holes of masks and for glass.
    pub stopped: f32,
}

/// Light on a point of a material with this colour (factor × texture × vertex colour) and transmission τ.
pub fn stopped(material: &Material, [r, g, b, alpha]: [f32; 4], transmission: f32) -> Stopped {
    if material.alpha_cutoff.is_some_and(|cutoff| alpha < cutoff) {
        return Stopped { share: 0.0, albedo: [r, g, b] };
    }
    let there = match &material.glass {
        Some(Glass { blends: true, .. }) => alpha,
        _ => 1.0,
    };
    glass::stopped(there, [r, g, b], transmission)
}

/// A parallelogram around a point of a triangle, over which textures are averaged: its two sides as changes of the
/// barycentric weights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footprint {
    /// Both sides; each sums to 0.
    pub sides: [[f32; 3]; 2],
}

impl Footprint {
    /// No extent: one bilinear sample.
    pub const POINT: Self = Self { sides: [[0.0; 3]; 2] };

    /// A square of `side_m` metres in the plane of a triangle.
    pub fn square(instance: &MeshInstance, triangle: usize, side_m: f32) -> Self {
        let [a, b, c] = instance.triangles[triangle].map(|v| instance.positions_m[v as usize].as_dvec3());
        let (ab, ac) = (b - a, c - a);
        let scaled_normal = ab.cross(ac);
        let Some(along) = ab.try_normalize() else { return Self::POINT };
        let Some(across) = scaled_normal.cross(along).try_normalize() else { return Self::POINT };
        // d = β·ab + γ·ac, solved by areas.
        let weights = |d: DVec3| {
            let squared = scaled_normal.length_squared();
            let beta = d.cross(ac).dot(scaled_normal) / squared;
            let gamma = ab.cross(d).dot(scaled_normal) / squared;
            [(-beta - gamma) as f32, beta as f32, gamma as f32]
        };
        Self { sides: [along, across].map(|direction| weights(direction * f64::from(side_m))) }
    }
}

/// The surface at a point of a triangle, with textures averaged over a footprint.
///
/// `barycentrics` are the weights of the triangle's three vertices. Panics on an instance or triangle that the scene
/// does not have.
pub fn surface_at(
    scene: &Scene,
    images: &DecodedImages,
    instance: usize,
    triangle: usize,
    barycentrics: [f32; 3],
    footprint: &Footprint,
) -> SurfaceSample {
    let instance = &scene.instances[instance];
    let material = &scene.materials[instance.material_index as usize];
    let point = Point { images, instance, corners: instance.triangles[triangle], barycentrics, footprint };
    let base = point.texture(material.base_colour_texture.as_ref());
    let glow = point.texture(material.emissive_texture.as_ref());
    let vertex = point.vertex_colour();
    let colour = [0, 1, 2, 3].map(|channel| material.base_colour[channel] * base[channel] * vertex[channel]);
    let transmission = material
        .glass
        .as_ref()
        .map_or(0.0, |glass| glass.transmission * point.texture(glass.transmission_texture.as_ref())[3]);
    let Stopped { share, albedo } = stopped(material, colour, transmission);
    SurfaceSample {
        albedo: albedo.map(|channel| channel.clamp(0.0, MAX_ALBEDO)),
        emission: [0, 1, 2].map(|channel| material.emissive[channel] * glow[channel]),
        glow: [glow[0], glow[1], glow[2]],
        stopped: share,
    }
}

/// The world-space normal at a point of a triangle, interpolated and unit.
pub fn normal_at(instance: &MeshInstance, triangle: usize, barycentrics: [f32; 3]) -> Vec3 {
    normal_of(instance, instance.triangles[triangle], barycentrics)
}

/// As [`normal_at`], of a triangle by its vertices.
pub fn normal_of(instance: &MeshInstance, vertices: [u32; 3], barycentrics: [f32; 3]) -> Vec3 {
    let corners = vertices.map(|vertex| instance.normals[vertex as usize]);
    let sum: Vec3 = corners.into_iter().zip(barycentrics).map(|(normal, weight)| normal * weight).sum();
    sum.try_normalize().unwrap_or(corners[0])
}

struct Point<'a> {
    images: &'a DecodedImages,
    instance: &'a MeshInstance,
    corners: [u32; 3],
    barycentrics: [f32; 3],
    footprint: &'a Footprint,
}

impl Point<'_> {
    /// The texture's mean over the footprint; white without a texture, or without the UVs for one.
    fn texture(&self, texture: Option<&TextureUse>) -> [f32; 4] {
        let Some(texture) = texture else { return [1.0; 4] };
        let uvs = if texture.uv_set == 0 { &self.instance.uv0 } else { &self.instance.uv1 };
        if uvs.is_empty() {
            return [1.0; 4];
        }
        let [a, b, c] = self.corners.map(|vertex| uvs[vertex as usize]);
        let weighted = |weights: [f32; 3]| (a * weights[0] + b * weights[1] + c * weights[2]).to_array();
        if *self.footprint == Footprint::POINT {
            return self.images.sample_bilinear(texture, weighted(self.barycentrics));
        }
        let [duv_dx, duv_dy] = self.footprint.sides.map(weighted);
        self.images.sample_footprint(texture, weighted(self.barycentrics), duv_dx, duv_dy)
    }

    fn vertex_colour(&self) -> [f32; 4] {
        if self.instance.colours.is_empty() {
            return [1.0; 4];
        }
        let corners = self.corners.map(|vertex| self.instance.colours[vertex as usize]);
        [0, 1, 2, 3].map(|channel| (0..3).map(|k| corners[k][channel] * self.barycentrics[k]).sum())
    }
}
