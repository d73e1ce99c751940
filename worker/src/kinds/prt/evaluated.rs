//! A bake over patches as evaluation sees it.

use lightkiln_proto::chunk::decode_patches;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::kinds::prt::{PATCHES, Settings, first_tasks, tasks};
use lightkiln_proto::kinds::voxels::tasks::RECEIVERS;
use lightkiln_proto::manifest::Manifest;
use lightkiln_proto::relight::PatchTable;
use lightkiln_proto::voxels::{
    LitByWalks, VOXELS, VoxelPart, VoxelTable, decode_voxels, light_of_walks, walked_blocks,
};

use super::plan::PATCH_SET;
use super::{PatchTransport, TracedSettings};
use crate::evaluate::{ChunkBytes, EvaluationError};
use crate::factors::{FactoredBake, Threads, decoded};
use crate::kinds::voxels::WalkedBake;
use crate::kinds::{BakeKinds, FirstTasks, made_anew};
use crate::task::Progress;

/// Makes the bake's world anew and decodes its chunks.
pub fn evaluated(
    kinds: &BakeKinds,
    manifest: &Manifest,
    scene: Vec<u8>,
    bytes: ChunkBytes,
    progress: &Progress,
) -> Result<FactoredBake<PatchTable>, EvaluationError> {
    let settings: Settings = manifest.settings()?;
    let plan = |scene| first_tasks(scene, &settings);
    let traced = TracedSettings::from(&settings);
    evaluated_of(
        kinds,
        manifest,
        (scene, plan, tasks::PLAN.name, &[RECEIVERS.name][..]),
        traced,
        bytes,
        progress,
    )
}

/// As [`evaluated`], of a scene whose first tasks `plan` gives, and of which the task kind `planning` plans the relightable bake; `or_else`
/// has the inputs of its rays where there are none.
pub fn evaluated_of(
    kinds: &BakeKinds,
    manifest: &Manifest,
    (scene, plan, planning, or_else): (Vec<u8>, impl FnOnce(Digest) -> Vec<TaskSpec>, &str, &[&str]),
    settings: TracedSettings,
    bytes: ChunkBytes,
    progress: &Progress,
) -> Result<FactoredBake<PatchTable>, EvaluationError> {
    let first = FirstTasks { kinds, plan, run: &[planning], up_to: tasks::TRANSPORT.name, or_else };
    made_anew(first, scene, progress, |context, run| {
        let chunks = manifest.chunks(PATCHES);
        if chunks.iter().map(|chunk| Some(chunk.digest)).ne([run.output(planning, PATCH_SET)]) {
            return Err(EvaluationError::OtherStage { what: "other surface patches".into() });
        }
        let patches = decoded(&chunks[0], bytes, decode_patches)?;
        let is_bare = settings.is_bare;
        let transport = PatchTransport::of(context, settings).map_err(EvaluationError::Prepare)?;
        let columns = |slots: &_| PatchTable::new(&patches, slots);
        let mut bake = FactoredBake::new(manifest, bytes, context, Box::new(transport), columns)?;
        let parts = manifest.chunks(VOXELS).iter().map(|chunk| decoded(chunk, bytes, decode_voxels));
        let parts: Vec<VoxelPart> = parts.collect::<Result<_, EvaluationError>>()?;
        if parts.is_empty() {
            return Ok(bake);
        }
        let voxels = VoxelTable::of_bake(parts.iter(), bake.columns())?;
        let blocks = walked_blocks(manifest);
        let lit = if is_bare { LitByWalks::All } else { LitByWalks::Of(&blocks) };
        bake.walk(|transport| light_of_walks(&voxels, transport, lit, &Threads))?;
        Ok(bake.walkable(Box::new(|bake| Box::new(WalkedBake::new(bake, voxels)))))
    })
}
