//! Order of ΣVᵀ's columns in a rank, where each key has one: those that were large in the ranks before come first. Cells then
//! hold numbers of one size, and nothing has to be said of the order.

/// Bits of a column's size below one code.
const SIZE_BITS: u32 = 4;
/// Of its size a column loses `2⁻³` from rank to rank: some eight ranks count.
const FADING_BITS: u32 = 3;
/// The order is made anew at ranks that are multiples of this, and at the second and third rank.
const RENEWED_EVERY: usize = 4;

/// Order of columns, from rank to rank.
#[derive(Clone, Debug, Default)]
pub(super) struct ColumnOrder {
    /// Columns, largest first.
    order: Vec<u32>,
    /// Of each column, by key.
    sizes: Vec<u32>,
    rank: usize,
}

impl ColumnOrder {
    /// That of the first rank: by key.
    pub fn new(columns: usize) -> Self {
        Self { order: (0..columns as u32).collect(), sizes: vec![0; columns], rank: 0 }
    }

    /// The columns of the present rank, in stored order.
    pub fn columns(&self) -> &[u32] {
        &self.order
    }

    /// Goes on to the next rank, `codes` being the present rank's, by key.
    pub fn advance(&mut self, codes: &[i32]) {
        for (size, code) in self.sizes.iter_mut().zip(codes) {
            let own = code.unsigned_abs().min(u32::MAX >> (SIZE_BITS + FADING_BITS + 1)) << SIZE_BITS;
            *size = *size - (*size >> FADING_BITS) + own;
        }
        self.rank += 1;
        if self.rank < 3 || self.rank.is_multiple_of(RENEWED_EVERY) {
            // Of columns of one size, those whose keys are near stay together.
            self.order.sort_unstable_by_key(|&column| (u32::MAX - self.sizes[column as usize], column));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_that_were_large_come_first_and_others_by_key() {
        let mut order = ColumnOrder::new(4);
        assert_eq!(order.columns(), [0, 1, 2, 3]);
        order.advance(&[0, -5, 0, 7]);
        assert_eq!(order.columns(), [3, 1, 0, 2]);
        order.advance(&[0, 0, 9, 0]);
        assert_eq!(order.columns(), [2, 3, 1, 0]);
        order.advance(&[100, 0, 0, 0]);
        assert_eq!(order.columns(), [2, 3, 1, 0], "of the third rank on, every fourth time");
        order.advance(&[100, 0, 0, 0]);
        assert_eq!(order.columns(), [0, 2, 3, 1]);
    }

    #[test]
    fn no_code_is_too_large() {
        let mut order = ColumnOrder::new(2);
        (0..100).for_each(|_| order.advance(&[i32::MIN, i32::MAX]));
        assert_eq!(order.columns(), [0, 1]);
    }
}
