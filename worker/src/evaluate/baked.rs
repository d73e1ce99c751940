//! A bake decoded from its chunks, relit by the normative reconstruction until bounces have converged.

use std::collections::BTreeMap;

use lightkiln_proto::chunk::{decode_cluster, decode_patches, decode_probe_batch};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::manifest::Manifest;
use lightkiln_proto::prt::reconstruct::{
    Rgb, cluster_basis, irradiance, patch_radiance, relight, relight_basis, sky_coefficients,
};
use lightkiln_proto::prt::{BasisKind, BlockKey, ClusterTransport, PatchSet, ProbeBatch, ProbeKey, Texel};
use lightkiln_proto::units::{Albedo, Irradiance, Radiance, leaving_radiance};
use rayon::prelude::*;

use super::error::EvaluationError;

/// Most bounces; a closed room of albedo 0.98 is within a thousandth of its end after 342.
const BOUNCES_MAX: usize = 400;
/// Relative change of total irradiance at which bounces have converged.
const CHANGE_MAX: f64 = 1e-5;

/// Where a receiver is: its cluster, and its place there.
pub type Place = (usize, usize);

/// Decoded clusters and probes of a bake.
#[derive(Debug)]
pub struct Baked {
    /// Clusters in the manifest's order.
    pub clusters: Vec<ClusterTransport>,
    batches: Vec<ProbeBatch>,
    patches: Vec<PatchSet>,
    basis: BasisKind,
    bands: u32,
    place_of: BTreeMap<(BlockKey, Texel), Place>,
}

/// Light that is not the scene's own geometry's to know: what the run time is given from frame to frame.
#[derive(Clone, Debug)]
pub struct Incoming {
    /// E_dir of each receiver by cluster, W·m⁻².
    pub direct: Vec<Vec<Rgb>>,
    /// Radiance of the sky at zenith and horizon, W·m⁻²·sr⁻¹.
    pub sky: [Rgb; 2],
    /// Strength of the scene's emitters relative to the bake.
    pub emitter_scale: f32,
}

/// Light after the last bounce.
#[derive(Clone, Debug, Default)]
pub struct Settled {
    /// E_ind of each receiver by cluster, W·m⁻².
    pub indirect: Vec<Vec<Rgb>>,
    /// λ that gave it, by probe.
    pub lambda: BTreeMap<ProbeKey, Vec<Rgb>>,
    /// λ of the sky.
    pub lambda_sky: Vec<Rgb>,
    /// Bounces until it changed no more.
    pub bounces: usize,
    /// Whether it did before the last bounce allowed.
    pub converged: bool,
}

impl Settled {
    /// λ of a probe; nothing for one that is in no batch.
    pub fn lambda_of(&self, probe: ProbeKey) -> Option<&[Rgb]> {
        self.lambda.get(&probe).map(Vec::as_slice)
    }
}

impl Baked {
    /// Decodes every chunk of clusters and probes; `bytes` gives a chunk's bytes by digest.
    pub fn decode(
        manifest: &Manifest,
        bytes: impl Fn(Digest) -> Result<Vec<u8>, EvaluationError> + Sync,
    ) -> Result<Self, EvaluationError> {
        let damaged = |digest, source| EvaluationError::Chunk { digest, source };
        let clusters = manifest
            .clusters
            .par_iter()
            .map(|c| decode_cluster(&bytes(c.digest)?).map_err(|error| damaged(c.digest, error)))
            .collect::<Result<Vec<_>, _>>()?;
        let batches = manifest
            .probes
            .par_iter()
            .map(|b| decode_probe_batch(&bytes(b.digest)?).map_err(|error| damaged(b.digest, error)))
            .collect::<Result<Vec<_>, _>>()?;
        let patches = manifest
            .patches
            .iter()
            .map(|p| decode_patches(&bytes(p.digest)?).map_err(|error| damaged(p.digest, error)))
            .collect::<Result<Vec<_>, _>>()?;
        let mut place_of = BTreeMap::new();
        for (c, cluster) in clusters.iter().enumerate() {
            for (r, name) in names(cluster).enumerate() {
                place_of.insert(name, (c, r));
            }
        }
        let (basis, bands) = (manifest.settings.basis, manifest.settings.bands);
        Ok(Self { clusters, batches, patches, basis, bands, place_of })
    }

