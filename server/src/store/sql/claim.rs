//! Handing out ready tasks.
//!
//! A claim looks at running bakes in order of priority and age, a window of them at a time, and takes one task after the
//! other from the bake whose turn it is ([`rules::next_contender`]). Tasks and bakes that are better left to another
//! worker are looked at closely only if this one ever failed.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use lightkiln_proto::api::{ClaimRequest, Lease, Needs};
use lightkiln_proto::ids::Digest;

use super::codec::to_json;
use super::conn::{Conn, Row, query};
use super::grant::{self, Chosen};
use super::outputs::{outputs_of_alike, outputs_of_needs};
use super::patience::Locked;
use super::present::{Other, others, see_worker};
use super::reruns;
use crate::random;
use crate::store::Result;
use crate::store::rules::{
    self, Abilities, BLOCK_TASKS, CLAIM_WINDOW, Contender, dependencies, next_contender,
};

/// Whether a bake has room for a worker: it has no limit of workers or has not reached it, or the worker holds some of its tasks already.
macro_rules! has_room {
    ($worker:literal) => {
        concat!(
            "(b.max_workers IS NULL OR EXISTS (SELECT 1 FROM leases l WHERE l.bake = b.seq AND l.worker = ",
            $worker,
            ") OR (SELECT count(DISTINCT l.worker) FROM leases l WHERE l.bake = b.seq) < b.max_workers)"
        )
    };
}

/// Running bakes with ready tasks, behind one of that priority and number. The look for a ready task is a column of the
/// row, which no planner turns around: it ends at the first that it finds, kind by kind.
macro_rules! open_bakes {
    ($first_ready:literal) => {
        concat!(
            "SELECT b.seq, b.id, b.priority, b.scene, b.needs, b.attempt_limit_secs, b.traceparent,
             b.max_workers IS NOT NULL AS is_limited,
             (SELECT CAST(coalesce(sum(s.leased), 0) AS BIGINT) FROM stages s WHERE s.bake = b.seq) AS leased
             FROM bakes b
             WHERE b.state = 'running' AND (b.priority < $1 OR (b.priority = $1 AND b.seq > $2)) AND (",
            $first_ready,
            ") IS NOT NULL AND ",
            has_room!("$6"),
            " ORDER BY b.priority DESC, b.seq LIMIT $5"
        )
    };
}

/// Live bakes that hold a task, as JSON.
macro_rules! live_bakes {
    ($list:literal, $task:literal) => {
        concat!(
            "(SELECT ",
            $list,
            " FROM bake_tasks m WHERE m.task = ",
            $task,
            " AND (SELECT b.state FROM bakes b WHERE b.seq = m.bake) IN ('running', 'paused')) AS bakes"
        )
    };
}

/// The first ready tasks of a bake in claim order, and whether the worker failed at them before. Kind by kind the index has them
/// in that order: tasks of other kinds are not read.
const FIRST: &str = concat!(
    "SELECT r.task, r.kind, EXISTS (SELECT 1 FROM blames x WHERE x.task = r.task AND x.worker = $4) AS is_blamed, ",
    live_bakes!("json_group_array(m.bake)", "r.task"),
    ", 0 AS seen FROM json_each($3) k CROSS JOIN ready r INDEXED BY ready_by_task
     WHERE r.bake = $1 AND r.task IN (
         SELECT o.task FROM ready o INDEXED BY ready_by_kind WHERE o.bake = $1 AND o.kind = k.value AND o.not_before_ms <= $2
         AND o.task NOT IN (SELECT CAST(value AS BIGINT) FROM json_each($5)) ORDER BY o.cost DESC, o.key LIMIT $7)
     ORDER BY r.cost DESC, r.key LIMIT $6"
);

/// The same, and the tasks' rows are locked, no more of them than are wanted; those locked by other claims are left to them. As there may
/// be some, more are read. `t.state` is looked at again once a lock is held, so that a task that a claim took just before is not
/// taken twice.
const FIRST_LOCKED: &str = concat!(
    "WITH first AS MATERIALIZED (
         SELECT x.task, x.kind, x.cost, x.key FROM json_each($3) k CROSS JOIN LATERAL (
             SELECT r.task, r.kind, r.cost, r.key FROM ready r
             WHERE r.bake = $1 AND r.kind = k.value AND r.not_before_ms <= $2
             AND r.task <> ALL (ARRAY(SELECT CAST(value AS BIGINT) FROM json_each($5)))
             ORDER BY r.cost DESC, r.key LIMIT $7) AS x
         ORDER BY x.cost DESC, x.key LIMIT $7)
     SELECT f.task, f.kind, EXISTS (SELECT 1 FROM blames x WHERE x.task = f.task AND x.worker = $4) AS is_blamed, ",
    live_bakes!("CAST(coalesce(json_agg(m.bake), '[]') AS TEXT)", "f.task"),
    ", (SELECT count(*) FROM first) AS seen FROM first f JOIN tasks t ON t.id = f.task
     WHERE t.state = 'ready' ORDER BY f.cost DESC, f.key LIMIT $6 FOR UPDATE OF t SKIP LOCKED"
);

