//! Views of the farm for callers.

use std::collections::BTreeMap;

use lightkiln_proto::api::{
    Bake, BakeEvent, BakeLimits, BakeResult, BakeState, EventPage, Needs, ResultPage, StageCount, Worker,
};
use lightkiln_proto::ids::Digest;

use super::alarms;
use super::conn::{Conn, Row, corrupt, query};
use super::ledger::{seq_of, state_from};
use super::reruns;
use crate::store::limits;
use crate::store::rules::{WORKER_LISTED_MS, results_on_page};
use crate::store::{Demand, Result, Stats, StoreError, TaskCount, TaskState};

/// Rows of bakes, with the number of results that each lost.
macro_rules! bakes {
    () => {
        "SELECT seq, id, name, kind, scene, settings, priority, needs, state, tasks_run, tasks_reused, attempts_failed,
         attempts_lost, alarms, owner, failure, manifest, report, evaluation, created_ms, finished_ms, counters, counters_reused,
         max_workers, max_attempts, max_lost, verify_share,
         (SELECT count(*) FROM lost_results l WHERE l.bake = bakes.seq) AS results_lost FROM bakes"
    };
}
pub(super) use bakes;

/// Results of a bake behind a place, of one kind of task if that is named.
macro_rules! results {
    ($columns:literal, $end:literal) => {
        concat!(
            "SELECT ",
            $columns,
            " FROM bake_tasks m JOIN tasks t ON t.id = m.task JOIN results r ON r.task = t.id
              WHERE m.bake = $1 AND m.place > $2 AND ($3 = '' OR t.kind = $3) ",
            $end
        )
    };
}

pub(super) async fn bake(conn: &mut Conn, id: &str) -> Result<Bake> {
    match query(concat!(bakes!(), " WHERE id = $1")).bind(id).optional(conn).await? {
        Some(row) => bake_from(conn, &row).await,
        None => Err(StoreError::NoSuchBake { bake: id.to_owned() }),
    }
}

pub(super) async fn bake_from(conn: &mut Conn, row: &Row) -> Result<Bake> {
    let state = state_from(&row.text("state")?)?;
    let when_done = |column: &str| -> Result<Option<Digest>> {
        Ok(row.digest_if_any(column)?.filter(|_| state == BakeState::Done))
    };
    Ok(Bake {
        id: row.get("id")?,
        name: row.get("name")?,
        kind: row.get("kind")?,
        scene: row.digest("scene")?,
        settings: row.json("settings")?,
        priority: i32::try_from(row.get::<i64>("priority")?).unwrap_or_default(),
        needs: row.json("needs")?,
        limits: limits_from(row)?,
        verify_share: row.get("verify_share")?,
        state,
        stages: stages(conn, row.get("seq")?).await?,
        tasks_run: row.count("tasks_run")?,
        tasks_reused: row.count("tasks_reused")?,
        results_lost: row.count("results_lost")?,
        attempts_failed: row.count("attempts_failed")?,
        attempts_lost: row.count("attempts_lost")?,
        alarms: row.count("alarms")?,
        owner: row.get("owner")?,
        failure: row.get("failure")?,
        manifest: when_done("manifest")?,
        report: when_done("report")?,
        evaluation: row.digest_if_any("evaluation")?,
        created_ms: row.get("created_ms")?,
        finished_ms: row.get("finished_ms")?,
        counters: row.json("counters")?,
        counters_reused: row.json("counters_reused")?,
    })
}

/// Limits as a bake's row has them.
pub(super) fn limits_from(row: &Row) -> Result<BakeLimits> {
    let limit = |column: &str| -> Result<Option<u32>> {
        Ok(row.get::<Option<i64>>(column)?.and_then(|limit| u32::try_from(limit).ok()))
    };
    Ok(BakeLimits {
        max_workers: limit("max_workers")?,
        attempts: limit("max_attempts")?,
        lost_workers: limit("max_lost")?,
    })
}

