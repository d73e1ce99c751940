//! Bearer tokens, known by their digests, and the scopes that they open.
//!
//! [`crate::guard`] asks for the tokens.

use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use lightkiln_proto::ids::Digest;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::random;

/// Longest name of a bearer, in characters.
const NAME_CHARS_MAX: usize = 64;
/// Prefix of tokens, so that they are recognised where they should not be.
const TOKEN_PREFIX: &str = "kiln_";
/// Prefix of codes.
const CODE_PREFIX: &str = "kilncode_";
/// Stands in a code's name behind that of the worker; random characters follow, as names are given once.
const CODE_MARK: &str = ".code-";
/// Number of these characters.
const CODE_MARK_CHARS: usize = 8;
/// Lifetime of a code. Longer → more time to walk to a machine, and for whoever finds the code.
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

    pub(crate) fn opens(self, wanted: Self) -> bool {
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

/// Errors in a bearer's name or scopes.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum AccessError {
    /// No such scope.
    #[error("'{text}' is no scope; there are read, submit, worker and admin")]
    NoScope {
        /// The text given.
        text: String,
    },
    /// No good name.
    #[error("a token's name has 1 to {NAME_CHARS_MAX} letters, digits, '.', '_' or '-', unlike '{text}'")]
    Name {
        /// The text given.
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
    /// Scopes that it opens.
    pub scopes: BTreeSet<Scope>,
    /// When it was made, in Unix milliseconds.
    pub created_ms: i64,
    /// Time of its revocation, in Unix milliseconds; it opens nothing any more.
    pub revoked_ms: Option<i64>,
}

/// Standing of a bearer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// It opens its scopes.
    Good,
    /// It was revoked.
    Revoked,
    /// A code for which a worker has its token.
    Used,
    /// A code that nobody used in time.
    TooOld,
}

impl Standing {
    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Revoked => "revoked",
            Self::Used => "used",
            Self::TooOld => "too old",
        }
    }
}

impl Bearer {
    /// Standing among all bearers of a farm, at a time in Unix milliseconds.
    pub fn standing(&self, all: &[Self], now_ms: i64) -> Standing {
        let is_code = self.scopes.contains(&Scope::Enrol);
        let is_for = |other: &Self| other.name == self.worker() && other.created_ms >= self.created_ms;
        if self.revoked_ms.is_some() {
            Standing::Revoked
        } else if is_code && all.iter().any(is_for) {
            Standing::Used
        } else if is_code && self.is_too_old(now_ms) {
            Standing::TooOld
        } else {
            Standing::Good
        }
    }

    /// The lifetime of codes is over since it was made.
    pub(crate) fn is_too_old(&self, now_ms: i64) -> bool {
        u128::try_from(now_ms.saturating_sub(self.created_ms))
            .is_ok_and(|age| age > CODE_LIFETIME.as_millis())
    }

    /// The worker that a code is for.
    pub(crate) fn worker(&self) -> &str {
        self.name.rsplit_once(CODE_MARK).map_or(&self.name, |(worker, _)| worker)
    }
}

/// A lease's token as its holder has it, and the other way round: whoever has it opens the lease only together with the bearer's own token
/// that claimed it. Nothing is stored for it, and without bearers both are one.
pub(crate) fn bound_to(bearer: Option<&Bearer>, lease_token: &str) -> String {
    let Some(bearer) = bearer.filter(|_| random::is_fencing_token(lease_token)) else {
        return lease_token.to_owned();
    };
    let mask = Digest::of(&[b"lease of ", &bearer.hash.0[..]].concat());
    let digits = lease_token.bytes().zip(mask.to_string().into_bytes());
    digits.map(|(digit, mask)| char::from(HEX[usize::from(value(digit) ^ value(mask))])).collect()
}

/// Hexadecimal digits.
const HEX: &[u8; 16] = b"0123456789abcdef";

