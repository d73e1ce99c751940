//! Durability of an SQLite farm whose process ends at any moment.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use lightkiln_proto::api::{BakeFilter, BakeState, CommitVerdict};
use lightkiln_server::store::{FarmStore, SqlStore, StoreError};

use crate::clock::ManualClock;
use crate::support::{TTL_MS, request, result, stock, submission, task};

async fn open(folder: &Path, clock: &Arc<ManualClock>) -> SqlStore {
    let store = SqlStore::open_sqlite(&folder.join("farm.sqlite"), clock.clone()).await.unwrap();
    stock(&store).await;
    store
}

/// Remains of a process that is killed now: the files as they are, nothing closed.
fn files_after_crash(folder: &Path) -> tempfile::TempDir {
    let copy = tempfile::tempdir().unwrap();
    let mut count = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap();
        // The shared-memory index is rebuilt from the log.
        if !name.to_string_lossy().ends_with("-shm") {
            std::fs::copy(&path, copy.path().join(name)).unwrap();
            count += 1;
        }
    }
    assert_eq!(count, 2, "the file and its log");
    copy
}

#[tokio::test]
async fn crash_keeps_everything_and_leases_run_out() {
    let folder = tempfile::tempdir().unwrap();
    let clock = Arc::new(ManualClock::at(0));
    let store = open(folder.path(), &clock).await;
    let a = task("a", &[]);
    let plan = [a.clone(), task("b", &[&a]), task("c", &[])];
    let bake = store.submit(&submission("bake", &plan)).await.unwrap().bake;
    let leases = store.claim(&request("w", 2)).await.unwrap();
    store.commit(&leases[0].token, &result(&leases[0], &[])).await.unwrap();
    let before = store.events_after(&bake.id, 0, 100).await.unwrap();

    let copy = files_after_crash(folder.path());
    let store = open(copy.path(), &clock).await;
    assert_eq!(store.events_after(&bake.id, 0, 100).await.unwrap(), before);
    let again = store.commit(&leases[0].token, &result(&leases[0], &[])).await.unwrap();
    assert_eq!(again, CommitVerdict::AlreadyCommitted);
    clock.advance_ms(TTL_MS);
    assert_eq!(store.reap().await.unwrap().expired, 1);
    while let Some(lease) = store.claim(&request("w", 1)).await.unwrap().pop() {
        store.commit(&lease.token, &result(&lease, &[])).await.unwrap();
    }
    let bake = store.show(&bake.id).await.unwrap();
    assert_eq!((bake.state, bake.tasks_run), (BakeState::Done, 3));
}

#[tokio::test]
async fn holder_goes_on_after_the_server_restarted() {
    let folder = tempfile::tempdir().unwrap();
    let clock = Arc::new(ManualClock::at(0));
    let store = open(folder.path(), &clock).await;
    store.submit(&submission("bake", &[task("a", &[])])).await.unwrap();
    let lease = store.claim(&request("w", 1)).await.unwrap().remove(0);
    store.close().await;
    let store = open(folder.path(), &clock).await;
    let verdict = store.commit(&lease.token, &result(&lease, &[])).await.unwrap();
    assert_eq!(verdict, CommitVerdict::Committed);
}

#[tokio::test]
async fn abandoned_call_happened_wholly_or_not_at_all() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path(), &Arc::new(ManualClock::at(0))).await;
    let mut submitted = 0;
    // Each call is given a little longer than the one before, until calls come to their end.
    for turn in 0u32.. {
        let first = task(&format!("first {turn}"), &[]);
        let plan = [first.clone(), task(&format!("second {turn}"), &[&first])];
        let started = Instant::now();
        let abandon = async {
            while started.elapsed() < turn * Duration::from_micros(50) {
                tokio::task::yield_now().await;
            }
        };
        let bake = submission(&format!("{turn}"), &plan);
        tokio::select! {
            biased;
            () = abandon => (),
            done = store.submit(&bake) => {
                done.unwrap();
                submitted += 1;
            }
        }
        if submitted == 5 {
            break;
        }
    }
    // Claims stand in line behind abandoned calls that are still being undone or finished.
    let mut ran = 0;
    while let Some(lease) = store.claim(&request("w", 1)).await.unwrap().pop() {
        store.commit(&lease.token, &result(&lease, &[])).await.unwrap();
        ran += 1;
    }
    let bakes = store.list(&BakeFilter::default(), None, 500).await.unwrap().bakes;
    assert!((submitted..500).contains(&bakes.len()), "{} bakes of {submitted} submitted", bakes.len());
    assert_eq!(ran, 2 * bakes.len());
    for bake in bakes {
        assert_eq!(store.show(&bake.id).await.unwrap().state, BakeState::Done);
    }
}

#[tokio::test]
async fn file_of_a_newer_version_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("farm.sqlite");
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(&path).create_if_missing(true);
    let pool = sqlx::SqlitePool::connect_with(options).await.unwrap();
    sqlx::query("PRAGMA user_version = 999").execute(&pool).await.unwrap();
    pool.close().await;
    let refused = SqlStore::open_sqlite(&path, Arc::new(ManualClock::at(0))).await;
    assert!(matches!(refused, Err(StoreError::Corrupt { what, .. }) if what.contains("999")));
}
