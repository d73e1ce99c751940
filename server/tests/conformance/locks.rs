//! PostgreSQL's locks: whoever waits for the farm's in vain leaves nothing behind, and a bake's holds up that bake alone.

use std::sync::Arc;
use std::time::Duration;

use async_trait::async_trait;
use lightkiln_proto::api::{Blame, ClaimRequest, CommitVerdict, Lease, Verdict};
use lightkiln_server::store::{FarmStore, FaultPoint, Faults, SqlStore, StoreError};
use sqlx::{Connection, Executor, PgConnection, Row};
use tokio::sync::Notify;
use tokio::task::JoinHandle;

use crate::parts::postgres::empty_schema;
use crate::support::{in_time, request, result, stock, submission, task, task_of};

/// A store, and a session that holds its lock.
struct Held {
    store: Arc<SqlStore>,
    holder: PgConnection,
    watcher: PgConnection,
}

impl Held {
    async fn new() -> Self {
        let url = empty_schema().await;
        let store = Arc::new(SqlStore::open_postgres(&url, None).await.unwrap());
        stock(&*store).await;
        let mut holder = PgConnection::connect(&url).await.unwrap();
        holder.execute("BEGIN; LOCK TABLE turnstile IN EXCLUSIVE MODE").await.unwrap();
        Self { store, holder, watcher: PgConnection::connect(&url).await.unwrap() }
    }

    /// The session that waits for the lock.
    async fn waiting(&mut self) -> i32 {
        let sql = "SELECT pid FROM pg_locks WHERE relation = 'turnstile'::regclass AND NOT granted";
        loop {
            if let Some(row) = self.watcher.fetch_optional(sql).await.unwrap() {
                return row.get(0);
            }
        }
    }

    /// Lets the lock go, and waits until the session has it no more, nor waits for it.
    async fn let_go(&mut self, session: i32) {
        self.holder.execute("ROLLBACK").await.unwrap();
        let sql = "SELECT 1 FROM pg_locks WHERE relation = 'turnstile'::regclass AND pid = $1";
        while sqlx::query(sql).bind(session).fetch_optional(&mut self.watcher).await.unwrap().is_some() {}
    }

    /// The database ends sessions that keep a transaction open; this one did not have to be.
    async fn assert_alive(&mut self, session: i32) {
        let sql = "SELECT 1 FROM pg_stat_activity WHERE pid = $1";
        let found = sqlx::query(sql).bind(session).fetch_optional(&mut self.watcher).await.unwrap();
        assert!(found.is_some(), "the session kept the lock until it was ended");
    }

    /// More calls than the store has connections.
    async fn assert_every_connection_works(&self) {
        for number in 0..20 {
            self.store.submit(&submission(&format!("after {number}"), &[])).await.unwrap();
            self.store.claim(&request("w", 1)).await.unwrap();
        }
    }
}

#[tokio::test]
async fn caller_that_goes_away_while_it_waits_for_the_lock_leaves_it_to_others() {
    let mut held = Held::new().await;
    for is_claim in [false, true] {
        let store = held.store.clone();
        let call = tokio::spawn(async move {
            let bake = submission("abandoned", &[task("a", &[])]);
            if is_claim {
                let _ = store.claim(&request("w", 1)).await;
            } else {
                let _ = store.submit(&bake).await;
            }
        });
        let session = in_time(held.waiting()).await;
        call.abort();
        assert!(call.await.unwrap_err().is_cancelled());
        in_time(held.let_go(session)).await;
        held.assert_alive(session).await;
        in_time(held.assert_every_connection_works()).await;
        held.holder.execute("BEGIN; LOCK TABLE turnstile IN EXCLUSIVE MODE").await.unwrap();
    }
}

