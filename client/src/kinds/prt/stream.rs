//! Light over surface patches that comes piece by piece.

use std::collections::{BTreeMap, HashSet};

use glam::{Vec3, Vec4};
use lightkiln_proto::chunk;
use lightkiln_proto::content::{BlockKey, ClusterTransport, PatchSet, Texel};
use lightkiln_proto::kinds::prt::PATCHES;
use lightkiln_proto::manifest::{CLUSTERS, DIRECTORY, OVERVIEW, with_chunks};
use lightkiln_proto::relight::{Limit, PatchTable, stand_in};

use super::one_of;
use crate::bake::{Light, LightStream, LitScene};
use crate::error::{ClientError, Result};
use crate::fetch::{Source, decoded, decoded_chunks};
use crate::lightmap::LightmapLight;
use crate::scene::LoadedScene;
use crate::stream::{Candidate, Lit, Streamed, Viewpoint, by_need};

/// Chunks that have come.
#[derive(Debug)]
pub struct PrtStream {
    set: PatchSet,
    overview: Vec<ClusterTransport>,
    /// By their number in the manifest.
    clusters: BTreeMap<usize, ClusterTransport>,
    streamed: Streamed,
}

impl PrtStream {
    /// Fetches patches and overview.
    pub fn begin(source: &Source, scene: &LoadedScene) -> Result<Self> {
        let manifest = &scene.manifest;
        let sets = decoded(source, manifest, PATCHES, |bytes| Ok(chunk::decode_patches(bytes)?))?;
        let set = one_of(&sets)?.clone();
        let overview: Vec<ClusterTransport> =
            decoded(source, manifest, OVERVIEW, |bytes| Ok(chunk::decode_cluster(bytes)?))?;
        if overview.iter().any(|cluster| !cluster.near.is_empty()) {
            return Err(ClientError::inconsistent(
                OVERVIEW,
                "has near hits, which clusters of an overview have not",
            ));
        }
        let bytes = [DIRECTORY, PATCHES, OVERVIEW].iter().map(|role| manifest.bytes_of(role)).sum();
        let streamed = Streamed {
            bytes,
            bytes_all: bytes + manifest.bytes_of(CLUSTERS),
            clusters: 0,
            clusters_all: manifest.clusters.len(),
        };
        Ok(Self { set, overview, clusters: BTreeMap::new(), streamed })
    }

    /// The light of the clusters that have come; receivers of the overview stand for all others, but for none where all have.
    fn assembled(&self, scene: &LoadedScene) -> Result<LightmapLight<PatchTable>> {
        let mut contents: Vec<ClusterTransport> = self.clusters.values().cloned().collect();
        if self.streamed.clusters == self.streamed.clusters_all {
            return LightmapLight::assemble(scene, &contents, |slots| PatchTable::new(&self.set, slots));
        }
        let there: HashSet<(BlockKey, Texel)> = contents.iter().flat_map(names).collect();
        let rest = |cluster| only(cluster, |name| !there.contains(&name));
        contents.extend(self.overview.iter().filter_map(rest));
        LightmapLight::assemble_some(
            scene,
            &contents,
            |slots| stand_in(&self.set, slots),
            |slots| PatchTable::new(&self.set, slots),
        )
    }
}

impl LightStream for PrtStream {
    fn streamed(&self) -> Streamed {
        self.streamed
    }

    fn light(&self, scene: &LoadedScene) -> Result<Box<dyn Light>> {
        Ok(Box::new(self.assembled(scene)?))
    }

