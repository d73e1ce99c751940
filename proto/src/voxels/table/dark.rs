//! Dark and lit parts of one plane side by side.

use glam::{IVec3, Vec3};

use super::super::content::{BRICK_VOXELS, SUBS, place_in_brick, sub_in_voxel, voxel_in_brick};
use super::{DARK_PATCH, ElementRow, GLOW_MARK, VoxelTable};

/// Least cosine between normals of parts of one plane, and how far they lie apart at most in sides of the voxel: as elements are joined.
const SAME_COSINE: f32 = 0.906_307_8;
const SAME_HEIGHT: f32 = 0.125;
/// Steps to the sub-voxels beside one.
const BESIDE: [IVec3; 6] = [IVec3::X, IVec3::NEG_X, IVec3::Y, IVec3::NEG_Y, IVec3::Z, IVec3::NEG_Z];

/// Gives sub-voxels of dark elements to lit ones of their plane that touch the same or one beside it. Light reaches dark parts from nowhere, so that
/// walks meet them for the width of a sub-voxel alone: the floor below a box is dark, and its sub-voxels reach out to the floor around. What is dark is
/// said of patches.
pub(super) fn yield_to_lit(table: &mut VoxelTable, is_dark_patch: impl Fn(u32) -> bool) {
    let is_dark = |row: &ElementRow| {
        row.glow().is_none() && (row.patch_number == DARK_PATCH || is_dark_patch(row.patch_number))
    };
    let is_dark: Vec<bool> = table.elements.iter().map(is_dark).collect();
    let mut elements = Vec::with_capacity(table.elements.len());
    let mut first_elements = Vec::with_capacity(table.first_elements.len());
    for brick in 0..table.len() as u32 {
        for place in 0..(BRICK_VOXELS * BRICK_VOXELS * BRICK_VOXELS) as u16 {
            let Some(voxel) = table.voxel(brick, place) else { continue };
            first_elements.push(elements.len() as u32);
            let row = &table.bricks[brick as usize];
            let cell = IVec3::from(row.cell) * BRICK_VOXELS + voxel_in_brick(place);
            let own = Voxel::new(table, row.level, cell, voxel);
            let has_dark = is_dark[own.first..own.end].contains(&true);
            if has_dark {
                own.yielded(table, &is_dark, &mut elements)
            } else {
                elements.extend(own.rows(table))
            }
        }
    }
    first_elements.push(elements.len() as u32);
    (table.elements, table.first_elements) = (elements, first_elements);
}

/// A voxel and its elements.
struct Voxel {
    level: u32,
    cell: IVec3,
    middle_m: Vec3,
    side_m: f32,
    first: usize,
    end: usize,
}

impl Voxel {
    fn new(table: &VoxelTable, level: u32, cell: IVec3, voxel: u32) -> Self {
        let side_m = table.voxel_m * (1_u32 << level) as f32;
        let [first, end] = [0, 1].map(|next| table.first_elements[voxel as usize + next] as usize);
        Self { level, cell, middle_m: (cell.as_vec3() + 0.5) * side_m, side_m, first, end }
    }

    /// The one beside it, if that has anything.
    fn beside(&self, table: &VoxelTable, step: IVec3) -> Option<Self> {
        let cell = self.cell + step;
        let brick = table.brick(self.level, cell.map(|at| at.div_euclid(BRICK_VOXELS)))?;
        Some(Self::new(table, self.level, cell, table.voxel(brick, place_in_brick(cell))?))
    }

