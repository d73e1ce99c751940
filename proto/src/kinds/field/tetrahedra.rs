//! Tetrahedra between probes: which of them a point lies in, found by a walk from one to the next towards it (\[Cupisz2012\]).

use glam::{IVec3, Vec3, Vec4};

use super::content::FieldPart;
use crate::relight::Inconsistent;

/// No tetrahedron lies beyond a face.
pub const NONE: u32 = u32::MAX;
/// Corners of the box around all probes: vertices of tetrahedra that have no light.
pub const CORNERS: usize = 8;

/// Most steps of a walk, which begins near its end.
const STEPS_MAX: u32 = 64;
/// Most steps of one to the middle of a cell, which begins in a cell beside it.
const STEPS_FROM_CELL_MAX: u32 = 4096;
/// Barycentric coordinate from which on a point counts as within.
const WITHIN: f32 = -1e-5;
/// Most cells that walks begin in.
const CELLS_MAX: i32 = 1 << 20;
/// Least share of the mean distance of probes that one has in wide surroundings.
const NEAREST: f32 = 0.05;

/// Tetrahedra, decoded.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TetrahedronSet {
    /// Least and greatest corner of the box that they fill, in metres.
    pub box_m: [[f32; 3]; 2],
    /// Probes that there are.
    pub probes: u32,
    /// Vertices of each: probes by their place in the order of keys, then the corners of the box, x fastest.
    pub vertices: Vec<[u32; 4]>,
}

/// Tetrahedra, what lies beyond their faces, and where walks begin.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TetrahedraTable {
    /// Least corner of the box.
    pub low_m: Vec3,
    /// Greatest.
    pub high_m: Vec3,
    /// Places of vertices in metres: probes, then [`CORNERS`].
    pub places_m: Vec<Vec4>,
    /// Vertices of each.
    pub vertices: Vec<[u32; 4]>,
    /// Tetrahedra beyond the faces opposite to each vertex, or [`NONE`].
    pub beyond: Vec<[u32; 4]>,
    /// Edge of the cells that walks begin in, in metres.
    pub cell_m: f32,
    /// Cells along each axis.
    pub cells: IVec3,
    /// Tetrahedron at the middle of each cell, x fastest.
    pub starts: Vec<u32>,
}

impl TetrahedraTable {
    /// Of probes in the order of parts.
    pub fn of(parts: &[FieldPart], set: &TetrahedronSet) -> Result<Self, Inconsistent> {
        let inconsistent = |problem: String| Inconsistent::new("tetrahedra", problem);
        let probes: Vec<(u64, Vec3)> = parts
            .iter()
            .flat_map(|part| part.probes.iter().map(|probe| (probe.key.0, probe.position_m(part.spacing_m))))
            .collect();
        if probes.len() != set.probes as usize {
            return Err(inconsistent(format!(
                "they are of {} probes, the field has {}",
                set.probes,
                probes.len()
            )));
        }
        let mut order: Vec<u32> = (0..probes.len() as u32).collect();
        order.sort_unstable_by_key(|&probe| probes[probe as usize].0);
        if let Some(pair) =
            order.windows(2).find(|pair| probes[pair[0] as usize].0 == probes[pair[1] as usize].0)
        {
            return Err(inconsistent(format!("probes {} and {} have one key", pair[0], pair[1])));
        }
        let [low_m, high_m] = set.box_m.map(Vec3::from);
        let corner = |at: u32| {
            let side = |axis: u32| at >> axis & 1 == 1;
            Vec3::select(glam::BVec3::new(side(0), side(1), side(2)), high_m, low_m)
        };
        let places = probes.iter().map(|(_, place)| *place).chain((0..CORNERS as u32).map(corner));
        let count = probes.len() as u32;
        let number = |vertex: u32| if vertex < count { order[vertex as usize] } else { vertex };
        let vertices: Vec<[u32; 4]> = set.vertices.iter().map(|of| of.map(number)).collect();
        let mut table = Self {
            low_m,
            high_m,
            places_m: places.map(|place| place.extend(0.0)).collect(),
            beyond: beyond(&vertices).map_err(inconsistent)?,
            vertices,
            ..Self::default()
        };
        let is_flat = |of: &u32| table.within(*of, table.middle_m(*of)).is_none();
        if let Some(flat) = (0..table.vertices.len() as u32).find(is_flat) {
            return Err(inconsistent(format!("number {flat} is flat")));
        }
        table.fill_starts();
        Ok(table)
    }

