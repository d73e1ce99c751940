//! What callers see.

use lightkiln_proto::api::{Bake, BakeEvent, BakePage, BakeState, EventPage, StageCount, Worker};
use lightkiln_proto::ids::Digest;
use sqlx::Row;
use sqlx::sqlite::SqliteRow;

use super::Conn;
use super::db::{corrupt, digest, from_column, from_json, to_column};
use super::ledger::{seq_of, state_from};
use crate::store::rules::WORKER_LISTED_MS;
use crate::store::{Stats, StoreError, TaskCount, TaskState};

pub(super) async fn bake(conn: &mut Conn, id: &str) -> Result<Bake, StoreError> {
    let query = sqlx::query("SELECT * FROM bakes WHERE id = ?").bind(id);
    match query.fetch_optional(&mut *conn).await? {
        Some(row) => bake_from(conn, &row).await,
        None => Err(StoreError::NoSuchBake { bake: id.to_owned() }),
    }
}

async fn bake_from(conn: &mut Conn, row: &SqliteRow) -> Result<Bake, StoreError> {
    let state = state_from(row.try_get("state")?)?;
    let when_done = |column: &str| -> Result<Option<Digest>, StoreError> {
        let text: Option<String> = row.try_get(column)?;
        text.filter(|_| state == BakeState::Done).as_deref().map(digest).transpose()
    };
    Ok(Bake {
        id: row.try_get("id")?,
        name: row.try_get("name")?,
        kind: row.try_get("kind")?,
        scene: digest(row.try_get("scene")?)?,
        settings: from_json(row.try_get("settings")?, "settings")?,
        priority: row.try_get("priority")?,
        state,
        stages: stages(conn, row.try_get("seq")?).await?,
        tasks_run: from_column(row.try_get("tasks_run")?),
        tasks_reused: from_column(row.try_get("tasks_reused")?),
        failure: row.try_get("failure")?,
        manifest: when_done("manifest")?,
        report: when_done("report")?,
        created_ms: row.try_get("created_ms")?,
        finished_ms: row.try_get("finished_ms")?,
        counters: from_json(row.try_get("counters")?, "counters")?,
        counters_reused: from_json(row.try_get("counters_reused")?, "counters_reused")?,
    })
}

async fn stages(conn: &mut Conn, bake: i64) -> Result<Vec<StageCount>, StoreError> {
    let sql = "SELECT *, coalesce(last_commit_ms - first_claim_ms, 0) AS elapsed_ms
               FROM stages WHERE bake = ? ORDER BY position";
    let mut stages = Vec::new();
    for row in sqlx::query(sql).bind(bake).fetch_all(conn).await? {
        let count = |column: &str| -> Result<u64, StoreError> { Ok(from_column(row.try_get(column)?)) };
        stages.push(StageCount {
            kind: row.try_get("kind")?,
            total: count("total")?,
            done: count("done")?,
            reused: count("reused")?,
            leased: count("leased")?,
            cost_total: count("cost_total")?,
            cost_done: count("cost_done")?,
            elapsed_ms: count("elapsed_ms")?,
        });
    }
    Ok(stages)
}

pub(super) async fn list(conn: &mut Conn, after: Option<&str>, limit: u32) -> Result<BakePage, StoreError> {
    let below = match after {
        Some(id) => seq_of(conn, id).await?,
        None => i64::MAX,
    };
    let sql = "SELECT * FROM bakes WHERE seq < ? ORDER BY seq DESC LIMIT ?";
    let query = sqlx::query(sql).bind(below).bind(i64::from(limit) + 1);
    let rows = query.fetch_all(&mut *conn).await?;
    let has_more = rows.len() > limit as usize;
    let mut bakes = Vec::with_capacity(rows.len());
    for row in rows.iter().take(limit as usize) {
        bakes.push(bake_from(conn, row).await?);
    }
    let next = bakes.last().filter(|_| has_more).map(|bake| bake.id.clone());
    Ok(BakePage { bakes, next })
}

pub(super) async fn events_after(
    conn: &mut Conn,
    id: &str,
    after: u64,
    limit: u32,
) -> Result<EventPage, StoreError> {
    let seq = seq_of(conn, id).await?;
    let sql = "SELECT seq, at_ms, event FROM events WHERE bake = ? AND seq > ? ORDER BY seq LIMIT ?";
    let query = sqlx::query(sql).bind(seq).bind(to_column(after)).bind(i64::from(limit));
    let mut events = Vec::new();
    for row in query.fetch_all(&mut *conn).await? {
        events.push(BakeEvent {
            seq: from_column(row.try_get("seq")?),
            at_ms: row.try_get("at_ms")?,
            event: from_json(row.try_get("event")?, "event")?,
        });
    }
    Ok(EventPage { events, bake: bake(conn, id).await? })
}

pub(super) async fn workers(conn: &mut Conn, now_ms: i64) -> Result<Vec<Worker>, StoreError> {
    let sql = "SELECT name, kinds, threads, seen_ms FROM workers WHERE seen_ms > ? ORDER BY name";
    let rows = sqlx::query(sql).bind(now_ms - WORKER_LISTED_MS).fetch_all(&mut *conn).await?;
    let mut workers = Vec::with_capacity(rows.len());
    for row in rows {
        let name: String = row.try_get("name")?;
        let sql =
            "SELECT t.label FROM leases l JOIN tasks t ON t.id = l.task WHERE l.worker = ? ORDER BY t.label";
        let holds = sqlx::query_scalar(sql).bind(&name).fetch_all(&mut *conn).await?;
        let kinds = from_json(row.try_get("kinds")?, "kinds")?;
        let (threads, seen_ms) = (row.try_get("threads")?, row.try_get("seen_ms")?);
        workers.push(Worker { name, kinds, threads, seen_ms, holds });
    }
    Ok(workers)
}

pub(super) async fn stats(conn: &mut Conn) -> Result<Stats, StoreError> {
    let sql = "SELECT kind, state, count(*) AS count FROM tasks GROUP BY kind, state";
    let mut tasks = Vec::new();
    for row in sqlx::query(sql).fetch_all(&mut *conn).await? {
        let state = task_state_from(row.try_get("state")?)?;
        tasks.push(TaskCount {
            kind: row.try_get("kind")?,
            state,
            count: from_column(row.try_get("count")?),
        });
    }
    tasks.sort();
    let sql = "SELECT count(*) AS total, coalesce(sum(state IN ('running', 'paused')), 0) AS live,
               coalesce(sum(tasks_run), 0) AS run, coalesce(sum(tasks_reused), 0) AS reused FROM bakes";
    let row = sqlx::query(sql).fetch_one(conn).await?;
    let sum = |column: &str| -> Result<u64, StoreError> { Ok(from_column(row.try_get(column)?)) };
    Ok(Stats {
        tasks,
        bakes_live: sum("live")?,
        bakes_total: sum("total")?,
        tasks_run: sum("run")?,
        tasks_reused: sum("reused")?,
    })
}

fn task_state_from(name: &str) -> Result<TaskState, StoreError> {
    use TaskState::{Done, Leased, Ready, Waiting};
    let found = [Waiting, Ready, Leased, Done].into_iter().find(|state| state.name() == name);
    found.ok_or_else(|| corrupt("a task's state", format!("'{name}' is no state")))
}
