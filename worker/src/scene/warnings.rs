//! Collects features that were not honoured, each kind once with a count.

use super::model::Warning;

/// Warnings under way: the first place of each kind is kept, the rest are counted.
#[derive(Debug, Default)]
pub(super) struct Warnings {
    found: Vec<(&'static str, String, u64)>,
}

impl Warnings {
    /// Notes one case of `code`; `message` is only asked for the first.
    pub(super) fn add(&mut self, code: &'static str, message: impl FnOnce() -> String) {
        self.add_many(code, 1, message);
    }

    /// Notes `count` cases of `code` at once; none when `count` is 0.
    pub(super) fn add_many(&mut self, code: &'static str, count: u64, message: impl FnOnce() -> String) {
        if count == 0 {
            return;
        }
        match self.found.iter_mut().find(|(known, ..)| *known == code) {
            Some((.., total)) => *total += count,
            None => self.found.push((code, message(), count)),
        }
    }

    /// The warnings in the order in which each kind was first met.
    pub(super) fn finish(self) -> Vec<Warning> {
        let to_warning = |(code, message, count): (&str, String, u64)| Warning {
            code: code.to_owned(),
            message: if count > 1 { format!("{message} (first of {count})") } else { message },
        };
        self.found.into_iter().map(to_warning).collect()
    }
}
