//! Random histories: the stores in databases behave as the plain model, step by step.

use std::collections::{BTreeMap, BTreeSet};

use lightkiln_proto::api::{Bake, BakeEvent, BakeResult, Blame, CommitVerdict, Lease, Worker};
use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::{TaskResult, TaskSpec};
use lightkiln_server::store::chunk::{ChunkRow, CollectRules, Usage};
use lightkiln_server::store::{Maker, Room, Standing, Stats, StoreError, WAIT_MAX_MS};
use proptest::collection::vec;
use proptest::prelude::*;

use crate::support::{SCENE, World, chunk, in_time, output, request, submission};
use crate::universe::{TASKS, limits_of, machine_of, plan_of, result_of, share_of, universe};

/// More results than a bake of them has.
const RESULTS: u32 = 10_000;
/// Something that happens. Numbers name bakes, leases, tasks and workers, modulo how many there are.
#[derive(Clone, Debug)]
enum Step {
    Submit {
        tasks: Vec<usize>,
        is_closed: bool,
        priority: i32,
        key: Option<u8>,
    },
    Claim {
        worker: u8,
        max: u32,
        knows_more: bool,
    },
    Heartbeat(usize),
    Commit(usize),
    CommitOtherwise(usize),
    /// One after the other of some leases, the same ones among them, the last one otherwise.
    CommitAll(Vec<usize>),
    Fail(usize, Blame),
    Release(usize),
    Wait(i64),
    Reap,
    Pause(usize),
    Resume(usize),
    Cancel(usize),
    Priority(usize, i32),
    Forget(usize),
    Keep {
        output: u8,
        generation: u64,
        replaces: Option<u64>,
        quota: Option<u64>,
    },
    Touch(u8),
    Lose(u8, u64),
    Collect {
        grace_ms: i64,
        keep_bakes_ms: Option<i64>,
        buries: bool,
    },
    Delete(usize),
    Extend,
    Present(u8),
    Clear {
        bake: usize,
        worker: Option<u8>,
    },
}

fn step() -> impl Strategy<Value = Step> {
    let tasks = vec(0..TASKS, 1..4);
    let submit = (tasks, prop::bool::weighted(0.9), -1..2, prop::option::weighted(0.3, 0_u8..3));
    let wait = prop_oneof![
        Just(1_i64),
        Just(1_000),
        Just(6_000),
        Just(30_000),
        Just(70_000),
        Just(700_000),
        Just(4_000_000),
        Just(-100_000)
    ];
    let any = 0_usize..64;
    prop_oneof![
        3 => submit.prop_map(|(tasks, is_closed, priority, key)| Step::Submit { tasks, is_closed, priority, key }),
        8 => (0_u8..4, 0_u32..4, prop::bool::weighted(0.8))
            .prop_map(|(worker, max, knows_more)| Step::Claim { worker, max, knows_more }),
        2 => any.clone().prop_map(Step::Heartbeat),
        8 => any.clone().prop_map(Step::Commit),
        1 => any.clone().prop_map(Step::CommitOtherwise),
        3 => vec(any.clone(), 1..5).prop_map(Step::CommitAll),
        3 => (any.clone(), prop_oneof![Just(Blame::Task), Just(Blame::Worker), Just(Blame::Lost)])
            .prop_map(|(lease, blame)| Step::Fail(lease, blame)),
        1 => any.clone().prop_map(Step::Release),
        3 => wait.prop_map(Step::Wait),
        2 => Just(Step::Reap),
        1 => any.clone().prop_map(Step::Pause),
        1 => any.clone().prop_map(Step::Resume),
        1 => any.clone().prop_map(Step::Cancel),
        1 => (any.clone(), -1..3).prop_map(|(bake, priority)| Step::Priority(bake, priority)),
        1 => (0..TASKS).prop_map(Step::Forget),
        3 => (0_u8..5, 1_u64..4, prop::option::weighted(0.2, 1_u64..4), prop::option::weighted(0.2, 100_u64..200))
            .prop_map(|(output, generation, replaces, quota)| Step::Keep { output, generation, replaces, quota }),
        1 => (0_u8..5).prop_map(Step::Touch),
        1 => (0_u8..5, 1_u64..4).prop_map(|(output, generation)| Step::Lose(output, generation)),
        2 => (prop_oneof![Just(0_i64), Just(50_000)], prop::option::weighted(0.3, Just(20_000_i64)), prop::bool::ANY)
            .prop_map(|(grace_ms, keep_bakes_ms, buries)| Step::Collect { grace_ms, keep_bakes_ms, buries }),
        1 => any.clone().prop_map(Step::Delete),
        1 => Just(Step::Extend),
        1 => (0_u8..4).prop_map(Step::Present),
        1 => (any.clone(), prop::option::of(0_u8..4)).prop_map(|(bake, worker)| Step::Clear { bake, worker }),
    ]
}

