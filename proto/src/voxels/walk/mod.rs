//! Walks: which element a ray or a narrow cone meets first.
//!
//! ```text
//! ℓ = ⌊log₂ max(1, 2κτl/h₀)⌋, κ = ¼      level at length l, τ the tangent of the half angle
//! candidates of x along ω:
//!     n_e·ω < 0 and n_e·x > d_e           the patch's side, seen from before
//!     n_e·ω > 0 and n_e·x < d_e           its dark other side, if it has one
//!     unless |n_e·x − d_e| < h/50 and |n_e·n| > 0.9, as then the start lies on it
//! ```
//! *We differ:* such an element of the start's own side is a candidate where n_e·ω < −1/256, as its sheet bends towards the walk there. Without
//! that, one walk in 1400 that starts on a sphere of five voxels leaves it through the nearest crease.
//!
//! A back that reaches up to the start's own sheet and ends there, as that of the next face of a box does, is no candidate in sub-voxels that the
//! plane of that sheet cuts: the walk is before the sheet, and so beside the back. It ends there if two sub-voxels farther, before the sheet, its
//! plane holds nothing of it.
//!
//! The first sub-voxel along the way that a candidate touches ends the walk, where the candidate's plane is, held within the sub-voxel. Where
//! candidates of several patches touch it, the walk goes on there a level finer. Surfaces without elements at the finer levels have walks of
//! their own, each at their finest level, as far as the main walk is at finer ones; the nearest hit wins.
//!
//! A brick that has not come is answered for by the coarser one around it. Bricks that are empty at some level have nothing at finer ones, but
//! for such surfaces; so the widest empty box is passed at once.
//!
//! All numbers have 32 bits, and levels come from products alone, not from log₂, so that shaders can take the same steps.

mod candidates;
mod path;

#[cfg(test)]
mod tests;

use glam::{IVec3, Vec3};

use self::candidates::{Line, Nearest, nearer};
use self::path::{Path, Place};
use super::content::{SUBS, place_in_brick, sub_in_voxel};
use super::table::{BRICK_SIZE, DARK_PATCH, ElementRow, NO_BRICK, VOXEL_SIZE, VoxelTable};

/// Steps at most; a walk that takes more ends in the dark. Along a wall 1024 voxels long, which it meets nowhere, a walk takes 4 steps a voxel
/// and axis, 12 288.
pub const STEPS_MAX: u32 = 1 << 14;
/// κ: voxels are at most as wide as this share of the cone, and more than half as wide.
const KAPPA: f32 = 0.25;
/// Least tangent; the level of a ray's walk rises nowhere.
const TANGENT_MIN: f32 = 1e-20;
/// Voxels of a level along the widest box that a walk at finer levels passes in one step, at most: the diagonal of a brick of the level below,
/// 4√3.
const STEP_VOXELS: f32 = 7.0;

/// Sub-voxels before the start's sheet at which a back that stands on it goes on.
const BESIDE_SUBS: f32 = 2.0;
/// Least square of the sine between a back and the start's sheet: flatter ones do not end at it.
const BESIDE_RISE: f32 = 0.1;
/// Least cosine between normals of a back and what it goes on as.
const BESIDE_COSINE: f32 = 0.9;

/// Stands for the element of a walk that was too long.
pub const NO_ELEMENT: u32 = u32::MAX;

/// Start of walks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// A point of a surface, or in free space, in metres.
    pub at_m: Vec3,
    /// The surface's normal; `None` in free space.
    pub normal: Option<Vec3>,
}

impl Start {
    /// On a surface.
    pub fn on(at_m: Vec3, normal: Vec3) -> Self {
        Self { at_m, normal: Some(normal) }
    }

    /// In free space.
    pub fn free(at_m: Vec3) -> Self {
        Self { at_m, normal: None }
    }
}

