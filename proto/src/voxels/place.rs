//! Patches of elements, told from their voxels: most are of the voxel's level, and where the element's plane has them.

use std::array::from_fn;

use glam::IVec3;

use super::content::Element;
use super::predict::{bits_of_column, cell_guess, direction_guess};
use crate::chunk::bytes::Reader;
use crate::chunk::error::in_range;
use crate::chunk::{ChunkError, ints};
use crate::content::PatchKey;

/// Most cells of patches along a side of their level's voxels.
pub(super) const CELLS_MAX: u32 = 8;
/// Most cells along a side of a voxel of a patch that is told by its column in it.
const SIDE_MAX: u32 = 256;
/// Symbol of a patch that is told by itself; those below, less one, are levels below the voxel's, and 0 is no patch.
const ELSEWHERE: u8 = 15;
/// Cells of patches to either side of the origin.
const CELL_MAX: i64 = 1 << 14;
const LEVEL_MAX: u64 = 14;
const DIRECTIONS: u32 = 6;
const ORDINAL_MAX: u64 = 1023;

/// An element and its voxel.
pub(super) struct Placed {
    /// The voxel.
    pub voxel: IVec3,
    /// The element.
    pub element: Element,
}

/// Lattices that patches are told by.
#[derive(Clone, Copy)]
pub(super) struct Lattices {
    /// Level of the voxels.
    pub level: u32,
    /// Cells of patches along a side of their level's voxels.
    pub cells: u32,
}

impl Lattices {
    /// Levels by which `of` is below the voxels', and cells of it along a side of a voxel, unless they are too many.
    fn below(self, of: u32) -> Option<[u32; 2]> {
        let drop = self.level.checked_sub(of)?;
        let side = self.cells << drop;
        (side <= SIDE_MAX).then_some([drop, side])
    }

    /// Cell of level `of` at the least corner of a voxel, as far as there are cells.
    fn corner(self, of: u32, voxel: IVec3) -> [i64; 3] {
        voxel.to_array().map(|at| {
            let at = i64::from(at) * i64::from(self.cells);
            let at = if of > self.level { at >> (of - self.level) } else { at << (self.level - of) };
            at.clamp(-CELL_MAX, CELL_MAX - 1)
        })
    }
}

/// Where an element's patch is, seen from its voxel, but for its ordinal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PatchPlace {
    /// Nowhere: the element is dark.
    None,
    /// In a column through the voxel, along its direction.
    Column {
        /// Levels below the voxel's.
        drop: u32,
        /// Cells of that level along a side of the voxel.
        side: u32,
        /// Column, along the two axes after that of the direction.
        column: [u32; 2],
        /// Cell in the column, from the voxel's.
        along: i64,
        /// Direction.
        direction: u8,
    },
    /// Anywhere.
    Elsewhere {
        /// Level.
        level: u8,
        /// Direction.
        direction: u8,
        /// Cell, from that at the voxel's least corner.
        apart: [i32; 3],
    },
}

/// Errs if a key is not that of a patch: its level is the sky's, or its direction a difference's.
pub(super) fn check_key(section: &'static str, key: PatchKey) -> Result<(), ChunkError> {
    in_range(section, "level in a patch's key", key.level(), 0, LEVEL_MAX)?;
    in_range(section, "direction in a patch's key", key.direction(), 0, u64::from(DIRECTIONS) - 1).map(drop)
}

impl PatchPlace {
    /// Of a patch, seen from a voxel.
    pub fn of(patch: Option<PatchKey>, lattices: Lattices, voxel: IVec3) -> Self {
        let Some(key) = patch else { return Self::None };
        let (of, direction, cell) = (key.level() as u32, key.direction() as u8, key.cell().map(i64::from));
        if let Some([drop, side]) = lattices.below(of) {
            let most = i64::from(side);
            let axis = usize::from(direction / 2);
            let inside = |axis: usize| cell[axis % 3] - i64::from(voxel[axis % 3]) * most;
            let [along, b, c] = [inside(axis), inside(axis + 1), inside(axis + 2)];
            let is_in = |at: i64| (0..most).contains(&at);
            if is_in(b) && is_in(c) && (-most..2 * most).contains(&along) {
                return Self::Column { drop, side, column: [b as u32, c as u32], along, direction };
            }
        }
        let corner = lattices.corner(of, voxel);
        let apart = from_fn(|axis| (cell[axis] - corner[axis]) as i32);
        Self::Elsewhere { level: of as u8, direction, apart }
    }