async fn stages(conn: &mut Conn, bake: i64) -> Result<Vec<StageCount>> {
    let sql = "SELECT kind, total, done, reused, leased, cost_total, cost_done,
               coalesce(last_commit_ms - first_claim_ms, 0) AS elapsed_ms
               FROM stages WHERE bake = $1 ORDER BY position";
    let mut stages = Vec::new();
    for row in query(sql).bind(bake).all(conn).await? {
        stages.push(StageCount {
            kind: row.get("kind")?,
            total: row.count("total")?,
            done: row.count("done")?,
            reused: row.count("reused")?,
            leased: row.count("leased")?,
            cost_total: row.count("cost_total")?,
            cost_done: row.count("cost_done")?,
            elapsed_ms: row.count("elapsed_ms")?,
        });
    }
    Ok(stages)
}

pub(super) async fn events_after(conn: &mut Conn, id: &str, after: u64, limit: u32) -> Result<EventPage> {
    let seq = seq_of(conn, id).await?;
    let sql = "SELECT seq, at_ms, event FROM events WHERE bake = $1 AND seq > $2 ORDER BY seq LIMIT $3";
    let rows = query(sql).bind(seq).bind(after).bind(limit).all(conn).await?;
    let mut events = Vec::new();
    for row in rows {
        events.push(BakeEvent {
            seq: row.count("seq")?,
            at_ms: row.get("at_ms")?,
            event: row.json("event")?,
        });
    }
    Ok(EventPage { events, bake: bake(conn, id).await? })
}

pub(super) async fn results_after(
    conn: &mut Conn,
    id: &str,
    kind: Option<&str>,
    after: u64,
    limit: u32,
) -> Result<ResultPage> {
    let bake_row = query("SELECT seq, last_place FROM bakes WHERE id = $1").bind(id).optional(conn).await?;
    let bake_row = bake_row.ok_or_else(|| StoreError::NoSuchBake { bake: id.to_owned() })?;
    let (seq, last_place) = (bake_row.get::<i64>("seq")?, bake_row.count("last_place")?);
    // Find where the page ends before any outputs are read: they may be long.
    let sql =
        results!("m.place, CAST(octet_length(r.outputs) AS BIGINT) AS bytes", "ORDER BY m.place LIMIT $4");
    let rows = query(sql).bind(seq).bind(after).bind(kind.unwrap_or_default()).bind(limit).all(conn).await?;
    let bytes = rows.iter().map(|row| row.count("bytes")).collect::<Result<Vec<u64>>>()?;
    let on_page = results_on_page(bytes);
    let last = on_page.checked_sub(1).map(|last| rows[last].count("place")).transpose()?;
    let is_full = on_page < rows.len() || on_page == limit as usize;
    let next_after = last.filter(|_| is_full).unwrap_or(last_place).max(after);
    let mut results = Vec::new();
    if let Some(last) = last {
        let sql =
            results!("m.place, t.key, t.kind, t.label, r.outputs", "AND m.place <= $4 ORDER BY m.place");
        let sql = query(sql).bind(seq).bind(after).bind(kind.unwrap_or_default()).bind(last);
        for row in sql.all(conn).await? {
            results.push(BakeResult {
                place: row.count("place")?,
                key: row.digest("key")?,
                kind: row.get("kind")?,
                label: row.get("label")?,
                outputs: row.json("outputs")?,
            });
        }
    }
    Ok(ResultPage { results, next_after, bake: bake(conn, id).await? })
}

