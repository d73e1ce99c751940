//! A bake over probes as evaluation sees it.

use lightkiln_proto::kinds::sh::{
    PROBES, ProbeBatch, ProbeTable, Settings, decode_probe_batch, first_tasks, tasks,
};
use lightkiln_proto::manifest::{ChunkRef, Manifest};
use rayon::prelude::*;

use super::{ProbeSet, ProbeTransport};
use crate::evaluate::{ChunkBytes, EvaluationError};
use crate::factors::{FactoredBake, decoded};
use crate::kinds::{BakeKinds, FirstTasks, made_anew};
use crate::task::Progress;

/// Makes the bake's world anew and decodes its chunks.
pub fn evaluated(
    kinds: &BakeKinds,
    manifest: &Manifest,
    scene: Vec<u8>,
    bytes: ChunkBytes,
    progress: &Progress,
) -> Result<FactoredBake<ProbeTable>, EvaluationError> {
    let settings: Settings = manifest.settings()?;
    let plan = |scene| first_tasks(scene, &settings);
    let first =
        FirstTasks { kinds, plan, run: &[tasks::PLAN.name], up_to: tasks::TRANSPORT.name, or_else: &[] };
    made_anew(first, scene, progress, |context, _| {
        let decode = |chunk: &ChunkRef| decoded(chunk, bytes, decode_probe_batch);
        let batches: Vec<ProbeBatch> =
            manifest.chunks(PROBES).par_iter().map(decode).collect::<Result<_, EvaluationError>>()?;
        let set = ProbeSet::of(context).map_err(EvaluationError::Prepare)?;
        let baked = batches.iter().flat_map(|batch| &batch.probes).map(|probe| probe.key);
        if baked.ne(set.probes.iter().map(|probe| probe.key)) {
            return Err(EvaluationError::OtherStage { what: "other probes".into() });
        }
        let transport = ProbeTransport::of(context, (&settings).into()).map_err(EvaluationError::Prepare)?;
        let (rays, bands) = (settings.probes.relight_rays, settings.probes.bands);
        let columns = |slots: &_| ProbeTable::join(&batches, rays, bands, slots);
        FactoredBake::new(manifest, bytes, context, Box::new(transport), columns)
    })
}
