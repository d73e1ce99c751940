//! Elements at run time: flat arrays that shaders read as they are, and the brick of a place by hash.

mod dark;
#[cfg(test)]
mod tests;

use bytemuck::{Pod, Zeroable};
use glam::{IVec3, Vec3};

use super::content::{
    BRICK_VOXELS, BRICKS_MAX, Brick, BrickKey, Element, Glow, LEVELS_MAX, NormalCode, SUBS, VoxelPart,
};
use crate::content::{PatchKey, PatchSet};
use crate::relight::{Inconsistent, PatchTable};

/// Stands for the patch of what is dark.
pub const DARK_PATCH: u32 = u32::MAX;
/// A free slot of the hash table, and the brick of a place that has none.
pub const NO_BRICK: u32 = u32::MAX;
/// Words of a brick's mask.
pub const BRICK_WORDS: usize = 16;
/// Binary logarithm of ticks along a side of a voxel of level 0. A **tick** is a sub-voxel of level 0; all boxes are 2^size ticks wide, so that
/// shifts take a tick to its boxes.
pub const VOXEL_SIZE: u32 = SUBS.trailing_zeros();
/// The same of a brick.
pub const BRICK_SIZE: u32 = VOXEL_SIZE + BRICK_VOXELS.trailing_zeros();
/// Bits of [`ElementRow::marks`] that hold its glow.
const GLOW_MARK: u32 = IS_BACKED - 1;
/// Bit of [`ElementRow::marks`]: see [`Element::is_backed`].
const IS_BACKED: u32 = 1 << 30;
/// Likewise [`Element::is_finest`].
const IS_FINEST: u32 = 1 << 31;

/// Place of a brick as shaders read it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct BrickRow {
    /// Cell x, y, z on the lattice of its level's bricks.
    pub cell: [i32; 3],
    /// Level.
    pub level: u32,
}

/// An element as shaders read it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct ElementRow {
    /// Code of n_e, x in the lower 16 bits, see [`NormalCode`].
    pub normal: u32,
    /// `n_e·(x − m)` of its plane in metres, m the middle of its voxel.
    pub height_m: f32,
    /// Sub-voxels that it touches, lower 32 bits first.
    pub bits: [u32; 2],
    /// Its patch, or [`DARK_PATCH`].
    pub patch_number: u32,
    /// Its glow and flags: [`ElementRow::glow`], [`ElementRow::is_backed`], [`ElementRow::is_finest`] read them.
    pub marks: u32,
}

impl ElementRow {
    /// Unit normal n_e.
    pub fn normal(&self) -> Vec3 {
        NormalCode([self.normal as i16, (self.normal >> 16) as i16]).normal()
    }

    /// Its glow, a place in [`VoxelTable::glows`].
    pub fn glow(&self) -> Option<u32> {
        (self.marks & GLOW_MARK).checked_sub(1)
    }

    /// Its other side is dark.
    pub fn is_backed(&self) -> bool {
        self.marks & IS_BACKED != 0
    }

    /// Its surface has no elements at the level below.
    pub fn is_finest(&self) -> bool {
        self.marks & IS_FINEST != 0
    }
}

/// Elements of all parts of a bake that have come; more may come, and coarser bricks answer meanwhile.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VoxelTable {
    /// Side h₀ of voxels of level 0 in metres.
    pub voxel_m: f32,
    /// Bricks by [`brick_hash`], a power of two of slots, at least twice as many as bricks; a taken slot sends on to the next.
    pub slots: Vec<u32>,
    /// Bricks, part by part.
    pub bricks: Vec<BrickRow>,
    /// Of each brick [`BRICK_WORDS`] times: 32 voxels' bits of its mask, and the number of their first voxel.
    pub words: Vec<[u32; 2]>,
    /// First element of each voxel, and the end.
    pub first_elements: Vec<u32>,
    /// Elements, voxel by voxel.
    pub elements: Vec<ElementRow>,
    /// Their glows.
    pub glows: Vec<Glow>,
    /// Levels that have bricks, a bit each.
    pub levels: u32,
    /// Levels above 0 that have elements of surfaces without elements below, a bit each.
    pub finest: u32,
    /// Least tick of all bricks' box.
    pub low: IVec3,
    /// Its end: beyond the greatest tick along each axis.
    pub high: IVec3,
}

