//! A bake over probes as evaluation sees it.

use lightkiln_proto::content::{BlockKey, Texel};
use lightkiln_proto::kinds::sh::{PROBES, ProbeBatch, Settings, ShTask, decode_probe_batch, first_tasks};
use lightkiln_proto::manifest::{ChunkRef, Manifest};
use lightkiln_proto::prt::reconstruct::{Rgb, relight, relight_basis, sky_coefficients};
use rayon::prelude::*;

use super::{ProbeSet, ProbeTransport};
use crate::evaluate::{ChunkBytes, EvaluationError};
use crate::factors::{Carriers, FactoredBake, Lambda, decoded};
use crate::kinds::{BakeKinds, made_anew};
use crate::task::Progress;

/// Decoded batches of probes.
struct Probes {
    batches: Vec<ProbeBatch>,
    bands: u32,
}

impl Carriers for Probes {
    fn lambda(&self, radiance: &(dyn Fn(BlockKey, Texel) -> Rgb + Sync), _: [Rgb; 2]) -> Lambda {
        let of_batch = |batch: &ProbeBatch| -> Vec<(u64, Vec<Rgb>)> {
            let basis = relight_basis(batch.relight_rays, batch.relight_rays, self.bands);
            let coefficients = basis.len() / batch.relight_rays as usize;
            let all = relight(batch, &basis, radiance);
            let lambda = all.chunks_exact(coefficients).map(<[_]>::to_vec);
            batch.probes.iter().map(|probe| probe.key).zip(lambda).collect()
        };
        self.batches.par_iter().flat_map_iter(of_batch).collect()
    }

    fn lambda_sky(&self, sky: [Rgb; 2]) -> Vec<Rgb> {
        sky_coefficients(sky[0], sky[1], self.bands)
    }
}

/// Makes the bake's world anew and decodes its chunks.
pub fn evaluated(
    manifest: &Manifest,
    scene: Vec<u8>,
    bytes: ChunkBytes,
    progress: &Progress,
) -> Result<FactoredBake, EvaluationError> {
    let settings: Settings = manifest.settings()?;
    let plan = |scene| first_tasks(scene, &settings);
    made_anew(&BakeKinds::new(), plan, ShTask::Transport.name(), scene, progress, |context, _| {
        let decode = |chunk: &ChunkRef| decoded(chunk, bytes, decode_probe_batch);
        let batches: Vec<ProbeBatch> =
            manifest.chunks(PROBES).par_iter().map(decode).collect::<Result<_, EvaluationError>>()?;
        let set = ProbeSet::of(context).map_err(EvaluationError::Prepare)?;
        let baked = batches.iter().flat_map(|batch| &batch.probes).map(|probe| probe.key);
        if baked.ne(set.probes.iter().map(|probe| probe.key)) {
            return Err(EvaluationError::OtherStage { what: "other probes".into() });
        }
        let carriers = Probes { batches, bands: settings.probes.bands };
        let transport = ProbeTransport::of(context, settings.clone()).map_err(EvaluationError::Prepare)?;
        FactoredBake::new(manifest, bytes, context, Box::new(transport), Box::new(carriers))
    })
}
