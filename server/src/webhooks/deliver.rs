//! One end, told to one address: tried again until it is taken.

use std::time::Duration;

use lightkiln_proto::api::Bake;
use reqwest::{Client, Url, redirect};
use serde_json::json;
use tokio::sync::Semaphore;

use super::{WebhookConfig, address, sign};
use crate::clock::{Clock as _, SystemClock};

/// Longest wait between tries.
const LONGEST_WAIT: Duration = Duration::from_secs(300);

/// A message and its address.
pub(super) struct Delivery {
    id: String,
    url: Url,
    body: Vec<u8>,
}

impl Delivery {
    /// Of a bake that has ended; nothing of one that has not.
    pub(super) fn of(bake: &Bake, url: Url) -> Option<Self> {
        let end = bake.state.is_final().then(|| bake.state.name())?;
        let id = format!("{}.{end}", bake.id);
        let body = json!({"id": id, "type": format!("bake.{end}"), "at_ms": bake.finished_ms, "bake": bake});
        Some(Self { body: serde_json::to_vec(&body).ok()?, id, url })
    }

    /// Tries until it is taken, or as often as the configuration says.
    pub(super) async fn deliver(&self, config: &WebhookConfig, places: &Semaphore) -> bool {
        let mut wait = config.first_wait;
        for attempt in 1..=config.attempts {
            // Not held while it waits: others may have their turn.
            let Ok(place) = places.acquire().await else { return false };
            let tried = self.once(config).await;
            drop(place);
            match tried {
                Ok(()) => {
                    tracing::info!(
                        delivery = self.id,
                        host = self.host(),
                        attempt,
                        "a webhook was delivered"
                    );
                    return true;
                }
                Err(why) => {
                    tracing::warn!(
                        delivery = self.id,
                        host = self.host(),
                        attempt,
                        why,
                        "a webhook was not delivered"
                    );
                }
            }
            if attempt < config.attempts {
                tokio::time::sleep(wait).await;
                wait = (wait * 2).min(LONGEST_WAIT);
            }
        }
        tracing::error!(delivery = self.id, host = self.host(), "a webhook is given up");
        false
    }

    /// Paths and queries of such URLs often hold secrets.
    fn host(&self) -> &str {
        self.url.host_str().unwrap_or_default()
    }

    async fn once(&self, config: &WebhookConfig) -> Result<(), String> {
        let addresses = address::resolve(&self.url, config.allow_local).await?;
        let told = |error: reqwest::Error| {
            let error = error.without_url();
            let cause =
                std::error::Error::source(&error).map(|cause| format!(": {cause}")).unwrap_or_default();
            format!("{error}{cause}")
        };
        let client = Client::builder()
            .timeout(config.timeout)
            // A redirection could lead where this may not go, and a proxy look a name up elsewhere.
            .redirect(redirect::Policy::none())
            .no_proxy()
            .resolve_to_addrs(self.host(), &addresses)
            .user_agent(concat!("lightkiln/", env!("CARGO_PKG_VERSION")))
            .build()
            .map_err(told)?;
        let at_secs = SystemClock.now_ms() / 1000;
        let signature = sign::signature(&config.secret, at_secs, &self.body).ok_or("it cannot be signed")?;
        let answer = client
            .post(self.url.clone())
            .header("Content-Type", "application/json")
            .header("Lightkiln-Delivery", &self.id)
            .header("Lightkiln-Signature", signature)
            .body(self.body.clone())
            .send()
            .await
            .map_err(told)?;
        match answer.status() {
            status if status.is_success() => Ok(()),
            status => Err(format!("the answer was {status}")),
        }
    }
}
