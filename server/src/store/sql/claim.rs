//! Handing out ready tasks.
//!
//! A claim looks at running bakes in order of priority and age, a window of them at a time, and takes one task after the
//! other from the bake whose turn it is ([`rules::next_contender`]). Tasks and bakes that are better left to another
//! worker are looked at closely only if this one ever failed.

use std::collections::{BTreeMap, BTreeSet};

use lightkiln_proto::api::{ClaimRequest, EventKind, Lease, Needs};
use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::{Artefact, TaskSpec};
use serde_json::json;

use super::codec::to_json;
use super::conn::{Conn, query, steps};
use super::outputs::{outputs_of_alike, outputs_of_needs};
use crate::random;
use crate::store::rules::{
    self, Abilities, BLOCK_TASKS, CLAIM_WINDOW, Contender, WORKER_PRESENT_MS, WORKER_SEEN_GRAIN_MS,
    dependencies, next_contender, resolve_inputs,
};
use crate::store::{LeaseState, Result};

/// Running bakes with ready tasks, behind one of that priority and number.
const OPEN_BAKES: &str = "
    SELECT b.seq, b.id, b.priority, b.scene, b.needs, b.attempt_limit_secs, b.traceparent,
    (SELECT CAST(coalesce(sum(s.leased), 0) AS BIGINT) FROM stages s WHERE s.bake = b.seq) AS leased
    FROM bakes b
    WHERE b.state = 'running' AND (b.priority < $1 OR (b.priority = $1 AND b.seq > $2))
    AND EXISTS (SELECT 1 FROM ready r WHERE r.bake = b.seq AND r.not_before_ms <= $3
                AND r.kind IN (SELECT value FROM json_each($4)))
    ORDER BY b.priority DESC, b.seq LIMIT $5";

/// The first ready task of a bake in claim order, and whether the worker failed at it before.
const FIRST: &str = "
    SELECT r.task, r.kind, EXISTS (SELECT 1 FROM blames x WHERE x.task = r.task AND x.worker = $4) AS is_blamed
    FROM ready r WHERE r.bake = $1 AND r.not_before_ms <= $2 AND r.kind IN (SELECT value FROM json_each($3))
    AND r.task NOT IN (SELECT CAST(value AS BIGINT) FROM json_each($5))
    ORDER BY r.cost DESC, r.key LIMIT 1";

/// The same, and the task's row is locked; one locked by another claim is left to it. `t.state` is looked at again
/// once the lock is held, so that a task that a claim took just before is not taken twice.
const FIRST_LOCKED: &str = "
    SELECT r.task, r.kind, EXISTS (SELECT 1 FROM blames x WHERE x.task = r.task AND x.worker = $4) AS is_blamed
    FROM ready r JOIN tasks t ON t.id = r.task
    WHERE r.bake = $1 AND t.state = 'ready' AND r.not_before_ms <= $2
    AND r.kind IN (SELECT value FROM json_each($3))
    AND r.task NOT IN (SELECT CAST(value AS BIGINT) FROM json_each($5))
    ORDER BY r.cost DESC, r.key LIMIT 1 FOR UPDATE OF t SKIP LOCKED";

/// A bake that has ready tasks.
#[derive(Clone)]
struct OpenBake {
    seq: i64,
    id: String,
    scene: Digest,
    needs: Needs,
    attempt_limit_secs: Option<u32>,
    traceparent: Option<String>,
}

/// A task chosen for a lease.
struct Chosen {
    task: i64,
    bake: String,
    token: String,
    expires_ms: i64,
    deadline_ms: i64,
    traceparent: Option<String>,
}

/// Another worker that is present.
struct Other {
    name: String,
    abilities: Abilities,
}

/// A claim under way.
struct Claim<'a> {
    conn: &'a mut Conn,
    request: &'a ClaimRequest,
    kinds: String,
    abilities: Abilities,
    /// The others, if this worker ever failed.
    others: Option<Vec<Other>>,
    /// The scene of the task that the worker was given last.
    scene: Option<Digest>,
    /// Tasks chosen, and tasks left to others.
    passed: BTreeSet<i64>,
    chosen: Vec<Chosen>,
}