impl VoxelTable {
    /// Joins parts that have come, with the patches of their bake.
    pub fn of_bake<'a>(
        parts: impl Iterator<Item = &'a VoxelPart> + Clone,
        patches: &PatchTable,
    ) -> Result<Self, Inconsistent> {
        let mut table = Self::join(parts, |key| patches.number(key))?;
        dark::yield_to_lit(&mut table, |patch| patches.is_dark(patch));
        Ok(table)
    }

    /// Joins parts that have come; `patch_of` says the number of a patch, see [`patch_numbers`].
    pub fn join<'a>(
        parts: impl Iterator<Item = &'a VoxelPart> + Clone,
        patch_of: impl Fn(PatchKey) -> Option<u32>,
    ) -> Result<Self, Inconsistent> {
        let bricks: usize = parts.clone().map(|part| part.bricks.len()).sum();
        let mut table = Self {
            voxel_m: parts.clone().next().map_or(1.0, |part| part.voxel_m),
            slots: vec![NO_BRICK; (2 * bricks).next_power_of_two()],
            first_elements: vec![0],
            low: IVec3::MAX,
            high: IVec3::MIN,
            ..Self::default()
        };
        for (index, part) in parts.enumerate() {
            let named = |problem| Inconsistent::new(format!("voxels {index}"), problem);
            table.push(part, &patch_of).map_err(named)?;
        }
        Ok(if table.bricks.is_empty() { Self { voxel_m: table.voxel_m, ..Self::default() } } else { table })
    }

    /// Bricks.
    pub fn len(&self) -> usize {
        self.bricks.len()
    }

    /// There are none.
    pub fn is_empty(&self) -> bool {
        self.bricks.is_empty()
    }

    /// The coarsest level that has bricks.
    pub fn top_level(&self) -> u32 {
        self.levels.checked_ilog2().unwrap_or(0)
    }

    /// Whether a tick lies in the box of all bricks.
    pub fn holds(&self, tick: IVec3) -> bool {
        tick.cmpge(self.low).all() && tick.cmplt(self.high).all()
    }

    /// The brick of a cell on the lattice of a level's bricks.
    pub fn brick(&self, level: u32, cell: IVec3) -> Option<u32> {
        if self.levels >> level & 1 == 0 {
            return None;
        }
        let brick = self.slots[self.slot(BrickRow { cell: cell.to_array(), level })];
        (brick != NO_BRICK).then_some(brick)
    }

    /// Whether a brick has no voxel in one eighth of it, which a brick of the level below would fill; 0 or 1 along each axis.
    pub fn is_bare(&self, brick: u32, eighth: IVec3) -> bool {
        let columns = if eighth.x == 0 { 0x0f0f_0f0f } else { 0xf0f0_f0f0 };
        let first = BRICK_WORDS * brick as usize + (8 * eighth.z + eighth.y) as usize;
        (0..4).all(|z| self.words[first + 2 * z][0] & columns == 0)
    }

    /// How often a voxel that holds nothing can be doubled, up to twice, on the lattices of 2³ and 4³ voxels, for a box that holds nothing.
    pub fn bare_around(&self, brick: u32, voxel: IVec3) -> u32 {
        if self.is_bare(brick, voxel >> 2 & 1) {
            return 2;
        }
        let [x, y, z] = (voxel & 6).to_array();
        let first = BRICK_WORDS * brick as usize + (2 * z + (y >> 2)) as usize;
        let square = 0x0303 << (x + 8 * (y & 3));
        u32::from((self.words[first][0] | self.words[first + 2][0]) & square == 0)
    }

    /// Voxel of a place in a brick, see [`super::place_in_brick`]; none where it holds nothing.
    pub fn voxel(&self, brick: u32, place: u16) -> Option<u32> {
        let [mask, first] = self.words[BRICK_WORDS * brick as usize + usize::from(place >> 5)];
        let bit = 1 << (place & 31);
        (mask & bit != 0).then(|| first + (mask & (bit - 1)).count_ones())
    }

    /// The slot of a brick, or the one that it would have.
    fn slot(&self, row: BrickRow) -> usize {
        let last = self.slots.len() - 1;
        let mut slot = brick_hash(row) as usize & last;
        while self.slots[slot] != NO_BRICK && self.bricks[self.slots[slot] as usize] != row {
            slot = (slot + 1) & last;
        }
        slot
    }

    fn push(&mut self, part: &VoxelPart, patch_of: &impl Fn(PatchKey) -> Option<u32>) -> Result<(), String> {
        let (own_m, voxel_m) = (part.voxel_m, self.voxel_m);
        if own_m != voxel_m || !(voxel_m > 0.0 && voxel_m.is_finite()) {
            return Err(format!("its voxels have sides of {own_m} m, others of {voxel_m} m"));
        }
        let glows = self.glows.len();
        self.glows.extend(&part.glows);
        if self.glows.len() >= GLOW_MARK as usize {
            return Err(format!("elements emit in more than {GLOW_MARK} ways"));
        }
        for brick in &part.bricks {
            let named =
                |problem| format!("brick {} of level {}: {problem}", brick.key.cell(), brick.key.level);
            let voxel_m = self.voxel_m * (1_u32 << brick.key.level.min(LEVELS_MAX)) as f32;
            let row = |element: &Element| {
                let patch = element.patch.map_or(Ok(DARK_PATCH), |key| {
                    patch_of(key)
                        .ok_or_else(|| format!("an element of patch {:016x}, which is unknown", key.0))
                })?;
                if usize::from(element.glow) > part.glows.len() {
                    return Err(format!("an element of glow {}", element.glow));
                }
                Ok(element_row(element, patch, glows, voxel_m))
            };
            self.place(brick.key).and_then(|()| self.fill(brick, row)).map_err(named)?;
        }
        Ok(())
    }

    /// Adds a brick's place.
    fn place(&mut self, key: BrickKey) -> Result<(), String> {
        let (level, cell) = (key.level, key.cell());
        if level >= LEVELS_MAX {
            return Err(format!("there are {LEVELS_MAX} levels at most"));
        }
        let end = IVec3::splat(BRICKS_MAX >> level);
        if !(cell.cmpge(-end).all() && cell.cmplt(end).all()) {
            return Err(format!("it lies farther out than {end}"));
        }
        let row = BrickRow { cell: cell.to_array(), level };
        let slot = self.slot(row);
        if self.slots[slot] != NO_BRICK {
            return Err("it is there twice".to_owned());
        }
        self.slots[slot] = self.bricks.len() as u32;
        self.bricks.push(row);
        self.levels |= 1 << level;
        self.low = self.low.min(cell << (level + BRICK_SIZE));
        self.high = self.high.max((cell + 1) << (level + BRICK_SIZE));
        Ok(())
    }

    /// Adds its mask, voxels and elements.
    fn fill(
        &mut self,
        brick: &Brick,
        row: impl Fn(&Element) -> Result<ElementRow, String>,
    ) -> Result<(), String> {
        let mut words = [[0_u32, self.first_elements.len() as u32 - 1]; BRICK_WORDS];
        let mut end = self.elements.len() as u32;
        let mut least = 0;
        for voxel in &brick.voxels {
            if voxel.place < least || usize::from(voxel.place) >= 32 * BRICK_WORDS || voxel.elements == 0 {
                return Err(format!("voxel {} of {} elements", voxel.place, voxel.elements));
            }
            least = voxel.place + 1;
            words[usize::from(voxel.place >> 5)][0] |= 1 << (voxel.place & 31);
            end += u32::from(voxel.elements);
            self.first_elements.push(end);
        }
        for word in 1..BRICK_WORDS {
            words[word][1] = words[word - 1][1] + words[word - 1][0].count_ones();
        }
        self.words.extend(words);
        for element in &brick.elements {
            self.elements.push(row(element)?);
            self.finest |= u32::from(element.is_finest && brick.key.level > 0) << brick.key.level;
        }
        match end as usize == self.elements.len() {
            true => Ok(()),
            false => Err(format!("its voxels do not have its {} elements", brick.elements.len())),
        }
    }
}

