//! The farm over each store, with hints and without: they change how soon, never whether.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use async_trait::async_trait;
use bytes::Bytes;
use lightkiln_proto::api::{
    Bake, BakeState, ClaimAnswer, ClaimRequest, CommitVerdict, Lease, Needs, NewBake,
};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{Artefact, TaskInput, TaskResult, TaskSpec};
use lightkiln_proto::problem::ProblemCode;
use lightkiln_server::ServerError;
use lightkiln_server::chunks::{ChunkStore, ObjectChunks};
use lightkiln_server::farm::Farm;
use lightkiln_server::storage::Storage;
use lightkiln_server::store::{FarmStore, FaultPoint, Faults, StoreError};
use lightkiln_server::wakeup::{LocalWakeup, Wakeup};
use tokio::sync::watch;
use tokio::time::Instant;

use crate::clock::ManualClock;
use crate::crash::open_file;
use crate::parts::kind::kinds;
use crate::support::{SCENE, World, chunks_in_memory, in_time, new_bake, stock, submission, task, task_of};

/// No hints at all: every wait lasts until its timeout.
#[derive(Clone, Copy, Debug, Default)]
struct NoWakeup;

#[async_trait]
impl Wakeup for NoWakeup {
    fn mark(&self) -> u64 {
        0
    }

    fn hint(&self) {}

    async fn wait(&self, _mark: u64, timeout: Duration) {
        tokio::time::sleep(timeout).await;
    }
}

/// Longer than any test may take: who waits this long has missed a hint.
const LONG: Duration = Duration::from_secs(3600);
/// Short enough to stand for polling.
const SHORT: Duration = Duration::from_millis(2);

fn farm(world: &World, wakeup: Arc<dyn Wakeup>, poll_interval: Duration) -> Arc<Farm> {
    farm_over(world, Arc::new(chunks_in_memory()), wakeup, poll_interval)
}

fn farm_over(
    world: &World,
    chunks: Arc<ObjectChunks>,
    wakeup: Arc<dyn Wakeup>,
    poll_interval: Duration,
) -> Arc<Farm> {
    farm_of(world.store.clone(), chunks, wakeup, poll_interval)
}

fn farm_of(
    store: Arc<dyn FarmStore>,
    chunks: Arc<ObjectChunks>,
    wakeup: Arc<dyn Wakeup>,
    poll_interval: Duration,
) -> Arc<Farm> {
    let (closing, is_closing) = watch::channel(false);
    // Open until the process ends.
    std::mem::forget(closing);
    let storage = Storage::new(store.clone(), chunks, None);
    Arc::new(Farm::new(store, storage, wakeup, kinds(), poll_interval, is_closing))
}

fn hinted(world: &World) -> Arc<Farm> {
    farm(world, Arc::new(LocalWakeup::default()), LONG)
}

fn polled(world: &World) -> Arc<Farm> {
    farm(world, Arc::new(NoWakeup), SHORT)
}

async fn submit(farm: &Farm) -> Bake {
    let scene = Digest::of(SCENE);
    farm.storage.put(scene, Bytes::from_static(SCENE)).await.unwrap();
    farm.submit(new_bake("bake", "two"), None, None, None).await.unwrap()
}

fn request(worker: &str) -> ClaimRequest {
    let kinds = ["two.first", "two.second", "work"].map(str::to_owned).to_vec();
    ClaimRequest {
        worker: worker.into(),
        kinds,
        threads: 1,
        memory_mib: 0,
        labels: Vec::new(),
        machine: String::new(),
        max: 1,
        ttl_secs: 30,
        wait_secs: 60,
    }
}

async fn claim_while_submitting(farm: Arc<Farm>) {
    let claim = farm.claim(request("w"));
    let (answer, _) = futures::future::join(claim, submit(&farm)).await;
    let leases = answer.unwrap().leases;
    assert_eq!(leases.len(), 1);
    assert_eq!((leases[0].task.kind.as_str(), leases[0].inputs[0].bytes), ("two.first", 5));
}

pub async fn waiting_claim_gets_what_is_submitted_later(world: World) {
    claim_while_submitting(hinted(&world)).await;
}