/// Gives a result other outputs than its task should have.
fn otherwise(result: &mut TaskResult) {
    result.outputs.iter_mut().for_each(|made| made.digest = output(made.digest.0[0] % 4));
}

fn verdict(committed: Result<CommitVerdict, StoreError>) -> String {
    committed.map_or_else(|error| refusal(&error), |verdict| format!("{verdict:?}"))
}

/// One store with the names that its own random ids stand for.
struct Side {
    world: World,
    bakes: Vec<String>,
    leases: Vec<Lease>,
    /// Of each bake, how far its results were read, and whose they were.
    followed: BTreeMap<String, (u64, BTreeSet<TaskKey>)>,
}

/// Tasks that are ready by kind and threads, or results that wait: their number, and who may take them.
type Ready = (String, u32, u64, Option<Room>, Option<Maker>);

/// Everything that callers can see, with ids replaced by numbers.
struct Seen {
    bakes: Vec<(Bake, Vec<BakeEvent>)>,
    results: Vec<Vec<BakeResult>>,
    workers: Vec<Worker>,
    stats: Stats,
    /// Openings for claims, and how far the bakes have come.
    openings: BTreeSet<Ready>,
    standings: Vec<Standing>,
    rows: Vec<ChunkRow>,
    usage: Usage,
}

impl Side {
    fn new(world: World) -> Self {
        Self { world, bakes: Vec::new(), leases: Vec::new(), followed: BTreeMap::new() }
    }

    fn number_of(&self, bake: &str) -> usize {
        self.bakes.iter().position(|known| known == bake).expect("a bake that was submitted")
    }

