//! Events in order of time, and stations: processors, locks and connections that calls wait for, first come, first served.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};
use std::time::Duration;

/// Number of a station.
pub type StationId = usize;

/// Part of a call's way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// Waits for a place, and keeps it.
    Take(StationId),
    /// Gives a place back.
    Free(StationId),
    /// Lets time pass.
    Wait(Duration),
}

impl Step {
    /// Has one place of a station for so long, once it is free.
    pub fn work(station: StationId, time: Duration) -> [Self; 3] {
        [Self::Take(station), Self::Wait(time), Self::Free(station)]
    }
}

/// Places that a way may need, some of them taken.
#[derive(Debug)]
struct Station {
    places: usize,
    taken: usize,
    line: VecDeque<usize>,
    changed: Duration,
    usage: Usage,
}

/// Sums over a station's time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Usage {
    /// Places taken, times time.
    pub busy: Duration,
    /// Calls that have a place or wait for one, times time.
    pub present: Duration,
    /// Calls that came.
    pub arrivals: u64,
}

impl Station {
    fn pass_time(&mut self, now: Duration) {
        let passed = now - self.changed;
        self.usage.busy += passed * self.taken as u32;
        self.usage.present += passed * (self.taken + self.line.len()) as u32;
        self.changed = now;
    }
}

/// A call under way.
#[derive(Debug)]
struct Way<E> {
    steps: VecDeque<Step>,
    end: Option<E>,
}

#[derive(Debug)]
enum What<E> {
    Emit(E),
    GoOn(usize),
}

#[derive(Debug)]
struct Due<E> {
    at: Duration,
    number: u64,
    what: What<E>,
}

impl<E> PartialEq for Due<E> {
    fn eq(&self, other: &Self) -> bool {
        self.number == other.number
    }
}

impl<E> Eq for Due<E> {}

impl<E> PartialOrd for Due<E> {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl<E> Ord for Due<E> {
    /// Equal times keep the order in which they were planned.
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        (self.at, self.number).cmp(&(other.at, other.number))
    }
}

/// The clock, what is due, and the stations.
#[derive(Debug)]
pub struct Engine<E> {
    now: Duration,
    planned: u64,
    due: BinaryHeap<Reverse<Due<E>>>,
    stations: Vec<Station>,
    ways: Vec<Way<E>>,
    free_ways: Vec<usize>,
}

impl<E> Default for Engine<E> {
    fn default() -> Self {
        Self {
            now: Duration::ZERO,
            planned: 0,
            due: BinaryHeap::new(),
            stations: Vec::new(),
            ways: Vec::new(),
            free_ways: Vec::new(),
        }
    }
}

impl<E> Engine<E> {
    /// Time since the beginning.
    pub fn now(&self) -> Duration {
        self.now
    }

    /// A station with so many places.
    pub fn station(&mut self, places: usize) -> StationId {
        self.stations.push(Station {
            places: places.max(1),
            taken: 0,
            line: VecDeque::new(),
            changed: self.now,
            usage: Usage::default(),
        });
        self.stations.len() - 1
    }

    /// Sums of a station until now.
    pub fn usage(&mut self, station: StationId) -> Usage {
        self.stations[station].pass_time(self.now);
        self.stations[station].usage
    }

    /// Plans an event.
    pub fn after(&mut self, time: Duration, event: E) {
        self.plan(time, What::Emit(event));
    }

    /// Goes a way from now on; the event comes at its end.
    pub fn go(&mut self, steps: impl IntoIterator<Item = Step>, end: E) {
        let way = Way { steps: steps.into_iter().collect(), end: Some(end) };
        let id = match self.free_ways.pop() {
            Some(id) => {
                self.ways[id] = way;
                id
            }
            None => {
                self.ways.push(way);
                self.ways.len() - 1
            }
        };
        self.go_on(id);
    }

    /// The next event; none when nothing is due any more.
    pub fn next_event(&mut self) -> Option<E> {
        loop {
            let Reverse(due) = self.due.pop()?;
            self.now = due.at;
            match due.what {
                What::Emit(event) => return Some(event),
                What::GoOn(way) => self.go_on(way),
            }
        }
    }

    fn plan(&mut self, time: Duration, what: What<E>) {
        self.planned += 1;
        self.due.push(Reverse(Due { at: self.now + time, number: self.planned, what }));
    }

    fn go_on(&mut self, id: usize) {
        loop {
            match self.ways[id].steps.pop_front() {
                Some(Step::Wait(time)) => return self.plan(time, What::GoOn(id)),
                Some(Step::Take(station)) => {
                    let station = &mut self.stations[station];
                    station.pass_time(self.now);
                    station.usage.arrivals += 1;
                    if station.taken == station.places {
                        return station.line.push_back(id);
                    }
                    station.taken += 1;
                }
                Some(Step::Free(station)) => {
                    let station = &mut self.stations[station];
                    station.pass_time(self.now);
                    // The place goes to the first in line, who goes on at this moment.
                    match station.line.pop_front() {
                        Some(next) => self.plan(Duration::ZERO, What::GoOn(next)),
                        None => station.taken -= 1,
                    }
                }
                None => {
                    if let Some(event) = self.ways[id].end.take() {
                        self.plan(Duration::ZERO, What::Emit(event));
                    }
                    return self.free_ways.push(id);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    /// Ways of `work` that begin at these times, through a station of so many places; when each ended, and the station's sums.
    fn run(places: usize, begins: &[u32], work: Duration) -> (Vec<Duration>, Usage) {
        let mut engine = Engine::default();
        let station = engine.station(places);
        begins.iter().enumerate().for_each(|(way, begin)| engine.after(MS * *begin, (way, false)));
        let mut ends = vec![Duration::ZERO; begins.len()];
        while let Some((way, is_over)) = engine.next_event() {
            match is_over {
                true => ends[way] = engine.now(),
                false => engine.go(Step::work(station, work), (way, true)),
            }
        }
        let usage = engine.usage(station);
        (ends, usage)
    }

    #[test]
    fn who_comes_first_is_served_first_and_the_others_wait() {
        let (ends, usage) = run(1, &[0, 1, 2, 50], 10 * MS);
        assert_eq!(ends, [10 * MS, 20 * MS, 30 * MS, 60 * MS]);
        assert_eq!((usage.busy, usage.arrivals), (40 * MS, 4));
        let (ends, usage) = run(2, &[0, 1, 2, 50], 10 * MS);
        assert_eq!(ends, [10 * MS, 11 * MS, 20 * MS, 60 * MS]);
        assert_eq!(usage.busy, 40 * MS);
    }

    /// Little's law: the mean number present is the rate of arrivals times the mean stay, whatever the arrivals and the places.
    #[test]
    fn number_present_is_the_rate_times_the_stay() {
        for places in 1..4 {
            for seed in 0..20 {
                let begins: Vec<u32> =
                    (0..200).map(|way| (super::super::times::draw(seed, way) * 700.0) as u32).collect();
                let (ends, usage) = run(places, &begins, 7 * MS);
                let stays: Duration = ends.iter().zip(&begins).map(|(end, begin)| *end - MS * *begin).sum();
                assert_eq!(usage.present, stays, "{places} places, seed {seed}");
                assert!(usage.busy < usage.present, "nobody waited");
            }
        }
    }
}