    /// Where the receiver of a texel is; `None` for those that no light can reach, which chunks leave out.
    pub fn place(&self, block: BlockKey, texel: Texel) -> Option<Place> {
        self.place_of.get(&(block, texel)).copied()
    }

    /// How many receivers there are.
    pub fn receivers(&self) -> usize {
        self.place_of.len()
    }

    /// All probes.
    pub fn probes(&self) -> impl Iterator<Item = ProbeKey> + '_ {
        self.batches.iter().flat_map(|batch| batch.probes.iter().map(|probe| probe.key))
    }

    /// Lets light bounce until its total changes by less than a hundred-thousandth.
    pub fn settle(&self, incoming: &Incoming) -> Settled {
        let dark = |cluster: &ClusterTransport| vec![[0.0; 3]; cluster.receivers.len()];
        let mut settled = Settled {
            indirect: self.clusters.iter().map(dark).collect(),
            lambda_sky: sky_coefficients(incoming.sky[0], incoming.sky[1], self.bands),
            ..Settled::default()
        };
        let mut total = 0.0;
        while settled.bounces < BOUNCES_MAX && !settled.converged {
            settled.lambda = self.lambda(incoming, &settled.indirect);
            settled.indirect = self.reconstruct(&settled, incoming.emitter_scale);
            let sum: f64 = settled.indirect.iter().flatten().flatten().map(|e| f64::from(*e)).sum();
            settled.converged = (sum - total).abs() <= CHANGE_MAX * sum;
            settled.bounces += 1;
            total = sum;
        }
        settled
    }

    /// λ of every probe, or patch, from the light at receivers.
    fn lambda(&self, incoming: &Incoming, indirect: &[Vec<Rgb>]) -> BTreeMap<ProbeKey, Vec<Rgb>> {
        let radiance = |block, texel| {
            // Receivers that no light can reach are left out of the chunks.
            let Some((c, r)) = self.place(block, texel) else { return [0.0; 3] };
            let e = [0, 1, 2].map(|channel| incoming.direct[c][r][channel] + indirect[c][r][channel]);
            let albedo = Albedo(self.clusters[c].receivers.albedo[r]);
            leaving_radiance(Radiance::default(), albedo, Irradiance(e)).0
        };
        let of_batch = |batch: &ProbeBatch| -> Vec<(ProbeKey, Vec<Rgb>)> {
            let basis = relight_basis(batch.relight_rays, batch.relight_rays, self.bands);
            let coefficients = basis.len() / batch.relight_rays as usize;
            let all = relight(batch, &basis, radiance);
            let lambda = all.chunks_exact(coefficients).map(<[_]>::to_vec);
            batch.probes.iter().map(|probe| probe.key).zip(lambda).collect()
        };
        let of_patches = |set: &PatchSet| -> Vec<(ProbeKey, Vec<Rgb>)> {
            let means = patch_radiance(set, radiance, incoming.sky);
            means.into_iter().map(|(key, mean)| (key.0, vec![mean])).collect()
        };
        match self.basis {
            BasisKind::Sh => self.batches.par_iter().flat_map_iter(of_batch).collect(),
            BasisKind::Patches => self.patches.iter().flat_map(of_patches).collect(),
        }
    }

    /// E_ind of every receiver from λ.
    fn reconstruct(&self, settled: &Settled, emitter_scale: f32) -> Vec<Vec<Rgb>> {
        let of = |cluster| reconstructed(cluster, settled, emitter_scale);
        self.clusters.par_iter().map(of).collect()
    }
}

/// E_ind at a cluster's receivers from λ, W·m⁻².
pub fn reconstructed(cluster: &ClusterTransport, settled: &Settled, emitter_scale: f32) -> Vec<Rgb> {
    let basis = cluster_basis(cluster, |probe| settled.lambda_of(probe), &settled.lambda_sky);
    irradiance(cluster, &basis, |_| emitter_scale)
}

/// Block and texel of a cluster's receivers.
pub fn names(cluster: &ClusterTransport) -> impl Iterator<Item = (BlockKey, Texel)> + '_ {
    let receivers = &cluster.receivers;
    let block = |index: &u16| receivers.blocks[usize::from(*index)];
    receivers.block.iter().map(block).zip(receivers.texel.iter().copied())
}