pub async fn waiting_claim_needs_no_hint(world: World) {
    claim_while_submitting(polled(&world)).await;
}

/// Counts transactions by call.
#[derive(Default)]
struct Transactions {
    claims: AtomicU32,
    looks: AtomicU32,
    reads: AtomicU32,
}

#[async_trait]
impl Faults for Transactions {
    async fn at(&self, point: FaultPoint) -> Result<(), StoreError> {
        if point.before == "COMMIT" {
            match point.call {
                "claim" => drop(self.claims.fetch_add(1, Ordering::SeqCst)),
                "look" => drop(self.looks.fetch_add(1, Ordering::SeqCst)),
                "events_after" => drop(self.reads.fetch_add(1, Ordering::SeqCst)),
                _ => (),
            }
        }
        Ok(())
    }
}

#[tokio::test]
async fn hints_that_bring_no_work_are_looked_into_once_for_all_who_wait() {
    const WAITING: u32 = 40;
    let started = Instant::now();
    let (_folder, farm, transactions, waiting) = counted(WAITING).await;
    let claims = || transactions.claims.load(Ordering::SeqCst);
    let looks = || transactions.looks.load(Ordering::SeqCst);
    in_time(async {
        for hint in 1..=5 {
            farm.wakeup.hint();
            while looks() < hint {
                tokio::task::yield_now().await;
            }
        }
    })
    .await;
    // After five seconds each says again that it is there.
    if started.elapsed() < Duration::from_secs(5) {
        assert_eq!(claims(), WAITING);
        assert!(looks() < 15, "{} looks for 5 hints", looks());
    }
    submit(&farm).await;
    let got = in_time(futures::future::select_all(waiting)).await.0.unwrap().unwrap();
    assert_eq!(got.leases.len(), 1);
}

/// A farm of one process that counts its transactions, and so many claims that wait.
async fn counted(waiting: u32) -> (tempfile::TempDir, Arc<Farm>, Arc<Transactions>, Vec<Claimed>) {
    let (folder, clock) = (tempfile::tempdir().unwrap(), Arc::new(ManualClock::at(0)));
    let transactions = Arc::new(Transactions::default());
    let store = Arc::new(open_file(folder.path(), &clock).await.with_faults(transactions.clone()));
    let farm = farm_of(store, Arc::new(chunks_in_memory()), Arc::new(LocalWakeup::default()), LONG);
    let claims = (0..waiting).map(|worker| {
        let farm = farm.clone();
        tokio::spawn(async move { farm.claim(request(&format!("w{worker}"))).await })
    });
    let claims = claims.collect();
    in_time(async {
        while transactions.claims.load(Ordering::SeqCst) < waiting {
            tokio::task::yield_now().await;
        }
    })
    .await;
    (folder, farm, transactions, claims)
}

type Claimed = tokio::task::JoinHandle<Result<ClaimAnswer, ServerError>>;

#[tokio::test]
async fn task_that_no_waiting_worker_may_take_wakes_none_of_them() {
    const WAITING: u32 = 20;
    let (_folder, farm, transactions, waiting) = counted(WAITING).await;
    let scene = Digest::of(SCENE);
    farm.storage.put(scene, Bytes::from_static(SCENE)).await.unwrap();
    let needs = Needs { labels: vec!["nobody".into()], ..Needs::default() };
    farm.submit(NewBake { needs, ..new_bake("bake", "two") }, None, None, None).await.unwrap();
    let looks = || transactions.looks.load(Ordering::SeqCst);
    in_time(async {
        for _ in 0..5 {
            let before = looks();
            farm.wakeup.hint();
            while looks() == before {
                tokio::task::yield_now().await;
            }
        }
    })
    .await;
    assert_eq!(transactions.claims.load(Ordering::SeqCst), WAITING, "none claimed again");
    // One that may take it does, and one task wakes a few, not all.
    farm.submit(NewBake { priority: 1, ..new_bake("bake", "two") }, None, None, None).await.unwrap();
    let (got, _, others) = in_time(futures::future::select_all(waiting)).await;
    assert_eq!(got.unwrap().unwrap().leases.len(), 1);
    assert_eq!(others.len() as u32, WAITING - 1);
    assert!(transactions.claims.load(Ordering::SeqCst) < WAITING + 10);
}

