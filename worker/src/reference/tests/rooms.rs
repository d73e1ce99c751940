//! Scenes of a few rectangles.

use glam::Vec3;

use super::*;
use crate::scene::model::{Glass, Material, MeshInstance, Scene};

/// A scene under construction, and the geometry that a reference borrows.
pub struct Room {
    scene: Scene,
    geometry: Option<Geometry>,
}

impl Room {
    pub fn new() -> Self {
        Self { scene: Scene::default(), geometry: None }
    }

    /// Triangles of one material, their fronts counter-clockwise.
    pub fn mesh(
        mut self,
        positions_m: Vec<Vec3>,
        triangles: Vec<[u32; 3]>,
        albedo: f32,
        emission: f32,
        double_sided: bool,
    ) -> Self {
        let mut normals = vec![Vec3::Y; positions_m.len()];
        for triangle in &triangles {
            let [a, b, c] = triangle.map(|vertex| positions_m[vertex as usize]);
            triangle.iter().for_each(|&v| normals[v as usize] = (b - a).cross(c - a).normalize());
        }
        self.scene.instances.push(MeshInstance {
            path: format!("mesh {}", self.scene.instances.len()),
            material_index: self.scene.materials.len() as u32,
            positions_m,
            normals,
            uv0: Vec::new(),
            uv1: Vec::new(),
            colours: Vec::new(),
            triangles,
            world_from_object: glam::Mat4::IDENTITY,
            lit_by: None,
        });
        self.scene.materials.push(Material {
            name: String::new(),
            base_colour: [albedo, albedo, albedo, 1.0],
            base_colour_texture: None,
            emissive: [emission; 3],
            emissive_texture: None,
            alpha_cutoff: None,
            glass: None,
            normal_map: None,
            specular: None,
            double_sided,
        });
        self
    }

    /// A rectangle; its front is the side of `u × v`.
    pub fn rectangle(self, corner: Vec3, u: Vec3, v: Vec3, albedo: f32, emission: f32) -> Self {
        let corners = vec![corner, corner + u, corner + u + v, corner + v];
        self.mesh(corners, vec![[0, 1, 2], [0, 2, 3]], albedo, emission, false)
    }

    /// A rectangle of glass that is there to a share; both its sides are lit.
    pub fn pane(self, [corner, u, v]: [Vec3; 3], alpha: f32, albedo: f32, emission: f32) -> Self {
        let corners = vec![corner, corner + u, corner + u + v, corner + v];
        let mut room = self.mesh(corners, vec![[0, 1, 2], [0, 2, 3]], albedo, emission, true);
        if let Some(material) = room.scene.materials.last_mut() {
            material.base_colour[3] = alpha;
            material.glass = Some(Glass { blends: true, transmission: 0.0, transmission_texture: None });
        }
        room
    }

    /// The inside of the box from the origin to `size`.
    pub fn walls(mut self, size: Vec3, albedo: f32, emission: f32) -> Self {
        for (corner, u, v) in Self::sides(size) {
            self = self.rectangle(corner, u, v, albedo, emission);
        }
        self
    }

    /// Corner and sides of each wall of the box from the origin to `size`, fronts inwards.
    pub fn sides(size: Vec3) -> [(Vec3, Vec3, Vec3); 6] {
        let (x, y, z) = (Vec3::X * size.x, Vec3::Y * size.y, Vec3::Z * size.z);
        [(Vec3::ZERO, z, x), (y, x, z), (Vec3::ZERO, x, y), (z, y, x), (Vec3::ZERO, y, z), (x, z, y)]
    }

    /// Ready to be traced.
    pub fn built(mut self) -> Self {
        self.geometry = Some(Geometry::new(self.scene.clone()).unwrap());
        self
    }

    pub fn under(&self, lighting: &Lighting) -> Reference<'_> {
        Reference::new(self.geometry.as_ref().unwrap(), lighting).unwrap()
    }
}

/// A site on a flat face.
pub fn site(position_m: Vec3, normal: Vec3) -> Site {
    Site { position_m, normal, face_normal: normal }
}

/// Sites spread evenly over the walls of the box from the origin to `size`, in number by area.
pub fn sites_on_walls(size: Vec3, per_m2: f32) -> Vec<Site> {
    let mut sites = Vec::new();
    for (corner, u, v) in Room::sides(size) {
        let count = (u.cross(v).length() * per_m2).round() as u32;
        let points = crate::rays::sampling::R2::new(u64::from(count));
        let normal = u.cross(v).normalize();
        sites.extend((0..count).map(|index| {
            let [s, t] = points.point(index);
            site(corner + u * s + v * t, normal)
        }));
    }
    sites
}