    /// The patch of that place; its ordinal is asked for if there is one.
    pub fn key(
        &self,
        lattices: Lattices,
        voxel: IVec3,
        ordinal: impl FnOnce() -> u32,
    ) -> Result<Option<PatchKey>, ChunkError> {
        let (level, direction, cell) = match *self {
            Self::None => return Ok(None),
            Self::Column { drop, side, column: [b, c], along, direction } => {
                let inside = [along, i64::from(b), i64::from(c)];
                let at = |axis: usize| {
                    let after = (axis + 3 - usize::from(direction / 2)) % 3;
                    i64::from(voxel[axis]) * i64::from(side) + inside[after]
                };
                (lattices.level - drop, direction, from_fn(at))
            }
            Self::Elsewhere { level, direction, apart } => {
                let corner = lattices.corner(level.into(), voxel);
                (level.into(), direction, from_fn(|axis| corner[axis] + i64::from(apart[axis])))
            }
        };
        for at in cell {
            in_range("patches", "cell of a patch + 2¹⁴", (at + CELL_MAX) as u64, 0, 2 * CELL_MAX as u64 - 1)?;
        }
        let ordinal = in_range("patches", "ordinal", ordinal().into(), 0, ORDINAL_MAX)? as u32;
        Ok(Some(PatchKey::of_cell(level, cell.map(|at: i64| at as i32), direction, ordinal)))
    }

    /// Its symbol, of four bits.
    pub fn symbol(&self) -> u8 {
        match *self {
            Self::None => 0,
            Self::Column { drop, .. } => drop as u8 + 1,
            Self::Elsewhere { .. } => ELSEWHERE,
        }
    }

    /// Sub-voxels in which its element may be expected.
    pub fn bits(&self) -> u64 {
        match *self {
            Self::Column { side, column, direction, .. } => {
                bits_of_column(side, column, usize::from(direction / 2))
            }
            _ => u64::MAX,
        }
    }

    /// Appends all but the symbols, of elements in turn.
    pub fn write(places: &[Self], placed: &[Placed], out: &mut Vec<u8>) {
        let (mut codes, mut levels, mut directions) = (Vec::new(), Vec::new(), Vec::new());
        let mut cells = [Vec::new(), Vec::new(), Vec::new()];
        for (place, Placed { element, .. }) in places.iter().zip(placed) {
            match *place {
                Self::None => {}
                Self::Column { side, column: [b, c], along, direction, .. } => {
                    let guess = cell_guess(element, side, [b, c], usize::from(direction / 2));
                    let error = ints::zigzag((along - guess) as i32);
                    let turn = u32::from(direction) + DIRECTIONS - u32::from(direction_guess(element.normal));
                    codes.push(b + side * (c + side * (turn % DIRECTIONS + DIRECTIONS * error)));
                }
                Self::Elsewhere { level, direction, apart } => {
                    levels.push(level);
                    directions.push(direction);
                    cells.iter_mut().zip(apart).for_each(|(along, at)| along.push(at));
                }
            }
        }
        ints::put_u32s(out, &codes);
        out.append(&mut levels);
        out.append(&mut directions);
        cells.iter().for_each(|along| ints::put_i32s(out, along));
    }

    /// Reads the places of those symbols, of elements that have their normal and plane.
    pub fn read(
        reader: &mut Reader,
        symbols: &[u8],
        placed: &[Placed],
        lattices: Lattices,
    ) -> Result<Vec<Self>, ChunkError> {
        let count = |is_one: fn(u8) -> bool| symbols.iter().filter(|&&symbol| is_one(symbol)).count();
        let inside = count(|symbol| (1..ELSEWHERE).contains(&symbol));
        let mut codes = ints::take_u32s(reader, "column of a patch", inside)?.into_iter();
        let far = count(|symbol| symbol == ELSEWHERE);
        let (levels, directions) = (reader.take("level", far, 1)?, reader.take("direction", far, 1)?);
        let mut apart = [Vec::new(), Vec::new(), Vec::new()];
        for along in &mut apart {
            *along = ints::take_i32s(reader, "cell", far)?;
        }
        let mut numbers = 0..far;
        let read = |(&symbol, Placed { element, .. }): (&u8, &Placed)| match symbol {
            0 => Ok(Self::None),
            ELSEWHERE => {
                let number = numbers.next().unwrap_or_default();
                let [level, direction] = [levels[number], directions[number]];
                in_range("patches", "level", level.into(), 0, LEVEL_MAX)?;
                in_range("patches", "direction", direction.into(), 0, u64::from(DIRECTIONS) - 1)?;
                Ok(Self::Elsewhere { level, direction, apart: from_fn(|axis| apart[axis][number]) })
            }
            symbol => {
                Self::of_code(codes.next().unwrap_or_default(), u32::from(symbol) - 1, element, lattices)
            }
        };
        symbols.iter().zip(placed).map(read).collect()
    }

