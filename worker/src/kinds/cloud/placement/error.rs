//! Placement by error: the distance between probes is less where transport between them would err more, whatever the light.
//!
//! Cells of an octree, from four distances between probes to a quarter, stand for one probe each. They are split, those that err most first,
//! until there are as many probes as even placement has; then places of each cell are thinned as even ones are, by the cell's size.
//!
//! A cell errs by `e² = Σ_x Σ_j Σ_s D² / Σ_x Σ_j Σ_s T²` over 8 places x in it, D = Σ_p w_p T_p − T(x) between its corners p that see x, less
//! chance: products of even and odd rays take the place of squares. *We differ:* columns s are parts of surfaces that lie in cubes of h, and
//! parts of the sky, all of one variance: patches are not needed for a survey. The error counts times the cell's volume, as far as it is
//! free: what is split first takes most off the mean over all space.

use std::collections::{BTreeSet, HashMap};

use glam::{IVec3, Vec3};
use lightkiln_proto::harmonics::relight_direction;
use lightkiln_proto::kinds::field::{PROBE_ROWS, ProbeKey};
use rayon::prelude::*;

use super::even::{Stand, ordered};
use super::{Account, CLEARANCE, Ground, PLACES};
use crate::geometry::lattice::{cell_of, key_of};
use crate::kinds::field::{Place, irradiance_weights, place, uniform_turn};
use crate::rays::sampling::{Sequence, seed_of};
use crate::task::Cancelled;

/// Size of the largest cells over the distance between probes.
const LARGEST: i32 = 4;
/// The distance between probes over the size of the smallest cells.
const SMALLEST: i32 = 4;
/// Rays of a place.
const RAYS: u32 = 128;
/// Cells of which one is split before errors are looked at again.
const BATCH: usize = 16;

/// A cell: its least corner and its size in steps of the lattice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Cell {
    size: i32,
    low: [i32; 3],
}

impl Cell {
    fn children(self) -> impl Iterator<Item = Self> {
        let size = self.size / 2;
        (0..8).map(move |child| Self {
            size,
            low: (IVec3::from(self.low) + size * IVec3::new(child & 1, child >> 1 & 1, child >> 2))
                .to_array(),
        })
    }

    fn corners(self) -> [IVec3; 8] {
        let low = IVec3::from(self.low);
        std::array::from_fn(|at| {
            let at = at as i32;
            low + self.size * IVec3::new(at & 1, at >> 1 & 1, at >> 2)
        })
    }

    /// Seed of its places.
    fn seed(self) -> u64 {
        let [x, y, z] = self.low.map(|along| along as u64);
        seed_of(&[self.size as u64, x, y, z, 15])
    }
}

/// A cell with its error.
#[derive(Clone, Copy, Debug)]
struct Judged {
    cell: Cell,
    /// e².
    error: f32,
    /// Share of its volume that is free.
    share: f32,
}

impl Judged {
    /// Urgency: e² times the free volume; the cell with the most is split first.
    fn urgency(&self) -> f32 {
        self.error * self.share * (self.cell.size as f32).powi(3)
    }
}

/// Places that may become probes, in their order, and the distances that are to be between them.
pub fn places(ground: &Ground<'_>, account: &mut Account) -> Result<Vec<Stand>, Cancelled> {
    let leaves = leaves(ground)?;
    let steps = ground.steps();
    let mut size = steps * LARGEST;
    while size >= steps / SMALLEST {
        let count = leaves.iter().filter(|leaf| leaf.size == size).count() as u64;
        account.push((format!("cells_of_{size}_twelfths"), count));
        size /= 2;
    }
    let of_leaf = |leaf: &Cell| {
        let (low, apart) = (IVec3::from(leaf.low), leaf.size / PLACES);
        let spacing_m = leaf.size as f32 * ground.step_m;
        (0..PLACES.pow(3)).filter_map(move |at| {
            let at = IVec3::new(at % PLACES, at / PLACES % PLACES, at / (PLACES * PLACES));
            Some(Stand { key: ProbeKey::of(low + apart * at)?, spacing_m })
        })
    };
    let stands: Vec<Stand> = leaves.iter().flat_map(of_leaf).collect();
    ordered(ground, stands.into_par_iter())
}

