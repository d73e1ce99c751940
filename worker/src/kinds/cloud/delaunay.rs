//! Delaunay tetrahedra between points of a lattice in a box (\[Bowyer1981\], \[Watson1981\]).
//!
//! All is exact, as coordinates are whole numbers. Points of a lattice lie on common spheres everywhere; which tetrahedra are between them
//! is then decided as if each point's square were less by an amount that is the larger the smaller its key (\[Edelsbrunner1990\]). So the
//! result hangs on places and keys alone, not on the order of points, and far points change nothing near.

use glam::IVec3;
use thiserror::Error;

/// Largest difference of two coordinates for which determinants are those of 64 bits.
const SHORT: i32 = 1 << 10;
/// Largest coordinate.
pub const COORDINATE_MAX: i32 = 1 << 21;
/// No tetrahedron.
const NONE: u32 = u32::MAX;
/// Points of the first of rounds whose points double.
const ROUND_BITS: u32 = 16;

/// Points that have no tetrahedra.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum Degenerate {
    /// Two at one place.
    #[error("points {0} and {1} are at one place")]
    Doubled(u32, u32),
    /// One that is not within the box.
    #[error("point {0} is not within the box")]
    Outside(u32),
    /// A box that is flat or too large.
    #[error("the box is flat, or larger than {COORDINATE_MAX} steps")]
    Box,
}

/// Tetrahedra of points, all within a box, and of its corners, which come before them by key: the least, the greatest, then the others. Keys of points are distinct.
/// Vertices are numbers of points, then those of corners, x fastest; they ascend, and so do tetrahedra.
pub fn tetrahedra([low, high]: [IVec3; 2], points: &[(IVec3, u64)]) -> Result<Vec<[u32; 4]>, Degenerate> {
    let is_far =
        |at: IVec3| at.to_array().iter().any(|along| along.unsigned_abs() > COORDINATE_MAX.unsigned_abs());
    if low.cmpge(high).any() || is_far(low) || is_far(high) {
        return Err(Degenerate::Box);
    }
    let is_outside = |(at, _): &(IVec3, u64)| at.cmple(low).any() || at.cmpge(high).any();
    if let Some(outside) = points.iter().position(is_outside) {
        return Err(Degenerate::Outside(outside as u32));
    }
    let mut mesh = Mesh::of_box([low, high], points);
    for point in order(low, points) {
        mesh.insert(point).map_err(|other| Degenerate::Doubled(point.min(other), point.max(other)))?;
    }
    let mut found: Vec<[u32; 4]> = mesh.vertices.iter().copied().filter(|of| of[0] != NONE).collect();
    found.iter_mut().for_each(|of| of.sort_unstable());
    found.sort_unstable();
    Ok(found)
}

/// Points in the order in which they are inserted: rounds that double, each along a curve that keeps neighbours together (\[Amenta2003\]).
fn order(low: IVec3, points: &[(IVec3, u64)]) -> Vec<u32> {
    let place = |(index, (at, key)): (u32, &(IVec3, u64))| {
        let hash = (key ^ key >> 31).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let round = hash.leading_zeros().min(ROUND_BITS);
        let [x, y, z] = (*at - low).to_array().map(|along| spread(along as u64));
        (std::cmp::Reverse(round), x | y << 1 | z << 2, *key, index)
    };
    let mut all: Vec<_> = (0..).zip(points).map(place).collect();
    all.sort_unstable();
    all.into_iter().map(|(.., index)| index).collect()
}

/// Bits of a number, each followed by two of 0.
fn spread(number: u64) -> u64 {
    (0..22).fold(0, |all, bit| all | (number >> bit & 1) << (3 * bit))
}

/// A determinant of three rows.
fn determinant<T>(rows: [[T; 3]; 3]) -> T
where
    T: Copy + std::ops::Mul<Output = T> + std::ops::Add<Output = T> + std::ops::Sub<Output = T>,
{
    let [a, b, c] = rows;
    a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
}

/// Six times the volume of a tetrahedron.
fn volume(of: [IVec3; 4]) -> i128 {
    let [first, rest @ ..] = of;
    let rows = rest.map(|at| at - first);
    if rows.iter().all(|row| row.abs().max_element() <= SHORT) {
        return determinant(rows.map(|row| row.to_array().map(i64::from))).into();
    }
    determinant(rows.map(|row| row.to_array().map(i128::from)))
}