/// Ready tasks that are read beside those wanted, as other claims may have locked some; the second number where that did not suffice.
const BESIDE: [usize; 2] = [16, 1024];

/// A bake that has ready tasks.
#[derive(Clone)]
struct OpenBake {
    seq: i64,
    id: String,
    scene: Digest,
    needs: Needs,
    attempt_limit_secs: Option<u32>,
    traceparent: Option<String>,
    /// It has a limit of workers.
    is_limited: bool,
}

/// A ready task that was found for a claim.
struct Found {
    task: i64,
    kind: String,
    is_blamed: bool,
    /// Live bakes that hold it.
    bakes: Vec<i64>,
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
    /// By bake, first tasks that were found and not looked at yet.
    found: BTreeMap<i64, VecDeque<Found>>,
    /// Bakes that have no others, or that somebody else has locked.
    emptied: BTreeSet<i64>,
    chosen: Vec<Chosen>,
    /// Tasks whose rows are locked.
    locked: BTreeSet<i64>,
}

/// Outcome of a claim.
pub(super) struct Claimed {
    pub(super) leases: Vec<Lease>,
    /// There are tasks whose bakes somebody else has locked.
    pub(super) has_left: bool,
}

pub(super) async fn claim(conn: &mut Conn, request: &ClaimRequest, locked: Locked) -> Result<Claimed> {
    // Note that the worker is present: tasks are left to workers that are.
    let seen = see_worker(conn, request).await?;
    // Load the other workers for one that failed before: it leaves tasks to them, nobody else does.
    let others = if seen.has_failed { Some(others(conn, request).await?) } else { None };
    // Choose before anything is written: on PostgreSQL the rows of chosen tasks are locked, and other claims pass them over.
    let mut claim = Claim::begin(conn, request, others, seen.scene)?;
    let (last, has_left) = claim.choose(locked).await?;
    let (chosen, scene) = (claim.chosen, claim.scene);
    // Write nothing for an idle worker's poll, unless it may verify a result: that never holds up a task.
    if chosen.is_empty() {
        let verifies = seen.has_reruns && !has_left;
        let rerun = if verifies { reruns::claim(conn, request).await? } else { None };
        return Ok(Claimed { leases: rerun.into_iter().collect(), has_left });
    }
    // Keep the scene with the worker, whose next claims prefer it.
    if let Some(scene) = scene.filter(|_| scene != seen.scene) {
        let sql = "UPDATE workers SET scene = $1 WHERE name = $2";
        query(sql).bind(scene.to_string()).bind(&request.worker).run(conn).await?;
    }
    // Mark all chosen tasks in one statement: round trips are most of a claim's time.
    let tasks: Vec<i64> = chosen.iter().map(|chosen| chosen.task).collect();
    let tasks = to_json(&tasks)?;
    let taken = grant::take_tasks(conn, &tasks).await?;
    // Read the outputs of dependencies only where there are any, as inputs name them by their tasks.
    let has_needs = taken.values().any(|taken| !dependencies(&taken.spec).is_empty());
    let outputs = if has_needs { outputs_of_needs(conn, &tasks).await? } else { BTreeMap::new() };
    // Find results of tasks alike only for tasks that have a name in common with any.
    let names: BTreeSet<Digest> = taken.values().filter_map(|taken| taken.spec.alike).collect();
    let alike = if names.is_empty() { BTreeMap::new() } else { outputs_of_alike(conn, &names).await? };
    grant::write_leases(conn, &chosen, &taken, last, request).await?;
    Ok(Claimed { leases: grant::leases(chosen, taken, &outputs, &alike), has_left })
}

