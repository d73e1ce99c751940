//! Random histories: the stores in databases do what the plain model does, step by step.

use lightkiln_proto::api::{Bake, BakeEvent, Blame, Lease, Worker};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{TaskResult, TaskSpec};
use lightkiln_server::store::{Stats, StoreError};
use proptest::collection::vec;
use proptest::prelude::*;

use crate::support::{World, in_time, outputs, request, submission, task_of};

/// Tasks of the universe.
const TASKS: usize = 9;
/// Dependencies of each task; all come before it.
const NEEDS: [&[usize]; TASKS] = [&[], &[], &[0], &[0, 1], &[2], &[3], &[3, 4], &[], &[7]];
/// What each task plans; task 7 plans one that needs task 5, which its bake may not hold.
const PLANS: [&[usize]; TASKS] = [&[1, 2], &[], &[4], &[5], &[], &[], &[], &[8, 7], &[]];

/// Something that happens. Numbers name bakes, leases, tasks and workers, modulo how many there are.
#[derive(Clone, Debug)]
enum Step {
    Submit { tasks: Vec<usize>, is_closed: bool, priority: i32, key: Option<u8> },
    Claim { worker: u8, max: u32, knows_more: bool },
    Heartbeat(usize),
    Commit(usize),
    Fail(usize, bool),
    Release(usize),
    Wait(i64),
    Reap,
    Pause(usize),
    Resume(usize),
    Cancel(usize),
    Priority(usize, i32),
    Forget(usize),
}

fn step() -> impl Strategy<Value = Step> {
    let tasks = vec(0..TASKS, 1..4);
    let submit = (tasks, prop::bool::weighted(0.9), -1..2, prop::option::weighted(0.3, 0_u8..3));
    let wait = prop_oneof![Just(1_i64), Just(1_000), Just(6_000), Just(30_000), Just(70_000), Just(700_000)];
    let any = 0_usize..64;
    prop_oneof![
        3 => submit.prop_map(|(tasks, is_closed, priority, key)| Step::Submit { tasks, is_closed, priority, key }),
        8 => (0_u8..4, 0_u32..4, prop::bool::weighted(0.8))
            .prop_map(|(worker, max, knows_more)| Step::Claim { worker, max, knows_more }),
        2 => any.clone().prop_map(Step::Heartbeat),
        8 => any.clone().prop_map(Step::Commit),
        2 => (any.clone(), prop::bool::weighted(0.3)).prop_map(|(lease, task)| Step::Fail(lease, task)),
        1 => any.clone().prop_map(Step::Release),
        3 => wait.prop_map(Step::Wait),
        2 => Just(Step::Reap),
        1 => any.clone().prop_map(Step::Pause),
        1 => any.clone().prop_map(Step::Resume),
        1 => any.clone().prop_map(Step::Cancel),
        1 => (any.clone(), -1..3).prop_map(|(bake, priority)| Step::Priority(bake, priority)),
        1 => (0..TASKS).prop_map(Step::Forget),
    ]
}

fn universe() -> Vec<TaskSpec> {
    let mut tasks: Vec<TaskSpec> = Vec::new();
    for (index, needs) in NEEDS.iter().enumerate() {
        let needs: Vec<&TaskSpec> = needs.iter().map(|needs| &tasks[*needs]).collect();
        let kind = if index % 3 == 2 { "more" } else { "work" };
        let task = task_of(kind, &format!("task {index}"), &needs, index as u64 % 4);
        tasks.push(task);
    }
    tasks
}

/// One store with the names that its own random ids stand for.
struct Side {
    world: World,
    bakes: Vec<String>,
    leases: Vec<Lease>,
}

/// Everything that callers can see, with ids replaced by numbers.
struct Seen {
    bakes: Vec<(Bake, Vec<BakeEvent>)>,
    workers: Vec<Worker>,
    stats: Stats,
}

