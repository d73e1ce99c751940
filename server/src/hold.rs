//! Who may have a state folder open: one server alone, or any number of bakes of one machine beside each other.
//!
//! ```text
//! STATE/lock         held by a server alone, by bakes together
//! STATE/seats/N      held by the bake in seat N; its text says which process that is
//! STATE/seats/gate   held while a bake takes a seat
//! ```
//! The operating system lets go of a lock when its process ends, however it ends: none is ever left over. What a killed
//! bake leaves is known by its seat, which is free by then ([`seats`]).
//!
//! Bakes of several machines are kept apart, as SQLite's log is shared through memory; a folder on a network's disk may be
//! reached by more than one.

use std::fs::{File, TryLockError};
use std::io::Write as _;
use std::path::Path;

use crate::error::{Result, ServerError};
use crate::occupant::Occupant;

/// Text of a folder's lock that a server holds, before its process.
const SERVER: &str = "server";

/// The right to have a state folder open. It goes with the last file.
#[derive(Debug)]
pub(crate) struct Hold {
    _locks: Vec<File>,
}

/// A seat at a state folder, while the gate behind it is still closed.
#[derive(Debug)]
pub(crate) struct Seating {
    /// To be kept for as long as the folder is open.
    pub(crate) hold: Hold,
    /// The seat's name.
    pub(crate) name: String,
    /// Those of other bakes that have the folder open, and their processes.
    pub(crate) others: Vec<(String, u32)>,
    /// Those that nobody has, its own among them, and the last process that had each.
    pub(crate) free: Vec<(String, u32)>,
    /// Nobody else takes a seat until this is dropped.
    pub(crate) gate: File,
}

/// Takes a folder, which is made if need be, for a server.
pub(crate) fn alone(folder: &Path) -> Result<Hold> {
    make_folder(folder)?;
    let path = folder.join("lock");
    let lock = open(&path)?;
    if !is_locked_by(&path, lock.try_lock())? {
        let by = occupant(folder)?;
        return Err(ServerError::StateInUse { path: folder.to_owned(), by });
    }
    sign(&lock, &path, SERVER)?;
    Ok(Hold { _locks: vec![lock] })
}

/// Takes a seat at a folder, which is made if need be: the first that is free.
pub(crate) fn take_seat(folder: &Path) -> Result<Seating> {
    let in_use = |by| ServerError::StateInUse { path: folder.to_owned(), by };
    let seats = folder.join("seats");
    make_folder(&seats)?;
    let gate_path = seats.join("gate");
    let gate = open(&gate_path)?;
    if !is_locked_by(&gate_path, gate.try_lock())? {
        return Err(in_use(Occupant::Starting));
    }
    let path = folder.join("lock");
    let lock = open(&path)?;
    if !is_locked_by(&path, lock.try_lock_shared())? {
        return Err(in_use(
            read(&path)
                .filter(|sign| sign.is_server)
                .map_or(Occupant::Unknown, |sign| Occupant::Server(sign.process)),
        ));
    }
    let (mut free, mut others, mut vacant) = (None, Vec::new(), Vec::new());
    for number in 0_u32.. {
        let path = seats.join(number.to_string());
        let is_last = !path.exists();
        if is_last && free.is_some() {
            break;
        }
        let seat = open(&path)?;
        if is_locked_by(&path, seat.try_lock())? {
            vacant.push((name_of(number), read(&path).map_or(0, |sign| sign.process)));
            free.get_or_insert((number, seat, path));
        } else {
            let sign = read(&path);
            if sign.as_ref().is_some_and(|sign| sign.machine != machine()) {
                return Err(in_use(Occupant::OtherMachine));
            }
            others.push((name_of(number), sign.map_or(0, |sign| sign.process)));
        }
        if is_last {
            break;
        }
    }
    let Some((number, seat, path)) = free else { return Err(in_use(Occupant::Starting)) };
    sign(&seat, &path, "bake")?;
    Ok(Seating { hold: Hold { _locks: vec![lock, seat] }, name: name_of(number), others, free: vacant, gate })
}

/// Seats of a folder as they are while nobody takes one.
#[derive(Debug)]
pub(crate) struct Seats {
    /// Names of those that are held.
    pub(crate) held: Vec<String>,
    /// Names of those that are free, and the last process that had each.
    pub(crate) free: Vec<(String, u32)>,
    /// Nobody takes a seat until this is dropped.
    _gate: File,
}

/// The seats of a folder; nothing while a bake takes its own.
pub(crate) fn seats(folder: &Path) -> Result<Option<Seats>> {
    let seats = folder.join("seats");
    let gate_path = seats.join("gate");
    let gate = open(&gate_path)?;
    if !is_locked_by(&gate_path, gate.try_lock())? {
        return Ok(None);
    }
    let (mut held, mut free) = (Vec::new(), Vec::new());
    for number in 0_u32.. {
        let path = seats.join(number.to_string());
        if !path.exists() {
            break;
        }
        if is_locked_by(&path, open(&path)?.try_lock())? {
            free.push((name_of(number), read(&path).map_or(0, |sign| sign.process)));
        } else {
            held.push(name_of(number));
        }
    }
    Ok(Some(Seats { held, free, _gate: gate }))
}

fn name_of(number: u32) -> String {
    format!("bake-{number}")
}

