//! PostgreSQL's lock on the farm: whoever waits for it in vain leaves nothing behind.

use std::sync::Arc;

use lightkiln_server::store::{FarmStore, SqlStore, StoreError};
use sqlx::{Connection, Executor, PgConnection, Row};

use crate::parts::postgres::empty_schema;
use crate::support::{in_time, request, stock, submission, task};

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
