//! Guesses of an element's plane, the place of its patch and its bits, from its normal and the elements before it. Whole numbers below 2⁵³
//! alone, so that decoders in any language guess the same.

use glam::IVec3;

use super::content::{Element, NormalCode, SUBS};
use crate::chunk::ChunkError;

/// Steps of octahedral coordinates to either side, and of planes in a side of a voxel.
const STEPS: i64 = 32_767;
/// Bits behind the point of a normal's length.
const LENGTH_BITS: u32 = 11;
/// Farthest voxel along an axis from whose plane another is guessed.
const REACH_MAX: i32 = 1023;
/// Slack of planes that touch a sub-voxel, in eighths of a step: they and normals are rounded.
const SLACK: i64 = 8;
/// Sheets that are remembered.
const SHEETS_MAX: usize = 255;
/// Number that tells an element whose normal no remembered sheet has.
pub(super) const NEW: usize = SHEETS_MAX;
/// Errors of guesses below this are of the same sheet.
const SAME_SHEET: u16 = 128;

/// A normal as a vector q of whole numbers, `|x| + |y| + |z| = 32767`.
#[derive(Clone, Copy)]
struct Octahedral {
    q: [i64; 3],
    /// r = ⌊2¹¹·|q|⌋.
    length: i64,
}

impl Octahedral {
    fn of(normal: NormalCode) -> Self {
        let [u, v] = normal.0.map(i64::from);
        let z = STEPS - u.abs() - v.abs();
        let fold = (-z).max(0);
        let toward = |at: i64| if at < 0 { at + fold } else { at - fold };
        let q = [toward(u), toward(v), z];
        let square: i64 = q.iter().map(|at| at * at).sum();
        Self { q, length: (square << (2 * LENGTH_BITS)).isqrt() }
    }

    /// q·w.
    fn dot(&self, w: IVec3) -> i64 {
        self.q.iter().zip(w.to_array()).map(|(q, w)| q * i64::from(w)).sum()
    }
}

/// ⌊a/b + ½⌋.
fn rounded(a: i64, b: i64) -> i64 {
    (2 * a + b).div_euclid(2 * b)
}

/// The plane of an element, and where it was met.
#[derive(Clone, Copy)]
pub(super) struct Sheet {
    /// Mean normal of the element.
    pub normal: NormalCode,
    /// Its plane.
    pub plane: i16,
    /// Its voxel.
    pub voxel: IVec3,
}

impl Sheet {
    /// Plane of an element of this sheet in `voxel`, `p + ⌊32767·2¹¹·q·(v₀ − v)/r + ½⌋`; 0 if it is too far off, or if the plane misses it.
    fn guess(&self, normal: &Octahedral, voxel: IVec3) -> i16 {
        let apart = self.voxel - voxel;
        if apart.to_array().iter().any(|at| at.abs() > REACH_MAX) {
            return 0;
        }
        let along = rounded((STEPS << LENGTH_BITS) * normal.dot(apart), normal.length);
        let plane = i64::from(self.plane) + along;
        if plane.abs() > STEPS { 0 } else { plane as i16 }
    }
}

/// The sheets of the elements before, the last one first.
#[derive(Default)]
pub(super) struct Sheets(Vec<Sheet>);

impl Sheets {
    /// Number of the sheet that an element is of: the first of its normal whose guess is near, else the first of its normal, else [`NEW`].
    pub fn number_of(&self, of: &Sheet) -> usize {
        let normal = Octahedral::of(of.normal);
        let is_near =
            |sheet: &Sheet| of.plane.wrapping_sub(sheet.guess(&normal, of.voxel)).unsigned_abs() < SAME_SHEET;
        let alike = || self.0.iter().enumerate().filter(|(_, sheet)| sheet.normal == of.normal);
        let near = alike().find(|(_, sheet)| is_near(sheet)).or_else(|| alike().next());
        near.map_or(NEW, |(number, _)| number)
    }

    /// Normal of a sheet, if there is one of that number.
    pub fn normal(&self, number: usize) -> Option<NormalCode> {
        self.0.get(number).map(|sheet| sheet.normal)
    }

    /// The error that there is no sheet of that number.
    pub fn unknown(&self, number: usize) -> ChunkError {
        let (value, max) = (number as u64 + 1, self.0.len() as u64);
        ChunkError::OutOfRange { section: "normals", what: "sheet + 1", value, min: 1, max }
    }

    /// Normal of the last element, by which a new one is told.
    pub fn last_normal(&self) -> NormalCode {
        self.normal(0).unwrap_or_default()
    }

    /// Plane of an element of a sheet, or of one with a new normal.
    pub fn guess(&self, number: usize, normal: NormalCode, voxel: IVec3) -> i16 {
        let sheet = self.0.get(if number == NEW { 0 } else { number });
        sheet.map_or(0, |sheet| sheet.guess(&Octahedral::of(normal), voxel))
    }

