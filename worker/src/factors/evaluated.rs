//! A bake of factorised clusters as evaluation sees it.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::{DVec3, Vec2};
use lightkiln_proto::content::{BlockKey, Texel};
use lightkiln_proto::manifest::Manifest;
use lightkiln_proto::prt::reconstruct::Rgb;
use lightkiln_proto::scene::LightKind;

use super::anew::{Anew, wide};
use super::baked::{Baked, Carriers, Incoming, Place, Settled};
use super::{ClusterCell, Transport, cells_of_task};
use crate::evaluate::{Answer, ChunkBytes, ErrorClass, Evaluated, EvaluationError, Measure, PlaceId, Relit};
use crate::geometry::{Geometry, Site};
use crate::lightmap::{Surface, World};
use crate::rays::Hit;
use crate::reference::{Lighting, Reference};
use crate::task::{Cancelled, Context, Progress};

/// Points over a panel that give E_dir at every receiver of the bake.
const PANEL_POINTS: u32 = 64;

/// A decoded bake in its world, made anew.
pub struct FactoredBake {
    world: Arc<World>,
    transport: Box<dyn Transport>,
    baked: Baked,
    cells: Vec<ClusterCell>,
    /// Index of each cluster's receivers in the lightmap.
    receiver_of: Vec<Vec<u32>>,
    anew: Option<Anew>,
}

impl FactoredBake {
    /// Decodes a bake's clusters and finds their receivers in the world that `context` has, that of its transport tasks.
    ///
    /// Errors when the world is not the one that was baked.
    pub fn new(
        manifest: &Manifest,
        bytes: ChunkBytes,
        context: &Context,
        transport: Box<dyn Transport>,
        carriers: Box<dyn Carriers>,
    ) -> Result<Self, EvaluationError> {
        let world = World::of(context).map_err(EvaluationError::Prepare)?;
        let cells = cells_of_task(context).map_err(EvaluationError::Prepare)?.as_ref().clone();
        let baked = Baked::decode(manifest, bytes, carriers)?;
        let receiver_of = same_world(manifest, &world, &baked)?;
        Ok(Self { world, transport, baked, cells, receiver_of, anew: None })
    }

    /// The world.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The decoded bake.
    pub fn baked(&self) -> &Baked {
        &self.baked
    }

    /// Cluster of a receiver and its place there; `None` for those that no light can reach.
    pub fn place(&self, receiver: u32) -> Option<Place> {
        let (block, texel) = self.world.lightmap.name_of(receiver);
        self.baked.place(block, texel)
    }

    /// The bake relit until bounces converge, E_dir by exact rays.
    pub fn settled(
        &self,
        reference: &Reference,
        lighting: &Lighting,
        progress: &Progress,
    ) -> Result<Settled, Cancelled> {
        let receivers = &self.world.lightmap.receivers;
        let direct = self.baked.direct(|at| -> Result<Rgb, Cancelled> {
            progress.check()?;
            let site = at.site(|(c, r)| receivers[self.receiver_of[c][r] as usize].site());
            Ok(reference.direct_irradiance(&site, PANEL_POINTS).as_vec3().to_array())
        })?;
        let mut sky = [[0.0; 3]; 2];
        for lamp in &lighting.lights {
            if let LightKind::Sky { zenith, horizon } = &lamp.kind {
                for (sum, colour) in sky.iter_mut().zip([zenith, horizon]) {
                    *sum = [0, 1, 2].map(|c| sum[c] + colour[c] * lamp.strength[c]);
                }
            }
        }
        Ok(self.baked.settle(&Incoming { direct, sky, emitter_scale: lighting.emitter_scale }))
    }
}

/// Classes of error of a factorised bake.
pub const ERROR_CLASSES: [&str; 3] = ["transport", "factorisation", "quantisation"];

impl Evaluated for FactoredBake {
    fn geometry(&self) -> &Geometry {
        &self.world.geometry
    }

    fn answer_at(&self, hit: &Hit) -> Answer {
        match self.world.surface_at(hit) {
            Surface::Receiver(receiver) => Answer::Place(receiver),
            Surface::Dark if self.world.is_in_cavity(hit) => Answer::Cavity,
            Surface::Dark => Answer::TooSmall,
        }
    }

