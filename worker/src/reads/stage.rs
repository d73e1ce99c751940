//! The stage of a scene as tasks read it: a digest for each part of it that is not empty.

use std::sync::Arc;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::marks::{Bytes, Mark, Name};
use super::patches;
use super::triangles::Surfaces;
use crate::geometry::Grid;
use crate::lightmap::{CAVITY, Receiver, TILE_TEXELS, World};
use crate::patches::PatchTree;
use crate::task::{Context, TaskError, artefact};

/// Magic of the stage's artefact.
const ARTEFACT_MAGIC: &[u8; 4] = b"LKst";
/// Name under which tasks see it.
pub const STAGE_ARTEFACT: &str = "stage";
/// Least side of a cell in texels.
const CELL_TEXELS_MIN: f32 = 2.0;

/// Digests of a stage's parts.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Stage {
    /// Grid over the scene.
    pub grid: Grid,
    /// Ascending by name.
    marks: Vec<(Name, Mark)>,
}

impl Stage {
    /// The stage of a world with its patches.
    pub fn of_world(world: &World, tree: &PatchTree, surfaces: &Surfaces) -> Self {
        let grid = Grid::over(world.geometry.bounds_m(), CELL_TEXELS_MIN * world.lightmap.texel_m);
        let mut marks = cells(world, surfaces, &grid);
        let leaf_key = leaf_keys(tree);
        let tiles: Vec<(Name, Mark)> = (0..world.tiles.len() as u32)
            .into_par_iter()
            .map(|index| tile(world, tree, &leaf_key, index))
            .collect();
        marks.extend(tiles);
        marks.extend(patches::marks(tree));
        marks.push((Name::extent(), extent(&grid)));
        marks.sort_unstable();
        Self { grid, marks }
    }

    /// The stage among a task's inputs, decoded once per worker.
    pub fn of(context: &Context) -> Result<Arc<Self>, TaskError> {
        context.shared(ARTEFACT_MAGIC, STAGE_ARTEFACT)
    }

    /// The stage as an artefact.
    pub fn encoded(&self) -> Result<Vec<u8>, TaskError> {
        artefact::encode(ARTEFACT_MAGIC, self)
    }

    /// Digest of a part.
    pub fn mark(&self, name: Name) -> Mark {
        let found = self.marks.binary_search_by_key(&name, |(other, _)| *other);
        found.map_or(Mark::default(), |place| self.marks[place].1)
    }
}

fn extent(grid: &Grid) -> Mark {
    let mut bytes = Bytes::default();
    for at in [grid.low, grid.size].map(|at| at.to_array()).as_flattened() {
        bytes.number(u64::from(*at as u32));
    }
    bytes.mark()
}

/// Cells with the triangles that they meet, in the order that decides between equally near ones.
fn cells(world: &World, surfaces: &Surfaces, grid: &Grid) -> Vec<(Name, Mark)> {
    let all = 0..world.geometry.triangles.len() as u32;
    let of_triangle =
        |index: u32| (surfaces.triangle(world, index), grid.cells_of_triangle(world.geometry.corners(index)));
    let found: Vec<(Mark, Vec<usize>)> = all.into_par_iter().map(of_triangle).collect();
    let mut of_cell = vec![Bytes::default(); grid.len()];
    for (mark, cells) in &found {
        cells.iter().for_each(|&cell| {
            of_cell[cell].bytes(mark);
        });
    }
    let filled = of_cell.iter().enumerate().filter(|(_, bytes)| !bytes.is_empty());
    filled.map(|(index, bytes)| (Name::cell(grid.cell(index)), bytes.mark())).collect()
}

/// Key of each leaf.
fn leaf_keys(tree: &PatchTree) -> Vec<u64> {
    let mut keys = vec![0; tree.leaf_starts.len()];
    for patch in tree.patches.iter().filter(|patch| patch.leaf_count == 1) {
        // Of a patch and its only part the part comes later, and is the leaf.
        keys[patch.first_leaf as usize] = patch.key.0;
    }
    keys
}

/// A tile: which receiver stands for each texel, and all that a hit there reads of it.
fn tile(world: &World, tree: &PatchTree, leaf_key: &[u64], index: u32) -> (Name, Mark) {
    let lightmap = &world.lightmap;
    let (block, place) = world.tiles.place(index);
    let table = &lightmap.blocks[block as usize];
    let mut bytes = Bytes::default();
    bytes.number(table.size[0].into()).number(table.size[1].into()).floats(&[table.texel_m]);
    let side = |axis: usize| {
        let first = place[axis] * TILE_TEXELS;
        first..(first + TILE_TEXELS).min(table.size[axis])
    };
    for y in side(1) {
        for x in side(0) {
            let receiver = table.receiver_of_texel[(y * table.size[0] + x) as usize];
            if receiver >= CAVITY {
                bytes.number(receiver.into());
                continue;
            }
            let own = &lightmap.receivers[receiver as usize];
            let at = own.texel.map(u32::from);
            bytes.number(u64::from(at[0]) << 32 | u64::from(at[1]));
            if at == [x, y] {
                add_receiver(&mut bytes, own, world, receiver);
                bytes.number(leaf_key[tree.leaf_of_receiver[receiver as usize] as usize]);
            }
        }
    }
    (Name::tile(table.key, place), bytes.mark())
}

fn add_receiver(bytes: &mut Bytes, own: &Receiver, world: &World, index: u32) {
    bytes.vector(own.position_m).vector(own.face_normal).vector(world.raised_receiver(index));
    bytes.number(u64::from(own.links) << 16 | u64::from(own.coverage));
}
