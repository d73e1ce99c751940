//! A bake decoded from its chunks, relit by the normative reconstruction until bounces have converged.

use std::collections::BTreeMap;

use glam::Vec3;
use lightkiln_proto::chunk::{ChunkError, decode_cluster};
use lightkiln_proto::content::{BlockKey, ClusterTransport, ColumnKey, NearSurface, Texel};
use lightkiln_proto::manifest::{CLUSTERS, ChunkRef, Manifest};
use lightkiln_proto::prt::reconstruct::{Rgb, cluster_basis, irradiance, near_irradiance};
use lightkiln_proto::units::{Albedo, Irradiance, Radiance, leaving_radiance};
use rayon::prelude::*;

use crate::evaluate::{ChunkBytes, EvaluationError};
use crate::geometry::Site;

/// Most bounces; a closed room of albedo 0.98 is within a thousandth of its end after 342.
const BOUNCES_MAX: usize = 400;
/// Relative change of total irradiance at which bounces have converged.
const CHANGE_MAX: f64 = 1e-5;

/// Where a receiver is: its cluster, and its place there.
pub type Place = (usize, usize);

/// λ of a column key: one colour for each of its coefficients.
pub type Lambda = BTreeMap<ColumnKey, Vec<Rgb>>;

/// The carriers of light that a kind's columns name: from radiance at receivers to λ.
pub trait Carriers: Send + Sync {
    /// λ of every carrier; `radiance` gives that of a texel, `sky` is the sky at zenith and horizon.
    fn lambda(&self, radiance: &(dyn Fn(BlockKey, Texel) -> Rgb + Sync), sky: [Rgb; 2]) -> Lambda;

    /// λ of the columns that clusters have for the sky beside those of keys.
    fn lambda_sky(&self, sky: [Rgb; 2]) -> Vec<Rgb>;
}

/// Decoded clusters of a bake, and the carriers of their light.
pub struct Baked {
    /// Clusters in the manifest's order.
    pub clusters: Vec<ClusterTransport>,
    carriers: Box<dyn Carriers>,
    place_of: BTreeMap<(BlockKey, Texel), Place>,
    /// Surface of each near hit, by cluster; `None` for those that no light can reach.
    near: Vec<Vec<Option<NearPlace>>>,
}

/// Surface that a near hit lies on.
#[derive(Clone, Copy, Debug)]
struct NearPlace {
    albedo: [f32; 3],
    /// Its own, or none for that of the texel.
    normal: Option<[f32; 3]>,
    /// Whose E_ind it has: the texel, or the receiver that meets it.
    light: Place,
}

/// Where E_dir is asked for.
#[derive(Clone, Copy, Debug)]
pub enum DirectAt {
    /// At a receiver.
    Receiver(Place),
    /// At a point of a receiver's texel, in metres.
    Texel(Place, [f32; 3]),
    /// At a point in metres with a normal.
    Point([f32; 3], [f32; 3]),
}

impl DirectAt {
    /// As a site of the reference, `of` giving those of receivers.
    pub fn site(self, of: impl Fn(Place) -> Site) -> Site {
        match self {
            Self::Receiver(place) => of(place),
            Self::Texel(place, point_m) => Site { position_m: Vec3::from_array(point_m), ..of(place) },
            Self::Point(point_m, normal) => {
                let normal = Vec3::from_array(normal);
                Site { position_m: Vec3::from_array(point_m), normal, face_normal: normal }
            }
        }
    }
}

/// E_dir wherever the run time reads it, W·m⁻².
#[derive(Clone, Debug, Default)]
pub struct Direct {
    /// At each receiver by cluster.
    pub receivers: Vec<Vec<Rgb>>,
    /// At each near hit by cluster.
    pub near: Vec<Vec<Rgb>>,
}