    /// Takes a step and tells its outcome.
    async fn take(&mut self, step: &Step, tasks: &[TaskSpec]) -> String {
        let store = self.world.store.clone();
        let lease = |number: &usize| self.leases.get(number % self.leases.len().max(1)).cloned();
        let bake = |number: &usize| self.bakes.get(number % self.bakes.len().max(1)).cloned();
        match step {
            Step::Submit { tasks: chosen, is_closed, priority, key } => {
                let plan = plan_of(chosen, *is_closed, tasks);
                let mut submission = submission("bake", &plan);
                submission.bake.priority = *priority;
                submission.bake.needs.threads = if chosen[0] == 3 { 3 } else { 0 };
                submission.bake.attempt_limit_secs = (chosen[0] == 4).then_some(40);
                submission.bake.limits = limits_of(chosen[0]);
                submission.bake.verify_share = share_of(chosen[0]);
                submission.bake.scene = chunk_of(if chosen[0] == 5 { 1 } else { 4 });
                submission.idempotency_key = key.map(|key| format!("key {key}"));
                submission.body_hash = Digest::of(format!("{chosen:?}").as_bytes());
                let submitted = store.submit(&submission).await;
                match submitted {
                    Ok(submitted) => {
                        if submitted.is_new {
                            self.bakes.push(submitted.bake.id.clone());
                        }
                        format!("{} {}", submitted.is_new, self.number_of(&submitted.bake.id))
                    }
                    Err(error) => refusal(&error),
                }
            }
            Step::Claim { worker, max, knows_more } => {
                let mut request = request(&format!("worker {worker}"), *max);
                request.kinds.truncate(if *knows_more { 2 } else { 1 });
                request.threads = u32::from(*worker) + 1;
                request.machine = machine_of(*worker);
                let leases = store.claim(&request).await.unwrap();
                let told: Vec<_> = leases
                    .iter()
                    .map(|lease| (self.number_of(&lease.bake), &lease.task, &lease.inputs, lease.expires_ms))
                    .collect();
                let told = format!("{told:?}");
                self.leases.extend(leases);
                told
            }
            Step::Heartbeat(number) => {
                let Some(lease) = lease(number) else { return String::new() };
                format!("{:?}", store.heartbeat(&lease.token, 0.5).await.unwrap())
            }
            Step::Commit(number) => {
                let Some(lease) = lease(number) else { return String::new() };
                verdict(store.commit(&lease.token, &result_of(&lease.task, tasks)).await)
            }
            Step::CommitOtherwise(number) => {
                let Some(lease) = lease(number) else { return String::new() };
                let mut result = result_of(&lease.task, tasks);
                otherwise(&mut result);
                verdict(store.commit(&lease.token, &result).await)
            }
            Step::CommitAll(numbers) => {
                let mut commits: Vec<(String, TaskResult)> = numbers
                    .iter()
                    .filter_map(lease)
                    .map(|lease| (lease.token.clone(), result_of(&lease.task, tasks)))
                    .collect();
                if let Some((_, result)) = commits.last_mut() {
                    otherwise(result);
                }
                // Plans are taken in after results without one: they are left out, as the order can be seen.
                commits.iter_mut().for_each(|(_, result)| result.plan.clear());
                let given: Vec<_> = commits.iter().map(|(token, result)| (token.as_str(), result)).collect();
                store.commit_all(&given).await.into_iter().map(verdict).collect::<Vec<_>>().join(" ")
            }
            Step::Fail(number, blame) => {
                let Some(lease) = lease(number) else { return String::new() };
                format!("{:?}", store.fail(&lease.token, *blame, "why").await.unwrap())
            }
            Step::Release(number) => {
                let Some(lease) = lease(number) else { return String::new() };
                format!("{}", store.release(&lease.token).await.unwrap())
            }
            Step::Wait(ms) => {
                self.world.clock.advance_ms(*ms);
                String::new()
            }
            Step::Reap => format!("{:?}", store.reap().await.unwrap()),
            Step::Pause(number) => changed(bake(number), |id| async move { store.pause(&id).await }).await,
            Step::Resume(number) => changed(bake(number), |id| async move { store.resume(&id).await }).await,
            Step::Cancel(number) => changed(bake(number), |id| async move { store.cancel(&id).await }).await,
            Step::Priority(number, priority) => {
                let priority = *priority;
                changed(bake(number), |id| async move { store.reprioritise(&id, priority).await }).await
            }
            Step::Keep { output, generation, replaces, quota } => {
                let kept = store.keep_chunk(chunk(chunk_of(*output), *generation), *replaces, *quota).await;
                kept.map_or_else(|error| error.to_string(), |kept| format!("{kept:?}"))
            }
            Step::Touch(output) => format!("{:?}", store.touch_chunk(chunk_of(*output)).await.unwrap()),
            Step::Lose(output, generation) => {
                let name = chunk(chunk_of(*output), *generation).name;
                format!("{}", store.lose_chunk(name).await.unwrap())
            }
            Step::Collect { grace_ms, keep_bakes_ms, buries } => {
                let rules = CollectRules { grace_ms: *grace_ms, keep_bakes_ms: *keep_bakes_ms, max: 3 };
                let collected = store.collect(&rules).await.unwrap();
                if *buries {
                    store.purge(&collected.to_remove).await.unwrap();
                }
                self.drop_deleted().await;
                format!("{collected:?}")
            }
            Step::Delete(number) => {
                let Some(id) = bake(number) else { return String::new() };
                let deleted = store.delete_bake(&id).await;
                self.drop_deleted().await;
                deleted.map_or_else(|error| refusal(&error), |()| "deleted".to_owned())
            }
            Step::Extend => format!("{}", store.extend_leases().await.unwrap()),
            Step::Present(worker) => {
                store.note_present(&[format!("worker {worker}")]).await.unwrap();
                String::new()
            }
            Step::Clear { bake: number, worker } => {
                let Some(id) = bake(number) else { return String::new() };
                let before = store.blocklist(&id).await.unwrap();
                let worker = worker.map(|worker| format!("worker {worker}"));
                let left = store.clear_blocklist(&id, worker.as_deref()).await.unwrap();
                format!("{before:?} {left:?}")
            }
            Step::Forget(task) => format!("{:?}", store.forget(&[tasks[*task].key]).await.is_ok()),
        }
    }

