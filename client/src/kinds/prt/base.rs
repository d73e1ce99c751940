//! Parts of a streamed bake that come first and stay: what stands for all clusters, and its voxels.

use lightkiln_proto::chunk;
use lightkiln_proto::content::{ClusterTransport, PatchSet};
use lightkiln_proto::kinds::prt::PATCHES;
use lightkiln_proto::manifest::{DIRECTORY, Manifest, OVERVIEW};
use lightkiln_proto::relight::PatchTable;
use lightkiln_proto::voxels::{VOXELS, VoxelPart, VoxelTable, decode_voxels};

use super::joined;
use super::memory::base_memory;
use crate::error::{ClientError, Result};
use crate::fetch::{Source, decoded};

/// The parts, decoded; a bake under way has none.
#[derive(Debug)]
pub(super) struct Base {
    /// The overview.
    pub(super) overview: Vec<ClusterTransport>,
    voxels: Vec<VoxelPart>,
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
        let voxels = decoded(source, manifest, VOXELS, |bytes| Ok(decode_voxels(bytes)?))?;
        Ok(Self { overview, voxels })
    }

    /// Elements with the patches of the light that is there.
    pub(super) fn voxels(&self, patches: &PatchTable) -> Result<Option<VoxelTable>> {
        joined(&self.voxels, patches)
    }

    /// Bytes of what always stays.
    pub(super) fn bytes(manifest: &Manifest) -> u64 {
        [DIRECTORY, PATCHES, OVERVIEW, VOXELS].iter().map(|role| manifest.bytes_of(role)).sum()
    }

    /// Memory of it.
    pub(super) fn memory(&self, set: &PatchSet) -> u64 {
        base_memory(set, &self.overview, &self.voxels)
    }
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::kinds::prt;

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
        add_voxels(folder.path(), manifest);
        let mut streamed = begin();
        let with = streamed.streamed();
        assert!(with.bytes > without.bytes && with.memory > without.memory);
        assert_eq!(with.bytes_all - without.bytes_all, with.bytes - without.bytes);
        let whole = LoadedBake::load(&source, &kinds::all()).unwrap();
        let mut view = view_of(&whole);
        view.walks = Walks { occlusion_m: Some(0.8), ..Walks::default() };
        let draw = |bake: &LoadedBake| render(bake, &view, Backend::Cpu).unwrap().linear;
        assert!(draw(&streamed.bake).iter().any(|pixel| pixel[0] > 0.0));
        streamed.refine(&view, Budget::NONE).unwrap();
        assert!(draw(&streamed.bake) == draw(&whole));
    }
}
