//! Farms of earlier versions: their bakes and bytes are there and go on under this version.

use std::path::Path;
use std::sync::Arc;

use lightkiln_proto::api::{Bake, BakeFilter, BakeState, CommitVerdict, EventKind, Needs, Verdict};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{Artefact, TaskResult, TaskSpec};
use lightkiln_server::store::chunk::{ChunkRow, CollectRules, KeptChunk, Usage};
use lightkiln_server::store::{BACKOFF_MAX_MS, FarmStore, SqlStore};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{Connection, Executor, PgConnection, SqliteConnection};

use crate::clock::ManualClock;
use crate::parts::postgres::empty_schema;
use crate::support::{TTL_MS, in_time, request, task};

/// Schemas of earlier versions, one step after the other.
const SQLITE: [&str; 9] = [
    include_str!("../../src/store/sql/schema/sqlite_1.sql"),
    include_str!("../../src/store/sql/schema/sqlite_2.sql"),
    include_str!("../../src/store/sql/schema/sqlite_3.sql"),
    include_str!("../../src/store/sql/schema/sqlite_4.sql"),
    include_str!("../../src/store/sql/schema/sqlite_5.sql"),
    include_str!("../../src/store/sql/schema/sqlite_6.sql"),
    include_str!("../../src/store/sql/schema/sqlite_7.sql"),
    include_str!("../../src/store/sql/schema/sqlite_8.sql"),
    include_str!("../../src/store/sql/schema/sqlite_9.sql"),
];
const POSTGRES: [&str; 9] = [
    include_str!("../../src/store/sql/schema/postgres_1.sql"),
    include_str!("../../src/store/sql/schema/postgres_2.sql"),
    include_str!("../../src/store/sql/schema/postgres_3.sql"),
    include_str!("../../src/store/sql/schema/postgres_4.sql"),
    include_str!("../../src/store/sql/schema/postgres_5.sql"),
    include_str!("../../src/store/sql/schema/postgres_6.sql"),
    include_str!("../../src/store/sql/schema/postgres_7.sql"),
    include_str!("../../src/store/sql/schema/postgres_8.sql"),
    include_str!("../../src/store/sql/schema/postgres_9.sql"),
];
/// Steps from there to the version before this one.
const POSTGRES_BEFORE: [&str; 6] = [
    include_str!("../../src/store/sql/schema/postgres_10.sql"),
    include_str!("../../src/store/sql/schema/postgres_11.sql"),
    include_str!("../../src/store/sql/schema/postgres_12.sql"),
    include_str!("../../src/store/sql/schema/postgres_13.sql"),
    include_str!("../../src/store/sql/schema/postgres_14.sql"),
    include_str!("../../src/store/sql/schema/postgres_15.sql"),
];
/// The last version whose tables [`Past::rows`] fills; later steps find its rows.
const FILLED: usize = 2;

/// Now, in the tests.
const NOW_MS: i64 = 1_000_000;

/// A farm as it was: two bakes that share two tasks; of the second, one task is under way, one ready, one waits.
struct Past {
    scene: Digest,
    /// Outputs: `shared` is one of two tasks.
    shared: Artefact,
    own: Artefact,
    tasks: [TaskSpec; 5],
    /// Of the lease under way; numbers below 0 stood for states.
    progress: f64,
}

impl Past {
    fn new() -> Self {
        let artefact =
            |name: &str, bytes| Artefact { name: name.into(), digest: Digest::of(name.as_bytes()), bytes };
        let a = task("a", &[]);
        let b = task("b", &[&a]);
        let c = task("c", &[&a]);
        let d = task("d", &[&b]);
        let e = task("e", &[&c, &d]);
        let scene = Digest::of(b"an old scene");
        let (shared, own) = (artefact("shared", 7), artefact("own", 9));
        Self { scene, shared, own, tasks: [a, b, c, d, e], progress: 0.25 }
    }

    fn outputs(&self, task: usize) -> Vec<Artefact> {
        if task == 0 { vec![self.shared.clone()] } else { vec![self.shared.clone(), self.own.clone()] }
    }

