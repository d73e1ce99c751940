//! A check of the stored bytes: missing ones, damaged ones and orphans.
//!
//! It may run beside servers. Repairing goes the ways that they go: chunks whose bytes are missing or damaged are given
//! up, so that their tasks run again where a live bake needs them, and bytes that nobody knows of are condemned first.

use std::time::Duration;

use futures::{StreamExt, TryStreamExt};
use lightkiln_proto::api::{BakeFilter, BakeState};
use lightkiln_proto::ids::Digest;
use serde::Serialize;

use crate::chunks::{ChunkError, ChunkName, ChunkStore, Listed};
use crate::clock::{Clock as _, SystemClock};
use crate::error::{Result, ServerError};
use crate::storage::Storage;
use crate::store::FarmStore;
use crate::store::chunk::{ChunkRow, KeptChunk};

/// Chunks, and bakes, that are asked for together.
const PAGE: u32 = 500;
/// Chunks that are looked at or read at a time.
const CALLS_IN_FLIGHT: usize = 8;

/// Depth of a check, and whether it repairs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Checks {
    /// Reads all bytes and compares their digests; else only lengths are looked at.
    pub reads: bool,
    /// Repairs what it can.
    pub repairs: bool,
    /// Bytes that nobody knows of count as left over once they are so old: younger ones may be uploads under way.
    pub grace: Duration,
}

/// A chunk with something wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Flaw {
    /// Digest of its bytes, as they should be.
    pub digest: Digest,
    /// Its length.
    pub bytes: u64,
    /// Bakes and results that refer to it.
    pub references: u64,
}

/// A bake that ended well and can no longer be fetched as a whole.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Incomplete {
    /// The bake's id.
    pub bake: String,
    /// Its name.
    pub name: String,
    /// Results of it that were lost.
    pub results_lost: u64,
}

/// Findings of a check.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Findings {
    /// Chunks that should be there.
    pub chunks: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Bytes that are not there.
    pub missing: Vec<Flaw>,
    /// Bytes that are not those of their digest, or not all of them.
    pub corrupt: Vec<Flaw>,
    /// Bytes that nobody knows of.
    pub orphaned: Vec<Flaw>,
    /// Scenes that bakes under way need and that are known to be lost: no task makes them, only an upload does.
    pub lost: Vec<Flaw>,
    /// Bakes that lost results after their end: no repair changes that, only a new bake of the scene does.
    pub incomplete: Vec<Incomplete>,
    /// Results forgotten by the repair; their tasks run again where a live bake needs them.
    pub results_forgotten: u64,
    /// Whether missing, corrupt and orphaned chunks were made good.
    pub repaired: bool,
}

impl Findings {
    /// Whether the farm has all bytes that it needs. Results that bakes lost after their end are no fault.
    pub fn is_sound(&self) -> bool {
        let open = self.missing.len() + self.corrupt.len() + self.orphaned.len();
        self.lost.is_empty() && (open == 0 || self.repaired)
    }
}

/// Faults of a chunk's bytes.
enum Wrong {
    Missing,
    Corrupt,
}

/// Checks every chunk that should be there, then every one that is.
pub async fn check(
    store: &dyn FarmStore,
    chunks: &dyn ChunkStore,
    storage: &Storage,
    checks: Checks,
) -> Result<Findings> {
    let mut findings = Findings::default();
    check_rows(store, chunks, checks, &mut findings).await?;
    check_objects(store, chunks, storage, checks, &mut findings).await?;
    list_incomplete(store, &mut findings).await?;
    findings.repaired = checks.repairs;
    Ok(findings)
}

async fn check_rows(
    store: &dyn FarmStore,
    chunks: &dyn ChunkStore,
    checks: Checks,
    findings: &mut Findings,
) -> Result<()> {
    let mut after = None;
    loop {
        let rows = store.chunk_rows(after, PAGE).await?;
        let Some(last) = rows.last() else { return Ok(()) };
        after = Some(last.digest);
        let looks = futures::stream::iter(rows)
            .map(|row| async move { Ok::<_, ServerError>((row, look(chunks, &row, checks.reads).await?)) });
        let looked: Vec<_> = looks.buffered(CALLS_IN_FLIGHT).try_collect().await?;
        for (row, wrong) in looked {
            note(store, &row, wrong, checks, findings).await?;
        }
    }
}

