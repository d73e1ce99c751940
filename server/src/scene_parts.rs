//! Big scenes, uploaded part by part: an upload that is cut goes on with the parts that are missing, on any server.
//!
//! A part is a chunk of its own, named by its digest, checked when it comes, and cleared away like any chunk that nobody
//! needs once the grace is over. So nothing has to be remembered of an upload under way: who wants to go on says which
//! parts there are, and is told which are missing. Once none is, they are put together and checked as a whole.

use std::collections::BTreeMap;
use std::sync::Arc;

use futures::{StreamExt, TryStreamExt};
use lightkiln_proto::api::{
    MAX_CHUNK_BYTES, MAX_SCENE_PART_BYTES, MAX_SCENE_PARTS, ScenePart, SceneParts, SceneProgress,
};
use lightkiln_proto::ids::Digest;

use crate::chunks::ChunkError;
use crate::error::{Result, ServerError};
use crate::farm::Farm;

/// Parts that are looked up at a time.
const CALLS_IN_FLIGHT: usize = 16;

impl Farm {
    /// Says which parts of a scene are missing; if none is, stores the scene.
    pub async fn put_scene_together(
        self: &Arc<Self>,
        scene: Digest,
        parts: SceneParts,
    ) -> Result<SceneProgress> {
        let parts = parts.parts;
        check(&parts)?;
        let done = SceneProgress { is_stored: true, missing: Vec::new() };
        if self.storage.length(scene).await?.is_some() {
            return Ok(done);
        }
        let missing = self.missing(&parts).await?;
        if !missing.is_empty() {
            return Ok(SceneProgress { is_stored: false, missing });
        }
        let farm = self.clone();
        // Goes on when the caller hangs up: whoever asks again finds the scene.
        let putting = tokio::spawn(async move {
            // One at a time: it costs reading and writing, and the same scene is put together once.
            let _turn = farm.scene_parts.lock().await;
            if farm.storage.length(scene).await?.is_none() {
                farm.storage.put_together(scene, &parts).await?;
            }
            Ok::<_, ServerError>(())
        });
        putting.await.map_err(|_| ServerError::Panicked)??;
        Ok(done)
    }

    /// Parts that are not stored, by digest. Those that are stay for the grace from now on.
    async fn missing(&self, parts: &[ScenePart]) -> Result<Vec<Digest>> {
        let looks = futures::stream::iter(sizes(parts)?).map(|(digest, bytes)| async move {
            Ok::<_, ServerError>((digest, bytes, self.storage.length(digest).await?))
        });
        let looked: Vec<_> = looks.buffered(CALLS_IN_FLIGHT).try_collect().await?;
        let mut missing = Vec::new();
        for (digest, bytes, stored) in looked {
            match stored {
                Some(length) if length == bytes => (),
                Some(length) => {
                    return Err(ServerError::bad_request(format!(
                        "part {digest} has {length} bytes, not {bytes}"
                    )));
                }
                None => missing.push(digest),
            }
        }
        Ok(missing)
    }
}

/// Lengths by digest.
fn sizes(parts: &[ScenePart]) -> Result<BTreeMap<Digest, u64>> {
    let mut sizes = BTreeMap::new();
    for part in parts {
        if *sizes.entry(part.digest).or_insert(part.bytes) != part.bytes {
            return Err(ServerError::bad_request(format!("part {} is named with two lengths", part.digest)));
        }
    }
    Ok(sizes)
}

fn check(parts: &[ScenePart]) -> Result<()> {
    if !(1..=MAX_SCENE_PARTS).contains(&parts.len()) {
        return Err(ServerError::bad_request(format!(
            "parts must be 1 to {MAX_SCENE_PARTS}, not {}",
            parts.len()
        )));
    }
    if let Some(part) = parts.iter().find(|part| !(1..=MAX_SCENE_PART_BYTES).contains(&part.bytes)) {
        let (digest, bytes) = (part.digest, part.bytes);
        return Err(ServerError::bad_request(format!(
            "part {digest} must have 1 to {MAX_SCENE_PART_BYTES} bytes, not {bytes}"
        )));
    }
    // Neither the count nor the lengths are big enough for an overflow.
    if parts.iter().map(|part| part.bytes).sum::<u64>() > MAX_CHUNK_BYTES {
        return Err(ChunkError::TooLarge { limit: MAX_CHUNK_BYTES }.into());
    }
    Ok(())
}