    fn place_m(&self, vertex: u32) -> Vec3 {
        self.places_m[vertex as usize].truncate()
    }

    fn middle_m(&self, tetrahedron: u32) -> Vec3 {
        self.vertices[tetrahedron as usize].iter().map(|&vertex| 0.25 * self.place_m(vertex)).sum()
    }

    /// Probes, without the corners.
    fn probes(&self) -> u32 {
        (self.places_m.len() - CORNERS) as u32
    }

    /// Barycentric coordinates of a point; none in a tetrahedron without volume.
    fn within(&self, tetrahedron: u32, point_m: Vec3) -> Option<[f32; 4]> {
        let [first, a, b, c] = self.vertices[tetrahedron as usize].map(|vertex| self.place_m(vertex));
        let [a, b, c, to] = [a, b, c, point_m].map(|place| place - first);
        let volume = a.dot(b.cross(c));
        let of = [to.dot(b.cross(c)), to.dot(c.cross(a)), to.dot(a.cross(b))].map(|part| part / volume);
        let all = [1.0 - of[0] - of[1] - of[2], of[0], of[1], of[2]];
        (volume != 0.0 && all.iter().all(|share| share.is_finite())).then_some(all)
    }

    /// Walks from a tetrahedron to the one that a point lies in, or is nearest to of those met.
    fn walk(&self, start: u32, point_m: Vec3, steps_max: u32) -> (u32, [f32; 4]) {
        let (mut at, mut best) = (start, (start, [0.0; 4], f32::NEG_INFINITY));
        for _ in 0..steps_max {
            let Some(shares) = self.within(at, point_m) else { break };
            let mut side = 0;
            for other in 1..4 {
                if shares[other] < shares[side] {
                    side = other;
                }
            }
            if shares[side] > best.2 {
                best = (at, shares, shares[side]);
            }
            let next = self.beyond[at as usize][side];
            if shares[side] >= WITHIN || next == NONE {
                break;
            }
            at = next;
        }
        (best.0, best.1)
    }

    /// Chooses cells about as dense as probes, and walks to the middle of each.
    fn fill_starts(&mut self) {
        if self.vertices.is_empty() {
            return;
        }
        let extent_m = self.high_m - self.low_m;
        let volume = f64::from(extent_m.x) * f64::from(extent_m.y) * f64::from(extent_m.z);
        let mut cell_m = (volume / f64::from(self.probes().max(1))).cbrt() as f32;
        loop {
            cell_m = cell_m.max(extent_m.max_element() / 1024.0);
            self.cells = (extent_m / cell_m).ceil().as_ivec3().clamp(IVec3::ONE, IVec3::splat(1024));
            if self.cells.to_array().into_iter().fold(1, i32::saturating_mul) <= CELLS_MAX {
                break;
            }
            cell_m *= 2.0;
        }
        self.cell_m = cell_m;
        let IVec3 { x, y, z } = self.cells;
        let (row, layer) = (x as usize, (x * y) as usize);
        for place in (0..z).flat_map(|z| (0..y).flat_map(move |y| (0..x).map(move |x| IVec3::new(x, y, z)))) {
            // From the cell before along x, else along y, else along z.
            let back = if place.x > 0 {
                1
            } else if place.y > 0 {
                row
            } else {
                layer
            };
            let start = self.starts.len().checked_sub(back).map_or(0, |before| self.starts[before]);
            let middle_m = (self.low_m + (place.as_vec3() + 0.5) * cell_m).min(self.high_m);
            self.starts.push(self.walk(start, middle_m, STEPS_FROM_CELL_MAX).0);
        }
    }

    /// The tetrahedron of a point, or of the nearest one of the box, and its barycentric coordinates, of which none is below 0.
    pub fn locate(&self, point_m: Vec3) -> Option<(u32, [f32; 4])> {
        if self.starts.is_empty() || !point_m.is_finite() {
            return None;
        }
        let point_m = point_m.clamp(self.low_m, self.high_m);
        let cell = ((point_m - self.low_m) / self.cell_m).as_ivec3().clamp(IVec3::ZERO, self.cells - 1);
        let start = self.starts[((cell.z * self.cells.y + cell.y) * self.cells.x + cell.x) as usize];
        let (at, shares) = self.walk(start, point_m, STEPS_MAX);
        Some((at, shares.map(|share| share.max(0.0))))
    }

