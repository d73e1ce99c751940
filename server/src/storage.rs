//! Stored bytes as the farm has them: which generation counts is in the queue's store, the bytes in the chunk store.
//!
//! Bytes are written under a name of their own first and taken in afterwards, so a name that the store gives always has
//! its bytes; `kiln fsck` finds bytes that were never taken in, as the server died. Bytes that turn out to be
//! lost or damaged are given up, and the tasks that made them run again.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::Arc;

use bytes::Bytes;
use futures::{StreamExt, TryStreamExt};
use lightkiln_proto::api::ScenePart;
use lightkiln_proto::ids::Digest;
use prometheus_client::metrics::counter::Counter;

use crate::chunks::{ByteStream, ChunkError, ChunkName, ChunkStore, Stored, StreamCheck};
use crate::error::{Result, ServerError};
use crate::store::chunk::{CollectRules, Kept, KeptChunk};
use crate::store::{FarmStore, StoreError};

/// Chunks that one check looks up, and one collection removes, at a time.
const CALLS_IN_FLIGHT: usize = 16;

/// The bytes, and the generations that count.
#[derive(Clone)]
pub struct Storage {
    store: Arc<dyn FarmStore>,
    chunks: Arc<dyn ChunkStore>,
    /// Most bytes stored at a time.
    quota_bytes: Option<u64>,
    lost: Counter,
}

/// Bakes and chunks removed by a collection.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Removed {
    /// Bakes that ended long ago.
    pub bakes: u64,
    /// Chunks that nobody needed.
    pub chunks: u64,
    /// There may be more.
    pub is_partial: bool,
}

impl Storage {
    /// Puts the two together.
    pub fn new(store: Arc<dyn FarmStore>, chunks: Arc<dyn ChunkStore>, quota_bytes: Option<u64>) -> Self {
        Self { store, chunks, quota_bytes, lost: Counter::default() }
    }

    /// Counts the chunks given up since this process started, as their bytes were lost or damaged.
    pub fn lost(&self) -> &Counter {
        &self.lost
    }

    /// Most bytes stored at a time.
    pub fn quota_bytes(&self) -> Option<u64> {
        self.quota_bytes
    }

    /// Stores bytes that are at hand.
    pub async fn put(&self, digest: Digest, bytes: Bytes) -> Result<Stored> {
        let length = bytes.len() as u64;
        let stream = futures::stream::once(async move { Ok(bytes) }).boxed();
        self.put_stream(digest, stream, length, Some(length)).await
    }

    /// Stores bytes as they arrive, at most `limit` of them; `length` is how many will, if that is known.
    ///
    /// Nothing is stored unless all came and their digest is right. Bytes that are stored already are read all the same.
    pub async fn put_stream(
        &self,
        digest: Digest,
        bytes: ByteStream,
        limit: u64,
        length: Option<u64>,
    ) -> Result<Stored> {
        let known = self.store.touch_chunk(digest).await?;
        if let Some(known) = known
            && self.chunks.head(known.name).await? == Some(known.bytes)
        {
            let bytes = read_through(digest, bytes, limit).await?;
            return Ok(Stored { is_new: false, bytes });
        }
        self.require_room(length.unwrap_or(0)).await?;
        let name = ChunkName::fresh(digest);
        let written = self.chunks.put_stream(name, bytes, limit).await?;
        let replaces = known.map(|known| known.name.generation);
        let is_new = self.take_in(KeptChunk { name, bytes: written.bytes }, replaces).await?;
        Ok(Stored { is_new, bytes: written.bytes })
    }

