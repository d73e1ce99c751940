//! Guesses of a receiver's value, from neighbouring texels that are stored before it.
//!
//! Coarse levels come first, so a finer texel mostly lies between two that are known already. Values of smooth
//! quantities are stored as differences from the mean of those.

use std::collections::BTreeMap;
use std::ops::Range;

use crate::content::{Receivers, Texel};

/// Most receivers that one is guessed from.
const SOURCES_MAX: usize = 4;
/// Pairs of opposite neighbours, in strides of the receiver's level: first the sides, then the corners.
const SIDES: [[[i32; 2]; 2]; 2] = [[[-1, 0], [1, 0]], [[0, -1], [0, 1]]];
const CORNERS: [[[i32; 2]; 2]; 2] = [[[-1, -1], [1, 1]], [[1, -1], [-1, 1]]];

/// Sources of every receiver read so far.
#[derive(Default)]
pub(super) struct Predictor {
    row_of: BTreeMap<(u16, Texel), u32>,
    sources: Vec<Sources>,
}

#[derive(Clone, Copy, Default)]
struct Sources {
    rows: [u32; SOURCES_MAX],
    count: usize,
}

impl Sources {
    fn push(&mut self, row: u32) {
        self.rows[self.count] = row;
        self.count += 1;
    }
}

impl Predictor {
    /// Of rows of which none says anything about another.
    pub fn none(rows: usize) -> Self {
        Self { sources: vec![Sources::default(); rows], ..Self::default() }
    }

    /// Takes in receivers `rows`, all of `level`, which follow those taken in before.
    pub fn extend(&mut self, receivers: &Receivers, rows: Range<usize>, level: u32) {
        for row in rows {
            let (block, texel) = (receivers.block[row], receivers.texel[row]);
            let mut sources = self.around(block, texel, 1 << level);
            if sources.count == 0 && row > 0 && receivers.block[row - 1] == block {
                sources.push(row as u32 - 1);
            }
            self.sources.push(sources);
            self.row_of.insert((block, texel), row as u32);
        }
    }

    /// Opposite sides, both known; else opposite corners, both known; else whatever side is known, else a corner.
    fn around(&self, block: u16, texel: Texel, stride: i32) -> Sources {
        let row_at = |offset: [i32; 2]| {
            let moved = |axis: usize| u16::try_from(i32::from(texel[axis]) + stride * offset[axis]).ok();
            self.row_of.get(&(block, [moved(0)?, moved(1)?])).copied()
        };
        let mut sources = Sources::default();
        for pairs in [SIDES, CORNERS] {
            for [one, other] in pairs {
                if let (Some(one), Some(other)) = (row_at(one), row_at(other)) {
                    sources.push(one);
                    sources.push(other);
                }
            }
            if sources.count > 0 {
                return sources;
            }
        }
        for pairs in [SIDES, CORNERS] {
            pairs
                .as_flattened()
                .iter()
                .filter_map(|&offset| row_at(offset))
                .for_each(|row| sources.push(row));
            if sources.count > 0 {
                return sources;
            }
        }
        sources
    }

    /// Guess of the value of receiver `row`: the rounded mean of its sources' `values`, or 0 without any.
    pub fn guess(&self, row: usize, values: &[i32]) -> i32 {
        let Sources { rows, count } = self.sources[row];
        if count == 0 {
            return 0;
        }
        let sum: i64 = rows[..count].iter().map(|&row| i64::from(values[row as usize])).sum();
        (sum + count as i64 / 2).div_euclid(count as i64) as i32
    }

    /// `values[row] − guess` for `rows`; `values` holds all receivers.
    pub fn differences(&self, rows: Range<usize>, values: &[i32]) -> Vec<i32> {
        rows.map(|row| values[row].wrapping_sub(self.guess(row, values))).collect()
    }

    /// Inverse of [`Self::differences`]: appends to `values`, which holds all receivers before `rows`.
    pub fn restore(&self, rows: Range<usize>, differences: &[i32], values: &mut Vec<i32>) {
        for (row, &difference) in rows.zip(differences) {
            values.push(self.guess(row, values).wrapping_add(difference));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(side: u16, levels: u32) -> (Receivers, Vec<Range<usize>>) {
        let mut texels: Vec<Texel> = (0..side).flat_map(|y| (0..side).map(move |x| [x, y])).collect();
        texels.sort_by_key(|&texel| {
            (levels - Receivers::level(texel, levels), super::super::order::morton(texel))
        });
        let level_of = |texel: &Texel| Receivers::level(*texel, levels);
        let mut ranges = Vec::new();
        for level in (0..levels).rev() {
            let first = texels.iter().filter(|texel| level_of(texel) > level).count();
            ranges.push(first..texels.iter().filter(|texel| level_of(texel) >= level).count());
        }
        (
            Receivers {
                blocks: vec![1],
                block: vec![0; texels.len()],
                texel: texels,
                ..Receivers::default()
            },
            ranges,
        )
    }

    #[test]
    fn a_linear_quantity_is_guessed_exactly_inside() {
        let (receivers, ranges) = grid(16, 3);
        let values: Vec<i32> =
            receivers.texel.iter().map(|t| 100 + 6 * i32::from(t[0]) - 4 * i32::from(t[1])).collect();
        let mut predictor = Predictor::default();
        let mut restored = Vec::new();
        for (level, rows) in (0..3).rev().zip(ranges) {
            predictor.extend(&receivers, rows.clone(), level);
            let differences = predictor.differences(rows.clone(), &values);
            predictor.restore(rows.clone(), &differences, &mut restored);
            let inside = |row: usize| receivers.texel[row].iter().all(|&x| x > 0 && x < 12);
            let wrong =
                rows.filter(|&row| inside(row)).filter(|&row| predictor.guess(row, &values) != values[row]);
            if level < 2 {
                assert_eq!(wrong.count(), 0, "level {level}");
            }
        }
        assert_eq!(restored, values);
    }

    #[test]
    fn extreme_differences_do_not_overflow() {
        let (receivers, ranges) = grid(4, 1);
        let values: Vec<i32> = (0..16).map(|i| if i % 2 == 0 { i32::MIN } else { i32::MAX }).collect();
        let mut predictor = Predictor::default();
        predictor.extend(&receivers, ranges[0].clone(), 0);
        let differences = predictor.differences(0..16, &values);
        let mut restored = Vec::new();
        predictor.restore(0..16, &differences, &mut restored);
        assert_eq!(restored, values);
    }
}
