//! Probes fitted to the light between them: a probe is no point sample, as what is read of it is always a mean with its neighbours.
//!
//! Rows minimise `Σ_x ‖Σ_p w_p(x) T_p − T(x)‖² + 0.3 Σ_p ‖T_p − T̂_p‖²`, T̂ being traced at probes and T(x) at places x in the cells around
//! them, with the weights w that the run time has there. So `T_p = Σ_q c_pq (0.3 T̂_q + Σ_x w_q(x) T(x))` with the inverse c of
//! `0.3 I + Σ_x w(x) w(x)ᵀ`. On a lattice there are four places in each cell, and between tetrahedra one in each.

use std::collections::{BTreeMap, BTreeSet};

use glam::{IVec3, Vec3};
use lightkiln_proto::kinds::field::{FieldPart, FieldTable, PROBE_ROWS, ProbeKey, TetrahedronSet};
use lightkiln_proto::relight::{Inconsistent, PatchTable};

use super::looks::is_free_by;
use super::{Survey, Tessellation};
use crate::geometry::{Geometry, Trail};
use crate::rays::sampling::{Sequence, seed_of};
use crate::transport::PatchRow;

/// Weight of a probe's own rows against a place's.
const RIDGE: f64 = 0.3;
/// Places in each cell.
const PLACES: u32 = 4;
/// Nearest that a surface may be to a place, over the lattice's step.
const CLEARANCE: f32 = 0.04;
/// Least share of a row that is added.
const SHARE_MIN: f64 = 1e-6;

/// Cells of the lattice that a probe's light is read in.
fn cells_of(key: ProbeKey) -> impl Iterator<Item = IVec3> {
    let count = if key.is_of_cell() { 1 } else { 8 };
    (0..count).map(move |corner| key.point() - IVec3::new(corner & 1, corner >> 1 & 1, corner >> 2))
}

/// Surroundings of some probes, as far as their light is read there.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Around {
    /// Least corners of cells, on a lattice.
    pub cells: Vec<IVec3>,
    /// Tetrahedra elsewhere: numbers in `probes`, and [`u32::MAX`] less that of a corner of the box.
    pub tetrahedra: Vec<[u32; 4]>,
    /// Numbers of probes in the survey: the own ones first, then others at corners of the cells and in them, or of the tetrahedra.
    pub probes: Vec<u32>,
}

impl Around {
    /// Of some probes of a survey; nothing but these where probes are not fitted.
    pub fn of(survey: &Survey, own: &[u32], is_fitted: bool) -> Self {
        if !is_fitted {
            return Self { probes: own.to_vec(), ..Self::default() };
        }
        if let Some(tessellation) = &survey.tessellation {
            return Self::in_tetrahedra(survey, tessellation, own);
        }
        let keys = own.iter().map(|&probe| survey.probe(probe as usize).key);
        let cells: BTreeSet<[i32; 3]> = keys.flat_map(cells_of).map(|cell| cell.to_array()).collect();
        let cells: Vec<IVec3> = cells.into_iter().map(IVec3::from_array).collect();
        let at = |cell: &IVec3| {
            let cell = *cell;
            let corners =
                (0..8).map(move |corner| cell + IVec3::new(corner & 1, corner >> 1 & 1, corner >> 2));
            corners.filter_map(ProbeKey::of).chain(ProbeKey::of_cell(cell))
        };
        let number = |key: ProbeKey| survey.probes.binary_search_by_key(&key.0, |probe| probe.0).ok();
        let all: BTreeSet<u32> =
            cells.iter().flat_map(at).filter_map(number).map(|number| number as u32).collect();
        let others = all.into_iter().filter(|probe| !own.contains(probe));
        Self { probes: own.iter().copied().chain(others).collect(), cells, ..Self::default() }
    }

