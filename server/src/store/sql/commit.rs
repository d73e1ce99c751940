//! Results of many attempts at once, beside other changes of the farm: with the locks of their bakes alone.
//!
//! Here come the commits that need no more: a lease that is good, of a task that is done for the first time. All others (a
//! lease that is gone, a token that commits again, a result that is made anew, a plan that names tasks of the farm) are
//! left to [`outcome`], alone on the farm. [`postgres`](super::postgres) says why the locks suffice.

use std::collections::{BTreeMap, BTreeSet};

use lightkiln_proto::api::CommitVerdict;
use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::TaskResult;
use serde_json::{Value, json};

use super::batch::{Fate, Waiting};
use super::codec::to_json;
use super::conn::{Conn, Row, query, together};
use super::ledger::Ledger;
use super::outcome::{self, task_done};
use super::patience::Locked;
use super::reruns::Made;
use super::{chunks, ready, reruns};
use crate::store::rules::{add_counters, named_artefacts};
use crate::store::{PlanError, Result};

/// Leases that are good, of tasks that are done for the first time; both rows are locked until the transaction ends. Whether a
/// result is made again, whom it is given back to and which late results it is compared with changes in changes of the farm
/// alone. Bakes are looked up one by one: a join may begin with all bakes of the farm.
macro_rules! good_leases {
    ($bakes:expr, $tokens:expr, $end:expr) => {
        concat!(
            "SELECT l.token, l.task, l.worker, l.started_ms, l.attempt, t.key, t.kind, t.label, t.cost,
             (SELECT ",
            $bakes,
            " FROM bake_tasks m WHERE m.task = t.id
              AND (SELECT b.state FROM bakes b WHERE b.seq = m.bake) IN ('running', 'paused')) AS bakes
             FROM leases l JOIN tasks t ON t.id = l.task WHERE l.token ",
            $tokens,
            " AND l.expires_ms > $2 AND t.outputs_before IS NULL
             AND NOT EXISTS (SELECT 1 FROM witnesses w WHERE w.task = t.id)
             AND NOT EXISTS (SELECT 1 FROM lost_results x WHERE x.key = t.key) ORDER BY l.token ",
            $end
        )
    };
}

macro_rules! of_list {
    () => {
        "= ANY (ARRAY(SELECT value FROM json_each($1)))"
    };
}

/// Counts a dependency less for each dependant of some tasks.
macro_rules! unlock {
    ($needed:literal) => {
        concat!(
            "UPDATE tasks SET waiting_count = waiting_count - n.met,
             state = CASE WHEN state = 'waiting' AND waiting_count = n.met THEN 'ready' ELSE state END
             FROM (SELECT task, count(*) AS met FROM task_needs WHERE ",
            $needed,
            " GROUP BY task) AS n
             WHERE tasks.id = n.task AND state <> 'done' RETURNING id, state = 'ready' AS is_ready"
        )
    };
}

/// An attempt whose result is taken in.
struct Done<'a> {
    token: String,
    result: &'a TaskResult,
    task: i64,
    key: TaskKey,
    kind: String,
    label: String,
    cost: u64,
    worker: String,
    attempt: u32,
    elapsed_ms: u64,
    /// Live bakes that hold the task.
    bakes: Vec<i64>,
}

impl Done<'_> {
    /// Its row among the results to be verified, if one of its bakes chooses it.
    fn chosen(&self, bakes: &[Ledger]) -> Option<Value> {
        let Self { task, key, kind, worker, .. } = self;
        let made = Made { task: *task, key: *key, kind, worker };
        made.chosen(bakes.iter().filter(|bake| self.bakes.contains(&bake.seq)))
    }
}