impl<'a> Claim<'a> {
    fn begin(
        conn: &'a mut Conn,
        request: &'a ClaimRequest,
        others: Option<Vec<Other>>,
        scene: Option<Digest>,
    ) -> Result<Self> {
        let (kinds, abilities) = (to_json(&request.kinds)?, Abilities::of(request));
        let (passed, found, emptied) = (BTreeSet::new(), BTreeMap::new(), BTreeSet::new());
        let (chosen, locked) = (Vec::new(), BTreeSet::new());
        Ok(Self { conn, request, kinds, abilities, others, scene, passed, found, emptied, chosen, locked })
    }

    fn is_full(&self) -> bool {
        self.chosen.len() >= self.request.max as usize
    }

    /// Chooses tasks and locks all bakes that hold them; the number of each one's last event, and whether there are tasks whose bakes were
    /// left to others.
    async fn choose(&mut self, locked: Locked) -> Result<(BTreeMap<i64, u64>, bool)> {
        let (mut last, mut has_left) = (BTreeMap::new(), false);
        loop {
            let before = self.chosen.len();
            self.choose_with_locks().await?;
            let bakes = self.chosen[before..].iter().flat_map(|chosen| &chosen.bakes);
            let bakes: BTreeSet<i64> = bakes.filter(|bake| !last.contains_key(*bake)).copied().collect();
            if bakes.is_empty() {
                return Ok((last, has_left));
            }
            last.extend(grant::lock_bakes(self.conn, &bakes, locked).await?);
            let missing: Vec<i64> = bakes.into_iter().filter(|bake| !last.contains_key(bake)).collect();
            // Count workers again where there is a limit: other claims may have been granted before the lock was.
            let full = self.full(before).await?;
            if missing.is_empty() && full.is_empty() {
                return Ok((last, has_left));
            }
            // Look for tasks of other bakes in their place.
            has_left |= !missing.is_empty();
            self.chosen.retain(|chosen| {
                !full.contains(&chosen.seq) && chosen.bakes.iter().all(|bake| last.contains_key(bake))
            });
            for bake in missing.into_iter().chain(full) {
                self.emptied.insert(bake);
                self.found.remove(&bake);
            }
        }
    }

    /// Bakes with a limit of workers among those of the tasks chosen last that have no room for this one any more.
    async fn full(&mut self, before: usize) -> Result<Vec<i64>> {
        let limited = self.chosen[before..].iter().filter(|chosen| chosen.is_limited);
        let limited: BTreeSet<i64> = limited.map(|chosen| chosen.seq).collect();
        if limited.is_empty() || !self.conn.has_neighbours() {
            return Ok(Vec::new());
        }
        let sql = concat!(
            "SELECT b.seq FROM bakes b WHERE b.seq = ANY (ARRAY(SELECT CAST(value AS BIGINT) FROM json_each($1))) AND NOT ",
            has_room!("$2")
        );
        let rows = query(sql).bind(to_json(&limited)?).bind(&self.request.worker).all(self.conn).await?;
        rows.iter().map(|row| row.get("seq")).collect()
    }

    /// Chooses tasks whose rows are locked, and no others: who chose otherwise than he looked lets these go.
    async fn choose_with_locks(&mut self) -> Result<()> {
        let may_leave = self.conn.has_neighbours() && (self.request.max > 1 || self.others.is_some());
        if may_leave {
            query("SAVEPOINT choice").run(self.conn).await?;
        }
        let before = self.chosen.len();
        self.locked.clear();
        self.choose_all().await?;
        for chosen in &self.chosen[before..] {
            self.locked.remove(&chosen.task);
        }
        if !may_leave || self.locked.is_empty() {
            return Ok(());
        }
        query("ROLLBACK TO SAVEPOINT choice").run(self.conn).await?;
        for (bake, found) in std::mem::take(&mut self.found) {
            // There are others, after all.
            if !found.is_empty() {
                self.emptied.remove(&bake);
            }
        }
        let tasks: Vec<i64> = self.chosen[before..].iter().map(|chosen| chosen.task).collect();
        let sql =
            "SELECT id FROM tasks WHERE id = ANY (ARRAY(SELECT CAST(value AS BIGINT) FROM json_each($1)))
                   AND state = 'ready' FOR UPDATE SKIP LOCKED";
        let rows = query(sql).bind(to_json(&tasks)?).all(self.conn).await?;
        let locked = rows.iter().map(|row| row.get("id")).collect::<Result<BTreeSet<i64>>>()?;
        let mut index = 0;
        self.chosen.retain(|chosen| {
            index += 1;
            index <= before || locked.contains(&chosen.task)
        });
        Ok(())
    }

