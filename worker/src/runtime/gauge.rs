//! Memory in use and its limits, as the kernel tells them (Linux): of the process against a limit that its owner gave, of its group of
//! processes and those above it (cgroup v2) against theirs, and of the machine.

use std::collections::BTreeMap;
use std::fmt::Debug;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

/// Part of a kernel's limit that is left when it counts as reached, and its bounds. More → less is lost to a kernel's kill, and
/// less memory is of use.
const MARGIN_PART: u64 = 32;
const MARGIN_BYTES: [u64; 2] = [32 << 20, 512 << 20];
/// Margins below a limit of the kernel within which it probably was the kernel that ended a process without a word.
const NEAR_MARGINS: u64 = 2;

/// Memory in use, of a limit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Fill {
    /// Whose limit it is.
    pub(super) of: &'static str,
    pub(super) used: u64,
    pub(super) limit: u64,
    /// Bytes below the limit at which it counts as reached.
    pub(super) margin: u64,
}

impl Fill {
    /// Of a limit at which the kernel ends processes.
    pub(super) fn of_kernel(of: &'static str, used: u64, limit: u64) -> Self {
        let [least, most] = MARGIN_BYTES;
        Self { of, used, limit, margin: (limit / MARGIN_PART).clamp(least, most) }
    }

    pub(super) fn is_reached(&self) -> bool {
        self.used.saturating_add(self.margin) > self.limit
    }

    /// Near a limit at which the kernel ends processes.
    pub(super) fn is_near(&self) -> bool {
        self.margin > 0 && self.used.saturating_add(NEAR_MARGINS * self.margin) > self.limit
    }

    pub(super) fn share(&self) -> f64 {
        self.used as f64 / self.limit.max(1) as f64
    }

    pub(super) fn words(&self) -> String {
        let [used, limit] = [self.used, self.limit].map(|bytes| bytes >> 20);
        format!("{used} of {limit} MiB of {} were in use", self.of)
    }
}

/// The kernel's kills for want of memory, since groups of processes began. A later process compares them.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub(super) struct Kills {
    /// The process's own group.
    pub(super) group: String,
    /// Kills in that group and in each above it, those in groups below among them.
    pub(super) counts: BTreeMap<String, u64>,
}

/// State of the memory at one moment.
#[derive(Clone, Debug, Default)]
pub(super) struct Reading {
    /// Bytes of this process.
    pub(super) own: u64,
    pub(super) fills: Vec<Fill>,
    pub(super) kills: Kills,
}

/// Source of readings.
pub(super) trait Gauge: Debug + Send + Sync {
    fn read(&self) -> Reading;
}

/// The kernel, by its files.
#[derive(Debug)]
pub(super) struct Kernel {
    root: PathBuf,
}

impl Default for Kernel {
    fn default() -> Self {
        Self { root: PathBuf::from("/") }
    }
}

impl Gauge for Kernel {
    fn read(&self) -> Reading {
        let groups = self.groups();
        let machine = self.text("proc/meminfo").and_then(|text| fill_of_machine(&text));
        Reading {
            own: self.text("proc/self/status").and_then(|status| bytes_of_process(&status)).unwrap_or(0),
            fills: groups.iter().filter_map(|group| self.fill_of_group(group)).chain(machine).collect(),
            kills: self.kills_of(&groups),
        }
    }
}

impl Kernel {
    /// Kills until now.
    pub(super) fn kills(&self) -> Kills {
        self.kills_of(&self.groups())
    }

    fn text(&self, path: impl AsRef<Path>) -> Option<String> {
        std::fs::read_to_string(self.root.join(path)).ok()
    }

    /// Folders of this process's group and those above it, the own one first; as a container sees them, where this is one.
    fn groups(&self) -> Vec<PathBuf> {
        let own = self.text("proc/self/cgroup").unwrap_or_default();
        let Some(path) = own.lines().find_map(|line| line.strip_prefix("0::/")) else { return Vec::new() };
        let top = Path::new("sys/fs/cgroup");
        top.join(path).ancestors().take_while(|folder| folder.starts_with(top)).map(Path::to_owned).collect()
    }

    /// None for a group without a limit. Files and their names that the kernel keeps in memory can go.
    fn fill_of_group(&self, folder: &Path) -> Option<Fill> {
        let number = |name: &str| self.text(folder.join(name))?.trim().parse::<u64>().ok();
        let limit = number("memory.max")?;
        let current = number("memory.current")?;
        let stat = self.text(folder.join("memory.stat")).unwrap_or_default();
        let spare = stat.lines().filter_map(|line| {
            let (name, bytes) = line.split_once(' ')?;
            let can_go = matches!(name, "active_file" | "inactive_file" | "slab_reclaimable");
            can_go.then(|| bytes.parse::<u64>().ok()).flatten()
        });
        let used = current.saturating_sub(spare.sum());
        Some(Fill::of_kernel("this worker's group of processes (its container or unit)", used, limit))
    }

