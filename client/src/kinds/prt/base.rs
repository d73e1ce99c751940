//! Parts of a streamed bake that stay once they have come: first what stands for all clusters, and its coarser voxels; after all clusters the
//! finer ones, for which those answer meanwhile.

use lightkiln_proto::chunk;
use lightkiln_proto::content::{ClusterTransport, PatchSet};
use lightkiln_proto::kinds::prt::PATCHES;
use lightkiln_proto::manifest::{ChunkRef, DIRECTORY, Manifest, OVERVIEW};
use lightkiln_proto::relight::PatchTable;
use lightkiln_proto::voxels::{VOXELS, VoxelPart, VoxelTable, decode_voxels, walked_blocks};

use super::joined;
use super::memory::{base_memory, voxel_memory};
use crate::error::{ClientError, Result};
use crate::fetch::{Source, decoded, decoded_chunks};
use crate::stream::Budget;

/// The parts, decoded; a bake under way has none.
#[derive(Debug)]
pub(super) struct Base {
    /// The overview.
    pub(super) overview: Vec<ClusterTransport>,
    /// The first so many parts, the coarser levels first.
    voxels: Vec<VoxelPart>,
    /// Number of those that come before clusters.
    voxels_first: usize,
}

impl Base {
    /// Fetches them.
    pub(super) fn fetch(source: &Source, manifest: &Manifest) -> Result<Self> {
        let overview: Vec<ClusterTransport> =
            decoded(source, manifest, OVERVIEW, |bytes| Ok(chunk::decode_cluster(bytes)?))?;
        if overview.iter().any(|cluster| !cluster.near.is_empty()) {
            let problem = "has near hits, which clusters of an overview have not";
            return Err(ClientError::inconsistent(OVERVIEW, problem));
        }
        let first = first_voxels(manifest);
        let mut base = Self { overview, voxels: Vec::new(), voxels_first: first.len() };
        base.fetch_voxels(source, first)?;
        Ok(base)
    }

    fn fetch_voxels(&mut self, source: &Source, chunks: &[ChunkRef]) -> Result<()> {
        self.voxels.extend(decoded_chunks(source, chunks, VOXELS, |bytes| Ok(decode_voxels(bytes)?))?);
        Ok(())
    }

    /// Fetches as many of the finer voxels as there is room for; gives the bytes that came.
    pub(super) fn fetch_more(&mut self, source: &Source, manifest: &Manifest, room: Budget) -> Result<u64> {
        let [_, left] = self.more(manifest);
        let mut bytes = 0;
        let has_room = |(index, chunk): &(usize, &ChunkRef)| {
            bytes += chunk.bytes;
            // One at least comes in a step.
            bytes <= room.bytes && voxel_memory(bytes) <= room.memory && (*index == 0 || bytes <= room.step)
        };
        let count = left.iter().enumerate().take_while(has_room).count();
        self.fetch_voxels(source, &left[..count])?;
        Ok(bytes_of(&left[..count]))
    }

    /// Lets the finer voxels go.
    pub(super) fn let_go(&mut self) {
        self.voxels.truncate(self.voxels_first);
    }

    /// Chunks of the finer voxels that have come, and that have not.
    pub(super) fn more<'a>(&self, manifest: &'a Manifest) -> [&'a [ChunkRef]; 2] {
        let all = manifest.chunks(VOXELS);
        let (come, left) = all.split_at(self.voxels.len().min(all.len()));
        [come.get(self.voxels_first..).unwrap_or_default(), left]
    }

    /// Elements with the patches of the light that is there.
    pub(super) fn voxels(&self, patches: &PatchTable) -> Result<Option<VoxelTable>> {
        joined(&self.voxels, patches)
    }

    /// Bytes of what comes first.
    pub(super) fn bytes(manifest: &Manifest) -> u64 {
        let of_voxels = bytes_of(first_voxels(manifest));
        of_voxels + [DIRECTORY, PATCHES, OVERVIEW].iter().map(|role| manifest.bytes_of(role)).sum::<u64>()
    }

    /// Memory of it.
    pub(super) fn memory(&self, set: &PatchSet, manifest: &Manifest) -> u64 {
        base_memory(set, &self.overview) + voxel_memory(bytes_of(first_voxels(manifest)))
    }
}