pub(super) async fn claim(conn: &mut Conn, request: &ClaimRequest) -> Result<Vec<Lease>> {
    // Note that the worker is present: tasks are left to workers that are.
    let seen = see_worker(conn, request).await?;
    // Load the other workers for one that failed before: it leaves tasks to them, nobody else does.
    let others = if seen.has_failed { Some(others(conn, request).await?) } else { None };
    // Choose before anything is written: on PostgreSQL the rows of chosen tasks are locked, and other claims pass them over.
    let (kinds, abilities) = (to_json(&request.kinds)?, Abilities::of(request));
    let (passed, chosen) = (BTreeSet::new(), Vec::new());
    let scene = seen.scene;
    let mut claim = Claim { conn, request, kinds, abilities, others, scene, passed, chosen };
    claim.choose_all().await?;
    let chosen = claim.chosen;
    // Write nothing for an idle worker's poll.
    if chosen.is_empty() {
        return Ok(Vec::new());
    }
    // Mark all chosen tasks in one statement: round trips are most of a claim's time.
    let tasks: Vec<i64> = chosen.iter().map(|chosen| chosen.task).collect();
    let tasks = to_json(&tasks)?;
    let taken = take_tasks(conn, &tasks).await?;
    // Read the outputs of dependencies only where there are any, as inputs name them by their tasks.
    let has_needs = taken.values().any(|taken| !dependencies(&taken.spec).is_empty());
    let outputs = if has_needs { outputs_of_needs(conn, &tasks).await? } else { BTreeMap::new() };
    // Find results of tasks alike only for tasks that have a name in common with any.
    let names: BTreeSet<Digest> = taken.values().filter_map(|taken| taken.spec.alike).collect();
    let alike = if names.is_empty() { BTreeMap::new() } else { outputs_of_alike(conn, &names).await? };
    // Lock counters and events last, as claims beside this one wait for these rows until the transaction ends.
    write_leases(conn, &chosen, &taken, &tasks, request).await?;
    Ok(leases(chosen, taken, &outputs, &alike))
}

pub(super) async fn is_any_ready(conn: &mut Conn, kinds: &[String]) -> Result<bool> {
    let sql = "SELECT EXISTS (
                   SELECT 1 FROM bakes b WHERE b.state = 'running' AND EXISTS (
                       SELECT 1 FROM ready r WHERE r.bake = b.seq AND r.not_before_ms <= $1
                       AND r.kind IN (SELECT value FROM json_each($2)))) AS is_any_ready";
    query(sql).bind(conn.now_ms).bind(to_json(kinds)?).one(conn).await?.get("is_any_ready")
}

/// Facts about the worker that claims.
struct Seen {
    /// The scene of the task that it was given last.
    scene: Option<Digest>,
    /// It failed at a task that is still there.
    has_failed: bool,
}

/// Looks the worker up and notes it, unless that was done a moment ago: an idle worker's polls write nothing.
async fn see_worker(conn: &mut Conn, request: &ClaimRequest) -> Result<Seen> {
    let (kinds, labels) = (to_json(&request.kinds)?, to_json(&request.labels)?);
    let sql = "SELECT w.scene, EXISTS (SELECT 1 FROM blames x WHERE x.worker = n.name) AS has_failed,
               coalesce(w.kinds = $2 AND w.labels = $3 AND w.threads = $4 AND w.memory_mib = $5
                        AND $6 - w.seen_ms < $7, false) AS is_noted
               FROM (SELECT CAST($1 AS TEXT) AS name) n LEFT JOIN workers w ON w.name = n.name";
    let row = query(sql)
        .bind(&request.worker)
        .bind(&kinds)
        .bind(&labels)
        .bind(request.threads)
        .bind(request.memory_mib)
        .bind(conn.now_ms)
        .bind(WORKER_SEEN_GRAIN_MS)
        .one(conn)
        .await?;
    let seen = Seen { scene: row.digest_if_any("scene")?, has_failed: row.get("has_failed")? };
    if row.get("is_noted")? {
        return Ok(seen);
    }
    let sql = "INSERT INTO workers (name, kinds, threads, seen_ms, memory_mib, labels)
               VALUES ($1, $2, $3, $4, $5, $6) ON CONFLICT (name) DO UPDATE SET
               kinds = excluded.kinds, threads = excluded.threads,
               seen_ms = CASE WHEN excluded.seen_ms > workers.seen_ms THEN excluded.seen_ms ELSE workers.seen_ms END,
               memory_mib = excluded.memory_mib, labels = excluded.labels";
    query(sql)
        .bind(&request.worker)
        .bind(&kinds)
        .bind(request.threads)
        .bind(conn.now_ms)
        .bind(request.memory_mib)
        .bind(&labels)
        .run(conn)
        .await?;
    Ok(seen)
}

