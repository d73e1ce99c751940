//! Room for connections in this process.

use rustix::process::{Resource, Rlimit, setrlimit};

use super::ConnectionConfig;

/// Files that a server has open beside connections: database, listener, log.
const OTHER_FILES: u64 = 64;
/// Files of one connection: its own, and one that a call reads or writes.
const FILES_OF_CONNECTION: u64 = 2;
/// Fewest connections that are let in, however few files the system allows.
const FEWEST: u64 = 16;

/// Raises the number of files that this process may open as far as it may; the number then, if there is a limit and it is
/// known.
pub(crate) fn open_files() -> Option<u64> {
    let [current, maximum] = limits_in(&std::fs::read_to_string("/proc/self/limits").ok()?)?;
    if current == maximum {
        return current;
    }
    // Refused by some sandboxes: then it stays as it is.
    match setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum }) {
        Ok(()) => maximum,
        Err(_) => current,
    }
}

/// The limit of open files, and how far it may be raised, in a list of all limits. Read as a text, as sandboxes that forbid
/// to change limits often forbid to ask for them, too.
fn limits_in(list: &str) -> Option<[Option<u64>; 2]> {
    let mut words = list.lines().find_map(|line| line.strip_prefix("Max open files"))?.split_whitespace();
    let mut next = || match words.next()? {
        "unlimited" => Some(None),
        count => count.parse().ok().map(Some),
    };
    Some([next()?, next()?])
}

impl ConnectionConfig {
    /// The limits of a process that may open so many files.
    ///
    /// While there are limits, one address has three quarters of the room at most: the rest is for others.
    pub(crate) fn within(self, files: Option<u64>) -> Self {
        let by_files =
            files.map(|files| (files.saturating_sub(OTHER_FILES) / FILES_OF_CONNECTION).max(FEWEST));
        let wanted = Some(u64::from(self.at_a_time)).filter(|wanted| *wanted > 0);
        let Some(at_a_time) = wanted.into_iter().chain(by_files).min() else { return self };
        let at_a_time = u32::try_from(at_a_time).unwrap_or(u32::MAX);
        if wanted.is_some_and(|wanted| wanted > u64::from(at_a_time)) {
            tracing::warn!(
                at_a_time,
                "fewer connections at a time than asked for, as few files may be open (ulimit -n)"
            );
        }
        let of_address = match self.of_address {
            0 => 0,
            wanted => wanted.min(at_a_time - at_a_time / 4),
        };
        Self { at_a_time, of_address, ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn connections_fit_into_the_files_that_may_be_open() {
        let within = |at_a_time, of_address, files| {
            let asked = ConnectionConfig { at_a_time, of_address, ..ConnectionConfig::default() };
            let fits = asked.within(files);
            (fits.at_a_time, fits.of_address)
        };
        assert_eq!(within(10_000, 7_500, None), (10_000, 7_500));
        assert_eq!(within(10_000, 7_500, Some(1_000_000)), (10_000, 7_500));
        assert_eq!(within(10_000, 7_500, Some(1024)), (480, 360), "one address leaves room for others");
        assert_eq!(within(10_000, 100, Some(1024)), (480, 100));
        assert_eq!(within(10_000, 0, Some(1024)), (480, 0));
        assert_eq!(within(0, 0, Some(1024)), (480, 0), "0 is what the system allows");
        assert_eq!(within(0, 7, None), (0, 7));
        assert_eq!(within(10_000, 7_500, Some(10)), (16, 12));
    }

    #[test]
    fn a_raised_limit_of_files_stays_raised() {
        let files = open_files();
        assert_eq!(open_files(), files);
        let [current, maximum] = limits_in(&std::fs::read_to_string("/proc/self/limits").unwrap()).unwrap();
        assert_eq!((current, maximum), (files, files));
    }

    #[test]
    fn limits_are_read_from_the_list() {
        let list = |limits: &str| {
            format!("Limit  Soft  Hard  Units\nMax open files            {limits} files\nMax x 1 2\n")
        };
        assert_eq!(limits_in(&list("1024   524288")), Some([Some(1024), Some(524_288)]));
        assert_eq!(limits_in(&list("1024   unlimited")), Some([Some(1024), None]));
        assert_eq!((limits_in(""), limits_in(&list("many"))), (None, None));
    }
}
