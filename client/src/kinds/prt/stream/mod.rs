//! Light over surface patches that comes piece by piece.

use std::collections::{BTreeMap, BTreeSet, HashSet};

use glam::{Vec3, Vec4};
use lightkiln_proto::chunk;
use lightkiln_proto::content::{BlockKey, ClusterTransport, PatchSet, Texel};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::kinds::prt::PATCHES;
use lightkiln_proto::manifest::{CLUSTERS, Manifest};
use lightkiln_proto::relight::{Limit, PatchTable, stand_in};
use lightkiln_proto::voxels::{LitByWalks, walked_blocks};
use rayon::prelude::*;

use super::base::{Base, bytes_of};
use super::memory::{rung_memory, voxel_memory};
use super::one_of;
use super::only::{names, only};
use crate::bake::{Among, Light, LightStream, LitScene, ReceiverLight};
use crate::error::{ClientError, Result};
use crate::fetch::{Came, Layers, Source, decoded, decoded_layers, is_lost, parallel};
use crate::lightmap::LightmapLight;
use crate::scene::LoadedScene;
use crate::stream::{Baked, Budget, Candidate, Lit, Plan, Rung, Streamed, Viewpoint, by_need, plan};

/// Chunks that have come.
#[derive(Debug)]
pub struct PrtStream {
    set: PatchSet,
    base: Base,
    /// First bytes of chunks, whole layers each, verified and decoded once; by their number in the manifest.
    clusters: BTreeMap<usize, Vec<u8>>,
    /// Those of them of which layers came for this view.
    fresh: BTreeSet<usize>,
    /// Clusters of a bake under way whose bytes the server has lost, as far as they were asked for.
    lost: BTreeSet<usize>,
    /// Those of them that are not asked for again before something lands.
    passed_over: BTreeSet<usize>,
    /// Bytes of what always stays.
    base_bytes: u64,
    /// Memory of it.
    base_memory: u64,
    streamed: Streamed,
}

impl PrtStream {
    /// Fetches patches, overview and the coarser voxels.
    pub fn begin(source: &Source, manifest: &Manifest) -> Result<Self> {
        let sets = decoded(source, manifest, PATCHES, |bytes| Ok(chunk::decode_patches(bytes)?))?;
        let set = one_of(&sets)?.clone();
        let base = Base::fetch(source, manifest)?;
        let mut stream = Self {
            base_bytes: Base::bytes(manifest),
            base_memory: base.memory(&set, manifest),
            set,
            base,
            clusters: BTreeMap::new(),
            fresh: BTreeSet::new(),
            lost: BTreeSet::new(),
            passed_over: BTreeSet::new(),
            streamed: Streamed::default(),
        };
        stream.count(manifest);
        Ok(stream)
    }

    /// The light of the layers that have come; receivers of the overview stand for all others, but for none where all have.
    fn assembled(&self, scene: &LoadedScene, manifest: &Manifest) -> Result<LightmapLight<PatchTable>> {
        let held: Vec<(&usize, &Vec<u8>)> = self.clusters.iter().collect();
        let decoded = |(index, bytes): &(&usize, &Vec<u8>)| {
            decoded_layers(layers_of(manifest, **index), bytes).map(|(cluster, _)| cluster)
        };
        let mut contents: Vec<ClusterTransport> = held.par_iter().map(decoded).collect::<Result<_>>()?;
        if self.has_all_clusters() {
            return LightmapLight::assemble(scene, &contents, |slots| PatchTable::new(&self.set, slots));
        }
        let there: HashSet<(BlockKey, Texel)> = contents.iter().flat_map(names).collect();
        let rest = |cluster| only(cluster, |name| !there.contains(&name));
        contents.extend(self.base.overview.iter().filter_map(rest));
        LightmapLight::assemble_some(
            scene,
            &contents,
            |slots| stand_in(&self.set, slots),
            |slots| PatchTable::new(&self.set, slots),
        )
    }

