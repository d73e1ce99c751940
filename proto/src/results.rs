//! Results of a bake's tasks as they land, for whoever follows a bake under way ([`crate::api`] has the call).

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::api::Bake;
use crate::ids::TaskKey;
use crate::jobs::Artefact;

/// Most results on a page, and as many as there are on one unless asked otherwise.
pub const MAX_PAGE_RESULTS: u32 = 500;

/// A task of a bake that is done, with its outputs. One whose bytes were lost, and that ran again, comes a second time at a later
/// place, its outputs perhaps others.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct BakeResult {
    /// Place in the order in which the bake's results landed: 1 or more, growing, with gaps.
    pub place: u64,
    /// Task key.
    pub key: TaskKey,
    /// Task kind.
    pub kind: String,
    /// Task label.
    pub label: String,
    /// The outputs, by name.
    pub outputs: Vec<Artefact>,
}

/// Results in the order of their places. An empty page of a bake that has ended is the last, unless bytes of a result are lost later.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ResultPage {
    /// The page.
    pub results: Vec<BakeResult>,
    /// Place to ask behind for the next page: those up to it hold no more results of the kind that was asked for. It grows also where
    /// the page is empty, so that no place is looked at twice.
    pub next_after: u64,
    /// The bake as it stood with them.
    pub bake: Bake,
}
