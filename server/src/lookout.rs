//! Looks at the farm on behalf of all who wait: claims for work, readers of events and results for news.
//!
//! A thousand idle workers and readers hear of every change. If each then asked the store, a change that is nothing to them
//! would cost a thousand transactions. So they say what they wait for, one look answers for all, and those alone
//! wake for whom there is something: claims whose abilities suffice for ready tasks, about as many as there are
//! tasks, and readers of bakes that have gone on.
//!
//! The watch runs while anybody waits. It decides nothing: who is woken asks the store, and may find that others were there
//! first. Who waits here is noted as present, so that a waiting worker need not claim again to say so.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use lightkiln_proto::api::ClaimRequest;
use tokio::sync::{Notify, oneshot};
use tokio::time::Instant;

use crate::store::rules::{Abilities, WORKER_SEEN_GRAIN_MS};
use crate::store::{FarmStore, Look, Opening, Result, Standing};
use crate::wakeup::Wakeup;

/// Least time between two looks. Longer → changes that follow each other closely cost fewer looks, and are told later.
const BETWEEN_LOOKS: Duration = Duration::from_millis(10);
/// Tasks for which claims are woken beyond those that are ready: one of those woken may have gone, or leave a task to others as it failed
/// at it.
const SPARE_CLAIMS: u64 = 2;

/// A watch over the farm.
pub struct Lookout(Arc<Watch>);

struct Watch {
    store: Arc<dyn FarmStore>,
    wakeup: Arc<dyn Wakeup>,
    /// Looks are made at least this often, hint or not.
    interval: Duration,
    waiting: Mutex<Waiting>,
    /// Somebody came or went.
    changed: Notify,
}

/// Those who wait, by the order in which they came.
#[derive(Default)]
struct Waiting {
    count: u64,
    claims: BTreeMap<Abilities, BTreeMap<u64, Claim>>,
    readers: BTreeMap<u64, Reader>,
    /// Mark of the hints that the last look saw, while the watch runs.
    seen: Option<u64>,
}

struct Claim {
    worker: String,
    machine: String,
    max: u32,
    wake: oneshot::Sender<()>,
}

struct Reader {
    bake: String,
    news: News,
    wake: oneshot::Sender<()>,
}

/// Something new about a bake; its end is, too.
#[derive(Clone, Copy, Debug)]
pub enum News {
    /// An event behind that `seq`.
    Event(u64),
    /// A result behind that place.
    Result(u64),
}

impl News {
    fn is_told_by(self, standing: &Standing) -> bool {
        standing.is_final
            || match self {
                Self::Event(after) => standing.last_event > after,
                Self::Result(after) => standing.last_place > after,
            }
    }
}

/// A place among those who wait; left when dropped.
struct Place<'a> {
    watch: &'a Watch,
    number: u64,
    abilities: Option<Abilities>,
}

impl Drop for Place<'_> {
    fn drop(&mut self) {
        let mut waiting = self.watch.waiting();
        match &self.abilities {
            Some(abilities) => waiting.leave(abilities, self.number),
            None => drop(waiting.readers.remove(&self.number)),
        }
        if waiting.is_empty() {
            self.watch.changed.notify_one();
        }
    }
}

impl Lookout {
    /// A watch that nobody waits for yet.
    pub fn new(store: Arc<dyn FarmStore>, wakeup: Arc<dyn Wakeup>, interval: Duration) -> Self {
        let (waiting, changed) = (Mutex::default(), Notify::new());
        Self(Arc::new(Watch { store, wakeup, interval, waiting, changed }))
    }

    /// Waits until there may be work for a claim that found none; `mark` was taken before it asked.
    pub async fn work(&self, request: &ClaimRequest, mark: u64) {
        let abilities = Abilities::of(request);
        let (wake, woken) = oneshot::channel();
        let (worker, machine) = (request.worker.clone(), request.machine.clone());
        let claim = Claim { worker, machine, max: request.max, wake };
        let number = self.enter(mark, |waiting, number| {
            waiting.claims.entry(abilities.clone()).or_default().insert(number, claim);
        });
        let _place = Place { watch: &self.0, number, abilities: Some(abilities) };
        // A watch that ends wakes all: they ask for themselves.
        let _ = woken.await;
    }

    /// Waits for news of a bake that there was none of, or its deletion; `mark` was taken before.
    pub async fn news(&self, bake: &str, news: News, mark: u64) {
        let (wake, woken) = oneshot::channel();
        let reader = Reader { bake: bake.to_owned(), news, wake };
        let number = self.enter(mark, |waiting, number| {
            waiting.readers.insert(number, reader);
        });
        let _place = Place { watch: &self.0, number, abilities: None };
        let _ = woken.await;
    }

    fn enter(&self, mark: u64, add: impl FnOnce(&mut Waiting, u64)) -> u64 {
        let mut waiting = self.0.waiting();
        waiting.count += 1;
        let number = waiting.count;
        add(&mut waiting, number);
        match waiting.seen {
            // The last look was made after other hints than those of before this one's own look.
            Some(seen) if seen != mark => self.0.changed.notify_one(),
            Some(_) => (),
            None => {
                waiting.seen = Some(mark);
                tokio::spawn(self.0.clone().run());
            }
        }
        number
    }
}