/// Who holds a folder's lock, as far as its files tell.
fn occupant(folder: &Path) -> Result<Occupant> {
    if let Some(sign) = read(&folder.join("lock")).filter(|sign| sign.is_server) {
        return Ok(Occupant::Server(sign.process));
    }
    let seats = folder.join("seats");
    let mut bakes = Vec::new();
    for path in (0_u32..).map(|number| seats.join(number.to_string())).take_while(|path| path.exists()) {
        if !is_locked_by(&path, open(&path)?.try_lock_shared())?
            && let Some(sign) = read(&path)
        {
            bakes.push(sign.process);
        }
    }
    Ok(if bakes.is_empty() { Occupant::Unknown } else { Occupant::Bakes(bakes) })
}

/// What a process writes into a file that it has locked.
struct Sign {
    is_server: bool,
    process: u32,
    machine: String,
}

fn sign(file: &File, path: &Path, what: &str) -> Result<()> {
    let text = format!("{what} {} {}\n", std::process::id(), machine());
    let mut file = file;
    file.set_len(0).and_then(|()| file.write_all(text.as_bytes())).map_err(cannot("write", path))
}

/// The sign in a locked file; none in that of an older program, nor where locked files cannot be read.
fn read(path: &Path) -> Option<Sign> {
    let text = std::fs::read_to_string(path).ok()?;
    let mut words = text.split_whitespace();
    let (what, process) = (words.next()?, words.next()?.parse().ok()?);
    let machine = words.next().unwrap_or_default().to_owned();
    Some(Sign { is_server: what == SERVER, process, machine })
}

/// The running system, in a word; the same in all of its containers. Nothing where systems do not say.
fn machine() -> String {
    let id = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
    id.trim().to_owned()
}

fn open(path: &Path) -> Result<File> {
    let file = File::options().create(true).read(true).write(true).truncate(false).open(path);
    file.map_err(cannot("open", path))
}

/// Whether a lock was gained; nobody else's is an error.
fn is_locked_by(path: &Path, tried: std::result::Result<(), TryLockError>) -> Result<bool> {
    match tried {
        Ok(()) => Ok(true),
        Err(TryLockError::WouldBlock) => Ok(false),
        Err(TryLockError::Error(source)) => Err(cannot("lock", path)(source)),
    }
}

/// Makes a folder and those above it.
pub(crate) fn make_folder(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).map_err(cannot("make", folder))
}

fn cannot(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> ServerError {
    let path = path.to_owned();
    move |source| ServerError::State { action, path, source }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(error: ServerError) -> Occupant {
        match error {
            ServerError::StateInUse { by, .. } => by,
            error => panic!("not in use: {error}"),
        }
    }

    #[test]
    fn bakes_sit_beside_each_other_and_a_free_seat_is_taken_again() {
        let folder = tempfile::tempdir().unwrap();
        let seat = || take_seat(folder.path()).map(|seating| (seating.name, seating.others, seating.hold));
        let (first, others, first_hold) = seat().unwrap();
        assert_eq!((first.as_str(), others), ("bake-0", Vec::new()));
        let (second, others, _second_hold) = seat().unwrap();
        let process = std::process::id();
        assert_eq!((second.as_str(), others), ("bake-1", vec![(first, process)]));
        drop(first_hold);
        let (third, others, _third_hold) = seat().unwrap();
        assert_eq!((third.as_str(), others), ("bake-0", vec![(second, process)]));
    }

    #[test]
    fn server_and_bakes_keep_each_other_out_and_say_by_which_process() {
        let folder = tempfile::tempdir().unwrap();
        let process = std::process::id();
        let seating = take_seat(folder.path()).unwrap();
        assert_eq!(refused(alone(folder.path()).unwrap_err()), Occupant::Bakes(vec![process]));
        drop(seating);
        let server = alone(folder.path()).unwrap();
        assert_eq!(refused(take_seat(folder.path()).unwrap_err()), Occupant::Server(process));
        assert_eq!(refused(alone(folder.path()).unwrap_err()), Occupant::Server(process));
        drop(server);
        assert!(take_seat(folder.path()).is_ok(), "an ended server leaves nothing behind");
    }

    #[test]
    fn program_from_before_seats_and_one_of_another_machine_are_waited_for() {
        let folder = tempfile::tempdir().unwrap();
        let old = open(&folder.path().join("lock")).unwrap();
        old.lock().unwrap();
        assert_eq!(refused(take_seat(folder.path()).unwrap_err()), Occupant::Unknown);
        drop(old);
        let _seating = take_seat(folder.path()).unwrap();
        std::fs::write(folder.path().join("seats/0"), "bake 7 elsewhere\n").unwrap();
        drop(_seating.gate);
        assert_eq!(refused(take_seat(folder.path()).unwrap_err()), Occupant::OtherMachine);
    }

    #[test]
    fn seat_of_an_ended_process_is_seen_by_those_that_sit_on() {
        let folder = tempfile::tempdir().unwrap();
        let process = std::process::id();
        let first = take_seat(folder.path()).unwrap();
        assert!(seats(folder.path()).unwrap().is_none(), "a seat is being taken");
        drop(first.gate);
        let second = take_seat(folder.path()).unwrap();
        drop(second.gate);
        let seen = || seats(folder.path()).unwrap().map(|seats| (seats.held, seats.free)).unwrap();
        assert_eq!(seen(), (vec![first.name.clone(), second.name.clone()], vec![]));
        drop(first.hold);
        assert_eq!(seen(), (vec![second.name], vec![(first.name, process)]));
    }

    #[test]
    fn gate_is_closed_while_a_bake_takes_its_seat() {
        let folder = tempfile::tempdir().unwrap();
        let seating = take_seat(folder.path()).unwrap();
        assert_eq!(refused(take_seat(folder.path()).unwrap_err()), Occupant::Starting);
        drop(seating.gate);
        assert!(take_seat(folder.path()).is_ok());
    }
}
