//! Chunks: kept, referred to, condemned, purged. The references are counted by triggers.

use std::collections::BTreeSet;

use lightkiln_proto::ids::Digest;

use super::codec::{ROWS_PER_STATEMENT, to_json};
use super::conn::{Conn, Row, query, to_column};
use super::forget;
use super::ledger::{seq_of, state_from};
use crate::chunks::ChunkName;
use crate::store::chunk::{ChunkRow, CollectRules, Collected, Kept, KeptChunk, Usage};
use crate::store::rules::CHUNK_USED_GRAIN_MS;
use crate::store::{Result, StoreError, require_ended};

/// The kept ones among `digests`.
pub(super) async fn find(conn: &mut Conn, digests: &[Digest]) -> Result<Vec<KeptChunk>> {
    let sql =
        "SELECT c.digest, c.generation, c.bytes FROM json_each($1) j JOIN chunks c ON c.digest = j.value
               WHERE c.generation IS NOT NULL";
    let mut found = Vec::new();
    for digests in digests.chunks(ROWS_PER_STATEMENT) {
        for row in query(sql).bind(to_json(digests)?).all(conn).await? {
            found.push(kept(&row)?);
        }
    }
    Ok(found)
}

/// A kept chunk, and whether it was last asked for so long ago that it should be noted.
pub(super) async fn look(conn: &mut Conn, digest: Digest) -> Result<Option<(KeptChunk, bool)>> {
    let sql =
        "SELECT digest, generation, bytes, used_ms FROM chunks WHERE digest = $1 AND generation IS NOT NULL";
    let Some(row) = query(sql).bind(digest.to_string()).optional(conn).await? else { return Ok(None) };
    let is_stale = conn.now_ms - row.get::<i64>("used_ms")? >= CHUNK_USED_GRAIN_MS;
    Ok(Some((kept(&row)?, is_stale)))
}

/// Notes that a chunk was asked for.
pub(super) async fn touch(conn: &mut Conn, digest: Digest) -> Result<Option<KeptChunk>> {
    let sql =
        "UPDATE chunks SET used_ms = $1 WHERE digest = $2 AND generation IS NOT NULL AND $1 - used_ms >= $3";
    query(sql).bind(conn.now_ms).bind(digest.to_string()).bind(CHUNK_USED_GRAIN_MS).run(conn).await?;
    Ok(look(conn, digest).await?.map(|(kept, _)| kept))
}

pub(super) async fn keep(
    conn: &mut Conn,
    chunk: KeptChunk,
    replaces: Option<u64>,
    quota: Option<u64>,
) -> Result<Kept> {
    let (digest, generation) = (chunk.name.digest.to_string(), chunk.name.generation);
    // A name does not take its own place.
    let replaces = replaces.filter(|old| *old != generation);
    let sql = "SELECT 1 FROM condemned WHERE digest = $1 AND generation = $2";
    if query(sql).bind(&digest).bind(generation).optional(conn).await?.is_some() {
        return Ok(Kept::Condemned);
    }
    if let Some(replaces) = replaces {
        let sql =
            "INSERT INTO condemned (digest, generation, bytes) SELECT digest, generation, bytes FROM chunks
                   WHERE digest = $1 AND generation = $2 ON CONFLICT DO NOTHING";
        query(sql).bind(&digest).bind(replaces).run(conn).await?;
    }
    let sql = "INSERT INTO chunks (digest, generation, bytes, used_ms) VALUES ($1, $2, $3, $4) ON CONFLICT (digest) DO UPDATE SET
               generation = excluded.generation, bytes = excluded.bytes, used_ms = excluded.used_ms
               WHERE chunks.generation IS NULL OR chunks.generation = $5";
    let insert = query(sql).bind(&digest).bind(generation).bind(chunk.bytes).bind(conn.now_ms);
    // No generation is below 0.
    if insert.bind(replaces.map_or(-1, to_column)).run(conn).await? == 0 {
        let known = touch(conn, chunk.name.digest).await?;
        return Ok(known.map_or(Kept::Condemned, Kept::Known));
    }
    let sql = "UPDATE storage_usage SET chunks = chunks + 1, bytes = bytes + $1 WHERE bytes + $1 <= $2";
    let quota = quota.unwrap_or(u64::MAX);
    if query(sql).bind(chunk.bytes).bind(quota).run(conn).await? == 0 {
        let used = usage(conn).await?.bytes;
        return Err(StoreError::OverQuota { used, wanted: chunk.bytes });
    }
    Ok(Kept::Fresh)
}

