//! Who may do what: bearer tokens, known by their digests, and the scopes that they open.
//!
//! A farm that never had a token asks nobody for one. From the first token on every call but those about health needs
//! one, also when all of them are revoked.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use lightkiln_proto::ids::Digest;
use serde::{Deserialize, Serialize};
use thiserror::Error;
use tokio::sync::Mutex;

use crate::clock::{Clock as _, SystemClock};
use crate::error::ServerError;
use crate::store::{FarmStore, StoreError, random_secret};

/// What servers know of the tokens is at most this old. Longer → fewer reads, and a revoked token is good for longer.
const KNOWN_FOR: Duration = Duration::from_secs(2);
/// After this every server has read a change: what it knows is too old by then, however long the reading took.
const KNOWN_BY_ALL_AFTER: Duration = Duration::from_secs(3);
/// Longest name of a bearer, in characters.
const NAME_CHARS_MAX: usize = 64;
/// Longest token that is looked at, in bytes.
const TOKEN_BYTES_MAX: usize = 256;
/// What tokens begin with, so that they are recognised where they should not be.
const TOKEN_PREFIX: &str = "kiln_";
/// What codes begin with.
const CODE_PREFIX: &str = "kilncode_";
/// What stands in a code's name behind that of the worker; random characters follow, as names are given once.
const CODE_MARK: &str = ".code-";
/// How many of them.
const CODE_MARK_CHARS: usize = 8;
/// How long a code is good for. Longer → more time to walk to a machine, and for whoever finds the code.
pub const CODE_LIFETIME: Duration = Duration::from_secs(3600);

/// A part of the API.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Scope {
    /// Bakes, events, chunks, workers and metrics can be read.
    Read,
    /// Scenes and bakes can be sent, bakes changed and cancelled; includes reading.
    Submit,
    /// Tasks can be taken, artefacts stored and results handed in.
    Worker,
    /// Everything.
    Admin,
    /// A worker's token can be had for it, once: the scope of codes, and of nothing else.
    Enrol,
}

impl Scope {
    /// All scopes that a token can be made with.
    pub const ALL: [Self; 4] = [Self::Read, Self::Submit, Self::Worker, Self::Admin];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Submit => "submit",
            Self::Worker => "worker",
            Self::Admin => "admin",
            Self::Enrol => "enrol",
        }
    }

    fn opens(self, wanted: Self) -> bool {
        self == wanted || self == Self::Admin || (self == Self::Submit && wanted == Self::Read)
    }
}

impl fmt::Display for Scope {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Scope {
    type Err = AccessError;

    fn from_str(text: &str) -> Result<Self, AccessError> {
        let found = Self::ALL.into_iter().find(|scope| scope.name() == text);
        found.ok_or_else(|| AccessError::NoScope { text: text.chars().take(80).collect() })
    }
}

/// What is wrong with a bearer.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum AccessError {
    /// No such scope.
    #[error("'{text}' is no scope; there are read, submit, worker and admin")]
    NoScope {
        /// What was given.
        text: String,
    },
    /// No good name.
    #[error("a token's name has 1 to {NAME_CHARS_MAX} letters, digits, '.', '_' or '-', unlike '{text}'")]
    Name {
        /// What was given.
        text: String,
    },
}

/// Someone who has a token. The token itself is known to nobody else.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Bearer {
    /// Unique on the farm, for ever.
    pub name: String,
    /// Digest of the token.
    pub hash: Digest,
    /// What it opens.
    pub scopes: BTreeSet<Scope>,
    /// When it was made, in Unix milliseconds.
    pub created_ms: i64,
    /// Since when it opens nothing any more.
    pub revoked_ms: Option<i64>,
}

/// A bearer to make, and its token, which is shown once.
pub struct NewBearer {
    /// Its name.
    pub name: String,
    /// Its token; random, so that a plain digest tells nothing of it.
    pub token: String,
}

impl NewBearer {
    /// A new token for a name.
    pub fn named(name: &str) -> Result<Self, ServerError> {
        let is_good = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-');
        if !(1..=NAME_CHARS_MAX).contains(&name.chars().count()) || !name.chars().all(is_good) {
            return Err(AccessError::Name { text: name.chars().take(80).collect() }.into());
        }
        Ok(Self { name: name.to_owned(), token: format!("{TOKEN_PREFIX}{}", random_secret()?) })
    }

