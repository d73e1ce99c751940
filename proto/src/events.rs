//! Events of a bake, as its log tells them ([`crate::api`] has the calls).

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::api::{Bake, BakeState, Blame};
use crate::ids::Digest;

/// Something that happened to a bake. `seq` has no gaps within a bake.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct BakeEvent {
    /// 1, 2, 3, … within the bake.
    pub seq: u64,
    /// Unix milliseconds.
    pub at_ms: i64,
    /// The event.
    pub event: EventKind,
}

/// The kinds of event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case", tag = "type")]
pub enum EventKind {
    /// The bake was accepted.
    Submitted,
    /// The submission or a finished task added tasks.
    Planned {
        /// How many were added.
        tasks: u64,
        /// How many of them were done already.
        reused: u64,
    },
    /// A worker took a task. When the farm's machine loses power, one that nothing followed may be forgotten, and its
    /// `seq` given to another event.
    TaskStarted {
        /// Task key.
        key: Digest,
        /// Task kind.
        kind: String,
        /// Task label.
        label: String,
        /// Worker's name.
        worker: String,
        /// 1 for the first attempt; attempts that were given back do not count.
        attempt: u32,
    },
    /// A task was committed.
    TaskDone {
        /// Task key.
        key: Digest,
        /// Task kind.
        kind: String,
        /// Task label.
        label: String,
        /// Worker's name.
        worker: String,
        /// See `task_started`.
        #[serde(default)]
        attempt: u32,
        /// Milliseconds since the worker took it.
        #[serde(default)]
        elapsed_ms: u64,
        /// How the result came about, in words for people; empty where there is nothing to say.
        #[serde(default, skip_serializing_if = "String::is_empty")]
        note: String,
    },
    /// An attempt at a task ended without a result.
    TaskFailed {
        /// Task key.
        key: Digest,
        /// Task kind.
        kind: String,
        /// Task label.
        label: String,
        /// Worker's name.
        worker: String,
        /// Why.
        message: String,
        /// It will be tried again.
        retry: bool,
        /// Who is to blame. `task`: what the bake was given cannot be baked by anyone; `lost`: the worker ended while it had it.
        #[serde(default)]
        blame: Blame,
        /// See `task_started`.
        #[serde(default)]
        attempt: u32,
        /// Milliseconds since the worker took it.
        #[serde(default)]
        elapsed_ms: u64,
        /// Milliseconds before it may be tried again.
        #[serde(default)]
        wait_ms: u64,
    },
    /// A lease ran out, and the task is ready again. Unless it took too long, its worker counts as lost, once it was heard about it.
    LeaseExpired {
        /// Task key.
        key: Digest,
        /// Task kind.
        #[serde(default)]
        kind: String,
        /// Task label.
        #[serde(default)]
        label: String,
        /// Worker that held it.
        worker: String,
        /// See `task_started`.
        #[serde(default)]
        attempt: u32,
        /// Milliseconds since the worker took it.
        #[serde(default)]
        elapsed_ms: u64,
        /// The attempt had all the time that one may take; else its worker was not heard from.
        #[serde(default)]
        took_too_long: bool,
    },
    /// A worker gave a task back undone, as it was told to stop; the task is ready again.
    TaskReleased {
        /// Task key.
        key: Digest,
        /// Task kind.
        kind: String,
        /// Task label.
        label: String,
        /// Worker's name.
        worker: String,
        /// Milliseconds since the worker took it.
        elapsed_ms: u64,
    },
    /// The bytes of a result were lost; the task runs again.
    ResultLost {
        /// Task key.
        key: Digest,
        /// Task kind.
        kind: String,
        /// Task label.
        label: String,
    },
    /// Another attempt at a task, too late or once more, gave other bytes than those of its result, which stays as it was. A machine, or
    /// the code of the task, is not to be trusted.
    ResultDiffers {
        /// Task key.
        key: Digest,
        /// Task kind.
        kind: String,
        /// Task label.
        label: String,
        /// Worker of the attempt whose result came later; empty where that is not known.
        worker: String,
        /// The output that differs.
        output: String,
        /// Its digest in the result that was there before; absent if that lacks it.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        kept: Option<Digest>,
        /// Its digest in the other; absent if that lacks it.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        found: Option<Digest>,
    },
    /// The bake's state changed.
    State {
        /// The new state.
        state: BakeState,
    },
}

/// Events in order.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct EventPage {
    /// The page.
    pub events: Vec<BakeEvent>,
    /// The bake as it stands after them.
    pub bake: Bake,
}
