//! Adding tasks to a bake, in batches: the plans of tasks done already are followed layer by layer.

use std::collections::{BTreeMap, BTreeSet};

use lightkiln_proto::api::EventKind;
use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::{TaskResult, TaskSpec};
use serde_json::json;

use super::chunks;
use super::codec::{ROWS_PER_STATEMENT, to_json};
use super::conn::{Conn, query};
use super::ledger::Ledger;
use super::ready;
use crate::store::rules::{add_counters, dependencies, is_same_task, named_artefacts};
use crate::store::{PlanError, Result};

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

/// Growth of one kind of task.
#[derive(Default)]
struct StageGain {
    total: u64,
    done: u64,
    leased: u64,
    cost_total: u64,
    cost_done: u64,
}

/// An addition under way.
struct Addition<'a> {
    conn: &'a mut Conn,
    bake: &'a mut Ledger,
    added: Vec<Added>,
    ids: BTreeMap<TaskKey, i64>,
    /// Ids that this addition made.
    fresh: Vec<i64>,
    /// In order of first appearance.
    stages: Vec<(String, StageGain)>,
    reused: u64,
    /// Artefacts that the added tasks name, and those among them that are still to be read.
    named: BTreeSet<Digest>,
    required: BTreeSet<Digest>,
}

/// Adds `plan` to the bake. The ledger is changed, not saved.
pub(super) async fn apply_plan(conn: &mut Conn, bake: &mut Ledger, plan: &[TaskSpec]) -> Result<()> {
    let (added, ids, fresh, stages) = (Vec::new(), BTreeMap::new(), Vec::new(), Vec::new());
    let (named, required) = (BTreeSet::new(), BTreeSet::new());
    let mut addition = Addition { conn, bake, added, ids, fresh, stages, reused: 0, named, required };
    let mut layer = plan.to_vec();
    while !layer.is_empty() {
        layer = addition.add_layer(layer).await?;
    }
    if addition.added.is_empty() {
        return Ok(());
    }
    addition.link().await?;
    chunks::refer(addition.conn, addition.bake.seq, &addition.named, &addition.required).await?;
    addition.write_stages().await?;
    let (tasks, reused) = (addition.added.len() as u64, addition.reused);
    bake.open_count += tasks - reused;
    bake.tasks_reused += reused;
    bake.event(EventKind::Planned { tasks, reused });
    Ok(())
}

