//! Workers that failed at tasks of a bake.

use lightkiln_proto::api::{BlockedWorker, Blocklist};

use super::conn::{Conn, query};
use super::ledger::seq_of;
use crate::store::Result;
use crate::store::rules::BLOCK_TASKS;

pub(super) async fn show(conn: &mut Conn, id: &str) -> Result<Blocklist> {
    let bake = seq_of(conn, id).await?;
    let sql = "SELECT x.worker, count(*) AS tasks FROM bake_tasks m JOIN blames x ON x.task = m.task
               WHERE m.bake = $1 GROUP BY x.worker";
    let mut workers = Vec::new();
    for row in query(sql).bind(bake).all(conn).await? {
        let tasks = row.count("tasks")?;
        workers.push(BlockedWorker { worker: row.get("worker")?, tasks, is_blocked: tasks >= BLOCK_TASKS });
    }
    workers.sort_by(|a, b| a.worker.cmp(&b.worker));
    Ok(Blocklist { workers })
}

pub(super) async fn clear(conn: &mut Conn, id: &str, worker: Option<&str>) -> Result<Blocklist> {
    let bake = seq_of(conn, id).await?;
    let sql = "DELETE FROM blames WHERE task IN (SELECT task FROM bake_tasks WHERE bake = $1)
               AND ($2 = '' OR worker = $2)";
    query(sql).bind(bake).bind(worker.unwrap_or_default()).run(conn).await?;
    show(conn, id).await
}
