//! A worker's seat on its machine: a name that outlives the process, and a note of the leases in hand. A process that ends without a
//! word leaves it, and the next one in the seat tells the farm what became of its tasks: none waits for a lease to run out.
//!
//! ```text
//! FOLDER/N.seat    locked while a process has the seat; its id
//! FOLDER/N.held    its machine, leases in hand and what was seen of the memory, JSON
//! ```
//!
//! Locks of a shared folder may hold on one machine alone; so a seat is its machine's for ever.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions, TryLockError};
use std::hash::{BuildHasher as _, RandomState};
use std::io::{self, Read as _, Seek as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use lightkiln_proto::api::{Blame, Failure};
use serde::{Deserialize, Serialize};

use super::gauge::{Kernel, Kills};
use super::host::Host;

/// Most seats of a folder that are looked at for one that is free.
const SEATS_MAX: u32 = 10_000;
/// Characters of an id: 64 bits, as a studio may have workers on machines that have all one name.
const ID_CHARS: usize = 16;

/// A seat, for as long as it is not dropped.
#[derive(Debug)]
pub struct Seat {
    id: String,
    path: PathBuf,
    notes: Mutex<Notes>,
    /// Held, not read.
    _lock: File,
}

#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
struct Notes {
    /// Machine of the process.
    host: Host,
    /// By token.
    leases: BTreeMap<String, Held>,
    /// Memory that was nearly used up, in words.
    near: Option<String>,
    /// The kernel's kills for memory when the process last looked.
    kills: Kills,
}

/// A lease that was in hand.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Held {
    /// URL of the farm.
    server: String,
    /// Label of its task.
    label: String,
    /// End of the process that had it; none while that goes on.
    end: Option<End>,
}

/// How a process ended that left a lease, as far as one can tell.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum End {
    Unknown,
    /// For memory, and what tells so; probably, unless the kernel says it of a process that had no other task.
    Memory {
        why: String,
        is_sure: bool,
    },
}

impl Seat {
    /// Takes the first free seat of a folder, which is made if need be.
    pub fn take(folder: &Path) -> io::Result<Self> {
        Self::take_on(folder, &Host::here())
    }

    fn take_on(folder: &Path, host: &Host) -> io::Result<Self> {
        std::fs::create_dir_all(folder)?;
        for number in 0..SEATS_MAX {
            let mut lock = OpenOptions::new()
                .read(true)
                .write(true)
                .create(true)
                .truncate(false)
                .open(folder.join(format!("{number}.seat")))?;
            match lock.try_lock() {
                Ok(()) => (),
                Err(TryLockError::WouldBlock) => continue,
                Err(TryLockError::Error(error)) => return Err(error),
            }
            let path = folder.join(format!("{number}.held"));
            let notes = notes_at(&path);
            if notes.as_ref().is_none_or(|notes| notes.host.is_same(host)) {
                let (id, kills) = (id_of(&mut lock)?, Kernel::default().kills());
                return Ok(Self::open(id, path, notes.unwrap_or_default(), (host, kills), lock));
            }
        }
        Err(io::Error::other(format!("{SEATS_MAX} workers have a seat there")))
    }

    fn open(id: String, path: PathBuf, mut notes: Notes, (host, kills): (&Host, Kills), lock: File) -> Self {
        let end = end_of(&notes, host, &kills);
        for held in notes.leases.values_mut() {
            held.end.get_or_insert_with(|| end.clone());
        }
        (notes.host, notes.near, notes.kills) = (host.clone(), None, kills);
        let seat = Self { id, path, notes: Mutex::new(notes), _lock: lock };
        seat.write(&seat.lock());
        seat
    }

    /// Sixteen characters that make a name of it, the same for every process that has the seat.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// Leases of a farm that former processes left: their tokens, and what there is to say about each.
    pub(super) fn left(&self, server: &str, name: &str) -> Vec<(String, Failure)> {
        let notes = self.lock();
        let left = notes.leases.iter().filter(|(_, held)| held.server == server);
        left.filter_map(|(token, held)| Some((token.clone(), failure(name, held.end.as_ref()?)))).collect()
    }

