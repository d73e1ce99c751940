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
}

/// Ends of directions of some receivers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WalkedTable {
    /// Receivers.
    pub rows: Vec<WalkedRow>,
    /// Places in λ, receiver after receiver, ascending in each.
    pub places: Vec<u32>,
    /// Weight of each, `∫ cosθ dω`.
    pub weight: f32,
}

impl WalkedTable {
    /// Of receivers by slot, each with its ends; `weight` is that of each end.
    ///
    /// Errors for a receiver that has near hits, as both would be its whole light from near, and for more ends than 32 bits count.
    pub fn new(
        ends: impl IntoIterator<Item = (u32, Vec<u32>)>,
        weight: f32,
        near: &NearTable,
    ) -> Result<Self, Inconsistent> {
        let mut table = Self { weight, ..Self::default() };
        for (slot, mut places) in ends {
            let wrong = |problem: &str| Inconsistent::new(format!("receiver {slot}"), problem);
            if near.rows.binary_search_by_key(&slot, |row| row.slot).is_ok() {
                return Err(wrong("has near hits beside its walks"));
            }
            places.sort_unstable();
            let first = u32::try_from(table.places.len()).map_err(|_| wrong("has one end too many"))?;
            table.rows.push(WalkedRow { slot, first, count: places.len() as u32 });
            table.places.append(&mut places);
        }
        Ok(table)
    }

    /// There are none.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Writes `N(r) = w Σ λ` of its receivers into an array by slot, W·m⁻².
    pub fn gather(&self, parallel: &impl Parallel, lambda: &[Vec4], by_slot: &mut [Vec4]) {
        let sums = parallel.map(self.rows.len(), |row| {
            let row = &self.rows[row];
            let places = &self.places[row.first as usize..(row.first + row.count) as usize];
            let sum: Vec4 = places.iter().map(|place| lambda[*place as usize]).sum();
            self.weight * sum
        });
        self.rows.iter().zip(sums).for_each(|(row, sum)| by_slot[row.slot as usize] = sum);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::relight::{NearRow, Serial};

    #[test]
    fn receivers_get_the_light_of_their_ends_and_others_keep_theirs() {
        let ends = [(2, vec![3, 0, 3]), (0, Vec::new())];
        let table = WalkedTable::new(ends, 0.5, &NearTable::default()).unwrap();
        let lambda = [1.0, 7.0, 7.0, 10.0].map(Vec4::splat);
        let mut by_slot = vec![Vec4::splat(9.0); 3];
        table.gather(&Serial, &lambda, &mut by_slot);
        assert_eq!(by_slot, [0.0, 9.0, 10.5].map(Vec4::splat));
    }

    #[test]
    fn receiver_with_near_hits_is_refused() {
        let rows = vec![NearRow { slot: 2, ..NearRow::default() }];
        let near = NearTable { rows, ..NearTable::default() };
        let error = WalkedTable::new([(2, vec![0])], 0.5, &near).unwrap_err();
        assert!(error.to_string().contains("receiver 2"), "{error}");
    }
}
