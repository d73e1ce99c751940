//! Results that are made once more on another machine ([`verify`](crate::store::verify)): chosen by commits, handed out by claims that
//! find no task, compared, given up.
//!
//! A row is a result that waits, or the lease of the one attempt under way at it. Its task stays done, so nothing that counts tasks,
//! leases or attempts of bakes sees it. Rows that workers with the same abilities may take share a `source`: whoever looks walks from
//! one source to the next by the index, however many rows each has.

use std::collections::BTreeMap;

use lightkiln_proto::api::{ClaimRequest, Lease, Needs};
use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::{Artefact, TaskSpec};
use serde_json::{Value, json};

use super::alarms::{self, Given};
use super::chunks;
use super::codec::{ROWS_PER_STATEMENT, to_json};
use super::conn::{Conn, corrupt, query, steps};
use super::ledger::Ledger;
use crate::random;
use crate::store::rules::{self, Abilities, dependencies, resolve_inputs};
use crate::store::verify::{Maker, RERUN_LAPSES_MS, RERUN_TRIES, RERUNS_GIVEN_UP, is_chosen};
use crate::store::{Opening, Result, StoreError};

/// Rows that are read beside the first of each source, as other claims may have locked some, for all sources together.
const BESIDE: usize = 16;

/// Sources of rows that wait, and how many each has, counted up to a number.
macro_rules! sources {
    ($reruns:literal) => {
        concat!(
            "WITH RECURSIVE s (source) AS (
                 SELECT (SELECT r.source FROM ",
            $reruns,
            " WHERE r.token IS NULL AND r.is_paused = 0 ORDER BY r.source LIMIT 1)
                 UNION ALL SELECT (SELECT r.source FROM ",
            $reruns,
            " WHERE r.token IS NULL AND r.is_paused = 0 AND r.source > s.source ORDER BY r.source LIMIT 1)
                 FROM s WHERE s.source IS NOT NULL)
             SELECT s.source, (SELECT count(*) FROM (
                 SELECT 1 FROM ",
            $reruns,
            " WHERE r.token IS NULL AND r.is_paused = 0 AND r.source = s.source AND r.until_ms > $1
                 LIMIT $2) AS counted) AS ready
             FROM s WHERE s.source IS NOT NULL"
        )
    };
}

/// The row of those sources that has waited longest.
const FIRST: &str = "SELECT r.task FROM json_each($1) k CROSS JOIN reruns r WHERE r.task IN (
                         SELECT o.task FROM reruns o INDEXED BY reruns_that_wait
                         WHERE o.token IS NULL AND o.is_paused = 0 AND o.source = k.value AND o.until_ms > $2
                         ORDER BY o.until_ms, o.key LIMIT $3)
                     ORDER BY r.until_ms, r.key LIMIT 1";
/// The same, locked; rows that other claims have locked are left to them. Ordered by what was read, so that no planner walks all rows
/// by their ends.
const FIRST_LOCKED: &str = "WITH first AS MATERIALIZED (
                                SELECT x.task, x.until_ms, x.key FROM json_each($1) k CROSS JOIN LATERAL (
                                    SELECT o.task, o.until_ms, o.key FROM reruns o
                                    WHERE o.token IS NULL AND o.is_paused = 0 AND o.source = k.value AND o.until_ms > $2
                                    ORDER BY o.until_ms, o.key LIMIT $3) AS x)
                            SELECT f.task FROM first f JOIN reruns r ON r.task = f.task WHERE r.token IS NULL
                            ORDER BY f.until_ms, f.key LIMIT 1 FOR UPDATE OF r SKIP LOCKED";

/// A result that was taken in just now.
pub(super) struct Made<'a> {
    pub(super) task: i64,
    pub(super) key: TaskKey,
    pub(super) kind: &'a str,
    pub(super) worker: &'a str,
}

impl Made<'_> {
    /// Its row, if one of the live bakes that hold its task, oldest first, chooses it.
    pub(super) fn chosen<'b>(&self, bakes: impl IntoIterator<Item = &'b Ledger>) -> Option<Value> {
        let Self { task, key, kind, worker } = self;
        let chooses = |bake: &&Ledger| bake.verify_share > 0.0 && is_chosen(*key, bake.verify_share);
        bakes.into_iter().find(chooses).map(|bake| json!([task, key, bake.seq, kind, worker]))
    }
}