    /// Stores bytes that are those of `parts`, one after the other. A part whose bytes turn out to be lost or damaged is
    /// given up, so that it counts as missing.
    pub(crate) async fn put_together(&self, digest: Digest, parts: &[ScenePart]) -> Result<Stored> {
        let digests: BTreeSet<Digest> = parts.iter().map(|part| part.digest).collect();
        let digests: Vec<Digest> = digests.into_iter().collect();
        let kept = self.store.find_chunks(&digests).await?;
        let names: BTreeMap<Digest, ChunkName> =
            kept.iter().map(|chunk| (chunk.name.digest, chunk.name)).collect();
        let (chunks, by_digest) = (self.chunks.clone(), names.clone());
        let pieces = futures::stream::iter(parts.to_vec()).then(move |part| {
            let (chunks, name) = (chunks.clone(), by_digest.get(&part.digest).copied());
            async move {
                let name = name.ok_or(ChunkError::NotFound { digest: part.digest })?;
                chunks.get_range(name, 0..part.bytes).await
            }
        });
        let length = parts.iter().map(|part| part.bytes).sum();
        let stored = self.put_stream(digest, pieces.try_flatten().boxed(), length, Some(length)).await;
        if let Err(ServerError::Chunks(ChunkError::NotFound { digest } | ChunkError::Damaged { digest })) =
            &stored
            && let Some(name) = names.get(digest)
        {
            self.lose(*name).await?;
        }
        stored
    }

    /// Refuses an upload for which there is no room before it comes.
    async fn require_room(&self, wanted: u64) -> Result<(), StoreError> {
        let Some(quota) = self.quota_bytes else { return Ok(()) };
        let used = self.store.usage().await?.bytes;
        if used + wanted > quota { Err(StoreError::OverQuota { used, wanted }) } else { Ok(()) }
    }

    /// Makes written bytes the chunk's; false when it has equal ones by now.
    async fn take_in(&self, chunk: KeptChunk, replaces: Option<u64>) -> Result<bool> {
        match self.store.keep_chunk(chunk, replaces, self.quota_bytes).await {
            Ok(Kept::Fresh) => return Ok(true),
            Ok(Kept::Known(_)) => (),
            Ok(Kept::Condemned) => {
                let why = "the upload took so long that its bytes were cleared away; send them again";
                return Err(StoreError::Unavailable(why.into()).into());
            }
            Err(error @ StoreError::OverQuota { .. }) => {
                self.remove(chunk.name).await;
                return Err(error.into());
            }
            // They may have been taken in although no answer came: they stay.
            Err(error) => return Err(error.into()),
        }
        self.remove(chunk.name).await;
        Ok(false)
    }

    /// Removes bytes that nobody knows of. Bytes that cannot be removed cost room until the storage is checked.
    async fn remove(&self, name: ChunkName) {
        if let Err(error) = self.chunks.delete(name).await {
            tracing::warn!(%error, digest = %name.digest, "bytes of no use could not be removed; 'kiln fsck' will find them");
        }
    }

    /// Length of a chunk whose bytes are there. It then stays for the grace, whoever needs it.
    pub async fn length(&self, digest: Digest) -> Result<Option<u64>> {
        if let Some(known) = self.store.touch_chunk(digest).await? {
            return Ok(self.is_whole(known).await?.then_some(known.bytes));
        }
        self.adopt(digest).await
    }

    /// Takes in bytes from before generations.
    async fn adopt(&self, digest: Digest) -> Result<Option<u64>> {
        let name = ChunkName::from(digest);
        let Some(bytes) = self.chunks.head(name).await? else { return Ok(None) };
        let kept = self.store.keep_chunk(KeptChunk { name, bytes }, None, None).await?;
        Ok((kept != Kept::Condemned).then_some(bytes))
    }

    /// Looks whether a chunk's bytes are there, and gives it up if not.
    async fn is_whole(&self, chunk: KeptChunk) -> Result<bool> {
        let is_whole = self.chunks.head(chunk.name).await? == Some(chunk.bytes);
        if !is_whole {
            self.lose(chunk.name).await?;
        }
        Ok(is_whole)
    }

