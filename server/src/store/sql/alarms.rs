//! Results of one task that differ: a task must give the same bytes wherever it runs. Each such result is noted once, counted by every
//! bake that holds the task, and told in its log if it is among the first; the result that was there stays.

use lightkiln_proto::api::EventKind;
use lightkiln_proto::jobs::Artefact;

use super::codec::to_json;
use super::conn::{Conn, query};
use super::ledger::Ledger;
use crate::store::Result;
use crate::store::rules::{self, Difference, MAX_ALARMS_TOLD};

/// Outputs that an attempt gave, or would have given.
pub(super) struct Given<'a> {
    /// Token of the attempt.
    pub(super) token: &'a str,
    /// Worker that made it.
    pub(super) worker: &'a str,
    /// The outputs.
    pub(super) outputs: &'a [Artefact],
}

/// Notes that `given` is not as `kept`, the outputs of the task that count, if so.
pub(super) async fn compare(conn: &mut Conn, task: i64, kept: &[Artefact], given: &Given<'_>) -> Result<()> {
    let Some(difference) = rules::difference(kept, given.outputs) else { return Ok(()) };
    let row = query("SELECT key, kind, label FROM tasks WHERE id = $1").bind(task).one(conn).await?;
    let (key, kind, label) = (row.digest("key")?, row.text("kind")?, row.text("label")?);
    let Difference { name, kept, found } = difference;
    let sql = "INSERT INTO alarms (token, key, kind, worker, output, kept, found, at_ms)
               VALUES ($1, $2, $3, $4, $5, $6, $7, $8) ON CONFLICT DO NOTHING";
    let noted = query(sql)
        .bind(given.token)
        .bind(key.to_string())
        .bind(&kind)
        .bind(given.worker)
        .bind(&name)
        .bind(kept.map(|digest| digest.to_string()))
        .bind(found.map(|digest| digest.to_string()))
        .bind(conn.now_ms)
        .run(conn)
        .await?;
    // Tell it once, however often it is handed in.
    if noted == 0 {
        return Ok(());
    }
    tracing::error!(%key, kind, label, worker = given.worker, output = name, "two results of one task differ");
    let worker = given.worker.to_owned();
    let event = EventKind::ResultDiffers { key, kind, label, worker, output: name, kept, found };
    let sql =
        "UPDATE bakes SET alarms = alarms + 1 WHERE seq IN (SELECT bake FROM bake_tasks WHERE task = $1)";
    query(sql).bind(task).run(conn).await?;
    // A bake whose tasks give other bytes each time is told of the first ones alone.
    let sql = "SELECT m.bake FROM bake_tasks m JOIN bakes b ON b.seq = m.bake WHERE m.task = $1 AND b.alarms <= $2 ORDER BY m.bake";
    for row in query(sql).bind(task).bind(MAX_ALARMS_TOLD).all(conn).await? {
        let mut bake = Ledger::load(conn, row.get("bake")?).await?;
        bake.event(event.clone());
        bake.save(conn).await?;
    }
    Ok(())
}

/// Compares a result that is handed in again with the one that its token gave; false if it gave none.
pub(super) async fn of_replay(conn: &mut Conn, token: &str, outputs: &[Artefact]) -> Result<bool> {
    let read = query("SELECT task, outputs, worker FROM results WHERE token = $1").bind(token);
    let Some(row) = read.optional(conn).await? else { return Ok(false) };
    let (kept, worker): (Vec<Artefact>, String) = (row.json("outputs")?, row.get("worker")?);
    compare(conn, row.get("task")?, &kept, &Given { token, worker: &worker, outputs }).await?;
    Ok(true)
}

/// Compares a result whose lease was gone with the one that counts, or keeps its outputs until there is one.
pub(super) async fn of_stale(conn: &mut Conn, token: &str, outputs: &[Artefact]) -> Result<()> {
    let sql = "SELECT l.task, l.worker FROM leases l WHERE l.token = $1 AND l.task IS NOT NULL
               UNION ALL SELECT e.task, e.worker FROM expired e WHERE e.token = $1";
    let Some(row) = query(sql).bind(token).optional(conn).await? else { return Ok(()) };
    let (task, worker): (i64, String) = (row.get("task")?, row.get("worker")?);
    let done = query("SELECT outputs FROM results WHERE task = $1").bind(task).optional(conn).await?;
    match done {
        Some(done) => {
            let kept: Vec<Artefact> = done.json("outputs")?;
            compare(conn, task, &kept, &Given { token, worker: &worker, outputs }).await
        }
        None => {
            let sql = "INSERT INTO witnesses (token, task, worker, outputs) VALUES ($1, $2, $3, $4)
                       ON CONFLICT DO NOTHING";
            query(sql).bind(token).bind(task).bind(&worker).bind(to_json(outputs)?).run(conn).await?;
            Ok(())
        }
    }
}

/// Compares a result that was taken in just now with those that came too late before.
pub(super) async fn of_witnesses(conn: &mut Conn, task: i64, kept: &[Artefact]) -> Result<()> {
    let sql = "DELETE FROM witnesses WHERE task = $1 RETURNING token, worker, outputs";
    let mut witnesses = Vec::new();
    for row in query(sql).bind(task).all(conn).await? {
        witnesses.push((row.text("worker")?, row.json::<Vec<Artefact>>("outputs")?, row.text("token")?));
    }
    // One order on every store.
    witnesses.sort_by_cached_key(|(worker, outputs, _)| rules::order_of_witness(worker, outputs));
    for (worker, outputs, token) in &witnesses {
        compare(conn, task, kept, &Given { token, worker, outputs }).await?;
    }
    Ok(())
}

/// Results that differed, ever.
pub(super) async fn count(conn: &mut Conn) -> Result<u64> {
    query("SELECT count(*) AS alarms FROM alarms").one(conn).await?.count("alarms")
}