    async fn choose_all(&mut self) -> Result<()> {
        let (mut priority, mut seq) = (i64::MAX, 0_i64);
        while !self.is_full() {
            // Read a window of bakes: fairness holds among them, and the cost does not grow with all bakes of the farm.
            let sql = self.conn.pick(
                open_bakes!(
                    "SELECT 1 FROM json_each($4) k CROSS JOIN ready r INDEXED BY ready_by_kind
                     WHERE r.bake = b.seq AND r.kind = k.value AND r.not_before_ms <= $3 LIMIT 1"
                ),
                open_bakes!(
                    "SELECT 1 FROM json_each($4) k CROSS JOIN LATERAL (
                         SELECT 1 FROM ready r WHERE r.bake = b.seq AND r.kind = k.value AND r.not_before_ms <= $3
                         LIMIT 1) AS due LIMIT 1"
                ),
            );
            let rows = query(sql)
                .bind(priority)
                .bind(seq)
                .bind(self.conn.now_ms)
                .bind(&self.kinds)
                .bind(CLAIM_WINDOW)
                .bind(&self.request.worker)
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
                    is_limited: row.get("is_limited")?,
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
        while !self.is_full()
            && let Some(index) = next_contender(&contenders)
        {
            let bake = contenders[index].bake.clone();
            match self.first(&bake, contenders.len()).await? {
                Some(Found { task, bakes, .. }) => {
                    // Pass the task over from now on: it is offered until the leases are written.
                    self.passed.insert(task);
                    let deadline_ms = rules::deadline_ms(self.conn.now_ms, bake.attempt_limit_secs);
                    let expires_ms = self.conn.now_ms + i64::from(self.request.ttl_secs) * 1000;
                    // End the lease with the attempt's limit, so that no heartbeat carries it beyond.
                    let expires_ms = expires_ms.min(deadline_ms);
                    let (token, traceparent) = (random::fencing_token(), bake.traceparent);
                    self.chosen.push(Chosen {
                        task,
                        bakes,
                        bake: bake.id,
                        seq: bake.seq,
                        is_limited: bake.is_limited,
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
        Ok(())
    }

    /// The bake's first ready task that this worker need not leave to others; `bakes` share what the claim still wants.
    async fn first(&mut self, bake: &OpenBake, bakes: usize) -> Result<Option<Found>> {
        loop {
            if self.found.get(&bake.seq).is_none_or(VecDeque::is_empty) && !self.find(bake, bakes).await? {
                return Ok(None);
            }
            let next = self.found.get_mut(&bake.seq).and_then(VecDeque::pop_front);
            // Pass over what came by another of its bakes.
            let Some(found) = next.filter(|found| !self.passed.contains(&found.task)) else { continue };
            if !found.is_blamed || !self.is_left_to_others(bake, found.task, &found.kind).await? {
                return Ok(Some(found));
            }
            self.passed.insert(found.task);
        }
    }

    /// Finds the bake's next ready tasks, about as many as will be taken: on PostgreSQL each is kept from others. False
    /// if there are none.
    async fn find(&mut self, bake: &OpenBake, bakes: usize) -> Result<bool> {
        if self.emptied.contains(&bake.seq) {
            return Ok(false);
        }
        let wanted = (self.request.max as usize - self.chosen.len()).div_ceil(bakes.max(1));
        let mut rows = Vec::new();
        for beside in self.conn.pick(&[0][..], &BESIDE) {
            rows = self.read_first(bake, wanted, wanted + beside).await?;
            let seen = rows.first().map(|row| row.get::<i64>("seen")).transpose()?;
            // None of them was locked by others, or these do not count.
            if rows.len() == wanted || seen.is_some_and(|seen| seen < (wanted + beside) as i64) {
                break;
            }
        }
        if rows.len() < wanted {
            self.emptied.insert(bake.seq);
        }
        let found = self.found.entry(bake.seq).or_default();
        for row in &rows {
            let (task, kind, is_blamed) = (row.get("task")?, row.get("kind")?, row.get("is_blamed")?);
            self.locked.insert(task);
            found.push_back(Found { task, kind, is_blamed, bakes: row.json("bakes")? });
        }
        Ok(!rows.is_empty())
    }

    async fn read_first(&mut self, bake: &OpenBake, wanted: usize, read: usize) -> Result<Vec<Row>> {
        query(self.conn.pick(FIRST, FIRST_LOCKED))
            .bind(bake.seq)
            .bind(self.conn.now_ms)
            .bind(&self.kinds)
            .bind(&self.request.worker)
            .bind(to_json(&self.passed)?)
            .bind(wanted)
            .bind(read)
            .all(self.conn)
            .await
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
