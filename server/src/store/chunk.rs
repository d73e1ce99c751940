//! Stored bytes as the queue's store knows them: the generation that counts, its references, its end.
//!
//! ```text
//!  keep ──▶ kept ──nobody refers to it, and it was not asked for within the grace──▶ condemned ──purge──▶ gone
//!            │ bytes found lost or damaged
//!            └─────▶ lost (kept again when somebody uploads it)
//! ```
//! Results refer to their outputs, bakes to their scene and to every artefact that their tasks name. The database counts
//! the references itself. A chunk is condemned in a transaction that no change of a reference runs beside, and a result
//! is taken in only if its outputs are kept in that same transaction: so no chunk that is referred to is ever condemned.
//! Condemned names are dead for good; who uploads the same bytes meanwhile gets another generation, and waits for nobody.

use lightkiln_proto::ids::Digest;

use crate::chunks::ChunkName;

/// A chunk that may be referred to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct KeptChunk {
    /// Its name.
    pub name: ChunkName,
    /// Its length.
    pub bytes: u64,
}

/// Outcome of taking stored bytes in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kept {
    /// They are the chunk's now.
    Fresh,
    /// The chunk has others, equal ones; these are of no use.
    Known(KeptChunk),
    /// The name was condemned meanwhile: store them again, under another.
    Condemned,
}

/// Rules of a collection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CollectRules {
    /// Chunks that nobody refers to stay this long after they were last asked for.
    pub grace_ms: i64,
    /// Bakes that ended this long ago are deleted, with the results that no other bake holds.
    pub keep_bakes_ms: Option<i64>,
    /// At most so many bakes, and so many chunks, in one call.
    pub max: u32,
}

/// Outcome of a collection.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Collected {
    /// Bakes deleted because they ended long ago.
    pub bakes: u64,
    /// Chunks condemned now.
    pub condemned: u64,
    /// Condemned chunks whose bytes are to be removed and then purged, earlier ones included.
    pub to_remove: Vec<ChunkName>,
}

/// A chunk as a check of the storage sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChunkRow {
    /// Digest of its bytes.
    pub digest: Digest,
    /// The generation that counts; none when its bytes are lost.
    pub generation: Option<u64>,
    /// Its length.
    pub bytes: u64,
    /// References to it.
    pub refs: u64,
    /// It is the scene of a bake that has not ended: no task makes it again if its bytes are lost.
    pub is_live_scene: bool,
}

/// Fill of the storage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    /// Chunks stored, condemned ones included.
    pub chunks: u64,
    /// Their bytes.
    pub bytes: u64,
}