    /// Probes at the corners of a point's tetrahedron, and its barycentric coordinates; less than 1 in all where corners of the box are
    /// among them.
    pub fn around(&self, point_m: Vec3) -> Vec<(u32, f32)> {
        let Some((at, shares)) = self.locate(point_m) else { return Vec::new() };
        let all = self.vertices[at as usize].into_iter().zip(shares);
        all.filter(|&(vertex, share)| vertex < self.probes() && share > 0.0).collect()
    }

    /// Probes of a point's tetrahedron, of those beyond its faces and of those beyond theirs, the nearer the more: by reciprocals of squared
    /// distances.
    pub(super) fn wide(&self, point_m: Vec3) -> Vec<(u32, f32)> {
        let Some((at, _)) = self.locate(point_m) else { return Vec::new() };
        let beyond = |of: u32| self.beyond[of as usize].into_iter().filter(|beside| *beside != NONE);
        let mut found = self.vertices[at as usize].to_vec();
        for around in beyond(at).flat_map(|beside| std::iter::once(beside).chain(beyond(beside))) {
            for vertex in self.vertices[around as usize] {
                if !found.contains(&vertex) {
                    found.push(vertex);
                }
            }
        }
        let weight = |vertex: u32| {
            let away = (self.place_m(vertex) - point_m) / self.cell_m;
            (vertex, 1.0 / away.length_squared().max(NEAREST * NEAREST))
        };
        found.into_iter().filter(|vertex| *vertex < self.probes()).map(weight).collect()
    }
}

/// Tetrahedra beyond the faces of each.
fn beyond(vertices: &[[u32; 4]]) -> Result<Vec<[u32; 4]>, String> {
    let mut faces: Vec<([u32; 3], u32, u8)> = Vec::with_capacity(4 * vertices.len());
    for (number, of) in vertices.iter().enumerate() {
        for side in 0..4 {
            let mut face = [of[(side + 1) % 4], of[(side + 2) % 4], of[(side + 3) % 4]];
            face.sort_unstable();
            faces.push((face, number as u32, side as u8));
        }
    }
    faces.sort_unstable();
    let mut beyond = vec![[NONE; 4]; vertices.len()];
    for same in faces.chunk_by(|a, b| a.0 == b.0) {
        match *same {
            [_] => {}
            [(_, a, of_a), (_, b, of_b)] if a != b => {
                beyond[a as usize][of_a as usize] = b;
                beyond[b as usize][of_b as usize] = a;
            }
            _ => return Err(format!("{} have one face in common", same.len())),
        }
    }
    Ok(beyond)
}

#[cfg(test)]
mod tests {
    use super::super::content::{Probe, ProbeKey};
    use super::*;

    /// A box of unit cells, each cut into six tetrahedra about its diagonal, with probes at all inner points and at none of its corners.
    fn cut_box(size: IVec3) -> (Vec<FieldPart>, TetrahedronSet) {
        let points = |size: IVec3| {
            (0..size.z).flat_map(move |z| {
                (0..size.y).flat_map(move |y| (0..size.x).map(move |x| IVec3::new(x, y, z)))
            })
        };
        let is_corner = |at: IVec3| (0..3).all(|axis| [0, size[axis] - 1].contains(&at[axis]));
        let probes: Vec<Probe> = points(size)
            .filter(|at| !is_corner(*at))
            .map(|at| Probe { key: ProbeKey::of(at).unwrap(), moved: [0; 3] })
            .collect();
        let vertex = |at: IVec3| {
            let corner = (at.min(IVec3::ONE)).dot(IVec3::new(1, 2, 4)) as u32;
            let key = ProbeKey::of(at).unwrap();
            probes
                .binary_search_by_key(&key, |probe| probe.key)
                .map_or(probes.len() as u32 + corner, |at| at as u32)
        };
        let ways = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
        let mut vertices = Vec::new();
        for cell in points(size - 1) {
            for [a, b, _] in ways {
                let one = cell + IVec3::AXES[a];
                vertices.push([cell, one, one + IVec3::AXES[b], cell + 1].map(vertex));
            }
        }
        let set = TetrahedronSet {
            box_m: [[0.0; 3], (0.5 * (size - 1).as_vec3()).to_array()],
            probes: probes.len() as u32,
            vertices,
        };
        // Parts have their probes in another order than keys.
        let (even, odd): (Vec<_>, Vec<_>) = probes.iter().partition(|probe| probe.key.0 % 2 == 0);
        let part = |probes: Vec<Probe>| FieldPart { spacing_m: 0.5, probes, ..FieldPart::default() };
        (vec![part(odd), part(even)], set)
    }

