//! Ends of attempts: commit, failure, expiry.

use std::collections::BTreeSet;

use lightkiln_proto::api::{BakeLimits, BakeState, Blame, CommitVerdict, EventKind};
use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::TaskResult;

use super::alarms;
use super::batch::Given;
use super::bulk;
use super::codec::to_json;
use super::conn::{Conn, query, steps};
use super::leases::{self, Ended, requeue};
use super::ledger::Ledger;
use super::plan::apply_plan;
use super::{chunks, forget, ready, remake, reruns, view};
use crate::store::limits;
use crate::store::rules::{self, FarmRules, add_counters};
use crate::store::{FailVerdict, LeaseState, PlanError, Reaped, Result};

/// Commits a result; `plan` says whether its plan is one.
pub(super) async fn commit(
    conn: &mut Conn,
    token: &str,
    result: &TaskResult,
    plan: &Result<(), PlanError>,
) -> Result<CommitVerdict> {
    // Take the lease first: who commits with a token that is not the newest of its task changes nothing else.
    let Some(ended) = leases::end(conn, token).await? else {
        // Answer a commit that is sent again as the first one, whose answer may have been lost.
        if alarms::of_replay(conn, token, &result.outputs).await? {
            return Ok(CommitVerdict::AlreadyCommitted);
        }
        // Compare a result that was made once more.
        if reruns::commit(conn, token, &result.outputs).await? {
            return Ok(CommitVerdict::Committed);
        }
        plan.clone()?;
        // Give the attempt back if the lease ran out under a worker that is alive.
        leases::hear_late(conn, token).await?;
        // Its result counts for nothing, but must be that which does.
        alarms::of_stale(conn, token, &result.outputs).await?;
        return Ok(CommitVerdict::Stale);
    };
    // Refuse a bad plan by an error: it undoes the transaction, so the holder keeps its lease and can report the failure.
    plan.clone()?;
    bulk::take_time(conn, result.plan.len()).await?;
    write_result(conn, token, &ended, result).await?;
    // Unlock dependants in this transaction, so that no crash leaves them waiting for a task that is done.
    if ended.has_dependants {
        unlock_dependants(conn, ended.task).await?;
    }
    // Remove the edges of tasks that only waited for a lost output, after they were unlocked along these.
    if !ended.outputs_before.is_empty() {
        remake::release_readers(conn, ended.task, ended.key).await?;
    }
    // Sound the alarm where another attempt at the task gave other bytes, before or too late.
    if !ended.outputs_before.is_empty() {
        let given = alarms::Given { token, worker: &ended.worker, outputs: &result.outputs };
        alarms::compare(conn, ended.task, &ended.outputs_before, &given).await?;
    }
    if ended.has_witnesses {
        alarms::of_witnesses(conn, ended.task, &result.outputs).await?;
    }
    // Find outputs that came out otherwise than before: tasks that name the former bytes could wait for ever.
    let gone = remake::not_made_again(conn, &ended.outputs_before, &result.outputs).await?;
    // Tell every live bake that holds the task: each has counts, events and a plan of its own.
    let mut made = BTreeSet::new();
    let bakes = Ledger::live_of(conn, ended.task).await?;
    let own = reruns::Made { task: ended.task, key: ended.key, kind: &ended.kind, worker: &ended.worker };
    reruns::add(conn, own.chosen(&bakes).as_slice()).await?;
    for mut bake in bakes {
        count_done(conn, &mut bake, &ended, result).await?;
        // Fail a bake that reads bytes which nobody will make again, instead of letting it wait.
        if let Some(output) = remake::first_named(conn, bake.seq, &gone).await? {
            let failure = rules::made_otherwise_message(&ended.label, &ended.kind, output);
            bake.close(conn, BakeState::Failed, Some(failure)).await?;
            continue;
        }
        // Add the planned tasks before the bake may finish: it is done when none is open.
        apply_plan(conn, &mut bake, &result.plan, &mut made).await?;
        bake.save_or_finish(conn).await?;
    }
    Ok(CommitVerdict::Committed)
}

