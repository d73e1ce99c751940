//! Results of several leases in one call: each is taken in or refused by itself.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::api::CommitVerdict;
use crate::jobs::TaskResult;
use crate::problem::Problem;

/// Most results that are handed in at once.
pub const MAX_COMMITS: usize = 64;

/// Results of several leases, handed in at once.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Commits {
    /// At most 64 of them; each is taken in or refused by itself.
    #[schema(max_items = 64)]
    pub commits: Vec<Commit>,
}

/// The result of a lease.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Commit {
    /// The lease's token: 32 lower-case hex digits. Another text is no lease's, and refused by itself.
    pub token: String,
    /// Its result.
    pub result: TaskResult,
}

/// Answer to results of several leases.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CommitsAnswer {
    /// In the order of the results.
    pub answers: Vec<CommitOutcome>,
}

/// Fate of a result, or the reason why it was not looked at.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum CommitOutcome {
    /// Its fate.
    Verdict(CommitVerdict),
    /// The answer that it would have had alone.
    Problem(Problem),
}
