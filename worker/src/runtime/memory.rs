//! The memory that this process takes, of that which it may take. A kernel that runs out of memory ends a process without a word; so
//! tasks in hand fail as out of memory a moment before, and the farm hears which they were.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use lightkiln_proto::api::Blame;

use super::gauge::{Fill, Gauge, Kills, Reading};

/// Time between two looks. Longer → a task that takes memory fast is ended by the kernel before anybody looks.
pub(super) const LOOK_EVERY: Duration = Duration::from_millis(100);
/// Part of a limit from which on a process without a task takes so much of it that its end helps others.
const MUCH_PART: u64 = 8;
/// Part of a limit that a cache may take.
const CACHE_PART: u64 = 4;

/// A limit that is reached.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Exhausted {
    fill: Fill,
    /// Bytes of it that this process has.
    own: u64,
    /// Tasks that were in hand when it was reached.
    pub(super) tasks: usize,
}

impl Exhausted {
    /// Whether the greater part is this process's.
    pub(super) fn is_own(&self) -> bool {
        self.own >= self.fill.limit / 2
    }

    /// Whether this process has so much that its end would help.
    pub(super) fn is_much(&self) -> bool {
        self.own >= self.fill.limit / MUCH_PART
    }

    /// Who is to blame that the tasks in hand end: one that was alone, by what it takes; none of several, or where others took the
    /// memory.
    pub(super) fn blame(&self) -> Blame {
        if self.is_own() && self.tasks == 1 { Blame::Worker } else { Blame::Lost }
    }

    /// The limit, and whose the memory is.
    pub(super) fn words(&self) -> String {
        let share =
            if self.is_own() { String::new() } else { format!(", {} by this worker", self.own >> 20) };
        format!("{}{share}", self.fill.words())
    }
}

/// State of the memory at the last look.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Seen {
    exhausted: Option<Exhausted>,
    /// The limit that was nearly reached, in words.
    near: Option<String>,
    kills: Kills,
}

/// A difference between two looks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum News {
    Nothing,
    Changed,
    /// A limit was reached while there were so many tasks in hand.
    Exhausted {
        tasks: usize,
    },
}

/// Looks at the memory from time to time.
#[derive(Debug)]
pub(super) struct MemoryWatch {
    /// Most bytes that this process may take, if its owner said so.
    own_limit: Option<u64>,
    gauge: Box<dyn Gauge>,
    seen: Mutex<Seen>,
}

impl MemoryWatch {
    pub(super) fn new(own_limit: Option<u64>, gauge: Box<dyn Gauge>) -> Self {
        Self { own_limit, gauge, seen: Mutex::default() }
    }

    /// The limit that is reached, if one is.
    pub(super) fn exhausted(&self) -> Option<Exhausted> {
        self.lock().exhausted.clone()
    }

    /// Whether a limit is reached.
    pub(super) fn is_exhausted(&self) -> bool {
        self.lock().exhausted.is_some()
    }

    /// The limit that is nearly reached, in words, if one is; the kernel's kills.
    pub(super) fn signs(&self) -> (Option<String>, Kills) {
        let seen = self.lock();
        (seen.near.clone(), seen.kills.clone())
    }

    /// Most bytes of a cache that is to have so many.
    pub(super) fn cache_bytes(&self, wanted: usize) -> usize {
        let smallest = self.read().fills.iter().map(|fill| fill.limit).min().unwrap_or(u64::MAX);
        wanted.min(usize::try_from(smallest / CACHE_PART).unwrap_or(usize::MAX))
    }

    /// Looks. Where a limit is reached, `free` lets go of all that nobody needs, and it counts as reached if that did not help.
    ///
    /// A task is to be counted in `in_hand` before a look that it begins after: then each limit is either reached without it, and that
    /// look says so, or it is among those that were in hand.
    pub(super) fn look(&self, in_hand: &AtomicUsize, free: impl FnOnce()) -> News {
        let mut last = self.lock();
        let mut seen = seen(&self.read());
        if seen.exhausted.is_some() {
            free();
            seen = self::seen(&self.read());
        }
        let before = last.exhausted.as_ref().map(|exhausted| exhausted.tasks);
        if let Some(exhausted) = &mut seen.exhausted {
            exhausted.tasks = before.unwrap_or_else(|| in_hand.load(Ordering::Acquire));
        }
        let news = match &seen.exhausted {
            Some(exhausted) if before.is_none() => News::Exhausted { tasks: exhausted.tasks },
            _ if *last == seen => News::Nothing,
            _ => News::Changed,
        };
        *last = seen;
        news
    }

    fn read(&self) -> Reading {
        let mut reading = self.gauge.read();
        let own = reading.own;
        let fill = |limit| Fill { of: "this worker", used: own, limit, margin: 0 };
        reading.fills.extend(self.own_limit.map(fill));
        reading
    }

