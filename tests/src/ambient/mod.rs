//! A kind of bake outside Lightkiln: constant ambient light. It has one task, one chunk and one shading function, and is
//! the worked example of CONTRIBUTING.md, "Add a kind".
//!
//! No room that kinds share has a line for it: it comes to program, server, worker and client by their tables.

mod client;
mod contract;
mod worker;

pub use contract::{Ambient, Body, CHUNK, NAME, ROLE, Settings, decode, encode};

use kiln::kinds::KindTables;

/// Lightkiln's own kinds and this one.
pub fn tables() -> KindTables {
    KindTables::new().with(&worker::Ambient, client::Ambient)
}