    /// Rows in words that both databases read; numbers of bakes and tasks are given by them, from 1.
    fn rows(&self, version: usize) -> String {
        let Self { scene, shared, own, progress, .. } = self;
        let mut rows = vec![
            format!(
                "INSERT INTO bakes (id, idempotency_key, body_hash, name, kind, scene, settings, priority, state, open_count,
                 tasks_run, tasks_reused, counters, counters_reused, manifest, report, created_ms, finished_ms, last_event)
                 VALUES ('old', 'key of old', '{scene}', 'old bake', 'prt', '{scene}', '{{\"preset\":\"draft\"}}', 3, 'done', 0,
                 2, 0, '{{\"rays\":20.0}}', '{{}}', '{}', '{}', 500, 900, 2)",
                shared.digest, own.digest
            ),
            format!(
                "INSERT INTO bakes (id, body_hash, name, kind, scene, settings, priority, state, open_count, tasks_run,
                 tasks_reused, counters, counters_reused, created_ms, last_event)
                 VALUES ('live', '{scene}', 'live bake', 'prt', '{scene}', '{{}}', 0, 'running', 3, 0, 2, '{{}}',
                 '{{\"rays\":20.0}}', 950, 1)"
            ),
        ];
        let states = ["done", "done", "leased", "ready", "waiting"];
        for (number, task) in self.tasks.iter().enumerate() {
            let json = |value: serde_json::Value| value.to_string().replace('\'', "''");
            let (state, waiting) = (states[number], if number == 4 { 2 } else { 0 });
            let attempts = u32::from(number == 2);
            rows.push(format!(
                "INSERT INTO tasks (key, kind, label, params, inputs, cost, state, waiting_count, attempts) VALUES
                 ('{}', '{}', '{}', '{}', '{}', {}, '{state}', {waiting}, {attempts})",
                task.key,
                task.kind,
                task.label,
                json(task.params.clone()),
                json(serde_json::json!(task.inputs)),
                task.cost
            ));
        }
        for (task, token) in [(1, "token of a"), (2, "token of b")] {
            let outputs = serde_json::json!(self.outputs(task - 1));
            rows.push(format!(
                "INSERT INTO results VALUES ({task}, '{token}', '{outputs}', '[]', '{{\"rays\":10.0}}')"
            ));
        }
        let d = &self.tasks[3].key;
        let expires_ms = NOW_MS + 10_000;
        rows.extend(
            [
                "INSERT INTO task_needs VALUES (2, 1), (3, 1), (4, 2), (5, 3), (5, 4)".to_owned(),
                "INSERT INTO blames VALUES (3, 'clumsy')".to_owned(),
                "INSERT INTO bake_tasks VALUES (1, 1, 1, 0), (1, 2, 1, 0), (2, 1, 1, 1), (2, 2, 1, 1), (2, 3, 0, 0),
                 (2, 4, 0, 0), (2, 5, 0, 0)".to_owned(),
                format!("INSERT INTO ready VALUES (2, 1, '{d}', 4, 'work', 0)"),
                format!("INSERT INTO leases VALUES ('{}', 3, 'holder', {TTL_MS}, {expires_ms}, {progress:.2})", token()),
                "INSERT INTO stages VALUES (1, 'work', 0, 2, 2, 0, 0, 2, 2, 600, 800)".to_owned(),
                "INSERT INTO stages VALUES (2, 'work', 0, 5, 2, 2, 1, 5, 2, 970, NULL)".to_owned(),
                "INSERT INTO events VALUES (1, 1, 500, '{\"type\":\"submitted\"}'),
                 (1, 2, 900, '{\"type\":\"state\",\"state\":\"done\"}'), (2, 1, 950, '{\"type\":\"submitted\"}')".to_owned(),
                "INSERT INTO workers VALUES ('holder', '[\"work\"]', 4, 999000)".to_owned(),
            ],
        );
        if version >= 2 {
            rows.push(format!("INSERT INTO bearers VALUES ('anna', '{scene}', '[\"read\"]', 400, NULL)"));
        }
        rows.join(";\n")
    }
}