#[tokio::test]
async fn result_to_verify_wakes_those_alone_who_may_verify_it() {
    const WAITING: u32 = 20;
    let (_folder, farm, transactions, waiting) = counted(WAITING).await;
    stock(&*farm.store).await;
    // Workers without the label wait on.
    let mut submission = submission("bake", &[task_of("work", "a", &[], 1)]);
    submission.bake.verify_share = 1.0;
    submission.bake.needs.labels = vec!["gpu".into()];
    farm.store.submit(&submission).await.unwrap();
    let on = |worker: &str, machine: &str| {
        let (machine, labels) = (machine.to_owned(), vec!["gpu".to_owned()]);
        ClaimRequest { machine, labels, ..request(worker) }
    };
    let lease = farm.claim(on("maker", "oven")).await.unwrap().leases.remove(0);
    let outputs = crate::support::outputs(lease.task.key);
    let result = TaskResult { outputs, ..TaskResult::default() };
    farm.store.commit(&lease.token, &result).await.unwrap();
    let claims = || transactions.claims.load(Ordering::SeqCst);
    let same = tokio::spawn({
        let (farm, request) = (farm.clone(), on("same", "oven"));
        async move { farm.claim(request).await }
    });
    let looks = || transactions.looks.load(Ordering::SeqCst);
    in_time(async {
        while claims() < WAITING + 2 {
            tokio::task::yield_now().await;
        }
        for _ in 0..5 {
            let before = looks();
            farm.wakeup.hint();
            while looks() == before {
                tokio::task::yield_now().await;
            }
        }
    })
    .await;
    assert_eq!(claims(), WAITING + 2, "none claimed again");
    let other = tokio::spawn({
        let (farm, request) = (farm.clone(), on("other", "hob"));
        async move { farm.claim(request).await }
    });
    assert_eq!(in_time(other).await.unwrap().unwrap().leases[0].task, lease.task);
    drop((same, waiting));
}

#[tokio::test]
async fn claim_that_waits_is_woken_to_verify_a_result() {
    let (_folder, farm, _, _) = counted(0).await;
    stock(&*farm.store).await;
    let mut submission = submission("bake", &[task("a", &[])]);
    submission.bake.verify_share = 1.0;
    farm.store.submit(&submission).await.unwrap();
    let lease = farm.claim(request("maker")).await.unwrap().leases.remove(0);
    let waiting = tokio::spawn({
        let farm = farm.clone();
        async move { farm.claim(request("other")).await }
    });
    let outputs = crate::support::outputs(lease.task.key);
    let result = TaskResult { outputs, ..TaskResult::default() };
    farm.change(farm.store.commit(&lease.token, &result)).await.unwrap();
    assert_eq!(in_time(waiting).await.unwrap().unwrap().leases[0].task, lease.task);
}

#[tokio::test]
async fn tasks_that_wait_for_others_wake_nobody() {
    const WAITING: u32 = 40;
    let (_folder, farm, transactions, waiting) = counted(WAITING).await;
    let first = task("first", &[]);
    let behind = (0..100).map(|number| task(&format!("{number}"), &[&first]));
    let plan: Vec<TaskSpec> = std::iter::once(first.clone()).chain(behind).collect();
    stock(&*farm.store).await;
    farm.store.submit(&submission("bake", &plan)).await.unwrap();
    farm.wakeup.hint();
    let (got, _, others) = in_time(futures::future::select_all(waiting)).await;
    assert_eq!(got.unwrap().unwrap().leases.len(), 1);
    let looks = transactions.looks.load(Ordering::SeqCst);
    farm.wakeup.hint();
    in_time(async {
        while transactions.looks.load(Ordering::SeqCst) == looks {
            tokio::task::yield_now().await;
        }
    })
    .await;
    assert!(transactions.claims.load(Ordering::SeqCst) < WAITING + 10, "one task wakes a few");
    drop(others);
}

