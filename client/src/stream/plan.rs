//! Layers to fetch, and those to let go, within budgets.

use super::{Candidate, Step};

/// Bounds on light that comes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Budget {
    /// No more is fetched above so many bytes of light; what is there is not let go for them.
    pub bytes: u64,
    /// Most bytes that come in one call. More → fewer and larger steps.
    pub step: u64,
    /// Most memory that light takes when it is lit, in bytes. Less → clusters that a view needs least go back to fewer layers.
    pub memory: u64,
}

impl Budget {
    /// No bounds.
    pub const NONE: Self = Self { bytes: u64::MAX, step: u64::MAX, memory: u64::MAX };

    /// Bounded by bytes alone.
    pub const fn of_bytes(bytes: u64) -> Self {
        Self { bytes, ..Self::NONE }
    }
}

/// Layers to have of each candidate.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Plan {
    /// Candidates whose layers are to be fetched, with the number to have, those first that are needed most.
    pub fetch: Vec<(usize, usize)>,
    /// Candidates that may go to make room, with the layers that stay, those first that are needed least.
    pub evict: Vec<(usize, usize)>,
}

/// The layers that are needed most, `steps` being those of the candidates by falling need. The budget is what `Budget` leaves beside
/// the bytes and the memory of what always stays.
pub fn plan(candidates: &[Candidate], steps: &[Step], budget: Budget) -> Plan {
    let targets = within_memory(candidates, steps, budget.memory);
    let mut have: Vec<usize> =
        candidates.iter().zip(&targets).map(|(of, target)| of.held.min(*target)).collect();
    let evict = evicted(candidates, steps, &have);
    let bytes: u64 = candidates.iter().zip(&have).map(|(of, have)| of.bytes_of(*have)).sum();
    let mut left = budget.bytes.saturating_sub(bytes).min(budget.step);
    let mut order: Vec<usize> = Vec::new();
    for step in steps {
        let (of, have) = (&candidates[step.candidate], &mut have[step.candidate]);
        let layers = step.layers.min(targets[step.candidate]);
        let bytes = of.bytes_of(layers).saturating_sub(of.bytes_of(*have));
        if layers > *have && bytes <= left {
            left -= bytes;
            if *have == of.held {
                order.push(step.candidate);
            }
            *have = layers;
        }
    }
    Plan { fetch: order.into_iter().map(|index| (index, have[index])).collect(), evict }
}

/// Candidates of which fewer layers stay than are held, those first whose last step is needed least.
fn evicted(candidates: &[Candidate], steps: &[Step], have: &[usize]) -> Vec<(usize, usize)> {
    let mut places = vec![0; candidates.len()];
    for (place, step) in steps.iter().enumerate() {
        if step.layers <= candidates[step.candidate].held {
            places[step.candidate] = place;
        }
    }
    let gone = candidates.iter().zip(have).enumerate().filter(|(_, (of, have))| **have < of.held);
    let mut gone: Vec<(usize, usize)> = gone.map(|(index, (_, have))| (index, *have)).collect();
    gone.sort_by_key(|(index, _)| std::cmp::Reverse(places[*index]));
    gone
}

