//! Position, normals, albedo and emission of the surface at a texel's point.

use glam::Vec3;
use lightkiln_proto::content::{AreaCode, TexelEdge};

use super::cover::TexelPoint;
use crate::geometry::{Geometry, Site, TriangleRef, corners_of, face_normal_of};
use crate::lightmap::Receiver;
use crate::lightmap::texel_points::site_of;
use crate::scene::surface::{Footprint, surface_at};
use crate::unwrap::UnwrappedTriangle;

/// The same texel seen from the back.
pub fn turned(front: &Receiver) -> Receiver {
    Receiver { normal: -front.normal, face_normal: -front.face_normal, ..*front }
}

/// An instance whose points are asked for.
pub struct Attributes<'a> {
    /// Triangles.
    pub geometry: &'a Geometry,
    /// Index of the instance.
    pub instance: usize,
    /// Texel size in metres.
    pub texel_m: f32,
}

impl Attributes<'_> {
    /// World area of a triangle, or of the piece of it that lies in the block, in texels.
    pub fn area_texels(&self, triangle: &UnwrappedTriangle) -> f32 {
        let reference = TriangleRef { instance: self.instance as u32, triangle: triangle.source_triangle };
        let source = corners_of(&self.geometry.scene, reference);
        let corner = |weights: &Vec3| source[0] * weights.x + source[1] * weights.y + source[2] * weights.z;
        let [a, b, c] =
            triangle.piece_corners.as_deref().map_or(source, |piece| piece.each_ref().map(corner));
        0.5 * (b - a).cross(c - a).length() / (self.texel_m * self.texel_m)
    }

    /// Normal of a triangle's front.
    pub fn face_normal(&self, triangle: u32) -> Vec3 {
        let reference = TriangleRef { instance: self.instance as u32, triangle };
        face_normal_of(&self.geometry.scene, reference)
    }

    /// The front's receiver of a texel; its block is filled in later.
    pub fn receiver(&self, point: &TexelPoint) -> Receiver {
        let instance = &self.geometry.scene.instances[self.instance];
        let triangle = point.triangle as usize;
        let reference = TriangleRef { instance: self.instance as u32, triangle: point.triangle };
        let Site { position_m, normal, face_normal } = site_of(self.geometry, reference, point.weights);
        let footprint = Footprint::square(instance, triangle, self.texel_m);
        let Geometry { scene, images, .. } = self.geometry;
        let surface = surface_at(scene, images, self.instance, triangle, point.weights, &footprint);
        Receiver {
            block: 0,
            texel: point.texel,
            position_m,
            normal,
            face_normal,
            albedo: surface.albedo,
            emission: surface.emission,
            links: 0,
            coverage: 0,
            fine: 0,
            edge: TexelEdge::NONE,
            area: AreaCode::ONE,
            light_of: 0,
        }
    }
}
