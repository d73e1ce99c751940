//! Things that a task reads of a scene's stage, by name: cells of space that rays cross, tiles of the lightmap that hits are looked
//! up in, parts of the tree of patches. A task records what it read; when all of that is as it was, so is its result.
//!
//! Names are those of places and hang on nothing else in the scene; a [`Stage`] tells what is there now.

mod alike;
mod before;
mod marks;
mod own;
mod patches;
mod record;
mod stage;
mod triangles;

pub use alike::{Common, alike};
pub use before::{Before, before, of_before, outputs_of_before};
pub use marks::{Bytes, Mark, Name, places_in, union};
pub use own::Reads;
pub use patches::branches;
pub use record::{Changes, RECORD_ARTEFACT, Record};
pub use stage::{STAGE_ARTEFACT, Stage};