/// Lets chosen results wait.
pub(super) async fn add(conn: &mut Conn, chosen: &[Value]) -> Result<()> {
    if chosen.is_empty() {
        return Ok(());
    }
    let sql = conn.pick(
        "INSERT INTO reruns (task, key, bake, source, until_ms, is_paused)
         SELECT j.value ->> 0, j.value ->> 1, b.seq, json_array(j.value ->> 3, b.needs, j.value ->> 4, coalesce(w.machine, '')), $2,
         b.state = 'paused' FROM json_each($1) j JOIN bakes b ON b.seq = j.value ->> 2
         LEFT JOIN workers w ON w.name = j.value ->> 4",
        "INSERT INTO reruns (task, key, bake, source, until_ms, is_paused)
         SELECT (v ->> 0)::bigint, v ->> 1, b.seq, CAST(json_build_array(v ->> 3, b.needs, v ->> 4, coalesce(w.machine, '')) AS TEXT), $2,
         (b.state = 'paused')::int FROM jsonb_array_elements($1::jsonb) AS j (v) JOIN bakes b ON b.seq = (v ->> 2)::bigint
         LEFT JOIN workers w ON w.name = v ->> 4",
    );
    query(sql).bind(to_json(chosen)?).bind(conn.now_ms + RERUN_LAPSES_MS).run(conn).await?;
    Ok(())
}

/// Results that wait, by who may make them again, counted up to `enough`.
pub(super) async fn openings(conn: &mut Conn, enough: u64) -> Result<Vec<Opening>> {
    Ok(read_sources(conn, enough).await?.into_iter().map(|(_, opening)| opening).collect())
}

async fn read_sources(conn: &mut Conn, enough: u64) -> Result<Vec<(String, Opening)>> {
    let sql = conn.pick(sources!("reruns r INDEXED BY reruns_that_wait"), sources!("reruns r"));
    let mut sources = Vec::new();
    for row in query(sql).bind(conn.now_ms).bind(enough).all(conn).await? {
        let (source, ready) = (row.text("source")?, row.count("ready")?);
        let (kind, needs, worker, machine): (String, String, String, String) = row.json("source")?;
        let needs: Needs =
            serde_json::from_str(&needs).map_err(|error| corrupt("needs of a result's source", error))?;
        let maker = Some(Maker { worker, machine });
        // Those that have just lapsed wait for nobody but the reaper.
        if ready > 0 {
            sources.push((source, Opening { kind, needs, ready, room: None, maker }));
        }
    }
    Ok(sources)
}

/// Hands out the task whose result has waited longest, of those that this worker may make again.
pub(super) async fn claim(conn: &mut Conn, request: &ClaimRequest) -> Result<Option<Lease>> {
    if request.max == 0 {
        return Ok(None);
    }
    let abilities = Abilities::of(request);
    let may_take = |opening: &Opening| {
        request.kinds.contains(&opening.kind)
            && abilities.suffice(&opening.needs)
            && opening.maker.as_ref().is_some_and(|maker| maker.may_be_verified_by(request))
    };
    let sources = read_sources(conn, 1).await?.into_iter().filter(|(_, opening)| may_take(opening));
    let sources: Vec<String> = sources.map(|(source, _)| source).collect();
    if sources.is_empty() {
        return Ok(None);
    }
    let beside = conn.pick(0, BESIDE / sources.len());
    let sources = to_json(&sources)?;
    for _ in 0..RERUNS_GIVEN_UP {
        let first = query(conn.pick(FIRST, FIRST_LOCKED)).bind(&sources).bind(conn.now_ms).bind(1 + beside);
        let Some(row) = first.optional(conn).await? else { return Ok(None) };
        let task: i64 = row.get("task")?;
        if let Some(lease) = lease(conn, task, request).await? {
            return Ok(Some(lease));
        }
        // Nobody can make it again.
        query("DELETE FROM reruns WHERE task = $1").bind(task).run(conn).await?;
    }
    Ok(None)
}

