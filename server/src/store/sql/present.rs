//! Workers that are present: the one that claims is noted, the others may be left tasks.

use lightkiln_proto::api::ClaimRequest;
use lightkiln_proto::ids::Digest;

use super::codec::to_json;
use super::conn::{Conn, query};
use crate::store::Result;
use crate::store::rules::{Abilities, WORKER_PRESENT_MS, WORKER_SEEN_GRAIN_MS};

/// Another worker that is present.
pub(super) struct Other {
    pub(super) name: String,
    pub(super) abilities: Abilities,
}

/// Facts about the worker that claims.
pub(super) struct Seen {
    /// The scene of the task that it was given last.
    pub(super) scene: Option<Digest>,
    /// It failed at a task that is still there.
    pub(super) has_failed: bool,
    /// Results wait to be made once more.
    pub(super) has_reruns: bool,
}

/// Looks the worker up and notes it, unless that was done a moment ago: an idle worker's polls write nothing.
pub(super) async fn see_worker(conn: &mut Conn, request: &ClaimRequest) -> Result<Seen> {
    let (kinds, labels) = (to_json(&request.kinds)?, to_json(&request.labels)?);
    let sql = "SELECT w.scene, EXISTS (SELECT 1 FROM blames x WHERE x.worker = n.name) AS has_failed,
               EXISTS (SELECT 1 FROM reruns r WHERE r.token IS NULL AND r.is_paused = 0 AND r.source > '') AS has_reruns,
               coalesce(w.kinds = $2 AND w.labels = $3 AND w.threads = $4 AND w.memory_mib = $5 AND w.machine = $8
                        AND $6 - w.seen_ms < $7, false) AS is_noted
               FROM (SELECT CAST($1 AS TEXT) AS name) n LEFT JOIN workers w ON w.name = n.name";
    let row = query(sql)
        .bind(&request.worker)
        .bind(&kinds)
        .bind(&labels)
        .bind(request.threads)
        .bind(request.memory_mib)
        .bind(conn.now_ms)
        .bind(WORKER_SEEN_GRAIN_MS)
        .bind(&request.machine)
        .one(conn)
        .await?;
    let (has_failed, has_reruns) = (row.get("has_failed")?, row.get("has_reruns")?);
    let seen = Seen { scene: row.digest_if_any("scene")?, has_failed, has_reruns };
    if row.get("is_noted")? {
        return Ok(seen);
    }
    let sql = "INSERT INTO workers (name, kinds, threads, seen_ms, memory_mib, labels, machine)
               VALUES ($1, $2, $3, $4, $5, $6, $7) ON CONFLICT (name) DO UPDATE SET
               kinds = excluded.kinds, threads = excluded.threads,
               seen_ms = CASE WHEN excluded.seen_ms > workers.seen_ms THEN excluded.seen_ms ELSE workers.seen_ms END,
               memory_mib = excluded.memory_mib, labels = excluded.labels, machine = excluded.machine";
    query(sql)
        .bind(&request.worker)
        .bind(&kinds)
        .bind(request.threads)
        .bind(conn.now_ms)
        .bind(request.memory_mib)
        .bind(&labels)
        .bind(&request.machine)
        .run(conn)
        .await?;
    Ok(seen)
}

/// Other workers that are present.
pub(super) async fn others(conn: &mut Conn, request: &ClaimRequest) -> Result<Vec<Other>> {
    let sql =
        "SELECT name, kinds, threads, memory_mib, labels FROM workers WHERE seen_ms > $1 AND name <> $2";
    let rows = query(sql).bind(conn.now_ms - WORKER_PRESENT_MS).bind(&request.worker).all(conn).await?;
    let mut others = Vec::with_capacity(rows.len());
    for row in rows {
        let abilities = Abilities {
            kinds: row.json("kinds")?,
            threads: row.small("threads")?,
            memory_mib: row.small("memory_mib")?,
            labels: row.json("labels")?,
        };
        others.push(Other { name: row.get("name")?, abilities });
    }
    Ok(others)
}
