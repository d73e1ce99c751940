//! Limits of single bakes, where a task belongs to several of them: the most generous one decides.

use lightkiln_proto::api::BakeLimits;

use super::rules::{FarmRules, MAX_ATTEMPTS, POISON_WORKERS};

/// Whether a task with that many failed attempts by that many workers is given up by every bake that wants it.
pub fn is_given_up(bakes: &[BakeLimits], attempts: u32, workers: u32) -> bool {
    bakes.iter().all(|limits| match limits.attempts {
        Some(most) => attempts >= most,
        None => attempts >= MAX_ATTEMPTS || workers >= POISON_WORKERS,
    })
}

/// Whether a task with which so many workers were lost is given up by every bake that wants it.
pub fn is_lost_too_often(bakes: &[BakeLimits], losses: u32, farm: &FarmRules) -> bool {
    bakes.iter().all(|limits| losses >= limits.lost_workers.unwrap_or(farm.lost_workers))
}

/// Workers that a bake with that limit may have beside those that hold tasks of it, of which there are so many; any number without a limit.
pub fn room_for_workers(max_workers: Option<u32>, holders: u64) -> Option<u64> {
    max_workers.map(|most| u64::from(most).saturating_sub(holders))
}

/// Ready tasks of one kind of a bake, as far as workers that hold none of its tasks yet may take one each. `left` is the room for such
/// workers that the kinds before it left; none where there is no limit.
pub fn take_room(left: &mut Option<u64>, ready: u64) -> u64 {
    let taken = left.map_or(ready, |left| ready.min(left));
    *left = left.map(|left| left - taken);
    taken
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_of_a_bake_share_its_room() {
        let taken = |mut left| [3, 900, 7].map(|ready| take_room(&mut left, ready));
        assert_eq!(taken(None), [3, 900, 7]);
        assert_eq!(taken(Some(5)), [3, 2, 0]);
    }

    #[test]
    fn most_generous_bake_decides_when_a_task_is_given_up() {
        let of = |attempts, lost_workers| BakeLimits { attempts, lost_workers, ..BakeLimits::default() };
        let farm = FarmRules { lost_workers: 4 };
        let usual = of(None, None);
        assert!(is_given_up(&[usual], MAX_ATTEMPTS, 1) && is_given_up(&[usual], 3, POISON_WORKERS));
        assert!(!is_given_up(&[usual], MAX_ATTEMPTS - 1, POISON_WORKERS - 1));
        assert!(is_given_up(&[of(Some(1), None)], 1, 1));
        assert!(!is_given_up(&[of(Some(9), None)], 8, 8), "a number that a bake names counts alone");
        assert!(!is_given_up(&[of(Some(1), None), usual], 1, 1));
        assert!(is_given_up(&[of(Some(1), None), usual], MAX_ATTEMPTS, 1));
        assert!(!is_lost_too_often(&[usual], 3, &farm) && is_lost_too_often(&[usual], 4, &farm));
        assert!(is_lost_too_often(&[of(None, Some(2))], 2, &farm));
        assert!(!is_lost_too_often(&[of(None, Some(2)), usual], 3, &farm));
        assert!(!is_lost_too_often(&[of(None, Some(6)), usual], 4, &farm));
    }
}