/// Leases a task whose row nobody else has; nothing if something that it reads is gone.
async fn lease(conn: &mut Conn, task: i64, request: &ClaimRequest) -> Result<Option<Lease>> {
    let sql = "SELECT t.key, t.kind, t.version, t.label, t.params, t.inputs, t.cost, t.alike, b.id, b.attempt_limit_secs,
               b.traceparent FROM reruns r JOIN tasks t ON t.id = r.task JOIN bakes b ON b.seq = r.bake WHERE r.task = $1";
    let row = query(sql).bind(task).one(conn).await?;
    let spec = row.task()?;
    let Some(inputs) = inputs(conn, &spec).await? else { return Ok(None) };
    let limit = row.get::<Option<i64>>("attempt_limit_secs")?.and_then(|limit| u32::try_from(limit).ok());
    let deadline_ms = rules::deadline_ms(conn.now_ms, limit);
    let ttl_ms = i64::from(request.ttl_secs) * 1000;
    let (token, expires_ms) = (random::fencing_token(), (conn.now_ms + ttl_ms).min(deadline_ms));
    query(
        "UPDATE reruns SET token = $2, worker = $3, ttl_ms = $4, started_ms = $5, expires_ms = $6, deadline_ms = $7, graces = 0
         WHERE task = $1",
    )
    .bind(task)
    .bind(&token)
    .bind(&request.worker)
    .bind(ttl_ms)
    .bind(conn.now_ms)
    .bind(expires_ms)
    .bind(deadline_ms)
    .run(conn)
    .await?;
    let (bake, traceparent) = (row.get("id")?, row.get("traceparent")?);
    // No results of tasks alike: its own is among them, and must not be taken over.
    Ok(Some(Lease { token, bake, task: spec, inputs, alike: Vec::new(), expires_ms, traceparent }))
}

/// Inputs of a task, if all of them are there. Dependencies are found by their keys: one that was dropped and made again is another row.
async fn inputs(conn: &mut Conn, spec: &TaskSpec) -> Result<Option<Vec<Artefact>>> {
    let keys = dependencies(spec);
    let sql = "SELECT t.key, x.outputs FROM json_each($1) j JOIN tasks t ON t.key = j.value JOIN results x ON x.task = t.id";
    let mut outputs: BTreeMap<TaskKey, Vec<Artefact>> = BTreeMap::new();
    for keys in keys.chunks(ROWS_PER_STATEMENT) {
        for row in query(sql).bind(to_json(keys)?).all(conn).await? {
            outputs.insert(row.digest("key")?, row.json("outputs")?);
        }
    }
    if outputs.len() < keys.len() {
        return Ok(None);
    }
    let inputs = resolve_inputs(spec, |key| outputs.get(key).cloned().unwrap_or_default());
    let digests: Vec<Digest> = inputs.iter().map(|input| input.digest).collect();
    match chunks::require(conn, &digests).await {
        Ok(()) => Ok(Some(inputs)),
        Err(StoreError::MissingChunk { .. }) => Ok(None),
        Err(error) => Err(error),
    }
}

/// Prolongs a lease that is good: its worker, and until when.
pub(super) async fn keep(conn: &mut Conn, token: &str) -> Result<Option<(String, i64)>> {
    let sql = "UPDATE reruns SET expires_ms = CASE WHEN deadline_ms < $1 + ttl_ms THEN deadline_ms ELSE $1 + ttl_ms END, graces = 0
               WHERE token = $2 AND expires_ms > $1 RETURNING worker, expires_ms";
    let kept = query(sql).bind(conn.now_ms).bind(token).optional(conn).await?;
    kept.map(|row| Ok((row.get("worker")?, row.get("expires_ms")?))).transpose()
}

/// Compares what a task gave the second time with the result that counts; false if the lease is not good.
pub(super) async fn commit(conn: &mut Conn, token: &str, outputs: &[Artefact]) -> Result<bool> {
    let sql = "DELETE FROM reruns WHERE token = $1 AND expires_ms > $2 RETURNING task, worker";
    let Some(row) = query(sql).bind(token).bind(conn.now_ms).optional(conn).await? else { return Ok(false) };
    let (task, worker): (i64, String) = (row.get("task")?, row.get("worker")?);
    query("UPDATE farm_totals SET verified = verified + 1").run(conn).await?;
    let kept = query("SELECT outputs FROM results WHERE task = $1").bind(task).one(conn).await?;
    let kept: Vec<Artefact> = kept.json("outputs")?;
    alarms::compare(conn, task, &kept, &Given { token, worker: &worker, outputs }).await?;
    Ok(true)
}

/// Ends an attempt that failed; false if the lease is not good.
pub(super) async fn fail(conn: &mut Conn, token: &str) -> Result<bool> {
    let sql = "UPDATE reruns SET token = NULL, worker = NULL, tries = tries + 1 WHERE token = $1 AND expires_ms > $2
               RETURNING task, tries";
    let Some(row) = query(sql).bind(token).bind(conn.now_ms).optional(conn).await? else { return Ok(false) };
    if row.small("tries")? >= RERUN_TRIES {
        query("DELETE FROM reruns WHERE task = $1").bind(row.get::<i64>("task")?).run(conn).await?;
    }
    Ok(true)
}

