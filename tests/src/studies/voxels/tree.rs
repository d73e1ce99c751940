//! An octree over a scene's bounding cube, in levels of sorted nodes.
//!
//! The paper has pointers; here a node is found by its cell. Level ℓ has voxels of `h·2^ℓ`, and its nodes are bricks of 2³ of them.

use std::collections::HashMap;

use glam::{IVec3, Vec3};

/// A cube cut into `2^depth` voxels along each side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cube {
    /// Lower corner in metres.
    pub low_m: Vec3,
    /// w_s: side in metres.
    pub side_m: f32,
    /// Depth of the octree.
    pub depth: u32,
}

/// The nodes of all levels.
#[derive(Clone, Debug)]
pub struct Tree {
    /// The cube.
    pub cube: Cube,
    levels: Vec<Level>,
}

#[derive(Clone, Debug, Default)]
struct Level {
    nodes: Vec<IVec3>,
    index: HashMap<IVec3, u32>,
}

impl Cube {
    /// The cube about bounds, a little wider than they are, so that no surface lies on its faces.
    pub fn about([low_m, high_m]: [Vec3; 2], depth: u32) -> Self {
        let side_m = 1.001 * (high_m - low_m).max_element();
        Self { low_m: 0.5 * (low_m + high_m) - 0.5 * side_m, side_m, depth }
    }

    /// h: side of a voxel of the finest level in metres.
    pub fn voxel_m(&self) -> f32 {
        self.side_m / (1u32 << self.depth) as f32
    }

    /// Cell of the voxel that a point lies in; outside of the cube, that of the nearest.
    pub fn voxel_of(&self, point_m: Vec3) -> IVec3 {
        let last = (1 << self.depth) - 1;
        ((point_m - self.low_m) / self.voxel_m()).floor().as_ivec3().clamp(IVec3::ZERO, IVec3::splat(last))
    }

    /// How far a point lies outside, in metres; 0 within.
    pub fn outside_m(&self, point_m: Vec3) -> f32 {
        let beyond = (self.low_m - point_m).max(point_m - self.low_m - self.side_m);
        beyond.max_element().max(0.0)
    }
}

impl Tree {
    /// The tree of some voxels.
    pub fn new(cube: Cube, voxels: impl Iterator<Item = IVec3>) -> Self {
        let mut cells: Vec<IVec3> = voxels.collect();
        let mut levels = Vec::new();
        for _ in 0..cube.depth {
            cells.iter_mut().for_each(|cell| *cell /= 2);
            cells.sort_unstable_by_key(|cell| cell.to_array());
            cells.dedup();
            let index = cells.iter().zip(0..).map(|(cell, at)| (*cell, at)).collect();
            levels.push(Level { nodes: cells.clone(), index });
        }
        Self { cube, levels }
    }

    /// Levels, the finest first.
    pub fn levels(&self) -> usize {
        self.levels.len()
    }

    /// Cells of the nodes of a level.
    pub fn nodes(&self, level: usize) -> &[IVec3] {
        &self.levels[level].nodes
    }

    /// Nodes of all levels.
    pub fn node_count(&self) -> usize {
        self.levels.iter().map(|level| level.nodes.len()).sum()
    }

    /// Number of the node of a cell among those of its level.
    pub fn find(&self, level: usize, cell: IVec3) -> Option<usize> {
        self.levels[level].index.get(&cell).map(|at| *at as usize)
    }
}
