//! Places of connections, and the time that each has left.

use std::collections::{BTreeMap, BTreeSet};
use std::net::{IpAddr, Ipv6Addr};
use std::pin::pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::Notify;

use super::ConnectionConfig;

/// When the server closes, a connection without a call has so long to take leave of its caller.
const CLOSING_GRACE: Duration = Duration::from_secs(1);
/// Time between two looks at a connection meanwhile.
const CLOSING_LOOK: Duration = Duration::from_secs(1);

/// All connections of a server.
pub(super) struct Table {
    at_a_time: usize,
    of_address: usize,
    inner: Mutex<Inner>,
}

#[derive(Default)]
struct Inner {
    next: u64,
    open: BTreeMap<u64, Entry>,
    /// Those without a call under way, longest silent first.
    silent: BTreeSet<(Instant, u64)>,
    addresses: BTreeMap<IpAddr, OfAddress>,
    refused: u64,
}

struct Entry {
    address: IpAddr,
    calls: usize,
    silent_since: Option<Instant>,
    told_to_go: Arc<Notify>,
}

#[derive(Default)]
struct OfAddress {
    open: usize,
    calls: usize,
    silent: BTreeSet<(Instant, u64)>,
}

impl Table {
    pub(super) fn new(config: &ConnectionConfig) -> Self {
        let limit = |count: u32| if count == 0 { usize::MAX } else { count as usize };
        let (at_a_time, of_address) = (limit(config.at_a_time), limit(config.of_address));
        Self { at_a_time, of_address, inner: Mutex::default() }
    }

    /// A place for one more connection; none if all that could make room have a call under way.
    pub(super) fn enter(self: &Arc<Self>, address: IpAddr, now: Instant) -> Option<Seat> {
        let address = network_of(address);
        let mut inner = self.lock();
        let has_room = inner.make_room_at(address, self.of_address) && inner.make_room(self.at_a_time);
        if !has_room {
            inner.refused += 1;
            // Told at 1, 2, 4, 8 …: a crowd at the door must not fill the log as well.
            if inner.refused.is_power_of_two() {
                tracing::warn!(%address, refused = inner.refused, "connections were refused, as all places have calls under way");
            }
            return None;
        }
        let (id, told_to_go) = (inner.next, Arc::new(Notify::new()));
        inner.next += 1;
        inner.addresses.entry(address).or_default().open += 1;
        let entry = Entry { address, calls: 0, silent_since: None, told_to_go: told_to_go.clone() };
        inner.open.insert(id, entry);
        inner.set_silent(id, Some(now));
        drop(inner);
        let state = State {
            calls: 0,
            next_call: 0,
            is_multiplexed: false,
            silent_since: now,
            head_since: Some(now),
            blocked_since: None,
            untaken: BTreeMap::new(),
        };
        Some(Seat { table: self.clone(), id, told_to_go, state: Mutex::new(state) })
    }

