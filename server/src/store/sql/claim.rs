//! Handing out ready tasks, a batch at a time.

use std::collections::BTreeMap;

use lightkiln_proto::api::{ClaimRequest, Lease};
use lightkiln_proto::ids::TaskKey;
use lightkiln_proto::jobs::{Artefact, TaskSpec};

use super::codec::to_json;
use super::conn::{Conn, query};
use crate::store::rules::{WORKER_PRESENT_MS, WORKER_SEEN_GRAIN_MS, resolve_inputs};
use crate::store::{StoreError, token};

/// Walks running bakes in claim order and each one's ready tasks in theirs, without sorting. A worker that failed at
/// a task leaves it to others, if one that has not failed at it is present.
const CANDIDATES: &str = "
    SELECT r.task, b.id AS bake
    FROM bakes b INDEXED BY bakes_in_claim_order CROSS JOIN ready r ON r.bake = b.seq
    WHERE b.state = 'running' AND r.not_before_ms <= $1 AND r.kind IN (SELECT value FROM json_each($2))
    AND NOT (
        EXISTS (SELECT 1 FROM blames x WHERE x.task = r.task AND x.worker = $3)
        AND EXISTS (
            SELECT 1 FROM workers w WHERE w.seen_ms > $4
            AND EXISTS (SELECT 1 FROM json_each(w.kinds) WHERE value = r.kind)
            AND NOT EXISTS (SELECT 1 FROM blames y WHERE y.task = r.task AND y.worker = w.name)))
    ORDER BY b.priority DESC, b.seq, r.cost DESC, r.key LIMIT $5";

/// The same, and the tasks' rows are locked; those locked by another claim are left to it. `t.state` is looked at
/// again once the lock is held, so that a task that a claim took just before is not taken twice.
const CANDIDATES_LOCKED: &str = "
    SELECT c.task, b.id AS bake
    FROM bakes b CROSS JOIN LATERAL (
        SELECT r.task, r.cost, r.key
        FROM ready r JOIN tasks t ON t.id = r.task
        WHERE r.bake = b.seq AND t.state = 'ready' AND r.not_before_ms <= $1
        AND r.kind IN (SELECT value FROM json_each($2))
        AND NOT (
            EXISTS (SELECT 1 FROM blames x WHERE x.task = r.task AND x.worker = $3)
            AND EXISTS (
                SELECT 1 FROM workers w WHERE w.seen_ms > $4
                AND EXISTS (SELECT 1 FROM json_each(w.kinds) k WHERE k.value = r.kind)
                AND NOT EXISTS (SELECT 1 FROM blames y WHERE y.task = r.task AND y.worker = w.name)))
        ORDER BY r.cost DESC, r.key LIMIT $5 FOR UPDATE OF t SKIP LOCKED) c
    WHERE b.state = 'running'
    ORDER BY b.priority DESC, b.seq, c.cost DESC, c.key LIMIT $5";

/// A task chosen for a lease.
struct Chosen {
    task: i64,
    bake: String,
    token: String,
}

pub(super) async fn claim(
    conn: &mut Conn,
    request: &ClaimRequest,
    now_ms: i64,
) -> Result<Vec<Lease>, StoreError> {
    see_worker(conn, request, now_ms).await?;
    let mut leases = Vec::new();
    let mut tasks = Vec::new();
    while leases.len() < request.max as usize {
        let chosen = choose(conn, request, request.max as usize - leases.len(), now_ms).await?;
        if chosen.is_empty() {
            break;
        }
        tasks.extend(chosen.iter().map(|chosen| chosen.task));
        leases.extend(lease(conn, chosen, request, now_ms).await?);
    }
    if !tasks.is_empty() {
        count_leased(conn, &to_json(&tasks)?, now_ms).await?;
    }
    Ok(leases)
}

/// Notes the worker, unless that was done a moment ago: an idle worker's polls write nothing.
async fn see_worker(conn: &mut Conn, request: &ClaimRequest, now_ms: i64) -> Result<(), StoreError> {
    let sql = "INSERT INTO workers VALUES ($1, $2, $3, $4) ON CONFLICT (name) DO UPDATE SET
               kinds = excluded.kinds, threads = excluded.threads, seen_ms = excluded.seen_ms
               WHERE workers.kinds <> excluded.kinds OR workers.threads <> excluded.threads
               OR excluded.seen_ms - workers.seen_ms >= $5";
    query(sql)
        .bind(&request.worker)
        .bind(to_json(&request.kinds)?)
        .bind(request.threads)
        .bind(now_ms)
        .bind(WORKER_SEEN_GRAIN_MS)
        .run(conn)
        .await?;
    Ok(())
}