#[tokio::test]
async fn readers_are_woken_by_news_of_their_bake_alone() {
    let (_folder, farm, transactions, _) = counted(0).await;
    let (quiet, busy) = (submit(&farm).await, submit(&farm).await);
    let after = farm.events(&quiet.id, 0, 100, Instant::now()).await.unwrap().events.len() as u64;
    let reader = tokio::spawn({
        let (farm, id) = (farm.clone(), quiet.id.clone());
        async move { farm.events(&id, after, 100, Instant::now() + LONG).await }
    });
    let reads = || transactions.reads.load(Ordering::SeqCst);
    let (mut before, looks) = (reads(), || transactions.looks.load(Ordering::SeqCst));
    in_time(async {
        while reads() == before {
            tokio::task::yield_now().await;
        }
        before = reads();
        for priority in 1..6 {
            let seen = looks();
            let change = farm.store.reprioritise(&busy.id, priority);
            farm.change(change).await.unwrap();
            while looks() == seen {
                tokio::task::yield_now().await;
            }
        }
    })
    .await;
    assert_eq!(reads(), before, "nothing happened to its bake");
    farm.change(farm.store.pause(&quiet.id)).await.unwrap();
    assert_eq!(in_time(reader).await.unwrap().unwrap().events.len(), 1);
}

pub async fn workers_without_hints_finish_a_bake(world: World) {
    for farm in [hinted(&world), polled(&world)] {
        let name = Arc::as_ptr(&farm) as usize;
        let bake = submit(&farm).await;
        let planned: Vec<TaskSpec> = (0..20).map(|i| task(&format!("{name} {i}"), &[])).collect();
        let workers: Vec<_> = (0..4)
            .map(|worker| tokio::spawn(work(farm.clone(), format!("w{worker}"), planned.clone())))
            .collect();
        let mut after = 0;
        loop {
            let page = farm.events(&bake.id, after, 100, Instant::now() + LONG).await.unwrap();
            after = page.events.last().map_or(after, |event| event.seq);
            if page.bake.state.is_final() {
                assert_eq!(page.bake.state, BakeState::Done);
                break;
            }
        }
        workers.iter().for_each(|worker| worker.abort());
        // The next round starts from nothing.
        let keys: Vec<_> = world.store.reusable(&initial(&bake)).await.unwrap();
        let keys: Vec<_> = keys.into_iter().map(|result| result.key).collect();
        world.store.forget(&keys).await.unwrap();
    }
}

fn initial(bake: &Bake) -> Vec<TaskSpec> {
    kinds().first_tasks(&bake.kind, bake.scene, &bake.settings).unwrap()
}

/// Takes tasks for ever; preparing plans the given tasks.
async fn work(farm: Arc<Farm>, worker: String, planned: Vec<TaskSpec>) {
    loop {
        for lease in farm.claim(request(&worker)).await.unwrap().leases {
            let plan = if lease.task.kind == "two.second" { planned.clone() } else { Vec::new() };
            let result = TaskResult { plan, ..TaskResult::default() };
            farm.commit(&lease.token, result).await.unwrap();
        }
    }
}

pub async fn waiting_for_results_ends_with_one_of_the_kind_asked_for(world: World) {
    let farm = hinted(&world);
    let bake = world.submit("bake", &[task_of("work", "a", &[], 2), task_of("more", "b", &[], 1)]).await;
    let leases = world.claim("w", 2).await;
    let results = |kind, after| farm.results(&bake.id, Some(kind), after, 10, Instant::now() + LONG);
    let commit = async |lease: &Lease| {
        farm.commit(&lease.token, TaskResult::default()).await.unwrap();
    };
    let land = async {
        commit(&leases[0]).await;
        tokio::task::yield_now().await;
        commit(&leases[1]).await;
    };
    let (page, ()) = futures::future::join(results("more", 0), land).await;
    let places: Vec<_> =
        page.unwrap().results.into_iter().map(|result| (result.place, result.label)).collect();
    assert_eq!(places, [(2, "b".to_owned())]);
    // Of a bake that has ended there is nothing to wait for.
    let page = results("other", 0).await.unwrap();
    assert_eq!((page.results.len(), page.bake.state), (0, BakeState::Done));
}

