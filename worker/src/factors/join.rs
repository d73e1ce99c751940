//! Small parts of a cell as one cluster. U is block-diagonal: each part keeps its own ranks and columns, and a receiver's
//! U is 0 in those of the others. So no light crosses, and the factors are those of the parts, number by number.

use super::split::Factored;
use super::svd::Factors;
use crate::lightmap::Numbering;

/// Parts of fewer receivers are joined. More → fewer chunks, higher ranks at run time.
const RECEIVERS_MIN: usize = 32;

/// Receivers of a cell with their factors.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Part {
    /// Indices of receivers, one for each row of U.
    pub receivers: Vec<u32>,
    /// Their factors.
    pub factored: Factored,
}

impl Part {
    fn rank(&self) -> usize {
        self.factored.factors.rank
    }
}

/// Joins the smallest parts until all have [`RECEIVERS_MIN`] receivers, as far as the sum of their ranks is within
/// `rank_max`; those of rank 0 always. Empty ones vanish.
pub fn joined(mut parts: Vec<Part>, rank_max: usize) -> Vec<Part> {
    parts.retain(|part| !part.receivers.is_empty());
    let mut done = Vec::new();
    loop {
        // Take the smallest first, of equal ones the first.
        parts.sort_by_key(|part| (part.rank() > 0, part.receivers.len(), part.receivers[0]));
        let Some(first) = parts.first() else { break };
        let is_small = first.rank() == 0 || first.receivers.len() < RECEIVERS_MIN;
        let fits = |other: &Part| first.rank() + other.rank() <= rank_max;
        match parts[1..].iter().position(|other| is_small && fits(other)) {
            Some(index) => {
                let other = parts.remove(1 + index);
                parts[0] = join(&parts[0], &other);
            }
            None => done.push(parts.remove(0)),
        }
    }
    done.sort_by_key(|part| part.receivers[0]);
    done
}

/// Two parts as one, whose error is at most the larger of both.
fn join(a: &Part, b: &Part) -> Part {
    let parts = [a, b];
    let factors = parts.map(|part| &part.factored.factors);
    let groups = Numbering::of(parts.iter().flat_map(|part| part.factored.groups.iter().copied()));
    // The first ranks of both come first, as a chunk's first layers have those alone.
    let mut ranks: Vec<(usize, usize)> =
        (0..2).flat_map(|p| (0..factors[p].rank).map(move |i| (i, p))).collect();
    ranks.sort_unstable();
    let mut joined = Factors {
        rank: ranks.len(),
        truncation_error: factors[0].truncation_error.max(factors[1].truncation_error),
        s1_criterion_bound: factors[0].s1_criterion_bound.max(factors[1].s1_criterion_bound),
        ..Factors::default()
    };
    for (p, part) in parts.iter().enumerate() {
        for row in 0..part.receivers.len() {
            let entry = |&(i, of): &(usize, usize)| {
                if of == p { factors[p].u[row * factors[p].rank + i] } else { 0.0 }
            };
            joined.u.extend(ranks.iter().map(entry));
        }
    }
    for (i, p) in ranks {
        let own = &parts[p].factored.groups;
        let columns = factors[p].vt.len() / factors[p].rank;
        let coefficients = columns / own.len();
        let row = &factors[p].vt[i * columns..][..columns];
        let first = joined.vt.len();
        joined.vt.resize(first + groups.len() * coefficients, 0.0);
        for (&group, values) in own.iter().zip(row.chunks_exact(coefficients)) {
            joined.vt[first + groups.place(group) * coefficients..][..coefficients].copy_from_slice(values);
        }
    }
    let receivers = parts.iter().flat_map(|part| part.receivers.iter().copied()).collect();
    Part { receivers, factored: Factored { factors: joined, groups: groups.into_values() } }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A part of receivers from `first` on, over groups of two columns each.
    fn part(first: u32, receivers: u32, groups: &[u32], rank: usize) -> Part {
        let numbers =
            |count: usize| (0..count).map(|i| 1.0 + ((i * 7 + first as usize) % 5) as f32).collect();
        let factors = Factors {
            rank,
            u: numbers(receivers as usize * rank),
            vt: numbers(rank * groups.len() * 2),
            truncation_error: 0.01 * receivers as f32,
            ..Factors::default()
        };
        let receivers = (first..first + receivers).collect();
        Part { receivers, factored: Factored { factors, groups: groups.to_vec() } }
    }

    /// Entry of the product of factors, at a receiver and a column.
    fn entry(part: &Part, receiver: u32, column: u32) -> f32 {
        let Part { receivers, factored: Factored { factors, groups } } = part;
        let row = receivers.iter().position(|&r| r == receiver).unwrap();
        let Some(place) = groups.iter().position(|&group| group == column / 2) else { return 0.0 };
        let at = |i: usize| {
            factors.u[row * factors.rank + i]
                * factors.vt[i * groups.len() * 2 + 2 * place + column as usize % 2]
        };
        (0..factors.rank).map(at).sum()
    }

    #[test]
    fn product_of_joined_factors_is_that_of_each_part_and_exactly_zero_across() {
        let parts = [part(0, 5, &[0, 3], 2), part(20, 3, &[1, 3, 4], 3), part(40, 4, &[], 0)];
        let all = joined(parts.to_vec(), 64);
        assert_eq!(all.len(), 1);
        assert_eq!(all[0].receivers.len(), 12);
        assert_eq!(all[0].rank(), 5);
        assert_eq!(all[0].factored.factors.truncation_error, parts[0].factored.factors.truncation_error);
        for part in &parts {
            for &receiver in &part.receivers {
                for column in 0..10 {
                    assert_eq!(entry(&all[0], receiver, column), entry(part, receiver, column));
                }
            }
        }
    }

    #[test]
    fn small_parts_are_joined_up_to_the_highest_rank_and_those_of_rank_zero_always() {
        let small = (0..10).map(|index| part(10 * index, 4, &[index], 3));
        let large = [part(200, 100, &[20], 10), part(400, 90, &[], 0)];
        let all = joined(small.chain(large).collect(), 10);
        assert!(all.iter().all(|part| part.rank() > 0 && part.rank() <= 10), "{all:?}");
        assert_eq!(all.iter().map(|part| part.receivers.len()).sum::<usize>(), 230);
        assert_eq!(all.len(), 5, "three of rank 9, one of the rest, the large one");
        assert_eq!(joined(vec![part(0, 90, &[], 0), part(90, 9, &[], 0)], 10).len(), 1);
    }

    #[test]
    fn large_parts_stay_as_they_are() {
        let parts = vec![part(0, 40, &[0], 2), part(50, 50, &[1], 2)];
        assert_eq!(joined(parts.clone(), 64), parts);
    }
}
