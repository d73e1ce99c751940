//! Names of parts of a stage, and digests of what they hold.

use glam::{IVec3, Vec2, Vec3};
use lightkiln_proto::content::{BlockKey, PatchKey};
use lightkiln_proto::ids::Digest;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::rays::sampling::seed_of;

/// Bits of a name below those of its kind.
const KIND_SHIFT: u32 = 61;
/// Cells along an axis that names tell apart, to each side of the origin.
const CELLS: i32 = 1 << 19;

/// Kinds of parts of a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Part {
    /// A cell of the grid over the scene: its triangles.
    Cell = 0,
    /// A tile of the lightmap: its receivers.
    Tile = 1,
    /// A patch of few texels with all its parts.
    Branch = 2,
    /// A large patch: its parts, and their areas in steps.
    Shape = 3,
    /// A large patch: the areas of its parts.
    Shares = 4,
    /// How far the scene reaches.
    Extent = 5,
}

/// Name of a part of a stage: the same for the same place of any scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Name(pub u64);

impl Name {
    fn of(part: Part, rest: u64) -> Self {
        Self((part as u64) << KIND_SHIFT | rest & ((1 << KIND_SHIFT) - 1))
    }

    /// A cell of the lattice.
    pub fn cell(cell: IVec3) -> Self {
        let [x, y, z] = cell.to_array().map(|at| u64::from(at.wrapping_add(CELLS) as u32) & 0xf_ffff);
        Self::of(Part::Cell, z << 40 | y << 20 | x)
    }

    /// A tile of a block.
    pub fn tile(block: BlockKey, place: [u32; 2]) -> Self {
        Self::of(Part::Tile, seed_of(&[block, place[0].into(), place[1].into()]))
    }

    /// A patch, as a part of that kind.
    pub fn patch(part: Part, key: PatchKey) -> Self {
        Self::of(part, seed_of(&[key.0, 8]))
    }

    /// How far the scene reaches.
    pub fn extent() -> Self {
        Self::of(Part::Extent, 0)
    }

    /// Kind of the part.
    pub fn part(self) -> Part {
        let all = [Part::Cell, Part::Tile, Part::Branch, Part::Shape, Part::Shares];
        all.get((self.0 >> KIND_SHIFT) as usize).copied().unwrap_or(Part::Extent)
    }

    /// Words for people: the place of a cell in metres, or the kind alone.
    pub fn words(self, cell_m: f32) -> String {
        match self.part() {
            Part::Cell => {
                let axis = |shift: u32| ((self.0 >> shift & 0xf_ffff) as i32 - CELLS) as f32 * cell_m;
                format!("the cell of {cell_m} m at {} {} {}", axis(0), axis(20), axis(40))
            }
            Part::Tile => "a tile of the lightmap".into(),
            Part::Branch | Part::Shape | Part::Shares => "a surface patch".into(),
            Part::Extent => "the extent of the scene".into(),
        }
    }
}

/// Names in ascending order, each once. They mostly come so; those of cells far from the origin begin anew.
pub fn ascending(mut names: Vec<Name>) -> Vec<Name> {
    if !names.is_sorted() {
        names.sort_unstable();
    }
    names.dedup();
    names
}

/// All names of some lists, each ascending and each name once, as one such list.
pub fn union<'a>(lists: impl IndexedParallelIterator<Item = &'a [Name]>) -> Vec<Name> {
    lists.fold(Vec::new, |all, list| merged(&all, list)).reduce(Vec::new, |a, b| merged(&a, &b))
}

fn merged(a: &[Name], b: &[Name]) -> Vec<Name> {
    let (mut a, mut b) = (a.iter().copied().peekable(), b.iter().copied().peekable());
    let mut all = Vec::with_capacity(a.len().max(b.len()));
    loop {
        let least = match (a.peek(), b.peek()) {
            (Some(of_a), Some(of_b)) => *of_a.min(of_b),
            (Some(rest), None) | (None, Some(rest)) => *rest,
            (None, None) => return all,
        };
        all.push(least);
        a.next_if_eq(&least);
        b.next_if_eq(&least);
    }
}

/// Places of names among `all`, both lists ascending.
///
/// Panics where one is not in it: whoever left it out would keep what an edit has changed.
pub fn places_in<'a>(all: &'a [Name], names: &'a [Name]) -> impl Iterator<Item = usize> + 'a {
    let mut next = 0;
    names.iter().map(move |name| {
        while all[next] != *name {
            next += 1;
        }
        next
    })
}

/// Digest of a part's content; all 0 where there is nothing.
pub type Mark = [u8; 16];

/// Bytes that a digest is made of.
#[derive(Clone, Debug, Default)]
pub struct Bytes(Vec<u8>);

impl Bytes {
    /// Adds a whole number.
    pub fn number(&mut self, number: u64) -> &mut Self {
        self.0.extend_from_slice(&number.to_le_bytes());
        self
    }

    /// Adds numbers by their bits.
    pub fn floats(&mut self, floats: &[f32]) -> &mut Self {
        floats.iter().for_each(|float| self.0.extend_from_slice(&float.to_bits().to_le_bytes()));
        self
    }

    /// Adds a point, or a direction.
    pub fn vector(&mut self, vector: Vec3) -> &mut Self {
        self.floats(&vector.to_array())
    }

    /// Adds a place of a texture or a lightmap.
    pub fn place(&mut self, place: Vec2) -> &mut Self {
        self.floats(&place.to_array())
    }

    /// Adds bytes, with their length.
    pub fn bytes(&mut self, bytes: &[u8]) -> &mut Self {
        self.number(bytes.len() as u64);
        self.0.extend_from_slice(bytes);
        self
    }

    /// Nothing was added.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The digest.
    pub fn digest(&self) -> Digest {
        Digest::of(&self.0)
    }

    /// The digest's first half.
    pub fn mark(&self) -> Mark {
        let mut mark = Mark::default();
        mark.copy_from_slice(&self.digest().0[..16]);
        mark
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(of: &[u64]) -> Vec<Name> {
        of.iter().copied().map(Name).collect()
    }

    #[test]
    fn names_of_cells_at_the_end_of_their_numbers_are_put_in_order() {
        let row: Vec<Name> = (CELLS - 2..CELLS + 2).map(|x| Name::cell(IVec3::new(x, 0, 0))).collect();
        assert!(!row.is_sorted());
        let sorted = ascending(row.iter().chain(&row).copied().collect());
        assert!(sorted.is_sorted() && sorted.len() == 4 && row.iter().all(|name| sorted.contains(name)));
    }

    #[test]
    fn union_has_each_name_of_any_list_once_and_places_are_those_in_it() {
        let lists = [&[2, 5, 9][..], &[], &[1, 5, 12], &[9], &[1, 2, 30]].map(names);
        let all = union(lists.par_iter().map(Vec::as_slice));
        assert_eq!(all, names(&[1, 2, 5, 9, 12, 30]));
        for list in &lists {
            assert!(places_in(&all, list).map(|place| all[place]).eq(list.iter().copied()));
        }
        assert!(
            std::panic::catch_unwind(|| places_in(&all, &names(&[1, 3])).count()).is_err(),
            "3 is in no list"
        );
        assert_eq!(union([[].as_slice(); 2].into_par_iter()), []);
    }
}