    fn site(&self, place: PlaceId) -> Site {
        self.world.lightmap.receivers[place as usize].site()
    }

    fn texel(&self, place: PlaceId) -> Option<(BlockKey, Texel)> {
        Some(self.world.lightmap.name_of(place))
    }

    fn place_of(&self, block: BlockKey, texel: Texel) -> Option<PlaceId> {
        self.baked.place(block, texel).map(|(c, r)| self.receiver_of[c][r])
    }

    fn chunk_of(&self, place: PlaceId) -> Option<usize> {
        self.place(place).map(|(cluster, _)| cluster)
    }

    fn lightmap_at(&self, hit: &Hit) -> Option<(BlockKey, Vec2)> {
        self.world.lightmap_at(hit)
    }

    fn trace(&mut self, sample: &[PlaceId], effort: usize, progress: &Progress) -> Result<(), Cancelled> {
        self.anew = Some(Anew::trace(self.transport.as_ref(), &self.cells, sample, effort, progress)?);
        Ok(())
    }

    fn traced(&self) -> [usize; 2] {
        self.anew.as_ref().map_or([0; 2], |anew| [anew.cells(), anew.clusters()])
    }

    fn relit<'a>(
        &'a self,
        reference: &Reference,
        lighting: &Lighting,
        progress: &Progress,
    ) -> Result<Box<dyn Relit + 'a>, Cancelled> {
        let settled = self.settled(reference, lighting, progress)?;
        Ok(Box::new(RelitBake { bake: self, settled, emitter_scale: lighting.emitter_scale }))
    }
}

/// A bake under some lights.
struct RelitBake<'a> {
    bake: &'a FactoredBake,
    settled: Settled,
    emitter_scale: f32,
}

impl Relit for RelitBake<'_> {
    fn irradiance(&self, place: PlaceId) -> Option<DVec3> {
        self.bake.place(place).map(|(c, r)| wide(self.settled.indirect[c][r]))
    }

    fn bounces(&self) -> (usize, bool) {
        (self.settled.bounces, self.settled.converged)
    }

    fn classes(&self, sample: &[PlaceId]) -> Vec<ErrorClass> {
        let Some(anew) = &self.bake.anew else { return Vec::new() };
        let near_of =
            |&place: &PlaceId| self.bake.place(place).map_or([0.0; 3], |(c, r)| self.settled.near_of(c, r));
        let near = sample.iter().map(near_of).collect();
        let full = anew.full_rank(near, &self.settled, self.emitter_scale);
        let lightmap = &self.bake.world.lightmap;
        let [factorisation, quantisation] =
            anew.factor_errors(lightmap, &self.bake.baked, &self.settled, self.emitter_scale);
        let abouts = ["of rays and basis", "of the rank and of columns left out", "of the chunk's numbers"];
        let measures = [Measure::AtSample(full), Measure::Rms(factorisation), Measure::Rms(quantisation)];
        let named = ERROR_CLASSES.into_iter().zip(abouts).zip(measures);
        named.map(|((name, about), measure)| ErrorClass { name, about, measure }).collect()
    }
}

/// Index in the lightmap of each receiver by cluster; errors with the first difference between world and bake.
fn same_world(manifest: &Manifest, world: &World, baked: &Baked) -> Result<Vec<Vec<u32>>, EvaluationError> {
    let (lightmap, baked_m) = (&world.lightmap, manifest.lightmap.texel_m);
    if lightmap.texel_m != baked_m {
        let what = format!("texels of {} m, not {baked_m} m", lightmap.texel_m);
        return Err(EvaluationError::OtherStage { what });
    }
    let receivers = 0..lightmap.receivers.len() as u32;
    let index_of: BTreeMap<_, u32> = receivers.map(|index| (lightmap.name_of(index), index)).collect();
    let of_cluster = |cluster| {
        let found: Option<Vec<u32>> =
            super::names(cluster).map(|name| index_of.get(&name).copied()).collect();
        let absent = || EvaluationError::OtherStage { what: "a receiver of the bundle is not there".into() };
        found.ok_or_else(absent)
    };
    baked.clusters.iter().map(of_cluster).collect()
}