/// Six times the volume V of a tetrahedron, the same with a point in place of each vertex, and V times the point's power with respect to
/// the sphere through the vertices: below 0 within.
fn power(of: [IVec3; 4], point: IVec3) -> ([i128; 4], i128) {
    let [first, rest @ ..] = of;
    let (rows, to) = (rest.map(|at| at - first), point - first);
    macro_rules! by {
        ($number:ty) => {{
            let [b, c, d, e] = [rows[0], rows[1], rows[2], to].map(|row| row.to_array().map(<$number>::from));
            let square = |row: [$number; 3]| row[0] * row[0] + row[1] * row[1] + row[2] * row[2];
            let whole = determinant([b, c, d]);
            let parts = [determinant([e, c, d]), determinant([b, e, d]), determinant([b, c, e])];
            let sum = parts[0] * square(b) + parts[1] * square(c) + parts[2] * square(d);
            let first = whole - parts[0] - parts[1] - parts[2];
            ([first, parts[0], parts[1], parts[2]].map(i128::from), i128::from(whole * square(e) - sum))
        }};
    }
    if rows.iter().chain([&to]).all(|row| row.abs().max_element() <= SHORT) {
        return by!(i64);
    }
    by!(i128)
}

/// Tetrahedra while points are inserted.
struct Mesh {
    /// Points, then corners of the box.
    at: Vec<IVec3>,
    /// Keys of points plus 8, then those of corners.
    keys: Vec<u128>,
    /// Vertices of each, of positive volume; [`NONE`] of those that are gone.
    vertices: Vec<[u32; 4]>,
    /// Tetrahedra beyond the faces opposite to each vertex.
    beyond: Vec<[u32; 4]>,
    /// Point that was last found to be within the sphere of each (2n + 1) or not (2n).
    seen: Vec<u32>,
    free: Vec<u32>,
    /// A tetrahedron that is there.
    last: u32,
}

/// A face of the hole that a point leaves: the tetrahedron beyond, the one within, and the face's number there.
type Rim = (u32, u32, usize);

impl Mesh {
    /// A box without points: six tetrahedra about the diagonal, as its corners' keys have it.
    fn of_box([low, high]: [IVec3; 2], points: &[(IVec3, u64)]) -> Self {
        let first = points.len() as u32;
        let corner = |at: u32| {
            IVec3::new(
                if at & 1 == 0 { low.x } else { high.x },
                if at & 2 == 0 { low.y } else { high.y },
                if at & 4 == 0 { low.z } else { high.z },
            )
        };
        // The least corner, the greatest, then the others.
        let key = |at: u32| if at == 7 { 1 } else { u128::from(at + u32::from(at > 0)) };
        let at: Vec<IVec3> = points.iter().map(|(at, _)| *at).chain((0..8).map(corner)).collect();
        let keys = points.iter().map(|(_, key)| u128::from(*key) + 9).chain((0..8).map(key)).collect();
        let ways = [[1, 3], [2, 3], [2, 6], [4, 6], [4, 5], [1, 5]];
        let mut mesh = Self {
            at,
            keys,
            vertices: Vec::new(),
            beyond: vec![[NONE; 4]; ways.len()],
            seen: vec![NONE; ways.len()],
            free: Vec::new(),
            last: 0,
        };
        for [a, b] in ways {
            let mut of = [0, a, b, 7].map(|corner| first + corner);
            if volume(of.map(|vertex| mesh.at[vertex as usize])) < 0 {
                of.swap(1, 2);
            }
            mesh.vertices.push(of);
        }
        let faces: Vec<Rim> =
            (0..6).flat_map(|number| (0..4).map(move |side| (NONE, number, side))).collect();
        mesh.join(&faces);
        mesh
    }

    fn places(&self, tetrahedron: u32) -> [IVec3; 4] {
        self.vertices[tetrahedron as usize].map(|vertex| self.at[vertex as usize])
    }

