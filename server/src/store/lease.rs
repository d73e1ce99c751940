//! The states of a lease.
//!
//! ```text
//! claim ──▶ granted ──heartbeat──▶ held ──heard after it ran out, before that was noticed──▶ late
//!              │                    ▲ │                                                       │
//!              │                    └─┼──────────────heartbeat of a lease that runs on────────┤
//!           runs out               runs out                                                runs out
//!              ▼                      ▼                                                       ▼
//!       nothing was attempted   an attempt failed, until its worker is heard          an attempt is pardoned
//! ```
//! A worker that ends without a word may tell so at its next start, of each lease that it had: a loss, unless the lease is `granted`. A
//! worker says that it has a task when it begins it, so that leases which came with one claim and wait for their turn are none.
//!
//! A lease that its holder ends (commit, failure, release), or whose task was dropped, is gone in any state.
//!
//! The claim asks for the length of the lease (`ttl_secs`, within [`crate::farm::TTL_SECS`]); each heartbeat gives it anew.

/// State of a lease, by the last word of its holder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LeaseState {
    /// Nothing: the answer to the claim may have been lost, or the worker gone before it came.
    Granted,
    /// The holder said that it has the task.
    Held,
    /// A holder that had been heard was heard again after its lease ran out, and before anybody noticed.
    Late,
}

impl LeaseState {
    /// Its name in the database.
    pub fn name(self) -> &'static str {
        match self {
            Self::Granted => "granted",
            Self::Held => "held",
            Self::Late => "late",
        }
    }

    /// The state of that name.
    pub fn named(name: &str) -> Option<Self> {
        [Self::Granted, Self::Held, Self::Late].into_iter().find(|state| state.name() == name)
    }
}