    #[test]
    fn walks_end_where_the_point_is_and_linear_light_is_read_as_it_is() {
        let (parts, set) = cut_box(IVec3::splat(4));
        let table = TetrahedraTable::of(&parts, &set).unwrap();
        let mut state = 1_u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1 << 24) as f32
        };
        for _ in 0..20_000 {
            let point_m = Vec3::new(next(), next(), next()) * 1.5;
            let (at, shares) = table.locate(point_m).unwrap();
            let brute = (0..table.vertices.len() as u32)
                .find(|of| table.within(*of, point_m).unwrap().iter().all(|share| *share >= WITHIN))
                .unwrap();
            assert!(
                at == brute || shares.iter().any(|share| *share < 1e-4),
                "{point_m}: {at} {shares:?}, {brute}"
            );
            let read: Vec3 = table.vertices[at as usize]
                .iter()
                .zip(shares)
                .map(|(of, share)| table.place_m(*of) * share)
                .sum();
            assert!(read.distance(point_m) < 1e-4, "{read} at {point_m}");
        }
        // Whatever they begin at.
        for start in 0..table.vertices.len() as u32 {
            let (_, shares) = table.walk(start, Vec3::new(0.61, 0.93, 1.27), STEPS_MAX);
            assert!(shares.iter().all(|share| *share >= WITHIN), "from {start}: {shares:?}");
        }
    }

    #[test]
    fn places_of_a_long_box_are_found_from_the_start_of_their_cell() {
        let (parts, set) = cut_box(IVec3::new(120, 4, 4));
        let table = TetrahedraTable::of(&parts, &set).unwrap();
        assert!(table.cells.x > 60, "{}: too few cells to walk far", table.cells);
        for probe in 0..table.probes() {
            let (at, _) = table.locate(table.place_m(probe)).unwrap();
            assert!(table.vertices[at as usize].contains(&probe), "{probe} is not found at its own place");
        }
        for step in 0..2000 {
            let share = Vec3::new(step as f32, (step * 7 % 2000) as f32, (step * 13 % 2000) as f32) / 2000.0;
            let (at, shares) = table.locate(share * table.high_m).unwrap();
            let read: Vec3 =
                table.vertices[at as usize].iter().zip(shares).map(|(of, by)| table.place_m(*of) * by).sum();
            assert!(read.distance(share * table.high_m) < 1e-3, "{read}, not {}", share * table.high_m);
        }
    }

    #[test]
    fn corners_of_the_box_have_no_light_and_points_beyond_take_that_of_its_sides() {
        let (parts, set) = cut_box(IVec3::splat(4));
        let table = TetrahedraTable::of(&parts, &set).unwrap();
        let sum = |point_m: Vec3| table.around(point_m).iter().map(|(_, share)| share).sum::<f32>();
        assert!((sum(Vec3::splat(0.75)) - 1.0).abs() < 1e-5);
        assert!(sum(Vec3::splat(0.01)) < 0.1);
        assert!((sum(Vec3::new(-9.0, 0.75, 0.75)) - 1.0).abs() < 1e-5);
        assert!(table.wide(Vec3::splat(0.01)).len() >= 3);
        assert_eq!(table.around(Vec3::splat(f32::NAN)), []);
        assert_eq!(TetrahedraTable::default().around(Vec3::ZERO), []);
    }

    #[test]
    fn tetrahedra_that_contradict_the_field_are_refused() {
        let problem = |change: &dyn Fn(&mut TetrahedronSet)| {
            let (parts, mut set) = cut_box(IVec3::splat(4));
            change(&mut set);
            TetrahedraTable::of(&parts, &set).unwrap_err().to_string()
        };
        assert!(problem(&|set| set.probes += 1).contains("the field has"));
        assert!(problem(&|set| set.vertices = vec![[0, 3, 7, 11]]).contains("flat"));
        assert!(problem(&|set| set.vertices.push(set.vertices[3])).contains("one face in common"));
    }
}