/// Commits results without plans, one after the other.
pub(super) async fn commit_each(conn: &mut Conn, commits: &[Given<'_>]) -> Result<Vec<CommitVerdict>> {
    let mut verdicts = Vec::with_capacity(commits.len());
    for (token, result) in commits {
        verdicts.push(commit(conn, token, result, &Ok(())).await?);
    }
    Ok(verdicts)
}

async fn write_result(conn: &mut Conn, token: &str, ended: &Ended, result: &TaskResult) -> Result<()> {
    let outputs: BTreeSet<Digest> = result.outputs.iter().map(|output| output.digest).collect();
    let outputs: Vec<Digest> = outputs.into_iter().collect();
    let touched = steps([
        "UPDATE tasks SET state = 'done', outputs_before = NULL WHERE id = $1",
        "INSERT INTO results (task, token, outputs, plan, counters, worker) VALUES ($1, $2, $3, $4, $5, $7)",
        "INSERT INTO result_chunks (task, digest) SELECT $1, c.digest FROM json_each($6) j JOIN chunks c ON c.digest = j.value
         WHERE c.generation IS NOT NULL",
    ])
    .bind(ended.task)
    .bind(token)
    .bind(to_json(&result.outputs)?)
    .bind(to_json(&result.plan)?)
    .bind(to_json(&result.counters)?)
    .bind(to_json(&outputs)?)
    .bind(&ended.worker)
    .run(conn)
    .await?;
    // One row of the task, one of its result, and one for each output that is kept.
    if touched < 2 + outputs.len() as u64 {
        chunks::require(conn, &outputs).await?;
    }
    if ended.is_missed { forget::give_back(conn, ended.task, ended.key).await } else { Ok(()) }
}

async fn unlock_dependants(conn: &mut Conn, task: i64) -> Result<()> {
    let sql = "UPDATE tasks SET waiting_count = waiting_count - 1,
               state = CASE WHEN state = 'waiting' AND waiting_count = 1 THEN 'ready' ELSE state END
               WHERE id IN (SELECT task FROM task_needs WHERE needs = $1) AND state <> 'done'
               RETURNING state = 'ready' AS is_ready";
    let mut is_any_ready = false;
    for row in query(sql).bind(task).all(conn).await? {
        is_any_ready |= row.get::<bool>("is_ready")?;
    }
    if is_any_ready {
        ready::offer_dependants(conn, task).await?;
    }
    Ok(())
}

async fn count_done(conn: &mut Conn, bake: &mut Ledger, ended: &Ended, result: &TaskResult) -> Result<()> {
    steps([
        "UPDATE bake_tasks SET done = 1, place = $6 WHERE bake = $1 AND task = $2",
        "UPDATE stages SET done = done + 1, leased = leased - 1, cost_done = cost_done + $3, last_commit_ms = $4
         WHERE bake = $1 AND kind = $5",
    ])
    .bind(bake.seq)
    .bind(ended.task)
    .bind(ended.cost)
    .bind(conn.now_ms)
    .bind(&ended.kind)
    .bind(bake.next_place())
    .run(conn)
    .await?;
    bake.open_count -= 1;
    bake.tasks_run += 1;
    add_counters(&mut bake.counters, &result.counters);
    bake.note_outputs(&result.outputs);
    let attempt = (ended.worker.as_str(), ended.attempt, ended.elapsed_ms);
    bake.event(task_done((ended.key, &ended.kind, &ended.label), attempt, &result.note));
    Ok(())
}

pub(super) async fn fail(
    conn: &mut Conn,
    token: &str,
    blame: Blame,
    message: &str,
    farm: FarmRules,
) -> Result<FailVerdict> {
    let Some(ended) = leases::end(conn, token).await? else {
        let is_rerun = reruns::fail(conn, token).await?;
        return Ok(if is_rerun { FailVerdict::Rerun } else { FailVerdict::Stale });
    };
    let message = rules::cut_message(message);
    // A worker that lost an input is not to blame, and tries again once that is there.
    let wait_ms = match blame {
        Blame::Task => {
            let failure = rules::task_fault_message(&ended.label, &ended.kind, &ended.worker, &message);
            count_attempt(conn, ended.task, blame).await?;
            give_up(conn, &ended, blame, &message, &failure).await?;
            None
        }
        Blame::Worker if ended.input_lost => Some(0),
        Blame::Worker => blame_worker(conn, &ended, &message).await?,
        // It came with others and was not begun when its worker ended: that tells nothing of the task.
        Blame::Lost if ended.state == LeaseState::Granted => Some(0),
        Blame::Lost => count_loss(conn, &ended, &message, farm).await?,
    };
    let Some(wait_ms) = wait_ms else { return Ok(FailVerdict::GivenUp) };
    requeue(conn, &ended).await?;
    for mut bake in Ledger::live_of(conn, ended.task).await? {
        bake.event(task_failed(&ended, (blame, &message), Some(wait_ms)));
        bake.save(conn).await?;
    }
    Ok(FailVerdict::Retry)
}

/// Remembers a lease that ran out, for a holder that is heard later: whether it counts as a loss until then. Of those that do not, no more
/// than a number: a worker may claim again and again, and begin nothing.
async fn remember(conn: &mut Conn, token: &str, ended: &Ended, counted: bool) -> Result<()> {
    let sql = "INSERT INTO expired (token, task, worker, counted, is_first) SELECT $1, t.id, $2, $4,
               CASE WHEN EXISTS (SELECT 1 FROM losses x WHERE x.task = t.id AND x.worker = $2) THEN 0 ELSE 1 END
               FROM tasks t WHERE t.id = $3 AND ($4 <> 0 OR (SELECT count(*) FROM expired e WHERE e.task = $3) < $5)";
    query(sql)
        .bind(token)
        .bind(&ended.worker)
        .bind(ended.task)
        .bind(i64::from(counted))
        .bind(rules::MAX_EXPIRED)
        .run(conn)
        .await?;
    Ok(())
}

/// Counts a worker that was lost with a task: the wait before it is tried again, or none when it was given up for that.
async fn count_loss(conn: &mut Conn, ended: &Ended, message: &str, farm: FarmRules) -> Result<Option<i64>> {
    let losses = ended.losses + 1;
    query("UPDATE tasks SET losses = $1 WHERE id = $2").bind(losses).bind(ended.task).run(conn).await?;
    query("INSERT INTO losses (task, worker) VALUES ($1, $2) ON CONFLICT DO NOTHING")
        .bind(ended.task)
        .bind(&ended.worker)
        .run(conn)
        .await?;
    count_attempt(conn, ended.task, Blame::Lost).await?;
    if !limits::is_lost_too_often(&limits_of(conn, ended.task).await?, losses, &farm) {
        let wait_ms = rules::lost_wait_ms(ended.key, losses);
        delay(conn, ended.task, wait_ms).await?;
        return Ok(Some(wait_ms));
    }
    let failure = rules::lost_message(&ended.label, &ended.kind, losses, message);
    give_up(conn, ended, Blame::Lost, message, &failure).await?;
    Ok(None)
}

/// Keeps a task from being claimed for a while.
async fn delay(conn: &mut Conn, task: i64, wait_ms: i64) -> Result<()> {
    let sql = "UPDATE tasks SET not_before_ms = $1 WHERE id = $2";
    query(sql).bind(conn.now_ms + wait_ms).bind(task).run(conn).await?;
    Ok(())
}

/// Counts an attempt that failed, or whose worker was lost, in every live bake that holds the task.
async fn count_attempt(conn: &mut Conn, task: i64, blame: Blame) -> Result<()> {
    let sql =
        "UPDATE bakes SET attempts_lost = attempts_lost + $2, attempts_failed = attempts_failed + 1 - $2
               WHERE state IN ('running', 'paused') AND seq IN (SELECT bake FROM bake_tasks WHERE task = $1)";
    query(sql).bind(task).bind(i64::from(blame == Blame::Lost)).run(conn).await?;
    Ok(())
}

/// Counts an attempt against its worker: the wait before the task is tried again, or none when it was given up for that.
async fn blame_worker(conn: &mut Conn, ended: &Ended, message: &str) -> Result<Option<i64>> {
    let attempts = ended.attempts + 1;
    count_attempt(conn, ended.task, Blame::Worker).await?;
    query("UPDATE tasks SET attempts = $1 WHERE id = $2").bind(attempts).bind(ended.task).run(conn).await?;
    query("INSERT INTO blames (task, worker) VALUES ($1, $2) ON CONFLICT DO NOTHING")
        .bind(ended.task)
        .bind(&ended.worker)
        .run(conn)
        .await?;
    let count = query("SELECT count(*) AS workers FROM blames WHERE task = $1").bind(ended.task);
    let workers = count.one(conn).await?.small("workers")?;
    if !limits::is_given_up(&limits_of(conn, ended.task).await?, attempts, workers) {
        let wait_ms = rules::retry_wait_ms(ended.key, attempts);
        delay(conn, ended.task, wait_ms).await?;
        return Ok(Some(wait_ms));
    }
    let failure = rules::given_up_message(&ended.label, &ended.kind, attempts, workers, message);
    give_up(conn, ended, Blame::Worker, message, &failure).await?;
    Ok(None)
}

/// Limits of the live bakes that hold a task.
async fn limits_of(conn: &mut Conn, task: i64) -> Result<Vec<BakeLimits>> {
    let sql =
        "SELECT b.max_workers, b.max_attempts, b.max_lost FROM bake_tasks m JOIN bakes b ON b.seq = m.bake
               WHERE m.task = $1 AND b.state || '' IN ('running', 'paused')";
    query(sql).bind(task).all(conn).await?.iter().map(view::limits_from).collect()
}

/// Fails every bake that wants the task.
async fn give_up(conn: &mut Conn, ended: &Ended, blame: Blame, message: &str, failure: &str) -> Result<()> {
    for mut bake in Ledger::live_of(conn, ended.task).await? {
        bake.event(task_failed(ended, (blame, message), None));
        bake.close(conn, BakeState::Failed, Some(failure.to_owned())).await?;
    }
    Ok(())
}

/// A result of a task (its key, kind and label), by an attempt (its worker, number and duration).
pub(super) fn task_done(
    (key, kind, label): (TaskKey, &str, &str),
    (worker, attempt, elapsed_ms): (&str, u32, u64),
    note: &str,
) -> EventKind {
    let [kind, label, worker, note] = [kind, label, worker, note].map(str::to_owned);
    EventKind::TaskDone { key, kind, label, worker, attempt, elapsed_ms, note }
}

/// A failure; `wait_ms` is the wait before the next try, if there is one.
fn task_failed(ended: &Ended, (blame, message): (Blame, &str), wait_ms: Option<i64>) -> EventKind {
    EventKind::TaskFailed {
        key: ended.key,
        kind: ended.kind.clone(),
        label: ended.label.clone(),
        worker: ended.worker.clone(),
        message: message.to_owned(),
        retry: wait_ms.is_some(),
        blame,
        attempt: ended.attempt,
        elapsed_ms: ended.elapsed_ms,
        wait_ms: wait_ms.and_then(|wait_ms| u64::try_from(wait_ms).ok()).unwrap_or(0),
    }
}

fn lease_expired(ended: &Ended) -> EventKind {
    EventKind::LeaseExpired {
        key: ended.key,
        kind: ended.kind.clone(),
        label: ended.label.clone(),
        worker: ended.worker.clone(),
        attempt: ended.attempt,
        elapsed_ms: ended.elapsed_ms,
        took_too_long: ended.has_hit_limit,
    }
}

pub(super) async fn reap(conn: &mut Conn, farm: FarmRules) -> Result<Reaped> {
    leases::heed_clock(conn).await?;
    // Locked, so that no heartbeat prolongs one that is about to go.
    let sql = conn.pick(
        "SELECT l.token FROM leases l LEFT JOIN tasks t ON t.id = l.task
         WHERE l.expires_ms <= $1 ORDER BY l.expires_ms, t.key",
        "SELECT l.token FROM leases l LEFT JOIN tasks t ON t.id = l.task
         WHERE l.expires_ms <= $1 ORDER BY l.expires_ms, t.key FOR UPDATE OF l",
    );
    let rows = query(sql).bind(conn.now_ms).all(conn).await?;
    let mut reaped = Reaped { expired: reruns::reap(conn).await?, ..Reaped::default() };
    for row in rows {
        let token = row.text("token")?;
        let Some(ended) = leases::take(conn, &token).await? else { continue };
        reaped.expired += 1;
        for mut bake in Ledger::live_of(conn, ended.task).await? {
            bake.event(lease_expired(&ended));
            bake.save(conn).await?;
        }
        if ended.is_pardoned {
            query("UPDATE tasks SET pardons = pardons + 1 WHERE id = $1").bind(ended.task).run(conn).await?;
        }
        let is_lost = ended.state != LeaseState::Granted && !ended.is_pardoned && !ended.has_hit_limit;
        remember(conn, &token, &ended, is_lost).await?;
        let wait_ms = if is_lost {
            reaped.lost += 1;
            count_loss(conn, &ended, &rules::expiry_message(&ended.worker), farm).await?
        } else if ended.state == LeaseState::Granted || ended.is_pardoned {
            Some(0)
        } else {
            blame_worker(conn, &ended, &rules::limit_message(&ended.worker)).await?
        };
        match wait_ms {
            Some(_) => requeue(conn, &ended).await?,
            None => reaped.given_up += 1,
        }
    }
    Ok(reaped)
}