    fn refine(
        &mut self,
        source: &Source,
        lit: &LitScene<'_>,
        viewpoint: Option<Viewpoint>,
        bytes_max: u64,
        limit: Limit,
    ) -> Result<()> {
        let manifest = &lit.scene.manifest;
        let absent: Vec<usize> =
            (0..manifest.clusters.len()).filter(|index| !self.clusters.contains_key(index)).collect();
        let rows: Vec<_> = with_chunks(manifest).collect();
        let of_all: u64 = absent.iter().map(|&index| rows[index].1.bytes).sum();
        let left = bytes_max.saturating_sub(self.streamed.bytes);
        let chosen = if of_all <= left {
            absent
        } else {
            let mut order = self.order(&absent, lit, viewpoint, limit)?;
            let mut left = left;
            order.retain(|&index| {
                let fits = rows[index].1.bytes <= left;
                left -= if fits { rows[index].1.bytes } else { 0 };
                fits
            });
            order
        };
        let chunks: Vec<_> = chosen.iter().map(|&index| rows[index].1.clone()).collect();
        let found = decoded_chunks(source, &chunks, CLUSTERS, |bytes| Ok(chunk::decode_cluster(bytes)?))?;
        self.streamed.bytes += chunks.iter().map(|chunk| chunk.bytes).sum::<u64>();
        self.clusters.extend(chosen.into_iter().zip(found));
        self.streamed.clusters = self.clusters.len();
        Ok(())
    }
}

impl PrtStream {
    /// Those of `absent` by falling need.
    fn order(
        &self,
        absent: &[usize],
        lit: &LitScene<'_>,
        viewpoint: Option<Viewpoint>,
        limit: Limit,
    ) -> Result<Vec<usize>> {
        let manifest = &lit.scene.manifest;
        let rows: Vec<_> = with_chunks(manifest).collect();
        let candidate = |&index: &usize| {
            let (row, chunk) = rows[index];
            let bounds_m = row.bounds_m.map(Vec3::from);
            Candidate { bounds_m, receivers: row.receivers, bytes: chunk.bytes }
        };
        let candidates: Vec<Candidate> = absent.iter().map(candidate).collect();
        let light = self.assembled(lit.scene)?;
        let settled = light.settled(lit, limit).light;
        let receivers = &light.transport.receivers;
        let irradiance: Vec<Vec4> = (0..receivers.len() as u32).map(|slot| settled.indirect(slot)).collect();
        let place = |(position_m, irradiance): (&Vec4, &Vec4)| Lit {
            position_m: position_m.truncate(),
            irradiance: irradiance.truncate(),
        };
        let places: Vec<Lit> = receivers.position_m.iter().zip(&irradiance).map(place).collect();
        let [low, high] = manifest.bounds_m.map(Vec3::from);
        let order = by_need(&candidates, &places, viewpoint, low.distance(high));
        Ok(order.into_iter().map(|at| absent[at]).collect())
    }
}

fn names(cluster: &ClusterTransport) -> impl Iterator<Item = (BlockKey, Texel)> + '_ {
    let receivers = &cluster.receivers;
    let block = |&block: &u16| receivers.blocks.get(usize::from(block)).copied().unwrap_or_default();
    receivers.block.iter().map(block).zip(receivers.texel.iter().copied())
}

/// A cluster of an overview with the receivers alone that `is_wanted` names; `None` if it names none.
pub fn only(
    cluster: &ClusterTransport,
    is_wanted: impl Fn((BlockKey, Texel)) -> bool,
) -> Option<ClusterTransport> {
    let keep: Vec<bool> = names(cluster).map(is_wanted).collect();
    let rank = cluster.factors.rank as usize;
    let mut kept = cluster.clone();
    let receivers = &mut kept.receivers;
    keep_of(&mut receivers.block, &keep);
    keep_of(&mut receivers.texel, &keep);
    keep_of(&mut receivers.position_m, &keep);
    keep_of(&mut receivers.normal, &keep);
    keep_of(&mut receivers.albedo, &keep);
    keep_of(&mut receivers.emission, &keep);
    keep_of(&mut receivers.links, &keep);
    keep_of(&mut receivers.coverage, &keep);
    keep_of(&mut receivers.edge, &keep);
    kept.emitters.iter_mut().for_each(|column| keep_of(&mut column.irradiance, &keep));
    let rows = cluster.factors.u.chunks(rank.max(1)).zip(&keep);
    kept.factors.u = rows.filter(|(_, keep)| **keep).flat_map(|(row, _)| row.iter().copied()).collect();
    (!kept.receivers.texel.is_empty()).then_some(kept)
}

