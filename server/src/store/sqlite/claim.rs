//! Handing out ready tasks.

use std::collections::BTreeMap;

use lightkiln_proto::api::{ClaimRequest, Lease};
use lightkiln_proto::ids::TaskKey;
use lightkiln_proto::jobs::{Artefact, TaskSpec};
use sqlx::Row;

use super::Conn;
use super::db::{digest, from_column, from_json, to_json};
use super::leases::change_leased;
use crate::store::rules::{WORKER_PRESENT_MS, WORKER_SEEN_GRAIN_MS, resolve_inputs};
use crate::store::{StoreError, token};

/// Walks running bakes in claim order and each one's ready tasks in theirs, without sorting. A worker that failed at
/// a task leaves it to others, if one that has not failed at it is present.
const CANDIDATES: &str = "
    SELECT r.task, b.id AS bake
    FROM bakes b INDEXED BY bakes_in_claim_order CROSS JOIN ready r ON r.bake = b.seq
    WHERE b.state = 'running' AND r.not_before_ms <= ?1 AND r.kind IN (SELECT value FROM json_each(?2))
    AND NOT (
        EXISTS (SELECT 1 FROM blames x WHERE x.task = r.task AND x.worker = ?3)
        AND EXISTS (
            SELECT 1 FROM workers w WHERE w.seen_ms > ?4
            AND EXISTS (SELECT 1 FROM json_each(w.kinds) WHERE value = r.kind)
            AND NOT EXISTS (SELECT 1 FROM blames y WHERE y.task = r.task AND y.worker = w.name)))
    ORDER BY b.priority DESC, b.seq, r.cost DESC, r.key LIMIT ?5";

pub(super) async fn claim(
    conn: &mut Conn,
    request: &ClaimRequest,
    now_ms: i64,
) -> Result<Vec<Lease>, StoreError> {
    see_worker(conn, request, now_ms).await?;
    let mut leases = Vec::new();
    let kinds = to_json(&request.kinds)?;
    while leases.len() < request.max as usize {
        let query = sqlx::query(CANDIDATES)
            .bind(now_ms)
            .bind(&kinds)
            .bind(&request.worker)
            .bind(now_ms - WORKER_PRESENT_MS)
            .bind(i64::from(request.max) - leases.len() as i64);
        let rows = query.fetch_all(&mut *conn).await?;
        if rows.is_empty() {
            break;
        }
        // A task that several bakes want may show up for each of them: the first counts.
        let mut taken = Vec::new();
        for row in rows {
            let task: i64 = row.try_get("task")?;
            if !taken.contains(&task) {
                taken.push(task);
                leases.push(lease(conn, task, row.try_get("bake")?, request, now_ms).await?);
            }
        }
    }
    Ok(leases)
}

/// Notes the worker, unless that was done a moment ago: an idle worker's polls write nothing.
async fn see_worker(conn: &mut Conn, request: &ClaimRequest, now_ms: i64) -> Result<(), StoreError> {
    let sql = "INSERT INTO workers VALUES (?, ?, ?, ?) ON CONFLICT (name) DO UPDATE SET
               kinds = excluded.kinds, threads = excluded.threads, seen_ms = excluded.seen_ms
               WHERE kinds <> excluded.kinds OR threads <> excluded.threads OR excluded.seen_ms - seen_ms >= ?";
    sqlx::query(sql)
        .bind(&request.worker)
        .bind(to_json(&request.kinds)?)
        .bind(i64::from(request.threads))
        .bind(now_ms)
        .bind(WORKER_SEEN_GRAIN_MS)
        .execute(conn)
        .await?;
    Ok(())
}

async fn lease(
    conn: &mut Conn,
    task: i64,
    bake: String,
    request: &ClaimRequest,
    now_ms: i64,
) -> Result<Lease, StoreError> {
    let token = token::new_token()?;
    let ttl_ms = i64::from(request.ttl_secs) * 1000;
    let expires_ms = now_ms + ttl_ms;
    sqlx::query("INSERT INTO leases VALUES (?, ?, ?, ?, ?, 0.0)")
        .bind(&token)
        .bind(task)
        .bind(&request.worker)
        .bind(ttl_ms)
        .bind(expires_ms)
        .execute(&mut *conn)
        .await?;
    sqlx::query("DELETE FROM ready WHERE task = ?").bind(task).execute(&mut *conn).await?;
    let sql =
        "UPDATE tasks SET state = 'leased' WHERE id = ? RETURNING key, kind, label, params, inputs, cost";
    let row = sqlx::query(sql).bind(task).fetch_one(&mut *conn).await?;
    let spec = TaskSpec {
        key: digest(row.try_get("key")?)?,
        kind: row.try_get("kind")?,
        label: row.try_get("label")?,
        params: from_json(row.try_get("params")?, "params")?,
        inputs: from_json(row.try_get("inputs")?, "inputs")?,
        cost: from_column(row.try_get("cost")?),
    };
    change_leased(conn, task, &spec.kind, 1, now_ms).await?;
    let outputs = outputs_of_needs(conn, task).await?;
    let inputs = resolve_inputs(&spec, |key| outputs.get(key).cloned().unwrap_or_default());
    Ok(Lease { token, bake, task: spec, inputs, expires_ms })
}

async fn outputs_of_needs(
    conn: &mut Conn,
    task: i64,
) -> Result<BTreeMap<TaskKey, Vec<Artefact>>, StoreError> {
    let sql = "SELECT t.key, r.outputs FROM task_needs n JOIN tasks t ON t.id = n.needs
               JOIN results r ON r.task = t.id WHERE n.task = ?";
    let mut outputs = BTreeMap::new();
    for row in sqlx::query(sql).bind(task).fetch_all(conn).await? {
        outputs.insert(digest(row.try_get("key")?)?, from_json(row.try_get("outputs")?, "outputs")?);
    }
    Ok(outputs)
}
