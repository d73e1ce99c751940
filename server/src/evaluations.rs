//! Evaluations of bakes: the index that names their files, attached once all of them are stored.

use std::collections::BTreeSet;

use futures::TryStreamExt as _;
use lightkiln_proto::evaluation::EvaluationIndex;
use lightkiln_proto::ids::Digest;

use crate::chunks::ChunkError;
use crate::error::{Result, ServerError};
use crate::farm::Farm;
use crate::store::{StoreError, require_done};

/// Largest index, and largest body that brings one.
pub(crate) const MAX_INDEX_BYTES: usize = 1 << 20;

impl Farm {
    /// Attaches an evaluation to a finished bake, in place of the one before. Its files must be stored, with the lengths that it names.
    pub async fn attach_evaluation(&self, bake: &str, index: &EvaluationIndex) -> Result<()> {
        index.check()?;
        // Refused before anything is stored for it.
        require_done(bake, self.store.show(bake).await?.state, "given an evaluation")?;
        let files: BTreeSet<Digest> = index.files.iter().map(|file| file.digest).collect();
        let lengths = self.storage.lengths(&files).await?;
        for file in &index.files {
            let stored = lengths.get(&file.digest);
            let stored = *stored.ok_or(StoreError::MissingChunk { digest: file.digest })?;
            if stored != file.bytes {
                return Err(ServerError::EvaluationFileLength {
                    name: file.name.clone(),
                    stored,
                    named: file.bytes,
                });
            }
        }
        let bytes = serde_json::to_vec(index).map_err(|error| {
            let what = "an evaluation's index cannot be written".to_owned();
            StoreError::Corrupt { what, source: Some(error.into()) }
        })?;
        let digest = Digest::of(&bytes);
        self.storage.put(digest, bytes.into()).await?;
        Ok(self.store.set_evaluation(bake, digest, &files).await?)
    }

    /// Digest of the index of the evaluation that is attached to a bake.
    pub async fn evaluation_of(&self, bake: &str) -> Result<Digest> {
        let attached = self.store.show(bake).await?.evaluation;
        attached.ok_or_else(|| {
            let why =
                format!("none was attached; 'kiln evaluate {bake} --server URL --out DIR --attach' does it");
            ServerError::NoResult { bake: bake.to_owned(), what: "evaluation", why }
        })
    }

    /// The index of the evaluation that is attached to a bake.
    pub async fn evaluation_index(&self, bake: &str) -> Result<EvaluationIndex> {
        let digest = self.evaluation_of(bake).await?;
        let length = self.storage.length(digest).await?.ok_or(ChunkError::NotFound { digest })?;
        let pieces: Vec<_> = self.storage.read(digest, 0..length).await?.try_collect().await?;
        serde_json::from_slice(&pieces.concat()).map_err(|error| {
            let what = format!("the index {digest} of an evaluation");
            StoreError::Corrupt { what, source: Some(error.into()) }.into()
        })
    }
}