    /// Notes that leases are in hand, each by its token and the label of its task.
    pub(super) fn hold<'a>(&self, server: &str, leases: impl IntoIterator<Item = (&'a str, &'a str)>) {
        let held = |(token, label): (&str, &str)| {
            (token.to_owned(), Held { server: server.to_owned(), label: label.to_owned(), end: None })
        };
        self.change(|notes| notes.leases.extend(leases.into_iter().map(held)));
    }

    /// Notes that a lease needs nothing more.
    pub(super) fn let_go(&self, token: &str) {
        self.change(|notes| drop(notes.leases.remove(token)));
    }

    /// Whether a former process ended for memory, as it seems, while it had several tasks.
    pub(super) fn left_several_for_memory(&self) -> bool {
        let notes = self.lock();
        let ends = notes.leases.values().filter(|held| matches!(held.end, Some(End::Memory { .. })));
        ends.count() > 1
    }

    /// Notes the memory that is nearly used up, if any, and the kernel's kills.
    pub(super) fn note_memory(&self, (near, kills): (Option<String>, Kills)) {
        self.change(|notes| (notes.near, notes.kills) = (near, kills));
    }

    fn change(&self, change: impl FnOnce(&mut Notes)) {
        let mut notes = self.lock();
        change(&mut notes);
        self.write(&notes);
    }

    /// A note that cannot be written costs the length of a lease, should this process end without a word.
    fn write(&self, notes: &Notes) {
        let beside = self.path.with_extension("held-new");
        let json = serde_json::to_vec(notes).unwrap_or_default();
        if let Err(error) = std::fs::write(&beside, json).and_then(|()| std::fs::rename(&beside, &self.path))
        {
            tracing::warn!(%error, file = %self.path.display(), "the leases in hand could not be noted");
        }
    }

    fn lock(&self) -> MutexGuard<'_, Notes> {
        self.notes.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Notes that cannot be read are those of a machine that went down while they were written: leases run out then.
fn notes_at(path: &Path) -> Option<Notes> {
    std::fs::read(path).ok().and_then(|json| serde_json::from_slice(&json).ok())
}

/// The end of a process as its notes tell it, beside the kernel's kills by now.
///
/// A group that outlived the process says it of that group. Units and containers have a new one with each start: then groups above tell,
/// where they are seen, that it was one of many that the kernel ended.
fn end_of(notes: &Notes, host: &Host, kills: &Kills) -> End {
    let is_more =
        |group: &String, now: &u64| notes.kills.counts.get(group).is_some_and(|before| now > before);
    let killed: Vec<&String> = match notes.host.is_same_start(host) {
        true => {
            kills.counts.iter().filter(|(group, now)| is_more(group, now)).map(|(group, _)| group).collect()
        }
        false => Vec::new(),
    };
    let in_hand = notes.leases.values().filter(|held| held.end.is_none()).count();
    if killed.contains(&&notes.kills.group) {
        let why = "the kernel ended a process of this worker's group for want of memory".to_owned();
        return End::Memory { why, is_sure: in_hand == 1 };
    }
    let above = "the kernel ended a process of a group around this worker's for want of memory";
    let why = notes.near.clone().or_else(|| (!killed.is_empty()).then(|| above.to_owned()));
    why.map_or(End::Unknown, |why| End::Memory { why, is_sure: false })
}

/// The report of a lease that an ended process had: memory that surely ran out by its task is a failure of its worker, all else a loss.
fn failure(name: &str, end: &End) -> Failure {
    let ended = format!("worker {name} ended without a word while it had the task");
    match end {
        End::Unknown => Failure {
            blame: Blame::Lost,
            message: format!("{ended}: it was killed, crashed, or its machine went down"),
        },
        End::Memory { why, is_sure: true } => {
            Failure { blame: Blame::Worker, message: format!("out of memory: {ended}, and {why}") }
        }
        End::Memory { why, is_sure: false } => {
            Failure { blame: Blame::Lost, message: format!("{ended}, probably out of memory: {why}") }
        }
    }
}

/// The id in a seat's file; made for the first process that has it.
fn id_of(file: &mut File) -> io::Result<String> {
    let mut id = String::new();
    file.read_to_string(&mut id)?;
    if id.len() == ID_CHARS && id.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return Ok(id);
    }
    let id = new_id();
    file.rewind()?;
    file.set_len(0)?;
    file.write_all(id.as_bytes())?;
    Ok(id)
}

/// Sixteen characters that no other process has made, on whatever machine.
pub fn new_id() -> String {
    // Keys of the standard library's hashes come from the system's random bytes.
    format!("{:016x}", RandomState::new().hash_one(std::process::id()))
}

#[cfg(test)]
mod tests {
    use super::super::host::tests::host;
    use super::*;

    #[test]
    fn seat_keeps_its_id_and_is_nobody_elses_meanwhile() {
        let folder = tempfile::tempdir().unwrap();
        let first = Seat::take(folder.path()).unwrap();
        let second = Seat::take(folder.path()).unwrap();
        let (id, other) = (first.id().to_owned(), second.id().to_owned());
        assert!(id.len() == ID_CHARS && id != other && first.path != second.path);
        drop(first);
        assert_eq!(Seat::take(folder.path()).unwrap().id(), id);
        drop(second);
        let again = [Seat::take(folder.path()).unwrap(), Seat::take(folder.path()).unwrap()];
        assert_eq!(again.each_ref().map(Seat::id), [id.as_str(), other.as_str()]);
    }

