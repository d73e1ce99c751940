//! A server's bake under way, followed by its results: its outline, and the clusters of its cells as they land.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use lightkiln_http::RetryPolicy;
use lightkiln_proto::api::{Bake, BakeResult, BakeState, ResultPage};
use lightkiln_proto::chunk::decode_directory;
use lightkiln_proto::ids::TaskKey;
use lightkiln_proto::kinds::{OUTLINE_OUTPUT, PAGE_OUTPUT, UnderWay};
use lightkiln_proto::manifest::{
    self, CLUSTERS, CLUSTERS_MAX, ChunkRef, ClusterRow, DIRECTORY, Manifest, OVERVIEW, PAGE_BYTES_MAX,
};
use serde_json::Value;

use super::api::{ApiClient, MAX_WAIT_SECS};
use super::{Source, parallel, parsed};
use crate::error::{ClientError, Result};

/// A bake outlives a server's restart, so whoever follows one waits some minutes for it.
pub const PATIENCE: RetryPolicy = RetryPolicy::new()
    .with_min_delay(Duration::from_millis(250))
    .with_max_delay(Duration::from_secs(8))
    .with_max_times(80);

/// A bake under way.
pub struct Following {
    source: Source,
    client: Arc<ApiClient>,
    /// The whole id, where a beginning of it was given.
    bake: String,
    tasks: UnderWay,
    /// Places up to which no result is left to take: of the outline's task, and of cells.
    after: [u64; 2],
    /// Cells whose clusters are listed.
    cells: BTreeSet<TaskKey>,
    /// All cells, as the server knows them.
    cells_all: u64,
    /// The outline, with the clusters that have landed in the order in which they did.
    manifest: Option<Manifest>,
    /// Bytes of the outline and of the pages.
    bytes: u64,
}

/// Change of a bake under way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum News {
    /// None.
    None,
    /// The outline has come, or clusters behind those that were listed.
    More,
    /// The bake is done: its own manifest tells the rest.
    Done,
}

/// Clusters of a cell with their chunks.
type Page = (Vec<ClusterRow>, Vec<ChunkRef>);

impl Following {
    /// Follows the bake of a source; `None` for a bundle, and for a bake that is done. `tasks_of` gives the tasks to follow of a kind of
    /// bake. Errs for a bake that ended otherwise, and for a kind without such tasks.
    pub fn of(
        source: &Source,
        tasks_of: impl FnOnce(&str) -> Result<Option<UnderWay>>,
    ) -> Result<Option<Self>> {
        let Source::Server { client, bake, cache } = source else { return Ok(None) };
        let bake = client.bake(bake)?;
        judge(&bake)?;
        if bake.state == BakeState::Done {
            return Ok(None);
        }
        let Some(tasks) = tasks_of(&bake.kind)? else {
            let text = format!("bake {}", bake.id);
            let problem = format!(
                "is of kind {} and goes on: bakes of this kind are seen only once they are done ('kiln watch' waits for that)",
                bake.kind
            );
            return Err(ClientError::Source { text, problem });
        };
        let client = Arc::clone(client);
        let source =
            Source::Server { client: Arc::clone(&client), bake: bake.id.clone(), cache: cache.clone() };
        let cells_all = cells_of(&bake, tasks);
        Ok(Some(Self {
            source,
            client,
            bake: bake.id,
            tasks,
            after: [0; 2],
            cells: BTreeSet::new(),
            cells_all,
            manifest: None,
            bytes: 0,
        }))
    }

    /// The same with [`PATIENCE`], for whoever follows the bake to its end.
    #[must_use]
    pub fn patient(mut self) -> Self {
        self.client = Arc::new(ApiClient::clone(&self.client).with_retry(PATIENCE));
        if let Source::Server { client, .. } = &mut self.source {
            *client = Arc::clone(&self.client);
        }
        self
    }

    /// The bake's source, by its whole id.
    pub fn source(&self) -> &Source {
        &self.source
    }

    /// The outline with the clusters that have landed; none before [`Self::hear`] told of it.
    pub fn manifest(&self) -> Option<&Manifest> {
        self.manifest.as_ref()
    }

