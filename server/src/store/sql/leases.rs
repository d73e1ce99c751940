//! Leases under way: heartbeat, release, and taking a lease from its holder.

use lightkiln_proto::api::{EventKind, HeartbeatAnswer, Verdict};
use lightkiln_proto::ids::TaskKey;
use lightkiln_proto::jobs::Artefact;

use super::conn::{Conn, corrupt, query, steps};
use super::ledger::Ledger;
use super::{ready, reruns};
use crate::store::rules::{self, WORKER_SEEN_GRAIN_MS};
use crate::store::{LeaseState, Result};

/// Deadlines behind this are none: leases from before there were deadlines.
const NO_DEADLINE_MS: i64 = i64::MAX / 2;

/// An attempt that just ended, and its task.
pub(super) struct Ended {
    pub(super) task: i64,
    pub(super) key: TaskKey,
    pub(super) kind: String,
    pub(super) label: String,
    pub(super) cost: u64,
    /// Attempts that have failed.
    pub(super) attempts: u32,
    /// Workers that were lost with it.
    pub(super) losses: u32,
    /// Number of this attempt.
    pub(super) attempt: u32,
    pub(super) worker: String,
    /// Duration of the attempt.
    pub(super) elapsed_ms: u64,
    /// The attempt had all the time that one may take.
    pub(super) has_hit_limit: bool,
    /// State of the lease.
    pub(super) state: LeaseState,
    /// It is late, and its task was not pardoned too often.
    pub(super) is_pardoned: bool,
    /// Something that the task reads was lost meanwhile.
    pub(super) input_lost: bool,
    /// Outputs of the task before its result was forgotten; none if that did not happen.
    pub(super) outputs_before: Vec<Artefact>,
    /// Other tasks wait for this one.
    pub(super) has_dependants: bool,
    /// Attempts whose leases were gone have told what they would have given.
    pub(super) has_witnesses: bool,
    /// Bakes that have ended lack the task's result.
    pub(super) is_missed: bool,
}

/// Prolongs a lease that is good, and says until when. It waits for nobody: neither for changes of the farm and claims, nor for a
/// commit of the lease itself, as that of a long plan, which decides about it.
pub(super) async fn keep(conn: &mut Conn, token: &str, progress: f32) -> Result<Option<i64>> {
    let sql = conn.pick(
        "UPDATE leases SET state = $2, progress = $3, graces = 0,
         expires_ms = CASE WHEN deadline_ms < $1 + ttl_ms THEN deadline_ms ELSE $1 + ttl_ms END
         WHERE token = $4 AND task IS NOT NULL AND expires_ms > $1 RETURNING worker, expires_ms",
        "UPDATE leases SET state = $2, progress = $3, graces = 0,
         expires_ms = CASE WHEN deadline_ms < $1 + ttl_ms THEN deadline_ms ELSE $1 + ttl_ms END
         WHERE token IN (SELECT l.token FROM leases l WHERE l.token = $4 AND l.task IS NOT NULL AND l.expires_ms > $1
                         FOR UPDATE SKIP LOCKED)
         RETURNING worker, expires_ms",
    );
    let kept = query(sql)
        .bind(conn.now_ms)
        .bind(LeaseState::Held.name())
        .bind(f64::from(progress))
        .bind(token)
        .optional(conn)
        .await?;
    let Some(row) = kept else {
        let sql = "SELECT expires_ms FROM leases WHERE token = $2 AND task IS NOT NULL AND expires_ms > $1";
        let held = query(sql).bind(conn.now_ms).bind(token).optional(conn).await?;
        return held.map(|row| row.get("expires_ms")).transpose();
    };
    see_holder(conn, &row.text("worker")?).await?;
    Ok(Some(row.get("expires_ms")?))
}

/// Notes that a worker is there.
async fn see_holder(conn: &mut Conn, worker: &str) -> Result<()> {
    // A row that somebody else writes is left: he says the same, and nobody waits for it with a lease in hand.
    let sql = conn.pick(
        "UPDATE workers SET seen_ms = $1 WHERE name = $2 AND $1 - seen_ms >= $3",
        "UPDATE workers SET seen_ms = $1 WHERE name IN (
             SELECT w.name FROM workers w WHERE w.name = $2 AND $1 - w.seen_ms >= $3 FOR UPDATE SKIP LOCKED)",
    );
    query(sql).bind(conn.now_ms).bind(worker).bind(WORKER_SEEN_GRAIN_MS).run(conn).await?;
    Ok(())
}