    fn of_code(code: u32, drop: u32, element: &Element, lattices: Lattices) -> Result<Self, ChunkError> {
        in_range("patches", "levels below the voxel's", drop.into(), 0, lattices.level.into())?;
        let side = u64::from(lattices.cells) << drop;
        let side = in_range("patches", "cells along a voxel", side, 1, SIDE_MAX.into())? as u32;
        let column = [code % side, code / side % side];
        let rest = code / (side * side);
        let direction = (u32::from(direction_guess(element.normal)) + rest) % DIRECTIONS;
        let guess = cell_guess(element, side, column, direction as usize / 2);
        let along = guess + i64::from(ints::unzigzag(rest / DIRECTIONS));
        Ok(Self::Column { drop, side, column, along, direction: direction as u8 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::voxels::NormalCode;

    const LATTICES: Lattices = Lattices { level: 2, cells: 2 };

    fn placed(voxel: IVec3) -> Placed {
        let normal = NormalCode([-900, 30_000]);
        let element =
            Element { normal, plane: -5000, bits: 1, patch: None, glow: 0, is_backed: true, is_finest: true };
        Placed { voxel, element }
    }

    #[test]
    fn patches_come_back_from_where_they_are_seen() {
        let voxel = IVec3::new(-3, 0, 70);
        for (key, wanted) in [
            (PatchKey::of_cell(2, [-6, 1, 140], 5, 3), 1),
            (PatchKey::of_cell(2, [-5, 3, 141], 2, 3), 1),
            (PatchKey::of_cell(0, [-17, 7, 560], 0, 1023), 3),
            (PatchKey::of_cell(2, [-7, 1, 140], 5, 0), ELSEWHERE),
            (PatchKey::of_cell(2, [-5, 4, 141], 2, 3), ELSEWHERE),
            (PatchKey::of_cell(14, [-1, 0, 0], 2, 0), ELSEWHERE),
            (PatchKey::of_cell(3, [-(1 << 14), (1 << 14) - 1, 9], 2, 0), ELSEWHERE),
        ] {
            let place = PatchPlace::of(Some(key), LATTICES, voxel);
            assert_eq!(place.symbol(), wanted, "{key:?}");
            assert_eq!(place.key(LATTICES, voxel, || key.ordinal()).unwrap(), Some(key));
            let mut bytes = Vec::new();
            let placed = [placed(voxel), placed(voxel)];
            PatchPlace::write(&[place, PatchPlace::None], &placed, &mut bytes);
            let mut reader = Reader::new("test", &bytes);
            let read = PatchPlace::read(&mut reader, &[wanted, 0], &placed, LATTICES).unwrap();
            reader.end().unwrap();
            assert_eq!(read, [place, PatchPlace::None]);
        }
    }

    #[test]
    fn a_cell_beyond_the_lattice_and_levels_too_far_below_are_refused() {
        let beyond = PatchPlace::Column { drop: 0, side: 2, column: [0; 2], along: 0, direction: 0 };
        let told = beyond.key(LATTICES, IVec3::new(1 << 13, 0, 0), || 0).unwrap_err().to_string();
        assert!(told.contains("cell of a patch"), "{told}");
        let element = placed(IVec3::ZERO).element;
        assert!(PatchPlace::of_code(0, 3, &element, LATTICES).is_err(), "below level 0");
        assert!(PatchPlace::of_code(0, 8, &element, Lattices { level: 9, cells: 2 }).is_err(), "512 cells");
        assert!(
            PatchPlace::of_code(u32::MAX, 0, &element, LATTICES).is_ok(),
            "what it names may not be there"
        );
    }
}
