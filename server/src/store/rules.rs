//! The queue's rules as pure functions and constants; every store follows these.

use std::collections::{BTreeMap, BTreeSet};

use lightkiln_proto::api::{ClaimRequest, Needs};
use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::{Artefact, MAX_PLAN_TASKS, REPORT_OUTPUT, TaskInput, TaskSpec};

use super::PlanError;

/// Failed attempts after which a task is given up. Workers that are lost do not count here.
pub const MAX_ATTEMPTS: u32 = 5;
/// Distinct workers after whose failures a task counts as poison and is given up.
pub const POISON_WORKERS: u32 = 3;
/// Times that a worker is lost with a task before that is given up, unless the farm's owner says otherwise. More → a farm whose
/// machines come and go fails fewer bakes, and a task that kills its workers takes more of them.
pub const LOST_WORKERS: u32 = 50;
/// Step of the wait before a task is tried again: each loss of a worker but the first adds one.
pub const LOST_STEP_MS: i64 = 1_000;
/// Longest wait of any retry, whether workers failed or were lost. One that lies further ahead is a clock's that was set back.
pub const WAIT_MAX_MS: i64 = 60_000;
/// Distinct tasks of a bake at which a worker fails before it gets none of that bake any more while others can.
pub const BLOCK_TASKS: u64 = 3;
/// Time that one attempt may take unless the bake says otherwise: a day.
pub const ATTEMPT_LIMIT_SECS: u32 = 86_400;
/// Bakes with ready tasks that a claim looks at together; among them it shares fairly. More → fairer among many
/// bakes, dearer claims.
pub const CLAIM_WINDOW: usize = 64;
/// A bake whose scene the worker had last counts as if it had so many fewer tasks under way. More → scenes are fetched
/// less often, and bakes get less even shares.
pub const LOCALITY_LEASES: i64 = 2;
/// First wait before a task failed by a worker is tried again; doubles with each attempt.
pub const BACKOFF_FIRST_MS: i64 = 1_000;
/// Longest such wait.
pub const BACKOFF_MAX_MS: i64 = WAIT_MAX_MS;
/// A worker heard within this time counts as present when a task looks for another worker.
pub const WORKER_PRESENT_MS: i64 = 60_000;
/// A worker heard within this time is listed.
pub const WORKER_LISTED_MS: i64 = 600_000;
/// A worker's last-heard time is written at most this often: idle polling costs no disk writes.
pub const WORKER_SEEN_GRAIN_MS: i64 = 5_000;
/// A chunk's last use is written at most this often.
pub const CHUNK_USED_GRAIN_MS: i64 = 60_000;
/// Most attempts at a task that are given back because their workers were silent for longer than a lease, and alive. More
/// → a database that is slow for long fails fewer bakes, and a worker that is stuck again and again holds a task up for longer.
pub const MAX_PARDONS: u32 = MAX_ATTEMPTS;
/// Leases of a task that ran out are remembered, for holders that are heard later, up to this number; beyond it those alone that count as
/// losses, which are bounded. More → results that come later still are compared, in more rows of tasks that nobody begins.
pub const MAX_EXPIRED: u32 = 64;
/// Results of a bake's tasks that differ are told in its log up to this number; all are counted. More → longer logs of bakes whose tasks give
/// other bytes each time.
pub const MAX_ALARMS_TOLD: u32 = 100;
/// Most times that a lease is given its whole length again, for the farm's silence, before its worker is heard. More → workers
/// outlast more restarts in quick succession, and while a server crashes again and again, tasks of dead workers wait longer.
pub const MAX_GRACES: u32 = 5;
/// A page of results ends with the one that brings the JSON of their outputs to so many bytes, or before.
pub const RESULTS_PAGE_BYTES: u64 = 1 << 20;
/// Longest failure message kept, in characters.
pub const MAX_MESSAGE_CHARS: usize = 4_000;
/// Longest kind and label of a task, in bytes.
pub const MAX_TASK_NAME_BYTES: usize = 400;
/// Largest cost of one task; a million of them still add up in 64 bits.
pub const MAX_TASK_COST: u64 = 1 << 40;

/// Wait before attempt `attempts + 1`: 1 s, 2 s, 4 s … up to a minute.
pub fn backoff_ms(attempts: u32) -> i64 {
    let doublings = attempts.saturating_sub(1).min(16);
    (BACKOFF_FIRST_MS << doublings).min(BACKOFF_MAX_MS)
}