    /// Forgets the names of bakes that are no more, and of their leases.
    async fn drop_deleted(&mut self) {
        let mut left = Vec::new();
        for id in std::mem::take(&mut self.bakes) {
            if self.world.store.show(&id).await.is_ok() {
                left.push(id);
            }
        }
        self.bakes = left;
    }

    /// Reads on in the results of every bake: whoever does so misses none that there are.
    async fn follow(&mut self) {
        for id in &self.bakes {
            let (after, keys) = self.followed.entry(id.clone()).or_default();
            let page = self.world.store.results_after(id, None, *after, RESULTS).await.unwrap();
            for result in page.results {
                assert!((*after + 1..=page.next_after).contains(&result.place));
                keys.insert(result.key);
            }
            *after = page.next_after;
            let page = self.world.store.results_after(id, None, 0, RESULTS).await.unwrap();
            assert!(page.results.iter().all(|result| keys.contains(&result.key)), "{page:?} {keys:?}");
        }
    }

    async fn look(&self) -> Seen {
        let store = &self.world.store;
        let (mut bakes, mut results) = (Vec::new(), Vec::new());
        for (number, id) in self.bakes.iter().enumerate() {
            let mut page = store.events_after(id, 0, 10_000).await.unwrap();
            assert_eq!(page.bake, store.show(id).await.unwrap());
            for (index, event) in page.events.iter().enumerate() {
                assert_eq!(event.seq, index as u64 + 1, "sequence without gaps");
            }
            let landed = store.results_after(id, None, 0, RESULTS).await.unwrap();
            assert_eq!(landed.bake, page.bake);
            results.push(landed.results);
            page.bake.id = number.to_string();
            bakes.push((page.bake, page.events));
        }
        let (rows, usage) = (store.chunk_rows(None, 100).await.unwrap(), store.usage().await.unwrap());
        let (workers, stats) = (store.workers().await.unwrap(), store.stats().await.unwrap());
        let look = store.look(&self.bakes, u64::MAX).await.unwrap();
        let openings = look
            .openings
            .into_iter()
            .map(|opening| (opening.kind, opening.needs.threads, opening.ready, opening.room, opening.maker))
            .collect();
        let mut standings = look.standings;
        for standing in &mut standings {
            standing.bake = self.number_of(&standing.bake).to_string();
        }
        standings.sort_by(|a, b| a.bake.cmp(&b.bake));
        Seen { bakes, results, workers, stats, openings, standings, rows, usage }
    }

    /// Lets everything end: every live bake must, for nothing may wait for ever.
    async fn finish(&mut self, tasks: &[TaskSpec]) {
        for id in &self.bakes {
            // Refused for those that have ended.
            let _ = self.world.store.resume(id).await;
        }
        self.world.clock.advance_ms(700_000);
        stock_again(&self.world).await;
        self.world.store.reap().await.unwrap();
        // Attempts that the reaper ended just now are tried again after a wait.
        self.world.clock.advance_ms(WAIT_MAX_MS);
        loop {
            let mut request = request("finisher", 4);
            request.threads = 8;
            let leases = self.world.store.claim(&request).await.unwrap();
            if leases.is_empty() {
                break;
            }
            for lease in leases {
                let result = TaskResult { plan: Vec::new(), ..result_of(&lease.task, tasks) };
                self.world.store.commit(&lease.token, &result).await.unwrap();
            }
        }
        for (bake, _) in self.look().await.bakes {
            assert!(bake.state.is_final(), "{bake:?}");
        }
    }
}

