//! The decoded clusters of a bake, relit by the run time's own passes until bounces have converged.

use glam::{DVec3, Vec4};
use lightkiln_proto::chunk::{ChunkError, decode_cluster};
use lightkiln_proto::content::ClusterTransport;
use lightkiln_proto::manifest::{CLUSTERS, ChunkRef, Manifest};
use lightkiln_proto::relight::{
    Columns, DirectAt, Incoming, Inconsistent, Limit, Parallel, Settled, Sky, SlotTable, Transport,
};
use rayon::prelude::*;

use crate::evaluate::{ChunkBytes, EvaluationError};
use crate::geometry::Site;
use crate::reference::Lighting;

/// End of the bounces; a closed room of albedo 0.98 is within a thousandth of its end after 342.
const LIMIT: Limit = Limit { bounces_max: 400, change_max: 1e-5 };

/// Items on all threads, their results in order.
#[derive(Clone, Copy, Debug, Default)]
pub struct Threads;

impl Parallel for Threads {
    fn map<T: Send>(&self, count: usize, each: impl Fn(usize) -> T + Send + Sync) -> Vec<T> {
        (0..count).into_par_iter().map(each).collect()
    }
}

/// Decoded clusters of a bake over columns `C`.
#[derive(Debug)]
pub struct Baked<C> {
    /// Run time's tables.
    pub transport: Transport<C>,
    emitters: usize,
}

/// A bake under some lights.
#[derive(Debug)]
pub struct Light {
    /// Light at receivers.
    pub settled: Settled,
    /// Strength of each of the scene's emitters relative to the bake.
    pub emitter_scale: Vec<f32>,
}

impl<C: Columns> Baked<C> {
    /// Decodes every cluster; `columns` makes the columns, with all receivers in their slots.
    pub fn decode(
        manifest: &Manifest,
        bytes: ChunkBytes,
        columns: impl FnOnce(&SlotTable) -> Result<C, Inconsistent>,
    ) -> Result<Self, EvaluationError> {
        let decode = |chunk: &ChunkRef| decoded(chunk, bytes, decode_cluster);
        let clusters: Vec<ClusterTransport> =
            manifest.chunks(CLUSTERS).par_iter().map(decode).collect::<Result<_, EvaluationError>>()?;
        let blocks = manifest.layout()?.blocks.iter().map(|block| (block.key, block.size));
        let emitters = manifest.emitters.len();
        let transport = Transport::join(blocks, emitters, &clusters, columns)?;
        Ok(Self { transport, emitters })
    }

    /// The bake under lights until bounces converge. `direct` gives the mean of E_dir over sites, W·m⁻²; `sites` are those
    /// of a slot's texel, `site` is that of its receiver.
    pub fn lit<E: Send>(
        &self,
        lighting: &Lighting,
        sites: impl Fn(u32) -> Vec<Site> + Sync,
        site: impl Fn(u32) -> Site + Sync,
        direct: impl Fn(&[Site]) -> Result<DVec3, E> + Sync,
    ) -> Result<Light, E> {
        let at = |place: DirectAt| -> Result<Vec4, E> {
            let found = match place {
                DirectAt::Receiver(slot) => direct(&sites(slot))?,
                DirectAt::Texel { slot, position_m, .. } => direct(&[Site { position_m, ..site(slot) }])?,
                DirectAt::Point { position_m, normal } => {
                    direct(&[Site { position_m, normal, face_normal: normal }])?
                }
            };
            Ok(found.as_vec3().extend(0.0))
        };
        let Transport { receivers, near, .. } = &self.transport;
        let slots = (0..receivers.len() as u32).into_par_iter();
        let dir = slots.map(|slot| at(DirectAt::Receiver(slot))).collect::<Result<Vec<Vec4>, E>>()?;
        let hits = (0..near.len()).into_par_iter();
        let of_near = hits.map(|hit| at(near.direct_at(hit, receivers))).collect::<Result<Vec<Vec4>, E>>()?;
        Ok(self.settled(lighting, &dir, &of_near))
    }

    /// The bake under lights until bounces converge, from E_dir by slot and by near hit, W·m⁻².
    pub fn settled(&self, lighting: &Lighting, dir: &[Vec4], near: &[Vec4]) -> Light {
        let emitter_scale = vec![lighting.emitter_scale; self.emitters];
        let sky = Sky::of(&lighting.lights);
        let panorama = lighting.panorama.as_deref();
        let incoming =
            Incoming { dir, near, sky, panorama, emitter_scale: &emitter_scale, ..Incoming::default() };
        Light { settled: self.transport.settle(&Threads, &incoming, LIMIT), emitter_scale }
    }

    /// Cluster of a slot.
    pub fn cluster_of(&self, slot: u32) -> usize {
        let clusters = &self.transport.clusters.clusters;
        clusters.partition_point(|cluster| cluster.rows().end <= slot as usize)
    }
}

/// A chunk fetched and decoded.
pub fn decoded<T>(
    chunk: &ChunkRef,
    bytes: ChunkBytes,
    decode: impl FnOnce(&[u8]) -> Result<T, ChunkError>,
) -> Result<T, EvaluationError> {
    let digest = chunk.digest;
    decode(&bytes(digest)?).map_err(|source| EvaluationError::Chunk { digest, source })
}
