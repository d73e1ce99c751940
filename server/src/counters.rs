//! Counters and notes of results: for people, and within limits.

use lightkiln_proto::jobs::{MAX_COUNTER, MAX_COUNTER_NAME_BYTES, MAX_COUNTERS, MAX_NOTE_BYTES, TaskResult};

use crate::error::{Result, ServerError};

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
