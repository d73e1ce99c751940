//! Hints between servers that share a PostgreSQL database, by NOTIFY.
//!
//! NOTIFY is sent on a connection of its own, never in a transaction of the farm: its commits stand in line for a lock
//! of the whole database. Hints given while one is being sent become one. While no connection listens, hints are lost;
//! those who wait look again by themselves.

use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use async_trait::async_trait;
use lightkiln_proto::ids::Digest;
use sqlx::postgres::{PgConnectOptions, PgListener, PgPool, PgPoolOptions};
use tokio::sync::Notify;
use tokio::task::JoinHandle;

use super::{LocalWakeup, Wakeup};
use crate::random;
use crate::store::Result;

/// One connection to listen, one to notify.
const CONNECTIONS: u32 = 2;
/// Wait before a connection that was lost is made anew.
const RECONNECT_AFTER: Duration = Duration::from_secs(1);

/// Hints within this process, and between it and the others on its database.
pub struct PostgresWakeup {
    local: Arc<LocalWakeup>,
    send: Arc<Notify>,
    tasks: [JoinHandle<()>; 2],
}

impl PostgresWakeup {
    /// Listens on the farm's database at `url`.
    pub async fn connect(url: &str) -> Result<Self> {
        let options = PgConnectOptions::from_str(url)?.application_name("lightkiln hints");
        let pool = PgPoolOptions::new().max_connections(CONNECTIONS).connect_with(options).await?;
        let schema: String = sqlx::query_scalar("SELECT current_schema()::text").fetch_one(&pool).await?;
        let channel = format!("lightkiln_{:016x}", Digest::of(schema.as_bytes()).short());
        let own_id = random::id();
        let (local, send) = (Arc::new(LocalWakeup::default()), Arc::new(Notify::new()));
        let listening = PgListener::connect_with(&pool).await?;
        let tasks = [
            tokio::spawn(listen(listening, pool.clone(), channel.clone(), own_id.clone(), local.clone())),
            tokio::spawn(notify(pool, channel, own_id, send.clone())),
        ];
        Ok(Self { local, send, tasks })
    }
}

impl Drop for PostgresWakeup {
    fn drop(&mut self) {
        self.tasks.iter().for_each(JoinHandle::abort);
    }
}

#[async_trait]
impl Wakeup for PostgresWakeup {
    fn mark(&self) -> u64 {
        self.local.mark()
    }

    fn hint(&self) {
        self.local.hint();
        self.send.notify_one();
    }

    async fn wait(&self, mark: u64, timeout: Duration) {
        self.local.wait(mark, timeout).await;
    }
}

async fn listen(
    mut listener: PgListener,
    pool: PgPool,
    channel: String,
    own_id: String,
    local: Arc<LocalWakeup>,
) {
    loop {
        if let Err(error) = pass_on(&mut listener, &channel, &own_id, &local).await {
            tracing::warn!(%error, "hints from other servers are not heard; waiting calls poll instead");
        }
        loop {
            tokio::time::sleep(RECONNECT_AFTER).await;
            if let Ok(fresh) = PgListener::connect_with(&pool).await {
                listener = fresh;
                break;
            }
        }
    }
}

/// Passes notifications on until the connection is lost.
async fn pass_on(
    listener: &mut PgListener,
    channel: &str,
    own_id: &str,
    local: &LocalWakeup,
) -> Result<(), sqlx::Error> {
    listener.listen(channel).await?;
    // Nobody heard earlier notifications.
    local.hint();
    while let Some(notification) = listener.try_recv().await? {
        if notification.payload() != own_id {
            local.hint();
        }
    }
    Ok(())
}

async fn notify(pool: PgPool, channel: String, own_id: String, send: Arc<Notify>) {
    loop {
        send.notified().await;
        let sent = sqlx::query("SELECT pg_notify($1, $2)").bind(&channel).bind(&own_id).execute(&pool).await;
        if let Err(error) = sent {
            tracing::debug!(%error, "a hint for other servers was lost");
        }
    }
}
