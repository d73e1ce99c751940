//! Ready tasks in the order of claims: one row for each live bake that holds the task. Its `cost` is that by which it is
//! claimed ([`rules::claim_cost`](crate::store::rules::claim_cost)).

use lightkiln_proto::ids::TaskKey;

use super::codec::{ROWS_PER_STATEMENT, to_json};
use super::conn::{Conn, query};
use crate::store::Result;

/// Offers a task in every live bake that holds it, if it is ready.
pub(super) async fn offer(conn: &mut Conn, task: i64) -> Result<()> {
    let sql = "INSERT INTO ready (bake, cost, key, task, kind, not_before_ms, since_ms)
               SELECT m.bake, coalesce(t.claim_cost, t.cost), t.key, t.id, t.kind, t.not_before_ms, $2
               FROM tasks t JOIN bake_tasks m ON m.task = t.id JOIN bakes b ON b.seq = m.bake
               WHERE t.id = $1 AND t.state = 'ready' AND b.state || '' IN ('running', 'paused')";
    query(sql).bind(task).bind(conn.now_ms).run(conn).await?;
    Ok(())
}

/// Offers the ready dependants of a task that has just been done. None of them was ready before: each waited for it.
pub(super) async fn offer_dependants(conn: &mut Conn, task: i64) -> Result<()> {
    let sql = "INSERT INTO ready (bake, cost, key, task, kind, not_before_ms, since_ms)
               SELECT m.bake, coalesce(t.claim_cost, t.cost), t.key, t.id, t.kind, t.not_before_ms, $2
               FROM task_needs n JOIN tasks t ON t.id = n.task JOIN bake_tasks m ON m.task = t.id
               JOIN bakes b ON b.seq = m.bake WHERE n.needs = $1 AND t.state = 'ready'
               AND b.state || '' IN ('running', 'paused')";
    query(sql).bind(task).bind(conn.now_ms).run(conn).await?;
    Ok(())
}

/// Offers tasks that have just become ready, in every live bake that holds them.
pub(super) async fn offer_all(conn: &mut Conn, tasks: &[i64]) -> Result<()> {
    let sql = conn.pick(
        "INSERT INTO ready (bake, cost, key, task, kind, not_before_ms, since_ms)
         SELECT m.bake, coalesce(t.claim_cost, t.cost), t.key, t.id, t.kind, t.not_before_ms, $2
         FROM json_each($1) j JOIN tasks t ON t.id = CAST(j.value AS BIGINT) JOIN bake_tasks m ON m.task = t.id
         JOIN bakes b ON b.seq = m.bake WHERE b.state || '' IN ('running', 'paused')",
        "INSERT INTO ready (bake, cost, key, task, kind, not_before_ms, since_ms)
         SELECT m.bake, coalesce(t.claim_cost, t.cost), t.key, t.id, t.kind, t.not_before_ms, $2
         FROM tasks t JOIN bake_tasks m ON m.task = t.id
         WHERE t.id = ANY (ARRAY(SELECT CAST(value AS BIGINT) FROM json_each($1)))
         AND (SELECT b.state FROM bakes b WHERE b.seq = m.bake) IN ('running', 'paused')",
    );
    for tasks in tasks.chunks(ROWS_PER_STATEMENT) {
        query(sql).bind(to_json(tasks)?).bind(conn.now_ms).run(conn).await?;
    }
    Ok(())
}

/// Offers those of `tasks` that are ready in one bake, which took them in just now.
pub(super) async fn offer_in(conn: &mut Conn, bake: i64, tasks: &[i64]) -> Result<()> {
    let sql = "INSERT INTO ready (bake, cost, key, task, kind, not_before_ms, since_ms)
               SELECT $1, coalesce(t.claim_cost, t.cost), t.key, t.id, t.kind, t.not_before_ms, $3
               FROM json_each($2) j JOIN tasks t ON t.id = CAST(j.value AS BIGINT) WHERE t.state = 'ready'";
    for tasks in tasks.chunks(ROWS_PER_STATEMENT) {
        query(sql).bind(bake).bind(to_json(tasks)?).bind(conn.now_ms).run(conn).await?;
    }
    Ok(())
}

/// A new task that can be claimed.
pub(super) struct Offer {
    /// Cost by which it is claimed.
    pub(super) cost: u64,
    pub(super) key: TaskKey,
    pub(super) task: i64,
    pub(super) kind: String,
}

/// Offers new tasks in the one bake that holds them.
pub(super) async fn offer_new(conn: &mut Conn, bake: i64, offers: &[Offer]) -> Result<()> {
    let sql = conn.pick(
        "INSERT INTO ready (bake, cost, key, task, kind, not_before_ms, since_ms)
         SELECT $1, value ->> 0, value ->> 1, value ->> 2, value ->> 3, 0, $3 FROM json_each($2)",
        "INSERT INTO ready (bake, cost, key, task, kind, not_before_ms, since_ms)
         SELECT $1, (v ->> 0)::bigint, v ->> 1, (v ->> 2)::bigint, v ->> 3, 0, $3 FROM jsonb_array_elements($2::jsonb) AS j (v)",
    );
    for offers in offers.chunks(ROWS_PER_STATEMENT) {
        let rows: Vec<_> =
            offers.iter().map(|offer| (offer.cost, offer.key, offer.task, &offer.kind)).collect();
        query(sql).bind(bake).bind(to_json(&rows)?).bind(conn.now_ms).run(conn).await?;
    }
    Ok(())
}