/// Leaves of the octree, in order.
fn leaves(ground: &Ground<'_>) -> Result<Vec<Cell>, Cancelled> {
    let steps = ground.steps();
    let mut judge = Judge { ground, corners: HashMap::new() };
    let roots = judge.judged(&roots(ground, LARGEST * steps))?;
    let even: Vec<Cell> =
        roots.iter().flat_map(|root| root.cell.children()).flat_map(Cell::children).collect();
    let share = |cell: &Cell| {
        ground.progress.check()?;
        Ok(ground.progress.casting(|| free_places(ground, *cell).len()) as f32 / 8.0)
    };
    let wanted: Vec<f32> = even.par_iter().map(share).collect::<Result<_, Cancelled>>()?;
    split(roots, (wanted.iter().sum(), steps / SMALLEST), |cells| judge.judged(cells))
}

/// Splits cells until there are as many probes as wanted, or all are of the least size.
fn split(
    mut open: Vec<Judged>,
    (wanted, least): (f32, i32),
    mut judged: impl FnMut(&[Cell]) -> Result<Vec<Judged>, Cancelled>,
) -> Result<Vec<Cell>, Cancelled> {
    let mut done: Vec<Cell> = Vec::new();
    let mut count: f32 = open.iter().map(|of| of.share).sum();
    while count < wanted {
        let (leaves, mut splits): (Vec<Judged>, Vec<Judged>) =
            open.into_iter().partition(|of| of.cell.size <= least || of.share == 0.0);
        done.extend(leaves.iter().map(|of| of.cell));
        splits.sort_by(|a, b| b.urgency().total_cmp(&a.urgency()).then(a.cell.cmp(&b.cell)));
        let most = splits.len().div_ceil(BATCH).min(((wanted - count) / 7.0).ceil() as usize);
        open = splits.split_off(most);
        if splits.is_empty() {
            break;
        }
        let children: Vec<Cell> = splits.iter().flat_map(|of| of.cell.children()).collect();
        let children = judged(&children)?;
        count +=
            children.iter().map(|of| of.share).sum::<f32>() - splits.iter().map(|of| of.share).sum::<f32>();
        open.extend(children);
    }
    done.extend(open.iter().map(|of| of.cell));
    done.sort_unstable();
    Ok(done)
}

/// Cells of a size that meet the volume.
fn roots(ground: &Ground<'_>, size: i32) -> Vec<Cell> {
    let [low_m, high_m] = ground.volume.outer_m();
    let size_m = size as f32 * ground.step_m;
    let [low, high] = [low_m, high_m].map(|corner_m| (corner_m / size_m).floor().as_ivec3());
    let along = |axis: usize| low[axis]..=high[axis];
    let cells = along(2).flat_map(|z| {
        along(1).flat_map(move |y| along(0).map(move |x| (size * IVec3::new(x, y, z)).to_array()))
    });
    cells.map(|low| Cell { size, low }).collect()
}

/// Free places of a cell: one at most in each eighth.
fn free_places(ground: &Ground<'_>, cell: Cell) -> Vec<Vec3> {
    let mut numbers = Sequence::new(cell.seed());
    let places = cell.children().map(|part| {
        let within = Vec3::from([(); 3].map(|()| numbers.next_f32()));
        (IVec3::from(part.low).as_vec3() + within * part.size as f32) * ground.step_m
    });
    let places: Vec<Vec3> = places.collect();
    let is_free =
        |at_m: &Vec3| ground.volume.holds(*at_m) && place(ground.geometry, *at_m, 0.0) != Place::Inside;
    places.into_iter().filter(is_free).collect()
}

/// Transport to a place by columns, ascending: rows of its even and of its odd rays.
type Transport = Vec<(u64, [[f32; PROBE_ROWS]; 2])>;

/// Judges cells, and keeps the transport to corners that cells share.
struct Judge<'g, 'a> {
    ground: &'g Ground<'a>,
    /// `None` where no probe may stand.
    corners: HashMap<IVec3, Option<Transport>>,
}

