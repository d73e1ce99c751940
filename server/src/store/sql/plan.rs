//! Adding tasks to a bake, in batches: the plans of tasks done already are followed layer by layer.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::panic::resume_unwind;
use std::thread;

use lightkiln_proto::api::EventKind;
use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::{MAX_PLAN_TASKS, TaskResult, TaskSpec};

use super::bulk::{self, COPIED_FROM, Field, Standing};
use super::chunks;
use super::codec::{ROWS_PER_STATEMENT, to_json};
use super::conn::{Conn, query};
use super::ledger::Ledger;
use super::ready::{self, Offer};
use crate::store::rules::{
    add_counters, check_plan, claim_cost, dependencies, is_same_task, named_artefacts,
};
use crate::store::{PlanError, Result, StoreError};

/// Plans up to so many tasks are checked on the caller's thread.
const CHECKED_HERE: usize = 64;
/// Tasks of a bigger plan that are checked before the caller's thread does something else: some milliseconds. More → it is held for longer.
const CHECKED_TOGETHER: usize = 4_000;
/// Most threads that check them.
const CHECKERS_MAX: usize = 8;

/// A task that the farm has.
struct Known {
    id: i64,
    spec: TaskSpec,
    state: String,
    is_member: bool,
}

/// A task added to the bake.
struct Added {
    key: TaskKey,
    needs: Vec<TaskKey>,
}

/// A task of the bake that others may depend on, as far as their states and edges tell.
#[derive(Clone, Copy)]
struct Needed {
    is_done: bool,
    cost: u64,
    /// Its row; none yet for a new task.
    id: Option<i64>,
}

/// Growth of one kind of task.
#[derive(Default)]
struct StageGain {
    total: u64,
    done: u64,
    leased: u64,
    cost_total: u64,
    cost_done: u64,
}

/// An addition under way. First all tasks are gathered and looked up, then they are written in the state that they will
/// have: a row that is changed again costs as much as a new one.
struct Addition<'a> {
    conn: &'a mut Conn,
    bake: &'a mut Ledger,
    added: Vec<Added>,
    /// Tasks that the farm does not have.
    fresh: BTreeMap<TaskKey, Cow<'a, TaskSpec>>,
    /// Looked up for each edge, and never walked.
    needed: HashMap<TaskKey, Needed>,
    /// Tasks that the farm has: each with whether it is done, and the place of its result.
    members: Vec<(i64, bool, Option<u64>)>,
    /// In order of first appearance.
    stages: Vec<(String, StageGain)>,
    reused: u64,
    /// Artefacts that the added tasks name, and those among them that are still to be read.
    named: BTreeSet<Digest>,
    required: BTreeSet<Digest>,
}

/// Checks what can be seen in a plan alone ([`check_plan`]), before any lock is taken: every task is hashed. Long plans are checked in
/// parts, on all processors, and callers of other calls get their turns in between.
pub(super) async fn check(plan: &[TaskSpec]) -> Result<(), PlanError> {
    if plan.len() <= CHECKED_HERE || plan.len() > MAX_PLAN_TASKS {
        return check_plan(plan);
    }
    let threads = thread::available_parallelism().map_or(1, usize::from).min(CHECKERS_MAX);
    for part in plan.chunks(CHECKED_TOGETHER) {
        check_side_by_side(part, threads)?;
        tokio::task::yield_now().await;
    }
    Ok(())
}

/// Checks tasks on some threads; of several faults the first in the plan counts.
fn check_side_by_side(plan: &[TaskSpec], threads: usize) -> Result<(), PlanError> {
    thread::scope(|scope| {
        let check = |part| {
            let spawned = thread::Builder::new().spawn_scoped(scope, move || check_plan(part));
            // Where no thread is to be had, this one does it.
            spawned.map_err(|_| check_plan(part))
        };
        let checks: Vec<_> = plan.chunks(plan.len().div_ceil(threads)).map(check).collect();
        checks.into_iter().try_for_each(|check| match check {
            Ok(thread) => thread.join().unwrap_or_else(|panic| resume_unwind(panic)),
            Err(checked) => checked,
        })
    })
}

