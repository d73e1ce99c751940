//! A crash between any two steps: in any call that a process dies in, and anywhere in it, the farm goes on from a state in
//! which the call happened wholly or not at all.
//!
//! One story with every kind of call is told once for each point that it passes. There the process ends; the next one
//! opens the database that is left, and callers ask again, as they do when an answer is lost.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};

use async_trait::async_trait;
use lightkiln_proto::api::{BakeState, Blame, EventKind, Lease};
use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::TaskSpec;
use lightkiln_server::access::Scope;
use lightkiln_server::store::chunk::CollectRules;
use lightkiln_server::store::{FarmStore, FaultPoint, Faults, SqlStore, StoreError};
use sqlx::{Connection, Executor, PgConnection};

use crate::clock::ManualClock;
use crate::parts::postgres::empty_schema;
use crate::support::{TTL_MS, chunk, request, result, stock, submission, task, task_of};

/// The fault at the point that is reached `target`-th.
struct At<F> {
    target: u32,
    passed: AtomicU32,
    points: Mutex<BTreeSet<FaultPoint>>,
    act: F,
}

#[async_trait]
trait Act: Send + Sync {
    async fn act(&self) -> Result<(), StoreError>;
}

impl<F: Act> At<F> {
    fn new(target: u32, act: F) -> Arc<Self> {
        Arc::new(Self { target, passed: AtomicU32::new(0), points: Mutex::default(), act })
    }

    fn is_reached(&self) -> bool {
        self.passed.load(Ordering::SeqCst) >= self.target
    }
}

#[async_trait]
impl<F: Act> Faults for At<F> {
    async fn at(&self, point: FaultPoint) -> Result<(), StoreError> {
        self.points.lock().unwrap().insert(point);
        if self.passed.fetch_add(1, Ordering::SeqCst) + 1 == self.target {
            self.act.act().await
        } else {
            Ok(())
        }
    }
}

pub fn crashed() -> StoreError {
    StoreError::Unavailable("the process has ended".into())
}

/// The tasks of one telling; names carry its number, so that tellings in one database do not meet.
struct Cast {
    number: u32,
    planner: TaskSpec,
    planned: [TaskSpec; 2],
    first: Vec<TaskSpec>,
    second: Vec<TaskSpec>,
}

impl Cast {
    fn new(number: u32) -> Self {
        let planner = task_of("work", &format!("{number} plan"), &[], 9);
        let planned = [
            task_of("more", &format!("{number} planned a"), &[&planner], 5),
            task_of("work", &format!("{number} planned b"), &[], 4),
        ];
        let last = task(&format!("{number} last"), &[&planner]);
        let first = vec![planner.clone(), last];
        let second = vec![planner.clone(), task(&format!("{number} other"), &[])];
        Self { number, planner, planned, first, second }
    }

    /// Plan of the planner; others plan nothing.
    fn plan_of(&self, key: TaskKey) -> &[TaskSpec] {
        if key == self.planner.key { &self.planned } else { &[] }
    }
}

/// State of the farm at the end, with or without crashes on the way.
#[derive(Debug, PartialEq)]
struct Ending {
    states: [BakeState; 1],
    /// Kind, total and done of the stages of the bake that ended well.
    stages: Vec<(String, u64, u64)>,
    done: BTreeMap<TaskKey, usize>,
}

/// Runs a call, and again on the next process if this one ends in it.
macro_rules! call {
    ($teller:ident, |$store:ident| $call:expr) => {{
        let outcome = {
            let $store = &$teller.store;
            $call.await
        };
        match outcome {
            Ok(value) => value,
            Err(error) => {
                assert!(matches!(error, StoreError::Unavailable(_)), "{error:?}");
                $teller.restart().await;
                let $store = &$teller.store;
                $call.await.unwrap()
            }
        }
    }};
}

/// Where a farm lives on when its process ends.
#[async_trait]
trait Home: Send + Sync {
    async fn open_again(&self) -> SqlStore;
}

struct Teller<'a> {
    store: SqlStore,
    clock: Arc<ManualClock>,
    home: &'a dyn Home,
}