pub(super) async fn usage(conn: &mut Conn) -> Result<Usage> {
    let row = query("SELECT chunks, bytes FROM storage_usage").one(conn).await?;
    Ok(Usage { chunks: row.count("chunks")?, bytes: row.count("bytes")? })
}

/// Makes a bake refer to artefacts, lost ones included; those of `required` must be kept.
pub(super) async fn refer(
    conn: &mut Conn,
    bake: i64,
    named: &BTreeSet<Digest>,
    required: &BTreeSet<Digest>,
) -> Result<()> {
    if named.is_empty() {
        return Ok(());
    }
    let required: Vec<Digest> = required.iter().copied().collect();
    require(conn, &required).await?;
    let named: Vec<Digest> = named.iter().copied().collect();
    let sql =
        "INSERT INTO bake_chunks (bake, digest) SELECT $1, c.digest FROM json_each($2) j JOIN chunks c ON c.digest = j.value
               WHERE true ON CONFLICT DO NOTHING";
    for named in named.chunks(ROWS_PER_STATEMENT) {
        query(sql).bind(bake).bind(to_json(named)?).run(conn).await?;
    }
    Ok(())
}

/// Refuses if one of them is not kept.
pub(super) async fn require(conn: &mut Conn, digests: &[Digest]) -> Result<()> {
    let sql = "SELECT j.value AS digest FROM json_each($1) j WHERE NOT EXISTS (
                   SELECT 1 FROM chunks c WHERE c.digest = j.value AND c.generation IS NOT NULL)
               ORDER BY j.value LIMIT 1";
    for digests in digests.chunks(ROWS_PER_STATEMENT) {
        if let Some(row) = query(sql).bind(to_json(digests)?).optional(conn).await? {
            return Err(StoreError::MissingChunk { digest: row.digest("digest")? });
        }
    }
    Ok(())
}

pub(super) async fn collect(conn: &mut Conn, rules: &CollectRules) -> Result<Collected> {
    let mut collected = Collected::default();
    if let Some(keep_ms) = rules.keep_bakes_ms {
        let sql = "SELECT seq FROM bakes WHERE finished_ms <= $1 ORDER BY seq LIMIT $2";
        for row in query(sql).bind(conn.now_ms - keep_ms).bind(rules.max).all(conn).await? {
            delete(conn, row.get("seq")?).await?;
            collected.bakes += 1;
        }
    }
    let sql = "SELECT digest, generation, bytes FROM chunks WHERE refs = 0 AND used_ms <= $1
               ORDER BY used_ms, digest LIMIT $2";
    let unused = query(sql).bind(conn.now_ms - rules.grace_ms).bind(rules.max).all(conn).await?;
    let mut digests = Vec::with_capacity(unused.len());
    for row in &unused {
        digests.push(row.text("digest")?);
        collected.condemned += u64::from(row.get::<Option<i64>>("generation")?.is_some());
    }
    let digests = to_json(&digests)?;
    for sql in [
        "INSERT INTO condemned (digest, generation, bytes) SELECT c.digest, c.generation, c.bytes FROM json_each($1) j
         JOIN chunks c ON c.digest = j.value WHERE c.generation IS NOT NULL ON CONFLICT DO NOTHING",
        "DELETE FROM chunks WHERE digest IN (SELECT value FROM json_each($1))",
    ] {
        query(sql).bind(&digests).run(conn).await?;
    }
    let sql = "SELECT digest, generation, bytes FROM condemned ORDER BY digest, generation LIMIT $1";
    for row in query(sql).bind(rules.max).all(conn).await? {
        collected.to_remove.push(kept(&row)?.name);
    }
    Ok(collected)
}

pub(super) async fn purge(conn: &mut Conn, names: &[ChunkName]) -> Result<()> {
    let sql = "DELETE FROM condemned WHERE digest = $1 AND generation = $2 RETURNING bytes";
    for name in names {
        let deleted = query(sql).bind(name.digest.to_string()).bind(name.generation).optional(conn).await?;
        if let Some(row) = deleted {
            let sql = "UPDATE storage_usage SET chunks = chunks - 1, bytes = bytes - $1";
            query(sql).bind(row.count("bytes")?).run(conn).await?;
        }
    }
    Ok(())
}

pub(super) async fn delete_bake(conn: &mut Conn, id: &str) -> Result<()> {
    let seq = seq_of(conn, id).await?;
    let state = query("SELECT state FROM bakes WHERE seq = $1").bind(seq).one(conn).await?.text("state")?;
    require_ended(id, state_from(&state)?, "deleted")?;
    delete(conn, seq).await
}