/// The same with jitter, between half of it and all: tasks that failed together are not tried again together.
///
/// The jitter is a function of the task and the attempt, so that every store waits alike.
pub fn retry_wait_ms(key: TaskKey, attempts: u32) -> i64 {
    jittered(backoff_ms(attempts), key, attempts)
}

/// Between half of a wait and all of it.
fn jittered(wait: i64, key: TaskKey, attempts: u32) -> i64 {
    let mut mixed = key.0.to_vec();
    mixed.extend(attempts.to_le_bytes());
    let share = (Digest::of(&mixed).short() >> 32) as i64;
    wait / 2 + (((wait - wait / 2) * share) >> 32)
}

/// Wait before a task is tried again with which so many workers were lost: none at first, as machines go, then longer each time, so
/// that a task that kills its workers takes few of them an hour. With jitter as [`retry_wait_ms`] has it.
pub fn lost_wait_ms(key: TaskKey, losses: u32) -> i64 {
    let wait = (LOST_STEP_MS * i64::from(losses.saturating_sub(1))).min(WAIT_MAX_MS);
    jittered(wait, key, losses)
}

/// Rules that a farm's owner may change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FarmRules {
    /// Workers that may be lost with one task before it is given up.
    pub lost_workers: u32,
}

impl Default for FarmRules {
    fn default() -> Self {
        Self { lost_workers: LOST_WORKERS }
    }
}

/// Properties of a worker that claims compare with needs.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Abilities {
    /// Kinds of tasks that it runs.
    pub kinds: Vec<String>,
    /// Threads that its tasks may use.
    pub threads: u32,
    /// Memory that its tasks may use.
    pub memory_mib: u32,
    /// Labels that bakes may ask for.
    pub labels: Vec<String>,
}

impl Abilities {
    /// Those of the worker that claims.
    pub fn of(request: &ClaimRequest) -> Self {
        let ClaimRequest { kinds, threads, memory_mib, labels, .. } = request.clone();
        Self { kinds, threads, memory_mib, labels }
    }

    /// Whether such a worker could do tasks that another asks for.
    pub fn can_replace(&self, request: &ClaimRequest, needs: &Needs) -> bool {
        self.kinds.iter().any(|kind| request.kinds.contains(kind)) && self.suffice(needs)
    }

    /// Whether such a worker may take a bake's tasks.
    pub fn suffice(&self, needs: &Needs) -> bool {
        self.threads >= needs.threads
            && self.memory_mib >= needs.memory_mib
            && needs.labels.iter().all(|label| self.labels.contains(label))
    }
}

/// A bake with ready tasks, as a claim weighs it.
#[derive(Clone, Debug)]
pub struct Contender<B> {
    /// The bake, in the store's own form.
    pub bake: B,
    /// Its priority; higher ones come first.
    pub priority: i64,
    /// Tasks of it under way.
    pub leased: i64,
    /// The worker had its scene last.
    pub is_local: bool,
}

/// Index of the contender that gets the next task, of a list with the oldest first: of those with the highest priority the one with the
/// fewest tasks under way, where the scene that the worker has counts for some; of equals the oldest.
pub fn next_contender<B>(contenders: &[Contender<B>]) -> Option<usize> {
    let rank = |contender: &Contender<B>| {
        let bonus = if contender.is_local { LOCALITY_LEASES } else { 0 };
        (-contender.priority, contender.leased - bonus)
    };
    (0..contenders.len()).min_by_key(|index| (rank(&contenders[*index]), *index))
}

/// Cost by which a task is claimed, among its bake's, whose dependencies have these costs: its own, or more than any of
/// theirs. So the step after a task comes soon after it, not after all others of its kind.
pub fn claim_cost(cost: u64, of_dependencies: impl IntoIterator<Item = u64>) -> u64 {
    of_dependencies.into_iter().map(|cost| cost + 1).fold(cost, u64::max)
}

/// When an attempt that starts now must have ended.
pub fn deadline_ms(now_ms: i64, attempt_limit_secs: Option<u32>) -> i64 {
    now_ms + 1000 * i64::from(attempt_limit_secs.unwrap_or(ATTEMPT_LIMIT_SECS))
}

/// Cuts a message to its limit.
pub fn cut_message(message: &str) -> String {
    message.chars().take(MAX_MESSAGE_CHARS).collect()
}

/// Why a bake failed when a worker blamed the task.
pub fn task_fault_message(label: &str, kind: &str, worker: &str, message: &str) -> String {
    cut_message(&format!("{label} ({kind}) failed on worker {worker}: {message}"))
}