/// Commits those of a batch that need no more than the locks of their bakes.
pub(super) async fn commit_all(conn: &mut Conn, batch: &[Waiting], locked: Locked) -> Result<Vec<Fate>> {
    // The same token twice in a batch commits the first time; the second is told so by the general way, which compares the results.
    let mut results: BTreeMap<&str, &TaskResult> = BTreeMap::new();
    for waiting in batch {
        results.entry(&waiting.token).or_insert(&waiting.result);
    }
    let (mut done, mut held) = take(conn, &results, locked).await?;
    done.sort_by_key(|done| batch.iter().position(|waiting| waiting.token == done.token));
    // Lock all bakes before anything of them is read: what one of them is told depends on what it was told before.
    let wanted = done.iter().flat_map(|done| &done.bakes).copied().collect();
    let mut bakes = Ledger::lock(conn, &wanted, locked).await?;
    // A bake that holds a task which is not done is live: one that is missing is somebody else's.
    let has = |bake: &i64| bakes.iter().any(|locked| locked.seq == *bake);
    for done in &done {
        if let Some(bake) = done.bakes.iter().find(|bake| !has(bake)) {
            held.insert(done.token.clone(), *bake);
        }
    }
    done.retain(|done| !held.contains_key(&done.token));
    if !done.is_empty() {
        write_results(conn, &done).await?;
        // Unlock dependants in this transaction, so that no crash leaves them waiting for a task that is done.
        unlock_dependants(conn, &done).await?;
        let chosen = done.iter().filter_map(|done| done.chosen(&bakes));
        reruns::add(conn, &chosen.collect::<Vec<_>>()).await?;
        for bake in &mut bakes {
            let of_bake: Vec<&Done<'_>> = done.iter().filter(|done| done.bakes.contains(&bake.seq)).collect();
            if !of_bake.is_empty() {
                count_done(conn, bake, &of_bake).await?;
                bake.save_or_finish(conn).await?;
            }
        }
    }
    let mut committed: BTreeSet<&str> = done.iter().map(|done| done.token.as_str()).collect();
    let fate = |waiting: &Waiting| match held.get(&waiting.token) {
        Some(bake) => Fate::Locked(*bake),
        None if committed.remove(waiting.token.as_str()) => Fate::Verdict(Ok(CommitVerdict::Committed)),
        None => Fate::Alone,
    };
    Ok(batch.iter().map(fate).collect())
}

/// Commits a result with a plan of new tasks; nothing if that takes a change of the farm.
pub(super) async fn commit_planned(
    conn: &mut Conn,
    token: &str,
    result: &TaskResult,
    plan: &Result<(), PlanError>,
) -> Result<Option<CommitVerdict>> {
    if conn.has_neighbours() && plan_names_known(conn, result).await? {
        return Ok(None);
    }
    let (taken, _) = take(conn, &BTreeMap::from([(token, result)]), Locked::AreWaitedFor).await?;
    let Some(done) = taken.first() else { return Ok(None) };
    let bakes = done.bakes.iter().copied().collect();
    Ledger::lock(conn, &bakes, Locked::AreWaitedFor).await?;
    if conn.has_neighbours() {
        lock_chunks(conn, result).await?;
    }
    outcome::commit(conn, token, result, plan).await.map(Some)
}

/// Locks the chunks that a result refers to at once, in the order in which all do: outputs and plan are written one after
/// the other.
async fn lock_chunks(conn: &mut Conn, result: &TaskResult) -> Result<()> {
    let named = result.plan.iter().flat_map(named_artefacts);
    let digests: BTreeSet<Digest> = result.outputs.iter().map(|output| output.digest).chain(named).collect();
    let sql = "SELECT 1 FROM chunks WHERE digest IN (SELECT value FROM json_each($1)) ORDER BY digest FOR NO KEY UPDATE";
    query(sql).bind(to_json(&digests)?).all(conn).await?;
    Ok(())
}

async fn plan_names_known(conn: &mut Conn, result: &TaskResult) -> Result<bool> {
    // PostgreSQL reads a list of keys between commas in a fraction of the time that JSON takes, and looks them up in order.
    let keys: Vec<String> = result.plan.iter().map(|task| task.key.to_string()).collect();
    let sql = "SELECT 1 FROM tasks WHERE key = ANY (string_to_array($1, ',')) LIMIT 1";
    Ok(query(sql).bind(keys.join(",")).optional(conn).await?.is_some())
}

