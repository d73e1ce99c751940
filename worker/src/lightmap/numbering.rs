//! The table that a chunk names things by: distinct values, ascending, each called by its place.

/// Distinct values, ascending.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Numbering<T>(Vec<T>);

impl<T: Ord + Copy> Numbering<T> {
    /// Of all values given, each once.
    pub fn of(values: impl IntoIterator<Item = T>) -> Self {
        let mut values: Vec<T> = values.into_iter().collect();
        values.sort_unstable();
        values.dedup();
        Self(values)
    }

    /// Place of a value.
    ///
    /// Panics when the value is not among those given: whoever asks for it left it out, and any other number would be
    /// another surface's light.
    pub fn place(&self, value: T) -> usize {
        self.find(value).expect("a value that is asked for is in its table")
    }

    /// As [`Numbering::place`], as chunks hold it. Panics beyond 2¹⁶ values, which no cluster or batch has.
    pub fn place_u16(&self, value: T) -> u16 {
        self.place(value).try_into().expect("a chunk's table has at most 2^16 values")
    }

    /// Place of a value, if it is among those given.
    pub fn find(&self, value: T) -> Option<usize> {
        self.0.binary_search(&value).ok()
    }

    /// The values.
    pub fn values(&self) -> &[T] {
        &self.0
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// There are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The values as the chunk lists them.
    pub fn into_values(self) -> Vec<T> {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_numbered_in_ascending_order_each_once() {
        let table = Numbering::of([7, 3, 7, 5]);
        assert_eq!(table.values(), [3, 5, 7]);
        assert_eq!([3, 5, 7].map(|value| table.place_u16(value)), [0, 1, 2]);
        assert_eq!(table.find(4), None);
    }

    #[test]
    #[should_panic(expected = "is in its table")]
    fn absent_value_is_a_broken_invariant_and_not_the_first() {
        Numbering::of([3, 5]).place(4);
    }
}
