//! Follows a bake on a server until it ends, showing its progress.

use lightkiln_client::fetch::ApiClient;
use lightkiln_proto::api::{Bake, BakeState, Blame, EventKind};

use crate::failure::{Exit, Failure, Result};
use crate::interrupt::Interrupt;
use crate::progress::ProgressView;

/// Seconds that one poll waits for news; short, so that Ctrl-C is heard soon.
const POLL_SECS: u32 = 1;

/// A bake that has ended, well or not.
pub struct Ended {
    /// As it stands for ever.
    pub bake: Bake,
    failed_kind: Option<String>,
    /// It failed by what it was given.
    is_input: bool,
}

/// Waits until the bake is done. `check` is asked between polls whether waiting still makes sense, and for a word to who waits.
///
/// Errors when the bake failed or was cancelled, on a signal, and when the server stays away.
pub fn follow(
    client: &ApiClient,
    id: &str,
    interrupt: &Interrupt,
    check: impl Fn() -> Result<Option<String>>,
) -> Result<Bake> {
    let ended = wait_for_end(client, id, interrupt, check)?;
    ended.judge()?;
    Ok(ended.bake)
}

/// As [`follow`], but a bake that failed or was cancelled is no error yet.
pub fn wait_for_end(
    client: &ApiClient,
    id: &str,
    interrupt: &Interrupt,
    check: impl Fn() -> Result<Option<String>>,
) -> Result<Ended> {
    let mut view = ProgressView::new();
    // From the first answer on it is the whole id, where a beginning of it was given.
    let mut id = id.to_owned();
    let mut seen = 0;
    let (mut failed_kind, mut is_input) = (None, false);
    loop {
        if interrupt.is_raised() {
            return Err(Failure::new(Exit::Interrupted, "interrupted"));
        }
        if let Some(word) = check()? {
            view.say(&word);
        }
        let page = client.events(&id, seen, POLL_SECS)?;
        id.clone_from(&page.bake.id);
        view.update(&page.bake, &page.events);
        for event in &page.events {
            seen = event.seq;
            if let EventKind::TaskFailed { kind, blame, retry: false, .. } = &event.event {
                (failed_kind, is_input) = (Some(kind.clone()), *blame == Blame::Task);
            }
        }
        if page.bake.state.is_final() && page.events.is_empty() {
            return Ok(Ended { bake: page.bake, failed_kind, is_input });
        }
    }
}

impl Ended {
    /// A bake that nobody waits for.
    pub fn not_yet(bake: Bake) -> Self {
        Self { bake, failed_kind: None, is_input: false }
    }

    /// An error unless the bake is done.
    pub fn judge(&self) -> Result<()> {
        let bake = &self.bake;
        match bake.state {
            BakeState::Done | BakeState::Running | BakeState::Paused => Ok(()),
            BakeState::Cancelled => {
                Err(Failure::new(Exit::Interrupted, format!("bake {} was cancelled", bake.id))
                    .try_this("the same command again goes on from what was done"))
            }
            BakeState::Failed => {
                let why = bake.failure.as_deref().unwrap_or("no reason was given");
                let exit = if self.is_input { Exit::BadInput } else { Exit::Failed };
                Err(Failure::new(exit, format!("bake {} failed: {why}", bake.id)))
            }
        }
    }

    /// The task kind in which the bake failed, if it did.
    pub fn failed_kind(&self) -> Option<&str> {
        self.failed_kind.as_deref().filter(|_| self.bake.state == BakeState::Failed)
    }
}