/// Finds and locks the good leases among those of some results. With them come those that somebody else has locked, if these are left,
/// each with one of its bakes.
async fn take<'a>(
    conn: &mut Conn,
    results: &BTreeMap<&str, &'a TaskResult>,
    locked: Locked,
) -> Result<(Vec<Done<'a>>, BTreeMap<String, i64>)> {
    let waits = conn.pick(
        good_leases!("json_group_array(m.bake)", "IN (SELECT value FROM json_each($1))", ""),
        good_leases!("CAST(coalesce(json_agg(m.bake), '[]') AS TEXT)", of_list!(), "FOR UPDATE OF l, t"),
    );
    let goes_on = good_leases!(
        "CAST(coalesce(json_agg(m.bake), '[]') AS TEXT)",
        of_list!(),
        "FOR UPDATE OF l, t SKIP LOCKED"
    );
    let leaves = conn.has_neighbours() && locked == Locked::AreLeft;
    let tokens = to_json(&results.keys().collect::<Vec<_>>())?;
    let mut done = Vec::with_capacity(results.len());
    let sql = if leaves { goes_on } else { waits };
    for row in query(sql).bind(&tokens).bind(conn.now_ms).all(conn).await? {
        done.extend(done_from(conn, results, &row)?);
    }
    let mut held = BTreeMap::new();
    if leaves && done.len() < results.len() {
        let sql = good_leases!("CAST(coalesce(json_agg(m.bake), '[]') AS TEXT)", of_list!(), "");
        for row in query(sql).bind(&tokens).bind(conn.now_ms).all(conn).await? {
            let bakes: Vec<i64> = row.json("bakes")?;
            held.insert(row.text("token")?, bakes.first().copied().unwrap_or_default());
        }
        held.retain(|token, _| done.iter().all(|done| done.token != *token));
    }
    Ok((done, held))
}

fn done_from<'a>(
    conn: &Conn,
    results: &BTreeMap<&str, &'a TaskResult>,
    row: &Row,
) -> Result<Option<Done<'a>>> {
    let token = row.text("token")?;
    let Some(result) = results.get(token.as_str()).copied() else { return Ok(None) };
    Ok(Some(Done {
        token,
        result,
        task: row.get("task")?,
        key: row.digest("key")?,
        kind: row.get("kind")?,
        label: row.get("label")?,
        cost: row.count("cost")?,
        worker: row.get("worker")?,
        attempt: row.small("attempt")?,
        elapsed_ms: u64::try_from(conn.now_ms - row.get::<i64>("started_ms")?).unwrap_or(0),
        bakes: row.json("bakes")?,
    }))
}