    /// Bytes of the outline and of the pages that list its clusters.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Cells whose clusters are listed, and all cells. One whose page is lost is not among the first.
    pub fn cells(&self) -> [u64; 2] {
        let baked = self.cells.len() as u64;
        [baked, self.cells_all.max(baked)]
    }

    /// Waits until there is an outline, or the bake is done.
    pub fn wait_for_outline(&mut self) -> Result<()> {
        while self.manifest.is_none() && self.hear(MAX_WAIT_SECS)? != News::Done {}
        Ok(())
    }

    /// Takes what has landed since the last call, waiting up to `wait_secs` for it. Errs for a bake that ended without all of its light.
    pub fn hear(&mut self, wait_secs: u32) -> Result<News> {
        let (mut wait_secs, mut news) = (wait_secs, News::None);
        if self.manifest.is_none() {
            let page = self.results(self.tasks.outline, self.after[0], wait_secs)?;
            if page.bake.state == BakeState::Done {
                return Ok(News::Done);
            }
            let Some(result) = page.results.last() else {
                self.after[0] = page.next_after;
                return Ok(News::None);
            };
            self.manifest = Some(self.outline(result)?);
            (wait_secs, news) = (0, News::More);
        }
        loop {
            let page = self.results(self.tasks.clusters, self.after[1], wait_secs)?;
            if page.bake.state == BakeState::Done {
                return Ok(News::Done);
            }
            let has_some = !page.results.is_empty();
            self.take(&page.results)?;
            self.after[1] = page.next_after;
            if !has_some {
                return Ok(news);
            }
            (wait_secs, news) = (0, News::More);
        }
    }

    fn results(&mut self, kind: &str, after: u64, wait_secs: u32) -> Result<ResultPage> {
        let page = self.client.results(&self.bake, kind, after, wait_secs).map_err(|error| {
            if !is_gone(&error) {
                return error;
            }
            let problem = "is not there any more: it was deleted while it was followed".to_owned();
            ClientError::Ended { bake: self.bake.clone(), state: None, problem }
        })?;
        judge(&page.bake)?;
        if !page.results.is_empty() && page.next_after <= after {
            let problem = format!("end at place {}, though they lie behind {after}", page.next_after);
            return Err(ClientError::inconsistent(format!("results of {kind}"), problem));
        }
        self.cells_all = cells_of(&page.bake, self.tasks);
        Ok(page)
    }

    /// The outline, which has no clusters.
    fn outline(&mut self, result: &BakeResult) -> Result<Manifest> {
        let place = format!("outline of bake {}", self.bake);
        if result.outputs.iter().all(|output| output.name != OUTLINE_OUTPUT) {
            let text = format!("bake {}", self.bake);
            let problem = "goes on by a plan of an earlier version, which tells of no light before the end: it is seen once it is done \
                ('kiln watch' waits for that)";
            return Err(ClientError::Source { text, problem: problem.to_owned() });
        }
        let chunk = output(result, OUTLINE_OUTPUT, manifest::MAX_BYTES as u64)?;
        let bytes = self.source.chunk(&chunk)?;
        self.bytes += bytes.len() as u64;
        parsed(&place, Manifest::from_json(&bytes).and_then(|outline| outline.with_directory(&[])))
    }

    /// Lists the clusters of cells behind the others. A page whose bytes were lost comes again once its task has run again.
    fn take(&mut self, results: &[BakeResult]) -> Result<()> {
        let mut named = BTreeSet::new();
        let is_new = |result: &&BakeResult| !self.cells.contains(&result.key) && named.insert(result.key);
        let results: Vec<&BakeResult> = results.iter().filter(is_new).collect();
        let chunks: Vec<ChunkRef> = results
            .iter()
            .map(|result| output(result, PAGE_OUTPUT, PAGE_BYTES_MAX))
            .collect::<Result<_>>()?;
        let sizes: Vec<u64> = chunks.iter().map(|chunk| chunk.bytes).collect();
        let (pages, ended) = parallel(&self.source, &sizes, |index| page_of(&self.source, &chunks[index]));
        ended?;
        let Some(manifest) = &mut self.manifest else { return Ok(()) };
        for ((result, chunk), page) in results.iter().zip(&chunks).zip(pages) {
            let Some((rows, refs)) = page.flatten() else { continue };
            if (manifest.clusters.len() + rows.len()) as u64 > CLUSTERS_MAX {
                let problem = format!("lists more than {CLUSTERS_MAX} clusters");
                return Err(ClientError::inconsistent(format!("page of {}", result.label), problem));
            }
            self.cells.insert(result.key);
            self.bytes += chunk.bytes;
            manifest.clusters.extend(rows);
            manifest.chunks.entry(CLUSTERS.to_owned()).or_default().extend(refs);
        }
        Ok(())
    }
}