impl Judge<'_, '_> {
    fn judged(&mut self, cells: &[Cell]) -> Result<Vec<Judged>, Cancelled> {
        let ground = self.ground;
        let new: BTreeSet<[i32; 3]> =
            cells.iter().flat_map(|cell| cell.corners()).map(|at| at.to_array()).collect();
        let new: Vec<IVec3> =
            new.into_iter().map(IVec3::from).filter(|at| !self.corners.contains_key(at)).collect();
        let of_corner = |&at: &IVec3| {
            ground.progress.check()?;
            let at_m = at.as_vec3() * ground.step_m;
            let found = ground.progress.casting(|| {
                let stands = place(ground.geometry, at_m, CLEARANCE * ground.spacing_m) == Place::Free;
                let [x, y, z] = at.to_array().map(|along| along as u64);
                stands.then(|| transport(ground, at_m, seed_of(&[x, y, z, 16])))
            });
            Ok((at, found))
        };
        let found: Vec<_> = new.par_iter().map(of_corner).collect::<Result<_, Cancelled>>()?;
        self.corners.extend(found);
        let judged = |cell: &Cell| {
            ground.progress.check()?;
            Ok(ground.progress.casting(|| self.judge(*cell)))
        };
        cells.par_iter().map(judged).collect()
    }

    fn judge(&self, cell: Cell) -> Judged {
        let places = free_places(self.ground, cell);
        let (mut wrong, mut all) = (0.0, 0.0);
        for (&at_m, number) in places.iter().zip(0..) {
            let there = transport(self.ground, at_m, seed_of(&[cell.seed(), number]));
            let (of_difference, of_place) = differences(&self.around(cell, at_m), &there);
            wrong += of_difference;
            all += of_place;
        }
        let error = if all > 0.0 { (wrong / all).max(0.0) } else { 0.0 };
        Judged { cell, error, share: places.len() as f32 / 8.0 }
    }

    /// Transport to the corners that see a place, and their weights there, which add up to 1.
    fn around(&self, cell: Cell, at_m: Vec3) -> Vec<(f32, &Transport)> {
        let ground = self.ground;
        let share = (at_m / ground.step_m - IVec3::from(cell.low).as_vec3()) / cell.size as f32;
        let mut around = Vec::new();
        for (number, corner) in cell.corners().into_iter().enumerate() {
            let Some(Some(there)) = self.corners.get(&corner) else { continue };
            if ground.geometry.tracer.is_occluded(corner.as_vec3() * ground.step_m, at_m) {
                continue;
            }
            let along = |axis: usize| if number >> axis & 1 == 1 { share[axis] } else { 1.0 - share[axis] };
            around.push((along(0) * along(1) * along(2), there));
        }
        let sum: f32 = around.iter().map(|(weight, _)| weight).sum();
        around.iter_mut().for_each(|(weight, _)| *weight /= sum.max(f32::MIN_POSITIVE));
        around
    }
}

/// Transport to a place.
fn transport(ground: &Ground<'_>, at_m: Vec3, seed: u64) -> Transport {
    let turn = uniform_turn(seed);
    let mut met: Vec<(u64, usize, [f32; PROBE_ROWS])> = Vec::new();
    for ray in 0..RAYS {
        let direction = turn * relight_direction(ray, RAYS);
        let column = match ground.geometry.tracer.met(at_m, direction, f32::INFINITY) {
            // Parts of the sky: an octant's four.
            None => {
                let [x, y, z] = (2.0 * direction).floor().as_ivec3().to_array().map(|along| along as u64);
                seed_of(&[x, y, z, 17])
            }
            Some(hit) if ground.geometry.is_back(&hit) => continue,
            Some(hit) => {
                let cell = cell_of(at_m + direction * hit.t, ground.spacing_m);
                seed_of(&[key_of(cell, ground.spacing_m), u64::from(hit.front), 18])
            }
        };
        // Rays come in bit-reversed order: each half of them is spread evenly.
        met.push((column, usize::from(2 * ray >= RAYS), irradiance_weights(direction)));
    }
    met.sort_by_key(|(column, half, _)| (*column, *half));
    let mut all: Transport = Vec::new();
    for (column, half, weights) in met {
        if all.last().is_none_or(|(last, _)| *last != column) {
            all.push((column, [[0.0; PROBE_ROWS]; 2]));
        }
        let Some((_, rows)) = all.last_mut() else { continue };
        rows[half].iter_mut().zip(weights).for_each(|(sum, weight)| *sum += weight);
    }
    all
}