#[tokio::test]
async fn connection_that_did_not_get_the_lock_in_time_works_afterwards() {
    let mut held = Held::new().await;
    let store = held.store.clone();
    let call = tokio::spawn(async move { store.submit(&submission("late", &[])).await });
    let session = in_time(held.waiting()).await;
    // As the database does by itself when `lock_timeout` is over, only sooner.
    sqlx::query("SELECT pg_cancel_backend($1)").bind(session).execute(&mut held.watcher).await.unwrap();
    let refused = in_time(call).await.unwrap().unwrap_err();
    assert!(matches!(refused, StoreError::Unavailable(_)), "{refused:?}");
    in_time(held.let_go(session)).await;
    in_time(held.assert_every_connection_works()).await;
}

/// A store with two bakes, the first of which somebody else holds.
struct HeldBake {
    url: String,
    store: Arc<SqlStore>,
    /// Names of the bakes.
    ids: Vec<String>,
    holder: PgConnection,
    watcher: PgConnection,
}

impl HeldBake {
    /// Bakes of so many tasks; leases are taken before the first is held.
    async fn new(tasks: usize, claimed: u32) -> (Self, Vec<Lease>) {
        let url = empty_schema().await;
        let store = Arc::new(SqlStore::open_postgres(&url, None).await.unwrap());
        stock(&*store).await;
        let mut ids = Vec::new();
        for (name, kind) in [("first", "work"), ("second", "more")] {
            let task = |number| task_of(kind, &format!("{name} {number}"), &[], 1);
            let tasks: Vec<_> = (0..tasks).map(task).collect();
            ids.push(store.submit(&submission(name, &tasks)).await.unwrap().bake.id);
        }
        let leases = store.claim(&request("w", claimed)).await.unwrap();
        let mut holder = PgConnection::connect(&url).await.unwrap();
        // Some server that commits a result with a long plan.
        holder.execute("BEGIN; SELECT 1 FROM bakes WHERE name = 'first' FOR NO KEY UPDATE").await.unwrap();
        let watcher = PgConnection::connect(&url).await.unwrap();
        (Self { url, store, ids, holder, watcher }, leases)
    }

    async fn waiting(&mut self) -> i64 {
        let sql = "SELECT count(*) FROM pg_stat_activity a JOIN pg_locks l ON l.pid = a.pid AND l.relation = 'bakes'::regclass
                   WHERE a.wait_event_type = 'Lock' AND l.mode = 'RowShareLock'";
        self.watcher.fetch_one(sql).await.unwrap().get(0)
    }

    fn is_of(&self, bake: usize) -> impl Fn(&&Lease) -> bool + use<> {
        let bake = self.ids[bake].clone();
        move |lease| lease.bake == bake
    }
}

/// Calls until it is served, as clients do: on a slow machine the database ends a call that waits for somebody's lock.
async fn served<T, C: Future<Output = Result<T, StoreError>>>(call: impl Fn() -> C) -> T {
    loop {
        match call().await {
            Err(StoreError::Unavailable(_)) => {}
            answer => return answer.unwrap(),
        }
    }
}

/// Commits that wait until somebody lets their bake go.
fn commit_later(store: &Arc<SqlStore>, lease: &Lease) -> JoinHandle<CommitVerdict> {
    let (store, token, result) = (store.clone(), lease.token.clone(), result(lease, &[]));
    tokio::spawn(async move { served(|| store.commit(&token, &result)).await })
}