/// Why a bake failed when workers kept failing at a task.
pub fn given_up_message(label: &str, kind: &str, attempts: u32, workers: u32, message: &str) -> String {
    let (workers, attempts) = (counted(workers, "worker"), counted(attempts, "attempt"));
    cut_message(&format!("{label} ({kind}) failed on {workers} in {attempts}; the last: {message}"))
}

/// Why a bake failed when workers kept being lost with a task.
pub fn lost_message(label: &str, kind: &str, losses: u32, message: &str) -> String {
    let times = counted(losses, "time");
    cut_message(&format!(
        "{label} ({kind}) was lost {times}: its workers ended, fell silent or ran out of memory while they had it. See \
         whether it needs more memory than they have, or let it be lost more often (--lost-workers N of kiln submit or kiln \
         server); the last: {message}"
    ))
}

fn counted(count: u32, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

/// Why a bake failed when a task that was run again gave other bytes than before, and others had named those.
pub fn made_otherwise_message(label: &str, kind: &str, before: &Artefact) -> String {
    let Artefact { name, digest, .. } = before;
    cut_message(&format!(
        "{label} ({kind}) was run again because bytes of its result were lost, and its output '{name}' is not {digest} any \
         more, which other tasks read; the same task must give the same bytes: look whether workers of different versions \
         took part, then submit the bake again"
    ))
}

/// Outputs of a task's result before it was forgotten whose bytes are not among those of the new one.
pub fn outputs_gone<'a>(before: &'a [Artefact], now: &'a [Artefact]) -> impl Iterator<Item = &'a Artefact> {
    before.iter().filter(|output| now.iter().all(|other| other.digest != output.digest))
}

/// Why an attempt ended when its lease ran out.
pub fn expiry_message(worker: &str) -> String {
    format!("worker {worker} was not heard from until its lease ran out")
}

/// Why an attempt ended when it took too long.
pub fn limit_message(worker: &str) -> String {
    format!("worker {worker} took longer than one attempt may take (attempt_limit_secs)")
}

/// An output of one name that two results of a task have with different bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Difference {
    /// The output's name.
    pub name: String,
    /// Its digest in the result that counts; none if that has no such output.
    pub kept: Option<Digest>,
    /// Its digest in the other; none if that has no such output.
    pub found: Option<Digest>,
}

/// The first output in which two results of a task differ. A report tells of the run and may differ; a result that was taken over from
/// another task may lack outputs that nobody reads, so one that has fewer names than the other differs in those that it has.
pub fn difference(kept: &[Artefact], found: &[Artefact]) -> Option<Difference> {
    let by_name = |outputs: &[Artefact]| -> BTreeMap<String, Digest> {
        let told = outputs.iter().filter(|output| output.name != REPORT_OUTPUT);
        told.map(|output| (output.name.clone(), output.digest)).collect()
    };
    let (kept, found) = (by_name(kept), by_name(found));
    let names: BTreeSet<&String> = kept.keys().chain(found.keys()).collect();
    let lack = |outputs: &BTreeMap<String, Digest>| names.iter().any(|name| !outputs.contains_key(*name));
    let is_part = (!lack(&kept) || !lack(&found)) && !kept.is_empty() && !found.is_empty();
    let differ = |name: &&&String| {
        let (kept, found) = (kept.get(**name), found.get(**name));
        kept != found && !(is_part && (kept.is_none() || found.is_none()))
    };
    names.iter().find(differ).map(|name| Difference {
        name: (*name).clone(),
        kept: kept.get(*name).copied(),
        found: found.get(*name).copied(),
    })
}

/// Results of a task that came too late are compared in the order of these.
pub fn order_of_witness(worker: &str, outputs: &[Artefact]) -> (String, Vec<(String, Digest)>) {
    (worker.to_owned(), outputs.iter().map(|output| (output.name.clone(), output.digest)).collect())
}

/// Results on a page, of those whose outputs have so many bytes of JSON each: as many as there is room for, one at least.
pub fn results_on_page(bytes: impl IntoIterator<Item = u64>) -> usize {
    let mut before = 0;
    let has_room = |bytes: &u64| {
        let has_room = before < RESULTS_PAGE_BYTES;
        before += bytes;
        has_room
    };
    bytes.into_iter().take_while(has_room).count()
}