/// Σ_j Σ_s D² of the mean of some with their weights less a place's own transport, and the same of the latter; squares are products of
/// halves, which chance has no part in.
fn differences(around: &[(f32, &Transport)], own: &Transport) -> (f32, f32) {
    let parts = around.iter().map(|(weight, there)| (*weight, *there)).chain([(-1.0, own)]);
    let mut all: Vec<(u64, f32, &[[f32; PROBE_ROWS]; 2])> = parts
        .flat_map(|(weight, there)| there.iter().map(move |(column, rows)| (*column, weight, rows)))
        .collect();
    // Stable, so that sums have one order.
    all.sort_by_key(|(column, ..)| *column);
    let product = |[even, odd]: &[[f32; PROBE_ROWS]; 2]| -> f32 {
        even.iter().zip(odd).map(|(even, odd)| even * odd).sum()
    };
    let of_column = |of: &[(u64, f32, &[[f32; PROBE_ROWS]; 2])]| {
        let mut sum = [[0.0; PROBE_ROWS]; 2];
        for (_, weight, rows) in of {
            let pairs = sum.as_flattened_mut().iter_mut().zip(rows.as_flattened());
            pairs.for_each(|(sum, row)| *sum += weight * row);
        }
        product(&sum)
    };
    let wrong = all.chunk_by(|a, b| a.0 == b.0).map(of_column).sum();
    (wrong, own.iter().map(|(_, rows)| product(rows)).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Transport of one column each.
    fn of(columns: &[(u64, f32, f32)]) -> Transport {
        columns.iter().map(|&(column, even, odd)| (column, [[even; PROBE_ROWS], [odd; PROBE_ROWS]])).collect()
    }

    #[test]
    fn the_mean_of_places_alike_does_not_err_and_chance_is_taken_off() {
        let (a, b, own) = (of(&[(1, 1.0, 1.0)]), of(&[(1, 3.0, 3.0)]), of(&[(1, 2.0, 2.0)]));
        assert_eq!(differences(&[(0.5, &a), (0.5, &b)], &own), (0.0, 4.0 * PROBE_ROWS as f32));
        // Other columns count whole, whatever their number.
        let far = of(&[(2, 2.0, 2.0)]);
        assert_eq!(differences(&[(1.0, &far)], &own).0, 8.0 * PROBE_ROWS as f32);
        // Halves that differ by as much this way as that are noise.
        let noisy = of(&[(1, 3.0, 2.0)]);
        assert_eq!(differences(&[(1.0, &noisy)], &own).0, 0.0);
        assert_eq!(differences(&[], &own).0, 4.0 * PROBE_ROWS as f32);
    }

    #[test]
    fn cells_that_err_are_split_until_there_are_as_many_as_wanted() {
        // Error about the least corner alone.
        let judged = |cells: &[Cell]| {
            let of =
                |&cell: &Cell| Judged { cell, error: f32::from(u8::from(cell.low == [0; 3])), share: 1.0 };
            Ok(cells.iter().map(of).collect::<Vec<_>>())
        };
        let root = Cell { size: 48, low: [0; 3] };
        let open = judged(&[root]).unwrap();
        let leaves = split(open.clone(), (22.0, 3), judged).unwrap();
        assert_eq!(leaves.len(), 22);
        assert_eq!(leaves.iter().filter(|leaf| leaf.size == 6).count(), 8);
        assert!(leaves.iter().filter(|leaf| leaf.size == 6).all(|leaf| leaf.low.iter().max() < Some(&12)));
        let volume: i32 = leaves.iter().map(|leaf| leaf.size.pow(3)).sum();
        assert_eq!(volume, 48_i32.pow(3));
        // None is less than the least.
        let all = split(open, (1e9, 3), judged).unwrap();
        assert_eq!(all.len(), 16_usize.pow(3));
        assert!(all.iter().all(|leaf| leaf.size == 3));
    }
}
