//! From voxels to corners, and from level to level.
//!
//! As written: means within a node, opacity by the largest along its axis, then edges are averaged between neighbours, x, y and z in turn.
//! Mended: all voxels or corners around one count, those of other nodes too, and along an axis they are composited front to back.

use std::time::Instant;

use glam::{IVec3, Vec3};
use rayon::prelude::*;

use super::brick::{BRICK, Brick, Levels, at_lattice, corners, place};
use super::corner::{Corner, towards};
use super::fill::Leaves;
use super::tree::Tree;
use super::{Kind, Manner, Model};

/// Seconds of the steps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FilterTimes {
    /// Voxels to corners of the finest level.
    pub inside_secs: f64,
    /// Corners of a level to those of the next.
    pub up_secs: f64,
    /// Edges between neighbours.
    pub edges_secs: f64,
}

/// The bricks of all levels.
pub fn filtered(tree: &Tree, leaves: &Leaves, kind: Kind) -> (Levels, FilterTimes) {
    let mut times = FilterTimes::default();
    let mut levels: Levels = Vec::new();
    for level in 0..tree.levels() {
        let begun = Instant::now();
        let brick = |cell: &IVec3| -> Brick {
            match levels.last() {
                None => of_voxels(leaves, *cell, kind),
                Some(finer) => of_finer(tree, finer, level, *cell, kind),
            }
        };
        let mut bricks: Vec<Brick> = tree.nodes(level).par_iter().map(brick).collect();
        let secs = begun.elapsed().as_secs_f64();
        *if level == 0 { &mut times.inside_secs } else { &mut times.up_secs } += secs;
        if kind.manner == Manner::Written {
            let begun = Instant::now();
            average_edges(tree, level, &mut bricks);
            times.edges_secs += begun.elapsed().as_secs_f64();
        }
        levels.push(bricks);
    }
    (levels, times)
}

/// Corners of the finest level.
fn of_voxels(leaves: &Leaves, cell: IVec3, kind: Kind) -> Brick {
    let mut brick = [Corner::default(); BRICK];
    for corner in corners() {
        let at = |step: IVec3| leaves.find(2 * cell + corner + step).copied().unwrap_or_default();
        brick[place(corner)] = match kind.manner {
            Manner::Written => {
                let ranges = corner.to_array().map(|along| [i32::from(along > 0), i32::from(along < 2)]);
                let steps: Vec<IVec3> = steps(ranges.map(|[down, up]| -down..up)).collect();
                let found: Vec<Corner> = steps.iter().map(|step| at(*step)).collect();
                Corner::sum(found.iter().map(|voxel| (voxel, 1.0 / found.len() as f32)))
            }
            Manner::Mended => {
                let found: Vec<Corner> = steps([-1..1, -1..1, -1..1]).map(at).collect();
                composited(&found, &[0.5, 0.5], kind.model)
            }
        };
    }
    brick
}

/// Corners of a level from those of the finer one.
fn of_finer(tree: &Tree, finer: &[Brick], level: usize, cell: IVec3, kind: Kind) -> Brick {
    // Corners of the finer level in and around the node, from −1 to 5 along each axis.
    let reach = match kind.manner {
        Manner::Written => 0,
        Manner::Mended => 1,
    };
    let side = 5 + 2 * reach;
    let is_read = |child: IVec3| reach > 0 || child.div_euclid(IVec3::splat(2)) == cell;
    let at = |at: IVec3| at_lattice(tree, (finer, level - 1), 4 * cell + at, is_read).unwrap_or_default();
    let around = -reach..5 + reach;
    let lattice: Vec<Corner> = steps([around.clone(), around.clone(), around]).map(at).collect();
    let read = |at: IVec3| {
        let at = at + reach;
        lattice[(at.x + side * (at.y + side * at.z)) as usize]
    };
    let mut brick = [Corner::default(); BRICK];
    for corner in corners() {
        brick[place(corner)] = match kind.manner {
            Manner::Written => {
                let ranges = corner.to_array().map(|along| -i32::from(along > 0)..1 + i32::from(along < 2));
                let sizes = ranges.clone().map(|range| range.len());
                let found: Vec<Corner> = steps(ranges).map(|step| read(2 * corner + step)).collect();
                largest_along(&found, sizes)
            }
            Manner::Mended => {
                let found: Vec<Corner> =
                    steps([-1..2, -1..2, -1..2]).map(|step| read(2 * corner + step)).collect();
                composited(&found, &[0.5, 1.0, 0.5], kind.model)
            }
        };
    }
    brick
}

