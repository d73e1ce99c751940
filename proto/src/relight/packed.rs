//! Factors as run times keep them: whole numbers of a step in as few bits as hold them.
//!
//! Chunks store whole numbers, and most are small: of ΣVᵀ two thirds are 0, and most columns have none above 7. So memory and
//! bandwidth are a fifth of what f32 would take. A number that is no multiple of its step, as in factors that no chunk has stored, is
//! kept as f32.
//!
//! A *group* is eight numbers: those of eight ranks in a row, of one column of ΣVᵀ or one row of U; 0 stands behind the last rank.
//! ```text
//! bits      words   in each word, the lowest first
//! 4         1       eight numbers
//! 8         2       four
//! 16        4       two
//! f32       8       one
//!
//! ΣVᵀ       for each eight ranks, for each column: a group. Columns that need f32 or 16 bits come first, then those of 8, then of 4
//! U         for each eight ranks, for each row: a group. The first ranks are wide: 16 bits or f32; all others have 8
//! ```

use super::clusters::Cluster;

/// Numbers of a group.
pub const GROUP: usize = 8;
/// Words of a group by its bits.
const OF_4: usize = 1;
const OF_8: usize = 2;
const OF_16: usize = 4;
const OF_F32: usize = 8;

/// Numbers of a group.
pub(super) type Group = [f32; GROUP];

/// Where a cluster's factor lies, and which of its groups are wide.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Packing {
    /// First word.
    pub first: usize,
    /// Words.
    pub len: usize,
    /// Columns of ΣVᵀ, or groups of ranks of U, that are wide: the first.
    pub wide: usize,
    /// Words of each group of these: 4 for 16-bit numbers, 8 for f32.
    pub wide_words: usize,
    /// Columns of ΣVᵀ behind these whose numbers have 8 bits; those of the others have 4.
    pub bytes: usize,
}

/// The whole number whose product with step and scale is `value` to the bit; else the quotient.
pub fn number_of(value: f32, step: f32, scale: f32) -> f32 {
    let quotient = value / (step * scale);
    let whole = quotient.round();
    if whole * step * scale == value { whole } else { quotient }
}

/// A step that numbers can be divided by: 1 where there is none.
pub fn step_of(steps: &[f32], rank: usize) -> f32 {
    steps.get(rank).copied().filter(|step| *step > 0.0).unwrap_or(1.0)
}

/// Words of a group that holds a number.
fn words_for(number: f32) -> usize {
    let fits = |most: f32| number.fract() == 0.0 && number.abs() <= most;
    match () {
        () if fits(7.0) => OF_4,
        () if fits(127.0) => OF_8,
        () if fits(32_767.0) => OF_16,
        () => OF_F32,
    }
}

/// Appends a group in so many words.
fn put(words: &mut Vec<u32>, numbers: Group, count: usize) {
    if count == OF_F32 {
        words.extend(numbers.map(f32::to_bits));
        return;
    }
    let bits = 32 * count / GROUP;
    for in_word in numbers.chunks(GROUP / count) {
        let parts = in_word.iter().zip(0..).map(|(number, place)| {
            let part = *number as i32 as u32 & u32::MAX >> (32 - bits);
            part << (place * bits)
        });
        words.push(parts.fold(0, |word, part| word | part));
    }
}

/// Reads a group of so many words.
fn take(words: &[u32]) -> Group {
    let count = words.len();
    if let Ok(all) = <[u32; GROUP]>::try_from(words) {
        return all.map(f32::from_bits);
    }
    let (bits, in_word) = (32 * count / GROUP, GROUP / count);
    std::array::from_fn(|index| {
        let above = 32 - bits * (index % in_word + 1);
        ((words[index / in_word] << above) as i32 >> (32 - bits)) as f32
    })
}

/// Eight numbers, the first `count` given and 0 behind them.
fn group(count: usize, of: impl Fn(usize) -> f32) -> Group {
    std::array::from_fn(|index| if index < count { of(index) } else { 0.0 })
}

/// Words of each group of a column of ΣVᵀ.
fn words_of_column(rank: usize, number: impl Fn(usize) -> f32) -> usize {
    (0..rank).map(|i| words_for(number(i))).max().unwrap_or(OF_4)
}

