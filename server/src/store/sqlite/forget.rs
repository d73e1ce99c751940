//! Results that would be reused, and results whose bytes are lost.

use std::collections::BTreeSet;

use lightkiln_proto::ids::TaskKey;
use lightkiln_proto::jobs::TaskSpec;
use sqlx::Row;

use super::Conn;
use super::db::{ROWS_PER_STATEMENT, digest, from_column, from_json, to_column, to_json};
use super::leases::offer;
use super::ledger::{Ledger, live_bakes_of};
use crate::store::{KnownResult, StoreError};

pub(super) async fn reusable(conn: &mut Conn, plan: &[TaskSpec]) -> Result<Vec<KnownResult>, StoreError> {
    let sql = "SELECT t.key, r.outputs, r.plan FROM json_each(?) j JOIN tasks t ON t.key = j.value
               JOIN results r ON r.task = t.id ORDER BY j.key";
    let mut seen = BTreeSet::new();
    let mut known = Vec::new();
    let mut layer: Vec<TaskKey> = plan.iter().map(|spec| spec.key).collect();
    while !layer.is_empty() {
        layer.retain(|key| seen.insert(*key));
        let mut next = Vec::new();
        for keys in layer.chunks(ROWS_PER_STATEMENT) {
            for row in sqlx::query(sql).bind(to_json(keys)?).fetch_all(&mut *conn).await? {
                let outputs = from_json(row.try_get("outputs")?, "outputs")?;
                known.push(KnownResult { key: digest(row.try_get("key")?)?, outputs });
                let plan: Vec<TaskSpec> = from_json(row.try_get("plan")?, "plan")?;
                next.extend(plan.iter().map(|spec| spec.key));
            }
        }
        layer = next;
    }
    Ok(known)
}

pub(super) async fn forget(conn: &mut Conn, key: TaskKey) -> Result<(), StoreError> {
    let sql = "SELECT id, kind, cost FROM tasks WHERE key = ? AND state = 'done'";
    let query = sqlx::query(sql).bind(key.to_string());
    let Some(row) = query.fetch_optional(&mut *conn).await? else { return Ok(()) };
    let task: i64 = row.try_get("id")?;
    let wanted_by = live_bakes_of(conn, task).await?;
    if wanted_by.is_empty() {
        sqlx::query("DELETE FROM tasks WHERE id = ?").bind(task).execute(conn).await?;
        return Ok(());
    }
    undo_result(conn, task).await?;
    for bake in wanted_by {
        count_undone(conn, bake, task, row.try_get("kind")?, from_column(row.try_get("cost")?)).await?;
    }
    offer(conn, task).await
}

/// Makes the task as if it had never run, and lets its dependants wait for it.
async fn undo_result(conn: &mut Conn, task: i64) -> Result<(), StoreError> {
    for sql in [
        "DELETE FROM results WHERE task = ?",
        "DELETE FROM blames WHERE task = ?",
        "UPDATE tasks SET attempts = 0, not_before_ms = 0, waiting_count = (
             SELECT count(*) FROM task_needs n JOIN tasks d ON d.id = n.needs
             WHERE n.task = tasks.id AND d.state <> 'done') WHERE id = ?",
        "UPDATE tasks SET state = CASE waiting_count WHEN 0 THEN 'ready' ELSE 'waiting' END WHERE id = ?",
        "DELETE FROM ready WHERE task IN (SELECT task FROM task_needs WHERE needs = ?)",
        "UPDATE tasks SET waiting_count = waiting_count + 1,
         state = CASE state WHEN 'ready' THEN 'waiting' ELSE state END
         WHERE id IN (SELECT task FROM task_needs WHERE needs = ?) AND state <> 'done'",
    ] {
        sqlx::query(sql).bind(task).execute(&mut *conn).await?;
    }
    Ok(())
}

async fn count_undone(
    conn: &mut Conn,
    bake: i64,
    task: i64,
    kind: &str,
    cost: u64,
) -> Result<(), StoreError> {
    let mut bake = Ledger::load(conn, bake).await?;
    let query = sqlx::query_scalar("SELECT reused FROM bake_tasks WHERE bake = ? AND task = ?");
    let reused: i64 = query.bind(bake.seq).bind(task).fetch_one(&mut *conn).await?;
    sqlx::query("UPDATE bake_tasks SET done = 0, reused = 0 WHERE bake = ? AND task = ?")
        .bind(bake.seq)
        .bind(task)
        .execute(&mut *conn)
        .await?;
    let sql = "UPDATE stages SET done = done - 1, reused = reused - ?, cost_done = cost_done - ?
               WHERE bake = ? AND kind = ?";
    sqlx::query(sql).bind(reused).bind(to_column(cost)).bind(bake.seq).bind(kind).execute(&mut *conn).await?;
    bake.open_count += 1;
    bake.tasks_reused -= from_column(reused);
    bake.save(conn).await
}