pub(super) async fn heartbeat(conn: &mut Conn, token: &str, progress: f32) -> Result<HeartbeatAnswer> {
    let sql = "SELECT task, worker, ttl_ms, expires_ms, deadline_ms FROM leases WHERE token = $1";
    let Some(row) = query(sql).bind(token).optional(conn).await? else {
        if let Some((worker, expires_ms)) = reruns::keep(conn, token).await? {
            see_holder(conn, &worker).await?;
            return Ok(HeartbeatAnswer { verdict: Verdict::Keep, expires_ms });
        }
        hear_late(conn, token).await?;
        return Ok(HeartbeatAnswer { verdict: Verdict::Lost, expires_ms: conn.now_ms });
    };
    let mut expires_ms: i64 = row.get("expires_ms")?;
    let mut verdict = Verdict::Keep;
    if row.get::<Option<i64>>("task")?.is_none() {
        verdict = Verdict::Cancel;
    } else if expires_ms <= conn.now_ms {
        hear_late(conn, token).await?;
        verdict = Verdict::Lost;
    } else {
        expires_ms = (conn.now_ms + row.get::<i64>("ttl_ms")?).min(row.get("deadline_ms")?);
        query("UPDATE leases SET expires_ms = $1, state = $2, progress = $3, graces = 0 WHERE token = $4")
            .bind(expires_ms)
            .bind(LeaseState::Held.name())
            .bind(f64::from(progress))
            .bind(token)
            .run(conn)
            .await?;
    }
    see_holder(conn, &row.text("worker")?).await?;
    Ok(HeartbeatAnswer { verdict, expires_ms })
}

pub(super) async fn release(conn: &mut Conn, token: &str) -> Result<bool> {
    let Some(ended) = end(conn, token).await? else {
        if reruns::release(conn, token).await? {
            return Ok(true);
        }
        hear_late(conn, token).await?;
        return Ok(false);
    };
    requeue(conn, &ended).await?;
    for mut bake in Ledger::live_of(conn, ended.task).await? {
        let (kind, label, worker) = (ended.kind.clone(), ended.label.clone(), ended.worker.clone());
        let elapsed_ms = ended.elapsed_ms;
        bake.event(EventKind::TaskReleased { key: ended.key, kind, label, worker, elapsed_ms });
        bake.save(conn).await?;
    }
    Ok(true)
}

/// Gives back every task of a worker whose process has ended; returns how many.
pub(super) async fn release_all(conn: &mut Conn, worker: &str) -> Result<u64> {
    let sql = "SELECT token FROM leases WHERE worker = $1 ORDER BY token";
    let mut released = reruns::release_all(conn, worker).await?;
    for row in query(sql).bind(worker).all(conn).await? {
        released += u64::from(release(conn, &row.text("token")?).await?);
    }
    Ok(released)
}

pub(super) async fn extend(conn: &mut Conn) -> Result<u64> {
    let sql = "UPDATE leases SET expires_ms = CASE WHEN deadline_ms < $1 + ttl_ms THEN deadline_ms ELSE $1 + ttl_ms END,
               graces = graces + 1
               WHERE task IS NOT NULL AND expires_ms <= $1 + ttl_ms / 2 AND expires_ms < deadline_ms AND graces < $2";
    let extended = query(sql).bind(conn.now_ms).bind(rules::MAX_GRACES).run(conn).await?;
    Ok(extended + reruns::extend(conn).await?)
}

/// Whether a reaper has something to do: leases that have run out, or something that [`heed_clock`] makes whole.
pub(super) async fn is_any_due(conn: &mut Conn) -> Result<bool> {
    let sql = "SELECT 1 FROM leases WHERE expires_ms <= $1 OR expires_ms > $1 + ttl_ms OR started_ms > $1
               UNION ALL SELECT 1 FROM ready WHERE not_before_ms > $1 + $2 AND not_before_ms > 0
               UNION ALL SELECT 1 FROM workers WHERE seen_ms > $1 LIMIT 1";
    let found = query(sql).bind(conn.now_ms).bind(rules::WAIT_MAX_MS).optional(conn).await?;
    Ok(found.is_some() || reruns::is_any_due(conn).await?)
}

/// Makes leases, waits and times of a clock that was set back since then whole again: none of them lies further ahead than it could have
/// been made now, or a dead worker would hold its task, and a failed task wait, until the clock has been there again. Holders that
/// are alive keep their leases.
pub(super) async fn heed_clock(conn: &mut Conn) -> Result<()> {
    let shift = steps([
        "UPDATE leases SET started_ms = $1, deadline_ms = CASE WHEN deadline_ms < $3 THEN $1 + (deadline_ms - started_ms)
                                                              ELSE deadline_ms END WHERE started_ms > $1",
        "UPDATE leases SET expires_ms = CASE WHEN deadline_ms < $1 + ttl_ms THEN deadline_ms ELSE $1 + ttl_ms END
         WHERE expires_ms > $1 + ttl_ms",
        "UPDATE tasks SET not_before_ms = $1
         WHERE id IN (SELECT r.task FROM ready r WHERE r.not_before_ms > $1 + $2 AND r.not_before_ms > 0)",
        "UPDATE ready SET not_before_ms = $1 WHERE not_before_ms > $1 + $2 AND not_before_ms > 0",
        "UPDATE workers SET seen_ms = $1 WHERE seen_ms > $1",
    ]);
    shift.bind(conn.now_ms).bind(rules::WAIT_MAX_MS).bind(NO_DEADLINE_MS).run(conn).await?;
    Ok(())
}