fn element_row(element: &Element, patch: u32, glows: usize, voxel_m: f32) -> ElementRow {
    let [x, y] = element.normal.0.map(|at| u32::from(at as u16));
    let glow = if element.glow == 0 { 0 } else { glows as u32 + u32::from(element.glow) };
    let flag = |is: bool, bit: u32| if is { bit } else { 0 };
    ElementRow {
        normal: x | y << 16,
        height_m: element.height_m(voxel_m),
        bits: [element.bits as u32, (element.bits >> 32) as u32],
        patch_number: patch,
        marks: glow | flag(element.is_backed, IS_BACKED) | flag(element.is_finest, IS_FINEST),
    }
}

/// Hash of a brick's place: each number times an odd constant, all combined by xor, then the finaliser of MurmurHash3. The lower bits
/// choose the slot.
pub fn brick_hash(row: BrickRow) -> u32 {
    let [x, y, z] = row.cell.map(|at| at as u32);
    mixed(
        x.wrapping_mul(0x8da6_b343)
            ^ y.wrapping_mul(0xd816_3841)
            ^ z.wrapping_mul(0xcb1a_b31f)
            ^ row.level.wrapping_mul(0x9e37_79b9),
    )
}

/// Mixes 32 bits so that every input bit reaches every output bit: the finaliser of MurmurHash3.
pub fn mixed(value: u32) -> u32 {
    let value = (value ^ value >> 16).wrapping_mul(0x85eb_ca6b);
    let value = (value ^ value >> 13).wrapping_mul(0xc2b2_ae35);
    value ^ value >> 16
}

/// Number of each patch by its key: its place in the set, which must ascend by key.
pub fn patch_numbers(set: &PatchSet) -> Result<impl Fn(PatchKey) -> Option<u32>, Inconsistent> {
    if let Some(pair) = set.patches.windows(2).find(|pair| pair[0].key >= pair[1].key) {
        let problem = format!("{:016x} follows {:016x}", pair[1].key.0, pair[0].key.0);
        return Err(Inconsistent::new("patches", problem));
    }
    Ok(|key| {
        let place = set.patches.binary_search_by_key(&key, |patch| patch.key);
        place.ok().map(|place| place as u32)
    })
}