    fn lock(&self) -> MutexGuard<'_, Seen> {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn seen(reading: &Reading) -> Seen {
    let reached = reading.fills.iter().filter(|fill| fill.is_reached());
    let fullest = reached.max_by(|a, b| a.share().total_cmp(&b.share()));
    let near = reading.fills.iter().find(|fill| fill.is_near());
    Seen {
        exhausted: fullest.map(|fill| Exhausted { fill: fill.clone(), own: reading.own, tasks: 0 }),
        // Without the figures: a note of it need not be written anew with each look.
        near: near.map(|fill| format!("nearly all memory of {} was in use", fill.of)),
        kills: reading.kills.clone(),
    }
}

#[cfg(test)]
pub(super) mod tests {
    use std::fmt;

    use super::*;

    const MIB: u64 = 1 << 20;

    /// Readings that a test makes.
    pub struct Script(Box<dyn Fn() -> Reading + Send + Sync>);

    impl Script {
        pub fn new(read: impl Fn() -> Reading + Send + Sync + 'static) -> Box<Self> {
            Box::new(Self(Box::new(read)))
        }
    }

    impl fmt::Debug for Script {
        fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("Script")
        }
    }

    impl Gauge for Script {
        fn read(&self) -> Reading {
            (self.0)()
        }
    }

    /// A machine of 4 GiB, all of it in use or half of it, so many MiB by this process.
    pub fn machine(is_full: bool, own_mib: u64) -> Reading {
        let used = if is_full { 4096 } else { 2048 };
        let fills = vec![Fill::of_kernel("this machine", used * MIB, 4096 * MIB)];
        Reading { own: own_mib * MIB, fills, kills: Kills::default() }
    }

    fn look(watch: &MemoryWatch, in_hand: usize) -> News {
        watch.look(&AtomicUsize::new(in_hand), || ())
    }

    #[test]
    fn limit_of_the_owner_holds_to_the_byte_and_says_whose_it_is() {
        let of = |own: u64| {
            let read = move || Reading { own, ..Reading::default() };
            let watch = MemoryWatch::new(Some(100 * MIB), Script::new(read));
            look(&watch, 1);
            assert_eq!(watch.signs().0, None, "no kernel keeps it");
            watch.exhausted()
        };
        assert_eq!([50 * MIB, 100 * MIB].map(of), [None, None]);
        let over = of(100 * MIB + 1).unwrap();
        assert_eq!(over.words(), "100 of 100 MiB of this worker were in use");
        assert!(over.is_own());
    }

    #[test]
    fn task_is_to_blame_that_was_alone_with_most_of_the_memory() {
        let blame = |own_mib, tasks| {
            let watch = MemoryWatch::new(None, Script::new(move || machine(true, own_mib)));
            assert_eq!(look(&watch, tasks), News::Exhausted { tasks });
            // By now they may have ended, or another has come.
            assert_ne!(look(&watch, 1), News::Exhausted { tasks: 1 });
            let exhausted = watch.exhausted().unwrap();
            (exhausted.blame(), exhausted.is_much(), exhausted.words())
        };
        assert_eq!(
            blame(3000, 1),
            (Blame::Worker, true, "4096 of 4096 MiB of this machine were in use".into())
        );
        assert_eq!(blame(3000, 2).0, Blame::Lost, "one of two");
        assert_eq!(blame(3000, 0).0, Blame::Lost, "it was used up before there was a task");
        let (of_two_workers, is_much, words) = blame(1900, 1);
        assert!(of_two_workers == Blame::Lost && is_much);
        assert_eq!(words, "4096 of 4096 MiB of this machine were in use, 1900 by this worker");
        assert_eq!((blame(100, 1).0, blame(100, 1).1), (Blame::Lost, false));
    }

    #[test]
    fn limit_counts_as_reached_if_it_is_after_all_was_let_go_of() {
        let held = std::sync::Arc::new(AtomicUsize::new(1));
        let holds = held.clone();
        let read = move || machine(holds.load(Ordering::Relaxed) > 0, 1900);
        let watch = MemoryWatch::new(None, Script::new(read));
        let in_hand = AtomicUsize::new(1);
        watch.look(&in_hand, || held.store(0, Ordering::Relaxed));
        assert!(!watch.is_exhausted());
        held.store(1, Ordering::Relaxed);
        assert_eq!(watch.look(&in_hand, || ()), News::Exhausted { tasks: 1 });
        held.store(0, Ordering::Relaxed);
        assert_eq!(watch.look(&in_hand, || panic!("nothing is reached")), News::Changed);
        assert_eq!(watch.look(&in_hand, || ()), News::Nothing);
    }

    #[test]
    fn cache_takes_a_quarter_of_the_smallest_limit_at_most() {
        let cache = |own_limit: Option<u64>| {
            let watch = MemoryWatch::new(own_limit, Script::new(|| machine(false, 0)));
            watch.cache_bytes(2 << 30)
        };
        assert_eq!(cache(None), 1 << 30);
        assert_eq!(cache(Some(400 * MIB)), 100 << 20);
        assert_eq!(MemoryWatch::new(None, Script::new(Reading::default)).cache_bytes(7), 7);
    }
}