    /// Ends the connection that has been silent the longest, if there is one.
    pub(super) fn make_room(&self) {
        let mut inner = self.lock();
        let open = inner.open.len();
        inner.make_room(open);
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Inner {
    /// Whether there are fewer connections than `limit`, perhaps as a silent one was told to go.
    fn make_room(&mut self, limit: usize) -> bool {
        if self.open.len() < limit {
            return true;
        }
        let longest = self.silent.first().map(|(_, id)| *id);
        longest.is_some_and(|id| self.tell_to_go(id))
    }

    /// The same among those of an address.
    fn make_room_at(&mut self, address: IpAddr, limit: usize) -> bool {
        let Some(of_address) = self.addresses.get(&address) else { return true };
        if of_address.open < limit {
            return true;
        }
        let longest = of_address.silent.first().map(|(_, id)| *id);
        longest.is_some_and(|id| self.tell_to_go(id))
    }

    fn tell_to_go(&mut self, id: u64) -> bool {
        let told = self.open.get(&id).map(|entry| entry.told_to_go.notify_one()).is_some();
        self.remove(id);
        told
    }

    fn set_silent(&mut self, id: u64, since: Option<Instant>) {
        // One that was told to go has no entry any more.
        let Some(entry) = self.open.get_mut(&id) else { return };
        let of_address = self.addresses.entry(entry.address).or_default();
        if let Some(before) = std::mem::replace(&mut entry.silent_since, since) {
            self.silent.remove(&(before, id));
            of_address.silent.remove(&(before, id));
        }
        if let Some(since) = since {
            self.silent.insert((since, id));
            of_address.silent.insert((since, id));
        }
    }

    /// Whether one more call may begin while its address has fewer than `limit`.
    fn begin_call(&mut self, id: u64, limit: usize) -> bool {
        // One that was told to go is about to end, and its calls with it.
        let Some(entry) = self.open.get_mut(&id) else { return true };
        let of_address = self.addresses.entry(entry.address).or_default();
        // A connection's first call needs no more room than the connection.
        if entry.calls > 0 && of_address.calls >= limit {
            return false;
        }
        entry.calls += 1;
        of_address.calls += 1;
        self.set_silent(id, None);
        true
    }

    fn end_call(&mut self, id: u64, now: Instant) {
        let Some(entry) = self.open.get_mut(&id) else { return };
        entry.calls -= 1;
        let is_last = entry.calls == 0;
        if let Some(of_address) = self.addresses.get_mut(&entry.address) {
            of_address.calls -= 1;
        }
        if is_last {
            self.set_silent(id, Some(now));
        }
    }

    fn remove(&mut self, id: u64) {
        self.set_silent(id, None);
        let Some(entry) = self.open.remove(&id) else { return };
        if let Some(of_address) = self.addresses.get_mut(&entry.address) {
            of_address.open -= 1;
            of_address.calls -= entry.calls;
            if of_address.open == 0 {
                self.addresses.remove(&entry.address);
            }
        }
    }
}

/// The address as one caller: whoever has one address of IPv6 has the 64 bits below it, too.
fn network_of(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V4(address) => address.into(),
        IpAddr::V6(address) => Ipv6Addr::from_bits(address.to_bits() >> 64 << 64).into(),
    }
}

/// One connection's place.
pub(super) struct Seat {
    table: Arc<Table>,
    id: u64,
    told_to_go: Arc<Notify>,
    state: Mutex<State>,
}

struct State {
    /// Calls under way; their answers are not sent yet.
    calls: u32,
    next_call: u64,
    /// It has several calls at a time, and says more than heads between them.
    is_multiplexed: bool,
    silent_since: Instant,
    /// First byte of a head that is not complete.
    head_since: Option<Instant>,
    /// The caller takes nothing of what is sent.
    blocked_since: Option<Instant>,
    /// Calls a piece of whose answer was handed over and nothing asked for since.
    untaken: BTreeMap<u64, Instant>,
}

/// A call under way.
pub(super) struct Call {
    seat: Arc<Seat>,
    id: u64,
    /// It has others beside it on its connection.
    pub(super) is_multiplexed: bool,
}

impl Call {
    /// The caller is ready for more of the answer.
    pub(super) fn note_taken(&self) {
        self.seat.lock().untaken.remove(&self.id);
    }

    /// A piece of the answer was handed over.
    pub(super) fn note_handed(&self, now: Instant) {
        self.seat.lock().untaken.insert(self.id, now);
    }
}

impl Seat {
    /// A call begins; it ends when the answer is dropped. None if its address has as many as it may have connections.
    pub(super) fn begin(self: &Arc<Self>, is_multiplexed: bool) -> Option<Call> {
        let mut state = self.lock();
        state.is_multiplexed = is_multiplexed;
        state.head_since = None;
        if !self.table.lock().begin_call(self.id, self.table.of_address) {
            return None;
        }
        state.calls += 1;
        state.next_call += 1;
        let id = state.next_call;
        drop(state);
        Some(Call { seat: self.clone(), id, is_multiplexed })
    }

    fn finish(&self, call: u64, now: Instant) {
        let mut state = self.lock();
        state.untaken.remove(&call);
        state.calls -= 1;
        if state.calls == 0 {
            state.silent_since = now;
        }
        self.table.lock().end_call(self.id, now);
    }

    /// Bytes came.
    pub(super) fn note_read(&self, now: Instant) {
        let mut state = self.lock();
        if state.calls == 0 && !state.is_multiplexed {
            state.head_since.get_or_insert(now);
        }
    }

    /// Bytes were to go, and did unless the caller takes none.
    pub(super) fn note_write(&self, is_blocked: bool, now: Instant) {
        let mut state = self.lock();
        match is_blocked {
            true => _ = state.blocked_since.get_or_insert(now),
            false => state.blocked_since = None,
        }
    }

    /// Waits until the connection must end; the reason. The server closes once `closing` is done.
    pub(super) async fn end(
        &self,
        config: &ConnectionConfig,
        closing: impl Future<Output = ()>,
    ) -> &'static str {
        let (mut closing, mut closing_since) = (pin!(closing), None);
        loop {
            let (now, due) = (Instant::now(), self.due(config, closing_since));
            if let Some((_, why)) = due.filter(|(due, _)| *due <= now) {
                return why;
            }
            // A head may begin, or an answer get stuck, after this look.
            let look_again = if closing_since.is_some() { CLOSING_LOOK } else { config.head_timeout };
            let next = now + look_again.min(config.stall_timeout);
            let next = due.map_or(next, |(due, _)| due.min(next));
            tokio::select! {
                () = self.told_to_go.notified() => return "it was silent, and its place was needed",
                () = &mut closing, if closing_since.is_none() => closing_since = Some(Instant::now()),
                () = tokio::time::sleep_until(next.into()) => (),
            }
        }
    }