/// Clusters of a cell; none where the page's bytes were lost.
fn page_of(source: &Source, chunk: &ChunkRef) -> Result<Option<Page>> {
    let bytes = match source.chunk(chunk) {
        Err(error) if is_lost(&error) => return Ok(None),
        bytes => bytes?,
    };
    decode_directory(&bytes).map(Some).map_err(|source| ClientError::Chunk {
        digest: chunk.digest,
        role: PAGE_OUTPUT,
        source: Box::new(source),
    })
}

/// An output of a task, of at most so many bytes.
fn output(result: &BakeResult, name: &str, bytes_max: u64) -> Result<ChunkRef> {
    let BakeResult { kind, label, outputs, .. } = result;
    let Some(found) = outputs.iter().find(|output| output.name == name) else {
        let problem =
            format!("has no output '{name}': a worker of another version ran it, use the kiln of the farm");
        return Err(ClientError::inconsistent(format!("task {kind} '{label}'"), problem));
    };
    if found.bytes > bytes_max {
        let what = format!("output '{name}' of task {kind}");
        return Err(ClientError::TooLarge { what, bytes: found.bytes, limit: bytes_max });
    }
    Ok(ChunkRef { digest: found.digest, bytes: found.bytes })
}

/// Errs for a bake that failed or was cancelled.
fn judge(bake: &Bake) -> Result<()> {
    let problem = match bake.state {
        BakeState::Running | BakeState::Paused | BakeState::Done => return Ok(()),
        BakeState::Failed => format!("failed: {}", bake.failure.as_deref().unwrap_or("no reason was given")),
        BakeState::Cancelled => {
            "was cancelled; 'kiln submit' of its scene goes on from what was done".to_owned()
        }
    };
    Err(ClientError::Ended { bake: bake.id.clone(), state: Some(bake.state), problem })
}

fn cells_of(bake: &Bake, tasks: UnderWay) -> u64 {
    bake.stages.iter().find(|stage| stage.kind == tasks.clusters).map_or(0, |stage| stage.total)
}

/// The server has no bake or no bytes of that name.
fn is_gone(error: &ClientError) -> bool {
    matches!(error, ClientError::Call(error) if error.status() == Some(404))
}

/// The server has no bytes of a chunk, or others in their place: while a bake goes on they come again, once their task has run again.
pub fn is_lost(error: &ClientError) -> bool {
    is_gone(error) || matches!(error, ClientError::WrongDigest { .. } | ClientError::WrongPrefix { .. })
}

/// The part of a manifest that a bake's outline has, too: all but clusters, directory and overview.
pub fn outline_of(manifest: &Manifest) -> Manifest {
    let is_early = |role: &str| ![CLUSTERS, DIRECTORY, OVERVIEW].contains(&role);
    let chunks = manifest.chunks.iter().filter(|(role, _)| is_early(role));
    Manifest {
        chunks: chunks.map(|(role, refs)| (role.clone(), refs.clone())).collect(),
        directory: Vec::new(),
        clusters: Vec::new(),
        ..manifest.clone()
    }
}

/// Errs unless a bake's manifest is of the scene, the settings and the chunks that its outline had.
pub fn check_outline(outline: &Manifest, whole: &Manifest) -> Result<()> {
    // The body tells of the clusters.
    let early = |manifest: &Manifest| Manifest { body: Value::Null, ..outline_of(manifest) };
    if early(outline) == early(whole) {
        return Ok(());
    }
    let problem = "is not that of the outline which its bake gave while it went on".to_owned();
    Err(ClientError::inconsistent("manifest", problem))
}