    fn rows<'a>(&self, table: &'a VoxelTable) -> &'a [ElementRow] {
        &table.elements[self.first..self.end]
    }

    /// Lit elements.
    fn lit<'a>(
        &self,
        table: &'a VoxelTable,
        is_dark: &'a [bool],
    ) -> impl Iterator<Item = &'a ElementRow> + use<'a> {
        let marks = &is_dark[self.first..self.end];
        self.rows(table).iter().zip(marks).filter(|(_, is_dark)| !**is_dark).map(|(row, _)| row)
    }

    /// Its elements, dark ones without what is given to lit ones, and that as elements of theirs.
    fn yielded(&self, table: &VoxelTable, is_dark: &[bool], elements: &mut Vec<ElementRow>) {
        let beside = BESIDE.map(|step| self.beside(table, step));
        for (row, index) in self.rows(table).iter().zip(self.first..) {
            if !is_dark[index] {
                elements.push(*row);
                continue;
            }
            let mut left = *row;
            for other in self.lit(table, is_dark).filter(|other| self.is_of_plane(row, self, other)) {
                left.bits = [0, 1].map(|half| left.bits[half] & !other.bits[half]);
            }
            let bits = u64::from(left.bits[0]) | u64::from(left.bits[1]) << 32;
            // By patch and marks, glows among these.
            let mut given: Vec<([u32; 2], u64)> = Vec::new();
            for sub in (0..u64::BITS).filter(|sub| bits >> sub & 1 == 1) {
                let Some(lit) = self.lit_beside(table, is_dark, &beside, (row, sub)) else { continue };
                let light = [lit.patch_number, row.marks & !GLOW_MARK | lit.marks & GLOW_MARK];
                match given.iter_mut().find(|(known, _)| *known == light) {
                    Some((_, bits)) => *bits |= 1 << sub,
                    None => given.push((light, 1 << sub)),
                }
            }
            let kept = given.iter().fold(bits, |bits, (_, given)| bits & !given);
            elements.extend((kept != 0).then_some(ElementRow { bits: halves(kept), ..*row }));
            elements.extend(given.into_iter().map(|([patch_number, marks], bits)| ElementRow {
                bits: halves(bits),
                patch_number,
                marks,
                ..*row
            }));
        }
    }

    /// The first lit element of a dark one's plane that touches a sub-voxel beside one of its own.
    fn lit_beside<'a>(
        &self,
        table: &'a VoxelTable,
        is_dark: &'a [bool],
        beside: &[Option<Self>; 6],
        (row, sub): (&ElementRow, u32),
    ) -> Option<&'a ElementRow> {
        let at = IVec3::new((sub & 3) as i32, (sub >> 2 & 3) as i32, (sub >> 4) as i32);
        BESIDE.iter().zip(beside).find_map(|(step, beside)| {
            let next = at + *step;
            let is_within = next.cmpge(IVec3::ZERO).all() && next.cmplt(IVec3::splat(SUBS)).all();
            let voxel = if is_within { self } else { beside.as_ref()? };
            let bit = sub_in_voxel(next);
            let touches = |other: &&ElementRow| other.bits[(bit >> 5) as usize] >> (bit & 31) & 1 == 1;
            let mut lit = voxel.lit(table, is_dark).filter(touches);
            lit.find(|other| self.is_of_plane(row, voxel, other))
        })
    }

    /// Whether a lit element of a voxel is of a dark one's plane, and can stand for it: it stops as much.
    fn is_of_plane(&self, dark: &ElementRow, voxel: &Self, lit: &ElementRow) -> bool {
        let normal = lit.normal();
        let on_m = self.middle_m + dark.normal() * dark.height_m;
        lit.patch_number != DARK_PATCH
            && normal.dot(dark.normal()) > SAME_COSINE
            && (normal.dot(on_m - voxel.middle_m) - lit.height_m).abs() <= SAME_HEIGHT * self.side_m
            && lit.is_backed() >= dark.is_backed()
            && lit.is_finest() >= dark.is_finest()
    }
}

