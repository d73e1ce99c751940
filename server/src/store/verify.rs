//! Results that are made once more on another machine, as pure rules; every store follows these.
//!
//! A share of a bake's results is chosen by the keys of their tasks. Such a result waits until a claim finds no task; then
//! a worker of another machine gets its task again, and its outputs must be those that count. Nothing else comes of it: tasks, attempts
//! and bakes stay as they are.

use lightkiln_proto::api::ClaimRequest;
use lightkiln_proto::ids::{Digest, TaskKey};
use serde::{Deserialize, Serialize};

/// Time after which a result that waits is not made again any more. Longer → busy farms verify more of what they chose, and bakes that
/// nobody else can verify cost a row for longer.
pub const RERUN_LAPSES_MS: i64 = 3_600_000;
/// Attempts that fail, or whose workers are lost, after which a result is not made again any more.
pub const RERUN_TRIES: u32 = 3;
/// Reruns that one claim gives up, as what they read is gone, before it goes without. More → dearer claims.
pub const RERUNS_GIVEN_UP: usize = 16;

/// Whether a share of all results has that task's among them: the same tasks on every farm, and those of a share in every bigger one.
pub fn is_chosen(key: TaskKey, share: f64) -> bool {
    let mixed = Digest::of(&[&b"verify"[..], &key.0[..]].concat());
    // 53 bits, as many as a double has.
    ((mixed.short() >> 11) as f64) < share * (1_u64 << 53) as f64
}

/// The worker that gave a result first.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Maker {
    /// Its name.
    pub worker: String,
    /// Its machine; empty where that could not be told.
    pub machine: String,
}

impl Maker {
    /// Whether a worker is on another machine, or another worker where machines cannot be told.
    pub fn is_elsewhere(&self, worker: &str, machine: &str) -> bool {
        let is_same = machine == self.machine && !machine.is_empty();
        worker != self.worker && !is_same
    }

    /// Whether the worker that claims is.
    pub fn may_be_verified_by(&self, request: &ClaimRequest) -> bool {
        self.is_elsewhere(&request.worker, &request.machine)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keys() -> impl Iterator<Item = TaskKey> {
        (0..4_000_u32).map(|number| Digest::of(&number.to_le_bytes()))
    }

    #[test]
    fn share_of_the_keys_is_chosen_and_a_bigger_one_has_the_same_among_it() {
        let count = |share| keys().filter(|key| is_chosen(*key, share)).count();
        assert_eq!((count(0.0), count(1.0)), (0, 4_000));
        for share in [0.01_f64, 0.25, 0.5] {
            // Five standard deviations.
            let (wanted, least) = (4_000.0 * share, 5.0 * (4_000.0 * share * (1.0 - share)).sqrt());
            assert!((count(share) as f64 - wanted).abs() < least, "{share}: {}", count(share));
        }
        assert!(keys().all(|key| !is_chosen(key, 0.2) || is_chosen(key, 0.3)));
    }

    #[test]
    fn choice_is_the_same_for_ever() {
        let chosen: Vec<usize> =
            keys().take(64).enumerate().filter(|(_, key)| is_chosen(*key, 0.1)).map(|(at, _)| at).collect();
        assert_eq!(chosen, [18, 23, 33, 42]);
    }

    #[test]
    fn result_is_verified_on_another_machine_or_by_another_worker_where_none_can_be_told() {
        let maker = |machine: &str| Maker { worker: "a".into(), machine: machine.into() };
        for (of, worker, machine, is_elsewhere) in [
            ("oven", "b", "hob", true),
            ("oven", "b", "oven", false),
            ("oven", "a", "hob", false),
            ("oven", "b", "", true),
            ("", "b", "oven", true),
            ("", "b", "", true),
            ("", "a", "", false),
        ] {
            assert_eq!(maker(of).is_elsewhere(worker, machine), is_elsewhere, "{of} {worker} {machine}");
        }
    }
}