    /// Tetrahedra that have an own probe among their vertices.
    fn in_tetrahedra(survey: &Survey, tessellation: &Tessellation, own: &[u32]) -> Self {
        let is_own: BTreeSet<u32> = own.iter().copied().collect();
        let tetrahedra = || {
            let all = tessellation.tetrahedra.iter();
            all.filter(|of| of.iter().any(|vertex| is_own.contains(vertex)))
        };
        let count = survey.probes.len() as u32;
        let others: BTreeSet<u32> =
            tetrahedra().flatten().copied().filter(|vertex| *vertex < count).collect();
        let others = others.into_iter().filter(|vertex| !is_own.contains(vertex));
        let probes: Vec<u32> = own.iter().copied().chain(others).collect();
        let number_of: BTreeMap<u32, u32> = probes.iter().copied().zip(0..).collect();
        let number =
            |vertex: u32| number_of.get(&vertex).copied().unwrap_or(u32::MAX - vertex.saturating_sub(count));
        Self { tetrahedra: tetrahedra().map(|of| of.map(number)).collect(), probes, ..Self::default() }
    }
}

/// A place in free space, and the probes that its light is read of: numbers in [`Around::probes`].
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// In metres.
    pub position_m: Vec3,
    /// Seed of its rays.
    pub seed: u64,
    /// Weights, which add up to 1.
    pub weights: Vec<(u32, f32)>,
}

/// Places in the cells, as far as these are within the scene's near bounds, by the depth maps of the probes. None that a wall parts from a probe it is read of: light of the other side would
/// come into its own. Marks the `trail` of the rays that tell.
pub fn places(
    geometry: &Geometry,
    survey: &Survey,
    around: &Around,
    depths: Vec<u16>,
    trail: &Trail,
) -> Result<Vec<Place>, Inconsistent> {
    let (spacing_m, [low_m, high_m]) = (survey.step_m, geometry.near_bounds_m());
    let probes: Vec<_> = around.probes.iter().map(|&probe| survey.probe(probe as usize)).collect();
    let part = FieldPart { spacing_m, probes, depths, ..FieldPart::default() };
    // Weights between tetrahedra are known here: no walk is made.
    let none = TetrahedronSet { probes: around.probes.len() as u32, ..TetrahedronSet::default() };
    let tetrahedra = survey.tessellation.is_some().then_some(&none);
    let table = FieldTable::join(&[part], tetrahedra, 0, &PatchTable::default())?;
    let mut places = Vec::new();
    // A place, and the probes that its light is read of.
    let mut add = |position_m: Vec3, seed: u64, weights: Vec<(u32, f32)>| {
        let from = trail.from(position_m);
        let is_parted = |&(probe, _): &(u32, f32)| {
            let probe_m = table.position_m[probe as usize].truncate();
            from.mark(probe_m - position_m, Some(1.0));
            geometry.tracer.is_occluded(probe_m, position_m)
        };
        let is_within = position_m.cmpge(low_m).all() && position_m.cmple(high_m).all();
        let is_read = !weights.is_empty() && !weights.iter().any(is_parted);
        if is_within && is_read && is_free_by(geometry, position_m, CLEARANCE * spacing_m, trail) {
            places.push(Place { position_m, seed, weights });
        }
    };
    for cell in &around.cells {
        let Some(key) = ProbeKey::of_cell(*cell) else { continue };
        let mut numbers = Sequence::new(seed_of(&[key.0, 9]));
        for place in 0..PLACES {
            let within = Vec3::from([(); 3].map(|()| numbers.next_f32()));
            let position_m = (cell.as_vec3() + within) * spacing_m;
            add(position_m, seed_of(&[key.0, 10, u64::from(place)]), table.weights(position_m));
        }
    }
    for of in &around.tetrahedra {
        let vertex = |number: u32| match around.probes.get(number as usize) {
            Some(&probe) => {
                (survey.probe(probe as usize).position_m(spacing_m), survey.probes[probe as usize].0)
            }
            None => (survey.corner_m(u32::MAX - number), u64::MAX - u64::from(u32::MAX - number)),
        };
        let vertices = of.map(vertex);
        let [a, b, c, d] = vertices.map(|(_, key)| key);
        let shares = within_tetrahedron(&mut Sequence::new(seed_of(&[a, b, c, d, 11])));
        let position_m = vertices.iter().zip(shares).map(|((at_m, _), share)| *at_m * share).sum();
        let near =
            of.iter().copied().zip(shares).filter(|(number, _)| (*number as usize) < around.probes.len());
        let near: Vec<(u32, f32)> = near.collect();
        add(position_m, seed_of(&[a, b, c, d, 12]), table.seen(&near, position_m));
    }
    Ok(places)
}