/// Of the lease under way.
fn token() -> String {
    "c".repeat(32)
}

async fn sqlite_file(path: &Path, past: &Past, version: usize) {
    let options = SqliteConnectOptions::new().filename(path).create_if_missing(true).foreign_keys(true);
    let mut connection = SqliteConnection::connect_with(&options).await.unwrap();
    for (index, step) in SQLITE[..version].iter().enumerate() {
        sqlx::raw_sql(*step).execute(&mut connection).await.unwrap();
        if index + 1 == version.min(FILLED) {
            let rows = sqlx::AssertSqlSafe(past.rows(version));
            sqlx::raw_sql(rows).execute(&mut connection).await.unwrap();
        }
    }
    let done = sqlx::AssertSqlSafe(format!("PRAGMA user_version = {version}"));
    sqlx::raw_sql(done).execute(&mut connection).await.unwrap();
    connection.close().await.unwrap();
}

async fn postgres_schema(past: &Past, version: usize) -> String {
    let url = empty_schema().await;
    let mut connection = PgConnection::connect(&url).await.unwrap();
    connection.execute("CREATE TABLE schema_version (version BIGINT NOT NULL)").await.unwrap();
    for (index, step) in POSTGRES[..version].iter().enumerate() {
        sqlx::raw_sql(*step).execute(&mut connection).await.unwrap();
        let done = i64::try_from(index + 1).unwrap();
        sqlx::query("INSERT INTO schema_version VALUES ($1)")
            .bind(done)
            .execute(&mut connection)
            .await
            .unwrap();
        if index + 1 == version.min(FILLED) {
            let rows = sqlx::AssertSqlSafe(past.rows(version));
            sqlx::raw_sql(rows).execute(&mut connection).await.unwrap();
        }
    }
    connection.close().await.unwrap();
    url
}

#[tokio::test]
async fn sqlite_file_of_an_earlier_version_goes_on() {
    for version in 1..=SQLITE.len() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("farm.sqlite");
        let past = Past::new();
        sqlite_file(&path, &past, version).await;
        let clock = Arc::new(ManualClock::at(NOW_MS));
        let store = SqlStore::open_sqlite(&path, clock.clone()).await.unwrap();
        in_time(goes_on(&store, &clock, &past, version)).await;
        // A second start finds nothing left to do.
        store.close().await;
        SqlStore::open_sqlite(&path, clock).await.unwrap().probe().await.unwrap();
    }
}

#[tokio::test]
async fn postgres_database_of_an_earlier_version_goes_on() {
    for version in 1..=POSTGRES.len() {
        let past = Past::new();
        let url = postgres_schema(&past, version).await;
        let clock = Arc::new(ManualClock::at(NOW_MS));
        let store = SqlStore::open_postgres(&url, Some(clock.clone())).await.unwrap();
        in_time(goes_on(&store, &clock, &past, version)).await;
        store.close().await;
        SqlStore::open_postgres(&url, Some(clock)).await.unwrap().probe().await.unwrap();
    }
}

/// Statements of servers of the version before, as far as their tables have changed.
const FORMER: [&str; 3] = [
    "SELECT t.id, r.kind FROM ready r JOIN tasks t ON t.id = r.task WHERE r.bake = 2 AND t.state = 'ready' AND r.not_before_ms <= $1
     AND r.kind IN (SELECT value FROM json_each('[\"work\"]')) ORDER BY r.cost DESC, r.key LIMIT 1 FOR UPDATE OF t SKIP LOCKED",
    "SELECT kind, state, count(*) AS count FROM tasks WHERE id < $1 GROUP BY kind, state",
    "SELECT r.kind, b.needs, count(*) AS ready FROM bakes b JOIN ready r ON r.bake = b.seq WHERE b.state = 'running'
     AND r.not_before_ms <= $1 GROUP BY r.kind, b.needs",
];