/// Light that the run time is given from frame to frame.
#[derive(Clone, Debug)]
pub struct Incoming {
    /// E_dir.
    pub direct: Direct,
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
    /// The part of it that near hits gave, likewise; nothing in clusters without any.
    pub near: Vec<Vec<Rgb>>,
    /// λ that gave it.
    pub lambda: Lambda,
    /// λ of the sky.
    pub lambda_sky: Vec<Rgb>,
    /// Bounces until it changed no more.
    pub bounces: usize,
    /// Whether it did before the last bounce allowed.
    pub converged: bool,
}

impl Settled {
    /// Light that near hits gave receiver r of cluster c, W·m⁻².
    pub fn near_of(&self, c: usize, r: usize) -> Rgb {
        self.near[c].get(r).copied().unwrap_or_default()
    }

    /// λ of a column key; nothing for one that no carrier has.
    pub fn lambda_of(&self, probe: ColumnKey) -> Option<&[Rgb]> {
        self.lambda.get(&probe).map(Vec::as_slice)
    }
}

impl Baked {
    /// Decodes every cluster.
    pub fn decode(
        manifest: &Manifest,
        bytes: ChunkBytes,
        carriers: Box<dyn Carriers>,
    ) -> Result<Self, EvaluationError> {
        let decode = |chunk: &ChunkRef| decoded(chunk, bytes, decode_cluster);
        let clusters: Vec<_> =
            manifest.chunks(CLUSTERS).par_iter().map(decode).collect::<Result<_, EvaluationError>>()?;
        let mut place_of = BTreeMap::new();
        for (c, cluster) in clusters.iter().enumerate() {
            for (r, name) in names(cluster).enumerate() {
                place_of.insert(name, (c, r));
            }
        }
        let near_places = |(c, cluster): (usize, &ClusterTransport)| {
            let place = |(own, surface): (usize, &NearSurface)| match *surface {
                NearSurface::Texel { block, texel } => {
                    let name = (cluster.near.blocks[usize::from(block)], texel);
                    let light = place_of.get(&name).copied()?;
                    Some(NearPlace {
                        albedo: clusters[light.0].receivers.albedo[light.1],
                        normal: None,
                        light,
                    })
                }
                NearSurface::Own { albedo, normal } => {
                    Some(NearPlace { albedo, normal: Some(normal), light: (c, own) })
                }
            };
            cluster.near.receivers().zip(&cluster.near.surface).map(place).collect()
        };
        let near = clusters.par_iter().enumerate().map(near_places).collect();
        Ok(Self { clusters, carriers, place_of, near })
    }

    /// E_dir wherever the run time reads it, W·m⁻², as `at` gives it.
    pub fn direct<E: Send>(&self, at: impl Fn(DirectAt) -> Result<Rgb, E> + Sync) -> Result<Direct, E> {
        let receivers = |c: usize| -> Result<Vec<Rgb>, E> {
            let count = self.clusters[c].receivers.len();
            (0..count).into_par_iter().map(|r| at(DirectAt::Receiver((c, r)))).collect()
        };
        let near = |c: usize| -> Result<Vec<Rgb>, E> {
            let ClusterTransport { receivers, near, .. } = &self.clusters[c];
            let at_hit = |(hit, (place, r)): (usize, (&Option<NearPlace>, usize))| {
                let Some(NearPlace { normal: own, light, .. }) = *place else { return Ok([0.0; 3]) };
                let normal = own.unwrap_or_else(|| self.clusters[light.0].receivers.normal[light.1]);
                let point_m = near.position_m(hit, receivers.position_m[r], normal);
                at(if own.is_some() {
                    DirectAt::Point(point_m, normal)
                } else {
                    DirectAt::Texel(light, point_m)
                })
            };
            let own: Vec<usize> = near.receivers().collect();
            self.near[c].par_iter().zip(own).enumerate().map(at_hit).collect()
        };
        let clusters = || 0..self.clusters.len();
        Ok(Direct {
            receivers: clusters().map(receivers).collect::<Result<_, _>>()?,
            near: clusters().map(near).collect::<Result<_, _>>()?,
        })
    }

