//! The leases of a claim, once it has chosen its tasks.

use std::collections::{BTreeMap, BTreeSet};

use lightkiln_proto::api::{ClaimRequest, EventKind, Lease};
use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::{Artefact, TaskSpec};
use serde_json::json;

use super::codec::to_json;
use super::conn::{Conn, query, together};
use super::patience::Locked;
use crate::store::rules::resolve_inputs;
use crate::store::{LeaseState, Result};

macro_rules! last_events {
    ($end:literal) => {
        concat!(
            "SELECT seq, last_event FROM bakes WHERE seq = ANY (ARRAY(SELECT CAST(value AS BIGINT) FROM json_each($1)))
             ORDER BY seq FOR NO KEY UPDATE",
            $end
        )
    };
}

/// A task chosen for a lease.
pub(super) struct Chosen {
    pub(super) task: i64,
    /// Live bakes that hold it.
    pub(super) bakes: Vec<i64>,
    /// The bake that it is given to the worker for.
    pub(super) bake: String,
    /// The same bake's number.
    pub(super) seq: i64,
    /// It has a limit of workers.
    pub(super) is_limited: bool,
    pub(super) token: String,
    pub(super) expires_ms: i64,
    pub(super) deadline_ms: i64,
    pub(super) traceparent: Option<String>,
}

/// Writes leases and their starts, and counts them, in every live bake that holds the tasks; `last` are the bakes' last events.
pub(super) async fn write_leases(
    conn: &mut Conn,
    chosen: &[Chosen],
    taken: &BTreeMap<i64, Taken>,
    last: BTreeMap<i64, u64>,
    request: &ClaimRequest,
) -> Result<()> {
    let tasks: Vec<i64> = chosen.iter().map(|chosen| chosen.task).collect();
    let row = |chosen: &Chosen| {
        let attempt = taken.get(&chosen.task).map_or(1, |taken| taken.attempt);
        json!([chosen.token, chosen.task, chosen.expires_ms, chosen.deadline_ms, attempt, chosen.seq])
    };
    let rows: Vec<_> = chosen.iter().map(row).collect();
    let Starts { events, last, begun } = starts(chosen, taken, &request.worker, last)?;
    let last: Vec<_> = last.into_iter().collect();
    let begun: Vec<_> = begun.into_iter().map(|((bake, kind), count)| (bake, kind, count)).collect();
    let inserts = conn.pick(
        [
            "INSERT INTO leases (token, task, expires_ms, deadline_ms, attempt, bake, worker, ttl_ms, state, progress, started_ms)
             SELECT value ->> 0, value ->> 1, value ->> 2, value ->> 3, value ->> 4, value ->> 5, $2, $3, $4, 0, $5 FROM json_each($1)",
            "INSERT INTO events (bake, seq, at_ms, event)
             SELECT value ->> 0, value ->> 1, $5, value ->> 2 FROM json_each($7)",
            "UPDATE bakes SET last_event = j.value ->> 1 FROM json_each($8) j WHERE bakes.seq = j.value ->> 0",
            "UPDATE stages SET leased = leased + (j.value ->> 2), first_claim_ms = coalesce(first_claim_ms, $5)
             FROM json_each($9) j WHERE stages.bake = j.value ->> 0 AND stages.kind = j.value ->> 1",
        ],
        [
            "INSERT INTO leases (token, task, expires_ms, deadline_ms, attempt, bake, worker, ttl_ms, state, progress, started_ms)
             SELECT v ->> 0, (v ->> 1)::bigint, (v ->> 2)::bigint, (v ->> 3)::bigint, (v ->> 4)::bigint, (v ->> 5)::bigint,
             $2, $3, $4, 0, $5
             FROM jsonb_array_elements($1::jsonb) AS j (v)",
            "INSERT INTO events (bake, seq, at_ms, event) SELECT (v ->> 0)::bigint, (v ->> 1)::bigint, $5, v ->> 2
             FROM jsonb_array_elements($7::jsonb) AS j (v)",
            "UPDATE bakes SET last_event = (v ->> 1)::bigint FROM jsonb_array_elements($8::jsonb) AS j (v)
             WHERE bakes.seq = (v ->> 0)::bigint",
            "UPDATE stages SET leased = leased + (v ->> 2)::bigint, first_claim_ms = coalesce(first_claim_ms, $5)
             FROM jsonb_array_elements($9::jsonb) AS j (v)
             WHERE stages.bake = (v ->> 0)::bigint AND stages.kind = v ->> 1",
        ],
    );
    let offered = "DELETE FROM ready WHERE task IN (SELECT CAST(value AS BIGINT) FROM json_each($6))";
    together([&inserts[..], &[offered]].concat())
        .bind(to_json(&rows)?)
        .bind(&request.worker)
        .bind(i64::from(request.ttl_secs) * 1000)
        .bind(LeaseState::Granted.name())
        .bind(conn.now_ms)
        .bind(to_json(&tasks)?)
        .bind(to_json(&events)?)
        .bind(to_json(&last)?)
        .bind(to_json(&begun)?)
        .run(conn)
        .await
}

