//! A bake under way as a source of light: the tasks of a kind that whoever follows it asks for, and their outputs.

/// Name of the outline among outputs: a manifest without clusters, as JSON ([`crate::manifest::Manifest::from_json`]).
pub const OUTLINE_OUTPUT: &str = "outline";
/// Name of a cell's page among outputs: its clusters' rows with their chunks, as
/// [`crate::chunk::decode_directory`] reads them. The chunks are outputs of the same task.
pub const PAGE_OUTPUT: &str = "page";

/// Kinds of the tasks to follow. All clusters of the pages of all cells, in another order, are those of the bake's manifest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnderWay {
    /// Kind of the one task that gives the outline ([`OUTLINE_OUTPUT`]), before any of the others begins.
    pub outline: &'static str,
    /// Kind of the tasks that give a page each ([`PAGE_OUTPUT`]), one for each cell.
    pub clusters: &'static str,
}