/// Ends the leases, and writes the results and which chunks they refer to.
async fn write_results(conn: &mut Conn, done: &[Done<'_>]) -> Result<()> {
    let (mut tokens, mut tasks, mut rows) = (Vec::new(), Vec::new(), Vec::new());
    let mut outputs: BTreeSet<(Digest, i64)> = BTreeSet::new();
    for Done { token, result, task, worker, .. } in done {
        tokens.push(token);
        tasks.push(*task);
        let [outputs_json, plan] = [to_json(&result.outputs)?, to_json(&result.plan)?];
        rows.push(json!([task, token, outputs_json, plan, to_json(&result.counters)?, worker]));
        outputs.extend(result.outputs.iter().map(|output| (output.digest, *task)));
    }
    let insert = conn.pick(
        "INSERT INTO results (task, token, outputs, plan, counters, worker)
         SELECT value ->> 0, value ->> 1, value ->> 2, value ->> 3, value ->> 4, value ->> 5 FROM json_each($3)",
        "INSERT INTO results (task, token, outputs, plan, counters, worker)
         SELECT (v ->> 0)::bigint, v ->> 1, v ->> 2, v ->> 3, v ->> 4, v ->> 5 FROM jsonb_array_elements($3::jsonb) AS j (v)",
    );
    together([
        "DELETE FROM leases WHERE token IN (SELECT value FROM json_each($1))",
        "UPDATE tasks SET state = 'done' WHERE id IN (SELECT CAST(value AS BIGINT) FROM json_each($2))",
        insert,
    ])
    .bind(to_json(&tokens)?)
    .bind(to_json(&tasks)?)
    .bind(to_json(&rows)?)
    .run(conn)
    .await?;
    refer(conn, &outputs).await
}

/// Makes results refer to their outputs, which must be kept.
async fn refer(conn: &mut Conn, outputs: &BTreeSet<(Digest, i64)>) -> Result<()> {
    if outputs.is_empty() {
        return Ok(());
    }
    let sql = conn.pick(
        "INSERT INTO result_chunks (task, digest) SELECT value ->> 1, c.digest FROM json_each($1) j
         JOIN chunks c ON c.digest = j.value ->> 0 WHERE c.generation IS NOT NULL",
        "INSERT INTO result_chunks (task, digest) SELECT (v ->> 1)::bigint, c.digest
         FROM jsonb_array_elements($1::jsonb) AS j (v) JOIN chunks c ON c.digest = v ->> 0 WHERE c.generation IS NOT NULL",
    );
    if query(sql).bind(to_json(outputs)?).run(conn).await? < outputs.len() as u64 {
        let digests: BTreeSet<Digest> = outputs.iter().map(|(digest, _)| *digest).collect();
        chunks::require(conn, &digests.into_iter().collect::<Vec<_>>()).await?;
    }
    Ok(())
}

/// Unlocks dependants. They are looked for under the locks of the bakes: a plan that was taken in just before may have brought some.
async fn unlock_dependants(conn: &mut Conn, done: &[Done<'_>]) -> Result<()> {
    let needed: Vec<i64> = done.iter().map(|done| done.task).collect();
    let sql = conn.pick(
        unlock!("needs IN (SELECT CAST(value AS BIGINT) FROM json_each($1))"),
        unlock!("needs = ANY (ARRAY(SELECT CAST(value AS BIGINT) FROM json_each($1)))"),
    );
    let mut freed: Vec<i64> = Vec::new();
    for row in query(sql).bind(to_json(&needed)?).all(conn).await? {
        if row.get("is_ready")? {
            freed.push(row.get("id")?);
        }
    }
    ready::offer_all(conn, &freed).await
}

/// Counts results in a bake, in the order of the batch, and tells it of them.
async fn count_done(conn: &mut Conn, bake: &mut Ledger, done: &[&Done<'_>]) -> Result<()> {
    let mut places = Vec::with_capacity(done.len());
    let mut gains: BTreeMap<&str, (u64, u64)> = BTreeMap::new();
    for done in done {
        places.push((done.task, bake.next_place()));
        let (count, cost) = gains.entry(&done.kind).or_default();
        (*count, *cost) = (*count + 1, *cost + done.cost);
        bake.open_count -= 1;
        bake.tasks_run += 1;
        add_counters(&mut bake.counters, &done.result.counters);
        bake.note_outputs(&done.result.outputs);
        bake.event(task_done(
            (done.key, &done.kind, &done.label),
            (&done.worker, done.attempt, done.elapsed_ms),
            &done.result.note,
        ));
    }
    let gains: Vec<_> = gains.into_iter().map(|(kind, (count, cost))| json!([kind, count, cost])).collect();
    together(conn.pick(
        [
            "UPDATE bake_tasks SET done = 1, place = j.value ->> 1 FROM json_each($2) j
             WHERE bake_tasks.bake = $1 AND bake_tasks.task = j.value ->> 0",
            "UPDATE stages SET done = done + (j.value ->> 1), leased = leased - (j.value ->> 1),
             cost_done = cost_done + (j.value ->> 2), last_commit_ms = $4 FROM json_each($3) j
             WHERE stages.bake = $1 AND stages.kind = j.value ->> 0",
        ],
        [
            "UPDATE bake_tasks SET done = 1, place = (v ->> 1)::bigint FROM jsonb_array_elements($2::jsonb) AS j (v)
             WHERE bake_tasks.bake = $1 AND bake_tasks.task = (v ->> 0)::bigint",
            "UPDATE stages SET done = done + (v ->> 1)::bigint, leased = leased - (v ->> 1)::bigint,
             cost_done = cost_done + (v ->> 2)::bigint, last_commit_ms = $4 FROM jsonb_array_elements($3::jsonb) AS j (v)
             WHERE stages.bake = $1 AND stages.kind = v ->> 0",
        ],
    ))
    .bind(bake.seq)
    .bind(to_json(&places)?)
    .bind(to_json(&gains)?)
    .bind(conn.now_ms)
    .run(conn)
    .await
}
