//! Results that are made again: who waits for them besides those that depend on the task itself.
//!
//! A task may name an artefact that another task of its bakes made. When that result is forgotten, the one that names it
//! waits for the one that makes it, as for any dependency: `task_needs` has a row more until that has been done. Nobody
//! waits for a task that waits for it, or that one of its live bakes does not hold: then it could wait for ever.

use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::Artefact;

use super::codec::to_json;
use super::conn::{Conn, query};
use super::ready;
use crate::store::Result;
use crate::store::rules;

/// Lets tasks that name an output of `task`, whose result is about to be forgotten, wait for it; attempts under way at
/// them and at its dependants have lost an input.
pub(super) async fn hold_readers(conn: &mut Conn, task: i64) -> Result<()> {
    let row = query("SELECT outputs FROM results WHERE task = $1").bind(task).one(conn).await?;
    let outputs: Vec<Artefact> = row.json("outputs")?;
    let digests: Vec<Digest> = outputs.iter().map(|output| output.digest).collect();
    let digests = to_json(&digests)?;
    let sql = "SELECT DISTINCT m.bake FROM bake_tasks m JOIN bakes b ON b.seq = m.bake
               JOIN bake_chunks x ON x.bake = m.bake WHERE m.task = $1 AND b.state IN ('running', 'paused')
               AND x.digest IN (SELECT value FROM json_each($2))";
    let rows = query(sql).bind(task).bind(&digests).all(conn).await?;
    let bakes = rows.iter().map(|row| row.get("bake")).collect::<Result<Vec<i64>, _>>()?;
    if !bakes.is_empty() {
        // A digest is found as text: nothing else in a task's inputs looks like it.
        let sql = "INSERT INTO task_needs (task, needs) SELECT t.id, $1 FROM tasks t
                   WHERE t.id IN (SELECT m.task FROM bake_tasks m
                                  WHERE m.bake IN (SELECT CAST(value AS BIGINT) FROM json_each($2)))
                   AND EXISTS (SELECT 1 FROM json_each($3) d WHERE t.inputs LIKE '%' || d.value || '%')
                   AND NOT EXISTS (SELECT 1 FROM bake_tasks o JOIN bakes b ON b.seq = o.bake
                                   WHERE o.task = t.id AND b.state IN ('running', 'paused')
                                   AND NOT EXISTS (SELECT 1 FROM bake_tasks x WHERE x.bake = o.bake AND x.task = $1))
                   AND t.id NOT IN (
                       WITH RECURSIVE needed (id) AS (
                           SELECT CAST($1 AS BIGINT)
                           UNION SELECT n.needs FROM task_needs n JOIN needed ON n.task = needed.id)
                       SELECT id FROM needed)
                   ON CONFLICT DO NOTHING";
        query(sql).bind(task).bind(to_json(&bakes)?).bind(&digests).run(conn).await?;
    }
    let sql = "UPDATE leases SET input_lost = 1 WHERE task IN (SELECT task FROM task_needs WHERE needs = $1)";
    query(sql).bind(task).run(conn).await?;
    Ok(())
}

/// Lets nobody but its dependants wait for `task`, which has made its outputs again.
pub(super) async fn release_readers(conn: &mut Conn, task: i64, key: TaskKey) -> Result<()> {
    let sql = "DELETE FROM task_needs WHERE needs = $1
               AND task IN (SELECT t.id FROM task_needs n JOIN tasks t ON t.id = n.task
                            WHERE n.needs = $1 AND t.inputs NOT LIKE '%' || $2 || '%')";
    query(sql).bind(task).bind(key.to_string()).run(conn).await?;
    Ok(())
}

/// Outputs that a task gave before its result was forgotten, that it does not give now, and whose bytes nobody has.
pub(super) async fn not_made_again(
    conn: &mut Conn,
    before: &[Artefact],
    now: &[Artefact],
) -> Result<Vec<Artefact>> {
    let mut gone = Vec::new();
    for output in rules::outputs_gone(before, now) {
        let sql = "SELECT 1 FROM chunks WHERE digest = $1 AND generation IS NOT NULL";
        if query(sql).bind(output.digest.to_string()).optional(conn).await?.is_none() {
            gone.push(output.clone());
        }
    }
    Ok(gone)
}

/// The first of `gone` that an open task of the bake names.
pub(super) async fn first_named<'a>(
    conn: &mut Conn,
    bake: i64,
    gone: &'a [Artefact],
) -> Result<Option<&'a Artefact>> {
    let sql = "SELECT 1 FROM bake_tasks m JOIN tasks t ON t.id = m.task
               WHERE m.bake = $1 AND m.done = 0 AND t.inputs LIKE '%' || $2 || '%' LIMIT 1";
    for output in gone {
        if query(sql).bind(bake).bind(output.digest.to_string()).optional(conn).await?.is_some() {
            return Ok(Some(output));
        }
    }
    Ok(None)
}

/// Lets nobody wait for tasks that go with an ended bake: tasks of other bakes may, if these took them in later.
pub(super) async fn let_go(conn: &mut Conn, bake: i64) -> Result<()> {
    let sql = "SELECT n.task, count(*) AS needs FROM bake_tasks m JOIN task_needs n ON n.needs = m.task
               WHERE m.bake = $1 AND m.done = 0
               AND EXISTS (SELECT 1 FROM bake_tasks o JOIN bakes b ON b.seq = o.bake
                           WHERE o.task = n.task AND o.done = 0 AND b.state IN ('running', 'paused'))
               AND NOT EXISTS (SELECT 1 FROM bake_tasks o JOIN bakes b ON b.seq = o.bake
                               WHERE o.task = m.task AND b.state IN ('running', 'paused'))
               GROUP BY n.task";
    for row in query(sql).bind(bake).all(conn).await? {
        let task: i64 = row.get("task")?;
        let sql = "UPDATE tasks SET waiting_count = waiting_count - $1,
                   state = CASE WHEN state = 'waiting' AND waiting_count = $1 THEN 'ready' ELSE state END WHERE id = $2";
        query(sql).bind(row.get::<i64>("needs")?).bind(task).run(conn).await?;
        ready::offer(conn, task).await?;
    }
    Ok(())
}
