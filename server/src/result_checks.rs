//! Checks of results before they are taken in.

use std::collections::BTreeMap;

use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{MAX_COUNTER, MAX_COUNTER_NAME_BYTES, MAX_COUNTERS, MAX_NOTE_BYTES, TaskResult};

use crate::error::{Result, ServerError};

/// Refuses a result whose outputs are not stored with the lengths that it says.
pub(crate) fn require_lengths(result: &TaskResult, there: &BTreeMap<Digest, u64>) -> Result<()> {
    for output in &result.outputs {
        let (name, digest, bytes) = (&output.name, output.digest, output.bytes);
        match there.get(&digest) {
            Some(length) if *length == bytes => (),
            Some(length) => {
                let what = format!("output '{name}' says {bytes} bytes, chunk {digest} has {length}");
                return Err(ServerError::bad_request(what));
            }
            None => return Err(ServerError::NoSuchOutput { name: name.clone(), digest }),
        }
    }
    Ok(())
}

/// Words for people are short. Sums of counters must stay numbers: JSON cannot say infinity, so a bake that had one could not be read any more.
pub(crate) fn check_counters(result: &TaskResult) -> Result<()> {
    let count = result.counters.len();
    if count > MAX_COUNTERS {
        return Err(ServerError::bad_request(format!(
            "counters must be at most {MAX_COUNTERS}, not {count}"
        )));
    }
    if result.note.len() > MAX_NOTE_BYTES || result.note.contains('\0') {
        let what = format!("the note must have at most {MAX_NOTE_BYTES} bytes, none of them 0");
        return Err(ServerError::bad_request(what));
    }
    for (name, value) in &result.counters {
        let shown: String = name.chars().take(40).collect();
        if name.len() > MAX_COUNTER_NAME_BYTES {
            let what = format!("the name of counter '{shown}…' has more than {MAX_COUNTER_NAME_BYTES} bytes");
            return Err(ServerError::bad_request(what));
        }
        if !(-MAX_COUNTER..=MAX_COUNTER).contains(value) {
            let what = format!("counter '{shown}' must be within ±{MAX_COUNTER:e}, not {value:e}");
            return Err(ServerError::bad_request(what));
        }
    }
    Ok(())
}
