//! Webhooks: other services are told when a bake has ended.
//!
//! A watcher looks at the farm's bakes from time to time, as any client could, and hands each end to deliveries of its
//! own: the queue knows nothing of them and waits for nothing. Delivery is at least once: a server that starts tells
//! ends of the last hour again, and every server that has the flag tells. An end's id is always the same, so
//! that receivers can drop repeats.

mod address;
mod deliver;
mod sign;

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use lightkiln_proto::api::{Bake, BakeFilter};
use reqwest::Url;
use tokio::sync::{Semaphore, watch};
use tokio::time::Instant;

use crate::clock::{Clock as _, SystemClock};
use crate::error::ServerError;
use crate::farm::Farm;
use crate::store::{Result, StoreError};
use crate::tls::use_ring;
use deliver::Delivery;

/// Bakes on one page of the look at the farm.
const PAGE_BAKES: u32 = 100;
/// Bakes that are looked at when a server starts, newest first.
const BAKES_AT_START: usize = 2000;
/// Ends that a server tells again when it starts are at most this old. Longer → more repeats after a restart, and an
/// outage may be longer before an end is lost.
const LOOK_BACK_MS: i64 = 3600 * 1000;
/// Ends that are remembered as told.
const TOLD_MAX: usize = 10_000;
/// Deliveries under way to one address at a time; others wait.
const DELIVERIES_AT_A_TIME: usize = 16;

/// Receivers of webhooks, and the rules of delivery.
#[derive(Clone)]
pub struct WebhookConfig {
    /// Addresses that ends are posted to.
    pub urls: Vec<Url>,
    /// Key of the signatures of deliveries.
    pub secret: Arc<[u8]>,
    /// Deliver to this machine and its link, too. Default: no.
    pub allow_local: bool,
    /// The farm is looked at this often. Default: 2 s.
    pub interval: Duration,
    /// Tries of one delivery. Default: 10, within about ten minutes.
    pub attempts: u32,
    /// Wait after the first try that failed; it doubles each time, up to 5 minutes. Default: 1 s.
    pub first_wait: Duration,
    /// Longest time of one try. Default: 10 s.
    pub timeout: Duration,
}

/// The secret is in no log.
impl std::fmt::Debug for WebhookConfig {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("WebhookConfig").field("allow_local", &self.allow_local).finish_non_exhaustive()
    }
}

/// Shortest secret, in bytes.
const SECRET_BYTES_MIN: usize = 16;

impl WebhookConfig {
    /// The defaults for addresses and a secret, which are checked.
    pub fn new(urls: &[String], secret: &str, allow_local: bool) -> Result<Self, ServerError> {
        let wrong = |what: String| ServerError::Webhook { what };
        if secret.trim().len() < SECRET_BYTES_MIN {
            let what = format!("the secret has fewer than {SECRET_BYTES_MIN} bytes; make it of random ones");
            return Err(wrong(what));
        }
        let urls = urls.iter().map(|text| address::checked(text, allow_local).map_err(wrong));
        Ok(Self {
            urls: urls.collect::<Result<_, _>>()?,
            secret: secret.trim().as_bytes().into(),
            allow_local,
            interval: Duration::from_secs(2),
            attempts: 10,
            first_wait: Duration::from_secs(1),
            timeout: Duration::from_secs(10),
        })
    }
}

/// Tells of ends until the server closes.
pub(crate) async fn run(farm: Arc<Farm>, config: WebhookConfig, mut closing: watch::Receiver<bool>) {
    // Before the first call, also one without TLS.
    use_ring();
    let places = |_: &Url| Arc::new(Semaphore::new(DELIVERIES_AT_A_TIME));
    let places: Vec<Arc<Semaphore>> = config.urls.iter().map(places).collect();
    let config = Arc::new(config);
    let mut watcher = Watcher::default();
    let mut ticks = tokio::time::interval_at(Instant::now(), config.interval);
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            _ = ticks.tick() => (),
            _ = closing.wait_for(|closing| *closing) => return,
        }
        match watcher.look(&farm).await {
            Ok(ended) => {
                for bake in ended {
                    spawn_deliveries(&config, &places, &bake);
                }
            }
            Err(error) => tracing::warn!(%error, "webhooks wait: the farm's bakes cannot be read"),
        }
    }
}

fn spawn_deliveries(config: &Arc<WebhookConfig>, places: &[Arc<Semaphore>], bake: &Bake) {
    for (url, places) in config.urls.iter().zip(places) {
        let Some(delivery) = Delivery::of(bake, url.clone()) else { continue };
        let (config, places) = (config.clone(), places.clone());
        tokio::spawn(async move {
            delivery.deliver(&config, &places).await;
        });
    }
}

/// Bakes of the farm as the watcher knows them.
#[derive(Default)]
struct Watcher {
    has_looked: bool,
    /// Bakes that have not ended.
    live: BTreeSet<String>,
    /// Ends that were told, by time and id; the oldest are forgotten first.
    told: BTreeSet<(i64, String)>,
}

impl Watcher {
    /// Bakes whose end is to be told now.
    async fn look(&mut self, farm: &Farm) -> Result<Vec<Bake>> {
        let mut ended = Vec::new();
        for id in self.live.clone() {
            match farm.store.show(&id).await {
                Ok(bake) => self.meet(bake, &mut ended),
                Err(StoreError::NoSuchBake { .. }) => drop(self.live.remove(&id)),
                Err(error) => return Err(error),
            }
        }
        let most = if self.has_looked { usize::MAX } else { BAKES_AT_START };
        let (mut after, mut seen) = (None, 0);
        loop {
            let page = farm.store.list(&BakeFilter::default(), after, PAGE_BAKES).await?;
            seen += page.bakes.len();
            let has_known = page.bakes.iter().any(|bake| self.knows(bake));
            for bake in page.bakes {
                self.meet(bake, &mut ended);
            }
            // Bakes come newest first: behind one that was seen before there is nothing new.
            match page.next {
                Some(next) if seen < most && !(self.has_looked && has_known) => after = Some(next),
                _ => break,
            }
        }
        self.has_looked = true;
        Ok(ended)
    }

    fn knows(&self, bake: &Bake) -> bool {
        let told = bake.finished_ms.map(|at_ms| (at_ms, bake.id.clone()));
        self.live.contains(&bake.id) || told.is_some_and(|told| self.told.contains(&told))
    }

    fn meet(&mut self, bake: Bake, ended: &mut Vec<Bake>) {
        let finished_ms = match (bake.state.is_final(), bake.finished_ms) {
            (true, Some(finished_ms)) => finished_ms,
            (true, None) => return,
            (false, _) => {
                self.live.insert(bake.id);
                return;
            }
        };
        self.live.remove(&bake.id);
        let is_new = self.told.insert((finished_ms, bake.id.clone()));
        if self.told.len() > TOLD_MAX {
            self.told.pop_first();
        }
        if is_new && finished_ms >= SystemClock.now_ms() - LOOK_BACK_MS {
            ended.push(bake);
        }
    }
}