/// Adds `plan` to the bake. The ledger is changed, not saved. `made` are the tasks that this transaction made.
pub(super) async fn apply_plan(
    conn: &mut Conn,
    bake: &mut Ledger,
    plan: &[TaskSpec],
    made: &mut BTreeSet<TaskKey>,
) -> Result<()> {
    let mut addition = Addition::new(conn, bake);
    let mut layer: Vec<Cow<'_, TaskSpec>> = plan.iter().map(Cow::Borrowed).collect();
    while !layer.is_empty() {
        layer = addition.add_layer(layer, made).await?.into_iter().map(Cow::Owned).collect();
    }
    if addition.added.is_empty() {
        return Ok(());
    }
    addition.write().await?;
    made.extend(addition.fresh.keys());
    chunks::refer(addition.conn, addition.bake.seq, &addition.named, &addition.required).await?;
    addition.write_stages().await?;
    let (tasks, reused) = (addition.added.len() as u64, addition.reused);
    bake.open_count += tasks - reused;
    bake.tasks_reused += reused;
    bake.event(EventKind::Planned { tasks, reused });
    Ok(())
}

impl<'a> Addition<'a> {
    fn new(conn: &'a mut Conn, bake: &'a mut Ledger) -> Self {
        let (added, members, stages) = (Vec::new(), Vec::new(), Vec::new());
        let (fresh, needed) = (BTreeMap::new(), HashMap::new());
        let (named, required) = (BTreeSet::new(), BTreeSet::new());
        Self { conn, bake, added, fresh, needed, members, stages, reused: 0, named, required }
    }

    /// Adds tasks, and returns those planned by the ones that are done already.
    async fn add_layer(
        &mut self,
        layer: Vec<Cow<'a, TaskSpec>>,
        made: &BTreeSet<TaskKey>,
    ) -> Result<Vec<TaskSpec>> {
        // Beside others, a plan that names a task of the farm was left out before; the first bake's tasks are all new.
        let is_new = self.conn.has_neighbours() && made.is_empty();
        let known = if is_new { BTreeMap::new() } else { self.known(&layer).await? };
        // A task that somebody else makes at the same time has bakes that are not locked here: the call is run again, and
        // finds it before it takes any lock.
        if self.conn.has_neighbours() && !known.keys().all(|key| made.contains(key)) {
            return Err(StoreError::Contended("a planned task was made meanwhile".into()));
        }
        let mut done: Vec<i64> = Vec::new();
        for spec in layer {
            let key = spec.key;
            let earlier =
                known.get(&key).map(|known| &known.spec).or_else(|| self.fresh.get(&key).map(Cow::as_ref));
            if earlier.is_some_and(|earlier| !is_same_task(earlier, &spec)) {
                return Err(PlanError::KeyClash { key }.into());
            }
            let known = known.get(&key);
            if self.needed.contains_key(&key) || known.is_some_and(|known| known.is_member) {
                continue;
            }
            let is_done = known.is_some_and(|known| known.state == "done");
            let cost = known.map_or(spec.cost, |known| known.spec.cost);
            self.needed.insert(key, Needed { is_done, cost, id: known.map(|known| known.id) });
            match known {
                Some(task) => {
                    self.count(&task.spec, &task.state);
                    self.added.push(Added { key, needs: dependencies(&task.spec) });
                    let place = is_done.then(|| self.bake.next_place());
                    self.members.push((task.id, is_done, place));
                    if is_done {
                        done.push(task.id);
                    }
                }
                None => {
                    self.count(&spec, "ready");
                    self.added.push(Added { key, needs: dependencies(&spec) });
                    self.fresh.insert(key, spec);
                }
            }
        }
        self.reuse(&done).await
    }

    /// Writes tasks, members and edges, and offers tasks that need nothing any more.
    async fn write(&mut self) -> Result<()> {
        self.find_dependencies().await?;
        let known: Vec<i64> = self.members.iter().map(|(id, ..)| *id).collect();
        let is_copied = self.conn.pick(false, self.fresh.len() >= COPIED_FROM);
        let offers = if is_copied { self.copy_fresh().await? } else { self.insert_tasks().await? };
        self.insert_members().await?;
        self.insert_edges(is_copied).await?;
        ready::offer_in(self.conn, self.bake.seq, &known).await?;
        ready::offer_new(self.conn, self.bake.seq, &offers).await
    }

    fn count(&mut self, spec: &TaskSpec, state: &str) {
        self.named.extend(named_artefacts(spec));
        if state != "done" {
            self.required.extend(named_artefacts(spec));
        }
        let index = self.stages.iter().position(|(kind, _)| *kind == spec.kind).unwrap_or_else(|| {
            self.stages.push((spec.kind.clone(), StageGain::default()));
            self.stages.len() - 1
        });
        let gain = &mut self.stages[index].1;
        gain.total += 1;
        gain.cost_total += spec.cost;
        match state {
            "leased" => gain.leased += 1,
            "done" => {
                gain.done += 1;
                gain.cost_done += spec.cost;
            }
            _ => (),
        }
    }