    /// Where the receiver of a texel is; `None` for those that no light can reach, which chunks leave out.
    pub fn place(&self, block: BlockKey, texel: Texel) -> Option<Place> {
        self.place_of.get(&(block, texel)).copied()
    }

    /// How many receivers there are.
    pub fn receivers(&self) -> usize {
        self.place_of.len()
    }

    /// Lets light bounce until its total changes by less than a hundred-thousandth.
    pub fn settle(&self, incoming: &Incoming) -> Settled {
        let dark = |cluster: &ClusterTransport| vec![[0.0; 3]; cluster.receivers.len()];
        let mut settled = Settled {
            indirect: self.clusters.iter().map(dark).collect(),
            lambda_sky: self.carriers.lambda_sky(incoming.sky),
            ..Settled::default()
        };
        let mut total = 0.0;
        while settled.bounces < BOUNCES_MAX && !settled.converged {
            settled.lambda = self.lambda(incoming, &settled.indirect);
            settled.near = self.near_light(incoming, &settled.indirect);
            settled.indirect = self.reconstruct(&settled, incoming.emitter_scale);
            let sum: f64 = settled.indirect.iter().flatten().flatten().map(|e| f64::from(*e)).sum();
            settled.converged = (sum - total).abs() <= CHANGE_MAX * sum;
            settled.bounces += 1;
            total = sum;
        }
        settled
    }

    /// λ of every carrier from the light at receivers.
    fn lambda(&self, incoming: &Incoming, indirect: &[Vec<Rgb>]) -> Lambda {
        let radiance = |block, texel| {
            // Receivers that no light can reach are left out of the chunks.
            let Some((c, r)) = self.place(block, texel) else { return [0.0; 3] };
            let e =
                [0, 1, 2].map(|channel| incoming.direct.receivers[c][r][channel] + indirect[c][r][channel]);
            let albedo = Albedo(self.clusters[c].receivers.albedo[r]);
            leaving_radiance(Radiance::default(), albedo, Irradiance(e)).0
        };
        self.carriers.lambda(&radiance, incoming.sky)
    }

    /// Light that near hits give the receivers of each cluster.
    fn near_light(&self, incoming: &Incoming, indirect: &[Vec<Rgb>]) -> Vec<Vec<Rgb>> {
        let of_cluster = |(c, cluster): (usize, &ClusterTransport)| {
            near_irradiance(&cluster.near, |hit| {
                let Some(NearPlace { albedo, light, .. }) = self.near[c][hit] else { return [0.0; 3] };
                let (direct, indirect) = (incoming.direct.near[c][hit], indirect[light.0][light.1]);
                let e = [0, 1, 2].map(|channel| direct[channel] + indirect[channel]);
                leaving_radiance(Radiance::default(), Albedo(albedo), Irradiance(e)).0
            })
        };
        self.clusters.par_iter().enumerate().map(of_cluster).collect()
    }

    /// E_ind of every receiver from λ.
    fn reconstruct(&self, settled: &Settled, emitter_scale: f32) -> Vec<Vec<Rgb>> {
        let of =
            |(cluster, near): (_, &Vec<Rgb>)| reconstructed(cluster, settled, near.clone(), emitter_scale);
        self.clusters.par_iter().zip(&settled.near).map(of).collect()
    }
}

/// E_ind at a cluster's receivers from λ and the light of near hits, W·m⁻².
pub fn reconstructed(
    cluster: &ClusterTransport,
    settled: &Settled,
    near: Vec<Rgb>,
    emitter_scale: f32,
) -> Vec<Rgb> {
    let basis = cluster_basis(cluster, |probe| settled.lambda_of(probe), &settled.lambda_sky);
    irradiance(cluster, &basis, near, |_| emitter_scale)
}

/// Block and texel of a cluster's receivers.
pub fn names(cluster: &ClusterTransport) -> impl Iterator<Item = (BlockKey, Texel)> + '_ {
    let receivers = &cluster.receivers;
    let block = |index: &u16| receivers.blocks[usize::from(*index)];
    receivers.block.iter().map(block).zip(receivers.texel.iter().copied())
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