    /// Takes note of an element of the sheet `number` whose guess was off by `error`.
    pub fn note(&mut self, number: usize, error: i16, of: Sheet) {
        if number < self.0.len() && error.unsigned_abs() < SAME_SHEET {
            self.0.remove(number);
        }
        self.0.truncate(SHEETS_MAX - 1);
        self.0.insert(0, of);
    }
}

/// Sub-voxels that a plane touches: those s with `|q·(2s − 3) − ⌊8·p·r/(2¹¹·32767) + ½⌋| ≤ 32767 + 8`.
pub(super) fn bits_of_plane(normal: NormalCode, plane: i16) -> u64 {
    let normal = Octahedral::of(normal);
    let height = rounded(8 * i64::from(plane) * normal.length, STEPS << LENGTH_BITS);
    let along = normal.q.map(|q| [-3, -1, 1, 3].map(|at| q * at));
    (0..64).fold(0, |bits, sub: usize| {
        let apart = along[0][sub & 3] + along[1][sub >> 2 & 3] + along[2][sub >> 4] - height;
        bits | u64::from(apart.abs() <= STEPS + SLACK) << sub
    })
}

/// Sub-voxels of a column along `axis`: it is one of S = `side` cells along each of the two axes after that.
pub(super) fn bits_of_column(side: u32, column: [u32; 2], axis: usize) -> u64 {
    /// The first layer across each axis, and how far the next one is.
    const LAYERS: [(u64, u32); 3] = [(0x1111_1111_1111_1111, 1), (0x000f_000f_000f_000f, 4), (0xffff, 16)];
    let bits = |at: u32, axis: usize| {
        let (layer, step) = LAYERS[axis % 3];
        let subs = at * SUBS as u32 / side..((at + 1) * SUBS as u32).div_ceil(side);
        subs.fold(0, |bits, sub| bits | layer << (step * sub))
    };
    bits(column[0], axis + 1) & bits(column[1], axis + 2)
}

/// Direction that an element's patch is taken to have: that of the longest part of its normal, of equal ones the first.
pub(super) fn direction_guess(normal: NormalCode) -> u8 {
    let q = Octahedral::of(normal).q;
    let longest =
        (1..3).fold(0, |longest, axis| if q[axis].abs() > q[longest].abs() { axis } else { longest });
    2 * longest as u8 + u8::from(q[longest] < 0)
}