/// End of a walk at an element.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WalkHit {
    /// The element, or [`NO_ELEMENT`] where a walk took more than [`STEPS_MAX`] steps.
    pub element: u32,
    /// Its patch, or [`DARK_PATCH`].
    pub patch: u32,
    /// Length of the walk in metres.
    pub t_m: f32,
    /// The element's dark other side is met.
    pub is_back: bool,
}

/// End of a walk along a direction of length 1, of a cone whose half angle has that tangent; `None`: the sky.
pub fn walk(table: &VoxelTable, start: &Start, direction: Vec3, tangent: f32) -> Option<WalkHit> {
    walk_within(table, start, direction, tangent, f32::INFINITY)
}

/// Likewise within a length in metres.
pub fn walk_within(
    table: &VoxelTable,
    start: &Start,
    direction: Vec3,
    tangent: f32,
    reach_m: f32,
) -> Option<WalkHit> {
    let line = Line::new(start, direction, table.voxel_m);
    if table.is_empty() || !line.from_m.is_finite() || !direction.is_finite() {
        return None;
    }
    let path = Path::new(line.from_m, direction, table.voxel_m);
    let place = path.enter(table)?;
    let top = table.top_level();
    // Length at which the level rises from 0 to 1; it doubles with each level. Unlike log₂, products are alike on all machines.
    let rise_m = table.voxel_m / (KAPPA * tangent.max(TANGENT_MIN));
    let main = Walk::new(table, &line, &path, place, top);
    let mut met = Walk { rise_m, limit_m: reach_m, ..main }.end();
    for level in 1..=top {
        if table.finest >> level & 1 == 1 {
            let scale = (1_u32 << level) as f32;
            let until_m = 0.5 * scale * rise_m + STEP_VOXELS * scale * table.voxel_m;
            let limit_m = met.map_or(reach_m, |hit| hit.t_m).min(until_m);
            let own = Walk { level, wanted: level, top: level, finest_alone: true, limit_m, ..main };
            met = nearer(met, own.end());
        }
    }
    met.filter(|hit| hit.t_m <= reach_m)
}

/// The brick that answers for a box, or none.
#[derive(Clone, Copy, Debug, Default)]
struct Held {
    /// Level that was asked for.
    wanted: u32,
    /// Level that answers.
    level: u32,
    /// The box: its size, and its cell on the lattice of that size.
    size: u32,
    cell: IVec3,
    /// The brick, or [`NO_BRICK`] where the box is empty.
    brick: u32,
}

/// Candidates in a voxel.
#[derive(Clone, Copy, Debug, Default)]
struct Inside {
    /// Level of the voxel, its cell, and side and middle in metres.
    level: u32,
    cell: IVec3,
    side_m: f32,
    middle_m: Vec3,
    /// Its elements.
    first: u32,
    end: u32,
    /// Sub-voxels that candidates among them touch.
    bits: [u32; 2],
}

/// State of a walk.
#[derive(Clone, Copy, Debug)]
struct Walk<'a> {
    table: &'a VoxelTable,
    line: &'a Line,
    path: &'a Path,
    place: Place,
    /// Level of the cone's width, and the length at which it rises.
    wanted: u32,
    rise_m: f32,
    /// The coarsest level.
    top: u32,
    /// Level that it looks at: finer than `wanted` within a sub-voxel of several patches.
    level: u32,
    /// Only surfaces count that have no elements below the level.
    finest_alone: bool,
    /// Length at which it ends, with what it has met so far.
    limit_m: f32,
    met: Option<WalkHit>,
    /// Boxes around the place; each is that of a box, and found anew outside.
    held: Option<Held>,
    inside: Option<Inside>,
}

impl<'a> Walk<'a> {
    fn new(table: &'a VoxelTable, line: &'a Line, path: &'a Path, place: Place, top: u32) -> Self {
        Self {
            table,
            line,
            path,
            place,
            wanted: 0,
            rise_m: f32::INFINITY,
            top,
            level: 0,
            finest_alone: false,
            limit_m: f32::INFINITY,
            met: None,
            held: None,
            inside: None,
        }
    }

