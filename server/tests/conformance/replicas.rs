//! Two servers on one PostgreSQL database.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use async_trait::async_trait;
use bytes::Bytes;
use lightkiln_proto::api::{Bake, BakeState, ClaimRequest, CommitVerdict, EventKind, Verdict};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::TaskSpec;
use lightkiln_server::chunks::ObjectChunks;
use lightkiln_server::clock::{Clock, SystemClock};
use lightkiln_server::farm::Farm;
use lightkiln_server::storage::Storage;
use lightkiln_server::store::chunk::CollectRules;
use lightkiln_server::store::{FarmStore, FaultPoint, Faults, SqlStore, StoreError, Submission};
use lightkiln_server::wakeup::{PostgresWakeup, Wakeup};
use sqlx::{Connection, Executor, PgConnection};
use tokio::sync::watch;

use crate::crash::end_sessions;
use crate::parts::kind::kinds;
use crate::parts::postgres::{empty_database, empty_schema};
use crate::support::{SCENE, chunks_in_memory, in_time, new_bake, request, result, stock, submission, task};

/// Longer than any test may take.
const LONG: Duration = Duration::from_secs(3600);

/// Two stores that share a database and its time.
async fn replicas() -> (String, [Arc<SqlStore>; 2]) {
    let url = empty_schema().await;
    let stores = replicas_at(&url).await;
    (url, stores)
}

async fn replicas_at(url: &str) -> [Arc<SqlStore>; 2] {
    // Both at once: one of them makes the tables, the other waits for it.
    let (a, b) =
        futures::future::join(SqlStore::open_postgres(url, None), SqlStore::open_postgres(url, None)).await;
    let stores = [Arc::new(a.unwrap()), Arc::new(b.unwrap())];
    stock(&*stores[0]).await;
    stores
}

/// Deadlocks that a database had to end, once its sessions are over and have told of theirs.
async fn deadlocks(database: &str, stores: [Arc<SqlStore>; 2]) -> i64 {
    for store in &stores {
        store.close().await;
    }
    let mut connection = PgConnection::connect(&crate::parts::postgres::server().url(None)).await.unwrap();
    let sessions = "SELECT count(*) FROM pg_stat_activity WHERE datname = $1";
    let count = "SELECT deadlocks FROM pg_stat_database WHERE datname = $1";
    in_time(async {
        while sqlx::query_scalar::<_, i64>(sessions).bind(database).fetch_one(&mut connection).await.unwrap()
            > 0
        {}
    })
    .await;
    sqlx::query_scalar(count).bind(database).fetch_one(&mut connection).await.unwrap()
}

async fn submit(store: &SqlStore, name: &str, plan: &[TaskSpec]) -> Bake {
    let submission = Submission { idempotency_key: Some(name.into()), ..submission(name, plan) };
    patiently(|| store.submit(&submission)).await.bake
}

