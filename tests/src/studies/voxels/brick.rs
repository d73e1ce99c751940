//! Bricks: 3³ corners of the 2³ voxels of a node, read trilinearly.

use glam::{IVec3, Vec3};

use super::Manner;
use super::corner::Corner;
use super::tree::Tree;

/// Corners along a side of a brick.
pub const CORNERS: usize = 3;
/// Corners of a brick.
pub const BRICK: usize = CORNERS * CORNERS * CORNERS;

/// Corners of a node, x fastest.
pub type Brick = [Corner; BRICK];

/// Bricks of all levels, each in the order of the tree's nodes.
pub type Levels = Vec<Vec<Brick>>;

/// Place of a corner in its brick.
pub fn place(corner: IVec3) -> usize {
    (corner.x + 3 * (corner.y + 3 * corner.z)) as usize
}

/// Corners of a brick in their order.
pub fn corners() -> impl Iterator<Item = IVec3> {
    (0..BRICK as i32).map(|at| IVec3::new(at % 3, at / 3 % 3, at / 9))
}

/// The corner of a level's lattice, from any brick that has it and that `is_read`.
pub fn at_lattice(
    tree: &Tree,
    (bricks, level): (&[Brick], usize),
    at: IVec3,
    is_read: impl Fn(IVec3) -> bool,
) -> Option<Corner> {
    let own = at.div_euclid(IVec3::splat(2));
    (0..8).find_map(|side| {
        // On faces between nodes the lower one has it as its last.
        let cell = own - IVec3::new(side & 1, side >> 1 & 1, side >> 2);
        let inner = at - 2 * cell;
        let node = (inner.max_element() <= 2 && is_read(cell)).then(|| tree.find(level, cell))??;
        Some(bricks[node][place(inner)])
    })
}

/// Values at a point, between the eight corners around it. As written all are of the brick that the point lies in, and nothing is where it is missing; mended each is
/// read from any brick that has it.
pub fn trilinear(tree: &Tree, levels: &Levels, level: usize, point_m: Vec3, manner: Manner) -> Corner {
    let side_m = tree.cube.voxel_m() * (1u32 << level) as f32;
    let at = (point_m - tree.cube.low_m) / side_m;
    let first = at.floor();
    let share = at - first;
    let cell = first.as_ivec3().div_euclid(IVec3::splat(2));
    let own = tree.find(level, cell).map(|node| &levels[level][node]);
    if own.is_none() && manner == Manner::Written {
        return Corner::default();
    }
    let corner = |side: i32| {
        let step = IVec3::new(side & 1, side >> 1 & 1, side >> 2);
        let weights = Vec3::select(step.cmpeq(IVec3::ONE), share, 1.0 - share);
        let at = first.as_ivec3() + step;
        let read = match own {
            Some(brick) => brick[place(at - 2 * cell)],
            None => at_lattice(tree, (&levels[level], level), at, |_| true).unwrap_or_default(),
        };
        (read, weights.element_product())
    };
    let read: [(Corner, f32); 8] = std::array::from_fn(|side| corner(side as i32));
    Corner::sum(read.iter().map(|(corner, weight)| (corner, *weight)))
}

/// Values at a point of voxels of any size from the finest on, between two levels.
pub fn quadrilinear(tree: &Tree, levels: &Levels, size_m: f32, point_m: Vec3, manner: Manner) -> Corner {
    let last = (levels.len() - 1) as f32;
    let level = (size_m / tree.cube.voxel_m()).log2().clamp(0.0, last);
    let of = |level: f32| trilinear(tree, levels, level as usize, point_m, manner);
    let (fine, share) = (level.floor(), level.fract());
    if share == 0.0 { of(fine) } else { of(fine).between(&of(fine + 1.0), share) }
}