fn halves(bits: u64) -> [u32; 2] {
    [bits as u32, (bits >> 32) as u32]
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, IVec3};

    use super::super::super::content::{Brick, BrickKey, Element, NormalCode, VoxelPart};
    use super::*;
    use crate::content::PatchKey;

    fn element(key: u64, normal: DVec3, height: f64, bits: u64) -> Element {
        Element {
            normal: NormalCode::of(normal),
            plane: Element::plane_code(height, 1.0),
            bits,
            patch: (key != 0).then_some(PatchKey(key)),
            glow: 0,
            is_backed: true,
            is_finest: false,
        }
    }

    /// Patches and bits of [`rows`].
    fn yielded(voxels: &[&[Element]]) -> Vec<(u32, u32)> {
        rows(voxels).iter().map(|row| (row.patch_number, row.bits[0])).collect()
    }

    /// Elements of voxels in a row along x, the first elements of which lie in the first voxel; patch 1 is dark.
    fn rows(voxels: &[&[Element]]) -> Vec<ElementRow> {
        let of = |(place, elements): (usize, &&[Element])| super::super::super::content::Voxel {
            place: 6 + place as u16,
            elements: elements.len() as u16,
        };
        let brick = |x| Brick {
            key: BrickKey::new(0, IVec3::new(x, 0, 0)),
            voxels: voxels.iter().enumerate().map(of).collect(),
            elements: voxels.concat(),
        };
        let glows = vec![super::super::Glow { emitter: 0, share: [1.0; 3] }];
        let part = VoxelPart { voxel_m: 1.0, glows, bricks: vec![brick(0), brick(5)] };
        let mut table = VoxelTable::join([&part].into_iter(), |key| Some(key.0 as u32)).unwrap();
        yield_to_lit(&mut table, |patch| patch == 1);
        let (one, two) = table.elements.split_at(table.elements.len() / 2);
        assert_eq!(one, two);
        assert_eq!(table.first_elements.len(), 2 * voxels.len() + 1);
        assert_eq!(*table.first_elements.last().unwrap() as usize, table.elements.len());
        one.to_vec()
    }

    #[test]
    fn dark_parts_beside_what_glows_glow_and_those_that_leave_all_are_gone() {
        let lit = Element { glow: 1, ..element(7, DVec3::Y, 0.0, 0b1000) };
        let found = rows(&[&[element(0, DVec3::Y, 0.0, 0b0100), lit]]);
        let of = |row: &ElementRow| (row.patch_number, row.bits[0], row.glow(), row.is_backed());
        assert_eq!(
            found.iter().map(of).collect::<Vec<_>>(),
            [(7, 0b0100, Some(0), true), (7, 0b1000, Some(0), true)]
        );
    }

    #[test]
    fn dark_parts_of_a_plane_leave_to_lit_ones_what_these_touch_or_have_beside_them() {
        let lit = element(7, DVec3::Y, 0.0, 0b1100);
        for dark in [0, 1] {
            let number = if dark == 0 { DARK_PATCH } else { 1 };
            let own = |normal, height| element(dark, normal, height, 0b0111);
            // Of sub-voxels along x the third is touched by both, the second is beside, the first is left.
            let wanted = [(number, 0b0001), (7, 0b0010), (7, 0b1100)];
            assert_eq!(yielded(&[&[own(DVec3::Y, 0.01), lit]]), wanted);
            // The lit one lies in the next voxel.
            let next = element(7, DVec3::Y, 0.0, 0b0001);
            let ends = element(dark, DVec3::Y, 0.0, 0b1110);
            assert_eq!(yielded(&[&[ends], &[next]]), [(number, 0b0110), (7, 0b1000), (7, 0b0001)]);
            assert_eq!(yielded(&[&[own(DVec3::Y, 0.0)], &[next]])[0], (number, 0b0111));
            for other in [own(DVec3::X, 0.0), own(DVec3::Y, 0.3), own(-DVec3::Y, 0.0)] {
                assert_eq!(yielded(&[&[other, lit]])[0], (number, 0b0111));
            }
            // What glows is not dark, and a part without a back does not stand for one with it.
            let glowing = Element { glow: 1, ..own(DVec3::Y, 0.0) };
            assert_eq!(yielded(&[&[glowing, lit]])[0].1, 0b0111);
            let bare = Element { is_backed: false, ..lit };
            assert_eq!(yielded(&[&[own(DVec3::Y, 0.0), bare]])[0], (number, 0b0111));
        }
    }
}
