//! What ended processes leave in a state folder that bakes share: bakes that nobody waits for, and tasks under way that
//! others may want too.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use lightkiln_proto::api::{BakeFilter, BakeState};
use tokio::time::MissedTickBehavior;

use crate::error::Result;
use crate::farm::Farm;
use crate::hold;
use crate::store::{FarmStore, SqlStore};

/// Bakes that one look at the queue lists.
const PAGE_BAKES: u32 = 100;

/// Cancels bakes that are nobody's: those of seats that are not held, and those from before seats. Workers of free seats
/// have ended, so their tasks are given back.
pub(crate) async fn clear(store: &SqlStore, held: &[String], free: &[(String, u32)]) -> Result<()> {
    let live = BakeFilter { states: vec![BakeState::Running, BakeState::Paused], ..BakeFilter::default() };
    let mut after = None;
    loop {
        let page = store.list(&live, after, PAGE_BAKES).await?;
        for bake in &page.bakes {
            if held.iter().any(|name| bake.needs.labels.contains(name)) {
                continue;
            }
            tracing::info!(bake = bake.id, "a bake was left by a process that has ended; it is cancelled");
            store.cancel(&bake.id).await?;
        }
        match page.next {
            Some(next) => after = Some(next),
            None => break,
        }
    }
    for (worker, _) in free {
        let released = store.release_all(worker).await?;
        if released > 0 {
            tracing::info!(
                worker,
                released,
                "tasks were left by a process that has ended; others may take them"
            );
        }
    }
    Ok(())
}

/// Looks from time to time whether a process has left its seat, and clears up after it at once: whoever wants its tasks
/// too need not wait until its leases have run out.
pub(crate) async fn watch(farm: Arc<Farm>, store: Arc<SqlStore>, folder: PathBuf, interval: Duration) {
    let mut ticks = tokio::time::interval(interval);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut cleared = Vec::new();
    loop {
        ticks.tick().await;
        let looked = async {
            // Somebody who takes a seat clears up himself.
            let Some(seats) = hold::seats(&folder)?.filter(|seats| seats.free != cleared) else {
                return Ok(None);
            };
            clear(&store, &seats.held, &seats.free).await?;
            farm.wakeup.hint();
            Ok::<_, crate::ServerError>(Some(seats.free))
        };
        match looked.await {
            Ok(Some(free)) => cleared = free,
            Ok(None) => {}
            Err(error) => {
                tracing::warn!(
                    error = error.chain(),
                    "seats of ended processes could not be looked at; trying again"
                );
            }
        }
    }
}