/// Order in which the columns of ΣVᵀ are packed: those of the widest class first, of these those of the highest levels, so that
/// a level of detail reads the first of each class.
pub fn column_order(
    [columns, rank]: [usize; 2],
    levels: &[u8],
    number: impl Fn(usize, usize) -> f32,
) -> Vec<usize> {
    // Columns of 16 bits and of f32 are one class.
    let class = |column: &usize| words_of_column(rank, |i| number(i, *column)).min(OF_16);
    let mut order: Vec<usize> = (0..columns).collect();
    order.sort_by_cached_key(|column| std::cmp::Reverse((class(column), levels[*column])));
    order
}

/// Appends ΣVᵀ of so many columns and ranks; `number` is that of a rank and a column, which stand in [`column_order`].
pub fn pack_vt(
    words: &mut Vec<u32>,
    [columns, rank]: [usize; 2],
    number: impl Fn(usize, usize) -> f32,
) -> Packing {
    let needed: Vec<usize> =
        (0..columns).map(|column| words_of_column(rank, |i| number(i, column))).collect();
    let wide = needed.iter().filter(|words| **words > OF_8).count();
    let bytes = needed.iter().filter(|words| **words == OF_8).count();
    let wide_words = needed.iter().copied().max().unwrap_or(OF_4).max(OF_16);
    let first = words.len();
    for of_ranks in (0..rank).step_by(GROUP) {
        for (column, &count) in needed.iter().enumerate() {
            let numbers = group(rank - of_ranks, |i| number(of_ranks + i, column));
            put(words, numbers, if count > OF_8 { wide_words } else { count });
        }
    }
    Packing { first, len: words.len() - first, wide, wide_words, bytes }
}

/// Appends U of so many ranks and rows; `number` is that of a row and a rank.
pub fn pack_u(
    words: &mut Vec<u32>,
    [rank, rows]: [usize; 2],
    number: impl Fn(usize, usize) -> f32,
) -> Packing {
    let needed = |of_ranks: usize| {
        let numbers = (of_ranks..rank.min(of_ranks + GROUP)).flat_map(|i| (0..rows).map(move |row| (row, i)));
        numbers.map(|(row, i)| words_for(number(row, i))).max().unwrap_or(OF_8)
    };
    let needed: Vec<usize> = (0..rank).step_by(GROUP).map(needed).collect();
    let wide = needed.iter().rposition(|words| *words > OF_8).map_or(0, |last| last + 1);
    let wide_words = needed.iter().copied().max().unwrap_or(OF_8).max(OF_16);
    let first = words.len();
    for (index, of_ranks) in (0..rank).step_by(GROUP).enumerate() {
        for row in 0..rows {
            let numbers = group(rank - of_ranks, |i| number(row, of_ranks + i));
            put(words, numbers, if index < wide { wide_words } else { OF_8 });
        }
    }
    Packing { first, len: words.len() - first, wide, wide_words, bytes: 0 }
}

impl Cluster {
    /// Its columns by the bits of their numbers: wide ones, those of 8, those of 4.
    pub(super) fn classes(&self) -> [std::ops::Range<usize>; 3] {
        let Packing { wide, bytes, .. } = self.vt;
        [0..wide, wide..wide + bytes, wide + bytes..self.column_count]
    }

    /// Groups of ranks.
    pub fn groups(&self) -> usize {
        self.rank.div_ceil(GROUP)
    }

    /// A group of ranks of ΣVᵀ at a column.
    pub(super) fn vt_numbers(&self, words: &[u32], group: usize, column: usize) -> Group {
        let Packing { first, len, wide, wide_words, bytes } = self.vt;
        let of_group = first + group * (len / self.groups());
        let (at, count) = if column < wide {
            (column * wide_words, wide_words)
        } else if column < wide + bytes {
            (wide * wide_words + (column - wide) * OF_8, OF_8)
        } else {
            (wide * wide_words + bytes * OF_8 + (column - wide - bytes) * OF_4, OF_4)
        };
        take(&words[of_group + at..][..count])
    }

