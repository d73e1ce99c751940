//! Relights a bake with the normative CPU reconstruction until bounces have converged.

use std::collections::BTreeMap;

use anyhow::Result;
use glam::Vec3;
use lightkiln_proto::prt::reconstruct::Rgb;
use lightkiln_proto::prt::{BlockKey, Texel};
use lightkiln_worker::evaluate::{Baked, EvaluationError, Incoming, Settled, names};
use lightkiln_worker::reference::Site;

use super::LocalBake;

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
    let baked = Baked::decode(&bake.manifest, |digest| {
        let found = bake.artefacts.get(&digest).map(|bytes| bytes.as_ref().clone());
        found.ok_or_else(|| EvaluationError::Missing { digest, source: "no task gave it".into() })
    })?;
    let direct = baked.direct(|at| -> Result<_> {
        let site = at.site(|(c, r)| {
            let receivers = &baked.clusters[c].receivers;
            let normal = Vec3::from_array(receivers.normal[r]);
            Site { position_m: Vec3::from_array(receivers.position_m[r]), normal, face_normal: normal }
        });
        Ok((lighting.direct)(site.position_m, site.normal))
    })?;
    let incoming = Incoming { direct, sky: lighting.sky, emitter_scale: 1.0 };
    let settled = baked.settle(&incoming);
    Ok(receivers(bake, &baked, &settled))
}

fn receivers(bake: &LocalBake, baked: &Baked, settled: &Settled) -> Vec<RelitReceiver> {
    let block_names: BTreeMap<BlockKey, &str> =
        bake.manifest.blocks.iter().map(|block| (block.key, block.name.as_str())).collect();
    let mut all = Vec::new();
    for (cluster, light) in baked.clusters.iter().zip(&settled.indirect) {
        let receivers = &cluster.receivers;
        for (r, ((block, texel), indirect)) in names(cluster).zip(light).enumerate() {
            let mut emitted = [0.0; 3];
            for emitter in &cluster.emitters {
                emitted = [0, 1, 2].map(|c| emitted[c] + emitter.irradiance[r][c]);
            }
            all.push(RelitReceiver {
                block: block_names.get(&block).copied().unwrap_or_default().to_owned(),
                texel,
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