/// Adds `more` into `sums`, name by name.
pub fn add_counters(sums: &mut BTreeMap<String, f64>, more: &BTreeMap<String, f64>) {
    for (name, value) in more {
        *sums.entry(name.clone()).or_insert(0.0) += value;
    }
}

/// Whether two tasks of one key are the same task; label and cost are for people.
pub fn is_same_task(a: &TaskSpec, b: &TaskSpec) -> bool {
    a.kind == b.kind && a.params == b.params && a.inputs == b.inputs
}

/// Checks all that can be seen in a plan alone: limits, and that each task has its own key. So one key is one task, and no task waits for
/// itself: its key would be a digest of itself.
pub fn check_plan(plan: &[TaskSpec]) -> Result<(), PlanError> {
    if plan.len() > MAX_PLAN_TASKS {
        return Err(PlanError::TooManyTasks { count: plan.len(), max: MAX_PLAN_TASKS });
    }
    plan.iter().try_for_each(check_fields)
}

fn check_fields(task: &TaskSpec) -> Result<(), PlanError> {
    let wrong = |what: String| Err(PlanError::Field { key: task.key, what });
    if task.kind.is_empty() || task.kind.len() > MAX_TASK_NAME_BYTES {
        return wrong(format!("its kind must have 1 to {MAX_TASK_NAME_BYTES} bytes"));
    }
    if task.label.len() > MAX_TASK_NAME_BYTES {
        return wrong(format!("its label must have at most {MAX_TASK_NAME_BYTES} bytes"));
    }
    if task.cost > MAX_TASK_COST {
        return wrong(format!("its cost must be at most {MAX_TASK_COST}"));
    }
    // A key that stands for something else would take another task's place, for every bake of the farm.
    if !task.has_its_key() {
        return Err(PlanError::WrongKey { key: task.key, computed: task.computed_key() });
    }
    Ok(())
}

/// Keys that a task waits for, each once, ascending.
pub fn dependencies(task: &TaskSpec) -> Vec<TaskKey> {
    let mut keys: Vec<TaskKey> = task.dependencies().collect();
    keys.sort_unstable();
    keys.dedup();
    keys
}

/// Artefacts that a task names.
pub fn named_artefacts(task: &TaskSpec) -> impl Iterator<Item = Digest> + '_ {
    task.inputs.iter().filter_map(|input| match input {
        TaskInput::Artefact { digest, .. } => Some(*digest),
        TaskInput::Task { .. } => None,
    })
}

/// A task's inputs as its worker sees them; `outputs_of` gives the outputs of a finished task.
///
/// The length of a plain artefact is not known here and left 0.
pub fn resolve_inputs(task: &TaskSpec, outputs_of: impl Fn(&TaskKey) -> Vec<Artefact>) -> Vec<Artefact> {
    let mut inputs = Vec::with_capacity(task.inputs.len());
    for input in &task.inputs {
        match input {
            TaskInput::Artefact { name, digest } => inputs.push(artefact(name.clone(), *digest, 0)),
            TaskInput::Task { name, key } => inputs.extend(
                outputs_of(key)
                    .into_iter()
                    .map(|output| artefact(format!("{name}/{}", output.name), output.digest, output.bytes)),
            ),
        }
    }
    inputs
}