/// Barycentric coordinates of a place in a tetrahedron, all alike (\[Rocchini2000\]).
fn within_tetrahedron(numbers: &mut Sequence) -> [f32; 4] {
    let [mut s, mut t, mut u] = [(); 3].map(|()| numbers.next_f32());
    if s + t > 1.0 {
        (s, t) = (1.0 - s, 1.0 - t);
    }
    if t + u > 1.0 {
        (t, u) = (1.0 - u, 1.0 - s - t);
    } else if s + t + u > 1.0 {
        (s, u) = (1.0 - t - u, s + t + u - 1.0);
    }
    [1.0 - s - t - u, s, t, u]
}

/// Shares of all rows in those of the first `own` probes: of each probe's own, then of each place's.
pub fn shares(probes: usize, own: usize, places: &[Place]) -> Vec<Vec<f64>> {
    let mut normal = vec![0.0; probes * probes];
    for at in 0..probes {
        normal[at * probes + at] = RIDGE;
    }
    for Place { weights, .. } in places {
        for &(a, weight_a) in weights {
            for &(b, weight_b) in weights {
                normal[a as usize * probes + b as usize] += f64::from(weight_a) * f64::from(weight_b);
            }
        }
    }
    let lower = cholesky(normal, probes);
    let of_probe = |probe: usize| {
        let inverse = column_of_inverse(&lower, probes, probe);
        let of_place = |place: &Place| {
            let weights = place.weights.iter();
            weights.map(|&(probe, weight)| inverse[probe as usize] * f64::from(weight)).sum::<f64>()
        };
        inverse.iter().map(|of| RIDGE * of).chain(places.iter().map(of_place)).collect()
    };
    (0..own).map(of_probe).collect()
}

/// L of a positive definite matrix, M = L Lᵀ, row-major.
fn cholesky(mut matrix: Vec<f64>, size: usize) -> Vec<f64> {
    for column in 0..size {
        for row in column..size {
            let (a, b) = (row * size, column * size);
            let sum: f64 = (0..column).map(|k| matrix[a + k] * matrix[b + k]).sum();
            let rest = matrix[a + column] - sum;
            matrix[a + column] = if row == column { rest.sqrt() } else { rest / matrix[b + column] };
        }
    }
    matrix
}

/// A column of the inverse of M = L Lᵀ.
fn column_of_inverse(lower: &[f64], size: usize, column: usize) -> Vec<f64> {
    let mut found = vec![0.0; size];
    for row in column..size {
        let sum: f64 = (column..row).map(|k| lower[row * size + k] * found[k]).sum();
        let wanted = if row == column { 1.0 } else { 0.0 };
        found[row] = (wanted - sum) / lower[row * size + row];
    }
    for row in (0..size).rev() {
        let sum: f64 = (row + 1..size).map(|k| lower[k * size + row] * found[k]).sum();
        found[row] = (found[row] - sum) / lower[row * size + row];
    }
    found
}

/// Rows of a probe: sums of those of all probes and places by its shares.
pub fn fitted(shares: &[f64], rows: &[PatchRow]) -> Vec<PatchRow> {
    let of_row = |j: usize| {
        let mut sum = PatchRow::default();
        for (source, share) in shares.iter().enumerate().filter(|(_, share)| share.abs() > SHARE_MIN) {
            let row = &rows[source * PROBE_ROWS + j];
            add(&mut sum.alpha, &row.alpha, *share);
            for (sum, row) in sum.importance.iter_mut().zip(&row.importance) {
                add(sum, row, *share);
            }
        }
        sum
    };
    (0..PROBE_ROWS).map(of_row).collect()
}

