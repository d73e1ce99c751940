//! The memory that this process takes, of that which it may take. A kernel that runs out of memory ends a process without a word; so
//! tasks in hand fail as out of memory a moment before, and the farm hears which they were.
//!
//! Looked at, where the system tells it (Linux): the process against a limit that its owner gave, its group of processes and those
//! above it (cgroup v2) against theirs, and the machine.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Time between two looks. Longer → a task that takes memory fast is ended by the kernel before anybody looks.
pub(super) const LOOK_EVERY: Duration = Duration::from_millis(100);
/// Part of a kernel's limit that is left when it counts as reached, and its bounds. More → less is lost to a kernel's kill, and
/// less memory is of use.
const MARGIN_PART: u64 = 32;
const MARGIN_BYTES: [u64; 2] = [32 << 20, 512 << 20];
/// Margins below a limit of the kernel within which it probably was the kernel that ended a process without a word.
const NEAR_MARGINS: u64 = 2;

/// Memory in use, of a limit.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Fill {
    /// Whose limit it is.
    of: &'static str,
    used: u64,
    limit: u64,
    /// Bytes below the limit at which it counts as reached.
    margin: u64,
}

impl Fill {
    /// Of a limit at which the kernel ends processes.
    fn of_kernel(of: &'static str, used: u64, limit: u64) -> Self {
        let [least, most] = MARGIN_BYTES;
        Self { of, used, limit, margin: (limit / MARGIN_PART).clamp(least, most) }
    }

    fn is_reached(&self) -> bool {
        self.used.saturating_add(self.margin) > self.limit
    }

    /// Near a limit at which the kernel ends processes.
    fn is_near(&self) -> bool {
        self.margin > 0 && self.used.saturating_add(NEAR_MARGINS * self.margin) > self.limit
    }

    fn share(&self) -> f64 {
        self.used as f64 / self.limit.max(1) as f64
    }

    fn words(&self) -> String {
        let [used, limit] = [self.used, self.limit].map(|bytes| bytes >> 20);
        format!("{used} of {limit} MiB of {} were in use", self.of)
    }
}

/// State of the memory at the last look.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Seen {
    /// The limit that was reached, in words.
    exhausted: Option<String>,
    /// The limit that was nearly reached, in words.
    near: Option<String>,
    /// This process has the greater part of it.
    is_own: bool,
}

/// Looks at the memory from time to time.
#[derive(Debug, Default)]
pub(super) struct MemoryWatch {
    /// Most bytes that this process may take, if its owner said so.
    own_limit: Option<u64>,
    seen: Mutex<Seen>,
}

impl MemoryWatch {
    pub(super) fn new(own_limit: Option<u64>) -> Self {
        Self { own_limit, seen: Mutex::default() }
    }

    /// The limit that is reached, in words, if one is.
    pub(super) fn exhausted(&self) -> Option<String> {
        self.lock().exhausted.clone()
    }

    /// Whether a limit is reached.
    pub(super) fn is_exhausted(&self) -> bool {
        self.lock().exhausted.is_some()
    }

    /// Whether most of that which is in use is this process's, so that its end would help.
    pub(super) fn is_own(&self) -> bool {
        self.lock().is_own
    }

    /// The limit that is nearly reached, in words, if one is.
    pub(super) fn near(&self) -> Option<String> {
        self.lock().near.clone()
    }

