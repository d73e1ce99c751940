//! Artefacts as one task sees them: this worker's disk first, then the server; tried again until it answers or the
//! task is given up.

use std::error::Error;
use std::sync::Arc;
use std::time::Duration;

use lightkiln_http::{CallError, DiskCache, FOREVER, Level, ShutdownFlag, retry};
use lightkiln_proto::api::MAX_CHUNK_BYTES;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::Artefact;
use lightkiln_proto::trace::TARGET;

use super::abreast::abreast;
use super::aside::Aside;
use super::farm::Farm;
use super::trace::step;
use crate::task::{ArtefactSource, Cancelled, FetchError, Progress};

/// Times that an artefact may arrive with other bytes than its digest says.
const DAMAGED_ARRIVALS_MAX: u32 = 3;

/// Longer than any call takes; it ends by its own timeout first.
const PATIENCE: Duration = Duration::from_secs(3600);

/// Artefacts for the length of one lease.
pub(super) struct LeaseStore<'a> {
    pub(super) farm: &'a Farm,
    pub(super) disk: Option<&'a DiskCache>,
    pub(super) progress: &'a Progress,
    pub(super) shutdown: &'a ShutdownFlag,
}

impl LeaseStore<'_> {
    /// Makes `call` until it succeeds, is refused for good, or the task is given up: then nobody waits for an answer any more.
    pub(super) fn insist<T: Send + 'static>(
        &self,
        call: impl Fn(&Farm) -> Result<T, CallError> + Clone + Send + 'static,
    ) -> Result<T, CallError> {
        let is_given_up = |level| level == Level::Stop || self.progress.is_cancelled();
        let check = |level| if is_given_up(level) { Err(CallError::Stopped) } else { Ok(()) };
        check(self.shutdown.level())?;
        let once = || {
            let (farm, call) = (self.farm.clone(), call.clone());
            let aside = Aside::begin(self.shutdown, move || call(&farm));
            aside.wait(PATIENCE, is_given_up).unwrap_or(Err(CallError::Stopped))
        };
        retry(FOREVER, once, |error, wait| {
            let (error, wait_secs) = (error as &dyn Error, wait.as_secs_f64());
            tracing::warn!(error, wait_secs, "a call failed; trying again");
            check(self.shutdown.wait(wait, is_given_up))
        })
    }

    /// Stores artefacts by their names, many at a time, as [`Self::put`] does each.
    pub(super) fn put_all(&self, artefacts: &[(String, Arc<Vec<u8>>)]) -> Result<Vec<Artefact>, CallError> {
        abreast(artefacts, |(name, bytes)| self.put(name.clone(), bytes))
    }

    /// Stores an artefact unless the server has it, and keeps it for tasks that read it here.
    fn put(&self, name: String, bytes: &Arc<Vec<u8>>) -> Result<Artefact, CallError> {
        let length = bytes.len() as u64;
        // Asked for here, as a server may hang up on an upload before its refusal is read.
        if length > MAX_CHUNK_BYTES {
            let body = format!("the output '{name}'");
            return Err(CallError::TooLarge { body, bytes: length, limit: MAX_CHUNK_BYTES });
        }
        let digest = Digest::of(bytes);
        let _span =
            step(|| tracing::info_span!(target: TARGET, "upload", name, %digest, bytes = length)).entered();
        if !self.insist(move |farm| farm.has_artefact(digest, length))? {
            let sent = bytes.clone();
            self.insist(move |farm| farm.put_artefact(digest, &sent))?;
        }
        self.keep(digest, bytes);
        Ok(Artefact { name, digest, bytes: length })
    }

    /// A cache that cannot be written costs time later, not the task now.
    fn keep(&self, digest: Digest, bytes: &[u8]) {
        if let Some(Err(error)) = self.disk.map(|disk| disk.put(digest, bytes)) {
            tracing::warn!(%error, %digest, "an artefact could not be cached; check the cache folder's free space");
        }
    }

    fn fetch(&self, digest: Digest) -> Result<Vec<u8>, FetchError> {
        let _span = step(|| tracing::info_span!(target: TARGET, "fetch", %digest)).entered();
        for _ in 0..DAMAGED_ARRIVALS_MAX {
            let arrived =
                self.insist(move |farm| farm.artefact(digest)).map_err(|error| unavailable(digest, error))?;
            let bytes = arrived.ok_or(FetchError::NotFound { digest })?;
            if Digest::of(&bytes) == digest {
                return Ok(bytes);
            }
            tracing::warn!(%digest, "an artefact arrived damaged; fetching it again");
        }
        Err(FetchError::Corrupt { digest })
    }
}

fn unavailable(digest: Digest, error: CallError) -> FetchError {
    match error {
        CallError::Stopped => FetchError::Cancelled(Cancelled),
        error => FetchError::Unavailable { digest, source: Box::new(error) },
    }
}

impl ArtefactSource for LeaseStore<'_> {
    fn get(&self, digest: Digest) -> Result<Arc<Vec<u8>>, FetchError> {
        if let Some(bytes) = self.disk.and_then(|disk| disk.get(digest)) {
            return Ok(Arc::new(bytes));
        }
        let bytes = self.fetch(digest)?;
        self.keep(digest, &bytes);
        Ok(Arc::new(bytes))
    }

    /// Asks the server, as this worker's own copy is nobody else's.
    fn require(&self, artefact: &Artefact) -> Result<(), FetchError> {
        let Artefact { digest, bytes, .. } = *artefact;
        match self.insist(move |farm| farm.has_artefact(digest, bytes)) {
            Ok(true) => Ok(()),
            Ok(false) => Err(FetchError::NotFound { digest }),
            Err(error) => Err(unavailable(digest, error)),
        }
    }

    fn require_all(&self, artefacts: &[&Artefact]) -> Result<(), FetchError> {
        abreast(artefacts, |artefact| self.require(artefact)).map(drop)
    }

    /// Fetches those that are not on the disk. Without one nothing would keep them until they are asked for.
    fn bring(&self, digests: &[Digest]) -> Result<(), FetchError> {
        if self.disk.is_none() {
            return Ok(());
        }
        abreast(digests, |digest| self.get(*digest).map(drop)).map(drop)
    }
}