#[tokio::test]
async fn servers_of_the_version_before_go_on_beside_a_new_one() {
    let url = postgres_schema(&Past::new(), POSTGRES.len()).await;
    let mut former = PgConnection::connect(&url).await.unwrap();
    for (step, version) in POSTGRES_BEFORE.iter().zip(10_i64..) {
        sqlx::raw_sql(*step).execute(&mut former).await.unwrap();
        sqlx::query("INSERT INTO schema_version VALUES ($1)")
            .bind(version)
            .execute(&mut former)
            .await
            .unwrap();
    }
    let ask = async |former: &mut PgConnection| {
        let mut rows = Vec::new();
        for sql in FORMER {
            rows.push(sqlx::query(sql).bind(NOW_MS).fetch_all(&mut *former).await.unwrap().len());
        }
        rows
    };
    // They keep their statements, and some are at work: a read, which waits for nobody, and a claim.
    former.execute("BEGIN; LOCK TABLE turnstile IN ROW SHARE MODE").await.unwrap();
    let before = ask(&mut former).await;
    assert!(before.iter().all(|rows| *rows > 0), "{before:?}");
    let clock = Arc::new(ManualClock::at(NOW_MS));
    let opening = tokio::spawn({
        let url = url.clone();
        async move { SqlStore::open_postgres(&url, Some(clock)).await.unwrap() }
    });
    let mut watcher = PgConnection::connect(&url).await.unwrap();
    let waits = "SELECT 1 FROM pg_locks WHERE relation = 'turnstile'::regclass AND NOT granted";
    in_time(async { while watcher.fetch_optional(waits).await.unwrap().is_none() {} }).await;
    assert_eq!(ask(&mut former).await, before, "the step waits, and holds nothing that they ask for");
    former.execute("COMMIT").await.unwrap();
    let store = in_time(opening).await.unwrap();
    assert_eq!(ask(&mut former).await, before);
    // A bake that one of them deletes leaves no rows behind, and one of its tasks none either.
    former
        .execute("DELETE FROM bakes WHERE id = 'live'; DELETE FROM tasks WHERE state <> 'done'")
        .await
        .unwrap();
    let left = "SELECT 1 FROM ready UNION ALL SELECT 1 FROM bake_tasks WHERE bake = 2
                UNION ALL SELECT 1 FROM task_needs n LEFT JOIN tasks t ON t.id = n.task WHERE t.id IS NULL";
    assert!(former.fetch_optional(left).await.unwrap().is_none());
    let stats = store.stats().await.unwrap();
    assert_eq!((stats.tasks.len(), stats.demand.len()), (1, 0), "{stats:?}");
}

/// Numbers of version 8 that stood for the states of a lease, those states, and whether a lease that runs out in them counts
/// as a loss.
const STATES: [(f64, &str, bool); 3] =
    [(-1.0, "granted", false), (-2.0, "late", false), (0.25, "held", true)];

#[tokio::test]
async fn lease_of_a_sqlite_file_keeps_its_state() {
    for (progress, name, counts) in STATES {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("farm.sqlite");
        sqlite_file(&path, &Past { progress, ..Past::new() }, SQLITE.len()).await;
        let clock = Arc::new(ManualClock::at(NOW_MS));
        let store = SqlStore::open_sqlite(&path, clock.clone()).await.unwrap();
        let mut connection = SqliteConnection::connect(&path.display().to_string()).await.unwrap();
        let state: String =
            sqlx::query_scalar("SELECT state FROM leases").fetch_one(&mut connection).await.unwrap();
        assert_eq!(state, name);
        in_time(lease_ends(&store, &clock, counts)).await;
    }
}

#[tokio::test]
async fn lease_of_a_postgres_database_keeps_its_state() {
    for (progress, name, counts) in STATES {
        let url = postgres_schema(&Past { progress, ..Past::new() }, POSTGRES.len()).await;
        let clock = Arc::new(ManualClock::at(NOW_MS));
        let store = SqlStore::open_postgres(&url, Some(clock.clone())).await.unwrap();
        let mut connection = PgConnection::connect(&url).await.unwrap();
        let state: String =
            sqlx::query_scalar("SELECT state FROM leases").fetch_one(&mut connection).await.unwrap();
        assert_eq!(state, name);
        in_time(lease_ends(&store, &clock, counts)).await;
    }
}