    /// Looks; true when something has changed.
    pub(super) fn look(&self) -> bool {
        let own =
            std::fs::read_to_string("/proc/self/status").ok().and_then(|status| bytes_of_process(&status));
        let mut fills: Vec<Fill> = groups().iter().filter_map(|group| fill_of_group(group)).collect();
        fills.extend(own.zip(self.own_limit).map(|(used, limit)| Fill {
            of: "this worker",
            used,
            limit,
            margin: 0,
        }));
        fills.extend(std::fs::read_to_string("/proc/meminfo").ok().and_then(|text| fill_of_machine(&text)));
        let seen = seen(&fills, own.unwrap_or(0));
        let mut last = self.lock();
        let has_changed = *last != seen;
        *last = seen;
        has_changed
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Seen> {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn seen(fills: &[Fill], own: u64) -> Seen {
    let fullest =
        fills.iter().filter(|fill| fill.is_reached()).max_by(|a, b| a.share().total_cmp(&b.share()));
    let near = fills.iter().find(|fill| fill.is_near());
    Seen {
        exhausted: fullest.map(Fill::words),
        // Without the figures: a note of it need not be written anew with each look.
        near: near.map(|fill| format!("nearly all memory of {} was in use", fill.of)),
        is_own: fullest.is_some_and(|fill| own >= fill.limit / 2),
    }
}

/// Bytes of a process that no file can give back, of `/proc/self/status`; all where it does not tell which.
fn bytes_of_process(status: &str) -> Option<u64> {
    let kib = |name: &str| {
        let line = status.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(':'));
        line?.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()
    };
    let kib = match kib("RssAnon") {
        Some(anonymous) => anonymous + kib("RssShmem").unwrap_or(0),
        None => kib("VmRSS")?,
    };
    Some(kib << 10)
}

/// Of `/proc/meminfo`; swap counts as room.
fn fill_of_machine(meminfo: &str) -> Option<Fill> {
    let kib = |name: &str| {
        let line = meminfo.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(':'));
        line?.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()
    };
    let limit = kib("MemTotal")? + kib("SwapTotal").unwrap_or(0);
    let free = kib("MemAvailable")? + kib("SwapFree").unwrap_or(0);
    Some(Fill::of_kernel("this machine", limit.saturating_sub(free) << 10, limit << 10))
}

/// Folders of this process's group and those above it, the own one first.
fn groups() -> Vec<PathBuf> {
    let own = std::fs::read_to_string("/proc/self/cgroup").unwrap_or_default();
    let Some(path) = own.lines().find_map(|line| line.strip_prefix("0::/")) else { return Vec::new() };
    let top = Path::new("/sys/fs/cgroup");
    top.join(path).ancestors().take_while(|folder| folder.starts_with(top)).map(Path::to_owned).collect()
}

/// None for a group without a limit. Files that the kernel keeps in memory can go.
fn fill_of_group(folder: &Path) -> Option<Fill> {
    let read = |name: &str| std::fs::read_to_string(folder.join(name)).ok();
    let number = |name: &str| read(name)?.trim().parse::<u64>().ok();
    let limit = number("memory.max")?;
    let current = number("memory.current")?;
    let stat = read("memory.stat").unwrap_or_default();
    let files = stat.lines().filter_map(|line| {
        let (name, bytes) = line.split_once(' ')?;
        matches!(name, "active_file" | "inactive_file").then(|| bytes.parse::<u64>().ok()).flatten()
    });
    let used = current.saturating_sub(files.sum());
    Some(Fill::of_kernel("this worker's group of processes (its container or unit)", used, limit))
}

/// How often the kernel ended a process of this process's group for memory, and which group that is, of which start of the machine. A later
/// process of the same group compares it.
pub(super) fn kills() -> Option<(String, u64)> {
    let folder = groups().into_iter().next()?;
    let boot = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").ok()?;
    let events = std::fs::read_to_string(folder.join("memory.events")).ok()?;
    Some((format!("{} {}", boot.trim(), folder.display()), kills_of(&events)?))
}

fn kills_of(events: &str) -> Option<u64> {
    events.lines().find_map(|line| line.strip_prefix("oom_kill ")?.trim().parse().ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    const MIB: u64 = 1 << 20;

    #[test]
    fn process_counts_what_no_file_can_give_back() {
        let status = "Name:\tkiln\nVmRSS:\t  9000 kB\nRssAnon:\t    2048 kB\nRssFile:\t 6000 kB\nRssShmem:\t     512 kB\n";
        assert_eq!(bytes_of_process(status), Some((2048 + 512) << 10));
        assert_eq!(bytes_of_process("VmRSS:\t  9000 kB\n"), Some(9000 << 10));
        assert_eq!(bytes_of_process("nothing of the kind"), None);
    }

    #[test]
    fn machine_is_exhausted_when_neither_memory_nor_swap_is_left() {
        let fill = |available: u64, swap_free: u64| {
            fill_of_machine(&format!(
                "MemTotal: {} kB\nMemFree: 1 kB\nMemAvailable: {available} kB\nSwapTotal: 1048576 kB\nSwapFree: {swap_free} kB\n",
                8 << 20
            ))
            .unwrap()
        };
        assert!(!fill(4 << 20, 0).is_reached());
        assert!(!fill(1000, 1 << 20).is_reached(), "swap is left");
        assert!(fill(1000, 1000).is_reached());
    }

    #[test]
    fn group_counts_no_files_and_ones_without_a_limit_never_fill() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
        write("memory.current", &format!("{}\n", 1000 * MIB));
        write("memory.stat", &format!("anon 1\nactive_file {}\ninactive_file {}\n", 300 * MIB, 100 * MIB));
        write("memory.max", "max\n");
        assert_eq!(fill_of_group(folder.path()), None);
        write("memory.max", &format!("{}\n", 1024 * MIB));
        let fill = fill_of_group(folder.path()).unwrap();
        assert_eq!((fill.used, fill.is_reached()), (600 * MIB, false));
        write("memory.stat", "anon 1\n");
        assert!(fill_of_group(folder.path()).unwrap().is_reached());
    }

    #[test]
    fn limit_of_the_owner_holds_to_the_byte_and_says_whose_it_is() {
        let fill = |used| Fill { of: "this worker", used, limit: 100 * MIB, margin: 0 };
        for used in [50 * MIB, 100 * MIB] {
            assert_eq!(seen(&[fill(used)], used), Seen::default(), "no kernel keeps it");
        }
        let over = seen(&[fill(100 * MIB + 1)], 100 * MIB + 1);
        assert_eq!(over.exhausted.as_deref(), Some("100 of 100 MiB of this worker were in use"));
        assert!(over.is_own && !seen(&[fill(101 * MIB)], MIB).is_own);
    }

    #[test]
    fn limit_of_the_kernel_is_near_before_it_counts_as_reached() {
        let limit = 1 << 30;
        let of = |used: u64| {
            let seen = seen(&[Fill::of_kernel("this machine", used, limit)], 0);
            (seen.near.is_some(), seen.exhausted.is_some())
        };
        assert_eq!([900, 980, 1000].map(|mib| of(mib * MIB)), [(false, false), (true, false), (true, true)]);
    }

    #[test]
    fn kernels_kills_are_counted() {
        assert_eq!(kills_of("low 0\nhigh 0\nmax 12\noom 3\noom_kill 2\noom_group_kill 0\n"), Some(2));
        assert_eq!(kills_of("low 0\n"), None);
    }
}