fn value(digit: u8) -> u8 {
    if digit.is_ascii_digit() { digit - b'0' } else { digit - b'a' + 10 }
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
    pub fn named(name: &str) -> Result<Self, AccessError> {
        let is_good = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-');
        if !(1..=NAME_CHARS_MAX).contains(&name.chars().count()) || !name.chars().all(is_good) {
            return Err(AccessError::Name { text: name.chars().take(80).collect() });
        }
        Ok(Self { name: name.to_owned(), token: format!("{TOKEN_PREFIX}{}", random::secret()) })
    }

    /// A code for a worker, which exchanges it for a token that is listed by the worker's name.
    pub fn code_for(worker: &str) -> Result<Self, AccessError> {
        let mark: String = random::secret().chars().take(CODE_MARK_CHARS).collect();
        // Its own name, too, must do.
        Self::named(worker)?;
        let named = Self::named(&format!("{worker}{CODE_MARK}{mark}"))?;
        Ok(Self { token: format!("{CODE_PREFIX}{}", random::secret()), ..named })
    }

    /// The digest that is stored of the token.
    pub fn hash(&self) -> Digest {
        Digest::of(self.token.as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lease_token_is_another_one_with_each_bearer_and_comes_back_with_its_own() {
        let bearer = |name: &str| {
            let (hash, scopes) = (Digest::of(name.as_bytes()), BTreeSet::new());
            Bearer { name: name.to_owned(), hash, scopes, created_ms: 0, revoked_ms: None }
        };
        let (a, b) = (bearer("a"), bearer("b"));
        let token = random::fencing_token();
        let bound = bound_to(Some(&a), &token);
        assert!(random::is_fencing_token(&bound) && bound != token);
        assert_eq!(bound_to(Some(&a), &bound), token);
        assert!(bound_to(Some(&b), &bound) != token && bound_to(None, &bound) != token);
        assert_eq!(bound_to(None, &token), token);
        assert_eq!(bound_to(Some(&a), "no token"), "no token");
    }

    #[test]
    fn codes_are_good_until_they_are_used_or_too_old() {
        let bearer = |name: &str, scope: Scope, created_ms: i64| {
            let (hash, scopes) = (Digest::of(name.as_bytes()), BTreeSet::from([scope]));
            Bearer { name: name.to_owned(), hash, scopes, created_ms, revoked_ms: None }
        };
        let code = bearer("oven.code-abcd", Scope::Enrol, 1000);
        let all = |others: &[Bearer]| [std::slice::from_ref(&code), others].concat();
        let late_ms = 1001 + CODE_LIFETIME.as_millis() as i64;
        assert_eq!(code.standing(&all(&[]), 2000), Standing::Good);
        assert_eq!(code.standing(&all(&[bearer("kiln", Scope::Worker, 1500)]), 2000), Standing::Good);
        assert_eq!(code.standing(&all(&[]), late_ms), Standing::TooOld);
        let worker = bearer("oven", Scope::Worker, 1500);
        assert_eq!(code.standing(&all(std::slice::from_ref(&worker)), late_ms), Standing::Used);
        assert_eq!(worker.standing(&all(&[]), late_ms), Standing::Good);
        let revoked = Bearer { revoked_ms: Some(1200), ..code.clone() };
        assert_eq!(revoked.standing(&all(&[worker]), 2000), Standing::Revoked);
    }

    #[test]
    fn names_and_scopes_are_checked() {
        for name in ["", "with space", "ä", &"x".repeat(NAME_CHARS_MAX + 1)] {
            assert!(NewBearer::named(name).is_err(), "{name}");
        }
        assert!(NewBearer::code_for("with space").is_err());
        let code = NewBearer::code_for("oven").unwrap();
        assert!(code.name.starts_with("oven.code-") && code.token.starts_with(CODE_PREFIX), "{}", code.name);
        let [a, b] = ["a", "b"].map(|name| NewBearer::named(name).unwrap());
        assert!(a.token != b.token && a.token.starts_with(TOKEN_PREFIX) && a.token.len() > 64);
        assert_eq!("worker".parse(), Ok(Scope::Worker));
        assert!(["all", "enrol"].iter().all(|text| text.parse::<Scope>().is_err()));
    }
}
