//! Results that would be reused, and results whose bytes are lost.

use std::collections::BTreeSet;

use lightkiln_proto::api::EventKind;
use lightkiln_proto::ids::TaskKey;
use lightkiln_proto::jobs::{TaskResult, TaskSpec};

use super::codec::{ROWS_PER_STATEMENT, to_json};
use super::conn::{Conn, query, steps};
use super::ledger::Ledger;
use super::{ready, remake};
use crate::store::{KnownResult, Result};

pub(super) async fn reusable(conn: &mut Conn, plan: &[TaskSpec]) -> Result<Vec<KnownResult>> {
    let sql = "SELECT t.key, r.outputs, r.plan FROM json_each($1) j JOIN tasks t ON t.key = j.value
               JOIN results r ON r.task = t.id ORDER BY j.key";
    let mut seen = BTreeSet::new();
    let mut known = Vec::new();
    let mut layer: Vec<TaskKey> = plan.iter().map(|spec| spec.key).collect();
    while !layer.is_empty() {
        layer.retain(|key| seen.insert(*key));
        let mut next = Vec::new();
        for keys in layer.chunks(ROWS_PER_STATEMENT) {
            for row in query(sql).bind(to_json(keys)?).all(conn).await? {
                let (outputs, plan) = (row.json("outputs")?, row.json::<Vec<TaskSpec>>("plan")?);
                next.extend(plan.iter().map(|spec| spec.key));
                let result = TaskResult { outputs, plan, ..TaskResult::default() };
                known.push((row.digest("key")?, result));
            }
        }
        layer = next;
    }
    Ok(KnownResult::all(known))
}

pub(super) async fn forget_all(conn: &mut Conn, keys: &[TaskKey]) -> Result<()> {
    for key in keys {
        forget(conn, *key).await?;
    }
    Ok(())
}

async fn forget(conn: &mut Conn, key: TaskKey) -> Result<()> {
    let sql = "SELECT id, kind, label, cost FROM tasks WHERE key = $1 AND state = 'done'";
    let Some(row) = query(sql).bind(key.to_string()).optional(conn).await? else { return Ok(()) };
    let task: i64 = row.get("id")?;
    take_from_ended(conn, task, key).await?;
    let wanted_by = Ledger::live_of(conn, task).await?;
    if wanted_by.is_empty() {
        query("DELETE FROM tasks WHERE id = $1").bind(task).run(conn).await?;
        return Ok(());
    }
    remake::hold_readers(conn, task).await?;
    undo_result(conn, task).await?;
    let (kind, cost) = (row.text("kind")?, row.count("cost")?);
    for mut bake in wanted_by {
        count_undone(conn, &mut bake, task, &kind, cost).await?;
        let (kind, label) = (kind.clone(), row.text("label")?);
        bake.event(EventKind::ResultLost { key, kind, label });
        bake.save(conn).await?;
    }
    ready::offer(conn, task).await
}

/// Bakes that have ended hold the result no more; whoever runs the task again gives it back ([`give_back`]).
async fn take_from_ended(conn: &mut Conn, task: i64, key: TaskKey) -> Result<()> {
    let sql = "INSERT INTO lost_results (key, bake) SELECT $1, m.bake FROM bake_tasks m JOIN bakes b ON b.seq = m.bake
               WHERE m.task = $2 AND b.state NOT IN ('running', 'paused')";
    query(sql).bind(key.to_string()).bind(task).run(conn).await?;
    let sql =
        "DELETE FROM bake_tasks WHERE task = $1 AND bake IN (SELECT bake FROM lost_results WHERE key = $2)";
    query(sql).bind(task).bind(key.to_string()).run(conn).await?;
    Ok(())
}

/// Bakes that lost the result of a task after their end hold it again.
pub(super) async fn give_back(conn: &mut Conn, task: i64, key: TaskKey) -> Result<()> {
    let sql = "DELETE FROM lost_results WHERE key = $1 RETURNING bake";
    for row in query(sql).bind(key.to_string()).all(conn).await? {
        // It lands anew, behind all others: whoever reads the results of the bake has passed its old place.
        steps([
            "UPDATE bakes SET last_place = last_place + 1 WHERE seq = $1",
            "INSERT INTO bake_tasks (bake, task, done, reused, place)
             SELECT seq, $2, 1, 0, last_place FROM bakes WHERE seq = $1",
        ])
        .bind(row.get::<i64>("bake")?)
        .bind(task)
        .run(conn)
        .await?;
    }
    Ok(())
}

/// Makes the task as if it had never run, and lets its dependants wait for it.
async fn undo_result(conn: &mut Conn, task: i64) -> Result<()> {
    steps([
        "UPDATE tasks SET outputs_before = (SELECT outputs FROM results r WHERE r.task = tasks.id) WHERE id = $1",
        "DELETE FROM results WHERE task = $1",
        "DELETE FROM blames WHERE task = $1",
        "DELETE FROM losses WHERE task = $1",
        "DELETE FROM expired WHERE task = $1",
        "UPDATE tasks SET attempts = 0, losses = 0, pardons = 0, not_before_ms = 0, waiting_count = (
             SELECT count(*) FROM task_needs n JOIN tasks d ON d.id = n.needs
             WHERE n.task = tasks.id AND d.state <> 'done') WHERE id = $1",
        "UPDATE tasks SET state = CASE waiting_count WHEN 0 THEN 'ready' ELSE 'waiting' END WHERE id = $1",
        "DELETE FROM ready WHERE task IN (SELECT task FROM task_needs WHERE needs = $1)",
        "UPDATE tasks SET waiting_count = waiting_count + 1,
         state = CASE state WHEN 'ready' THEN 'waiting' ELSE state END
         WHERE id IN (SELECT task FROM task_needs WHERE needs = $1) AND state <> 'done'",
    ])
    .bind(task)
    .run(conn)
    .await?;
    Ok(())
}

async fn count_undone(conn: &mut Conn, bake: &mut Ledger, task: i64, kind: &str, cost: u64) -> Result<()> {
    let read = query("SELECT reused FROM bake_tasks WHERE bake = $1 AND task = $2");
    let reused: i64 = read.bind(bake.seq).bind(task).one(conn).await?.get("reused")?;
    query("UPDATE bake_tasks SET done = 0, reused = 0, place = NULL WHERE bake = $1 AND task = $2")
        .bind(bake.seq)
        .bind(task)
        .run(conn)
        .await?;
    let sql = "UPDATE stages SET done = done - 1, reused = reused - $1, cost_done = cost_done - $2
               WHERE bake = $3 AND kind = $4";
    query(sql).bind(reused).bind(cost).bind(bake.seq).bind(kind).run(conn).await?;
    query("UPDATE farm_totals SET tasks_reused = tasks_reused + $1").bind(reused).run(conn).await?;
    bake.open_count += 1;
    bake.tasks_reused -= u64::from(reused != 0);
    Ok(())
}
