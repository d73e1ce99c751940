//! A set of small whole numbers that threads add to at once.

use std::sync::atomic::{AtomicU64, Ordering};

/// Bits of a word.
const WORD: usize = 64;

/// The set. The order of additions does not matter.
#[derive(Debug, Default)]
pub struct Bits(Vec<AtomicU64>);

impl Bits {
    /// Nothing of the numbers below `len`.
    pub fn new(len: usize) -> Self {
        Self((0..len.div_ceil(WORD)).map(|_| AtomicU64::new(0)).collect())
    }

    /// Adds a number.
    pub fn add(&self, number: usize) {
        // Most are there already: a look costs less than a write.
        if !self.has(number) {
            self.0[number / WORD].fetch_or(1 << (number % WORD), Ordering::Relaxed);
        }
    }

    /// Whether a number is in it.
    pub fn has(&self, number: usize) -> bool {
        self.0[number / WORD].load(Ordering::Relaxed) >> (number % WORD) & 1 == 1
    }

    /// The numbers, ascending.
    pub fn iter(&self) -> impl Iterator<Item = usize> + '_ {
        let of_word = |(index, word): (usize, &AtomicU64)| {
            let word = word.load(Ordering::Relaxed);
            (0..WORD).filter(move |bit| word >> bit & 1 == 1).map(move |bit| index * WORD + bit)
        };
        self.0.iter().enumerate().flat_map(of_word)
    }
}

#[cfg(test)]
mod tests {
    use rayon::prelude::*;

    use super::*;

    #[test]
    fn numbers_that_threads_add_come_back_once_and_ascending() {
        let bits = Bits::new(1000);
        (0..5000_usize).into_par_iter().for_each(|number| bits.add(number * 7 % 1000 / 3 * 3));
        assert!(bits.iter().eq((0..1000).step_by(3)));
        assert_eq!(Bits::new(0).iter().count(), 0);
    }
}
