//! Points of receivers' texels on the surface.

use glam::Vec2;

use super::polygon::{clipped, is_inside, source_weights, texels_of};
use super::texel_table::TexelTable;
use super::{Lightmap, Receiver};
use crate::geometry::{Geometry, Site, TriangleRef, corners_of, face_normal_of};
use crate::scene::surface::normal_at;

/// The triangles in the texel of each receiver.
#[derive(Debug, Default)]
pub struct TexelTriangles {
    /// First entry of each receiver, and the end.
    starts: Vec<u32>,
    /// Indices of unwrapped triangles.
    entries: Vec<u32>,
}

impl TexelTriangles {
    /// Finds the triangles that touch each receiver's texel.
    pub fn new(lightmap: &Lightmap, texels: &TexelTable, sides: impl Fn(u32) -> u32) -> Self {
        let mut found: Vec<(u32, u32)> = Vec::new();
        for (index, entry) in texels.entries().enumerate() {
            let sides = sides(entry.instance);
            let front = lightmap.first_block[entry.instance as usize] + entry.part * sides;
            for block in front..front + sides {
                let table = &lightmap.blocks[block as usize];
                let corners = &entry.triangle.uv_texels;
                for (place, texel, corner) in texels_of(corners, table.size) {
                    let receiver = table.receiver_of_texel[place];
                    let own = lightmap.receivers.get(receiver as usize);
                    let is_own = own.is_some_and(|own| own.texel == texel);
                    if is_own && !clipped(corners, corner, corner + 1.0).is_empty() {
                        found.push((receiver, index as u32));
                    }
                }
            }
        }
        found.sort_unstable();
        let mut starts = vec![0; lightmap.receivers.len() + 1];
        found.iter().for_each(|(receiver, _)| starts[*receiver as usize + 1] += 1);
        for index in 1..starts.len() {
            starts[index] += starts[index - 1];
        }
        Self { starts, entries: found.into_iter().map(|(_, entry)| entry).collect() }
    }

    /// The surface at a place in a receiver's texel, 0..1 in x and y.
    pub fn point(
        &self,
        geometry: &Geometry,
        texels: &TexelTable,
        receiver: (u32, &Receiver, bool),
        at: Vec2,
    ) -> Option<Site> {
        let (index, Receiver { texel, .. }, is_back) = receiver;
        let point = Vec2::new(texel[0].into(), texel[1].into()) + at;
        let range = self.starts[index as usize] as usize..self.starts[index as usize + 1] as usize;
        let entries = self.entries[range].iter().map(|&entry| texels.entry(entry));
        let entry = { entries }.find(|entry| is_inside(&entry.triangle.uv_texels, point))?;
        let weights = source_weights(entry.triangle, point);
        let triangle = TriangleRef { instance: entry.instance, triangle: entry.triangle.source_triangle };
        let site = site_of(geometry, triangle, weights);
        Some(if is_back { site.turned() } else { site })
    }
}

/// A point of a triangle's front.
pub fn site_of(geometry: &Geometry, triangle: TriangleRef, weights: [f32; 3]) -> Site {
    let instance = &geometry.scene.instances[triangle.instance as usize];
    let [a, b, c] = corners_of(&geometry.scene, triangle);
    let [wa, wb, wc] = weights;
    let face_normal = face_normal_of(&geometry.scene, triangle);
    let shading = normal_at(instance, triangle.triangle as usize, weights);
    // A shading normal that points through the surface is a fault of the file.
    let normal = if shading.dot(face_normal) > 0.05 { shading } else { face_normal };
    Site { position_m: a * wa + b * wb + c * wc, normal, face_normal }
}