#[tokio::test]
async fn bake_that_is_locked_for_long_holds_up_none_other_at_its_own_server_nor_at_another() {
    let (mut held, leases) = HeldBake::new(60, 40).await;
    let of_first: Vec<&Lease> = leases.iter().filter(held.is_of(0)).collect();
    let mut of_second = leases.iter().filter(held.is_of(1));
    // Many more than there are connections.
    let waiting: Vec<_> = of_first.iter().map(|lease| commit_later(&held.store, lease)).collect();
    in_time(async { while held.waiting().await == 0 {} }).await;
    let other = Arc::new(SqlStore::open_postgres(&held.url, None).await.unwrap());
    in_time(async {
        for store in [&held.store, &other] {
            for lease in of_second.by_ref().take(8) {
                let verdict = store.commit(&lease.token, &result(lease, &[])).await.unwrap();
                assert_eq!(verdict, CommitVerdict::Committed);
            }
            for _ in 0..3 {
                // The first bake's turn comes as often; it is passed over.
                let next = store.claim(&request("v", 2)).await.unwrap();
                assert!(!next.is_empty() && next.iter().all(|lease| lease.bake == held.ids[1]));
            }
            store.show(&held.ids[0]).await.unwrap();
            store.events_after(&held.ids[0], 0, 10).await.unwrap();
            store.stats().await.unwrap();
        }
    })
    .await;
    assert!(waiting.iter().all(|commit| !commit.is_finished()));
    held.holder.execute("ROLLBACK").await.unwrap();
    for verdict in waiting {
        assert_eq!(in_time(verdict).await.unwrap(), CommitVerdict::Committed);
    }
    assert_eq!(held.store.stats().await.unwrap().tasks_run, of_first.len() as u64 + 16);
}

#[tokio::test]
async fn claims_for_which_a_locked_bake_alone_has_tasks_wait_and_leave_connections_to_others() {
    let (mut held, _) = HeldBake::new(30, 0).await;
    let of_kind =
        |worker: &str, kind: &str| ClaimRequest { kinds: vec![kind.to_owned()], ..request(worker, 1) };
    let claims: Vec<_> = (0..20)
        .map(|worker| {
            let (store, request) = (held.store.clone(), of_kind(&format!("v{worker}"), "work"));
            tokio::spawn(async move { served(|| store.claim(&request)).await })
        })
        .collect();
    in_time(async { while held.waiting().await == 0 {} }).await;
    for _ in 0..30 {
        let got = in_time(held.store.claim(&of_kind("w", "more"))).await.unwrap();
        assert_eq!(got.len(), 1, "connections are left for those who need no locked bake");
        assert!(held.waiting().await < 8);
    }
    held.holder.execute("ROLLBACK").await.unwrap();
    for claim in claims {
        assert_eq!(in_time(claim).await.unwrap().len(), 1);
    }
}

#[tokio::test]
async fn heartbeats_wait_neither_for_bakes_nor_for_changes_of_the_farm() {
    let (mut held, leases) = HeldBake::new(30, 2).await;
    let waiting = commit_later(&held.store, leases.iter().find(held.is_of(0)).unwrap());
    in_time(async { while held.waiting().await == 0 {} }).await;
    // A change of the farm stands in line behind whoever holds the bake, and everybody else behind the change.
    held.holder.execute("LOCK TABLE turnstile IN ROW SHARE MODE").await.unwrap();
    // Whoever asks whether the server is ready is no such change.
    tokio::time::timeout(Duration::from_secs(10), held.store.probe()).await.unwrap().unwrap();
    let change = tokio::spawn({
        let store = held.store.clone();
        let third = submission("third", &[]);
        async move { served(|| store.submit(&third)).await }
    });
    let in_line = "SELECT 1 FROM pg_locks WHERE relation = 'turnstile'::regclass AND mode = 'ExclusiveLock'";
    in_time(async { while held.watcher.fetch_optional(in_line).await.unwrap().is_none() {} }).await;
    let lease = leases.iter().find(held.is_of(1)).unwrap();
    // Long before any call gives up.
    let beat = tokio::time::timeout(Duration::from_secs(10), held.store.heartbeat(&lease.token, 0.5));
    assert_eq!(beat.await.expect("a heartbeat waits for nobody").unwrap().verdict, Verdict::Keep);
    let present = ["w".to_owned()];
    let present = held.store.note_present(&present);
    tokio::time::timeout(Duration::from_secs(10), present).await.unwrap().unwrap();
    held.holder.execute("ROLLBACK").await.unwrap();
    assert_eq!(in_time(waiting).await.unwrap(), CommitVerdict::Committed);
    in_time(change).await.unwrap();
}