#[tokio::test]
async fn lease_of_one_server_is_good_at_the_other() {
    let (_, [a, b]) = replicas().await;
    let before = SystemClock.now_ms();
    let bake = submit(&a, "bake", &[task("a", &[])]).await;
    let lease = a.claim(&request("w", 1)).await.unwrap().remove(0);
    assert!(b.claim(&request("v", 1)).await.unwrap().is_empty());
    // The database's clock is this machine's.
    assert!((before + 30_000..before + 90_000).contains(&lease.expires_ms), "{}", lease.expires_ms);
    assert_eq!(b.heartbeat(&lease.token, 0.5).await.unwrap().verdict, Verdict::Keep);
    let result = result(&lease, &[]);
    assert_eq!(b.commit(&lease.token, &result).await.unwrap(), CommitVerdict::Committed);
    assert_eq!(a.commit(&lease.token, &result).await.unwrap(), CommitVerdict::AlreadyCommitted);
    assert_eq!(a.show(&bake.id).await.unwrap().state, BakeState::Done);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn concurrent_claims_at_two_servers_hand_every_task_out_once() {
    let (_, stores) = replicas().await;
    let tasks: Vec<_> = (0..90).map(|i| task(&format!("{i}"), &[])).collect();
    // Two bakes want every task: two ways to get at it.
    submit(&stores[0], "first", &tasks).await;
    submit(&stores[1], "second", &tasks).await;
    let claims = (0..30).map(|worker| {
        let store = stores[worker % 2].clone();
        tokio::spawn(async move {
            let mut keys = Vec::new();
            loop {
                let leases = store.claim(&request(&format!("w{worker}"), 2)).await.unwrap();
                if leases.is_empty() {
                    return keys;
                }
                keys.extend(leases.iter().map(|lease| lease.task.key));
            }
        })
    });
    let mut keys = Vec::new();
    for claim in claims.collect::<Vec<_>>() {
        keys.extend(in_time(claim).await.unwrap());
    }
    // Those who found the last rows locked by others went home; nothing else may be left.
    while let Some(lease) = stores[0].claim(&request("last", 1)).await.unwrap().pop() {
        keys.push(lease.task.key);
    }
    assert_eq!(keys.len(), 90);
    assert_eq!(keys.into_iter().collect::<BTreeSet<_>>().len(), 90);
}

/// Claims and commits until the bake ends; commits again when an answer is lost.
async fn work(store: Arc<SqlStore>, bake: String, worker: String) -> u64 {
    let mut committed = 0;
    let claim = request(&worker, 2);
    loop {
        let leases = patiently(|| store.claim(&claim)).await;
        for lease in &leases {
            let result = result(lease, &[]);
            let verdict = patiently(|| store.commit(&lease.token, &result)).await;
            assert_ne!(verdict, CommitVerdict::Stale, "no lease ran out");
            committed += 1;
        }
        if leases.is_empty() && patiently(|| store.show(&bake)).await.state.is_final() {
            return committed;
        }
    }
}

/// Asks until there is an answer.
async fn patiently<T, F: Future<Output = Result<T, StoreError>>>(mut call: impl FnMut() -> F) -> T {
    let ask = async {
        loop {
            match call().await {
                Ok(value) => return value,
                Err(error) => assert!(matches!(error, StoreError::Unavailable(_)), "{error:?}"),
            }
        }
    };
    in_time(ask).await
}

/// Layers of tasks, each of which needs two of the layer before.
fn lattice(name: &str, layers: usize, width: usize) -> Vec<TaskSpec> {
    let mut tasks: Vec<TaskSpec> = Vec::new();
    for layer in 0..layers {
        for column in 0..width {
            let above = tasks.len().saturating_sub(column + width)..tasks.len() - column;
            let above = &tasks[above];
            let needs =
                if layer == 0 { Vec::new() } else { vec![&above[column], &above[(column + 1) % width]] };
            let made = task(&format!("{name} {layer} {column}"), &needs);
            tasks.push(made);
        }
    }
    tasks
}

/// Runs two bakes that share tasks, with workers at both servers, and checks the outcome.
async fn run_shared_bakes(stores: &[Arc<SqlStore>; 2]) {
    let tasks = lattice("shared", 6, 8);
    let first = submit(&stores[0], "first", &tasks).await;
    let second = submit(&stores[1], "second", &tasks[..24]).await;
    let workers: Vec<_> = (0..6)
        .map(|worker| tokio::spawn(work(stores[worker % 2].clone(), first.id.clone(), format!("w{worker}"))))
        .collect();
    let seen = in_time(watch_events(&stores[1], &first.id)).await;
    let mut committed = 0;
    for worker in workers {
        committed += in_time(worker).await.unwrap();
    }
    assert_eq!(committed, tasks.len() as u64);
    for (bake, count) in [(&first, 48), (&second, 24)] {
        let bake = stores[0].show(&bake.id).await.unwrap();
        assert_eq!((bake.state, bake.tasks_run), (BakeState::Done, count));
        assert_eq!((bake.stages[0].done, bake.stages[0].leased), (count, 0));
        assert_eq!(bake.counters["rays"], 10.0 * count as f64, "no change of the sums was lost");
    }
    let done: Vec<_> = seen.iter().filter(|event| matches!(event, EventKind::TaskDone { .. })).collect();
    assert_eq!(done.len(), tasks.len(), "every task is committed once");
}

/// Follows a bake to its end; its events have no gaps at any time.
async fn watch_events(store: &SqlStore, bake: &str) -> Vec<EventKind> {
    let mut seen = Vec::new();
    loop {
        let page = patiently(|| store.events_after(bake, seen.len() as u64, 7)).await;
        for event in page.events {
            seen.push(event.event);
            assert_eq!(event.seq, seen.len() as u64, "sequence without gaps");
        }
        if matches!(seen.last(), Some(EventKind::State { state: BakeState::Done })) {
            return seen;
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_servers_count_and_tell_events_without_gaps() {
    let (_, stores) = replicas().await;
    run_shared_bakes(&stores).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn sessions_that_end_again_and_again_lose_nothing() {
    let (url, stores) = replicas().await;
    let is_over = Arc::new(AtomicBool::new(false));
    let trouble = tokio::spawn({
        let (is_over, store) = (is_over.clone(), stores[0].clone());
        async move {
            let (mut rounds, mut done) = (0, 0);
            while !is_over.load(Ordering::SeqCst) {
                // Some work between two troubles, or the test would be of patience.
                let run = patiently(|| store.stats()).await.tasks_run;
                if run >= done + 3 {
                    end_sessions(&url).await;
                    (rounds, done) = (rounds + 1, run);
                }
            }
            rounds
        }
    });
    run_shared_bakes(&stores).await;
    is_over.store(true, Ordering::SeqCst);
    assert!(in_time(trouble).await.unwrap() > 5);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn bake_that_joins_during_a_commit_is_not_forgotten() {
    let (_, [a, b]) = replicas().await;
    for round in 0..30 {
        let shared = task(&format!("shared {round}"), &[]);
        let after = task(&format!("after {round}"), &[&shared]);
        submit(&a, &format!("first {round}"), std::slice::from_ref(&shared)).await;
        let lease = a.claim(&request("w", 1)).await.unwrap().remove(0);
        let result = result(&lease, &[]);
        let joins = submission("second", &[shared, after]);
        let (committed, joined) =
            futures::future::join(a.commit(&lease.token, &result), b.submit(&joins)).await;
        assert_eq!(committed.unwrap(), CommitVerdict::Committed);
        let joined = joined.unwrap().bake;
        in_time(work(b.clone(), joined.id.clone(), "w".into())).await;
        assert_eq!(b.show(&joined.id).await.unwrap().state, BakeState::Done);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn plans_that_bring_the_same_new_tasks_at_once_share_them() {
    let (_, stores) = replicas().await;
    for round in 0..20 {
        let planners = [task(&format!("{round} p"), &[]), task(&format!("{round} q"), &[])];
        let shared: Vec<TaskSpec> = (0..30).map(|i| task(&format!("{round} shared {i}"), &[])).collect();
        let mut bakes = Vec::new();
        for (planner, store) in planners.iter().zip(&stores) {
            bakes.push(submit(store, &planner.label, std::slice::from_ref(planner)).await);
        }
        let leases = stores[0].claim(&request("w", 2)).await.unwrap();
        let commit = async |number: usize| {
            let result = result(&leases[number], &shared);
            assert_eq!(
                stores[number].commit(&leases[number].token, &result).await.unwrap(),
                CommitVerdict::Committed
            );
        };
        in_time(futures::future::join(commit(0), commit(1))).await;
        let ran = in_time(work(stores[1].clone(), bakes[0].id.clone(), "w".into())).await;
        assert_eq!(ran, 30, "each of them ran once");
        for bake in bakes {
            let bake = stores[0].show(&bake.id).await.unwrap();
            assert_eq!((bake.state, bake.tasks_run), (BakeState::Done, 31));
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn task_that_is_planned_while_its_dependency_is_committed_is_woken() {
    let (_, stores) = replicas().await;
    for round in 0..40 {
        let tasks = [task(&format!("{round} planner"), &[]), task(&format!("{round} needed"), &[])];
        let late = task(&format!("{round} late"), &[&tasks[1]]);
        let bake = submit(&stores[0], &format!("{round}"), &tasks).await;
        let leases = stores[0].claim(&request("w", 2)).await.unwrap();
        let commit = async |store: &SqlStore, of: &TaskSpec, plan: &[TaskSpec]| {
            let lease = leases.iter().find(|lease| lease.task.key == of.key).unwrap();
            assert_eq!(
                store.commit(&lease.token, &result(lease, plan)).await.unwrap(),
                CommitVerdict::Committed
            );
        };
        let planned = commit(&stores[0], &tasks[0], std::slice::from_ref(&late));
        in_time(futures::future::join(planned, commit(&stores[1], &tasks[1], &[]))).await;
        let claimed = stores[0].claim(&request("w", 2)).await.unwrap();
        assert_eq!(claimed.len(), 1, "round {round}");
        stores[0].commit(&claimed[0].token, &result(&claimed[0], &[])).await.unwrap();
        assert_eq!(stores[0].show(&bake.id).await.unwrap().state, BakeState::Done);
    }
}

/// Many bakes that share tasks, commits in batches at two servers, and changes of the farm among them.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn batches_at_two_servers_lose_no_count_wake_every_dependant_and_never_deadlock() {
    let (database, url) = empty_database().await;
    let stores = replicas_at(&url).await;
    let layers = lattice("batch", 5, 24);
    let mut bakes = Vec::new();
    for number in 0..4 {
        bakes.push(submit(&stores[number % 2], &format!("{number}"), &layers[..24 * (2 + number)]).await);
    }
    let last = bakes.last().unwrap().id.clone();
    // Parts of the counts are put together meanwhile.
    let (has_ended, gatherer) = (Arc::new(AtomicBool::new(false)), stores[1].clone());
    let gathering = tokio::spawn({
        let (has_ended, url) = (has_ended.clone(), url.clone());
        async move {
            let rules = CollectRules { grace_ms: i64::MAX / 2, keep_bakes_ms: None, max: 10 };
            while !has_ended.load(Ordering::SeqCst) {
                patiently(|| gatherer.collect(&rules)).await;
                assert_counts_are_true(&url).await;
            }
        }
    });
    let workers: Vec<_> = (0..8)
        .map(|worker| {
            let (store, bake) = (stores[worker % 2].clone(), last.clone());
            tokio::spawn(async move {
                let claim = request(&format!("w{worker}"), 5);
                loop {
                    let mut leases = patiently(|| store.claim(&claim)).await;
                    // Some are given back, by a change of the farm.
                    if leases.len() > 4 {
                        patiently(|| store.release(&leases[4].token)).await;
                        leases.truncate(4);
                    }
                    let results: Vec<_> = leases.iter().map(|lease| result(lease, &[])).collect();
                    let commits: Vec<_> = leases
                        .iter()
                        .zip(&results)
                        .map(|(lease, result)| (lease.token.as_str(), result))
                        .collect();
                    for verdict in store.commit_all(&commits).await {
                        assert_eq!(verdict.unwrap(), CommitVerdict::Committed);
                    }
                    if leases.is_empty() && store.show(&bake).await.unwrap().state.is_final() {
                        return;
                    }
                }
            })
        })
        .collect();
    for worker in workers {
        in_time(worker).await.unwrap();
    }
    has_ended.store(true, Ordering::SeqCst);
    in_time(gathering).await.unwrap();
    assert_counts_are_true(&url).await;
    for (number, bake) in bakes.iter().enumerate() {
        let count = 24 * (2 + number) as u64;
        let bake = stores[1].show(&bake.id).await.unwrap();
        assert_eq!((bake.state, bake.tasks_run), (BakeState::Done, count));
        assert_eq!((bake.stages[0].done, bake.stages[0].leased), (count, 0));
        assert_eq!(bake.counters["rays"], 10.0 * count as f64);
        let page = stores[1].events_after(&bake.id, 0, 10_000).await.unwrap();
        assert!(page.events.iter().zip(1..).all(|(event, seq)| event.seq == seq), "sequence without gaps");
        let places = stores[1].results_after(&bake.id, None, 0, 1000).await.unwrap().results;
        assert!(places.iter().zip(1..).all(|(result, place)| result.place == place), "places without gaps");
    }
    let stats = stores[0].stats().await.unwrap();
    assert_eq!((stats.tasks.len(), stats.tasks[0].count, stats.demand.len()), (1, 120, 0), "{stats:?}");
    assert_eq!(deadlocks(&database, stores).await, 0);
}

/// Counts that are kept are those of the rows, at any moment.
async fn assert_counts_are_true(url: &str) {
    let mut connection = PgConnection::connect(url).await.unwrap();
    for (rows, kept) in [
        ("kind, state, count(*)::bigint FROM tasks", "kind, state, sum(count)::bigint FROM task_counts"),
        ("bake, kind, count(*)::bigint FROM ready", "bake, kind, sum(count)::bigint FROM ready_counts"),
    ] {
        let sql = format!(
            "WITH rows AS (SELECT {rows} GROUP BY 1, 2), kept AS (SELECT {kept} GROUP BY 1, 2 HAVING sum(count) <> 0)
             SELECT count(*) FROM ((TABLE rows EXCEPT TABLE kept) UNION ALL (TABLE kept EXCEPT TABLE rows)) AS d"
        );
        let differ: i64 =
            sqlx::query_scalar(sqlx::AssertSqlSafe(sql)).fetch_one(&mut connection).await.unwrap();
        assert_eq!(differ, 0, "{rows}");
    }
}

/// A server that stops, as by SIGSTOP, in the middle of its first commit.
struct Stopped;

#[async_trait]
impl Faults for Stopped {
    async fn at(&self, point: FaultPoint) -> Result<(), StoreError> {
        if point.call == "commit" && point.before == "COMMIT" {
            std::future::pending::<()>().await;
        }
        Ok(())
    }
}

#[tokio::test]
async fn server_that_stops_in_a_transaction_does_not_stop_the_farm() {
    let (url, [b, _]) = replicas().await;
    let stopped = SqlStore::open_postgres(&url, None).await.unwrap().with_faults(Arc::new(Stopped));
    let bake = submit(&b, "bake", &[task("a", &[])]).await;
    let lease = b.claim(&request("w", 1)).await.unwrap().remove(0);
    let result = result(&lease, &[]);
    let hangs = tokio::spawn({
        let (token, result) = (lease.token.clone(), result.clone());
        async move { stopped.commit(&token, &result).await }
    });
    let mut connection = PgConnection::connect(&url).await.unwrap();
    let is_held =
        "SELECT 1 FROM pg_locks WHERE relation = 'turnstile'::regclass AND mode = 'RowShareLock' AND granted";
    in_time(async { while connection.execute(is_held).await.unwrap().rows_affected() == 0 {} }).await;
    // The worker got no answer and asks another server.
    assert_eq!(patiently(|| b.commit(&lease.token, &result)).await, CommitVerdict::Committed);
    assert_eq!(b.show(&bake.id).await.unwrap().tasks_run, 1);
    hangs.abort();
}

/// A farm that does not look again by itself: only a hint can help it.
async fn farm(url: &str, store: &Arc<SqlStore>, chunks: &Arc<ObjectChunks>) -> Farm {
    let (closing, is_closing) = watch::channel(false);
    // Open until the process ends.
    std::mem::forget(closing);
    let wakeup = Arc::new(PostgresWakeup::connect(url).await.unwrap());
    let storage = Storage::new(store.clone(), chunks.clone(), None);
    Farm::new(store.clone(), storage, wakeup, kinds(), LONG, is_closing)
}

#[tokio::test]
async fn hint_of_one_server_wakes_a_claim_at_the_other() {
    let (url, stores) = replicas().await;
    let chunks = Arc::new(chunks_in_memory());
    let farms = [farm(&url, &stores[0], &chunks).await, farm(&url, &stores[1], &chunks).await];
    farms[0].storage.put(Digest::of(SCENE), Bytes::from_static(SCENE)).await.unwrap();
    let waiting = ClaimRequest { kinds: vec!["two.first".into()], wait_secs: 60, ..request("w", 1) };
    let submit_when_it_waits = async {
        while stores[0].workers().await.unwrap().is_empty() {}
        farms[1].submit(new_bake("bake", "two"), None, None, None).await.unwrap();
    };
    let (answer, ()) = in_time(futures::future::join(farms[0].claim(waiting), submit_when_it_waits)).await;
    assert_eq!(answer.unwrap().leases.len(), 1);
}

#[tokio::test]
async fn hints_are_heard_again_after_their_connection_was_lost() {
    let url = empty_schema().await;
    let [a, b] = [PostgresWakeup::connect(&url).await.unwrap(), PostgresWakeup::connect(&url).await.unwrap()];
    let mut connection = PgConnection::connect(&url).await.unwrap();
    let end = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity
               WHERE application_name = 'lightkiln hints' AND query LIKE '%LISTEN%'";
    // Until both listen, there is nothing to end.
    in_time(async { while connection.execute(end).await.unwrap().rows_affected() < 2 {} }).await;
    // It hints once when it listens again, for nobody knows which ones were missed; then hints of the other come through.
    let mark = a.mark();
    in_time(a.wait(mark, LONG)).await;
    let mark = a.mark();
    b.hint();
    in_time(a.wait(mark, LONG)).await;
}

#[tokio::test]
async fn database_of_a_newer_version_is_refused() {
    let (url, _) = replicas().await;
    let mut connection = PgConnection::connect(&url).await.unwrap();
    connection.execute("INSERT INTO schema_version VALUES (999)").await.unwrap();
    let refused = SqlStore::open_postgres(&url, None).await;
    assert!(matches!(refused, Err(StoreError::Corrupt { what, .. }) if what.contains("999")));
}

#[tokio::test]
async fn database_that_is_away_is_unavailable_and_its_password_stays_secret() {
    let url = format!("postgres://kiln:secret@127.0.0.1:{}/farm", crate::parts::keeper::free_port());
    let error = SqlStore::open_postgres(&url, None).await.err().expect("nobody listens there");
    assert!(matches!(error, StoreError::Unavailable(_)), "{error:?}");
    assert!(!format!("{error:?} {error}").contains("secret"));
}