/// Lets the old lease run out.
async fn lease_ends(store: &SqlStore, clock: &ManualClock, counts: bool) {
    clock.advance_ms(TTL_MS);
    assert_eq!(store.reap().await.unwrap().expired, 1);
    assert_eq!(store.show("live").await.unwrap().attempts_lost, u64::from(counts));
    // The attempt of 'clumsy' was the first.
    let attempt = if counts { 3 } else { 2 };
    clock.advance_ms(BACKOFF_MAX_MS);
    let lease = store.claim(&request("holder", 10)).await.unwrap();
    let c = lease.iter().find(|lease| lease.task.label == "c").expect("c is ready again");
    assert_eq!(store.commit(&c.token, &TaskResult::default()).await.unwrap(), CommitVerdict::Committed);
    let events = store.events_after("live", 0, 100).await.unwrap().events;
    let done = events.iter().find_map(|event| match &event.event {
        EventKind::TaskDone { label, attempt, .. } if label == "c" => Some(*attempt),
        _ => None,
    });
    assert_eq!(done, Some(attempt), "{events:?}");
}

async fn goes_on(store: &SqlStore, clock: &ManualClock, past: &Past, version: usize) {
    assert_bakes_are_as_they_were(store, past).await;
    assert_bytes_are_counted(store, past).await;
    let bearers = store.bearers().await.unwrap();
    assert_eq!(bearers.len(), usize::from(version >= 2));
    assert!(bearers.iter().all(|bearer| bearer.name == "anna" && bearer.created_ms == 400));
    let live = finish(store, past).await;
    assert_eq!((live.state, live.tasks_run, live.tasks_reused), (BakeState::Done, 3, 2));
    assert_bytes_go_when_nobody_needs_them(store, clock, past).await;
}

async fn assert_bakes_are_as_they_were(store: &SqlStore, past: &Past) {
    let old = store.show("old").await.unwrap();
    assert_eq!((old.state, old.priority, old.tasks_run, old.tasks_reused), (BakeState::Done, 3, 2, 0));
    assert_eq!((old.created_ms, old.finished_ms), (500, Some(900)));
    assert_eq!((old.manifest, old.report), (Some(past.shared.digest), Some(past.own.digest)));
    assert_eq!(old.settings, serde_json::json!({ "preset": "draft" }));
    assert_eq!((old.needs, old.counters["rays"]), (Needs::default(), 20.0));
    let page = store.events_after("old", 0, 10).await.unwrap();
    let kinds: Vec<EventKind> = page.events.into_iter().map(|event| event.event).collect();
    assert_eq!(kinds, [EventKind::Submitted, EventKind::State { state: BakeState::Done }]);
    for bake in ["old", "live"] {
        let landed = store.results_after(bake, None, 0, 10).await.unwrap().results;
        let places: Vec<_> =
            landed.into_iter().map(|result| (result.place, result.key, result.outputs)).collect();
        assert_eq!(places, [0, 1].map(|task| (task as u64 + 1, past.tasks[task].key, past.outputs(task))));
    }
    let live = store.show("live").await.unwrap();
    let stage = &live.stages[0];
    assert_eq!((stage.total, stage.done, stage.reused, stage.leased), (5, 2, 2, 1));
    let blocked = store.blocklist("live").await.unwrap().workers;
    assert_eq!((blocked[0].worker.as_str(), blocked[0].tasks), ("clumsy", 1));
    let workers = store.workers().await.unwrap();
    assert_eq!((workers[0].name.as_str(), workers[0].memory_mib), ("holder", 0));
    assert_eq!(workers[0].holds, ["c"]);
    let names: Vec<String> = store
        .list(&BakeFilter::default(), None, 10)
        .await
        .unwrap()
        .bakes
        .into_iter()
        .map(|bake| bake.id)
        .collect();
    assert_eq!(names, ["live", "old"]);
}

