//! The machine that a process runs on, as one can tell it from others that share a folder with it.

use std::path::Path;

use serde::{Deserialize, Serialize};

/// Names that many machines have.
const COMMON_NAMES: [&str; 4] = ["", "(none)", "localhost", "localhost.localdomain"];

/// A machine since it was started.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub(super) struct Host {
    /// Kept from one start to the next: the host's name, or the id of its installation where that is common; empty where unknown.
    name: String,
    /// Id of the start, which containers of a machine have in common; empty where unknown.
    boot: String,
}

impl Host {
    /// This one.
    pub(super) fn here() -> Self {
        Self::under(Path::new("/"))
    }

    fn under(root: &Path) -> Self {
        let line = |path: &str| {
            let text = std::fs::read_to_string(root.join(path)).unwrap_or_default();
            text.trim().to_owned()
        };
        let names = ["proc/sys/kernel/hostname", "etc/hostname", "etc/machine-id"].map(line);
        let own = names.into_iter().find(|name| !COMMON_NAMES.contains(&name.as_str()));
        Self { name: own.unwrap_or_default(), boot: line("proc/sys/kernel/random/boot_id") }
    }

    /// One word for it, the same in all containers of the machine until that is started anew; empty where unknown.
    pub(super) fn id(&self) -> &str {
        if self.boot.is_empty() { &self.name } else { &self.boot }
    }

    /// Whether both are one machine, perhaps started anew since, or containers of one: locks of files hold between them. Where a system
    /// tells nothing, they are.
    pub(super) fn is_same(&self, other: &Self) -> bool {
        let has_boot = !self.boot.is_empty() && self.boot == other.boot;
        let has_name = !self.name.is_empty() && self.name == other.name;
        has_boot || has_name || (*self == Self::default() && *other == Self::default())
    }

    /// Whether the machine was not started anew in between.
    pub(super) fn is_same_start(&self, other: &Self) -> bool {
        self.is_same(other) && self.boot == other.boot
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub fn host(name: &str, boot: &str) -> Host {
        Host { name: name.to_owned(), boot: boot.to_owned() }
    }

    #[test]
    fn machine_is_the_same_by_its_name_or_its_start() {
        let here = host("oven", "1");
        for (other, is_same) in [
            (host("oven", "2"), true),
            (host("a-container-of-it", "1"), true),
            (host("other", "2"), false),
            (host("", "2"), false),
            (Host::default(), false),
        ] {
            assert_eq!(here.is_same(&other), is_same, "{other:?}");
            assert_eq!(here.is_same_start(&other), is_same && other.boot == "1", "{other:?}");
        }
        assert_eq!([here.id(), host("oven", "").id(), Host::default().id()], ["1", "oven", ""]);
        assert!(!host("", "1").is_same(&host("", "2")), "two without a name");
        assert!(Host::default().is_same(&Host::default()));
    }

    #[test]
    fn common_names_give_way_to_the_installations_id() {
        let root = tempfile::tempdir().unwrap();
        let write = |path: &str, text: &str| {
            let path = root.path().join(path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        };
        assert_eq!(Host::under(root.path()), Host::default());
        write("proc/sys/kernel/hostname", "localhost\n");
        write("proc/sys/kernel/random/boot_id", "start\n");
        write("etc/machine-id", "installation\n");
        assert_eq!(Host::under(root.path()), host("installation", "start"));
        write("etc/hostname", "oven\n");
        assert_eq!(Host::under(root.path()), host("oven", "start"));
    }
}