    /// A code for a worker, which exchanges it for a token that is listed by the worker's name.
    pub fn code_for(worker: &str) -> Result<Self, ServerError> {
        let mark: String = random_secret()?.chars().take(CODE_MARK_CHARS).collect();
        // Its own name, too, must do.
        Self::named(worker)?;
        let named = Self::named(&format!("{worker}{CODE_MARK}{mark}"))?;
        Ok(Self { token: format!("{CODE_PREFIX}{}", random_secret()?), ..named })
    }

    /// What is stored of the token.
    pub fn hash(&self) -> Digest {
        Digest::of(self.token.as_bytes())
    }
}

/// Looks tokens up.
pub struct Guard {
    store: Arc<dyn FarmStore>,
    known: Mutex<Option<Known>>,
}

/// The bearers as they were a moment ago.
struct Known {
    at: Instant,
    is_guarded: bool,
    live: BTreeMap<Digest, BTreeSet<Scope>>,
}

impl Known {
    fn new(bearers: Vec<Bearer>) -> Self {
        let is_guarded = !bearers.is_empty();
        let live = bearers.into_iter().filter(|bearer| bearer.revoked_ms.is_none());
        Self {
            at: Instant::now(),
            is_guarded,
            live: live.map(|bearer| (bearer.hash, bearer.scopes)).collect(),
        }
    }

    /// The digest of the token, if one was needed.
    fn check(&self, token: Option<&str>, wanted: &[Scope]) -> Result<Option<Digest>, ServerError> {
        if !self.is_guarded || wanted.is_empty() {
            return Ok(None);
        }
        let token = token.ok_or(ServerError::Unauthorized { why: "the call has no token" })?;
        let hash = (token.len() <= TOKEN_BYTES_MAX).then(|| Digest::of(token.as_bytes()));
        let known = hash.and_then(|hash| Some((hash, self.live.get(&hash)?)));
        let unknown = ServerError::Unauthorized { why: "the token is unknown or was revoked" };
        let (hash, scopes) = known.ok_or(unknown)?;
        if scopes.iter().any(|scope| wanted.iter().any(|wanted| scope.opens(*wanted))) {
            return Ok(Some(hash));
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

    /// Refuses a call without a token that opens one of the scopes. The token's digest, if one was needed.
    pub(crate) async fn check(
        &self,
        token: Option<&str>,
        wanted: &[Scope],
    ) -> Result<Option<Digest>, ServerError> {
        let mut known = self.known.lock().await;
        match known.as_ref().filter(|known| known.at.elapsed() < KNOWN_FOR) {
            Some(known) => known.check(token, wanted),
            None => known.insert(Known::new(self.store.bearers().await?)).check(token, wanted),
        }
    }

    /// Makes the token with this digest a worker's, for a code that is good; the worker's name.
    ///
    /// Names are given once, in one transaction of the store: that a code is good for one token rests on it.
    pub(crate) async fn enrol(&self, code: &str, token: Digest) -> Result<String, ServerError> {
        let refused = |why| ServerError::Unauthorized { why };
        let hash = Digest::of(code.as_bytes());
        let bearers = self.store.bearers().await?;
        let is_code = |bearer: &&Bearer| bearer.hash == hash && bearer.scopes == [Scope::Enrol].into();
        let code = bearers.iter().find(is_code).filter(|code| code.revoked_ms.is_none());
        let code = code.ok_or(refused("the code is unknown or was revoked"))?;
        let age_ms = SystemClock.now_ms().saturating_sub(code.created_ms);
        if u128::try_from(age_ms).is_ok_and(|age| age > CODE_LIFETIME.as_millis()) {
            return Err(refused("the code is too old; 'kiln token enrol' makes another"));
        }
        let worker = code.name.rsplit_once(CODE_MARK).map_or(code.name.as_str(), |(worker, _)| worker);
        match self.store.add_bearer(worker, token, &[Scope::Worker].into()).await {
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
        assert!("enrol".parse::<Scope>().is_err());
        let code = NewBearer::code_for("oven").unwrap();
        assert!(code.name.starts_with("oven.code-") && code.token.starts_with(CODE_PREFIX), "{}", code.name);
        assert!(NewBearer::code_for("with space").is_err());
    }

    #[test]
    fn names_and_scopes_are_checked() {
        for name in ["", "with space", "ä", &"x".repeat(NAME_CHARS_MAX + 1)] {
            assert!(NewBearer::named(name).is_err(), "{name}");
        }
        let [a, b] = ["a", "b"].map(|name| NewBearer::named(name).unwrap());
        assert!(a.token != b.token && a.token.starts_with(TOKEN_PREFIX) && a.token.len() > 64);
        assert_eq!("worker".parse(), Ok(Scope::Worker));
        assert!("all".parse::<Scope>().is_err());
    }
}
