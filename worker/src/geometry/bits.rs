//! A set of small whole numbers that threads add to at once.

use std::cell::Cell;
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
        numbers(self.0.iter().map(|word| word.load(Ordering::Relaxed)))
    }
}

/// Such a set that one thread adds to, without the lock of the bus that others cost.
#[derive(Debug, Default)]
pub struct OwnBits(Vec<Cell<u64>>);

impl OwnBits {
    /// Nothing of the numbers below `len`.
    pub fn new(len: usize) -> Self {
        Self(vec![Cell::new(0); len.div_ceil(WORD)])
    }

    /// Adds a number.
    pub fn add(&self, number: usize) {
        let word = &self.0[number / WORD];
        word.set(word.get() | 1 << (number % WORD));
    }

    /// Whether a number is in it.
    pub fn has(&self, number: usize) -> bool {
        self.0[number / WORD].get() >> (number % WORD) & 1 == 1
    }

    /// The numbers, ascending.
    pub fn iter(&self) -> impl Iterator<Item = usize> + '_ {
        numbers(self.0.iter().map(Cell::get))
    }
}

/// Numbers of the bits of words, ascending.
fn numbers(words: impl Iterator<Item = u64>) -> impl Iterator<Item = usize> {
    words.enumerate().flat_map(|(index, all)| {
        let first = (all != 0).then_some(all);
        let left = std::iter::successors(first, |word| Some(word & (word - 1)).filter(|left| *left != 0));
        left.map(move |word| index * WORD + word.trailing_zeros() as usize)
    })
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
        let own = OwnBits::new(1000);
        (0..1000).rev().filter(|number| number % 3 == 0).for_each(|number| own.add(number));
        assert!(own.iter().eq(bits.iter()) && own.has(999) && !own.has(998));
        assert_eq!(Bits::new(0).iter().count(), 0);
    }
}
