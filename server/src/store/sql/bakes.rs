//! Bakes: submit, pause, resume, cancel, priority.

use std::collections::BTreeSet;

use lightkiln_proto::api::{Bake, BakeState, EventKind};

use super::bulk;
use super::chunks;
use super::codec::to_json;
use super::conn::{Conn, query};
use super::ledger::{Ledger, seq_of};
use super::plan::apply_plan;
use super::reruns;
use super::view;
use crate::random;
use crate::store::{PlanError, Result, StoreError, Submission, Submitted, require_live};

/// Takes a bake in; `plan` says whether its plan is one.
pub(super) async fn submit(
    conn: &mut Conn,
    submission: &Submission,
    plan: &Result<(), PlanError>,
) -> Result<Submitted> {
    if let Some(bake) = submitted_before(conn, submission).await? {
        return Ok(Submitted { bake, is_new: false });
    }
    plan.clone()?;
    bulk::take_time(conn, submission.plan.len()).await?;
    let seq = insert(conn, submission).await?;
    let mut bake = Ledger::load(conn, seq).await?;
    bake.event(EventKind::Submitted);
    let scene = [submission.bake.scene].into();
    chunks::refer(conn, seq, &scene, &scene).await?;
    apply_plan(conn, &mut bake, &submission.plan, &mut BTreeSet::new()).await?;
    bake.save_or_finish(conn).await?;
    Ok(Submitted { bake: view::bake(conn, &bake.id).await?, is_new: true })
}

async fn submitted_before(conn: &mut Conn, submission: &Submission) -> Result<Option<Bake>> {
    let Some(key) = &submission.idempotency_key else { return Ok(None) };
    let query = query("SELECT id, body_hash FROM bakes WHERE idempotency_key = $1").bind(key);
    let Some(row) = query.optional(conn).await? else { return Ok(None) };
    if row.text("body_hash")? != submission.body_hash.to_string() {
        return Err(StoreError::IdempotencyConflict { key: key.clone() });
    }
    Ok(Some(view::bake(conn, &row.text("id")?).await?))
}

async fn insert(conn: &mut Conn, submission: &Submission) -> Result<i64> {
    let sql =
        "INSERT INTO bakes (id, idempotency_key, body_hash, name, kind, scene, settings, priority, state,
               open_count, tasks_run, tasks_reused, counters, counters_reused, created_ms, last_event, needs,
               attempt_limit_secs, traceparent, owner, max_workers, max_attempts, max_lost, verify_share)
               VALUES ($1, $2, $3, $4, $5, $6, $7, $8, 'running', 0, 0, 0, '{}', '{}', $9, 0, $10, $11, $12, $13,
               $14, $15, $16, $17) RETURNING seq";
    let new = &submission.bake;
    let query = query(sql)
        .bind(random::id())
        .bind(&submission.idempotency_key)
        .bind(submission.body_hash.to_string())
        .bind(&new.name)
        .bind(&new.kind)
        .bind(new.scene.to_string())
        .bind(to_json(&new.settings)?)
        .bind(new.priority)
        .bind(conn.now_ms)
        .bind(to_json(&new.needs)?)
        .bind(new.attempt_limit_secs.map(i64::from))
        .bind(&submission.traceparent)
        .bind(&submission.owner)
        .bind(new.limits.max_workers.map(i64::from))
        .bind(new.limits.attempts.map(i64::from))
        .bind(new.limits.lost_workers.map(i64::from))
        .bind(new.verify_share);
    query.one(conn).await?.get("seq")
}

/// Pauses or resumes.
pub(super) async fn set_state(
    conn: &mut Conn,
    id: &str,
    state: BakeState,
    action: &'static str,
) -> Result<Bake> {
    let mut bake = load_live(conn, id, action).await?;
    if bake.state != state {
        bake.state = state;
        if state == BakeState::Running {
            let sql = "UPDATE ready SET since_ms = $1 WHERE bake = $2";
            query(sql).bind(conn.now_ms).bind(bake.seq).run(conn).await?;
        }
        reruns::pause(conn, bake.seq, state == BakeState::Paused).await?;
        bake.event(EventKind::State { state });
        bake.save(conn).await?;
    }
    view::bake(conn, id).await
}

pub(super) async fn cancel(conn: &mut Conn, id: &str) -> Result<Bake> {
    let seq = seq_of(conn, id).await?;
    let mut bake = Ledger::load(conn, seq).await?;
    if bake.state != BakeState::Cancelled {
        require_live(id, bake.state, "cancelled")?;
        bake.close(conn, BakeState::Cancelled, None).await?;
    }
    view::bake(conn, id).await
}

pub(super) async fn reprioritise(conn: &mut Conn, id: &str, priority: i32) -> Result<Bake> {
    let bake = load_live(conn, id, "given another priority").await?;
    query("UPDATE bakes SET priority = $1 WHERE seq = $2").bind(priority).bind(bake.seq).run(conn).await?;
    view::bake(conn, id).await
}

async fn load_live(conn: &mut Conn, id: &str, action: &'static str) -> Result<Ledger> {
    let seq = seq_of(conn, id).await?;
    let bake = Ledger::load(conn, seq).await?;
    require_live(id, bake.state, action)?;
    Ok(bake)
}
