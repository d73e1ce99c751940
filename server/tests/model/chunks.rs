//! Chunks of the model: references are recounted whenever they are asked for.

use std::collections::{BTreeMap, BTreeSet};

use lightkiln_proto::ids::{Digest, TaskKey};

use super::farm::Farm;
use lightkiln_server::chunks::ChunkName;
use lightkiln_server::store::chunk::{ChunkRow, CollectRules, Collected, Kept, KeptChunk, Usage};
use lightkiln_server::store::rules::CHUNK_USED_GRAIN_MS;
use lightkiln_server::store::{StoreError, require_done, require_ended};

/// Stored chunks.
#[derive(Clone, Default)]
pub(super) struct Chunks {
    rows: BTreeMap<Digest, Row>,
    /// Lengths of chunks whose bytes are to be removed.
    condemned: BTreeMap<ChunkName, u64>,
    usage: Usage,
}

#[derive(Clone, Copy)]
struct Row {
    generation: Option<u64>,
    bytes: u64,
    used_ms: i64,
}

impl Chunks {
    pub(super) fn kept(&self, digest: Digest) -> Option<KeptChunk> {
        let row = self.rows.get(&digest)?;
        Some(KeptChunk { name: ChunkName { digest, generation: row.generation? }, bytes: row.bytes })
    }

    /// Whether anything is known of a chunk, be it lost.
    pub(super) fn is_known(&self, digest: Digest) -> bool {
        self.rows.contains_key(&digest)
    }

    pub(super) fn touch(&mut self, digest: Digest, now_ms: i64) -> Option<KeptChunk> {
        let kept = self.kept(digest)?;
        if let Some(row) = self.rows.get_mut(&digest)
            && now_ms - row.used_ms >= CHUNK_USED_GRAIN_MS
        {
            row.used_ms = now_ms;
        }
        Some(kept)
    }

    pub(super) fn require(&self, digest: Digest) -> Result<(), StoreError> {
        self.kept(digest).map(|_| ()).ok_or(StoreError::MissingChunk { digest })
    }

    pub(super) fn keep(
        &mut self,
        chunk: KeptChunk,
        replaces: Option<u64>,
        quota: Option<u64>,
        now_ms: i64,
    ) -> Result<Kept, StoreError> {
        let digest = chunk.name.digest;
        let replaces = replaces.filter(|old| *old != chunk.name.generation);
        if self.condemned.contains_key(&chunk.name) {
            return Ok(Kept::Condemned);
        }
        if let Some(known) = self.kept(digest)
            && Some(known.name.generation) != replaces
        {
            self.touch(digest, now_ms);
            return Ok(Kept::Known(known));
        }
        if quota.is_some_and(|quota| self.usage.bytes + chunk.bytes > quota) {
            return Err(StoreError::OverQuota { used: self.usage.bytes, wanted: chunk.bytes });
        }
        if let Some(old) = self.kept(digest) {
            self.condemned.insert(old.name, old.bytes);
        }
        let generation = Some(chunk.name.generation);
        self.rows.insert(digest, Row { generation, bytes: chunk.bytes, used_ms: now_ms });
        self.usage.chunks += 1;
        self.usage.bytes += chunk.bytes;
        Ok(Kept::Fresh)
    }

    pub(super) fn purge(&mut self, names: &[ChunkName]) {
        for name in names {
            if let Some(bytes) = self.condemned.remove(name) {
                self.usage.chunks -= 1;
                self.usage.bytes -= bytes;
            }
        }
    }

    pub(super) fn usage(&self) -> Usage {
        self.usage
    }

    fn has(&self, name: ChunkName) -> bool {
        self.condemned.contains_key(&name) || self.kept(name.digest).is_some_and(|kept| kept.name == name)
    }

    pub(super) fn orphans(&self, names: &[ChunkName]) -> Vec<ChunkName> {
        names.iter().copied().filter(|name| !self.has(*name)).collect()
    }

    pub(super) fn condemn_orphans(&mut self, chunks: &[KeptChunk]) -> Vec<ChunkName> {
        let mut condemned = Vec::new();
        for chunk in chunks.iter().filter(|chunk| !self.has(chunk.name)).copied().collect::<Vec<_>>() {
            self.condemned.insert(chunk.name, chunk.bytes);
            self.usage.chunks += 1;
            self.usage.bytes += chunk.bytes;
            condemned.push(chunk.name);
        }
        condemned
    }
}