/// Deletes an ended bake and the results that no other bake holds.
async fn delete(conn: &mut Conn, bake: i64) -> Result<()> {
    for sql in [
        "UPDATE farm_totals SET tasks_run = farm_totals.tasks_run + b.tasks_run,
         tasks_reused = farm_totals.tasks_reused + b.tasks_reused FROM bakes b WHERE b.seq = $1",
        "DELETE FROM tasks WHERE id IN (SELECT task FROM bake_tasks WHERE bake = $1)
         AND NOT EXISTS (SELECT 1 FROM bake_tasks o WHERE o.task = tasks.id AND o.bake <> $1)",
        "DELETE FROM bakes WHERE seq = $1",
    ] {
        query(sql).bind(bake).run(conn).await?;
    }
    Ok(())
}

/// Gives a chunk's bytes up; results that have it among their outputs are forgotten. Returns how many.
pub(super) async fn lose(conn: &mut Conn, name: ChunkName) -> Result<u64> {
    let (digest, generation) = (name.digest.to_string(), name.generation);
    for sql in [
        "INSERT INTO condemned (digest, generation, bytes) SELECT digest, generation, bytes FROM chunks
         WHERE digest = $1 AND generation = $2 ON CONFLICT DO NOTHING",
        "UPDATE chunks SET generation = NULL WHERE digest = $1 AND generation = $2",
    ] {
        if query(sql).bind(&digest).bind(generation).run(conn).await? == 0 {
            return Ok(0);
        }
    }
    let sql =
        "SELECT t.key FROM result_chunks r JOIN tasks t ON t.id = r.task WHERE r.digest = $1 ORDER BY t.key";
    let rows = query(sql).bind(&digest).all(conn).await?;
    let keys = rows.iter().map(|row| row.digest("key")).collect::<Result<Vec<_>, _>>()?;
    forget::forget_all(conn, &keys).await?;
    Ok(keys.len() as u64)
}

pub(super) async fn rows(conn: &mut Conn, after: Option<Digest>, limit: u32) -> Result<Vec<ChunkRow>> {
    let sql = "SELECT digest, generation, bytes, refs,
               digest IN (SELECT scene FROM bakes WHERE state IN ('running', 'paused')) AS is_live_scene
               FROM chunks WHERE digest > $1 ORDER BY digest LIMIT $2";
    let after = after.map(|digest| digest.to_string()).unwrap_or_default();
    let mut found = Vec::new();
    for row in query(sql).bind(after).bind(limit).all(conn).await? {
        let generation = row.get::<Option<i64>>("generation")?.and_then(|g| u64::try_from(g).ok());
        let (bytes, refs) = (row.count("bytes")?, row.count("refs")?);
        let (digest, is_live_scene) = (row.digest("digest")?, row.get("is_live_scene")?);
        found.push(ChunkRow { digest, generation, bytes, refs, is_live_scene });
    }
    Ok(found)
}

/// Those that are neither kept nor condemned.
pub(super) async fn orphans(conn: &mut Conn, names: &[ChunkName]) -> Result<Vec<ChunkName>> {
    let sql = "SELECT 1 FROM chunks WHERE digest = $1 AND generation = $2
               UNION ALL SELECT 1 FROM condemned WHERE digest = $1 AND generation = $2";
    let mut orphans = Vec::new();
    for name in names {
        let found = query(sql).bind(name.digest.to_string()).bind(name.generation).optional(conn).await?;
        if found.is_none() {
            orphans.push(*name);
        }
    }
    Ok(orphans)
}

/// Condemns those that are neither kept nor condemned; returns them.
pub(super) async fn condemn_orphans(conn: &mut Conn, chunks: &[KeptChunk]) -> Result<Vec<ChunkName>> {
    let names: Vec<ChunkName> = chunks.iter().map(|chunk| chunk.name).collect();
    let condemned = orphans(conn, &names).await?;
    for chunk in chunks.iter().filter(|chunk| condemned.contains(&chunk.name)) {
        query("INSERT INTO condemned (digest, generation, bytes) VALUES ($1, $2, $3)")
            .bind(chunk.name.digest.to_string())
            .bind(chunk.name.generation)
            .bind(chunk.bytes)
            .run(conn)
            .await?;
        let sql = "UPDATE storage_usage SET chunks = chunks + 1, bytes = bytes + $1";
        query(sql).bind(chunk.bytes).run(conn).await?;
    }
    Ok(condemned)
}

fn kept(row: &Row) -> Result<KeptChunk> {
    let name = ChunkName { digest: row.digest("digest")?, generation: row.count("generation")? };
    Ok(KeptChunk { name, bytes: row.count("bytes")? })
}