impl Addition<'_> {
    /// Adds tasks, and returns those planned by the ones that are done already.
    async fn add_layer(&mut self, layer: Vec<TaskSpec>) -> Result<Vec<TaskSpec>> {
        let known = self.known(&layer).await?;
        let mut fresh: BTreeMap<TaskKey, TaskSpec> = BTreeMap::new();
        let mut members: Vec<(i64, bool, Option<u64>)> = Vec::new();
        let mut done: Vec<i64> = Vec::new();
        for spec in layer {
            let key = spec.key;
            let earlier = known.get(&key).map(|known| &known.spec).or_else(|| fresh.get(&key));
            if earlier.is_some_and(|earlier| !is_same_task(earlier, &spec)) {
                return Err(PlanError::KeyClash { key }.into());
            }
            let known = known.get(&key);
            if self.ids.contains_key(&key) || fresh.contains_key(&key) || known.is_some_and(|k| k.is_member) {
                continue;
            }
            match known {
                Some(task) => {
                    self.count(&task.spec, &task.state);
                    self.added.push(Added { key, needs: dependencies(&task.spec) });
                    self.ids.insert(key, task.id);
                    let is_done = task.state == "done";
                    let place = is_done.then(|| self.bake.next_place());
                    members.push((task.id, is_done, place));
                    if is_done {
                        done.push(task.id);
                    }
                }
                None => {
                    self.count(&spec, "ready");
                    self.added.push(Added { key, needs: dependencies(&spec) });
                    fresh.insert(key, spec);
                }
            }
        }
        let ids = self.insert_tasks(&fresh).await?;
        members.extend(ids.iter().map(|id| (*id, false, None)));
        self.insert_members(&members).await?;
        self.fresh.extend(ids);
        self.reuse(&done).await
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

    async fn known(&mut self, layer: &[TaskSpec]) -> Result<BTreeMap<TaskKey, Known>> {
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

    /// Makes new tasks, ready until [`Addition::link`] says otherwise; returns their ids.
    async fn insert_tasks(&mut self, fresh: &BTreeMap<TaskKey, TaskSpec>) -> Result<Vec<i64>> {
        let sql = self.conn.pick(
            "INSERT INTO tasks (key, kind, label, params, inputs, cost, alike, version, state, waiting_count)
             SELECT value ->> 0, value ->> 1, value ->> 2, value ->> 3, value ->> 4, value ->> 5, value ->> 6, value ->> 7, 'ready', 0
             FROM json_each($1) RETURNING id, key",
            "INSERT INTO tasks (key, kind, label, params, inputs, cost, alike, version, state, waiting_count)
             SELECT v ->> 0, v ->> 1, v ->> 2, v ->> 3, v ->> 4, (v ->> 5)::bigint, v ->> 6, (v ->> 7)::bigint, 'ready', 0
             FROM jsonb_array_elements($1::jsonb) AS j (v) RETURNING id, key",
        );
        let specs: Vec<&TaskSpec> = fresh.values().collect();
        let mut ids = Vec::with_capacity(specs.len());
        for specs in specs.chunks(ROWS_PER_STATEMENT) {
            let mut rows = Vec::with_capacity(specs.len());
            for spec in specs {
                let (params, inputs) = (to_json(&spec.params)?, to_json(&spec.inputs)?);
                let TaskSpec { key, kind, label, cost, alike, version, .. } = spec;
                rows.push(json!([key, kind, label, params, inputs, cost, alike, version]));
            }
            for row in query(sql).bind(to_json(&rows)?).all(self.conn).await? {
                let id = row.get("id")?;
                self.ids.insert(row.digest("key")?, id);
                ids.push(id);
            }
        }
        Ok(ids)
    }

    /// Adds tasks to the bake, each with whether it is done and the place of its result.
    async fn insert_members(&mut self, members: &[(i64, bool, Option<u64>)]) -> Result<()> {
        let sql = self.conn.pick(
            "INSERT INTO bake_tasks (bake, task, done, reused, place)
             SELECT $1, value ->> 0, value ->> 1, value ->> 1, value ->> 2 FROM json_each($2)",
            "INSERT INTO bake_tasks (bake, task, done, reused, place)
             SELECT $1, (v ->> 0)::bigint, (v ->> 1)::boolean::int, (v ->> 1)::boolean::int, (v ->> 2)::bigint
             FROM jsonb_array_elements($2::jsonb) AS j (v)",
        );
        for members in members.chunks(ROWS_PER_STATEMENT) {
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

    /// Writes the edges of dependencies, and offers tasks without open ones.
    async fn link(&mut self) -> Result<()> {
        self.find_dependencies().await?;
        let mut edges = Vec::new();
        for task in &self.added {
            for needs in &task.needs {
                match (self.ids.get(&task.key), self.ids.get(needs)) {
                    (Some(task), Some(needs)) => edges.push((*task, *needs)),
                    _ => return Err(PlanError::UnknownDependency { needs: *needs }.into()),
                }
            }
        }
        // A task that was there has its edges, unless a dependency was forgotten meanwhile.
        let sql = self.conn.pick(
            "INSERT OR IGNORE INTO task_needs (task, needs) SELECT value ->> 0, value ->> 1 FROM json_each($1)",
            "INSERT INTO task_needs (task, needs) SELECT (v ->> 0)::bigint, (v ->> 1)::bigint
             FROM jsonb_array_elements($1::jsonb) AS j (v) ON CONFLICT DO NOTHING",
        );
        for edges in edges.chunks(ROWS_PER_STATEMENT) {
            query(sql).bind(to_json(edges)?).run(self.conn).await?;
        }
        let count = "UPDATE tasks SET waiting_count = (SELECT count(*) FROM task_needs n JOIN tasks d ON d.id = n.needs
                     WHERE n.task = tasks.id AND d.state <> 'done') WHERE id IN (SELECT CAST(value AS BIGINT) FROM json_each($1))";
        let wait = "UPDATE tasks SET state = 'waiting'
                    WHERE id IN (SELECT CAST(value AS BIGINT) FROM json_each($1)) AND waiting_count > 0";
        // As rules::claim_cost has it.
        let rank = "UPDATE tasks SET claim_cost = (SELECT max(d.cost) + 1 FROM task_needs n JOIN tasks d ON d.id = n.needs
                                                   WHERE n.task = tasks.id)
                    WHERE id IN (SELECT CAST(value AS BIGINT) FROM json_each($1))
                    AND cost <= (SELECT max(d.cost) FROM task_needs n JOIN tasks d ON d.id = n.needs
                                 WHERE n.task = tasks.id)";
        for fresh in self.fresh.chunks(ROWS_PER_STATEMENT) {
            let fresh = to_json(fresh)?;
            for sql in [count, wait, rank] {
                query(sql).bind(&fresh).run(self.conn).await?;
            }
        }
        let ids: Vec<i64> = self.added.iter().filter_map(|task| self.ids.get(&task.key).copied()).collect();
        ready::offer_in(self.conn, self.bake.seq, &ids).await
    }

    /// Finds the ids of dependencies that the bake held before.
    async fn find_dependencies(&mut self) -> Result<()> {
        let mut before: Vec<TaskKey> = self.added.iter().flat_map(|task| &task.needs).copied().collect();
        before.retain(|key| !self.ids.contains_key(key));
        before.sort_unstable();
        before.dedup();
        let sql = "SELECT t.id, t.key FROM json_each($1) j JOIN tasks t ON t.key = j.value
                   JOIN bake_tasks m ON m.task = t.id AND m.bake = $2";
        for keys in before.chunks(ROWS_PER_STATEMENT) {
            for row in query(sql).bind(to_json(keys)?).bind(self.bake.seq).all(self.conn).await? {
                self.ids.insert(row.digest("key")?, row.get("id")?);
            }
        }
        Ok(())
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