impl Farm {
    /// References to a chunk, each result and each bake counted once.
    fn refs(&self, digest: Digest) -> u64 {
        let by_results = self.producers(digest).len();
        let by_bakes = self.bakes.iter().filter(|bake| bake.artefacts.contains(&digest)).count();
        let has_evaluated = |bake: &&super::entries::BakeEntry| {
            bake.evaluation.as_ref().is_some_and(|(_, chunks)| chunks.contains(&digest))
        };
        let by_evaluations = self.bakes.iter().filter(has_evaluated).count();
        (by_results + by_bakes + by_evaluations) as u64
    }

    /// Finished tasks whose results have the chunk among their outputs.
    fn producers(&self, digest: Digest) -> Vec<TaskKey> {
        let has = |task: &super::entries::Task| {
            let result = task.done.as_ref().map(|(result, _)| result);
            result.is_some_and(|result| result.outputs.iter().any(|output| output.digest == digest))
        };
        self.tasks.iter().filter(|(_, task)| has(task)).map(|(key, _)| *key).collect()
    }

    pub(super) fn chunk_rows(&self, after: Option<Digest>, limit: u32) -> Vec<ChunkRow> {
        let later = self.chunks.rows.iter().filter(|(digest, _)| after.is_none_or(|after| **digest > after));
        let row = |(digest, row): (&Digest, &Row)| ChunkRow {
            digest: *digest,
            generation: row.generation,
            bytes: row.bytes,
            refs: self.refs(*digest),
            is_live_scene: self.bakes.iter().any(|bake| !bake.state.is_final() && bake.new.scene == *digest),
        };
        later.take(limit as usize).map(row).collect()
    }

    pub(super) fn lose_chunk(&mut self, name: ChunkName, now_ms: i64) -> u64 {
        let Some(lost) = self.chunks.kept(name.digest).filter(|kept| kept.name == name) else { return 0 };
        self.chunks.condemned.insert(name, lost.bytes);
        if let Some(row) = self.chunks.rows.get_mut(&name.digest) {
            row.generation = None;
        }
        let producers = self.producers(name.digest);
        producers.iter().for_each(|key| self.forget(*key, now_ms));
        producers.len() as u64
    }

    pub(super) fn set_evaluation(
        &mut self,
        id: &str,
        index: Digest,
        files: &BTreeSet<Digest>,
    ) -> Result<(), StoreError> {
        let bake = self.index_of(id)?;
        require_done(id, self.bakes[bake].state, "given an evaluation")?;
        let chunks: BTreeSet<Digest> = files.iter().copied().chain([index]).collect();
        chunks.iter().try_for_each(|digest| self.chunks.require(*digest))?;
        self.bakes[bake].evaluation = Some((index, chunks));
        Ok(())
    }

    pub(super) fn delete_bake(&mut self, id: &str) -> Result<(), StoreError> {
        let index = self.index_of(id)?;
        require_ended(id, self.bakes[index].state, "deleted")?;
        let deleted = self.bakes.remove(index);
        self.end_reruns_of(id);
        self.gone_run += deleted.tasks_run;
        self.gone_reused += deleted.members.values().filter(|member| member.reused).count() as u64;
        for (key, _) in deleted.members.into_iter().filter(|(_, member)| member.held) {
            if !self.bakes.iter().any(|bake| bake.members.get(&key).is_some_and(|member| member.held)) {
                self.drop_task(key);
            }
        }
        Ok(())
    }

    pub(super) fn collect(&mut self, rules: &CollectRules, now_ms: i64) -> Collected {
        let mut collected = Collected::default();
        let is_old = |finished: i64| rules.keep_bakes_ms.is_some_and(|keep| finished <= now_ms - keep);
        let old = self.bakes.iter().filter(|bake| bake.finished_ms.is_some_and(is_old));
        let old: Vec<String> = old.take(rules.max as usize).map(|bake| bake.id.clone()).collect();
        for id in old {
            collected.bakes += u64::from(self.delete_bake(&id).is_ok());
        }
        let mut unused: BTreeSet<(i64, Digest)> = BTreeSet::new();
        for (digest, row) in &self.chunks.rows {
            if row.used_ms <= now_ms - rules.grace_ms && self.refs(*digest) == 0 {
                unused.insert((row.used_ms, *digest));
            }
        }
        for (_, digest) in unused.into_iter().take(rules.max as usize) {
            if let Some(kept) = self.chunks.kept(digest) {
                self.chunks.condemned.insert(kept.name, kept.bytes);
                collected.condemned += 1;
            }
            self.chunks.rows.remove(&digest);
        }
        collected.to_remove = self.chunks.condemned.keys().copied().take(rules.max as usize).collect();
        collected
    }
}