/// Outputs are those of results; of a scene only its references are known, until somebody looks for its bytes.
async fn assert_bytes_are_counted(store: &SqlStore, past: &Past) {
    let row = |digest, generation, bytes, refs| {
        let is_live_scene = digest == past.scene;
        ChunkRow { digest, generation, bytes, refs, is_live_scene }
    };
    let mut expected = vec![
        row(past.shared.digest, Some(0), 7, 2),
        row(past.own.digest, Some(0), 9, 1),
        row(past.scene, None, 0, 2),
    ];
    expected.sort_by_key(|row| row.digest);
    assert_eq!(store.chunk_rows(None, 10).await.unwrap(), expected);
    assert_eq!(store.usage().await.unwrap(), Usage { chunks: 2, bytes: 16 });
    let scene = KeptChunk { name: past.scene.into(), bytes: 100 };
    store.keep_chunk(scene, None, None).await.unwrap();
    assert_eq!(store.find_chunks(&[past.scene]).await.unwrap(), [scene]);
    assert_eq!(store.usage().await.unwrap(), Usage { chunks: 3, bytes: 116 });
}

/// The holder of the old lease hands in, then everything that is left is done.
async fn finish(store: &SqlStore, past: &Past) -> Bake {
    assert_eq!(store.heartbeat(&token(), 0.5).await.unwrap().verdict, Verdict::Keep);
    let result = |outputs: Vec<Artefact>| TaskResult { outputs, ..TaskResult::default() };
    let verdict = store.commit(&token(), &result(vec![past.own.clone()])).await.unwrap();
    assert_eq!(verdict, CommitVerdict::Committed);
    let again = store.commit("token of b", &result(past.outputs(1))).await.unwrap();
    assert_eq!(again, CommitVerdict::AlreadyCommitted);
    for (label, inputs) in [("d", vec!["in0/shared", "in0/own"]), ("e", vec!["in0/own", "in1/own"])] {
        let leases = store.claim(&request("new worker", 10)).await.unwrap();
        assert_eq!(leases.len(), 1, "{leases:?}");
        assert_eq!(leases[0].task.label, label);
        let names: Vec<&str> = leases[0].inputs.iter().map(|input| input.name.as_str()).collect();
        assert_eq!(names, inputs);
        let verdict = store.commit(&leases[0].token, &result(vec![past.own.clone()])).await.unwrap();
        assert_eq!(verdict, CommitVerdict::Committed);
    }
    let landed = store.results_after("live", None, 2, 10).await.unwrap().results;
    let places: Vec<_> = landed.iter().map(|result| (result.place, result.label.as_str())).collect();
    assert_eq!(places, [(3, "c"), (4, "d"), (5, "e")]);
    store.show("live").await.unwrap()
}

async fn assert_bytes_go_when_nobody_needs_them(store: &SqlStore, clock: &ManualClock, past: &Past) {
    let refs = || async {
        let rows = store.chunk_rows(None, 10).await.unwrap();
        [past.scene, past.shared.digest, past.own.digest]
            .map(|digest| rows.iter().find(|row| row.digest == digest).map(|row| row.refs))
    };
    assert_eq!(refs().await, [Some(2), Some(2), Some(4)]);
    store.delete_bake("old").await.unwrap();
    assert_eq!(refs().await, [Some(1), Some(2), Some(4)], "the other bake holds its tasks too");
    store.delete_bake("live").await.unwrap();
    assert_eq!(refs().await, [Some(0), Some(0), Some(0)]);
    clock.advance_ms(TTL_MS);
    let rules = CollectRules { grace_ms: 0, keep_bakes_ms: None, max: 10 };
    let collected = store.collect(&rules).await.unwrap();
    assert_eq!(collected.to_remove.len(), 3);
    store.purge(&collected.to_remove).await.unwrap();
    assert_eq!(store.usage().await.unwrap(), Usage { chunks: 0, bytes: 0 });
}