pub async fn waiting_for_events_ends_with_one(world: World) {
    let farm = hinted(&world);
    let bake = submit(&farm).await;
    let after = world.events(&bake).await.len() as u64;
    let waiting = farm.events(&bake.id, after, 10, Instant::now() + LONG);
    let (page, _) = futures::future::join(waiting, farm.change(world.store.pause(&bake.id))).await;
    let page = page.unwrap();
    assert_eq!((page.events.len(), page.bake.state), (1, BakeState::Paused));
}

/// Claims one task and commits it with one stored output.
async fn run_one(farm: &Farm, content: &'static [u8]) -> Digest {
    let lease = farm.claim(request("w")).await.unwrap().leases.remove(0);
    let digest = Digest::of(content);
    farm.storage.put(digest, Bytes::from_static(content)).await.unwrap();
    let outputs = vec![Artefact { name: "out".into(), digest, bytes: content.len() as u64 }];
    let result = TaskResult { outputs, ..TaskResult::default() };
    assert_eq!(farm.commit(&lease.token, result).await.unwrap(), CommitVerdict::Committed);
    digest
}

pub async fn results_whose_bytes_are_gone_are_run_again(world: World) {
    let chunks = Arc::new(chunks_in_memory());
    let farm = farm_over(&world, chunks.clone(), Arc::new(LocalWakeup::default()), LONG);
    submit(&farm).await;
    run_one(&farm, b"imported").await;
    let prepared = run_one(&farm, b"prepared").await;
    assert_eq!(submit(&farm).await.tasks_reused, 2);
    let name = world.store.find_chunks(&[prepared]).await.unwrap()[0].name;
    chunks.delete(name).await.unwrap();
    let again = submit(&farm).await;
    assert_eq!((again.state, again.tasks_reused), (BakeState::Running, 1));
    run_one(&farm, b"prepared").await;
    assert_eq!(world.state(&again).await, BakeState::Done);
}

/// A bake is cancelled halfway; then bytes are lost that tasks which never ran would have read.
pub async fn plans_whose_bytes_are_gone_are_made_again(world: World) {
    let chunks = Arc::new(chunks_in_memory());
    let farm = farm_over(&world, chunks.clone(), Arc::new(LocalWakeup::default()), LONG);
    let first = submit(&farm).await;
    let imported = run_one(&farm, b"imported").await;
    let inputs = vec![TaskInput::Artefact { name: "scene".into(), digest: imported }];
    let planned = TaskSpec::new("two.more", 1, "planned", serde_json::Value::Null, inputs, 1);
    let plan = || TaskResult { plan: vec![planned.clone()], ..TaskResult::default() };
    let lease = farm.claim(request("w")).await.unwrap().leases.remove(0);
    farm.commit(&lease.token, plan()).await.unwrap();
    world.store.cancel(&first.id).await.unwrap();
    let name = world.store.find_chunks(&[imported]).await.unwrap()[0].name;
    chunks.delete(name).await.unwrap();
    let second = submit(&farm).await;
    assert_eq!((second.state, second.tasks_reused), (BakeState::Running, 0));
    run_one(&farm, b"imported").await;
    let lease = farm.claim(request("w")).await.unwrap().leases.remove(0);
    assert_eq!(farm.commit(&lease.token, plan()).await.unwrap(), CommitVerdict::Committed);
    assert_eq!(world.show(&second).await.stages.iter().map(|stage| stage.total).sum::<u64>(), 3);
}

pub async fn result_without_its_bytes_is_refused(world: World) {
    let farm = hinted(&world);
    submit(&farm).await;
    let lease = farm.claim(request("w")).await.unwrap().leases.remove(0);
    let never_stored = (Digest::of(b"never stored"), 12, ProblemCode::NotStored);
    let of_another_length = (Digest::of(SCENE), 6, ProblemCode::BadRequest);
    for (digest, bytes, code) in [never_stored, of_another_length] {
        let outputs = vec![Artefact { name: "out".into(), digest, bytes }];
        let result = TaskResult { outputs, ..TaskResult::default() };
        let error = farm.commit(&lease.token, result).await.unwrap_err();
        assert_eq!(error.code(), code, "{error}");
    }
    assert_eq!(world.store.stats().await.unwrap().tasks_run, 0);
}