/// Ends an attempt that nobody counts; false if the lease is not good.
pub(super) async fn release(conn: &mut Conn, token: &str) -> Result<bool> {
    let sql = "UPDATE reruns SET token = NULL, worker = NULL WHERE token = $1 AND expires_ms > $2";
    Ok(query(sql).bind(token).bind(conn.now_ms).run(conn).await? > 0)
}

/// The same for all attempts of a worker; returns how many.
pub(super) async fn release_all(conn: &mut Conn, worker: &str) -> Result<u64> {
    let sql = "UPDATE reruns SET token = NULL, worker = NULL WHERE token IS NOT NULL AND worker = $1";
    query(sql).bind(worker).run(conn).await
}

/// Gives leases their whole length again, as [`leases`](super::leases) does.
pub(super) async fn extend(conn: &mut Conn) -> Result<u64> {
    let sql = "UPDATE reruns SET expires_ms = CASE WHEN deadline_ms < $1 + ttl_ms THEN deadline_ms ELSE $1 + ttl_ms END,
               graces = graces + 1
               WHERE token IS NOT NULL AND expires_ms <= $1 + ttl_ms / 2 AND expires_ms < deadline_ms AND graces < $2";
    query(sql).bind(conn.now_ms).bind(rules::MAX_GRACES).run(conn).await
}

/// Holds the results of a bake back, or does so no more.
pub(super) async fn pause(conn: &mut Conn, bake: i64, is_paused: bool) -> Result<()> {
    let sql = "UPDATE reruns SET is_paused = $2 WHERE bake = $1";
    query(sql).bind(bake).bind(i64::from(is_paused)).run(conn).await?;
    Ok(())
}

/// Whether [`reap`] has something to do.
pub(super) async fn is_any_due(conn: &mut Conn) -> Result<bool> {
    let sql = "SELECT 1 FROM reruns WHERE token IS NULL AND until_ms > 0 AND until_ms <= $1
               UNION ALL SELECT 1 FROM reruns WHERE token IS NULL AND until_ms > 0 AND until_ms > $1 + $2
               UNION ALL SELECT 1 FROM reruns WHERE token IS NOT NULL
               AND (expires_ms <= $1 OR expires_ms > $1 + ttl_ms OR started_ms > $1) LIMIT 1";
    Ok(query(sql).bind(conn.now_ms).bind(RERUN_LAPSES_MS).optional(conn).await?.is_some())
}

/// Ends attempts whose leases ran out, and gives up what waited too long; returns how many leases ran out. Times of a clock that was set
/// back since begin now.
pub(super) async fn reap(conn: &mut Conn) -> Result<u64> {
    let shift = steps([
        "UPDATE reruns SET until_ms = $1 + $2 WHERE token IS NULL AND until_ms > 0 AND until_ms > $1 + $2",
        "UPDATE reruns SET started_ms = $1, deadline_ms = $1 + (deadline_ms - started_ms)
         WHERE token IS NOT NULL AND started_ms > $1",
        "UPDATE reruns SET expires_ms = CASE WHEN deadline_ms < $1 + ttl_ms THEN deadline_ms ELSE $1 + ttl_ms END
         WHERE token IS NOT NULL AND expires_ms > $1 + ttl_ms",
    ]);
    shift.bind(conn.now_ms).bind(RERUN_LAPSES_MS).run(conn).await?;
    let mut expired = 0;
    for sql in [
        "DELETE FROM reruns WHERE token IS NOT NULL AND expires_ms <= $1 AND tries + 1 >= $2",
        "UPDATE reruns SET token = NULL, worker = NULL, tries = tries + 1
         WHERE token IS NOT NULL AND expires_ms <= $1 AND tries + 1 < $2",
    ] {
        expired += query(sql).bind(conn.now_ms).bind(RERUN_TRIES).run(conn).await?;
    }
    let sql = "DELETE FROM reruns WHERE token IS NULL AND until_ms > 0 AND until_ms <= $1";
    query(sql).bind(conn.now_ms).run(conn).await?;
    Ok(expired)
}

/// Results that were compared, that wait, and that were given up.
pub(super) async fn counts(conn: &mut Conn) -> Result<[u64; 3]> {
    let sql = "SELECT verified, (SELECT count(*) FROM reruns) AS waiting, reruns_over - verified AS lapsed FROM farm_totals";
    let row = query(sql).one(conn).await?;
    Ok([row.count("verified")?, row.count("waiting")?, row.count("lapsed")?])
}