    async fn known(&mut self, layer: &[Cow<'_, TaskSpec>]) -> Result<BTreeMap<TaskKey, Known>> {
        let sql = "SELECT t.id, t.key, t.kind, t.version, t.params, t.inputs, t.cost, t.state,
                   EXISTS (SELECT 1 FROM bake_tasks m WHERE m.bake = $1 AND m.task = t.id) AS is_member
                   FROM json_each($2) j JOIN tasks t ON t.key = j.value";
        let mut known = BTreeMap::new();
        for specs in layer.chunks(ROWS_PER_STATEMENT) {
            let keys: Vec<TaskKey> = specs.iter().map(|spec| spec.key).collect();
            for row in query(sql).bind(self.bake.seq).bind(to_json(&keys)?).all(self.conn).await? {
                let key = row.digest("key")?;
                let spec = TaskSpec {
                    key,
                    kind: row.get("kind")?,
                    version: row.small("version")?,
                    label: String::new(),
                    params: row.json("params")?,
                    inputs: row.json("inputs")?,
                    cost: row.count("cost")?,
                    alike: None,
                };
                let (id, state) = (row.get("id")?, row.get("state")?);
                known.insert(key, Known { id, spec, state, is_member: row.get("is_member")? });
            }
        }
        Ok(known)
    }

    /// Makes the new tasks; returns those that can be claimed, as [`ready::offer_new`] takes them.
    async fn insert_tasks(&mut self) -> Result<Vec<Offer>> {
        let sql = self.conn.pick(
            "INSERT INTO tasks (key, kind, label, params, inputs, cost, alike, version, state, waiting_count, claim_cost)
             SELECT value ->> 0, value ->> 1, value ->> 2, value ->> 3, value ->> 4, value ->> 5, value ->> 6, value ->> 7,
             value ->> 8, value ->> 9, value ->> 10 FROM json_each($1) RETURNING id, key",
            "INSERT INTO tasks (key, kind, label, params, inputs, cost, alike, version, state, waiting_count, claim_cost)
             SELECT v ->> 0, v ->> 1, v ->> 2, v ->> 3, v ->> 4, (v ->> 5)::bigint, v ->> 6, (v ->> 7)::bigint, v ->> 8,
             (v ->> 9)::bigint, (v ->> 10)::bigint FROM jsonb_array_elements($1::jsonb) AS j (v) RETURNING id, key",
        );
        // In the order of their keys: two additions that make the same tasks wait for each other in one order.
        let specs: Vec<&TaskSpec> = self.fresh.values().map(Cow::as_ref).collect();
        let mut offers = Vec::new();
        for specs in specs.chunks(ROWS_PER_STATEMENT) {
            let (mut rows, mut free) = (Vec::with_capacity(specs.len()), BTreeMap::new());
            for spec in specs {
                let (standing, cost) = standing(spec, &self.needed);
                let (params, inputs) = (to_json(&spec.params)?, to_json(&spec.inputs)?);
                let TaskSpec { key, kind, label, alike, version, .. } = spec;
                let Standing { state, waiting_count, claim_cost } = standing;
                let place = (state, waiting_count, claim_cost);
                rows.push((
                    key, kind, label, params, inputs, spec.cost, alike, version, place.0, place.1, place.2,
                ));
                if waiting_count == 0 {
                    free.insert(*key, (cost, kind));
                }
            }
            for row in query(sql).bind(to_json(&rows)?).all(self.conn).await? {
                let (id, key) = (row.get("id")?, row.digest("key")?);
                self.needed.entry(key).and_modify(|task| task.id = Some(id));
                self.members.push((id, false, None));
                if let Some((cost, kind)) = free.get(&key) {
                    offers.push(Offer { cost: *cost, key, task: id, kind: (*kind).clone() });
                }
            }
        }
        Ok(offers)
    }

    /// Makes the new tasks of a big plan, with all that belongs to them; returns those that are left to be offered: none.
    async fn copy_fresh(&mut self) -> Result<Vec<Offer>> {
        let (bake, now_ms) = (self.bake.seq, self.conn.now_ms);
        let ids = bulk::task_ids(self.conn, self.fresh.len()).await?;
        for (id, key) in ids.iter().zip(self.fresh.keys()) {
            self.needed.entry(*key).and_modify(|task| task.id = Some(*id));
        }
        let fresh: Vec<NewTask<'_>> = ids
            .iter()
            .zip(self.fresh.values())
            .map(|(id, spec)| NewTask::of(*id, spec, &self.needed))
            .collect();
        let edges = self.edges(|key| self.fresh.contains_key(key));
        let conn = &mut *self.conn;
        bulk::copy(conn, bulk::TASKS, &fresh, |rows, task| {
            bulk::push_task(rows, task.id, task.spec, &task.standing)
        })
        .await?;
        bulk::copy(conn, bulk::MEMBERS, &ids, |rows, id| {
            rows.push(&[Field::Int(bake), Field::Int(*id), Field::Int(0), Field::Int(0)]);
            Ok(())
        })
        .await?;
        bulk::copy(conn, bulk::EDGES, &edges, |rows, (task, needs)| {
            rows.push(&[Field::Int(*task), Field::Int(*needs)]);
            Ok(())
        })
        .await?;
        bulk::copy(conn, bulk::READY, &fresh, |rows, task| {
            if task.standing.waiting_count == 0 {
                bulk::push_ready(rows, (bake, task.id), task.spec, task.cost, now_ms);
            }
            Ok(())
        })
        .await?;
        Ok(Vec::new())
    }

    /// Adds the tasks to the bake.
    async fn insert_members(&mut self) -> Result<()> {
        let sql = self.conn.pick(
            "INSERT INTO bake_tasks (bake, task, done, reused, place)
             SELECT $1, value ->> 0, value ->> 1, value ->> 1, value ->> 2 FROM json_each($2)",
            "INSERT INTO bake_tasks (bake, task, done, reused, place)
             SELECT $1, (v ->> 0)::bigint, (v ->> 1)::boolean::int, (v ->> 1)::boolean::int, (v ->> 2)::bigint
             FROM jsonb_array_elements($2::jsonb) AS j (v)",
        );
        for members in self.members.chunks(ROWS_PER_STATEMENT) {
            query(sql).bind(self.bake.seq).bind(to_json(members)?).run(self.conn).await?;
        }
        Ok(())
    }

    /// Takes over the results of tasks that are done; returns the tasks that they planned.
    async fn reuse(&mut self, done: &[i64]) -> Result<Vec<TaskSpec>> {
        let sql =
            "SELECT r.outputs, r.plan, r.counters FROM json_each($1) j JOIN results r ON r.task = CAST(j.value AS BIGINT)
                   ORDER BY j.key";
        let mut planned = Vec::new();
        for ids in done.chunks(ROWS_PER_STATEMENT) {
            for row in query(sql).bind(to_json(ids)?).all(self.conn).await? {
                let result = TaskResult {
                    outputs: row.json("outputs")?,
                    plan: row.json("plan")?,
                    counters: row.json("counters")?,
                    ..TaskResult::default()
                };
                self.bake.note_outputs(&result.outputs);
                add_counters(&mut self.bake.counters_reused, &result.counters);
                planned.extend(result.plan);
            }
        }
        self.reused += done.len() as u64;
        Ok(planned)
    }

    /// Edges of dependencies of some of the added tasks, in the order of their rows.
    fn edges(&self, of: impl Fn(&TaskKey) -> bool) -> Vec<(i64, i64)> {
        let mut edges = Vec::new();
        for task in self.added.iter().filter(|task| of(&task.key)) {
            let id_of = |key| self.needed.get(key).and_then(|task| task.id);
            let Some(id) = id_of(&task.key) else { continue };
            edges.extend(task.needs.iter().filter_map(id_of).map(|needs| (id, needs)));
        }
        edges.sort_unstable();
        edges.dedup();
        edges
    }

    /// Writes the edges of dependencies; those of new tasks may be there already.
    async fn insert_edges(&mut self, is_copied: bool) -> Result<()> {
        let edges = self.edges(|key| !is_copied || !self.fresh.contains_key(key));
        // A task that was there has its edges, unless a dependency was forgotten meanwhile.
        let sql = self.conn.pick(
            "INSERT OR IGNORE INTO task_needs (task, needs) SELECT value ->> 0, value ->> 1 FROM json_each($1)",
            "INSERT INTO task_needs (task, needs) SELECT (v ->> 0)::bigint, (v ->> 1)::bigint
             FROM jsonb_array_elements($1::jsonb) AS j (v) ON CONFLICT DO NOTHING",
        );
        for edges in edges.chunks(ROWS_PER_STATEMENT) {
            query(sql).bind(to_json(edges)?).run(self.conn).await?;
        }
        Ok(())
    }

    /// Finds dependencies that the bake held before; every other one must be added with the tasks.
    async fn find_dependencies(&mut self) -> Result<()> {
        let needs = self.added.iter().flat_map(|task| &task.needs);
        let before: BTreeSet<TaskKey> = needs.filter(|key| !self.needed.contains_key(key)).copied().collect();
        let before: Vec<TaskKey> = before.into_iter().collect();
        let sql = "SELECT t.id, t.key, t.cost, t.state FROM json_each($1) j JOIN tasks t ON t.key = j.value
                   JOIN bake_tasks m ON m.task = t.id AND m.bake = $2";
        for keys in before.chunks(ROWS_PER_STATEMENT) {
            for row in query(sql).bind(to_json(keys)?).bind(self.bake.seq).all(self.conn).await? {
                let (key, is_done) = (row.digest("key")?, row.text("state")? == "done");
                let (cost, id) = (row.count("cost")?, Some(row.get("id")?));
                self.needed.insert(key, Needed { is_done, cost, id });
            }
        }
        let mut needs = self.added.iter().flat_map(|task| &task.needs);
        match needs.find(|key| !self.needed.contains_key(key)) {
            Some(needs) => Err(PlanError::UnknownDependency { needs: *needs }.into()),
            None => Ok(()),
        }
    }

    async fn write_stages(&mut self) -> Result<()> {
        let sql = "INSERT INTO stages
                   (bake, kind, position, total, done, reused, leased, cost_total, cost_done, first_claim_ms)
                   VALUES ($1, $2, (SELECT count(*) FROM stages WHERE bake = $1), $3, $4, $4, $5, $6, $7, $8)
                   ON CONFLICT (bake, kind) DO UPDATE SET
                   total = stages.total + excluded.total, done = stages.done + excluded.done,
                   reused = stages.reused + excluded.reused, leased = stages.leased + excluded.leased,
                   cost_total = stages.cost_total + excluded.cost_total,
                   cost_done = stages.cost_done + excluded.cost_done,
                   first_claim_ms = coalesce(stages.first_claim_ms, excluded.first_claim_ms)";
        for (kind, gain) in &self.stages {
            query(sql)
                .bind(self.bake.seq)
                .bind(kind)
                .bind(gain.total)
                .bind(gain.done)
                .bind(gain.leased)
                .bind(gain.cost_total)
                .bind(gain.cost_done)
                .bind((gain.leased > 0).then_some(self.conn.now_ms))
                .run(self.conn)
                .await?;
        }
        Ok(())
    }
}

/// A new task with its number.
struct NewTask<'a> {
    id: i64,
    spec: &'a TaskSpec,
    standing: Standing,
    /// Cost by which it is claimed.
    cost: u64,
}

