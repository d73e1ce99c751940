//! Bakes by beginnings of their ids, as people type them.

use lightkiln_proto::api::MIN_ID_CHARS;

use crate::error::{Result, ServerError};
use crate::random::BAKE_ID_CHARS;
use crate::store::{FarmStore, Named};

/// Most bakes that are named where a beginning is that of several.
const CANDIDATES_MAX: usize = 8;

/// The whole id of the one bake whose id begins with `text`. Other texts are given back as they are: the call that they
/// are for says that there is no such bake.
pub async fn whole_id(store: &dyn FarmStore, text: String) -> Result<String> {
    let is_hex = text.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'));
    if !is_hex || text.len() >= BAKE_ID_CHARS {
        return Ok(text);
    }
    if text.len() < MIN_ID_CHARS {
        return Err(ServerError::ShortId { text });
    }
    let mut found = store.begin_with(&text, CANDIDATES_MAX as u32 + 1).await?;
    match found.len() {
        0 => Ok(text),
        1 => Ok(found.remove(0).id),
        _ => Err(ServerError::AmbiguousId { candidates: candidates(&found), text }),
    }
}

/// The bakes in words, a line each.
fn candidates(found: &[Named]) -> String {
    let shown = found.iter().take(CANDIDATES_MAX);
    let mut lines: Vec<String> =
        shown.map(|bake| format!("\n  {}  {:9}  {}", bake.id, bake.state.name(), bake.name)).collect();
    if found.len() > CANDIDATES_MAX {
        lines.push("\n  and more".to_owned());
    }
    lines.concat()
}