pub(super) async fn workers(conn: &mut Conn) -> Result<Vec<Worker>> {
    let sql = "SELECT name, kinds, threads, seen_ms, memory_mib, labels FROM workers WHERE seen_ms > $1 ORDER BY name";
    let rows = query(sql).bind(conn.now_ms - WORKER_LISTED_MS).all(conn).await?;
    let sql = "SELECT l.worker, t.label FROM leases l JOIN tasks t ON t.id = l.task
               UNION ALL SELECT r.worker, t.label FROM reruns r JOIN tasks t ON t.id = r.task WHERE r.token IS NOT NULL ORDER BY label";
    let mut held: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for row in query(sql).all(conn).await? {
        held.entry(row.get("worker")?).or_default().push(row.get("label")?);
    }
    let mut workers = Vec::with_capacity(rows.len());
    for row in rows {
        let name: String = row.get("name")?;
        let holds = held.remove(&name).unwrap_or_default();
        let kinds = row.json("kinds")?;
        let threads = row.small("threads")?;
        let memory_mib = row.small("memory_mib")?;
        let labels = row.json("labels")?;
        let seen_ms = row.get("seen_ms")?;
        workers.push(Worker { name, kinds, threads, memory_mib, labels, seen_ms, holds });
    }
    Ok(workers)
}

pub(super) async fn stats(conn: &mut Conn) -> Result<Stats> {
    let sql = conn.pick(
        "SELECT kind, state, count FROM task_counts WHERE count <> 0",
        "SELECT kind, state, CAST(sum(count) AS BIGINT) AS count FROM task_counts
         GROUP BY kind, state HAVING sum(count) <> 0",
    );
    let mut tasks = Vec::new();
    for row in query(sql).all(conn).await? {
        let state = task_state_from(&row.text("state")?)?;
        tasks.push(TaskCount { kind: row.get("kind")?, state, count: row.count("count")? });
    }
    tasks.sort();
    let demand = demand(conn).await?;
    let sql = "SELECT count(*) AS total, count(*) FILTER (WHERE state IN ('running', 'paused')) AS live,
               CAST(coalesce(sum(tasks_run), 0) AS BIGINT) + (SELECT tasks_run FROM farm_totals) AS run,
               CAST(coalesce(sum(tasks_reused), 0) AS BIGINT) + (SELECT tasks_reused FROM farm_totals) AS reused
               FROM bakes";
    let row = query(sql).one(conn).await?;
    let [verified, reruns_waiting, reruns_lapsed] = reruns::counts(conn).await?;
    Ok(Stats {
        tasks,
        demand,
        bakes_live: row.count("live")?,
        bakes_total: row.count("total")?,
        tasks_run: row.count("run")?,
        tasks_reused: row.count("reused")?,
        alarms: alarms::count(conn).await?,
        verified,
        reruns_waiting,
        reruns_lapsed,
    })
}

/// Ready tasks of running bakes by kind and needs; those of a bake with a limit of workers (`limited`, else 0) apart.
macro_rules! ready_by_needs {
    ($ready:literal, $oldest:literal, $counts:literal) => {
        concat!(
            "SELECT c.kind, b.needs, CASE WHEN b.max_workers IS NULL THEN 0 ELSE b.seq END AS limited,
             max(b.max_workers) AS max_workers,
             max(CASE WHEN b.max_workers IS NULL THEN 0
                      ELSE (SELECT count(DISTINCT l.worker) FROM leases l WHERE l.bake = b.seq) END) AS holders, ",
            $ready,
            " AS ready, min((",
            $oldest,
            ")) AS oldest_ms FROM ",
            $counts,
            " c JOIN bakes b ON b.seq = c.bake WHERE b.state = 'running'
             GROUP BY c.kind, b.needs, CASE WHEN b.max_workers IS NULL THEN 0 ELSE b.seq END"
        )
    };
}