impl<'a> NewTask<'a> {
    fn of(id: i64, spec: &'a TaskSpec, needed: &HashMap<TaskKey, Needed>) -> Self {
        let (standing, cost) = standing(spec, needed);
        Self { id, spec, standing, cost }
    }
}

/// The state in which a new task is written, and the cost that it is claimed by.
fn standing(spec: &TaskSpec, needed: &HashMap<TaskKey, Needed>) -> (Standing, u64) {
    let needs: Vec<Needed> = dependencies(spec).iter().filter_map(|key| needed.get(key).copied()).collect();
    let waiting_count = needs.iter().filter(|needed| !needed.is_done).count();
    let cost = claim_cost(spec.cost, needs.iter().map(|needed| needed.cost));
    let state = if waiting_count == 0 { "ready" } else { "waiting" };
    let claim_cost = (cost != spec.cost).then_some(cost);
    (Standing { state, waiting_count, claim_cost }, cost)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_fault_of_a_plan_counts_on_any_number_of_threads() {
        let task = |number: u32| TaskSpec::new("work", 1, "", serde_json::json!(number), Vec::new(), 1);
        let mut plan: Vec<TaskSpec> = (0..50).map(task).collect();
        for threads in [1, 2, 7, 64] {
            assert_eq!(check_side_by_side(&plan, threads), Ok(()));
        }
        plan[20].kind = "other".into();
        plan[40].kind = "other".into();
        let (key, computed) = (plan[20].key, plan[20].computed_key());
        for threads in [1, 2, 7, 64] {
            assert_eq!(check_side_by_side(&plan, threads), Err(PlanError::WrongKey { key, computed }));
        }
    }
}