    /// Its end.
    fn end(mut self) -> Option<WalkHit> {
        for _ in 0..STEPS_MAX {
            if self.place.t_m >= self.limit_m || !self.table.holds(self.place.tick) {
                return self.met;
            }
            if let Some(hit) = self.step() {
                return nearer(self.met, Some(hit));
            }
        }
        let lost = WalkHit { element: NO_ELEMENT, patch: DARK_PATCH, t_m: self.place.t_m, is_back: false };
        nearer(self.met, Some(lost))
    }

    /// Passes one box, or goes a level finer where it is.
    fn step(&mut self) -> Option<WalkHit> {
        self.rise();
        let tick = self.place.tick;
        let held = match self.held {
            Some(held) if held.wanted == self.level && tick >> held.size == held.cell => held,
            _ => *self.held.insert(self.find()),
        };
        if held.brick == NO_BRICK {
            self.leave(held.size);
            return None;
        }
        let size = held.level + VOXEL_SIZE;
        let inside = match self.inside {
            Some(inside) if inside.level == held.level && tick >> size == inside.cell => inside,
            _ => *self.inside.insert(self.look(held)),
        };
        if inside.bits == [0, 0] {
            let is_empty = inside.first == inside.end;
            let doubled = if is_empty { self.table.bare_around(held.brick, inside.cell) } else { 0 };
            self.leave(size + doubled);
            return None;
        }
        let sub = sub_in_voxel(tick >> held.level);
        if !has(inside.bits, sub) {
            self.leave(held.level);
            return None;
        }
        self.meet(held, &inside, sub)
    }

    /// Takes the level of the cone's width.
    fn rise(&mut self) {
        while self.wanted < self.top && self.place.t_m >= self.rise_m {
            self.level += u32::from(self.level == self.wanted);
            self.wanted += 1;
            self.rise_m *= 2.0;
        }
    }

    /// Leaves a box. Outside sub-voxels of several patches the level is that of the cone's width again.
    fn leave(&mut self, size: u32) {
        let before = self.place.tick;
        self.place = self.path.leave(self.place, size);
        while self.level < self.wanted && before >> (self.level + 1) != self.place.tick >> (self.level + 1) {
            self.level += 1;
        }
    }

    /// The brick around: at the level, or the finest coarser one. Where that is bare as far as the brick of the level below it would reach,
    /// that one is empty; otherwise it has not come, and the coarser one stands for it.
    fn find(&self) -> Held {
        let (tick, wanted) = (self.place.tick, self.level);
        for level in wanted..=self.top {
            let size = level + BRICK_SIZE;
            let Some(brick) = self.table.brick(level, tick >> size) else { continue };
            if level == wanted {
                return Held { wanted, level, size, cell: tick >> size, brick };
            }
            let cell = tick >> (size - 1);
            let brick = if self.table.is_bare(brick, cell & 1) { NO_BRICK } else { brick };
            return Held { wanted, level, size: size - 1, cell, brick };
        }
        let size = self.top + BRICK_SIZE;
        Held { wanted, level: self.top, size, cell: tick >> size, brick: NO_BRICK }
    }

    /// Candidates in the voxel around.
    fn look(&self, held: Held) -> Inside {
        let level = held.level;
        let cell = self.place.tick >> (level + VOXEL_SIZE);
        let side_m = self.table.voxel_m * (1_u32 << level) as f32;
        let middle_m = (cell.as_vec3() + 0.5) * side_m;
        let mut inside = Inside { level, cell, side_m, middle_m, ..Inside::default() };
        let Some(voxel) = self.table.voxel(held.brick, place_in_brick(cell)) else { return inside };
        inside.first = self.table.first_elements[voxel as usize];
        inside.end = self.table.first_elements[voxel as usize + 1];
        for element in &self.table.elements[inside.first as usize..inside.end as usize] {
            if self.counts(element) && self.line.candidate(element, middle_m, side_m).is_some() {
                inside.bits[0] |= element.bits[0];
                inside.bits[1] |= element.bits[1];
            }
        }
        inside
    }