/// The leases as the worker gets them.
pub(super) fn leases(
    chosen: Vec<Chosen>,
    mut taken: BTreeMap<i64, Taken>,
    outputs: &BTreeMap<TaskKey, Vec<Artefact>>,
    alike: &BTreeMap<Digest, Vec<Vec<Artefact>>>,
) -> Vec<Lease> {
    let leased =
        chosen.into_iter().filter_map(|Chosen { task, bake, token, expires_ms, traceparent, .. }| {
            let task = taken.remove(&task)?.spec;
            let inputs = resolve_inputs(&task, |key| outputs.get(key).cloned().unwrap_or_default());
            let alike = task.alike.and_then(|name| alike.get(&name).cloned()).unwrap_or_default();
            Some(Lease { token, bake, task, inputs, alike, expires_ms, traceparent })
        });
    leased.collect()
}

/// A task that was taken, and which attempt at it begins.
pub(super) struct Taken {
    pub(super) spec: TaskSpec,
    attempt: u32,
}

/// Marks tasks as leased, and returns them.
pub(super) async fn take_tasks(conn: &mut Conn, tasks: &str) -> Result<BTreeMap<i64, Taken>> {
    let sql = "UPDATE tasks SET state = 'leased' WHERE id IN (SELECT CAST(value AS BIGINT) FROM json_each($1))
               RETURNING id, key, kind, version, label, params, inputs, cost, alike, attempts + losses AS tries";
    let mut taken = BTreeMap::new();
    for row in query(sql).bind(tasks).all(conn).await? {
        let spec = row.task()?;
        let attempt = row.small("tries")?.saturating_add(1);
        taken.insert(row.get("id")?, Taken { spec, attempt });
    }
    Ok(taken)
}

/// The starts of the chosen tasks in the live bakes that hold them.
struct Starts {
    /// Bake, number and event, in the order of the tasks.
    events: Vec<(i64, u64, String)>,
    /// The last number of each bake.
    last: BTreeMap<i64, u64>,
    /// How many began, by bake and kind.
    begun: BTreeMap<(i64, String), u64>,
}

/// Locks bakes, so that no event of another claim gets between; the number of each one's last event. Those that somebody else has locked
/// are missing, if these are left.
pub(super) async fn lock_bakes(
    conn: &mut Conn,
    bakes: &BTreeSet<i64>,
    locked: Locked,
) -> Result<BTreeMap<i64, u64>> {
    let of_list = "SELECT seq, last_event FROM bakes WHERE seq IN (SELECT value FROM json_each($1))";
    let sql = match locked {
        Locked::AreWaitedFor => last_events!(""),
        Locked::AreLeft => last_events!(" SKIP LOCKED"),
    };
    let mut last = BTreeMap::new();
    for row in query(conn.pick(of_list, sql)).bind(to_json(bakes)?).all(conn).await? {
        last.insert(row.get("seq")?, row.count("last_event")?);
    }
    Ok(last)
}

/// Numbers the starts.
fn starts(
    chosen: &[Chosen],
    taken: &BTreeMap<i64, Taken>,
    worker: &str,
    mut last: BTreeMap<i64, u64>,
) -> Result<Starts> {
    let (mut events, mut begun) = (Vec::new(), BTreeMap::new());
    for chosen in chosen {
        let Some(Taken { spec, attempt }) = taken.get(&chosen.task) else { continue };
        let TaskSpec { key, kind, label, .. } = spec.clone();
        let (worker, attempt) = (worker.to_owned(), *attempt);
        let start = to_json(&EventKind::TaskStarted { key, kind, label, worker, attempt })?;
        for bake in &chosen.bakes {
            let Some(last) = last.get_mut(bake) else { continue };
            *last += 1;
            events.push((*bake, *last, start.clone()));
            *begun.entry((*bake, spec.kind.clone())).or_insert(0) += 1;
        }
    }
    Ok(Starts { events, last, begun })
}
