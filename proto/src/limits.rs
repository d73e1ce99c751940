//! Limits that a bake is submitted with ([`crate::api`] has the call): how many workers it takes, and how often its tasks are tried.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Limits of one bake; those that it does not name are the farm's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BakeLimits {
    /// Machine limit: workers, by their names, that hold tasks of this bake at once, at most; 1..=100000. A worker counts as one however
    /// many tasks it holds, and from its claim until the last of them has ended. A task that several bakes want counts for
    /// the one that it was handed out for, so a bake at its limit holds no other back. No limit unless set.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 100000)]
    pub max_workers: Option<u32>,
    /// Failed attempts after which a task is given up, 1..=1000, on however many workers. Unless set 5, or 3 different workers, whichever
    /// comes first. Of a task that several bakes want, the most generous of them decides.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 1000)]
    pub attempts: Option<u32>,
    /// Times that a worker may be lost with one task before that is given up, 1..=1000000; the farm's number (`kiln server
    /// --lost-workers`) unless set. Of a task that several bakes want, the most generous of them decides.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 1000000)]
    pub lost_workers: Option<u32>,
}

impl BakeLimits {
    /// The farm's rules hold.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}