    fn counts(&self, element: &ElementRow) -> bool {
        !self.finest_alone || element.is_finest()
    }

    /// Ends at the nearest of the candidates that touch the sub-voxel around. Where they are of several patches and there are finer ones, it goes a
    /// level finer instead, having met those at most that have no finer ones.
    fn meet(&mut self, held: Held, inside: &Inside, sub: u32) -> Option<WalkHit> {
        let within_m = [self.place.t_m, self.path.exit(self.place, held.level).t_m];
        let [mut all, mut finest] = [Nearest::default(); 2];
        let mut has_finer = false;
        for number in inside.first..inside.end {
            let element = &self.table.elements[number as usize];
            if !has(element.bits, sub) || !self.counts(element) {
                continue;
            }
            let found = self.line.candidate(element, inside.middle_m, inside.side_m);
            let Some((t_m, is_back)) = found else { continue };
            if is_back && self.is_beside(held.level, element, t_m) {
                continue;
            }
            let patch = if is_back { DARK_PATCH } else { element.patch_number };
            let hit = WalkHit { element: number, patch, t_m, is_back };
            all.add(hit, within_m);
            if element.is_finest() {
                finest.add(hit, within_m);
            } else {
                has_finer = true;
            }
        }
        if !(all.is_mixed && has_finer && self.is_finer_there(held)) {
            if all.hit.is_none() {
                self.leave(held.level);
            }
            return all.hit;
        }
        self.level = held.level - 1;
        self.met = nearer(self.met, finest.hit);
        self.limit_m = self.met.map_or(self.limit_m, |met| met.t_m.min(self.limit_m));
        None
    }

    /// The back of an element, whose plane the walk crosses at a length, ends at the start's own sheet: the walk goes by beside it.
    fn is_beside(&self, level: u32, element: &ElementRow, t_m: f32) -> bool {
        let (own, normal) = (self.line.normal, element.normal());
        let sub_m = self.table.voxel_m / SUBS as f32 * (1_u32 << level) as f32;
        let middle_m = ((self.place.tick >> level).as_vec3() + 0.5) * sub_m;
        let reaches = 0.5 * sub_m * own.abs().element_sum();
        // Along the back, away from the sheet.
        let up = own - normal * own.dot(normal);
        let rise = up.length_squared();
        if own == Vec3::ZERO || own.dot(middle_m - self.line.from_m) > reaches || rise < BESIDE_RISE {
            return false;
        }
        let on_m = self.line.from_m + self.line.direction * t_m + up * (BESIDE_SUBS * sub_m / rise);
        let tick = (on_m * (SUBS as f32 / self.table.voxel_m)).floor().as_ivec3();
        let Some(brick) = self.table.brick(level, tick >> (level + BRICK_SIZE)) else { return true };
        let place = place_in_brick(tick >> (level + VOXEL_SIZE));
        let Some(voxel) = self.table.voxel(brick, place) else { return true };
        let [first, end] = [0, 1].map(|next| self.table.first_elements[voxel as usize + next] as usize);
        let sub = sub_in_voxel(tick >> level);
        let goes_on = |other: &ElementRow| {
            other.is_backed() && has(other.bits, sub) && other.normal().dot(normal) > BESIDE_COSINE
        };
        !self.table.elements[first..end].iter().any(goes_on)
    }

    /// The brick of the level below is there.
    fn is_finer_there(&self, held: Held) -> bool {
        held.level > 0
            && held.level == held.wanted
            && self.table.brick(held.level - 1, self.place.tick >> (held.level - 1 + BRICK_SIZE)).is_some()
    }
}

/// Whether the bit of a sub-voxel is set.
fn has(bits: [u32; 2], sub: u32) -> bool {
    bits[(sub >> 5) as usize] >> (sub & 31) & 1 == 1
}