    /// The tetrahedron that a point lies in, by a walk across faces that part it from the present one.
    fn locate(&self, point: IVec3) -> u32 {
        let (mut at, mut from) = (self.last, NONE);
        'walk: loop {
            let places = self.places(at);
            for side in 0..4 {
                let next = self.beyond[at as usize][side];
                if next == from || next == NONE {
                    continue;
                }
                let mut there = places;
                there[side] = point;
                if volume(there) < 0 {
                    (at, from) = (next, at);
                    continue 'walk;
                }
            }
            return at;
        }
    }

    /// Whether a point lies within the sphere through a tetrahedron's vertices; no point lies on one.
    fn is_within(&self, tetrahedron: u32, point: u32) -> bool {
        let (parts, power) = power(self.places(tetrahedron), self.at[point as usize]);
        if power != 0 {
            return power < 0;
        }
        let vertices = self.vertices[tetrahedron as usize];
        let mut by_key: [(u128, i128); 5] = [(self.keys[point as usize], -1); 5];
        for (slot, (vertex, part)) in by_key.iter_mut().zip(vertices.into_iter().zip(parts)) {
            *slot = (self.keys[vertex as usize], part);
        }
        by_key.sort_unstable_by_key(|of| of.0);
        by_key.into_iter().find(|of| of.1 != 0).is_some_and(|of| of.1 < 0)
    }

    /// Inserts a point: what has it within its sphere makes way for tetrahedra between the hole's faces and the point. Errs with the point
    /// that is there already.
    fn insert(&mut self, point: u32) -> Result<(), u32> {
        let place = self.at[point as usize];
        let start = self.locate(place);
        if let Some(&other) = self.vertices[start as usize].iter().find(|of| self.at[**of as usize] == place)
        {
            return Err(other);
        }
        let (mut hole, mut rims): (Vec<u32>, Vec<Rim>) = (vec![start], Vec::new());
        self.seen[start as usize] = 2 * point + 1;
        let mut next = 0;
        while let Some(&at) = hole.get(next) {
            next += 1;
            for side in 0..4 {
                let beside = self.beyond[at as usize][side];
                if beside != NONE {
                    if self.seen[beside as usize] >> 1 != point || self.seen[beside as usize] == NONE {
                        let is_within = self.is_within(beside, point);
                        self.seen[beside as usize] = 2 * point + u32::from(is_within);
                        if is_within {
                            hole.push(beside);
                        }
                    }
                    if self.seen[beside as usize] & 1 == 1 {
                        continue;
                    }
                }
                rims.push((beside, at, side));
            }
        }
        let made: Vec<Rim> =
            rims.iter().map(|&(beside, at, side)| (beside, self.make(at, side, point), side)).collect();
        for (&(beside, at, _), &(_, own, side)) in rims.iter().zip(&made) {
            self.beyond[own as usize][side] = beside;
            if beside != NONE {
                let back = self.beyond[beside as usize].iter_mut().find(|of| **of == at);
                back.into_iter().for_each(|of| *of = own);
            }
        }
        // The other faces, each of two of the new ones.
        let others = made.iter().flat_map(|&(_, own, side)| {
            (0..4).filter(move |other| *other != side).map(move |other| (NONE, own, other))
        });
        let others: Vec<Rim> = others.collect();
        self.join(&others);
        for gone in hole {
            self.vertices[gone as usize] = [NONE; 4];
            self.free.push(gone);
        }
        self.last = made[0].1;
        Ok(())
    }

    /// A tetrahedron like another, with a point in place of the vertex opposite to a face.
    fn make(&mut self, like: u32, side: usize, point: u32) -> u32 {
        let mut of = self.vertices[like as usize];
        of[side] = point;
        match self.free.pop() {
            Some(number) => {
                self.vertices[number as usize] = of;
                self.seen[number as usize] = NONE;
                number
            }
            None => {
                self.vertices.push(of);
                self.beyond.push([NONE; 4]);
                self.seen.push(NONE);
                self.vertices.len() as u32 - 1
            }
        }
    }

    /// Joins pairs of alike faces.
    fn join(&mut self, faces: &[Rim]) {
        let mut all: Vec<([u32; 3], u32, usize)> = Vec::with_capacity(faces.len());
        for &(_, number, side) in faces {
            let of = self.vertices[number as usize];
            let mut face = [of[(side + 1) % 4], of[(side + 2) % 4], of[(side + 3) % 4]];
            face.sort_unstable();
            all.push((face, number, side));
        }
        all.sort_unstable();
        for pair in all.windows(2).filter(|pair| pair[0].0 == pair[1].0) {
            let [(_, a, of_a), (_, b, of_b)] = [pair[0], pair[1]];
            self.beyond[a as usize][of_a] = b;
            self.beyond[b as usize][of_b] = a;
        }
    }
}

#[cfg(test)]
mod tests;
