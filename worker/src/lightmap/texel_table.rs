//! Where each triangle lies in the lightmap: from a hit to its texel.

use glam::{Vec2, Vec3};

use super::Charts;
use crate::scene::model::Scene;
use crate::unwrap::{UnwrappedTriangle, weights_in_part};

/// Where each triangle lies in its instance's unwrap.
pub(super) struct TexelTable {
    /// First entry of each triangle, and the end.
    starts: Vec<u32>,
    entries: Vec<TexelPart>,
}

/// A triangle, or a piece of one, with its instance and the part of the unwrap.
pub(super) struct TexelPart {
    pub instance: u32,
    pub part: u32,
    pub triangle: UnwrappedTriangle,
}

/// A triangle, or a piece of one, in an unwrap.
pub(super) struct TexelEntry<'a> {
    /// Instance.
    pub instance: u32,
    /// Part of its unwrap.
    pub part: u32,
    /// The triangle there.
    pub triangle: &'a UnwrappedTriangle,
}

impl TexelTable {
    /// The table of a scene's unwraps.
    pub fn new(scene: &Scene, charts: &Charts) -> Self {
        let mut by_triangle = Vec::new();
        let mut first_triangle = 0_u32;
        for (index, (instance, unwrap)) in scene.instances.iter().zip(&charts.unwraps).enumerate() {
            for (part, block) in unwrap.blocks.iter().enumerate() {
                for triangle in &block.triangles {
                    let [instance, part] = [index, part].map(|index| index as u32);
                    let entry = TexelPart { instance, part, triangle: triangle.clone() };
                    by_triangle.push((first_triangle + triangle.source_triangle, entry));
                }
            }
            first_triangle += instance.triangles.len() as u32;
        }
        by_triangle.sort_by_key(|(triangle, _)| *triangle);
        let mut starts = vec![0_u32; first_triangle as usize + 1];
        for (triangle, _) in &by_triangle {
            starts[*triangle as usize + 1] += 1;
        }
        for index in 1..starts.len() {
            starts[index] += starts[index - 1];
        }
        Self { starts, entries: by_triangle.into_iter().map(|(_, entry)| entry).collect() }
    }

    /// The triangle, or piece of one, of that index.
    pub fn entry(&self, index: u32) -> TexelEntry<'_> {
        let TexelPart { instance, part, triangle } = &self.entries[index as usize];
        TexelEntry { instance: *instance, part: *part, triangle }
    }

    /// All triangles and pieces, in the order of their indices.
    pub fn entries(&self) -> impl Iterator<Item = TexelEntry<'_>> {
        (0..self.entries.len() as u32).map(|index| self.entry(index))
    }

    /// A triangle in its unwrap, or the pieces that it is cut in.
    pub fn pieces_of(&self, triangle: u32) -> &[TexelPart] {
        &self.entries[self.starts[triangle as usize] as usize..self.starts[triangle as usize + 1] as usize]
    }

    /// Part and place in texels of a point of a triangle; of a triangle cut in pieces, the piece that holds it.
    pub fn locate(&self, triangle: u32, weights: Vec3) -> Option<(u32, Vec2)> {
        let (entry, inner) = match self.pieces_of(triangle) {
            [whole] => (whole, weights_in_part(&whole.triangle, weights)),
            pieces => {
                let pieces = pieces.iter().map(|entry| (entry, weights_in_part(&entry.triangle, weights)));
                pieces.max_by(|(_, a), (_, b)| a.min_element().total_cmp(&b.min_element()))?
            }
        };
        let [a, b, c] = entry.triangle.uv_texels;
        Some((entry.part, a * inner.x + b * inner.y + c * inner.z))
    }
}
