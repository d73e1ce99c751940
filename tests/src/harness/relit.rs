//! Relights a bake with the normative CPU reconstruction until bounces have converged.

use std::collections::BTreeMap;

use anyhow::{Context, Result};
use glam::Vec3;
use lightkiln_proto::chunk::{decode_cluster, decode_probe_batch};
use lightkiln_proto::prt::reconstruct::{
    Rgb, cluster_basis, irradiance, relight, relight_basis, sky_coefficients,
};
use lightkiln_proto::prt::{BlockKey, ClusterTransport, ProbeBatch, ProbeKey, Texel};
use lightkiln_proto::units::{Albedo, Irradiance, Radiance, leaving_radiance};

use super::LocalBake;

/// Most bounces; a closed room of albedo 0.9 is within a thousandth of its end after 66.
const BOUNCES_MAX: usize = 200;
/// Relative change of total irradiance at which bounces have converged.
const CHANGE_MAX: f64 = 1e-5;

/// A receiver and its light.
#[derive(Clone, Debug)]
pub struct RelitReceiver {
    /// Block's name in the manifest: instance path, part and side.
    pub block: String,
    /// Texel in the block.
    pub texel: Texel,
    /// Position in metres.
    pub position_m: Vec3,
    /// Unit normal.
    pub normal: Vec3,
    /// Albedo.
    pub albedo: Rgb,
    /// Irradiance that did not come straight from a dynamic light, W·m⁻².
    pub indirect: Rgb,
    /// The part of `indirect` that came straight from emissive surfaces, W·m⁻².
    pub emitted: Rgb,
}

/// What shines on the scene besides its emissive surfaces.
pub struct Lighting<'a> {
    /// E_dir of dynamic lights at a point with a normal, W·m⁻².
    pub direct: &'a (dyn Fn(Vec3, Vec3) -> Rgb + Sync),
    /// Radiance of the sky at zenith and horizon.
    pub sky: [Rgb; 2],
}

impl Lighting<'_> {
    /// Nothing but emissive surfaces.
    pub const NONE: Lighting<'static> = Lighting { direct: &|_, _| [0.0; 3], sky: [[0.0; 3]; 2] };
}

/// Light at every receiver of a bake, in the order of clusters.
pub fn relit(bake: &LocalBake, lighting: &Lighting) -> Result<Vec<RelitReceiver>> {
    let state = State::load(bake)?;
    let direct: Vec<Vec<Rgb>> = state
        .clusters
        .iter()
        .map(|cluster| {
            let receivers = &cluster.receivers;
            let points = receivers.position_m.iter().zip(&receivers.normal);
            points.map(|(p, n)| (lighting.direct)(Vec3::from_array(*p), Vec3::from_array(*n))).collect()
        })
        .collect();
    let sky = sky_coefficients(lighting.sky[0], lighting.sky[1], bake.manifest.settings.bands);
    let mut indirect: Vec<Vec<Rgb>> =
        state.clusters.iter().map(|cluster| vec![[0.0; 3]; cluster.receivers.len()]).collect();
    let mut total = 0.0;
    for _ in 0..BOUNCES_MAX {
        indirect = state.bounce(&direct, &indirect, &sky);
        let sum: f64 = indirect.iter().flatten().flatten().map(|e| f64::from(*e)).sum();
        let settled = (sum - total).abs() <= CHANGE_MAX * sum;
        total = sum;
        if settled {
            break;
        }
    }
    Ok(state.receivers(bake, &indirect))
}

struct State {
    clusters: Vec<ClusterTransport>,
    batches: Vec<ProbeBatch>,
    bands: u32,
    /// Cluster and receiver there of each texel.
    place: BTreeMap<(BlockKey, Texel), (usize, usize)>,
}

impl State {
    fn load(bake: &LocalBake) -> Result<Self> {
        let bytes =
            |digest| bake.artefacts.get(&digest).with_context(|| format!("chunk {digest} is missing"));
        let mut clusters = Vec::new();
        for cluster in &bake.manifest.clusters {
            clusters.push(decode_cluster(bytes(cluster.digest)?)?);
        }
        let mut batches = Vec::new();
        for batch in &bake.manifest.probes {
            batches.push(decode_probe_batch(bytes(batch.digest)?)?);
        }
        let mut place = BTreeMap::new();
        for (c, cluster) in clusters.iter().enumerate() {
            for (r, (block, texel)) in
                cluster.receivers.block.iter().zip(&cluster.receivers.texel).enumerate()
            {
                place.insert((cluster.receivers.blocks[usize::from(*block)], *texel), (c, r));
            }
        }
        Ok(Self { clusters, batches, bands: bake.manifest.settings.bands, place })
    }

    /// E_ind of the next frame.
    fn bounce(&self, direct: &[Vec<Rgb>], indirect: &[Vec<Rgb>], sky: &[Rgb]) -> Vec<Vec<Rgb>> {
        let mut lambda: BTreeMap<ProbeKey, Vec<Rgb>> = BTreeMap::new();
        for batch in &self.batches {
            let basis = relight_basis(batch.relight_rays, batch.relight_rays, self.bands);
            let coefficients = basis.len() / batch.relight_rays as usize;
            let all = relight(batch, &basis, |block, texel| {
                // Receivers that no light can reach are left out of the chunks.
                let Some(&(c, r)) = self.place.get(&(block, texel)) else { return [0.0; 3] };
                let e = [0, 1, 2].map(|channel| direct[c][r][channel] + indirect[c][r][channel]);
                let albedo = Albedo(self.clusters[c].receivers.albedo[r]);
                leaving_radiance(Radiance::default(), albedo, Irradiance(e)).0
            });
            for (probe, values) in batch.probes.iter().zip(all.chunks_exact(coefficients)) {
                lambda.insert(probe.key, values.to_vec());
            }
        }
        let of = |cluster: &ClusterTransport| {
            let basis = cluster_basis(cluster, |probe| lambda.get(&probe).map(Vec::as_slice), sky);
            irradiance(cluster, &basis, |_| 1.0)
        };
        self.clusters.iter().map(of).collect()
    }

    fn receivers(&self, bake: &LocalBake, indirect: &[Vec<Rgb>]) -> Vec<RelitReceiver> {
        let names: BTreeMap<BlockKey, &str> =
            bake.manifest.blocks.iter().map(|block| (block.key, block.name.as_str())).collect();
        let mut all = Vec::new();
        for (cluster, light) in self.clusters.iter().zip(indirect) {
            let receivers = &cluster.receivers;
            for (r, indirect) in light.iter().enumerate() {
                let mut emitted = [0.0; 3];
                for emitter in &cluster.emitters {
                    emitted = [0, 1, 2].map(|c| emitted[c] + emitter.irradiance[r][c]);
                }
                let block = receivers.blocks[usize::from(receivers.block[r])];
                all.push(RelitReceiver {
                    block: names.get(&block).copied().unwrap_or_default().to_owned(),
                    texel: receivers.texel[r],
                    position_m: Vec3::from_array(receivers.position_m[r]),
                    normal: Vec3::from_array(receivers.normal[r]),
                    albedo: receivers.albedo[r],
                    indirect: *indirect,
                    emitted,
                });
            }
        }
        all
    }
}
