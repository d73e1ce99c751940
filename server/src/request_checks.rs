//! Checks of requests before the store is asked.

use std::ops::RangeInclusive;

use lightkiln_proto::api::{BakeLimits, ClaimRequest, NewBake};

use crate::error::{Result, ServerError};
use crate::random::is_fencing_token;
use crate::store::rules::MAX_TASK_NAME_BYTES;

/// Longest name of a bake, in characters.
pub const MAX_NAME_CHARS: usize = 200;
/// Longest Idempotency-Key and worker name, in characters.
pub const MAX_ID_CHARS: usize = 200;
/// Most labels of a worker or a bake.
pub const MAX_LABELS: usize = 16;
/// Longest label, in characters.
pub const MAX_LABEL_CHARS: usize = 64;
/// Seconds that one attempt may take.
pub const ATTEMPT_LIMIT_SECS: RangeInclusive<u32> = 1..=604_800;
/// Workers that a bake may be limited to.
pub const MAX_WORKERS: RangeInclusive<u32> = 1..=100_000;
/// Attempts that a bake may be limited to.
pub const MAX_ATTEMPTS: RangeInclusive<u32> = 1..=1_000;
/// Lost workers that a bake may be limited to.
pub const MAX_LOST_WORKERS: RangeInclusive<u32> = 1..=1_000_000;
/// Most leases of one claim.
pub const MAX_LEASES: u32 = 64;
/// Most task kinds that one claim names.
pub const MAX_KINDS: usize = 64;
/// Longest kind of a task, in bytes.
pub const MAX_KIND_BYTES: usize = MAX_TASK_NAME_BYTES;
/// Lease lengths in seconds.
pub const TTL_SECS: RangeInclusive<u32> = 5..=3600;
/// Longest wait of a long poll, in seconds.
pub const MAX_WAIT_SECS: u32 = 60;

pub(crate) fn check_needs(bake: &NewBake) -> Result<()> {
    check_labels("needs.labels", &bake.needs.labels)?;
    let BakeLimits { max_workers, attempts, lost_workers } = bake.limits;
    let limits = [
        ("attempt_limit_secs", bake.attempt_limit_secs, ATTEMPT_LIMIT_SECS),
        ("limits.max_workers", max_workers, MAX_WORKERS),
        ("limits.attempts", attempts, MAX_ATTEMPTS),
        ("limits.lost_workers", lost_workers, MAX_LOST_WORKERS),
    ];
    for (name, limit, range) in limits {
        if let Some(limit) = limit.filter(|limit| !range.contains(limit)) {
            return Err(ServerError::bad_request(format!("{name} must be within {range:?}, not {limit}")));
        }
    }
    Ok(())
}

pub(crate) fn check_share(share: f64) -> Result<()> {
    if (0.0..=1.0).contains(&share) {
        return Ok(());
    }
    Err(ServerError::bad_request(format!("verify_share must be within 0..=1, not {share}")))
}

pub(crate) fn check_labels(name: &str, labels: &[String]) -> Result<()> {
    if labels.len() > MAX_LABELS {
        return Err(ServerError::bad_request(format!(
            "{name} must be at most {MAX_LABELS}, not {}",
            labels.len()
        )));
    }
    labels.iter().try_for_each(|label| require_chars(name, label, 1, MAX_LABEL_CHARS))
}

pub(crate) fn check_claim(request: &ClaimRequest) -> Result<()> {
    require_chars("worker", &request.worker, 1, MAX_ID_CHARS)?;
    check_labels("labels", &request.labels)?;
    require_chars("machine", &request.machine, 0, MAX_ID_CHARS)?;
    let limits = [
        ("max", (1..=MAX_LEASES).contains(&request.max), format!("1..={MAX_LEASES}")),
        ("ttl_secs", TTL_SECS.contains(&request.ttl_secs), format!("{TTL_SECS:?}")),
        ("wait_secs", request.wait_secs <= MAX_WAIT_SECS, format!("0..={MAX_WAIT_SECS}")),
        ("number of kinds", request.kinds.len() <= MAX_KINDS, format!("0..={MAX_KINDS}")),
    ];
    match limits.into_iter().find(|(_, is_within, _)| !is_within) {
        Some((name, _, range)) => Err(ServerError::bad_request(format!("{name} must be within {range}"))),
        None => Ok(()),
    }
}

pub(crate) fn require_chars(name: &str, text: &str, min: usize, max: usize) -> Result<()> {
    let count = text.chars().count();
    if (min..=max).contains(&count) {
        return Ok(());
    }
    Err(ServerError::bad_request(format!("{name} must have {min} to {max} characters, not {count}")))
}

pub(crate) fn require_token(token: &str) -> Result<()> {
    if is_fencing_token(token) { Ok(()) } else { Err(ServerError::NoSuchLease) }
}