fn artefact(name: String, digest: Digest, bytes: u64) -> Artefact {
    Artefact { name, digest, bytes }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn task(name: &str, needs: &[TaskKey]) -> TaskSpec {
        let inputs = needs.iter().map(|key| TaskInput::Task { name: "in".into(), key: *key }).collect();
        TaskSpec::new("kind", 1, name, json!({ "name": name }), inputs, 1)
    }

    #[test]
    fn backoff_doubles_and_stops_at_a_minute() {
        assert_eq!([1, 2, 3, 4].map(backoff_ms), [1_000, 2_000, 4_000, 8_000]);
        assert_eq!(backoff_ms(u32::MAX), BACKOFF_MAX_MS);
    }

    #[test]
    fn jitter_stays_between_half_and_all_and_differs() {
        let waits: Vec<i64> = (0..64_u8).map(|key| retry_wait_ms(Digest::of(&[key]), 3)).collect();
        assert!(waits.iter().all(|wait| (2_000..=4_000).contains(wait)), "{waits:?}");
        let (least, most) = (waits.iter().min(), waits.iter().max());
        assert!(least < Some(&2_500) && most > Some(&3_500), "{waits:?}");
    }

    #[test]
    fn page_of_results_ends_where_their_outputs_fill_it() {
        let full = RESULTS_PAGE_BYTES;
        for (bytes, wanted) in [
            (&[][..], 0),
            (&[3, 2, 1], 3),
            (&[7 * full, 1], 1),
            (&[full - 1, 1, 1], 2),
            (&[full - 1, full, 1, 1], 2),
        ] {
            assert_eq!(results_on_page(bytes.iter().copied()), wanted, "{bytes:?}");
        }
    }

    #[test]
    fn plan_in_any_order_is_accepted() {
        let first = task("first", &[]);
        let second = task("second", &[first.key]);
        assert_eq!(check_plan(&[second, first]), Ok(()));
    }

    #[test]
    fn tasks_that_wait_for_each_other_have_not_their_own_keys() {
        let (mut a, mut b) = (task("a", &[]), task("b", &[]));
        a.inputs = vec![TaskInput::Task { name: "in".into(), key: b.key }];
        b.inputs = vec![TaskInput::Task { name: "in".into(), key: a.key }];
        assert!(matches!(check_plan(&[a, b]), Err(PlanError::WrongKey { .. })));
    }

    #[test]
    fn key_of_another_task_is_rejected() {
        let (a, mut b) = (task("a", &[]), task("b", &[]));
        let computed = b.key;
        b.key = a.key;
        assert_eq!(check_plan(&[a.clone(), b]), Err(PlanError::WrongKey { key: a.key, computed }));
        let changes: [fn(&mut TaskSpec); 4] = [
            |task| task.version += 1,
            |task| task.kind.push('s'),
            |task| task.params = json!(1),
            |task| task.inputs.push(TaskInput::Artefact { name: "in".into(), digest: Digest::of(b"x") }),
        ];
        for change in changes {
            let mut changed = a.clone();
            change(&mut changed);
            assert!(matches!(check_plan(&[changed]), Err(PlanError::WrongKey { .. })));
        }
    }

    #[test]
    fn results_differ_where_outputs_of_one_name_have_other_bytes() {
        let output = |name: &str, bytes: &[u8]| artefact(name.into(), Digest::of(bytes), 1);
        let (a, b, rows) = (output("a", b"1"), output("b", b"2"), output("rows", b"3"));
        let both = [a.clone(), b.clone()];
        assert_eq!(difference(&both, &both), None);
        assert_eq!(difference(&both, &[b.clone(), a.clone()]), None, "order is nothing");
        let reports = [output(REPORT_OUTPUT, b"x"), output(REPORT_OUTPUT, b"y")];
        assert_eq!(difference(&reports[..1], &reports[1..]), None);
        assert_eq!(
            difference(&[a.clone(), b.clone(), rows.clone()], &both),
            None,
            "taken over without its rows"
        );
        let other = output("b", b"other");
        let differs = difference(&[a.clone(), b.clone(), rows], &[a.clone(), other.clone()]);
        assert_eq!(
            differs,
            Some(Difference { name: "b".into(), kept: Some(b.digest), found: Some(other.digest) })
        );
        assert!(difference(&both, &[]).is_some() && difference(&[], &both).is_some(), "nothing is no part");
        let renamed = difference(&both, &[a, output("c", b"2")]);
        assert_eq!(renamed, Some(Difference { name: "b".into(), kept: Some(b.digest), found: None }));
    }

    #[test]
    fn first_loss_costs_no_wait_and_later_ones_more_and_more() {
        let waits: Vec<i64> = (1..=200).map(|losses| lost_wait_ms(Digest::of(b"task"), losses)).collect();
        assert_eq!(waits[0], 0);
        assert!((LOST_STEP_MS / 2..=LOST_STEP_MS).contains(&waits[1]), "{waits:?}");
        assert!(waits.iter().all(|wait| *wait <= WAIT_MAX_MS) && waits[199] >= WAIT_MAX_MS / 2, "{waits:?}");
        assert!(waits[20] > waits[4] && waits[40] > waits[10], "{waits:?}");
    }

    #[test]
    fn fields_out_of_bounds_are_rejected() {
        let with = |change: fn(&mut TaskSpec)| {
            let mut changed = task("a", &[]);
            change(&mut changed);
            changed.key = changed.computed_key();
            check_plan(&[changed])
        };
        assert!(with(|task| task.kind.clear()).is_err());
        assert!(with(|task| task.label = "x".repeat(MAX_TASK_NAME_BYTES + 1)).is_err());
        assert!(with(|task| task.cost = MAX_TASK_COST + 1).is_err());
        assert!(with(|_| ()).is_ok());
    }
}
