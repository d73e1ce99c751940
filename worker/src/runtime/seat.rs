//! A worker's seat on its machine: a name that outlives the process, and a note of the leases in hand. A process that ends without a
//! word leaves it, and the next one in the seat tells the farm what became of its tasks: none waits for a lease to run out.
//!
//! ```text
//! FOLDER/N.seat    locked while a process has the seat; its id
//! FOLDER/N.held    leases in hand and what was seen of the memory, JSON
//! ```

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions, TryLockError};
use std::hash::{BuildHasher as _, RandomState};
use std::io::{self, Read as _, Seek as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use lightkiln_proto::api::{Blame, Failure};
use serde::{Deserialize, Serialize};

use super::memory;

/// Most seats of a folder that are looked at for one that is free.
const SEATS_MAX: u32 = 10_000;

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
    /// By token.
    leases: BTreeMap<String, Held>,
    /// Memory that was nearly used up, in words.
    near: Option<String>,
    /// The kernel's kills for memory when the process began.
    kills: Option<(String, u64)>,
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
    /// For memory, and what tells so.
    Memory(String),
}

impl Seat {
    /// Takes the first free seat of a folder, which is made if need be.
    pub fn take(folder: &Path) -> io::Result<Self> {
        std::fs::create_dir_all(folder)?;
        for number in 0..SEATS_MAX {
            let mut lock = OpenOptions::new()
                .read(true)
                .write(true)
                .create(true)
                .truncate(false)
                .open(folder.join(format!("{number}.seat")))?;
            match lock.try_lock() {
                Ok(()) => {
                    let id = id_of(&mut lock)?;
                    return Ok(Self::open(id, folder.join(format!("{number}.held")), memory::kills(), lock));
                }
                Err(TryLockError::WouldBlock) => (),
                Err(TryLockError::Error(error)) => return Err(error),
            }
        }
        Err(io::Error::other(format!("{SEATS_MAX} workers have a seat there")))
    }

    fn open(id: String, path: PathBuf, kills: Option<(String, u64)>, lock: File) -> Self {
        // Notes that cannot be read are those of a machine that went down while they were written: leases run out then.
        let found = std::fs::read(&path).ok().and_then(|json| serde_json::from_slice::<Notes>(&json).ok());
        let mut notes = found.unwrap_or_default();
        let end = end_of(&notes, kills.as_ref());
        for held in notes.leases.values_mut() {
            held.end.get_or_insert_with(|| end.clone());
        }
        (notes.near, notes.kills) = (None, kills);
        let seat = Self { id, path, notes: Mutex::new(notes), _lock: lock };
        seat.write(&seat.lock());
        seat
    }

    /// Four characters that make a name of it, the same for every process that has the seat.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// Leases of a farm that former processes left: their tokens, and what there is to say about each.
    pub(super) fn left(&self, server: &str, name: &str) -> Vec<(String, Failure)> {
        let notes = self.lock();
        let left = notes.leases.iter().filter(|(_, held)| held.server == server);
        left.filter_map(|(token, held)| Some((token.clone(), failure(name, held.end.as_ref()?)))).collect()
    }

    /// Notes that a lease is in hand.
    pub(super) fn hold(&self, server: &str, token: &str, label: &str) {
        let held = Held { server: server.to_owned(), label: label.to_owned(), end: None };
        self.change(|notes| drop(notes.leases.insert(token.to_owned(), held)));
    }

    /// Notes that a lease needs nothing more.
    pub(super) fn let_go(&self, token: &str) {
        self.change(|notes| drop(notes.leases.remove(token)));
    }

    /// Notes that memory is nearly used up, or not any more.
    pub(super) fn note_memory(&self, near: Option<String>) {
        self.change(|notes| notes.near = near);
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

/// The end of a process as its notes tell it, beside the kernel's kills by now.
fn end_of(notes: &Notes, kills: Option<&(String, u64)>) -> End {
    match (&notes.kills, kills) {
        (Some((group, before)), Some((same, now))) if group == same && now > before => {
            End::Memory("the kernel ended a process of this worker's group for want of memory".to_owned())
        }
        _ => notes.near.clone().map_or(End::Unknown, End::Memory),
    }
}

/// The report of a lease that an ended process had: memory that ran out is a failure of its worker, everything else a loss.
fn failure(name: &str, end: &End) -> Failure {
    match end {
        End::Unknown => Failure {
            blame: Blame::Lost,
            message: format!(
                "worker {name} ended without a word while it had the task: it was killed, crashed, or its machine went down"
            ),
        },
        End::Memory(why) => Failure {
            blame: Blame::Worker,
            message: format!(
                "out of memory: worker {name} ended without a word while it had the task, and {why}"
            ),
        },
    }
}

/// The id in a seat's file; made for the first process that has it.
fn id_of(file: &mut File) -> io::Result<String> {
    let mut id = String::new();
    file.read_to_string(&mut id)?;
    if id.len() == 4 && id.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return Ok(id);
    }
    // Keys of the standard library's hashes come from the system's random bytes.
    let id = format!("{:04x}", RandomState::new().hash_one(std::process::id()) & 0xffff);
    file.rewind()?;
    file.set_len(0)?;
    file.write_all(id.as_bytes())?;
    Ok(id)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seat_keeps_its_id_and_is_nobody_elses_meanwhile() {
        let folder = tempfile::tempdir().unwrap();
        let first = Seat::take(folder.path()).unwrap();
        let second = Seat::take(folder.path()).unwrap();
        let (id, other) = (first.id().to_owned(), second.id().to_owned());
        assert!(id.len() == 4 && first.path != second.path);
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
        seat.hold("http://farm", "done", "a");
        seat.hold("http://farm", "left", "b");
        seat.hold("http://other", "elsewhere", "c");
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
            seat.hold("http://farm", "new", "d");
            seat.let_go("new");
        }
        let seat = Seat::take(folder.path()).unwrap();
        seat.let_go("left");
        assert!(seat.left("http://farm", "w").is_empty());
        assert_eq!(seat.left("http://other", "w").len(), 1);
    }

    #[test]
    fn end_for_memory_is_told_as_that() {
        let folder = tempfile::tempdir().unwrap();
        let seat = Seat::take(folder.path()).unwrap();
        seat.hold("http://farm", "token", "a");
        seat.note_memory(Some("nearly all memory of this machine was in use".to_owned()));
        drop(seat);
        let left = Seat::take(folder.path()).unwrap().left("http://farm", "w");
        let (_, Failure { blame, message }) = &left[0];
        assert!(
            *blame == Blame::Worker && message.starts_with("out of memory: ") && message.contains("machine"),
            "{message}"
        );
        // The kernel's own count says it as well, of the same group.
        let kills = |group: &str, count| Some((group.to_owned(), count));
        let notes = Notes { kills: kills("g", 1), ..Notes::default() };
        assert!(matches!(end_of(&notes, kills("g", 2).as_ref()), End::Memory(_)));
        for now in [kills("g", 1), kills("h", 2), None] {
            assert_eq!(end_of(&notes, now.as_ref()), End::Unknown);
        }
    }

    #[test]
    fn notes_that_cannot_be_read_are_begun_anew() {
        let folder = tempfile::tempdir().unwrap();
        let seat = Seat::take(folder.path()).unwrap();
        std::fs::write(&seat.path, "{ not").unwrap();
        drop(seat);
        let seat = Seat::take(folder.path()).unwrap();
        seat.hold("http://farm", "token", "a");
        drop(seat);
        assert_eq!(Seat::take(folder.path()).unwrap().left("http://farm", "w").len(), 1);
    }
}