/// Other workers that are present.
async fn others(conn: &mut Conn, request: &ClaimRequest) -> Result<Vec<Other>> {
    let sql =
        "SELECT name, kinds, threads, memory_mib, labels FROM workers WHERE seen_ms > $1 AND name <> $2";
    let rows = query(sql).bind(conn.now_ms - WORKER_PRESENT_MS).bind(&request.worker).all(conn).await?;
    let mut others = Vec::with_capacity(rows.len());
    for row in rows {
        let abilities = Abilities {
            kinds: row.json("kinds")?,
            threads: row.small("threads")?,
            memory_mib: row.small("memory_mib")?,
            labels: row.json("labels")?,
        };
        others.push(Other { name: row.get("name")?, abilities });
    }
    Ok(others)
}

impl Claim<'_> {
    fn is_full(&self) -> bool {
        self.chosen.len() >= self.request.max as usize
    }

    async fn choose_all(&mut self) -> Result<()> {
        let (mut priority, mut seq) = (i64::MAX, 0_i64);
        while !self.is_full() {
            // Read a window of bakes: fairness holds among them, and the cost does not grow with all bakes of the farm.
            let rows = query(OPEN_BAKES)
                .bind(priority)
                .bind(seq)
                .bind(self.conn.now_ms)
                .bind(&self.kinds)
                .bind(CLAIM_WINDOW)
                .all(self.conn)
                .await?;
            let Some(last) = rows.last() else { return Ok(()) };
            // Go on behind this window if it does not fill the claim.
            (priority, seq) = (last.get("priority")?, last.get("seq")?);
            // Leave out bakes whose tasks this worker cannot do, or should not.
            let mut contenders = Vec::with_capacity(rows.len());
            for row in rows {
                let limit = row.get::<Option<i64>>("attempt_limit_secs")?;
                let bake = OpenBake {
                    seq: row.get("seq")?,
                    id: row.get("id")?,
                    scene: row.digest("scene")?,
                    needs: row.json("needs")?,
                    attempt_limit_secs: limit.and_then(|limit| u32::try_from(limit).ok()),
                    traceparent: row.get("traceparent")?,
                };
                if self.abilities.suffice(&bake.needs) && !self.is_blocked(&bake).await? {
                    let (priority, leased) = (row.get("priority")?, row.get("leased")?);
                    let is_local = self.scene == Some(bake.scene);
                    contenders.push(Contender { bake, priority, leased, is_local });
                }
            }
            self.choose_among(contenders).await?;
        }
        Ok(())
    }

    /// Chooses until there is enough, or nothing.
    async fn choose_among(&mut self, mut contenders: Vec<Contender<OpenBake>>) -> Result<()> {
        let scene_before = self.scene;
        while !self.is_full()
            && let Some(index) = next_contender(&contenders)
        {
            let bake = contenders[index].bake.clone();
            match self.first(&bake).await? {
                Some(task) => {
                    // Pass the task over from now on: it is offered until the leases are written.
                    self.passed.insert(task);
                    let deadline_ms = rules::deadline_ms(self.conn.now_ms, bake.attempt_limit_secs);
                    let expires_ms = self.conn.now_ms + i64::from(self.request.ttl_secs) * 1000;
                    // End the lease with the attempt's limit, so that no heartbeat carries it beyond.
                    let expires_ms = expires_ms.min(deadline_ms);
                    let (token, traceparent) = (random::fencing_token(), bake.traceparent);
                    self.chosen.push(Chosen {
                        task,
                        bake: bake.id,
                        token,
                        expires_ms,
                        deadline_ms,
                        traceparent,
                    });
                    // Count the lease at once, so that the next task may be another bake's.
                    contenders[index].leased += 1;
                    self.scene = Some(bake.scene);
                }
                // Leave the bake: its ready tasks are taken, or left to others.
                None => drop(contenders.remove(index)),
            }
        }
        // Keep the scene with the worker, whose next claims prefer it.
        if let Some(scene) = self.scene.filter(|_| self.scene != scene_before) {
            let sql = "UPDATE workers SET scene = $1 WHERE name = $2";
            query(sql).bind(scene.to_string()).bind(&self.request.worker).run(self.conn).await?;
        }
        Ok(())
    }

    /// The bake's first ready task that this worker need not leave to others.
    async fn first(&mut self, bake: &OpenBake) -> Result<Option<i64>> {
        loop {
            let row = query(self.conn.pick(FIRST, FIRST_LOCKED))
                .bind(bake.seq)
                .bind(self.conn.now_ms)
                .bind(&self.kinds)
                .bind(&self.request.worker)
                .bind(to_json(&self.passed)?)
                .optional(self.conn)
                .await?;
            let Some(row) = row else { return Ok(None) };
            let task = row.get("task")?;
            if !row.get::<bool>("is_blamed")?
                || !self.is_left_to_others(bake, task, &row.text("kind")?).await?
            {
                return Ok(Some(task));
            }
            self.passed.insert(task);
        }
    }

    /// A worker that failed at a task leaves it to others, if one that could do it and has not failed is present.
    async fn is_left_to_others(&mut self, bake: &OpenBake, task: i64, kind: &str) -> Result<bool> {
        let rows = query("SELECT worker FROM blames WHERE task = $1").bind(task).all(self.conn).await?;
        let blamed = rows.iter().map(|row| row.text("worker")).collect::<Result<BTreeSet<_>, _>>()?;
        let could = |other: &Other| {
            !blamed.contains(&other.name)
                && other.abilities.kinds.iter().any(|known| known == kind)
                && other.abilities.suffice(&bake.needs)
        };
        Ok(self.others.iter().flatten().any(could))
    }

    /// A worker that failed at many tasks of a bake gets none of it, if one that did not is present.
    async fn is_blocked(&mut self, bake: &OpenBake) -> Result<bool> {
        let Some(others) = &self.others else { return Ok(false) };
        if failures(self.conn, bake.seq, &self.request.worker).await? < BLOCK_TASKS {
            return Ok(false);
        }
        for other in others.iter().filter(|other| other.abilities.can_replace(self.request, &bake.needs)) {
            if failures(self.conn, bake.seq, &other.name).await? < BLOCK_TASKS {
                return Ok(true);
            }
        }
        Ok(false)
    }
}