/// Places of a box, x fastest.
fn steps([x, y, z]: [std::ops::Range<i32>; 3]) -> impl Iterator<Item = IVec3> {
    z.flat_map(move |z| {
        let x = x.clone();
        y.clone().flat_map(move |y| x.clone().map(move |x| IVec3::new(x, y, z)))
    })
}

/// As written: means, and for opacity along each axis the mean across of the largest along it (§5.4.3).
pub fn largest_along(found: &[Corner], sizes: [usize; 3]) -> Corner {
    let mean = Corner::sum(found.iter().map(|corner| (corner, 1.0 / found.len() as f32)));
    let strides = [1, sizes[0], sizes[0] * sizes[1]];
    let along = |axis: usize| {
        let [j, k] = [(axis + 1) % 3, (axis + 2) % 3];
        let column = |first: usize| {
            let opacities = (0..sizes[axis]).map(|at| found[first + at * strides[axis]].opacity[axis]);
            opacities.fold(0.0, f32::max)
        };
        let firsts = (0..sizes[k]).flat_map(|b| (0..sizes[j]).map(move |a| a * strides[j] + b * strides[k]));
        firsts.map(column).sum::<f32>() / (sizes[j] * sizes[k]) as f32
    };
    Corner { opacity: Vec3::new(along(0), along(1), along(2)), ..mean }
}

/// Mended: `1 − Π (1−α)^w` along each axis, the mean across; light towards an axis front to back, other values by means.
pub fn composited(found: &[Corner], weights: &[f32], model: Model) -> Corner {
    let side = weights.len();
    let total: f32 = weights.iter().sum();
    let shares: Vec<f32> = weights.iter().map(|weight| weight / total).collect();
    let strides = [1, side, side * side];
    let share = |at: usize| shares[at % side] * shares[at / side % side] * shares[at / (side * side)];
    let mut mean = Corner::sum(found.iter().zip(0..).map(|(corner, at)| (corner, share(at))));
    for axis in 0..3 {
        let [j, k] = [(axis + 1) % 3, (axis + 2) % 3];
        let mut opacity = 0.0;
        let mut light = [Vec3::ZERO; 2];
        for (a, b) in (0..side).flat_map(|b| (0..side).map(move |a| (a, b))) {
            let column = |at: usize| &found[a * strides[j] + b * strides[k] + at * strides[axis]];
            for is_up in [false, true] {
                let mut left = shares[a] * shares[b];
                for step in 0..side {
                    // Surfaces that face up the axis have the upper end in front.
                    let at = if is_up { side - 1 - step } else { step };
                    let corner = column(at);
                    let stopped = 1.0 - (1.0 - corner.opacity[axis].min(1.0)).powf(weights[at]);
                    if stopped > 0.0 {
                        let radiance = corner.values[towards(axis, is_up)] / corner.opacity[axis];
                        light[usize::from(is_up)] += left * stopped * radiance;
                        left *= 1.0 - stopped;
                    }
                }
                if is_up {
                    opacity += shares[a] * shares[b] - left;
                }
            }
        }
        mean.opacity[axis] = opacity;
        if model == Model::Axes {
            mean.values[towards(axis, false)] = light[0];
            mean.values[towards(axis, true)] = light[1];
        }
    }
    mean
}

/// Faces that neighbours share get the mean of both (§5.4.2).
pub fn average_edges(tree: &Tree, level: usize, bricks: &mut [Brick]) {
    for axis in [IVec3::X, IVec3::Y, IVec3::Z] {
        for (node, cell) in tree.nodes(level).iter().enumerate() {
            let Some(below) = tree.find(level, cell - axis) else { continue };
            for corner in corners().filter(|corner| corner.dot(axis) == 0) {
                let (own, other) = (place(corner), place(corner + 2 * axis));
                let mean = bricks[node][own].between(&bricks[below][other], 0.5);
                bricks[node][own] = mean;
                bricks[below][other] = mean;
            }
        }
    }
}