async fn choose(
    conn: &mut Conn,
    request: &ClaimRequest,
    max: usize,
    now_ms: i64,
) -> Result<Vec<Chosen>, StoreError> {
    let rows = query(conn.pick(CANDIDATES, CANDIDATES_LOCKED))
        .bind(now_ms)
        .bind(to_json(&request.kinds)?)
        .bind(&request.worker)
        .bind(now_ms - WORKER_PRESENT_MS)
        .bind(max)
        .all(conn)
        .await?;
    // A task that several bakes want may show up for each of them: the first counts.
    let mut chosen: Vec<Chosen> = Vec::with_capacity(rows.len());
    for row in rows {
        let task = row.get("task")?;
        if !chosen.iter().any(|earlier| earlier.task == task) {
            chosen.push(Chosen { task, bake: row.get("bake")?, token: token::new_token()? });
        }
    }
    Ok(chosen)
}

async fn lease(
    conn: &mut Conn,
    chosen: Vec<Chosen>,
    request: &ClaimRequest,
    now_ms: i64,
) -> Result<Vec<Lease>, StoreError> {
    let ttl_ms = i64::from(request.ttl_secs) * 1000;
    let expires_ms = now_ms + ttl_ms;
    let rows: Vec<(&str, i64)> = chosen.iter().map(|chosen| (chosen.token.as_str(), chosen.task)).collect();
    let sql = conn.pick(
        "INSERT INTO leases SELECT value ->> 0, value ->> 1, $2, $3, $4, 0.0 FROM json_each($1)",
        "INSERT INTO leases SELECT v ->> 0, (v ->> 1)::bigint, $2, $3, $4, 0.0
         FROM jsonb_array_elements($1::jsonb) AS j (v)",
    );
    let insert = query(sql).bind(to_json(&rows)?).bind(&request.worker).bind(ttl_ms).bind(expires_ms);
    insert.run(conn).await?;
    let tasks: Vec<i64> = chosen.iter().map(|chosen| chosen.task).collect();
    let tasks = to_json(&tasks)?;
    let sql = "DELETE FROM ready WHERE task IN (SELECT CAST(value AS BIGINT) FROM json_each($1))";
    query(sql).bind(&tasks).run(conn).await?;
    let mut specs = take_tasks(conn, &tasks).await?;
    let outputs = outputs_of_needs(conn, &tasks).await?;
    let leased = chosen.into_iter().filter_map(|Chosen { task, bake, token }| {
        let task = specs.remove(&task)?;
        let inputs = resolve_inputs(&task, |key| outputs.get(key).cloned().unwrap_or_default());
        Some(Lease { token, bake, task, inputs, expires_ms })
    });
    Ok(leased.collect())
}

/// Marks tasks as leased, and says what they are.
async fn take_tasks(conn: &mut Conn, tasks: &str) -> Result<BTreeMap<i64, TaskSpec>, StoreError> {
    let sql =
        "UPDATE tasks SET state = 'leased' WHERE id IN (SELECT CAST(value AS BIGINT) FROM json_each($1))
               RETURNING id, key, kind, label, params, inputs, cost";
    let mut specs = BTreeMap::new();
    for row in query(sql).bind(tasks).all(conn).await? {
        let spec = TaskSpec {
            key: row.digest("key")?,
            kind: row.get("kind")?,
            label: row.get("label")?,
            params: row.json("params")?,
            inputs: row.json("inputs")?,
            cost: row.count("cost")?,
        };
        specs.insert(row.get("id")?, spec);
    }
    Ok(specs)
}

async fn outputs_of_needs(
    conn: &mut Conn,
    tasks: &str,
) -> Result<BTreeMap<TaskKey, Vec<Artefact>>, StoreError> {
    let sql = "SELECT t.key, r.outputs FROM task_needs n JOIN tasks t ON t.id = n.needs
               JOIN results r ON r.task = t.id WHERE n.task IN (SELECT CAST(value AS BIGINT) FROM json_each($1))";
    let mut outputs = BTreeMap::new();
    for row in query(sql).bind(tasks).all(conn).await? {
        outputs.insert(row.digest("key")?, row.json("outputs")?);
    }
    Ok(outputs)
}

/// Counts new leases in every live bake that holds their tasks.
async fn count_leased(conn: &mut Conn, tasks: &str, now_ms: i64) -> Result<(), StoreError> {
    if conn.has_concurrent_claims() {
        // One order for all claims, or two of them could wait for each other.
        let sql = "SELECT 1 FROM stages WHERE (bake, kind) IN (
                       SELECT m.bake, t.kind FROM bake_tasks m JOIN tasks t ON t.id = m.task
                       WHERE t.id IN (SELECT CAST(value AS BIGINT) FROM json_each($1)))
                   ORDER BY bake, kind FOR UPDATE";
        query(sql).bind(tasks).run(conn).await?;
    }
    let sql = "UPDATE stages SET leased = leased + n.fresh, first_claim_ms = coalesce(first_claim_ms, $2)
               FROM (SELECT m.bake, t.kind, count(*) AS fresh
                     FROM bake_tasks m JOIN tasks t ON t.id = m.task JOIN bakes b ON b.seq = m.bake
                     WHERE t.id IN (SELECT CAST(value AS BIGINT) FROM json_each($1))
                     AND b.state IN ('running', 'paused') GROUP BY m.bake, t.kind) AS n
               WHERE stages.bake = n.bake AND stages.kind = n.kind";
    query(sql).bind(tasks).bind(now_ms).run(conn).await?;
    Ok(())
}