/// Tasks of a bake at which a worker failed.
async fn failures(conn: &mut Conn, bake: i64, worker: &str) -> Result<u64> {
    let sql = "SELECT count(*) AS tasks FROM blames x JOIN bake_tasks m ON m.task = x.task
               WHERE m.bake = $1 AND x.worker = $2";
    query(sql).bind(bake).bind(worker).one(conn).await?.count("tasks")
}

/// Writes leases and their starts, and counts them, in every live bake that holds the tasks.
async fn write_leases(
    conn: &mut Conn,
    chosen: &[Chosen],
    taken: &BTreeMap<i64, Taken>,
    tasks: &str,
    request: &ClaimRequest,
) -> Result<()> {
    let row = |chosen: &Chosen| {
        let attempt = taken.get(&chosen.task).map_or(1, |taken| taken.attempt);
        json!([chosen.token, chosen.task, chosen.expires_ms, chosen.deadline_ms, attempt])
    };
    let rows: Vec<_> = chosen.iter().map(row).collect();
    let insert = conn.pick(
        "INSERT INTO leases (token, task, expires_ms, deadline_ms, attempt, worker, ttl_ms, state, progress, started_ms)
         SELECT value ->> 0, value ->> 1, value ->> 2, value ->> 3, value ->> 4, $2, $3, $4, 0, $5 FROM json_each($1)",
        "INSERT INTO leases (token, task, expires_ms, deadline_ms, attempt, worker, ttl_ms, state, progress, started_ms)
         SELECT v ->> 0, (v ->> 1)::bigint, (v ->> 2)::bigint, (v ->> 3)::bigint, (v ->> 4)::bigint, $2, $3, $4, 0, $5
         FROM jsonb_array_elements($1::jsonb) AS j (v)",
    );
    let mut parts =
        vec![insert, "DELETE FROM ready WHERE task IN (SELECT CAST(value AS BIGINT) FROM json_each($6))"];
    if conn.has_concurrent_claims() {
        // One order for all claims, or two of them could wait for each other; then come the bakes', in one order too.
        // As late as can be: from here on a claim of the same kind waits for this one.
        parts.push(
            "SELECT 1 FROM stages WHERE (bake, kind) IN (
                 SELECT m.bake, t.kind FROM bake_tasks m JOIN tasks t ON t.id = m.task
                 WHERE t.id IN (SELECT CAST(value AS BIGINT) FROM json_each($6)))
             ORDER BY bake, kind FOR UPDATE",
        );
    }
    parts.push(
        "UPDATE stages SET leased = leased + n.fresh, first_claim_ms = coalesce(first_claim_ms, $5)
         FROM (SELECT m.bake, t.kind, count(*) AS fresh
               FROM bake_tasks m JOIN tasks t ON t.id = m.task JOIN bakes b ON b.seq = m.bake
               WHERE t.id IN (SELECT CAST(value AS BIGINT) FROM json_each($6))
               AND b.state IN ('running', 'paused') GROUP BY m.bake, t.kind) AS n
         WHERE stages.bake = n.bake AND stages.kind = n.kind",
    );
    steps(parts)
        .bind(to_json(&rows)?)
        .bind(&request.worker)
        .bind(i64::from(request.ttl_secs) * 1000)
        .bind(LeaseState::Granted.name())
        .bind(conn.now_ms)
        .bind(tasks)
        .run(conn)
        .await?;
    for (bake, starts) in starts(chosen, taken, &request.worker)? {
        tell_bake(conn, bake, &starts).await?;
    }
    Ok(())
}