async fn demand(conn: &mut Conn) -> Result<Vec<Demand>> {
    let sql = conn.pick(
        ready_by_needs!(
            "sum(c.count)",
            "SELECT max(r.not_before_ms, r.since_ms) FROM ready r INDEXED BY ready_by_age WHERE r.bake = c.bake AND r.kind = c.kind
             ORDER BY max(r.not_before_ms, r.since_ms) LIMIT 1",
            "ready_counts"
        ),
        ready_by_needs!(
            "CAST(sum(c.count) AS BIGINT)",
            "SELECT greatest(r.not_before_ms, r.since_ms) FROM ready r WHERE r.bake = c.bake AND r.kind = c.kind
             ORDER BY greatest(r.not_before_ms, r.since_ms) LIMIT 1",
            "(SELECT bake, kind, sum(count) AS count FROM ready_counts GROUP BY bake, kind HAVING sum(count) > 0)"
        ),
    );
    // By bake with a limit, in the order of kinds: these share its places.
    let mut asked: BTreeMap<(i64, String, String), (Option<u64>, Demand)> = BTreeMap::new();
    for row in query(sql).all(conn).await? {
        // Counts that say otherwise than the rows, as after a repair by hand, take no page down.
        let Some(oldest_ms) = row.get::<Option<i64>>("oldest_ms")? else { continue };
        let max_workers = row.get::<Option<i64>>("max_workers")?.and_then(|most| u32::try_from(most).ok());
        let others = limits::room_for_workers(max_workers, row.count("holders")?);
        let waited_ms = u64::try_from(conn.now_ms - oldest_ms).unwrap_or(0);
        let (kind, needs, ready): (String, Needs, u64) =
            (row.get("kind")?, row.json("needs")?, row.count("ready")?);
        let place = (row.get("limited")?, kind.clone(), serde_json::json!(needs).to_string());
        asked.insert(place, (others, Demand { kind, needs, ready, waited_ms }));
    }
    Ok(together(asked))
}

/// Adds what bakes with a limit ask for, within their places, to the demand of those without one.
fn together(asked: BTreeMap<(i64, String, String), (Option<u64>, Demand)>) -> Vec<Demand> {
    let mut left: BTreeMap<i64, Option<u64>> = BTreeMap::new();
    let mut demand: BTreeMap<(String, String), Demand> = BTreeMap::new();
    for ((limited, kind, needs), (others, asked)) in asked {
        let ready = limits::take_room(left.entry(limited).or_insert(others), asked.ready);
        if ready > 0 {
            let waited_ms = asked.waited_ms;
            let entry = demand.entry((kind, needs)).or_insert(Demand { ready: 0, ..asked });
            entry.ready += ready;
            entry.waited_ms = entry.waited_ms.max(waited_ms);
        }
    }
    demand.into_values().collect()
}

/// Puts the parts of counts together that sessions left.
pub(super) async fn gather_counts(conn: &mut Conn) -> Result<()> {
    // SQLite's have no parts.
    if conn.pick(true, false) {
        return Ok(());
    }
    for sql in [
        "WITH gone AS (DELETE FROM task_counts RETURNING kind, state, count)
         INSERT INTO task_counts (slot, kind, state, count)
         SELECT -1, kind, state, sum(count) FROM gone GROUP BY kind, state HAVING sum(count) <> 0",
        "UPDATE task_counts SET slot = 0",
        "WITH gone AS (DELETE FROM ready_counts RETURNING bake, kind, count)
         INSERT INTO ready_counts (slot, bake, kind, count)
         SELECT -1, bake, kind, sum(count) FROM gone GROUP BY bake, kind HAVING sum(count) <> 0",
        "UPDATE ready_counts SET slot = 0",
    ] {
        query(sql).run(conn).await?;
    }
    Ok(())
}

fn task_state_from(name: &str) -> Result<TaskState> {
    use TaskState::{Done, Leased, Ready, Waiting};
    let found = [Waiting, Ready, Leased, Done].into_iter().find(|state| state.name() == name);
    found.ok_or_else(|| corrupt("a task's state", format!("'{name}' is no state")))
}

/// Writes something.
pub(super) async fn probe(conn: &mut Conn) -> Result<()> {
    let sql =
        "INSERT INTO probe (id, at_ms) VALUES (1, $1) ON CONFLICT (id) DO UPDATE SET at_ms = excluded.at_ms";
    query(sql).bind(conn.now_ms).run(conn).await?;
    Ok(())
}