fn keep_of<T>(values: &mut Vec<T>, keep: &[bool]) {
    let mut keep = keep.iter();
    values.retain(|_| keep.next().copied().unwrap_or_default());
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::kinds::prt as prt_kind;

    use super::*;
    use crate::bake::LoadedBake;
    use crate::fixture::write_bundle;
    use crate::kinds;
    use crate::preview::{Backend, StreamedBake, View, render};
    use crate::tests::fixture_view;

    /// The fixture's bundle, a quarter of whose receivers are in the overview.
    fn streamed(folder: &std::path::Path) -> (Source, StreamedBake) {
        write_bundle(folder, prt_kind::NAME);
        let source = Source::bundle(folder).unwrap();
        let streamed = StreamedBake::begin(&source, &kinds::all(), u64::MAX).unwrap();
        (source, streamed)
    }

    fn picture(bake: &LoadedBake, view: &View) -> Vec<[f32; 3]> {
        render(bake, view, Backend::Cpu).unwrap().linear
    }

    fn mean(picture: &[[f32; 3]]) -> Vec3 {
        picture.iter().map(|pixel| Vec3::from(*pixel)).sum::<Vec3>() / picture.len() as f32
    }

    #[test]
    fn light_of_all_pieces_is_that_of_the_whole_bit_for_bit_and_the_overview_is_near_it() {
        let folder = tempfile::tempdir().unwrap();
        let (source, mut streamed) = streamed(folder.path());
        let (_, view) = fixture_view();
        let whole = picture(&LoadedBake::load(&source, &kinds::all()).unwrap(), &view);
        let first = picture(&streamed.bake, &view);
        assert_ne!(first, whole);
        let ratio = mean(&first) / mean(&whole);
        // A room of some hundred receivers, every fourth of which is there.
        assert!((ratio - 1.0).abs().max_element() < 0.1, "{ratio}");
        streamed.refine(&view, u64::MAX).unwrap();
        let all = streamed.streamed();
        assert_eq!((all.bytes, all.clusters), (all.bytes_all, all.clusters_all));
        assert_eq!(picture(&streamed.bake, &view), whole);
    }

    #[test]
    fn clusters_come_as_far_as_the_bytes_go() {
        let folder = tempfile::tempdir().unwrap();
        let (source, mut streamed) = streamed(folder.path());
        let (_, view) = fixture_view();
        let before = streamed.streamed();
        assert_eq!((before.clusters, before.clusters_all), (0, 7));
        let error = StreamedBake::begin(&source, &kinds::all(), before.bytes - 1).err().unwrap().to_string();
        assert!(error.contains(&before.bytes.to_string()), "{error}");
        streamed.refine(&view, before.bytes).unwrap();
        assert_eq!(streamed.streamed(), before);
        let half = (before.bytes + before.bytes_all) / 2;
        streamed.refine(&view, half).unwrap();
        let after = streamed.streamed();
        assert!((1..7).contains(&after.clusters) && after.bytes <= half, "{after:?}");
        assert!(mean(&picture(&streamed.bake, &view)).is_finite());
    }

    #[test]
    fn bakes_without_an_overview_say_so_before_anything_is_fetched() {
        for kind in ["sh", "prt"] {
            let folder = tempfile::tempdir().unwrap();
            write_bundle(folder.path(), kind);
            let path = folder.path().join(crate::fetch::MANIFEST_FILE);
            let mut manifest: serde_json::Value =
                serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
            manifest["chunks"].as_object_mut().unwrap().remove(OVERVIEW);
            std::fs::write(&path, manifest.to_string()).unwrap();
            let source = Source::bundle(folder.path()).unwrap();
            let problem = StreamedBake::begin(&source, &kinds::all(), u64::MAX).err().unwrap().to_string();
            assert!(problem.contains(kind) && problem.contains("no overview"), "{problem}");
        }
    }
}