impl Side {
    fn new(world: World) -> Self {
        Self { world, bakes: Vec::new(), leases: Vec::new() }
    }

    fn number_of(&self, bake: &str) -> usize {
        self.bakes.iter().position(|known| known == bake).expect("a bake that was submitted")
    }

    /// Takes a step and says what came of it.
    async fn take(&mut self, step: &Step, tasks: &[TaskSpec]) -> String {
        let store = self.world.store.clone();
        let lease = |number: &usize| self.leases.get(number % self.leases.len().max(1)).cloned();
        let bake = |number: &usize| self.bakes.get(number % self.bakes.len().max(1)).cloned();
        match step {
            Step::Submit { tasks: chosen, is_closed, priority, key } => {
                let plan = plan_of(chosen, *is_closed, tasks);
                let mut submission = submission("bake", &plan);
                submission.bake.priority = *priority;
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
                match store.commit(&lease.token, &result_of(&lease.task, tasks)).await {
                    Ok(verdict) => format!("{verdict:?}"),
                    Err(error) => refusal(&error),
                }
            }
            Step::Fail(number, is_task) => {
                let Some(lease) = lease(number) else { return String::new() };
                let blame = if *is_task { Blame::Task } else { Blame::Worker };
                format!("{:?}", store.fail(&lease.token, blame, "why").await.unwrap())
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
            Step::Forget(task) => format!("{:?}", store.forget(&[tasks[*task].key]).await.is_ok()),
        }
    }

    async fn look(&self) -> Seen {
        let store = &self.world.store;
        let mut bakes = Vec::new();
        for (number, id) in self.bakes.iter().enumerate() {
            let mut page = store.events_after(id, 0, 10_000).await.unwrap();
            assert_eq!(page.bake, store.show(id).await.unwrap());
            for (index, event) in page.events.iter().enumerate() {
                assert_eq!(event.seq, index as u64 + 1, "sequence without gaps");
            }
            page.bake.id = number.to_string();
            bakes.push((page.bake, page.events));
        }
        let (workers, stats) = (store.workers().await.unwrap(), store.stats().await.unwrap());
        Seen { bakes, workers, stats }
    }

    /// Lets everything end: every live bake must, for nothing may wait for ever.
    async fn finish(&mut self, tasks: &[TaskSpec]) {
        for id in &self.bakes {
            // Refused for those that have ended.
            let _ = self.world.store.resume(id).await;
        }
        self.world.clock.advance_ms(700_000);
        self.world.store.reap().await.unwrap();
        loop {
            let leases = self.world.claim("finisher", 4).await;
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

/// The chosen tasks, with all that they need if the plan is to be closed.
fn plan_of(chosen: &[usize], is_closed: bool, tasks: &[TaskSpec]) -> Vec<TaskSpec> {
    let mut numbers = chosen.to_vec();
    let mut next = 0;
    while is_closed && next < numbers.len() {
        numbers.extend(NEEDS[numbers[next]]);
        next += 1;
    }
    numbers.into_iter().map(|number| tasks[number].clone()).collect()
}

fn result_of(task: &TaskSpec, tasks: &[TaskSpec]) -> TaskResult {
    let number = tasks.iter().position(|known| known.key == task.key).expect("a task of the universe");
    let plan = PLANS[number].iter().map(|planned| tasks[*planned].clone()).collect();
    let counters = [("rays".to_owned(), 0.1 * number as f64)].into();
    TaskResult { outputs: outputs(task.key), plan, counters }
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

/// A refusal without the ids in it.
fn refusal(error: &StoreError) -> String {
    match error {
        StoreError::Plan(error) => format!("{error:?}"),
        StoreError::StateConflict { state, action, .. } => format!("{state:?} {action}"),
        StoreError::IdempotencyConflict { key } => key.clone(),
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
    assert_eq!(found.workers, expected.workers, "{when}");
    assert_eq!(found.stats, expected.stats, "{when}");
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