    fn kills_of(&self, groups: &[PathBuf]) -> Kills {
        let name = |folder: &PathBuf| folder.display().to_string();
        let count = |folder: &PathBuf| {
            let events = self.text(folder.join("memory.events"))?;
            let kills = events.lines().find_map(|line| line.strip_prefix("oom_kill "))?;
            Some((name(folder), kills.trim().parse().ok()?))
        };
        Kills {
            group: groups.first().map(name).unwrap_or_default(),
            counts: groups.iter().filter_map(count).collect(),
        }
    }
}

/// Bytes of a process that no file can give back, of `/proc/self/status`; all where it does not tell which.
fn bytes_of_process(status: &str) -> Option<u64> {
    let kib = match kib(status, "RssAnon") {
        Some(anonymous) => anonymous + kib(status, "RssShmem").unwrap_or(0),
        None => kib(status, "VmRSS")?,
    };
    Some(kib << 10)
}

/// Of `/proc/meminfo`; swap counts as room.
fn fill_of_machine(meminfo: &str) -> Option<Fill> {
    let limit = kib(meminfo, "MemTotal")? + kib(meminfo, "SwapTotal").unwrap_or(0);
    let free = kib(meminfo, "MemAvailable")? + kib(meminfo, "SwapFree").unwrap_or(0);
    Some(Fill::of_kernel("this machine", limit.saturating_sub(free) << 10, limit << 10))
}

/// The number of a line `NAME: NUMBER kB`.
fn kib(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(':'));
    line?.trim().strip_suffix("kB")?.trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    const MIB: u64 = 1 << 20;

    /// A kernel whose files are in a folder.
    struct Files(tempfile::TempDir);

    impl Files {
        fn new() -> Self {
            Self(tempfile::tempdir().unwrap())
        }

        fn write(&self, path: &str, text: &str) {
            let path = self.0.path().join(path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        }

        fn kernel(&self) -> Kernel {
            Kernel { root: self.0.path().to_owned() }
        }
    }

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
    fn groups_with_a_limit_and_the_machine_are_read_from_the_own_one_upwards() {
        let files = Files::new();
        files.write("proc/self/cgroup", "1:name=systemd:/other\n0::/slice/unit\n");
        files.write("proc/self/status", "RssAnon:\t 1024 kB\n");
        files.write("proc/meminfo", "MemTotal: 4194304 kB\nMemAvailable: 1048576 kB\n");
        let unit = |name: &str| format!("sys/fs/cgroup/slice/unit/{name}");
        files.write(&unit("memory.current"), &format!("{}\n", 1000 * MIB));
        let stat = format!(
            "anon 1\nactive_file {}\ninactive_file {}\nslab_reclaimable {}\n",
            300 * MIB,
            100 * MIB,
            50 * MIB
        );
        files.write(&unit("memory.stat"), &stat);
        files.write(&unit("memory.max"), "max\n");
        files.write("sys/fs/cgroup/slice/memory.max", &format!("{}\n", 2048 * MIB));
        files.write("sys/fs/cgroup/slice/memory.current", &format!("{}\n", 2040 * MIB));
        let used = |reading: &Reading| -> Vec<(u64, u64, bool)> {
            let figures = |fill: &Fill| (fill.used / MIB, fill.limit / MIB, fill.is_reached());
            reading.fills.iter().map(figures).collect()
        };
        let reading = files.kernel().read();
        assert_eq!(reading.own, MIB);
        let others = [(2040, 2048, true), (3072, 4096, false)];
        assert_eq!(used(&reading), others, "the unit has no limit");
        files.write(&unit("memory.max"), &format!("{}\n", 1024 * MIB));
        assert_eq!(used(&files.kernel().read()), [&[(550, 1024, false)], &others[..]].concat());
        files.write(&unit("memory.stat"), "anon 1\n");
        assert_eq!(used(&files.kernel().read())[0], (1000, 1024, true), "no file can go");
    }

    #[test]
    fn system_that_tells_nothing_has_no_limits() {
        let reading = Files::new().kernel().read();
        assert!(reading.own == 0 && reading.fills.is_empty() && reading.kills == Kills::default());
    }

    #[test]
    fn limit_of_the_kernel_is_near_before_it_counts_as_reached() {
        let of = |used: u64| {
            let fill = Fill::of_kernel("this machine", used, 1 << 30);
            (fill.is_near(), fill.is_reached())
        };
        assert_eq!([900, 980, 1000].map(|mib| of(mib * MIB)), [(false, false), (true, false), (true, true)]);
    }

    #[test]
    fn kernels_kills_are_counted_in_the_own_group_and_those_above() {
        let files = Files::new();
        files.write("proc/self/cgroup", "0::/slice/unit\n");
        let events = "low 0\nhigh 0\nmax 12\noom 3\noom_kill 2\noom_group_kill 0\n";
        files.write("sys/fs/cgroup/slice/unit/memory.events", events);
        files.write("sys/fs/cgroup/slice/memory.events", "oom_kill 7\n");
        files.write("sys/fs/cgroup/memory.events", "low 0\n");
        let kills = files.kernel().kills();
        assert_eq!(kills.group, "sys/fs/cgroup/slice/unit");
        assert_eq!(kills.counts.values().copied().collect::<Vec<_>>(), [7, 2], "{kills:?}");
    }
}