/// Bytes of what comes after clusters.
pub(super) fn bytes_last(manifest: &Manifest) -> u64 {
    manifest.bytes_of(VOXELS) - bytes_of(first_voxels(manifest))
}

/// Chunks of voxels that come before clusters: that of the coarser levels, or all where they light receivers.
fn first_voxels(manifest: &Manifest) -> &[ChunkRef] {
    let all = manifest.chunks(VOXELS);
    if walked_blocks(manifest).is_empty() { &all[..all.len().min(1)] } else { all }
}

/// Bytes of some chunks.
pub(super) fn bytes_of(chunks: &[ChunkRef]) -> u64 {
    chunks.iter().map(|chunk| chunk.bytes).sum()
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::kinds::prt;
    use lightkiln_proto::voxels::VOXELS;

    use crate::bake::LoadedBake;
    use crate::fetch::Source;
    use crate::fixture::{add_voxels, write_bundle};
    use crate::kinds;
    use crate::passes::walk::Walks;
    use crate::preview::{Backend, StreamedBake, render};
    use crate::stream::Budget;
    use crate::tests::view_of;

    /// Walks find the voxels of a bake of which the overview alone has come, and those of the whole are the same as at once.
    #[test]
    fn voxels_come_before_clusters_and_are_counted() {
        let folder = tempfile::tempdir().unwrap();
        let manifest = write_bundle(folder.path(), prt::NAME);
        let source = Source::bundle(folder.path()).unwrap();
        let begin = || StreamedBake::begin(&source, &kinds::all(), Budget::NONE).unwrap();
        let without = begin().streamed();
        let manifest = add_voxels(folder.path(), manifest);
        let mut streamed = begin();
        let with = streamed.streamed();
        assert!(with.bytes > without.bytes && with.memory > without.memory);
        let [first, finer] = [0, 1].map(|index| manifest.chunks(VOXELS)[index].bytes);
        assert!(with.bytes >= without.bytes + first);
        assert_eq!(with.bytes_all - with.bytes, without.bytes_all - without.bytes + finer);
        assert_eq!((without.rest, with.rest), (0, 1));
        let whole = LoadedBake::load(&source, &kinds::all()).unwrap();
        let mut view = view_of(&whole);
        view.walks = Walks { occlusion_m: Some(0.8), ..Walks::default() };
        let draw = |bake: &LoadedBake| render(bake, &view, Backend::Cpu).unwrap().linear;
        assert!(draw(&streamed.bake).iter().any(|pixel| pixel[0] > 0.0));
        // Finer ones come after all clusters, and with room for them alone.
        let room = with.bytes_all - finer;
        streamed.refine(&view, Budget::of_bytes(room)).unwrap();
        let there = streamed.streamed();
        assert!(there.whole == there.clusters_all && there.rest == 1 && !there.is_whole(), "{there:?}");
        assert_eq!(there.bytes, room);
        assert!(draw(&streamed.bake) != draw(&whole));
        streamed.refine(&view, Budget::NONE).unwrap();
        let there = streamed.streamed();
        assert!(there.is_whole() && there.bytes == with.bytes_all, "{there:?}");
        // They go before clusters do.
        let memory = there.memory - 1;
        streamed.refine(&view, Budget { memory, ..Budget::NONE }).unwrap();
        let less = streamed.streamed();
        assert!(less.memory <= memory && less.rest == 1 && less.whole == less.clusters_all, "{less:?}");
        assert_eq!(less.memory_least, with.memory);
        // A budget of what comes first is one to begin with.
        let least = StreamedBake::begin(&source, &kinds::all(), Budget::of_bytes(with.bytes)).unwrap();
        assert_eq!(least.streamed().bytes, with.bytes);
        assert!(StreamedBake::begin(&source, &kinds::all(), Budget::of_bytes(with.bytes - 1)).is_err());
        streamed.refine(&view, Budget::NONE).unwrap();
        assert!(draw(&streamed.bake) == draw(&whole));
    }
}