async fn note(
    store: &dyn FarmStore,
    row: &ChunkRow,
    wrong: Option<Wrong>,
    checks: Checks,
    findings: &mut Findings,
) -> Result<()> {
    let flaw = Flaw { digest: row.digest, bytes: row.bytes, references: row.refs };
    let Some(generation) = row.generation else {
        if row.is_live_scene {
            findings.lost.push(flaw);
        }
        return Ok(());
    };
    findings.chunks += 1;
    findings.bytes += row.bytes;
    let Some(wrong) = wrong else { return Ok(()) };
    let name = ChunkName { digest: row.digest, generation };
    // Servers go on meanwhile: it may have been cleared away, or stored again, since it was listed.
    let now = store.find_chunks(&[row.digest]).await?;
    if now.first().is_none_or(|kept| kept.name != name) {
        return Ok(());
    }
    match wrong {
        Wrong::Missing => findings.missing.push(flaw),
        Wrong::Corrupt => findings.corrupt.push(flaw),
    }
    if checks.repairs {
        findings.results_forgotten += store.lose_chunk(name).await?;
        if row.is_live_scene {
            findings.lost.push(flaw);
        }
    }
    Ok(())
}

async fn list_incomplete(store: &dyn FarmStore, findings: &mut Findings) -> Result<()> {
    let mut after = None;
    loop {
        let page = store.list(&BakeFilter::default(), after, PAGE).await?;
        let incomplete =
            page.bakes.into_iter().filter(|bake| bake.state == BakeState::Done && bake.results_lost > 0);
        findings.incomplete.extend(incomplete.map(|bake| Incomplete {
            bake: bake.id,
            name: bake.name,
            results_lost: bake.results_lost,
        }));
        match page.next {
            Some(next) => after = Some(next),
            None => return Ok(()),
        }
    }
}

async fn look(chunks: &dyn ChunkStore, row: &ChunkRow, reads: bool) -> Result<Option<Wrong>, ChunkError> {
    let Some(generation) = row.generation else { return Ok(None) };
    let name = ChunkName { digest: row.digest, generation };
    match chunks.head(name).await? {
        None => return Ok(Some(Wrong::Missing)),
        Some(length) if length != row.bytes => return Ok(Some(Wrong::Corrupt)),
        Some(_) => (),
    }
    if !reads || row.bytes == 0 {
        return Ok(None);
    }
    let read = async {
        let mut pieces = chunks.get_range(name, 0..row.bytes).await?;
        while pieces.try_next().await?.is_some() {}
        Ok(())
    };
    match read.await {
        Ok(()) => Ok(None),
        Err(ChunkError::Damaged { .. }) => Ok(Some(Wrong::Corrupt)),
        Err(ChunkError::NotFound { .. }) => Ok(Some(Wrong::Missing)),
        Err(error) => Err(error),
    }
}

async fn check_objects(
    store: &dyn FarmStore,
    chunks: &dyn ChunkStore,
    storage: &Storage,
    checks: Checks,
    findings: &mut Findings,
) -> Result<()> {
    let grace_ms = i64::try_from(checks.grace.as_millis()).unwrap_or(i64::MAX);
    let old_ms = SystemClock.now_ms().saturating_sub(grace_ms);
    let mut pages = chunks.list().try_chunks(PAGE as usize).map_err(|error| error.1);
    while let Some(page) = pages.try_next().await? {
        let old: Vec<Listed> = page.into_iter().filter(|chunk| chunk.written_ms <= old_ms).collect();
        let names: Vec<ChunkName> = old.iter().map(|chunk| chunk.name).collect();
        let orphans = store.orphans(&names).await?;
        let orphans = old.into_iter().filter(|chunk| orphans.contains(&chunk.name));
        let orphans: Vec<KeptChunk> =
            orphans.map(|chunk| KeptChunk { name: chunk.name, bytes: chunk.bytes }).collect();
        for orphan in &orphans {
            let flaw = Flaw { digest: orphan.name.digest, bytes: orphan.bytes, references: 0 };
            findings.orphaned.push(flaw);
        }
        if checks.repairs {
            let condemned = store.condemn_orphans(&orphans).await?;
            storage.remove_condemned(&condemned).await?;
        }
    }
    Ok(())
}
