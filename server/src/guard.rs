//! Asks callers for their tokens.
//!
//! A farm that never had a token asks nobody for one. From the first token on every call but those about health needs
//! one, also when all of them are revoked.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use lightkiln_proto::ids::Digest;
use tokio::sync::Mutex;

use crate::access::{Bearer, Scope};
use crate::clock::{Clock as _, SystemClock};
use crate::error::{Result, ServerError};
use crate::store::{FarmStore, StoreError};

/// Age limit of the tokens that a server remembers. Longer → fewer reads, and a revoked token is good for longer.
const KNOWN_FOR: Duration = Duration::from_secs(2);
/// After this every server has read a change: its memory is too old by then, however long the reading took.
const KNOWN_BY_ALL_AFTER: Duration = Duration::from_secs(3);
/// Longest token that is looked at, in bytes.
const TOKEN_BYTES_MAX: usize = 256;

/// Looks tokens up.
pub struct Guard {
    store: Arc<dyn FarmStore>,
    known: Mutex<Option<Known>>,
}

/// The bearers as they were a moment ago.
struct Known {
    at: Instant,
    is_guarded: bool,
    live: BTreeMap<Digest, Bearer>,
}

impl Known {
    fn new(bearers: Vec<Bearer>) -> Self {
        let is_guarded = !bearers.is_empty();
        let live = bearers.into_iter().filter(|bearer| bearer.revoked_ms.is_none());
        Self { at: Instant::now(), is_guarded, live: live.map(|bearer| (bearer.hash, bearer)).collect() }
    }

    /// Whose token it is, if one was needed.
    fn check(&self, token: Option<&str>, wanted: &[Scope]) -> Result<Option<Bearer>> {
        if !self.is_guarded || wanted.is_empty() {
            return Ok(None);
        }
        let token = token.ok_or(ServerError::Unauthorized { why: "the call has no token" })?;
        let hash = (token.len() <= TOKEN_BYTES_MAX).then(|| Digest::of(token.as_bytes()));
        let unknown = ServerError::Unauthorized { why: "the token is unknown or was revoked" };
        let bearer = hash.and_then(|hash| self.live.get(&hash)).ok_or(unknown)?;
        if bearer.scopes.iter().any(|scope| wanted.iter().any(|wanted| scope.opens(*wanted))) {
            return Ok(Some(bearer.clone()));
        }
        let wanted: Vec<&str> = wanted.iter().map(|scope| scope.name()).collect();
        Err(ServerError::Forbidden { wanted: wanted.join(" or ") })
    }
}

impl Guard {
    /// Over the farm's bearers.
    pub fn new(store: Arc<dyn FarmStore>) -> Self {
        Self { store, known: Mutex::default() }
    }

    /// Refuses a call without a token that opens one of the scopes. Its bearer, if one was needed.
    pub(crate) async fn check(&self, token: Option<&str>, wanted: &[Scope]) -> Result<Option<Bearer>> {
        let mut known = self.known.lock().await;
        match known.as_ref().filter(|known| known.at.elapsed() < KNOWN_FOR) {
            Some(known) => known.check(token, wanted),
            None => known.insert(Known::new(self.store.bearers().await?)).check(token, wanted),
        }
    }

    /// Makes the token with this digest a worker's, for a code that is good; the worker's name.
    ///
    /// Names are given once, in one transaction of the store: that a code is good for one token rests on it.
    pub(crate) async fn enrol(&self, code: &str, token: Digest) -> Result<String> {
        let refused = |why| ServerError::Unauthorized { why };
        let hash = Digest::of(code.as_bytes());
        let bearers = self.store.bearers().await?;
        let is_code = |bearer: &&Bearer| bearer.hash == hash && bearer.scopes == [Scope::Enrol].into();
        let code = bearers.iter().find(is_code).filter(|code| code.revoked_ms.is_none());
        let code = code.ok_or(refused("the code is unknown or was revoked"))?;
        if code.is_too_old(SystemClock.now_ms()) {
            return Err(refused("the code is too old; 'kiln token enrol' makes another"));
        }
        match self.store.add_bearer(code.worker(), token, &[Scope::Worker].into()).await {
            Ok(bearer) if bearer.revoked_ms.is_none() => {
                // When this is answered, every server of the farm knows the token.
                tokio::time::sleep(KNOWN_BY_ALL_AFTER).await;
                Ok(bearer.name)
            }
            Ok(_) => Err(refused("the token that this code was used for was revoked")),
            Err(StoreError::BearerExists { .. }) => {
                Err(refused("the code was used before; 'kiln token enrol' makes another"))
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Whether somebody has a token, so that nobody else gets in.
    pub(crate) async fn has_bearers(&self) -> Result<bool, StoreError> {
        Ok(!Known::new(self.store.bearers().await?).live.is_empty())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bearer(name: &str, scopes: &[Scope], revoked_ms: Option<i64>) -> Bearer {
        let scopes = scopes.iter().copied().collect();
        Bearer { name: name.into(), hash: Digest::of(name.as_bytes()), scopes, created_ms: 0, revoked_ms }
    }

    #[test]
    fn scopes_open_what_they_say() {
        use Scope::{Admin, Read, Submit, Worker};
        for (scope, opened) in [
            (Read, vec![Read]),
            (Submit, vec![Read, Submit]),
            (Worker, vec![Worker]),
            (Admin, Scope::ALL.to_vec()),
        ] {
            let known = Known::new(vec![bearer("token", &[scope], None)]);
            for wanted in Scope::ALL {
                let checked = known.check(Some("token"), &[wanted]);
                assert_eq!(checked.is_ok(), opened.contains(&wanted), "{scope} for {wanted}");
            }
        }
    }

    #[test]
    fn farm_is_open_until_its_first_token_and_never_again() {
        assert!(Known::new(Vec::new()).check(None, &[Scope::Admin]).is_ok());
        let known = Known::new(vec![bearer("token", &[Scope::Admin], Some(1))]);
        for token in [None, Some("token"), Some(""), Some(&*"x".repeat(TOKEN_BYTES_MAX + 1))] {
            let refused = known.check(token, &[Scope::Read]);
            assert!(matches!(refused, Err(ServerError::Unauthorized { .. })), "{token:?}");
        }
        assert!(known.check(None, &[]).is_ok(), "calls about health stay open");
    }

    #[test]
    fn code_opens_the_exchange_alone_and_is_no_scope_to_ask_for() {
        let known = Known::new(vec![bearer("code", &[Scope::Enrol], None)]);
        assert!(known.check(Some("code"), &[Scope::Enrol]).is_ok());
        for wanted in Scope::ALL {
            assert!(known.check(Some("code"), &[wanted]).is_err(), "{wanted}");
        }
    }
}