    /// When it must end if nothing more comes to pass, and why.
    fn due(
        &self,
        config: &ConnectionConfig,
        closing_since: Option<Instant>,
    ) -> Option<(Instant, &'static str)> {
        let state = self.lock();
        let stalled = state.blocked_since.into_iter().chain(state.untaken.values().copied()).min();
        let stalled = stalled
            .map(|since| (since + config.stall_timeout, "its caller took nothing of an answer for too long"));
        let silent = (state.calls == 0).then(|| match state.head_since {
            Some(since) => (since + config.head_timeout, "a request's head took too long"),
            None => (state.silent_since + config.idle_timeout, "no request came"),
        });
        // An answer that is still being written has its time.
        let closing =
            closing_since.filter(|_| state.calls == 0 && state.blocked_since.is_none()).map(|since| {
                let grace = if state.head_since.is_some() { Duration::ZERO } else { CLOSING_GRACE };
                (since.max(state.silent_since) + grace, "the server closes")
            });
        stalled.into_iter().chain(silent).chain(closing).min()
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.table.lock().remove(self.id);
    }
}

impl Drop for Call {
    fn drop(&mut self) {
        self.seat.finish(self.id, Instant::now());
    }
}

#[cfg(test)]
mod tests {
    use futures::FutureExt;
    use std::future::{pending, ready};
    use std::net::Ipv4Addr;

    use super::*;

    const ONE: IpAddr = IpAddr::V4(Ipv4Addr::new(10, 0, 0, 1));
    const TWO: IpAddr = IpAddr::V4(Ipv4Addr::new(10, 0, 0, 2));

    fn table(at_a_time: u32, of_address: u32) -> Arc<Table> {
        Arc::new(Table::new(&ConnectionConfig { at_a_time, of_address, ..ConnectionConfig::default() }))
    }

    fn enter(table: &Arc<Table>, address: IpAddr) -> Option<Arc<Seat>> {
        table.enter(address, Instant::now()).map(Arc::new)
    }

    fn is_told_to_go(seat: &Seat) -> bool {
        seat.told_to_go.notified().now_or_never().is_some()
    }

    #[test]
    fn longest_silent_connection_makes_room_and_one_with_a_call_does_not() {
        let table = table(3, 0);
        let seats = [ONE, ONE, ONE].map(|address| enter(&table, address).expect("there is room for three"));
        let [first, second] = [seats[0].begin(false).unwrap(), seats[0].begin(false).unwrap()];
        let newer = enter(&table, TWO).expect("a silent one makes room");
        assert!(!is_told_to_go(&seats[0]) && is_told_to_go(&seats[1]));
        assert!(!is_told_to_go(&seats[2]) && !is_told_to_go(&newer));
        drop(first);
        let newest = enter(&table, TWO).expect("another silent one makes room");
        assert!(!is_told_to_go(&seats[0]) && is_told_to_go(&seats[2]), "a call is left");
        let _busy = (newer.begin(false).unwrap(), newest.begin(false).unwrap());
        assert!(enter(&table, TWO).is_none(), "all have calls");
        drop(second);
        assert!(enter(&table, TWO).is_some() && is_told_to_go(&seats[0]));
    }

    #[test]
    fn one_address_takes_no_more_than_its_share_and_leaves_no_trace() {
        let table = table(4, 2);
        let [first, second] = [(); 2].map(|()| enter(&table, ONE).unwrap());
        let call = first.begin(false).unwrap();
        let third = enter(&table, ONE).expect("its own silent one makes room");
        assert!(is_told_to_go(&second) && !is_told_to_go(&first));
        let other = third.begin(false).unwrap();
        assert!(enter(&table, ONE).is_none(), "both of its connections have calls");
        let seats = [(); 2].map(|()| enter(&table, TWO).unwrap());
        drop((call, other, first, second, third, seats));
        let inner = table.lock();
        assert!(inner.open.is_empty() && inner.silent.is_empty() && inner.addresses.is_empty());
    }

