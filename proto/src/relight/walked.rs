//! Irradiance that receivers get along directions whose ends are known, as by walks: each has the radiance of one number of λ.

use glam::Vec4;

use super::{Inconsistent, NearTable, Parallel};

/// The ends of one receiver's directions as shaders read them.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct WalkedRow {
    /// Slot of the receiver.
    pub slot: u32,
    /// First of its ends.
    pub first: u32,
    /// Its ends; those in the dark are none.
    pub count: u32,
    /// 1 where it has near hits, to whose light that of the ends is added; else 0.
    pub has_near: u32,
}

/// Bit of an end whose light is taken away: factors have it, and it does not come any more.
pub const TAKEN: u32 = 1 << 31;

/// Ends of directions of some receivers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WalkedTable {
    /// Receivers.
    pub rows: Vec<WalkedRow>,
    /// Places in λ, receiver after receiver, with [`TAKEN`].
    pub places: Vec<u32>,
    /// Weight of each, `∫ cosθ dω`.
    pub weight: f32,
}

/// Ends of one receiver's directions.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ends {
    /// Slot of the receiver.
    pub slot: u32,
    /// Places in λ whose light is added, ascending.
    pub added: Vec<u32>,
    /// Those whose light is taken away, ascending.
    pub taken: Vec<u32>,
}

impl Ends {
    /// Neither adds nor takes.
    pub fn is_empty(&self) -> bool {
        self.added.is_empty() && self.taken.is_empty()
    }
}

impl WalkedTable {
    /// Of receivers with their ends; `weight` is that of each end.
    ///
    /// Errors for more ends than 32 bits count, or in more places than 31 bits do.
    pub fn new(
        ends: impl IntoIterator<Item = Ends>,
        weight: f32,
        near: &NearTable,
    ) -> Result<Self, Inconsistent> {
        let mut table = Self { weight, ..Self::default() };
        for Ends { slot, added, taken } in ends {
            let wrong = |problem: &str| Inconsistent::new(format!("receiver {slot}"), problem);
            if added.iter().chain(&taken).any(|place| place & TAKEN != 0) {
                return Err(wrong("has light of a place beyond the limit"));
            }
            let first = u32::try_from(table.places.len()).map_err(|_| wrong("has one end too many"))?;
            let count = (added.len() + taken.len()) as u32;
            let has_near = near.rows.binary_search_by_key(&slot, |row| row.slot).is_ok().into();
            table.rows.push(WalkedRow { slot, first, count, has_near });
            table.places.extend(added);
            table.places.extend(taken.into_iter().map(|place| place | TAKEN));
        }
        Ok(table)
    }

    /// There are none.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Adds `w Σ ±λ` of its receivers to an array by slot, W·m⁻², which holds the light of near hits.
    pub fn gather(&self, parallel: &impl Parallel, lambda: &[Vec4], by_slot: &mut [Vec4]) {
        let sums = parallel.map(self.rows.len(), |row| {
            let row = &self.rows[row];
            let places = &self.places[row.first as usize..(row.first + row.count) as usize];
            let signed = |place: &u32| {
                let light = lambda[(place & !TAKEN) as usize];
                if place & TAKEN != 0 { -light } else { light }
            };
            let sum: Vec4 = places.iter().map(signed).sum();
            self.weight * sum
        });
        self.rows.iter().zip(sums).for_each(|(row, sum)| by_slot[row.slot as usize] += sum);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::relight::{NearRow, Serial};

    #[test]
    fn receivers_get_the_light_of_their_ends_beside_that_of_near_hits() {
        let rows = vec![NearRow { slot: 2, ..NearRow::default() }];
        let near = NearTable { rows, ..NearTable::default() };
        let ends =
            [Ends { slot: 2, added: vec![0, 3, 3], taken: vec![1] }, Ends { slot: 0, ..Ends::default() }];
        let table = WalkedTable::new(ends, 0.5, &near).unwrap();
        assert_eq!(table.rows.iter().map(|row| row.has_near).collect::<Vec<_>>(), [1, 0]);
        let lambda = [1.0, 7.0, 7.0, 10.0].map(Vec4::splat);
        let mut by_slot = [0.0, 9.0, 2.0].map(Vec4::splat);
        table.gather(&Serial, &lambda, &mut by_slot);
        assert_eq!(by_slot, [0.0, 9.0, 9.0].map(Vec4::splat));
    }

    #[test]
    fn place_that_would_read_as_taken_away_is_refused() {
        let ends = Ends { slot: 3, added: vec![TAKEN], taken: Vec::new() };
        let error = WalkedTable::new([ends], 0.5, &NearTable::default()).unwrap_err();
        assert!(error.to_string().contains("receiver 3"), "{error}");
    }
}