impl Waiting {
    fn is_empty(&self) -> bool {
        self.claims.is_empty() && self.readers.is_empty()
    }

    fn leave(&mut self, abilities: &Abilities, number: u64) {
        if let Some(alike) = self.claims.get_mut(abilities) {
            alike.remove(&number);
            if alike.is_empty() {
                self.claims.remove(abilities);
            }
        }
    }

    fn workers(&self) -> Vec<String> {
        self.claims.values().flat_map(|alike| alike.values().map(|claim| claim.worker.clone())).collect()
    }

    fn bakes(&self) -> Vec<String> {
        let mut bakes: Vec<String> = self.readers.values().map(|reader| reader.bake.clone()).collect();
        bakes.sort_unstable();
        bakes.dedup();
        bakes
    }

    /// Tasks that would be enough for all claims.
    fn wanted(&self) -> u64 {
        self.claims.values().flat_map(BTreeMap::values).map(|claim| u64::from(claim.max)).sum()
    }

    /// Wakes the claims that came first, for about as many tasks as there are.
    fn wake_claims(&mut self, opening: &Opening) {
        let mut left = opening.ready.saturating_add(SPARE_CLAIMS);
        let mut room = opening.room.as_ref().map(|room| (&room.holders, room.others));
        if let Some((_, others)) = room.as_mut().filter(|(_, others)| *others > 0) {
            *others = others.saturating_add(SPARE_CLAIMS);
        }
        let can = |abilities: &Abilities| {
            abilities.kinds.contains(&opening.kind) && abilities.suffice(&opening.needs)
        };
        let mut able: Vec<_> = self.claims.iter_mut().filter(|(can_do, _)| can(can_do)).collect();
        // Those whom a bake at its limit of workers has no room for wait on.
        let has_room = |claim: &Claim, room: &Option<(&BTreeSet<String>, u64)>| match room {
            Some((holders, others)) => *others > 0 || holders.contains(&claim.worker),
            // So do those on the machine whose results are to be verified.
            None => {
                opening.maker.as_ref().is_none_or(|maker| maker.is_elsewhere(&claim.worker, &claim.machine))
            }
        };
        while left > 0 {
            // Whoever was woken and took nothing, as a worker that failed there, comes again last.
            let firsts = able.iter().enumerate().filter_map(|(index, (_, alike))| {
                let (number, _) = alike.iter().find(|(_, claim)| has_room(claim, &room))?;
                Some((*number, index))
            });
            let Some((number, index)) = firsts.min() else { break };
            let Some(claim) = able[index].1.remove(&number) else { break };
            // One that has gone takes nothing.
            if claim.wake.send(()).is_ok() {
                left = left.saturating_sub(claim.max.into());
                if let Some((_, others)) =
                    room.as_mut().filter(|(holders, _)| !holders.contains(&claim.worker))
                {
                    *others -= 1;
                }
            }
        }
        self.claims.retain(|_, alike| !alike.is_empty());
    }

    fn wake_readers(&mut self, standings: &[Standing], asked: &[String]) {
        let standings: BTreeMap<&str, &Standing> =
            standings.iter().map(|standing| (standing.bake.as_str(), standing)).collect();
        // A bake that was asked for and is not there has been deleted: its readers find out.
        let is_told = |reader: &Reader| match standings.get(reader.bake.as_str()) {
            Some(standing) => reader.news.is_told_by(standing),
            None => asked.binary_search(&reader.bake).is_ok(),
        };
        let told: Vec<u64> =
            self.readers.iter().filter(|(_, reader)| is_told(reader)).map(|(number, _)| *number).collect();
        for reader in told.iter().filter_map(|number| self.readers.remove(number)) {
            let _ = reader.wake.send(());
        }
    }

    /// Lets everybody ask the store.
    fn wake_all(&mut self) {
        self.claims.clear();
        self.readers.clear();
    }
}

/// The end of a watch. One that breaks down leaves nobody waiting for it, and the next who comes begins another.
struct Over<'a>(&'a Watch);

impl Drop for Over<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let mut waiting = self.0.waiting();
            waiting.seen = None;
            waiting.wake_all();
        }
    }
}