    #[test]
    fn heads_idle_connections_and_stuck_answers_have_their_time() {
        let (config, table, began) = (ConnectionConfig::default(), table(0, 0), Instant::now());
        let after = |secs| began + Duration::from_secs(secs);
        let seat = Arc::new(table.enter(ONE, began).unwrap());
        assert_eq!(seat.due(&config, None), Some((after(15), "a request's head took too long")));
        let call = seat.begin(false).unwrap();
        assert_eq!(
            seat.due(&config, None),
            None,
            "a call that waits for work has all the time that it asks for"
        );
        seat.note_read(after(20));
        seat.note_write(true, after(30));
        seat.note_write(true, after(40));
        let stuck = "its caller took nothing of an answer for too long";
        assert_eq!(seat.due(&config, None), Some((after(90), stuck)));
        seat.note_write(false, after(50));
        std::mem::forget(call);
        seat.finish(1, after(50));
        assert_eq!(seat.due(&config, None), Some((after(170), "no request came")));
        seat.note_read(after(60));
        seat.note_read(after(70));
        let late = Some((after(75), "a request's head took too long"));
        assert_eq!(seat.due(&config, None), late, "later bytes give a head no more time");
        std::mem::forget(seat.begin(true).unwrap());
        seat.finish(2, after(80));
        seat.note_read(after(90));
        assert_eq!(seat.due(&config, None), Some((after(200), "no request came")), "pings are no heads");
    }

    #[tokio::test]
    async fn connection_whose_time_is_over_is_ended_with_the_reason() {
        let config =
            ConnectionConfig { head_timeout: Duration::from_millis(20), ..ConnectionConfig::default() };
        let table = table(1, 0);
        let seat = enter(&table, ONE).unwrap();
        assert_eq!(seat.end(&config, pending()).await, "a request's head took too long");
        let silent = table.enter(ONE, Instant::now()).expect("the silent one makes room");
        assert_eq!(
            seat.end(&ConnectionConfig::default(), pending()).await,
            "it was silent, and its place was needed"
        );
        drop(silent);
    }

    #[test]
    fn answer_of_one_call_that_is_not_taken_ends_the_connection_however_busy_the_others_are() {
        let (config, table, began) = (ConnectionConfig::default(), table(0, 0), Instant::now());
        let after = |secs| began + Duration::from_secs(secs);
        let seat = Arc::new(table.enter(ONE, began).unwrap());
        let [refused, taken] = [(); 2].map(|()| seat.begin(true).unwrap());
        refused.note_handed(after(1));
        taken.note_handed(after(2));
        taken.note_taken();
        taken.note_handed(after(50));
        seat.note_write(false, after(50));
        let stuck = "its caller took nothing of an answer for too long";
        assert_eq!(seat.due(&config, None), Some((after(61), stuck)));
        refused.note_taken();
        assert_eq!(seat.due(&config, None), Some((after(110), stuck)));
        drop(taken);
        assert_eq!(seat.due(&config, None), None, "the other waits for work");
    }

    #[test]
    fn address_has_no_more_calls_than_connections() {
        let table = table(0, 2);
        let [first, second] = [(); 2].map(|()| enter(&table, ONE).unwrap());
        let calls = [(); 2].map(|()| first.begin(true).unwrap());
        assert!(first.begin(true).is_none());
        assert!(second.begin(true).is_some(), "each connection has one");
        drop(calls);
        assert!(first.begin(true).is_some());
        let other = enter(&table, TWO).unwrap();
        let calls = [(); 2].map(|()| other.begin(true).unwrap());
        drop((calls, first, second, other));
        assert!(table.lock().addresses.is_empty());
    }

    #[tokio::test]
    async fn when_the_server_closes_half_sent_heads_end_at_once_and_calls_do_not() {
        let (config, table, began) = (ConnectionConfig::default(), table(0, 0), Instant::now());
        let after = |secs| began + Duration::from_secs(secs);
        let seat = Arc::new(table.enter(ONE, began).unwrap());
        assert_eq!(seat.end(&config, ready(())).await, "the server closes");
        let call = seat.begin(false).unwrap();
        assert_eq!(seat.due(&config, Some(after(5))), None);
        seat.note_write(true, after(6));
        std::mem::forget(call);
        seat.finish(1, after(6));
        let stuck = "its caller took nothing of an answer for too long";
        assert_eq!(seat.due(&config, Some(after(5))), Some((after(66), stuck)), "its end is being written");
        seat.note_write(false, after(7));
        assert_eq!(seat.due(&config, Some(after(5))), Some((after(6) + CLOSING_GRACE, "the server closes")));
    }

    #[test]
    fn addresses_of_one_network_are_one_caller() {
        let of = |text: &str| network_of(text.parse().unwrap());
        assert_eq!(of("2001:db8:1:2:3:4:5:6"), of("2001:db8:1:2::9"));
        assert_ne!(of("2001:db8:1:2::9"), of("2001:db8:1:3::9"));
        assert_eq!(of("::ffff:10.0.0.1"), ONE);
        assert_ne!(of("10.0.0.1"), of("10.0.0.2"));
    }
}