fn add(sum: &mut Vec<f32>, row: &[f32], share: f64) {
    sum.resize(row.len(), 0.0);
    sum.iter_mut().zip(row).for_each(|(sum, value)| *sum += share as f32 * value);
}

/// The same of coefficients of emitters.
pub fn fitted_emitters(shares: &[f64], all: &[Vec<[[f32; 3]; PROBE_ROWS]>]) -> Vec<[[f32; 3]; PROBE_ROWS]> {
    let count = all.first().map_or(0, Vec::len);
    let mut sums = vec![[[0.0; 3]; PROBE_ROWS]; count];
    for (emitters, share) in all.iter().zip(shares).filter(|(_, share)| share.abs() > SHARE_MIN) {
        for (sum, of) in sums.iter_mut().zip(emitters) {
            let pairs = sum.as_flattened_mut().iter_mut().zip(of.as_flattened());
            pairs.for_each(|(sum, value)| *sum += *share as f32 * value);
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Probes on a line, with places half way between neighbours and at probes but for the last two, which nothing joins to the others.
    fn line() -> Vec<Place> {
        let place =
            |weights: &[(u32, f32)]| Place { position_m: Vec3::ZERO, seed: 0, weights: weights.to_vec() };
        let mut places: Vec<Place> = (0..3).map(|at| place(&[(at, 0.5), (at + 1, 0.5)])).collect();
        places.push(place(&[(4, 0.5), (5, 0.5)]));
        places
    }

    #[test]
    fn places_are_spread_evenly_over_a_tetrahedron() {
        let mut numbers = Sequence::new(7);
        let all: Vec<[f32; 4]> = (0..4000).map(|_| within_tetrahedron(&mut numbers)).collect();
        for corner in 0..4 {
            assert!(all.iter().all(|of| of[corner] >= 0.0 && (of.iter().sum::<f32>() - 1.0).abs() < 1e-6));
            // A coordinate of a uniform place is above 1/2 with chance 1/8, and 1/4 in the mean.
            let far = all.iter().filter(|of| of[corner] > 0.5).count() as f32 / 4000.0;
            let mean = all.iter().map(|of| of[corner]).sum::<f32>() / 4000.0;
            assert!((far - 0.125).abs() < 0.02 && (mean - 0.25).abs() < 0.01, "{corner}: {far}, {mean}");
        }
    }

    #[test]
    fn constant_light_stays_and_none_passes_between_probes_that_nothing_joins() {
        let shares = shares(6, 6, &line());
        for (probe, of) in shares.iter().enumerate() {
            assert!((of.iter().sum::<f64>() - 1.0).abs() < 1e-12, "{of:?}");
            let is_other = |source: usize| (probe < 4) != (source < 4 || (6..9).contains(&source));
            for source in (0..10).filter(|&source| is_other(source)) {
                assert_eq!(of[source], 0.0, "{source} in {probe}");
            }
        }
    }

    #[test]
    fn solution_is_that_of_the_normal_equations() {
        let places = line();
        let (traced, at_places) = ([1.0, 4.0, 2.0, 7.0, 3.0, 3.0], [2.0, 5.0, 1.0, 8.0]);
        let found: Vec<f64> = shares(6, 6, &places)
            .iter()
            .map(|of| {
                of.iter().zip(traced.iter().chain(&at_places)).map(|(share, value)| share * value).sum()
            })
            .collect();
        for probe in 0..6 {
            let of_place = |(place, value): (&Place, &f64)| {
                let read: f64 = place.weights.iter().map(|&(q, w)| found[q as usize] * f64::from(w)).sum();
                let own = place.weights.iter().find(|(q, _)| *q as usize == probe).map_or(0.0, |(_, w)| *w);
                f64::from(own) * (read - value)
            };
            let gradient: f64 = places.iter().zip(&at_places).map(of_place).sum::<f64>()
                + RIDGE * (found[probe] - traced[probe]);
            assert!(gradient.abs() < 1e-12, "{gradient} of {probe}");
        }
    }
}