    /// A group of ranks of U at a row, which counts from the cluster's first.
    pub(super) fn u_numbers(&self, words: &[u32], group: usize, row: usize) -> Group {
        let Packing { first, wide, wide_words, .. } = self.u;
        let (at, count) = if group < wide {
            ((group * self.row_count + row) * wide_words, wide_words)
        } else {
            let before = (wide * wide_words + (group - wide) * OF_8) * self.row_count;
            (before + row * OF_8, OF_8)
        };
        take(&words[first + at..][..count])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_numbers_of_a_step_are_found_to_the_bit_and_others_kept() {
        for (step, scale) in [(0.001_f32, 1.0_f32), (3.7e-5, 1.189_207_1), (1.0e12, 8.0), (1.0, 1.0)] {
            for code in [-32_767, -128, -1, 0, 1, 77, 5_000, 1 << 20] {
                assert_eq!(
                    number_of(code as f32 * step * scale, step, scale),
                    code as f32,
                    "{code} of {step}"
                );
            }
        }
        assert_eq!(number_of(0.3, 1.0, 1.0), 0.3);
        assert_eq!([step_of(&[0.0, 2.0], 0), step_of(&[0.0, 2.0], 1), step_of(&[], 0)], [1.0, 2.0, 1.0]);
    }

    #[test]
    fn levels_fall_within_each_class_though_wide_columns_need_16_bits_or_f32() {
        let numbers = [0.5_f32, 300.0, 0.25, 200.0, 20.0, 30.0, 1.0, 2.0];
        let levels = [2_u8, 9, 5, 0, 3, 4, 1, 7];
        let order = column_order([numbers.len(), 1], &levels, |_, column| numbers[column]);
        assert_eq!(order, [1, 2, 0, 3, 5, 4, 7, 6]);
        let mut words = Vec::new();
        let vt = pack_vt(&mut words, [numbers.len(), 1], |_, column| numbers[order[column]]);
        assert_eq!((vt.wide, vt.wide_words, vt.bytes), (4, OF_F32, 2));
        let cluster = Cluster { rank: 1, column_count: numbers.len(), vt, ..Cluster::default() };
        for class in cluster.classes() {
            let of_class: Vec<u8> = order[class].iter().map(|column| levels[*column]).collect();
            assert!(of_class.is_sorted_by(|a, b| a >= b), "{of_class:?}");
        }
        for (column, of) in order.iter().enumerate() {
            assert_eq!(cluster.vt_numbers(&words, 0, column)[0], numbers[*of]);
        }
    }

    #[test]
    fn numbers_come_back_from_the_fewest_words_that_hold_them() {
        let (columns, rank, rows) = (7, 11, 3);
        let cases =
            [(100.0, 2, OF_16), (128.0, 3, OF_16), (-32_767.0, 3, OF_16), (0.5, 3, OF_F32), (1e6, 3, OF_F32)];
        for (largest, wide, wide_words) in cases {
            // Two columns need 16 bits, two 8, two 4, and the last one what `largest` needs.
            let given = |i: usize, column: usize| match (i, column) {
                (9, 6) => largest,
                (_, 6) => 0.0,
                (i, column) => (i as f32 - 5.0) * [200.0, 1.0, 20.0, 0.0, -20.0, 300.0][column],
            };
            let order = column_order([columns, rank], &[0, 1, 5, 9, 0, 7, 3], given);
            let of_class = |class: &[usize]| class.iter().all(|column| order.contains(column));
            assert!(
                of_class(&order) && order.iter().position(|c| *c == 5) < order.iter().position(|c| *c == 0)
            );
            let of_vt = |i: usize, column: usize| given(i, order[column]);
            let of_u =
                |row: usize, i: usize| if [row, i] == [2, 3] { largest } else { row as f32 - i as f32 };
            let mut words = vec![7; 3];
            let vt = pack_vt(&mut words, [columns, rank], of_vt);
            let u = pack_u(&mut words, [rank, rows], of_u);
            assert_eq!(
                (vt.first, vt.wide, vt.wide_words, vt.bytes),
                (3, wide, wide_words, 5 - wide),
                "{largest}"
            );
            let a_group = wide * wide_words + (5 - wide) * OF_8 + 2 * OF_4;
            assert_eq!(vt.len, 2 * a_group, "two groups of ranks");
            assert_eq!((u.first, u.wide), (3 + vt.len, wide - 2));
            assert_eq!(words.len(), u.first + u.len);
            let cluster =
                Cluster { rank, row_count: rows, column_count: columns, u, vt, ..Cluster::default() };
            let padded = |of: &dyn Fn(usize) -> f32| -> Vec<f32> {
                (0..2 * GROUP).map(|i| if i < rank { of(i) } else { 0.0 }).collect()
            };
            for column in 0..columns {
                let found = [0, 1].map(|group| cluster.vt_numbers(&words, group, column)).concat();
                assert_eq!(found, padded(&|i| of_vt(i, column)), "column {column}, {largest}");
            }
            for row in 0..rows {
                let found = [0, 1].map(|group| cluster.u_numbers(&words, group, row)).concat();
                assert_eq!(found, padded(&|i| of_u(row, i)), "row {row}, {largest}");
            }
        }
    }
}