impl Teller<'_> {
    async fn restart(&mut self) {
        self.store = self.home.open_again().await;
    }

    async fn commit_all(&mut self, leases: &[Lease], cast: &Cast) {
        for lease in leases {
            let result = result(lease, cast.plan_of(lease.task.key));
            call!(self, |store| store.commit(&lease.token, &result));
        }
    }

    /// Every kind of call that changes something.
    async fn tell(&mut self, cast: &Cast) -> Ending {
        let name = |bake: &str| format!("{} {bake}", cast.number);
        let mut submissions =
            [submission(&name("first"), &cast.first), submission(&name("second"), &cast.second)];
        for submission in &mut submissions {
            submission.idempotency_key = Some(submission.bake.name.clone());
            submission.bake.verify_share = 1.0;
        }
        let first = call!(self, |store| store.submit(&submissions[0])).bake.id;
        let second = call!(self, |store| store.submit(&submissions[1])).bake.id;
        let planner = call!(self, |store| store.claim(&request("w", 1)));
        for lease in &planner {
            call!(self, |store| store.heartbeat(&lease.token, 0.5));
        }
        self.commit_all(&planner, cast).await;
        let held = call!(self, |store| store.claim(&request("w", 3)));
        for (index, lease) in held.iter().enumerate() {
            match index {
                0 => drop(call!(self, |store| store.fail(&lease.token, Blame::Worker, "why"))),
                1 => drop(call!(self, |store| store.release(&lease.token))),
                _ => (),
            }
        }
        call!(self, |store| store.pause(&first));
        call!(self, |store| store.resume(&first));
        call!(self, |store| store.reprioritise(&first, 3));
        // The third lease runs out, as do those whose holders never heard of them.
        self.clock.advance_ms(TTL_MS);
        call!(self, |store| store.reap());
        let cancelled = call!(self, |store| store.cancel(&second));
        assert_eq!(cancelled.state, BakeState::Cancelled);
        call!(self, |store| store.forget(&[cast.planner.key]));
        call!(self, |store| store.extend_leases());
        call!(self, |store| store.note_present(&["w".to_owned()]));
        call!(self, |store| store.clear_blocklist(&first, None));
        call!(self, |store| store.probe());
        let (bearer, hash) = (name("bearer"), Digest::of(name("token").as_bytes()));
        call!(self, |store| store.add_bearer(&bearer, hash, &[Scope::Read].into()));
        call!(self, |store| store.revoke_bearer(&bearer));
        self.finish(cast, &first).await;
        self.clear_away(cast, &second).await;
        // Another process's view counts, and its looking is not part of the story.
        self.restart().await;
        self.ending(&[first]).await
    }

    /// Works until the bake is done.
    async fn finish(&mut self, cast: &Cast, bake: &str) {
        loop {
            let leases = call!(self, |store| store.claim(&request("v", 4)));
            self.commit_all(&leases, cast).await;
            if call!(self, |store| store.show(bake)).state.is_final() {
                break;
            }
            if leases.is_empty() {
                // Held by somebody who never heard of it, or waiting to be tried again.
                self.clock.advance_ms(2 * TTL_MS);
                call!(self, |store| store.reap());
            }
        }
    }

    /// Every kind of call about stored bytes.
    async fn clear_away(&mut self, cast: &Cast, ended: &str) {
        let digest = Digest::of(format!("{} chunk", cast.number).as_bytes());
        call!(self, |store| store.keep_chunk(chunk(digest, 1), None, None));
        self.clock.advance_ms(TTL_MS * 10);
        call!(self, |store| store.touch_chunk(digest));
        call!(self, |store| store.lose_chunk(chunk(digest, 1).name));
        call!(self, |store| store.condemn_orphans(&[chunk(digest, 2), chunk(digest, 1)]));
        call!(self, |store| store.keep_chunk(chunk(digest, 3), None, None));
        match call!(self, |store| store.touch_chunk(digest)) {
            Some(kept) => assert_eq!(kept, chunk(digest, 3)),
            None => panic!("what was kept is there"),
        }
        let rules = CollectRules { grace_ms: 0, keep_bakes_ms: None, max: 100 };
        self.clock.advance_ms(1);
        let collected = call!(self, |store| store.collect(&rules));
        assert!(collected.to_remove.contains(&chunk(digest, 3).name), "{collected:?}");
        call!(self, |store| store.purge(&collected.to_remove));
        // Asked again, it is gone already: the first call's answer was lost.
        if let Err(error) = self.store.delete_bake(ended).await {
            let is_gone = matches!(error, StoreError::NoSuchBake { .. });
            assert!(is_gone || matches!(error, StoreError::Unavailable(_)), "{error:?}");
            if !is_gone {
                self.restart().await;
                let again = self.store.delete_bake(ended).await;
                assert!(matches!(again, Ok(()) | Err(StoreError::NoSuchBake { .. })), "{again:?}");
            }
        }
    }

    async fn ending(&self, bakes: &[String; 1]) -> Ending {
        let mut done = BTreeMap::new();
        let mut states = [BakeState::Running; 1];
        let mut stages = Vec::new();
        for (number, id) in bakes.iter().enumerate() {
            let page = self.store.events_after(id, 0, 1000).await.unwrap();
            for (index, event) in page.events.iter().enumerate() {
                assert_eq!(event.seq, index as u64 + 1, "sequence without gaps");
            }
            states[number] = page.bake.state;
            if page.bake.state == BakeState::Done {
                let commits = page.events.iter().filter_map(|event| match &event.event {
                    EventKind::TaskDone { key, .. } => Some(*key),
                    _ => None,
                });
                commits.for_each(|key| *done.entry(key).or_insert(0) += 1);
                assert_eq!(page.bake.tasks_run, done.values().sum::<usize>() as u64);
                stages =
                    page.bake.stages.into_iter().map(|stage| (stage.kind, stage.total, stage.done)).collect();
            }
        }
        for count in self.store.stats().await.unwrap().tasks {
            assert_eq!(count.state.name(), "done", "nothing is held or waits for ever: {count:?}");
        }
        let rows = self.store.chunk_rows(None, 1000).await.unwrap();
        assert!(rows.iter().all(|row| row.generation.is_some()), "{rows:?}");
        assert_eq!(self.store.usage().await.unwrap().chunks, rows.len() as u64);
        Ending { states, stages, done }
    }
}

