//! Garbage collection of bakes and chunks, now and then. Any number of servers may do it beside each other.

use std::sync::Arc;
use std::time::Duration;

use crate::farm::Farm;
use crate::store::chunk::CollectRules;

/// Bakes and chunks of one transaction. More → fewer transactions, and longer waits of others meanwhile.
const BATCH: u32 = 500;

/// Retention of chunks and bakes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Retention {
    /// Chunks that nobody refers to stay this long after they were last asked for. Shorter → room is free sooner;
    /// it must be longer than any upload and the task or submission that follows it. Default: a day.
    pub grace: Duration,
    /// Bakes that ended this long ago are deleted, with the results that no other bake holds. Default: never.
    pub bakes: Option<Duration>,
    /// Looked for this often. Default: 10 minutes.
    pub interval: Duration,
}

impl Default for Retention {
    fn default() -> Self {
        let hour = Duration::from_secs(3600);
        Self { grace: 24 * hour, bakes: None, interval: hour / 6 }
    }
}

impl Retention {
    fn rules(&self) -> CollectRules {
        let ms = |time: Duration| i64::try_from(time.as_millis()).unwrap_or(i64::MAX / 2);
        CollectRules { grace_ms: ms(self.grace), keep_bakes_ms: self.bakes.map(ms), max: BATCH }
    }
}

/// Collects garbage for ever.
pub(crate) async fn run(farm: Arc<Farm>, retention: Retention) {
    let mut ticks = tokio::time::interval(retention.interval);
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    loop {
        ticks.tick().await;
        loop {
            match farm.collect(&retention.rules()).await {
                Ok(removed) if removed.is_partial => (),
                Ok(_) => break,
                Err(error) => {
                    tracing::error!(error = error.chain(), "garbage collection failed; trying again");
                    break;
                }
            }
        }
    }
}