/// Cell, of S along a side of the voxel, in which an element's plane meets the middle of a column along `axis`; as for [`bits_of_column`]:
/// `⌊(⌊2·S·p·r/(2¹¹·32767) + ½⌋ − q_b (2 b + 1 − S) − q_c (2 c + 1 − S) + S q_a)/2 q_a⌋`, of −S…2 S − 1 the nearest; 0 if q_a is.
pub(super) fn cell_guess(element: &Element, side: u32, column: [u32; 2], axis: usize) -> i64 {
    let (normal, side) = (Octahedral::of(element.normal), i64::from(side));
    let height = rounded(2 * side * i64::from(element.plane) * normal.length, STEPS << LENGTH_BITS);
    let [a, b, c] = [0, 1, 2].map(|after| normal.q[(axis + after) % 3]);
    if a == 0 {
        return 0;
    }
    let [at_b, at_c] = column.map(|at| 2 * i64::from(at) + 1 - side);
    let top = height - b * at_b - c * at_c + side * a;
    (top * a.signum()).div_euclid(2 * a.abs()).clamp(-side, 2 * side - 1)
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Vec3};

    use super::*;
    use crate::voxels::sub_in_voxel;

    fn bits_where(is_in: impl Fn(IVec3) -> bool) -> u64 {
        let range = || 0..SUBS;
        let subs = range().flat_map(|z| range().flat_map(move |y| range().map(move |x| IVec3::new(x, y, z))));
        subs.filter(|&sub| is_in(sub)).fold(0, |bits, sub| bits | 1 << sub_in_voxel(sub))
    }

    #[test]
    fn planes_are_guessed_within_a_few_steps_of_what_a_plane_in_space_has() {
        for index in 0..500 {
            let n = crate::harmonics::relight_direction(index, 512).as_dvec3();
            let normal = NormalCode::of(n);
            let point = DVec3::new(0.3, -0.2, 0.4);
            let of = |voxel: IVec3| {
                let height = n.dot(point - voxel.as_dvec3());
                Sheet { normal, plane: Element::plane_code(height, 1.0), voxel }
            };
            let from = of(IVec3::ZERO);
            for voxel in [IVec3::new(1, 0, 0), IVec3::new(0, -1, 1), IVec3::new(-1, 2, 0)] {
                let wanted = n.dot(point - voxel.as_dvec3()) * STEPS as f64;
                if wanted.abs() < 0.99 * STEPS as f64 {
                    let guess = from.guess(&Octahedral::of(normal), voxel);
                    assert!(
                        (f64::from(guess) - wanted).abs() < 10.0,
                        "{n} {voxel}: {guess}, wanted {wanted}"
                    );
                }
            }
        }
    }

    #[test]
    fn sheets_side_by_side_are_told_apart_and_the_last_of_many_are_remembered() {
        let sheet = |plane: i16| Sheet {
            normal: NormalCode::of(DVec3::Z),
            plane,
            voxel: IVec3::new(i32::from(plane) / 10, 0, 0),
        };
        let mut sheets = Sheets::default();
        for plane in [0, 9000, 10, 9010, 20] {
            let number = sheets.number_of(&sheet(plane));
            let error = plane.wrapping_sub(sheets.guess(number, sheet(plane).normal, sheet(plane).voxel));
            sheets.note(number, error, sheet(plane));
        }
        assert_eq!(sheets.0.iter().map(|sheet| sheet.plane).collect::<Vec<_>>(), [20, 9010]);
        for u in 0..300 {
            let new = Sheet { normal: NormalCode([u, 1]), ..sheet(0) };
            assert_eq!(sheets.number_of(&new), NEW);
            sheets.note(NEW, 0, new);
        }
        assert_eq!((sheets.0.len(), sheets.last_normal()), (SHEETS_MAX, NormalCode([299, 1])));
    }

    #[test]
    fn a_plane_touches_the_sub_voxels_that_it_passes_through_and_those_it_ends_on() {
        let z = NormalCode::of(DVec3::Z);
        let layer = |sub: u32| 0xffff_u64 << (16 * sub);
        assert_eq!(bits_of_plane(z, 0), layer(1) | layer(2), "between two");
        assert_eq!(bits_of_plane(z, Element::plane_code(0.25, 1.0)), layer(2) | layer(3));
        assert_eq!(bits_of_plane(z, Element::plane_code(0.1, 1.0)), layer(2));
        let slanted = NormalCode::of(DVec3::new(1.0, 1.0, 0.0).normalize());
        assert_eq!(bits_of_plane(slanted, 0).count_ones(), 4 * 10, "a diagonal with both sides of it");
        for index in 0..200 {
            let n = crate::harmonics::relight_direction(index, 256);
            let bits = bits_of_plane(NormalCode::of(n.as_dvec3()), Element::plane_code(0.21, 1.0));
            let over = |sub: IVec3| {
                let middle = (sub.as_vec3() - Vec3::splat(1.5)) / 4.0;
                (n.dot(middle) - 0.21).abs() - n.abs().element_sum() / 8.0
            };
            assert_eq!(bits & bits_where(|sub| over(sub) > 3e-4), 0, "{n}");
            assert_eq!(!bits & bits_where(|sub| over(sub) < -3e-4), 0, "{n}");
        }
    }

    #[test]
    fn columns_of_cells_fill_a_voxel() {
        for side in 1..9 {
            let column = |at: u32| bits_of_column(side, [at % side, at / side], 1);
            assert_eq!((0..side * side).fold(0, |bits, at| bits | column(at)), u64::MAX);
        }
        assert_eq!(bits_of_column(2, [1, 0], 2), 0x00cc_00cc_00cc_00cc);
        assert_eq!(
            bits_of_column(64, [63, 0], 2),
            0x0008_0008_0008_0008,
            "a fine cell has the sub-voxel around it"
        );
        assert_eq!(bits_of_column(4, [0, 3], 0), 0xf << 48, "y, then z");
    }

    #[test]
    fn a_plane_meets_the_middle_of_a_column_where_it_is_guessed_to() {
        for index in 0..300 {
            let n = crate::harmonics::relight_direction(index, 512).as_dvec3();
            let normal = NormalCode::of(n);
            let direction = direction_guess(normal);
            let axis = usize::from(direction / 2);
            assert!(n[axis].abs() >= n.abs().max_element() - 1e-4 && (n[axis] < 0.0) == (direction % 2 == 1));
            let plane = Element::plane_code(0.23, 1.0);
            let element =
                Element { normal, plane, bits: 1, patch: None, glow: 0, is_backed: false, is_finest: false };
            let mut middle = DVec3::ZERO;
            middle[(axis + 1) % 3] = 5.0 / 8.0 - 0.5;
            middle[(axis + 2) % 3] = 1.0 / 8.0 - 0.5;
            let wanted = 4.0 * ((0.23 - n.dot(middle)) / n[axis] + 0.5);
            let guess = cell_guess(&element, 4, [2, 0], axis);
            let far = (wanted - guess as f64 - 0.5).abs();
            assert!(far < 0.501 || (guess == -4 || guess == 7), "{n}: {guess}, wanted {wanted}");
        }
    }
}