impl Watch {
    fn waiting(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Looks until nobody waits any more.
    async fn run(self: Arc<Self>) {
        let _over = Over(&self);
        let mut noted = Instant::now();
        while let Some(seen) = self.last_look() {
            tokio::select! {
                () = self.wakeup.wait(seen, self.interval.min(note_interval())) => (),
                () = self.changed.notified() => (),
            }
            if self.last_look().is_none() {
                return;
            }
            let looked = async {
                if noted.elapsed() >= note_interval() {
                    noted = Instant::now();
                    self.note_workers().await?;
                }
                self.look().await
            };
            if let Err(error) = looked.await {
                tracing::debug!(%error, "the farm could not be looked at; those who wait ask for themselves");
                self.waiting().wake_all();
            }
            tokio::time::sleep(BETWEEN_LOOKS).await;
        }
    }

    /// The mark of the last look; if nobody waits, the watch is over.
    fn last_look(&self) -> Option<u64> {
        let mut waiting = self.waiting();
        if waiting.is_empty() {
            waiting.seen = None;
        }
        waiting.seen
    }

    async fn note_workers(&self) -> Result<()> {
        let workers = self.waiting().workers();
        if workers.is_empty() { Ok(()) } else { self.store.note_present(&workers).await }
    }

    async fn look(&self) -> Result<()> {
        // Whoever comes from here on compares its mark with this one: it may have asked the store before those changes that
        // this look sees, and missed the look.
        let (asked, enough) = {
            let mut waiting = self.waiting();
            waiting.seen = waiting.seen.map(|_| self.wakeup.mark());
            (waiting.bakes(), waiting.wanted())
        };
        let Look { openings, standings } = self.store.look(&asked, enough).await?;
        let mut waiting = self.waiting();
        for opening in &openings {
            waiting.wake_claims(opening);
        }
        waiting.wake_readers(&standings, &asked);
        Ok(())
    }
}

/// Workers that wait are noted this often.
fn note_interval() -> Duration {
    Duration::from_millis(WORKER_SEEN_GRAIN_MS.unsigned_abs())
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::api::Needs;

    use super::*;
    use crate::store::{Maker, Room};

    #[test]
    fn those_who_wait_longest_are_woken_first_whatever_else_they_can_do() {
        let mut waiting = Waiting::default();
        let mut wakes = Vec::new();
        // Those of few threads come first by their abilities, and came last.
        for (number, threads) in [(1, 16), (2, 16), (3, 8), (4, 8), (5, 8), (6, 16)] {
            let (wake, woken) = oneshot::channel();
            let abilities =
                Abilities { kinds: vec!["work".into()], threads, memory_mib: 0, labels: Vec::new() };
            let claim = Claim { worker: number.to_string(), machine: String::new(), max: 1, wake };
            waiting.claims.entry(abilities).or_default().insert(number, claim);
            wakes.push(woken);
        }
        waiting.wake_claims(&Opening {
            kind: "work".into(),
            needs: Needs::default(),
            ready: 1,
            room: None,
            maker: None,
        });
        let is_woken: Vec<bool> = wakes.iter_mut().map(|woken| woken.try_recv().is_ok()).collect();
        assert_eq!(is_woken, [true, true, true, false, false, false]);
        waiting.wake_claims(&Opening {
            kind: "other".into(),
            needs: Needs::default(),
            ready: 9,
            room: None,
            maker: None,
        });
        assert_eq!(waiting.claims.values().map(BTreeMap::len).sum::<usize>(), 3, "none can do it");
    }

    #[test]
    fn those_for_whom_a_bake_has_no_room_wait_on() {
        let woken = |others| {
            let mut waiting = Waiting::default();
            let mut wakes = Vec::new();
            let abilities =
                Abilities { kinds: vec!["work".into()], threads: 1, memory_mib: 0, labels: Vec::new() };
            for number in 1..=9 {
                let (wake, woken) = oneshot::channel();
                let claim = Claim { worker: number.to_string(), machine: String::new(), max: 1, wake };
                waiting.claims.entry(abilities.clone()).or_default().insert(number, claim);
                wakes.push(woken);
            }
            let room = Some(Room { holders: ["8".to_owned(), "9".to_owned()].into(), others });
            let (kind, needs) = ("work".to_owned(), Needs::default());
            waiting.wake_claims(&Opening { kind, needs, ready: 100, room, maker: None });
            wakes.iter_mut().filter_map(|woken| woken.try_recv().ok()).count() as u64
        };
        assert_eq!(woken(0), 2, "those that hold some of its tasks");
        assert_eq!(woken(3), 2 + 3 + SPARE_CLAIMS);
    }

    #[test]
    fn those_on_the_machine_that_gave_a_result_do_not_wake_to_verify_it() {
        let mut waiting = Waiting::default();
        let mut wakes = Vec::new();
        for (number, machine) in [(1, "oven"), (2, ""), (3, "hob"), (4, "oven")] {
            let (wake, woken) = oneshot::channel();
            let abilities =
                Abilities { kinds: vec!["work".into()], threads: 1, memory_mib: 0, labels: Vec::new() };
            let claim = Claim { worker: number.to_string(), machine: machine.into(), max: 1, wake };
            waiting.claims.entry(abilities).or_default().insert(number, claim);
            wakes.push(woken);
        }
        let maker = Some(Maker { worker: "2".into(), machine: "oven".into() });
        let (kind, needs) = ("work".to_owned(), Needs::default());
        waiting.wake_claims(&Opening { kind, needs, ready: 9, room: None, maker });
        let is_woken: Vec<bool> = wakes.iter_mut().map(|woken| woken.try_recv().is_ok()).collect();
        assert_eq!(is_woken, [false, false, true, false]);
    }
}