    /// Counts anew.
    fn count(&mut self, manifest: &Manifest) {
        let of = |index: usize| layers_of(manifest, index);
        let is_whole = |(index, bytes): &(&usize, &Vec<u8>)| bytes.len() as u64 == of(**index).chunk.bytes;
        let memory = |(index, bytes): (&usize, &Vec<u8>)| rung_memory(of(*index), bytes.len() as u64);
        let memory_of_all =
            (0..manifest.clusters.len()).map(|index| rung_memory(of(index), of(index).chunk.bytes));
        let [_, left] = self.base.more(manifest);
        let there = self.least_bytes(manifest);
        let memory_there = self.least_memory(manifest);
        self.streamed = Streamed {
            bytes: there + self.clusters.values().map(|bytes| bytes.len() as u64).sum::<u64>(),
            bytes_all: there + bytes_of(left) + manifest.bytes_of(CLUSTERS),
            rest: left.len(),
            clusters: self.clusters.len(),
            whole: self.clusters.iter().filter(is_whole).count(),
            clusters_all: manifest.clusters.len(),
            lost: self.lost.len(),
            memory: memory_there + self.clusters.iter().map(memory).sum::<u64>(),
            memory_all: memory_there + voxel_memory(bytes_of(left)) + memory_of_all.sum::<u64>(),
            memory_least: self.base_memory,
            baked: self.streamed.baked,
            turns: self.streamed.turns,
        };
    }
}

impl LightStream for PrtStream {
    fn streamed(&self) -> Streamed {
        self.streamed
    }

    fn light(&self, scene: &LoadedScene, manifest: &Manifest) -> Result<Box<dyn Light>> {
        let mut light = self.assembled(scene, manifest)?;
        light.voxels = self.base.voxels(&light.transport.columns)?;
        super::walk(&mut light, LitByWalks::Of(&walked_blocks(manifest)))?;
        Ok(Box::new(light))
    }

    fn grown(&mut self, manifest: &Manifest, baked: Baked) {
        self.streamed.baked = Some(baked);
        self.passed_over.clear();
        self.count(manifest);
    }

    fn ended(&mut self, source: &Source, before: &Manifest, manifest: &Manifest) -> Result<()> {
        self.base = Base::fetch(source, manifest)?;
        self.base_bytes = Base::bytes(manifest);
        self.base_memory = self.base.memory(&self.set, manifest);
        let numbers: BTreeMap<Digest, usize> =
            manifest.chunks(CLUSTERS).iter().map(|chunk| chunk.digest).zip(0..).collect();
        let number = |index: usize| numbers.get(&before.chunks(CLUSTERS).get(index)?.digest).copied();
        let held = std::mem::take(&mut self.clusters).into_iter();
        self.clusters = held.filter_map(|(index, bytes)| Some((number(index)?, bytes))).collect();
        self.fresh = self.fresh.iter().filter_map(|index| number(*index)).collect();
        self.lost.clear();
        self.passed_over.clear();
        self.streamed.baked = None;
        self.count(manifest);
        Ok(())
    }

    fn change_view(&mut self) {
        self.fresh.clear();
    }

    fn refine(
        &mut self,
        of: (&Source, &Manifest),
        light: &dyn Light,
        lit: &LitScene<'_>,
        viewpoint: Option<Viewpoint>,
        budget: Budget,
        limit: Limit,
    ) -> Result<()> {
        let mut budget = budget;
        // Finer voxels go before clusters do.
        let [come, _] = self.base.more(of.1);
        if !come.is_empty() && (budget.memory < self.streamed.memory || budget.bytes < self.streamed.bytes) {
            self.base.let_go();
            self.count(of.1);
            self.streamed.turns += 1;
        }
        loop {
            let passed_over = self.passed_over.len();
            let plan = self.plan(of.1, (light, lit), viewpoint, budget, limit);
            budget.step = budget.step.saturating_sub(self.follow(of, &plan, budget)?);
            // Others take the share of those that turned out to be lost.
            if self.passed_over.len() == passed_over {
                break;
            }
        }
        if self.has_all_clusters() && budget.step > 0 {
            self.fetch_more(of, budget)?;
        }
        Ok(())
    }
}

