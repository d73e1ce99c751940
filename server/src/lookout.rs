//! Looks for work on behalf of all claims that wait.
//!
//! A thousand idle workers hear of every change. If each then claimed, a commit that makes nothing ready would cost a
//! thousand transactions; so one of them looks whether anything is ready for their kinds, and the others believe it.

use std::collections::BTreeMap;
use std::time::Duration;

use tokio::sync::Mutex;
use tokio::time::Instant;

use crate::store::{FarmStore, Result};

/// Lifetime of a look when no hint says that something changed: hints may be lost, and tasks become ready by time.
const LOOK_COUNTS_FOR: Duration = Duration::from_millis(250);
/// Sets of kinds whose looks are remembered, and the longest of them, in bytes of all names.
const SETS_MAX: usize = 64;
const SET_BYTES_MAX: usize = 4096;

/// The outcome of a look, and its time.
struct Look {
    /// Mark of the hints that was taken before it.
    mark: u64,
    at: Instant,
    is_any_ready: bool,
}

/// The last look for each set of kinds.
#[derive(Default)]
pub struct Lookout {
    looks: Mutex<BTreeMap<Vec<String>, Look>>,
}

impl Lookout {
    /// Whether a task of one of the kinds is ready in a running bake, seen after the hint `mark`. May take as long as the
    /// store does for all who came before.
    pub async fn is_any_ready(&self, store: &dyn FarmStore, kinds: &[String], mark: u64) -> Result<bool> {
        let mut kinds = kinds.to_vec();
        kinds.sort_unstable();
        kinds.dedup();
        if kinds.iter().map(String::len).sum::<usize>() > SET_BYTES_MAX {
            return store.is_any_ready(&kinds).await;
        }
        // Held while one looks: those who come meanwhile wait for its outcome.
        let mut looks = self.looks.lock().await;
        if let Some(look) = looks.get(&kinds)
            && look.mark >= mark
            && look.at.elapsed() < LOOK_COUNTS_FOR
        {
            return Ok(look.is_any_ready);
        }
        let at = Instant::now();
        let is_any_ready = store.is_any_ready(&kinds).await?;
        looks.retain(|_, look| look.at.elapsed() < LOOK_COUNTS_FOR);
        if looks.len() >= SETS_MAX {
            looks.pop_first();
        }
        looks.insert(kinds, Look { mark, at, is_any_ready });
        Ok(is_any_ready)
    }
}