async fn changed<F>(bake: Option<String>, change: impl FnOnce(String) -> F) -> String
where
    F: Future<Output = Result<Bake, StoreError>>,
{
    let Some(id) = bake else { return String::new() };
    match change(id).await {
        Ok(bake) => format!("{:?}", bake.state),
        Err(error) => refusal(&error),
    }
}

/// Chunks that were cleared away are stored again, under names that nobody has used.
async fn stock_again(world: &World) {
    for number in 0..5 {
        world.store.keep_chunk(chunk(chunk_of(number), 9), None, None).await.unwrap();
    }
}

/// One of the chunks of a history: an output, or the scene.
fn chunk_of(number: u8) -> Digest {
    if number == 4 { Digest::of(SCENE) } else { output(number) }
}

/// A refusal without the ids in it.
fn refusal(error: &StoreError) -> String {
    match error {
        StoreError::Plan(error) => format!("{error:?}"),
        StoreError::StateConflict { state, action, .. } => format!("{state:?} {action}"),
        StoreError::IdempotencyConflict { key } => key.clone(),
        StoreError::MissingChunk { .. } => "a chunk is missing".to_owned(),
        StoreError::NoSuchBake { .. } => "no such bake".to_owned(),
        other => panic!("no step can cause {other}"),
    }
}

async fn compare(world: World, steps: Vec<Step>) {
    let tasks = universe();
    let mut model = Side::new(World::memory().await);
    let mut store = Side::new(world);
    for (number, step) in steps.iter().enumerate() {
        let expected = model.take(step, &tasks).await;
        assert_eq!(store.take(step, &tasks).await, expected, "step {number}: {step:?}");
        model.follow().await;
        store.follow().await;
        assert_same(&store, &model, &format!("after step {number}: {step:?}")).await;
    }
    model.finish(&tasks).await;
    store.finish(&tasks).await;
    assert_same(&store, &model, "at the end").await;
}

/// Compares part by part, so that a difference can be read.
async fn assert_same(store: &Side, model: &Side, when: &str) {
    let (found, expected) = (store.look().await, model.look().await);
    for (found, expected) in found.bakes.iter().zip(&expected.bakes) {
        assert_eq!(found.0, expected.0, "{when}");
        assert_eq!(found.1, expected.1, "{when}");
    }
    assert_eq!(found.results, expected.results, "{when}");
    assert_eq!(found.workers, expected.workers, "{when}");
    assert_eq!(found.stats, expected.stats, "{when}");
    assert_eq!(found.openings, expected.openings, "{when}");
    assert_eq!(found.standings, expected.standings, "{when}");
    assert_eq!(found.rows, expected.rows, "{when}");
    assert_eq!(found.usage, expected.usage, "{when}");
}

/// Histories to try: 48, or as many as `LIGHTKILN_HISTORIES` says for a longer search.
fn config() -> ProptestConfig {
    let wanted = std::env::var("LIGHTKILN_HISTORIES").ok().and_then(|count| count.parse().ok());
    ProptestConfig { cases: wanted.unwrap_or(48), failure_persistence: None, ..ProptestConfig::default() }
}

fn run<F: Future<Output = ()>>(comparison: F) {
    tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap().block_on(in_time(comparison));
}

proptest! {
    #![proptest_config(config())]

    #[test]
    fn sqlite_does_what_the_model_does(steps in vec(step(), 1..70)) {
        run(async { compare(World::sqlite().await, steps).await });
    }

    #[test]
    fn postgres_does_what_the_model_does(steps in vec(step(), 1..70)) {
        run(async { compare(World::postgres().await, steps).await });
    }
}