/// A holder whose lease has run out turns out to be alive. If that was counted as a loss, it is given back, once and
/// not for ever; if nobody has noticed yet, it will not be.
pub(super) async fn hear_late(conn: &mut Conn, token: &str) -> Result<()> {
    let sql = "UPDATE leases SET state = $1 WHERE token = $2 AND state = $3 AND expires_ms < deadline_ms";
    let (late, held) = (LeaseState::Late.name(), LeaseState::Held.name());
    query(sql).bind(late).bind(token).bind(held).run(conn).await?;
    let sql =
        "UPDATE expired SET counted = 0 WHERE token = $1 AND counted = 1 RETURNING task, worker, is_first";
    let Some(row) = query(sql).bind(token).optional(conn).await? else { return Ok(()) };
    let task: i64 = row.get("task")?;
    let sql = "UPDATE tasks SET losses = losses - 1, pardons = pardons + 1
               WHERE id = $1 AND losses > 0 AND pardons < $2 AND state <> 'done'";
    let is_pardoned = query(sql).bind(task).bind(rules::MAX_PARDONS).run(conn).await? > 0;
    if is_pardoned && row.get::<i64>("is_first")? != 0 {
        let sql = "DELETE FROM losses WHERE task = $1 AND worker = $2";
        query(sql).bind(task).bind(row.text("worker")?).run(conn).await?;
    }
    Ok(())
}

/// Takes a lease that is still good from its holder. A cancelled one goes too, but gives nothing.
pub(super) async fn end(conn: &mut Conn, token: &str) -> Result<Option<Ended>> {
    take_if(conn, token, false).await
}

/// Takes a lease, good or not; nothing when it was cancelled or is gone.
pub(super) async fn take(conn: &mut Conn, token: &str) -> Result<Option<Ended>> {
    take_if(conn, token, true).await
}

/// Takes a lease, one that has run out only if `even_late`; a cancelled one goes in any case.
async fn take_if(conn: &mut Conn, token: &str, even_late: bool) -> Result<Option<Ended>> {
    let sql = "SELECT l.task, l.worker, l.started_ms, l.expires_ms, l.deadline_ms, l.state, l.input_lost, l.attempt,
               t.key, t.kind, t.label, t.cost, t.attempts, t.losses, t.pardons,
               coalesce(t.outputs_before, '[]') AS outputs_before,
               EXISTS (SELECT 1 FROM witnesses w WHERE w.task = t.id) AS has_witnesses,
               EXISTS (SELECT 1 FROM task_needs n WHERE n.needs = t.id) AS has_dependants,
               EXISTS (SELECT 1 FROM lost_results x WHERE x.key = t.key) AS is_missed
               FROM leases l LEFT JOIN tasks t ON t.id = l.task WHERE l.token = $1";
    let Some(row) = query(sql).bind(token).optional(conn).await? else { return Ok(None) };
    let is_cancelled = row.get::<Option<i64>>("task")?.is_none();
    if !is_cancelled && !even_late && row.get::<i64>("expires_ms")? <= conn.now_ms {
        return Ok(None);
    }
    query("DELETE FROM leases WHERE token = $1").bind(token).run(conn).await?;
    if is_cancelled {
        return Ok(None);
    }
    let name = row.text("state")?;
    let state = LeaseState::named(&name)
        .ok_or_else(|| corrupt("a lease's state", format!("'{name}' is no state")))?;
    Ok(Some(Ended {
        task: row.get("task")?,
        key: row.digest("key")?,
        kind: row.get("kind")?,
        label: row.get("label")?,
        cost: row.count("cost")?,
        attempts: row.small("attempts")?,
        losses: row.small("losses")?,
        attempt: row.small("attempt")?,
        worker: row.get("worker")?,
        elapsed_ms: u64::try_from(conn.now_ms - row.get::<i64>("started_ms")?).unwrap_or(0),
        has_hit_limit: row.get::<i64>("expires_ms")? >= row.get::<i64>("deadline_ms")?,
        state,
        is_pardoned: state == LeaseState::Late && row.small("pardons")? < rules::MAX_PARDONS,
        input_lost: row.get::<i64>("input_lost")? != 0,
        outputs_before: row.json("outputs_before")?,
        has_dependants: row.get("has_dependants")?,
        has_witnesses: row.get("has_witnesses")?,
        is_missed: row.get("is_missed")?,
    }))
}

/// Makes a task claimable again, or waiting if a dependency was forgotten meanwhile.
pub(super) async fn requeue(conn: &mut Conn, ended: &Ended) -> Result<()> {
    let sql =
        "UPDATE tasks SET state = CASE waiting_count WHEN 0 THEN 'ready' ELSE 'waiting' END WHERE id = $1";
    query(sql).bind(ended.task).run(conn).await?;
    ready::offer(conn, ended.task).await?;
    // Count a lease less in every live bake that holds the task.
    let sql = "UPDATE stages SET leased = leased - 1
               WHERE kind = $1 AND bake IN (SELECT m.bake FROM bake_tasks m JOIN bakes b ON b.seq = m.bake
                                            WHERE m.task = $2 AND b.state IN ('running', 'paused'))";
    query(sql).bind(&ended.kind).bind(ended.task).run(conn).await?;
    Ok(())
}