#[tokio::test]
async fn heartbeats_wait_for_no_commit_that_holds_leases_for_long() {
    let (mut held, leases) = HeldBake::new(30, 6).await;
    held.holder.execute("ROLLBACK; BEGIN").await.unwrap();
    // As commits of long plans do; more of them than there are connections for heartbeats.
    let (free, taken) = leases.split_first().unwrap();
    for lease in taken {
        let sql = "SELECT 1 FROM leases WHERE token = $1 FOR UPDATE";
        sqlx::query(sql).bind(&lease.token).execute(&mut held.holder).await.unwrap();
    }
    let beats = leases.iter().map(|lease| held.store.heartbeat(&lease.token, 0.5));
    let beats = tokio::time::timeout(Duration::from_secs(10), futures::future::join_all(beats));
    for beat in beats.await.expect("heartbeats wait for nobody") {
        assert_eq!(beat.unwrap().verdict, Verdict::Keep);
    }
    let prolonged = "SELECT token FROM leases WHERE state = 'held'";
    let prolonged = held.watcher.fetch_all(prolonged).await.unwrap();
    let prolonged: Vec<String> = prolonged.iter().map(|row| row.get(0)).collect();
    assert_eq!(prolonged, std::slice::from_ref(&free.token));
    held.holder.execute("ROLLBACK").await.unwrap();
}

/// Holds a claim before its end until it is let go.
#[derive(Default)]
struct Pause {
    reached: Notify,
    go_on: Notify,
}

#[async_trait]
impl Faults for Pause {
    async fn at(&self, point: FaultPoint) -> Result<(), StoreError> {
        if point.call == "claim" && point.before == "COMMIT" {
            self.reached.notify_one();
            self.go_on.notified().await;
        }
        Ok(())
    }
}

#[tokio::test]
async fn claim_keeps_no_task_from_others_that_it_leaves_to_them() {
    let url = empty_schema().await;
    let store = SqlStore::open_postgres(&url, None).await.unwrap();
    stock(&store).await;
    for name in ["first", "second"] {
        store.submit(&submission(name, &[task(name, &[])])).await.unwrap();
    }
    // Both workers are there; one of them fails.
    assert_eq!(store.claim(&request("other", 0)).await.unwrap(), []);
    let failed = store.claim(&request("failing", 1)).await.unwrap().remove(0);
    store.fail(&failed.token, Blame::Worker, "why").await.unwrap();
    let mut watcher = PgConnection::connect(&url).await.unwrap();
    watcher.execute("UPDATE ready SET not_before_ms = 0; UPDATE tasks SET not_before_ms = 0").await.unwrap();
    let pause = Arc::new(Pause::default());
    let slow = SqlStore::open_postgres(&url, None).await.unwrap().with_faults(pause.clone());
    let slow = tokio::spawn(async move { slow.claim(&request("failing", 1)).await.unwrap() });
    in_time(pause.reached.notified()).await;
    // While that claim of the second bake's task goes on, the one that it left can be had.
    let got = in_time(store.claim(&request("other", 1))).await.unwrap();
    pause.go_on.notify_one();
    let left = in_time(slow).await.unwrap();
    assert_eq!(got.iter().map(|lease| lease.task.key).collect::<Vec<_>>(), [failed.task.key]);
    assert!(left.len() == 1 && left[0].task.key != failed.task.key);
}

#[tokio::test]
async fn row_that_is_there_twice_against_the_rules_is_told_at_once() {
    let url = empty_schema().await;
    let store = SqlStore::open_postgres(&url, None).await.unwrap();
    stock(&store).await;
    store.submit(&submission("bake", &[task("a", &[]), task("b", &[])])).await.unwrap();
    let leases = store.claim(&request("w", 2)).await.unwrap();
    let mut connection = PgConnection::connect(&url).await.unwrap();
    connection.execute("CREATE UNIQUE INDEX one_result_each ON results (worker)").await.unwrap();
    store.commit(&leases[0].token, &result(&leases[0], &[])).await.unwrap();
    let refused = store.commit(&leases[1].token, &result(&leases[1], &[])).await.unwrap_err();
    assert!(matches!(refused, StoreError::Corrupt { .. }), "{refused:?}");
}