    #[test]
    fn leases_that_a_process_left_are_told_until_they_are_let_go() {
        let folder = tempfile::tempdir().unwrap();
        let seat = Seat::take(folder.path()).unwrap();
        seat.hold("http://farm", [("done", "a")]);
        seat.hold("http://farm", [("left", "b")]);
        seat.hold("http://other", [("elsewhere", "c")]);
        seat.let_go("done");
        assert!(seat.left("http://farm", "w").is_empty(), "they are in hand");
        drop(seat);
        for _ in 0..2 {
            let seat = Seat::take(folder.path()).unwrap();
            let left = seat.left("http://farm", "w");
            assert_eq!(
                left.iter().map(|(token, failure)| (token.as_str(), failure.blame)).collect::<Vec<_>>(),
                [("left", Blame::Lost)]
            );
            // A lease that the next process takes is none that was left.
            seat.hold("http://farm", [("new", "d")]);
            seat.let_go("new");
        }
        let seat = Seat::take(folder.path()).unwrap();
        seat.let_go("left");
        assert!(seat.left("http://farm", "w").is_empty());
        assert_eq!(seat.left("http://other", "w").len(), 1);
    }

    #[test]
    fn end_when_memory_was_nearly_used_up_is_a_loss_that_says_so() {
        let folder = tempfile::tempdir().unwrap();
        let seat = Seat::take(folder.path()).unwrap();
        seat.hold("http://farm", [("token", "a")]);
        seat.note_memory((Some("nearly all memory of this machine was in use".to_owned()), Kills::default()));
        drop(seat);
        let seat = Seat::take(folder.path()).unwrap();
        let (_, Failure { blame, message }) = &seat.left("http://farm", "w")[0];
        assert!(
            *blame == Blame::Lost
                && message.contains("probably out of memory: ")
                && message.contains("machine"),
            "{message}"
        );
        assert!(!seat.left_several_for_memory());
        seat.hold("http://farm", [("other", "b")]);
        assert!(!seat.left_several_for_memory(), "it is in hand");
        seat.note_memory((Some("nearly all memory of this machine was in use".to_owned()), Kills::default()));
        drop(seat);
        assert!(Seat::take(folder.path()).unwrap().left_several_for_memory());
    }

    /// Notes of a process that had so many leases, and saw so many kills in its group and the one above.
    fn notes(leases: usize, kills: Kills) -> Notes {
        let held = Held { server: "http://farm".to_owned(), label: "a".to_owned(), end: None };
        let leases = (0..leases).map(|number| (number.to_string(), held.clone())).collect();
        Notes { host: host("oven", "1"), leases, near: None, kills }
    }

    fn kills(group: &str, in_it: u64, above: u64) -> Kills {
        let counts = [(group.to_owned(), in_it), ("above".to_owned(), above)].into();
        Kills { group: group.to_owned(), counts }
    }

    #[test]
    fn kernels_kills_tell_of_an_end_for_memory() {
        let end = |leases, now: &Kills| end_of(&notes(leases, kills("g", 1, 5)), &host("oven", "1"), now);
        let is_sure = |end: End| match end {
            End::Unknown => None,
            End::Memory { is_sure, .. } => Some(is_sure),
        };
        assert_eq!(is_sure(end(1, &kills("g", 1, 5))), None);
        // Its group outlived it.
        assert_eq!(is_sure(end(1, &kills("g", 2, 6))), Some(true));
        assert_eq!(is_sure(end(2, &kills("g", 2, 6))), Some(false), "either task may have been it");
        // Its group was made anew.
        assert_eq!(is_sure(end(1, &kills("g", 0, 6))), Some(false));
        assert_eq!(is_sure(end(1, &kills("h", 9, 6))), Some(false));
        assert_eq!(is_sure(end(1, &kills("h", 9, 5))), None);
        let since = end_of(&notes(1, kills("g", 1, 5)), &host("oven", "2"), &kills("g", 2, 6));
        assert_eq!(is_sure(since), None, "counts begin anew with each start of the machine");
        let told = failure("w", &end(1, &kills("g", 2, 6)));
        assert!(told.blame == Blame::Worker && told.message.starts_with("out of memory: "), "{told:?}");
    }

    #[test]
    fn seat_of_another_machine_and_its_leases_are_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let take = |name: &str, boot: &str| Seat::take_on(folder.path(), &host(name, boot)).unwrap();
        let seat = take("oven", "1");
        seat.hold("http://farm", [("live", "a")]);
        let (id, path) = (seat.id().to_owned(), seat.path.clone());
        let noted = std::fs::read(&path).unwrap();
        // As locks that hold on one machine alone: it does live on.
        drop(seat);
        let other = take("kiln", "2");
        assert!(other.id() != id && other.left("http://farm", "w").is_empty());
        assert_eq!(std::fs::read(&path).unwrap(), noted);
        drop(other);
        let again = take("oven", "3");
        assert_eq!((again.id(), again.left("http://farm", "w").len()), (id.as_str(), 1));
    }

    #[test]
    fn notes_that_cannot_be_read_are_begun_anew() {
        let folder = tempfile::tempdir().unwrap();
        let seat = Seat::take(folder.path()).unwrap();
        std::fs::write(&seat.path, "{ not").unwrap();
        drop(seat);
        let seat = Seat::take(folder.path()).unwrap();
        seat.hold("http://farm", [("token", "a")]);
        drop(seat);
        assert_eq!(Seat::take(folder.path()).unwrap().left("http://farm", "w").len(), 1);
    }
}