fn assert_told_well(ending: &Ending, cast: &Cast, target: u32) {
    assert_eq!(ending.states, [BakeState::Done], "point {target}");
    let stages = [("work".to_owned(), 3, 3), ("more".to_owned(), 1, 1)];
    assert_eq!(ending.stages, stages, "point {target}");
    for (key, commits) in &ending.done {
        // The planner's result was forgotten once, and may have been taken in before and after.
        let most = if *key == cast.planner.key { 2 } else { 1 };
        assert!((1..=most).contains(commits), "point {target}: {commits} commits of one task");
    }
    assert_eq!(ending.done.len(), 4, "point {target}");
}

/// Every kind of call must have been ended somewhere.
fn assert_all_calls(points: &BTreeSet<FaultPoint>) {
    let calls: BTreeSet<&str> = points.iter().map(|point| point.call).collect();
    for call in [
        "submit",
        "claim",
        "heartbeat",
        "commit",
        "fail",
        "release",
        "pause",
        "resume",
        "reprioritise",
        "reap",
        "cancel",
        "forget",
        "probe",
        "add_bearer",
        "revoke_bearer",
        "keep_chunk",
        "extend_leases",
        "note_present",
        "clear_blocklist",
        "touch_chunk",
        "lose_chunk",
        "condemn_orphans",
        "collect",
        "purge",
        "delete_bake",
    ] {
        assert!(calls.contains(call), "{call} is not in the story");
    }
    assert!(points.iter().any(|point| point.before == "COMMIT"));
    assert!(points.iter().any(|point| point.before == "after COMMIT"));
}

/// The process ends, and its files stay as they are: nothing is closed, nothing is written any more.
struct KeepFiles {
    from: PathBuf,
    to: PathBuf,
    clock: Arc<ManualClock>,
}

#[async_trait]
impl Act for KeepFiles {
    async fn act(&self) -> Result<(), StoreError> {
        let mut count = 0;
        for entry in std::fs::read_dir(&self.from).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap();
            // The shared-memory index is rebuilt from the log.
            if path.is_file() && !name.to_string_lossy().ends_with("-shm") {
                std::fs::copy(&path, self.to.join(name)).unwrap();
                count += 1;
            }
        }
        assert_eq!(count, 2, "the file and its log");
        Err(crashed())
    }
}