/// The leases as the worker gets them.
fn leases(
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
struct Taken {
    spec: TaskSpec,
    attempt: u32,
    /// Live bakes that hold it.
    bakes: Vec<i64>,
}

/// Marks tasks as leased, and returns them.
async fn take_tasks(conn: &mut Conn, tasks: &str) -> Result<BTreeMap<i64, Taken>> {
    let sql = conn.pick(
        "UPDATE tasks SET state = 'leased' WHERE id IN (SELECT CAST(value AS BIGINT) FROM json_each($1))
         RETURNING id, key, kind, version, label, params, inputs, cost, alike, attempts + losses AS tries,
         (SELECT json_group_array(m.bake) FROM bake_tasks m JOIN bakes b ON b.seq = m.bake
          WHERE m.task = tasks.id AND b.state IN ('running', 'paused')) AS bakes",
        "UPDATE tasks SET state = 'leased' WHERE id IN (SELECT CAST(value AS BIGINT) FROM json_each($1))
         RETURNING id, key, kind, version, label, params, inputs, cost, alike, attempts + losses AS tries,
         (SELECT CAST(coalesce(json_agg(m.bake), '[]') AS TEXT) FROM bake_tasks m JOIN bakes b ON b.seq = m.bake
          WHERE m.task = tasks.id AND b.state IN ('running', 'paused')) AS bakes",
    );
    let mut taken = BTreeMap::new();
    for row in query(sql).bind(tasks).all(conn).await? {
        let spec = TaskSpec {
            key: row.digest("key")?,
            kind: row.get("kind")?,
            version: row.small("version")?,
            label: row.get("label")?,
            params: row.json("params")?,
            inputs: row.json("inputs")?,
            cost: row.count("cost")?,
            alike: row.digest_if_any("alike")?,
        };
        let attempt = row.small("tries")?.saturating_add(1);
        taken.insert(row.get("id")?, Taken { spec, attempt, bakes: row.json("bakes")? });
    }
    Ok(taken)
}

/// The starts of the chosen tasks, in their order, by live bake that holds them.
fn starts(
    chosen: &[Chosen],
    taken: &BTreeMap<i64, Taken>,
    worker: &str,
) -> Result<BTreeMap<i64, Vec<String>>> {
    let mut starts: BTreeMap<i64, Vec<String>> = BTreeMap::new();
    for Taken { spec, attempt, bakes } in chosen.iter().filter_map(|chosen| taken.get(&chosen.task)) {
        let TaskSpec { key, kind, label, .. } = spec.clone();
        let (worker, attempt) = (worker.to_owned(), *attempt);
        let start = to_json(&EventKind::TaskStarted { key, kind, label, worker, attempt })?;
        for bake in bakes {
            starts.entry(*bake).or_default().push(start.clone());
        }
    }
    Ok(starts)
}

/// Tells a bake of starts. The row is changed before it is read: claims beside this one wait for it.
async fn tell_bake(conn: &mut Conn, bake: i64, starts: &[String]) -> Result<()> {
    let events: Vec<_> = (1..).zip(starts).map(|(index, start)| json!([index, start])).collect();
    let insert = conn.pick(
        "INSERT INTO events (bake, seq, at_ms, event) SELECT b.seq, b.last_event - $2 + (value ->> 0), $3, value ->> 1
         FROM bakes b, json_each($4) WHERE b.seq = $1",
        "INSERT INTO events (bake, seq, at_ms, event) SELECT b.seq, b.last_event - $2 + (v ->> 0)::bigint, $3, v ->> 1
         FROM bakes b, jsonb_array_elements($4::jsonb) AS j (v) WHERE b.seq = $1",
    );
    steps(["UPDATE bakes SET last_event = last_event + $2 WHERE seq = $1", insert])
        .bind(bake)
        .bind(events.len())
        .bind(conn.now_ms)
        .bind(to_json(&events)?)
        .run(conn)
        .await?;
    Ok(())
}