impl PrtStream {
    /// All clusters are there with all of their layers.
    fn has_all_clusters(&self) -> bool {
        let Streamed { baked, whole, clusters_all, .. } = self.streamed;
        baked.is_none() && whole == clusters_all
    }

    /// Bytes of what is there beside clusters.
    fn least_bytes(&self, manifest: &Manifest) -> u64 {
        let [come, _] = self.base.more(manifest);
        self.base_bytes + bytes_of(come)
    }

    /// Memory of it.
    fn least_memory(&self, manifest: &Manifest) -> u64 {
        let [come, _] = self.base.more(manifest);
        self.base_memory + voxel_memory(bytes_of(come))
    }

    /// Fetches what comes after clusters, as far as there is room.
    fn fetch_more(&mut self, (source, manifest): (&Source, &Manifest), budget: Budget) -> Result<()> {
        let Streamed { bytes, memory, .. } = self.streamed;
        let room = Budget {
            bytes: budget.bytes.saturating_sub(bytes),
            memory: budget.memory.saturating_sub(memory),
            ..budget
        };
        let come = self.base.fetch_more(source, manifest, room)?;
        self.count(manifest);
        self.streamed.turns += u64::from(come > 0);
        Ok(())
    }

    /// Fetches and lets go by a plan; gives the bytes that came.
    fn follow(
        &mut self,
        (source, manifest): (&Source, &Manifest),
        Plan { fetch, evict }: &Plan,
        budget: Budget,
    ) -> Result<u64> {
        let size = |&(index, layers): &(usize, usize)| layers_of(manifest, index).bytes_of(layers);
        let sizes: Vec<u64> = fetch.iter().map(size).collect();
        // Bytes that were lost come again while the bake goes on, once their task has run again: others need not wait.
        let is_under_way = self.streamed.baked.is_some();
        let may_come_again = |error: &ClientError| is_under_way && is_lost(error);
        let (found, mut ended) = parallel(source, &sizes, |at| {
            let (index, layers) = fetch[at];
            let of = layers_of(manifest, index);
            let have: &[u8] = self.clusters.get(&index).map_or(&[], Vec::as_slice);
            let Came { mut bytes, lost } = match source.layers(of, layers, have) {
                Err(error) if may_come_again(&error) => Came { bytes: have.to_vec(), lost: Some(error) },
                came => came?,
            };
            // More may be at hand: budgets bound, and pictures hang on, those alone that were chosen.
            bytes.truncate(of.bytes_of(layers) as usize);
            bytes.shrink_to_fit();
            if bytes.len() > have.len() {
                decoded_layers(of, &bytes)?;
            }
            Ok((bytes, lost))
        });
        let mut come = 0;
        // Layers that came before an error stay.
        for ((index, _), (bytes, lost)) in fetch.iter().zip(found).filter_map(|(of, came)| Some((*of, came?)))
        {
            if lost.as_ref().is_some_and(may_come_again) {
                self.lost.insert(index);
                self.passed_over.insert(index);
            } else {
                self.lost.remove(&index);
                ended = lost.map_or(ended, Err);
            }
            let more = bytes.len().saturating_sub(self.clusters.get(&index).map_or(0, Vec::len));
            if more > 0 {
                self.fresh.insert(index);
                self.clusters.insert(index, bytes);
                come += more as u64;
            }
        }
        self.count(manifest);
        let has_gone = self.make_room(manifest, evict, budget);
        self.streamed.turns += u64::from(come > 0 || has_gone);
        ended.map(|()| come)
    }

    /// Lets layers go, the first ones first, until what is there fits into the budget; whether any went.
    fn make_room(&mut self, manifest: &Manifest, evict: &[(usize, usize)], budget: Budget) -> bool {
        let Streamed { mut memory, mut bytes, .. } = self.streamed;
        let mut has_gone = false;
        for &(index, layers) in evict {
            if memory <= budget.memory && bytes <= budget.bytes {
                break;
            }
            let Some(held) = self.clusters.get_mut(&index) else { continue };
            let of = layers_of(manifest, index);
            let (before, after) = (held.len() as u64, of.bytes_of(layers).min(held.len() as u64));
            memory -= rung_memory(of, before) - rung_memory(of, after);
            bytes -= before - after;
            held.truncate(after as usize);
            held.shrink_to_fit();
            if after == 0 {
                self.clusters.remove(&index);
            }
            has_gone = true;
        }
        self.count(manifest);
        has_gone
    }

