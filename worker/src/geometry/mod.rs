//! The scene's triangles ready for rays, and the properties of a hit that need the scene alone: side, material, normal.

mod bits;
pub mod lattice;
mod masks;
mod site;
mod strata;
mod trail;

use std::sync::Arc;

use glam::{Mat3, Vec3};

use crate::rays::{Hit, Tracer};
use crate::scene::model::{Material, MeshInstance, Scene};
use crate::scene::surface::normal_at;
use crate::scene::texture::DecodedImages;
use crate::task::{Context, TaskError};

pub use bits::{Bits, OwnBits};
pub use site::Site;
pub use strata::{Strata, morton, spread_sites};
pub use trail::{Grid, Trail, TrailFrom};

/// Shading normals that lean further than this from the face are a fault of the file: the face's is taken instead.
const LEAN_MIN: f32 = 0.05;

/// A triangle of the scene by instance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TriangleRef {
    /// Index into [`Scene::instances`].
    pub instance: u32,
    /// Index into the instance's triangles.
    pub triangle: u32,
}

/// A scene whose triangles are numbered through all instances and stand in a tree for rays.
pub struct Geometry {
    /// Imported scene.
    pub scene: Scene,
    /// Decoded images.
    pub images: Arc<DecodedImages>,
    /// Rays against the triangles.
    pub tracer: Tracer,
    /// Place of each triangle in the scene.
    pub triangles: Vec<TriangleRef>,
}

impl Geometry {
    /// Decodes images, gathers triangles and builds the tree.
    ///
    /// Errors with [`TaskError::BadInput`] when an image is damaged.
    pub fn new(scene: Scene) -> Result<Self, TaskError> {
        let images = DecodedImages::decode(&scene)
            .map(Arc::new)
            .map_err(|error| TaskError::bad_input_from("an image of the scene cannot be decoded", error))?;
        let mut triangles = Vec::new();
        let mut corners = Vec::new();
        for (instance_index, instance) in scene.instances.iter().enumerate() {
            for (triangle_index, triangle) in instance.triangles.iter().enumerate() {
                triangles
                    .push(TriangleRef { instance: instance_index as u32, triangle: triangle_index as u32 });
                corners.push(triangle.map(|vertex| instance.positions_m[vertex as usize]));
            }
        }
        let alpha = masks::alpha_test(&scene, &images, &triangles);
        let mut tracer = Tracer::new(&corners, alpha);
        if let Some(core) = scene.core {
            tracer = tracer.about(core.middle_m, core.half_m);
        }
        Ok(Self { tracer, scene, images, triangles })
    }

    /// Geometry of the imported scene among a task's inputs, built once per worker.
    pub fn of(context: &Context) -> Result<Arc<Self>, TaskError> {
        let (magic, name) = (crate::scene::ARTEFACT_MAGIC, crate::scene::ARTEFACT);
        context.memory.get_or_insert(context.digest(name)?, || {
            let (scene, bytes) = context.decoded(magic, name)?;
            Ok((Self::new(scene)?, 3 * bytes))
        })
    }

    /// A point of a surface raised along its normal by at most `height_m`, to be tested for walls between it and others:
    /// half way to the surface above it at most, as a gap may be narrower.
    pub fn raised(&self, point_m: Vec3, normal: Vec3, height_m: f32) -> Vec3 {
        let foot_m = self.lifted(point_m, normal);
        let free_m = self.tracer.closest(foot_m, normal, 2.0 * height_m).map_or(height_m, |hit| 0.5 * hit.t);
        foot_m + normal * free_m
    }

    /// A point of a surface lifted along its normal, for rays to start at.
    pub fn lifted(&self, point_m: Vec3, normal: Vec3) -> Vec3 {
        point_m + normal * self.tracer.ray_offset_m(point_m)
    }

    /// Corners of a triangle in metres.
    pub fn corners(&self, triangle: u32) -> [Vec3; 3] {
        corners_of(&self.scene, self.triangles[triangle as usize])
    }

    /// Unit normal of a triangle's front.
    pub fn face_normal(&self, triangle: u32) -> Vec3 {
        face_normal_of(&self.scene, self.triangles[triangle as usize])
    }

    /// Instance that a triangle belongs to.
    pub fn instance(&self, triangle: u32) -> &MeshInstance {
        &self.scene.instances[self.triangles[triangle as usize].instance as usize]
    }

    /// Material of a triangle.
    pub fn material(&self, triangle: u32) -> &Material {
        &self.scene.materials[self.instance(triangle).material_index as usize]
    }

    /// The hit lies on the back of a single-sided surface.
    pub fn is_back(&self, hit: &Hit) -> bool {
        !hit.front && !self.material(hit.triangle).double_sided
    }

    /// Unit normal of the side that was hit.
    pub fn side_normal(&self, hit: &Hit) -> Vec3 {
        let normal = self.face_normal(hit.triangle);
        if hit.front { normal } else { -normal }
    }

    /// The side that was hit as a point that gathers light.
    pub fn site_at(&self, hit: &Hit) -> Site {
        let local = self.triangles[hit.triangle as usize].triangle as usize;
        let side = if hit.front { 1.0 } else { -1.0 };
        let face_normal = self.side_normal(hit);
        let weights = weights_of(hit.barycentric).to_array();
        let shading = side * normal_at(self.instance(hit.triangle), local, weights);
        let normal = if shading.dot(face_normal) > LEAN_MIN { shading } else { face_normal };
        Site { position_m: self.point_of(hit), normal, face_normal }
    }

    /// Point of a hit taken from its triangle rather than along the ray, which rounds less.
    pub fn point_of(&self, hit: &Hit) -> Vec3 {
        let [a, b, c] = self.corners(hit.triangle);
        Mat3::from_cols(a, b, c) * weights_of(hit.barycentric)
    }

    /// Lower and upper corner of all vertices in metres; both the origin where there are none.
    pub fn bounds_m(&self) -> [Vec3; 2] {
        self.scene.bounds_m()
    }

    /// As [`Geometry::bounds_m`], of the part that people see from near.
    pub fn near_bounds_m(&self) -> [Vec3; 2] {
        self.scene.near_bounds_m()
    }

    /// Diagonal of the near bounds.
    pub fn near_diagonal_m(&self) -> f32 {
        let [low, high] = self.near_bounds_m();
        (high - low).length()
    }

    /// Diagonal of the bounds.
    pub fn diagonal_m(&self) -> f32 {
        let [low, high] = self.bounds_m();
        (high - low).length()
    }
}

/// Corners of a triangle in metres.
pub fn corners_of(scene: &Scene, triangle: TriangleRef) -> [Vec3; 3] {
    let instance = &scene.instances[triangle.instance as usize];
    instance.triangles[triangle.triangle as usize].map(|vertex| instance.positions_m[vertex as usize])
}

/// Unit normal of a triangle's front.
pub fn face_normal_of(scene: &Scene, triangle: TriangleRef) -> Vec3 {
    let [a, b, c] = corners_of(scene, triangle);
    (b - a).cross(c - a).normalize_or(Vec3::Y)
}

/// Weights of all three corners from those of corners 1 and 2.
pub fn weights_of([b1, b2]: [f32; 2]) -> Vec3 {
    Vec3::new(1.0 - b1 - b2, b1, b2)
}