    /// Lengths of those of `digests` whose bytes are there.
    pub async fn lengths(&self, digests: &BTreeSet<Digest>) -> Result<BTreeMap<Digest, u64>> {
        if digests.is_empty() {
            return Ok(BTreeMap::new());
        }
        let digests: Vec<Digest> = digests.iter().copied().collect();
        let known = self.store.find_chunks(&digests).await?;
        let looked = futures::stream::iter(known)
            .map(|chunk| async move { Ok::<_, ServerError>((self.is_whole(chunk).await?, chunk)) });
        let looked: Vec<(bool, KeptChunk)> = looked.buffer_unordered(CALLS_IN_FLIGHT).try_collect().await?;
        let whole = looked.into_iter().filter(|(is_whole, _)| *is_whole);
        Ok(whole.map(|(_, chunk)| (chunk.name.digest, chunk.bytes)).collect())
    }

    /// Reads a range, which must lie within the chunk, as it comes. When it is the whole chunk and its bytes are
    /// damaged, the stream ends in an error before it is complete.
    pub async fn read(&self, digest: Digest, range: Range<u64>) -> Result<ByteStream> {
        let found = self.store.find_chunks(&[digest]).await?;
        let chunk = found.first().copied().ok_or(ChunkError::NotFound { digest })?;
        let bytes = self.chunks.get_range(chunk.name, range).await;
        if let Err(ChunkError::NotFound { .. }) = &bytes {
            self.lose(chunk.name).await?;
        }
        let storage = self.clone();
        let bytes = bytes?.or_else(move |error| {
            let storage = storage.clone();
            async move {
                if let ChunkError::Damaged { .. } = &error
                    && let Err(error) = storage.lose(chunk.name).await
                {
                    tracing::error!(%error, "a damaged chunk could not be given up");
                }
                Err(error)
            }
        });
        Ok(bytes.boxed())
    }

    /// Gives up a chunk whose bytes are lost or damaged; tasks of live bakes that made it run again.
    pub async fn lose(&self, name: ChunkName) -> Result<(), StoreError> {
        let kept = self.store.find_chunks(&[name.digest]).await?;
        if kept.first().is_none_or(|kept| kept.name != name) {
            // Cleared away, or stored again, since somebody looked: nothing is lost.
            return Ok(());
        }
        let results = self.store.lose_chunk(name).await?;
        self.lost.inc();
        tracing::error!(digest = %name.digest, results, "a chunk's bytes are lost or damaged; what made it will run again");
        Ok(())
    }

    /// Deletes old bakes, and the bytes that nobody needs any more.
    pub async fn collect(&self, rules: &CollectRules) -> Result<Removed> {
        let collected = self.store.collect(rules).await?;
        let is_partial = [collected.bakes, collected.condemned, collected.to_remove.len() as u64]
            .iter()
            .any(|count| *count >= rules.max.into());
        self.remove_condemned(&collected.to_remove).await?;
        Ok(Removed { bakes: collected.bakes, chunks: collected.to_remove.len() as u64, is_partial })
    }

    /// Removes the bytes of condemned chunks, then forgets them: a crash in between is made good by the next one.
    pub async fn remove_condemned(&self, names: &[ChunkName]) -> Result<()> {
        let removals = futures::stream::iter(names.to_vec()).map(|name| {
            let chunks = self.chunks.clone();
            async move { chunks.delete(name).await }
        });
        removals.buffer_unordered(CALLS_IN_FLIGHT).try_collect::<Vec<()>>().await?;
        if !names.is_empty() {
            self.store.purge(names).await?;
        }
        Ok(())
    }

    /// Writes, reads and removes a few bytes, to show that the chunk store works.
    pub async fn probe(&self) -> Result<()> {
        const CONTENT: &[u8] = b"lightkiln readiness probe\n";
        let name = ChunkName::fresh(Digest::of(CONTENT));
        self.chunks.put_if_absent(name, Bytes::from_static(CONTENT)).await?;
        self.chunks.get(name, CONTENT.len() as u64).await?;
        Ok(self.chunks.delete(name).await?)
    }
}

/// Checks bytes that are not needed.
async fn read_through(digest: Digest, mut bytes: ByteStream, limit: u64) -> Result<u64, ChunkError> {
    let mut check = StreamCheck::new(limit);
    while let Some(piece) = bytes.try_next().await? {
        check.take(&piece)?;
    }
    check.finish(digest)
}