#[async_trait]
impl Home for KeepFiles {
    async fn open_again(&self) -> SqlStore {
        let has_crashed = self.to.join("farm.sqlite").exists();
        open_file(if has_crashed { &self.to } else { &self.from }, &self.clock).await
    }
}

pub async fn open_file(folder: &Path, clock: &Arc<ManualClock>) -> SqlStore {
    let store = SqlStore::open_sqlite(&folder.join("farm.sqlite"), clock.clone()).await.unwrap();
    stock(&store).await;
    store
}

#[tokio::test]
async fn sqlite_survives_a_crash_at_every_point() {
    let mut points = BTreeSet::new();
    for target in 1.. {
        let (from, to) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let clock = Arc::new(ManualClock::at(0));
        let paths = || (from.path().to_owned(), to.path().to_owned());
        let home = KeepFiles { from: paths().0, to: paths().1, clock: clock.clone() };
        let faults = At::new(target, KeepFiles { from: paths().0, to: paths().1, clock: clock.clone() });
        let store = open_file(from.path(), &clock).await.with_faults(faults.clone());
        let cast = Cast::new(target);
        let ending = Teller { store, clock, home: &home }.tell(&cast).await;
        assert_told_well(&ending, &cast, target);
        points.append(&mut faults.points.lock().unwrap());
        if !faults.is_reached() {
            assert!(target > 150, "only {target} points");
            break;
        }
    }
    assert_all_calls(&points);
}

/// A farm in a schema.
struct Schema {
    url: String,
    clock: Arc<ManualClock>,
}

#[async_trait]
impl Home for Schema {
    async fn open_again(&self) -> SqlStore {
        let store = SqlStore::open_postgres(&self.url, Some(self.clock.clone())).await.unwrap();
        stock(&store).await;
        store
    }
}

/// The server's process ends: its sessions do, and nobody answers the caller.
struct EndProcess;

#[async_trait]
impl Act for EndProcess {
    async fn act(&self) -> Result<(), StoreError> {
        Err(crashed())
    }
}

/// PostgreSQL ends the farm's sessions; the server's process goes on.
struct EndSessions(String);

#[async_trait]
impl Act for EndSessions {
    async fn act(&self) -> Result<(), StoreError> {
        end_sessions(&self.0).await;
        Ok(())
    }
}

/// Ends every session of a farm that is in a transaction.
pub async fn end_sessions(url: &str) {
    let mut connection = PgConnection::connect(url).await.unwrap();
    let sql = "SELECT pg_terminate_backend(l.pid) FROM pg_locks l
               WHERE l.relation = 'turnstile'::regclass AND l.granted AND l.pid <> pg_backend_pid()";
    connection.execute(sql).await.unwrap();
    connection.close().await.unwrap();
}

/// Every fifth point, as each takes a new server's connections; all of them with `LIGHTKILN_ALL_POINTS` set.
fn stride() -> usize {
    if std::env::var_os("LIGHTKILN_ALL_POINTS").is_some() { 1 } else { 5 }
}

async fn tell_on_postgres<F: Act + 'static>(act: impl Fn(&str) -> F) {
    let clock = Arc::new(ManualClock::at(0));
    // One schema for all: each telling leaves nothing to do behind.
    let home = Schema { url: empty_schema().await, clock: clock.clone() };
    let mut points = BTreeSet::new();
    for target in (1..).step_by(stride()) {
        let faults = At::new(target, act(&home.url));
        let store = home.open_again().await.with_faults(faults.clone());
        let cast = Cast::new(target);
        let mut teller = Teller { store, clock: clock.clone(), home: &home };
        let ending = teller.tell(&cast).await;
        assert_told_well(&ending, &cast, target);
        teller.store.close().await;
        points.append(&mut faults.points.lock().unwrap());
        if !faults.is_reached() {
            assert!(target > 150, "only {target} points");
            break;
        }
    }
    assert_all_calls(&points);
}

#[tokio::test]
async fn postgres_survives_a_crash_of_a_server_at_every_point() {
    tell_on_postgres(|_| EndProcess).await;
}

#[tokio::test]
async fn postgres_may_end_a_session_at_every_point() {
    tell_on_postgres(|url| EndSessions(url.to_owned())).await;
}