/// Layers of each candidate that fit into so much memory: those that are kept, then those first that are needed most. All that are
/// held stay where there is room for all. Where memory has become too small for those that are kept, they count as all others.
fn within_memory(candidates: &[Candidate], steps: &[Step], memory: u64) -> Vec<usize> {
    let kept: u64 = candidates.iter().map(|of| of.rung(of.kept).memory).sum();
    let (mut targets, mut left): (Vec<usize>, u64) = match memory.checked_sub(kept) {
        Some(left) => (candidates.iter().map(|of| of.kept).collect(), left),
        None => (vec![0; candidates.len()], memory),
    };
    for step in steps {
        let (of, target) = (&candidates[step.candidate], &mut targets[step.candidate]);
        let more = of.rung(step.layers).memory.saturating_sub(of.rung(*target).memory);
        if step.layers > *target && more <= left {
            left -= more;
            *target = step.layers;
        }
    }
    // Layers between two steps, as a line that broke leaves them, stay if they fit.
    for (of, target) in candidates.iter().zip(&mut targets) {
        let more = of.rung(of.held).memory.saturating_sub(of.rung(*target).memory);
        if of.held > *target && more <= left {
            left -= more;
            *target = of.held;
        }
    }
    targets
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::super::{Lit, Rung, by_need};
    use super::*;

    /// Two clusters of two layers of 10 bytes each in light of which the first has more.
    fn two(held: [usize; 2]) -> (Vec<Candidate>, Vec<Step>) {
        two_in([2.0, 1.0], held, [0, 0])
    }

    /// The two in such light.
    fn two_in(light: [f32; 2], held: [usize; 2], kept: [usize; 2]) -> (Vec<Candidate>, Vec<Step>) {
        let rungs =
            vec![Rung { bytes: 10, memory: 100, left: 0.4 }, Rung { bytes: 20, memory: 200, left: 0.0 }];
        let at = |x: f32| [Vec3::new(x, 0.0, 0.0), Vec3::new(x + 1.0, 1.0, 1.0)];
        let candidate = |index: usize| Candidate {
            bounds_m: at([0.0, 10.0][index]),
            receivers: 1,
            rungs: rungs.clone(),
            held: held[index],
            kept: kept[index],
        };
        let candidates: Vec<Candidate> = (0..2).map(candidate).collect();
        let lit =
            |x: f32, light: f32| Lit { position_m: Vec3::new(x, 0.5, 0.5), irradiance: Vec3::splat(light) };
        let steps = by_need(&candidates, &[lit(0.5, light[0]), lit(10.5, light[1])], None, 40.0);
        (candidates, steps)
    }

    fn planned(held: [usize; 2], budget: Budget) -> Plan {
        let (candidates, steps) = two(held);
        plan(&candidates, &steps, budget)
    }

    #[test]
    fn layers_of_one_cluster_are_fetched_at_once_and_by_need() {
        assert_eq!(planned([0, 0], Budget::NONE).fetch, [(0, 2), (1, 2)]);
        assert_eq!(planned([1, 2], Budget::NONE).fetch, [(0, 2)]);
        assert_eq!(planned([2, 2], Budget::NONE), Plan::default());
        assert_eq!(planned([0, 0], Budget::of_bytes(30)).fetch, [(0, 2), (1, 1)]);
        assert_eq!(planned([2, 0], Budget::of_bytes(25)).fetch, []);
        let of_step = Budget { step: 10, ..Budget::NONE };
        assert_eq!(planned([0, 0], of_step).fetch, [(0, 1)]);
        assert_eq!(planned([1, 0], of_step).fetch, [(0, 2)]);
    }

    #[test]
    fn what_is_needed_least_goes_where_memory_is_short() {
        let of_memory = |memory| Budget { memory, ..Budget::NONE };
        let least_first = planned([0, 2], of_memory(300));
        assert_eq!((least_first.fetch, least_first.evict), (vec![(0, 2)], vec![(1, 1)]));
        assert_eq!(planned([2, 2], of_memory(200)).evict, [(1, 0)]);
        assert_eq!(planned([2, 1], of_memory(300)), Plan::default());
        assert_eq!(planned([2, 2], of_memory(0)).evict, [(1, 0), (0, 0)], "the least needed goes first");
    }

    /// Plans until one changes nothing, of two clusters that an overview has four times too bright, and whose first layers take turns
    /// in a memory for one of them; `None` if they never end.
    fn plans_to_rest(keeps: bool) -> Option<usize> {
        let budget = Budget { memory: 100, ..Budget::NONE };
        let (mut held, mut kept) = ([0, 0], [0, 0]);
        for count in 0..20 {
            let light = held.map(|held| if held > 0 { 1.0 } else { 4.0 });
            let (candidates, steps) = two_in(light, held, kept);
            let Plan { fetch, evict } = plan(&candidates, &steps, budget);
            if fetch.is_empty() && evict.is_empty() {
                return Some(count);
            }
            evict.into_iter().for_each(|(index, layers)| held[index] = layers);
            fetch.into_iter().for_each(|(index, layers)| held[index] = layers);
            kept = if keeps { held } else { kept };
        }
        None
    }

    #[test]
    fn clusters_that_an_overview_has_too_bright_take_no_turns_while_those_that_came_are_kept() {
        assert_eq!(plans_to_rest(true), Some(1));
        assert_eq!(plans_to_rest(false), None);
        // Memory that has fallen below what is kept holds what is needed most.
        let (candidates, steps) = two_in([1.0, 2.0], [2, 2], [2, 2]);
        let Plan { fetch, evict } = plan(&candidates, &steps, Budget { memory: 200, ..Budget::NONE });
        assert_eq!((fetch, evict), (vec![], vec![(0, 0)]));
    }
}