    /// Layers to fetch and to let go, of clusters by their number in the manifest.
    fn plan(
        &self,
        manifest: &Manifest,
        (light, lit): (&dyn Light, &LitScene<'_>),
        viewpoint: Option<Viewpoint>,
        budget: Budget,
        limit: Limit,
    ) -> Plan {
        let candidates: Vec<Candidate> =
            (0..manifest.clusters.len()).map(|index| self.candidate(layers_of(manifest, index))).collect();
        let budget = Budget {
            bytes: budget.bytes.saturating_sub(self.least_bytes(manifest)),
            memory: budget.memory.saturating_sub(self.least_memory(manifest)),
            ..budget
        };
        let all = |of: &Candidate| of.rung(of.rungs.len());
        let of_clusters = manifest.bytes_of(CLUSTERS);
        let rest = of_clusters - self.clusters.values().map(|bytes| bytes.len() as u64).sum::<u64>();
        let memory: u64 = candidates.iter().map(|of| all(of).memory).sum();
        if of_clusters <= budget.bytes && rest <= budget.step && memory <= budget.memory {
            let missing = candidates.iter().enumerate().filter(|(_, of)| of.held < of.rungs.len());
            return Plan {
                fetch: missing.map(|(index, of)| (index, of.rungs.len())).collect(),
                evict: Vec::new(),
            };
        }
        let places = places(light, lit, limit);
        let [low, high] = manifest.bounds_m.map(Vec3::from);
        let steps = by_need(&candidates, &places, viewpoint, low.distance(high));
        plan(&candidates, &steps, budget)
    }

    fn candidate(&self, of: Layers<'_>) -> Candidate {
        let rung = |layers: usize| {
            let bytes = of.bytes_of(layers);
            let left = match of.row.layers.get(layers - 1).filter(|_| layers < of.count()) {
                Some(layer) => Rung::left_after(layer, of.row.rank),
                None => 0.0,
            };
            Rung { bytes, memory: rung_memory(of, bytes), left }
        };
        let held =
            self.clusters.get(&of.cluster).and_then(|bytes| of.within(bytes.len() as u64)).unwrap_or(0);
        // A lost cluster has no more than is held: others leave no bytes and no memory for it.
        let count = if self.passed_over.contains(&of.cluster) { held } else { of.count() };
        Candidate {
            bounds_m: of.row.bounds_m.map(Vec3::from),
            receivers: of.row.receivers,
            rungs: (1..=count).map(rung).collect(),
            held,
            kept: if self.fresh.contains(&of.cluster) { held } else { 0 },
        }
    }
}

/// Light of receivers, but for direct light.
fn places(light: &dyn Light, lit: &LitScene<'_>, limit: Limit) -> Vec<Lit> {
    let Some((settled, lightmap)) =
        light.at_receivers(lit, &Among::default(), limit).zip(light.lightmap(lit.scene))
    else {
        return Vec::new();
    };
    let ReceiverLight { emit, indirect, .. } = settled.light;
    let place = |((position_m, emit), indirect): ((&Vec4, Vec4), Vec4)| Lit {
        position_m: position_m.truncate(),
        irradiance: (emit + indirect).truncate(),
    };
    lightmap.receivers.position_m.iter().zip(emit).zip(indirect).map(place).collect()
}

/// A cluster of a manifest, whose directory has a row for each chunk.
fn layers_of(manifest: &Manifest, cluster: usize) -> Layers<'_> {
    Layers { cluster, row: &manifest.clusters[cluster], chunk: &manifest.chunks(CLUSTERS)[cluster] }
}

#[cfg(test)]
mod tests;
