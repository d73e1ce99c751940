//! A bake of factorised clusters as evaluation sees it.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use glam::{DVec3, Vec2};
use lightkiln_proto::content::{BlockKey, Texel};
use lightkiln_proto::manifest::Manifest;
use lightkiln_proto::relight::{Columns, Inconsistent, LightmapTexels, SlotTable, Transport, WalkedTable};

use super::anew::{Anew, wide};
use super::baked::{Baked, Light};
use super::{ClusterCell, cells_of_task};
use crate::emitters::emitter_of_material;
use crate::evaluate::{
    Answer, ChunkBytes, ErrorClass, Evaluated, EvaluatedLightmap, EvaluationError, MappedIncoming, Measure,
    Place, Relit,
};
use crate::geometry::{Geometry, Site};
use crate::lightmap::{Surface, World};
use crate::rays::Hit;
use crate::reference::{Lighting, Reference};
use crate::task::{Cancelled, Context, Progress};

/// Points over rectangles that give E_dir at every receiver of the bake.
const RECT_POINTS: u32 = 64;

/// Names of the classes of error, in the order of [`Relit::classes`].
pub const ERROR_CLASSES: [&str; 3] = ["transport", "factorisation", "quantisation"];

/// A decoded bake in its world, made anew.
pub struct FactoredBake<C> {
    world: Arc<World>,
    transport: Box<dyn super::Transport>,
    baked: Baked<C>,
    cells: Vec<ClusterCell>,
    /// Index in the lightmap of the receiver at each slot.
    receiver_of: Vec<u32>,
    anew: Option<Anew>,
    /// Light of the lightings that were asked for.
    known: Mutex<Vec<(Lighting, Arc<Light>)>>,
    by_walks: Option<ByWalks<C>>,
}

/// Makes of a bake the same with E_ind by walks.
pub type ByWalks<C> = Box<dyn FnOnce(FactoredBake<C>) -> Box<dyn Evaluated> + Send + Sync>;

impl<C: Columns> FactoredBake<C> {
    /// Decodes a bake's clusters and finds their receivers in the world that `context` has, that of its transport tasks.
    ///
    /// Errors when the world is not the one that was baked.
    pub fn new(
        manifest: &Manifest,
        bytes: ChunkBytes,
        context: &Context,
        transport: Box<dyn super::Transport>,
        columns: impl FnOnce(&SlotTable) -> Result<C, Inconsistent>,
    ) -> Result<Self, EvaluationError> {
        let world = World::of(context).map_err(EvaluationError::Prepare)?;
        let cells = cells_of_task(context).map_err(EvaluationError::Prepare)?.as_ref().clone();
        let baked = Baked::decode(manifest, bytes, columns)?;
        let receiver_of = same_world(manifest, &world, &baked)?;
        let known = Mutex::default();
        Ok(Self { world, transport, baked, cells, receiver_of, anew: None, known, by_walks: None })
    }

    /// The bake, which can be walked.
    #[must_use]
    pub fn walkable(mut self, by_walks: ByWalks<C>) -> Self {
        self.by_walks = Some(by_walks);
        self
    }

    /// Gives receivers the light of walks.
    pub fn walk(
        &mut self,
        walked: impl FnOnce(&Transport<C>) -> Result<WalkedTable, Inconsistent>,
    ) -> Result<(), EvaluationError> {
        self.baked.transport.walked = walked(&self.baked.transport)?;
        Ok(())
    }

    /// The world that it was made anew in.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The clusters' columns.
    pub fn columns(&self) -> &C {
        &self.baked.transport.columns
    }

    fn texels(&self) -> LightmapTexels<'_> {
        let Transport { slots, receivers, .. } = &self.baked.transport;
        LightmapTexels { slots, receivers }
    }

    /// A receiver as a place.
    fn place(&self, receiver: u32) -> Place {
        Place { site: self.world.lightmap.receivers[receiver as usize].site(), number: Some(receiver) }
    }

    /// Slot of a place's receiver; `None` for those that no light can reach.
    pub fn slot(&self, place: &Place) -> Option<u32> {
        let (block, texel) = self.world.lightmap.name_of(receiver_of(place));
        self.baked.transport.slots.slot_of(block, texel)
    }

    /// The bake relit until bounces converge, E_dir by exact rays; or what that gave last time.
    pub fn lit(
        &self,
        reference: &Reference,
        lighting: &Lighting,
        progress: &Progress,
    ) -> Result<Arc<Light>, Cancelled> {
        let known = || self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, light)) = known().iter().find(|(other, _)| other == lighting) {
            return Ok(Arc::clone(light));
        }
        let light = Arc::new(self.lit_anew(reference, lighting, progress)?);
        known().push((lighting.clone(), Arc::clone(&light)));
        Ok(light)
    }

    /// The bake relit until bounces converge, E_dir by exact rays.
    fn lit_anew(
        &self,
        reference: &Reference,
        lighting: &Lighting,
        progress: &Progress,
    ) -> Result<Light, Cancelled> {
        let site = |slot: u32| self.place(self.receiver_of[slot as usize]).site;
        let sites = |slot: u32| self.world.lit_points_of(self.receiver_of[slot as usize]);
        self.baked.lit(lighting, sites, site, |sites| {
            progress.check()?;
            let rect_points = RECT_POINTS.div_ceil(sites.len() as u32);
            let sum: DVec3 = sites.iter().map(|site| reference.direct_irradiance(site, rect_points)).sum();
            Ok(sum / sites.len() as f64)
        })
    }
}

impl<C: Columns> Evaluated for FactoredBake<C> {
    fn geometry(&self) -> &Geometry {
        &self.world.geometry
    }

    fn answer_at(&self, hit: &Hit) -> Answer {
        match self.world.surface_at(hit) {
            Surface::Receiver(receiver) => Answer::Place(self.place(receiver)),
            Surface::Dark if self.world.is_in_cavity(hit) => Answer::Cavity,
            Surface::Dark => Answer::TooSmall,
        }
    }

    fn lightmap(&self) -> Option<&dyn EvaluatedLightmap> {
        Some(self)
    }

    fn by_walks(mut self: Box<Self>) -> Option<Box<dyn Evaluated>> {
        let by_walks = self.by_walks.take()?;
        Some(by_walks(*self))
    }

    fn chunk_of(&self, place: &Place) -> Option<usize> {
        self.slot(place).map(|slot| self.baked.cluster_of(slot))
    }

    fn points_of(&self, place: &Place) -> Vec<Site> {
        self.world.gathering_points_of(receiver_of(place))
    }

    fn trace(&mut self, sample: &[Place], effort: usize, progress: &Progress) -> Result<(), Cancelled> {
        // Light of walks is of no rows that could be made anew.
        if !self.baked.transport.walked.is_empty() {
            return Ok(());
        }
        let receivers: Vec<u32> = sample.iter().map(receiver_of).collect();
        self.anew = Some(Anew::trace(self.transport.as_ref(), &self.cells, &receivers, effort, progress)?);
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
        Ok(Box::new(RelitBake { bake: self, light: self.lit(reference, lighting, progress)? }))
    }

    fn relit_by_maps<'a>(
        &'a self,
        lighting: &Lighting,
        direct: &MappedIncoming,
    ) -> Option<Box<dyn Relit + 'a>> {
        let Transport { receivers, near, .. } = &self.baked.transport;
        if [direct.receivers.len(), direct.near.len()] != [receivers.len(), near.len()] {
            return None;
        }
        let light = Arc::new(self.baked.settled(lighting, &direct.receivers, &direct.near));
        Some(Box::new(RelitBake { bake: self, light }))
    }
}

impl<C: Columns> EvaluatedLightmap for FactoredBake<C> {
    fn texel_m(&self) -> f32 {
        self.world.lightmap.texel_m
    }

    fn receivers(&self) -> u32 {
        self.receiver_of.len() as u32
    }

    fn receiver(&self, index: u32) -> Place {
        self.place(self.receiver_of[index as usize])
    }

    fn linked(&self, index: u32, offset: [i32; 2]) -> Option<u32> {
        let (block, texel) = self.world.lightmap.name_of(self.receiver_of[index as usize]);
        let Transport { slots, .. } = &self.baked.transport;
        self.texels().linked(slots.block_index(block)?, texel, offset)
    }

    fn block_name(&self, block: BlockKey) -> &str {
        let found = self.world.lightmap.blocks.iter().find(|other| other.key == block);
        found.map_or("", |block| &block.name)
    }

    fn texel_of(&self, place: &Place) -> Option<(BlockKey, Texel)> {
        Some(self.world.lightmap.name_of(receiver_of(place)))
    }

    fn place_of(&self, block: BlockKey, texel: Texel) -> Option<Place> {
        let slot = self.baked.transport.slots.slot_of(block, texel)?;
        Some(self.place(self.receiver_of[slot as usize]))
    }

    fn texel_at(&self, hit: &Hit) -> Option<(BlockKey, Vec2)> {
        self.world.lightmap_at(hit)
    }
}

/// The receiver of a place of a bake of clusters, whose every place has one.
fn receiver_of(place: &Place) -> u32 {
    place.number.expect("the place is one of this bake's, which all have numbers")
}

/// A bake under some lights.
struct RelitBake<'a, C> {
    bake: &'a FactoredBake<C>,
    light: Arc<Light>,
}

impl<C: Columns> Relit for RelitBake<'_, C> {
    fn irradiance(&self, place: &Place) -> Option<DVec3> {
        self.bake.slot(place).map(|slot| wide(self.light.settled.indirect(slot)))
    }

    fn shown_at(&self, hit: &Hit) -> Option<DVec3> {
        let (block, texel) = self.bake.world.lightmap_at(hit)?;
        let block = self.bake.baked.transport.slots.block_index(block)?;
        let light = |slot: u32| self.light.settled.indirect(slot);
        self.bake.texels().shown(block, texel.to_array(), light).map(wide)
    }

    fn bounces(&self) -> (usize, bool) {
        (self.light.settled.bounces as usize, self.light.settled.converged)
    }

    fn classes(&self, sample: &[Place]) -> Vec<ErrorClass> {
        let Some(anew) = &self.bake.anew else { return Vec::new() };
        let slots: Vec<Option<u32>> = sample.iter().map(|place| self.bake.slot(place)).collect();
        let full = anew.full_rank(&slots, &self.bake.baked, &self.light);
        let lightmap = &self.bake.world.lightmap;
        let [factorisation, quantisation] = anew.factor_errors(lightmap, &self.bake.baked, &self.light);
        let class = |which: usize, about, measure| ErrorClass { name: ERROR_CLASSES[which], about, measure };
        vec![
            class(0, "of rays and basis", Measure::AtSample(full)),
            class(1, "of the rank and of columns left out", Measure::Rms(factorisation)),
            class(2, "of the chunk's numbers", Measure::Rms(quantisation)),
        ]
    }
}

/// Index in the lightmap of the receiver at each slot; errors with the first difference between world and bake.
fn same_world<C>(manifest: &Manifest, world: &World, baked: &Baked<C>) -> Result<Vec<u32>, EvaluationError> {
    let (lightmap, baked_m) = (&world.lightmap, manifest.layout()?.texel_m);
    let other = |what: String| EvaluationError::OtherStage { what };
    let emitters = emitter_of_material(&world.geometry.scene).iter().flatten().count();
    if emitters != manifest.emitters.len() {
        return Err(other(format!("{emitters} emissive materials, not {}", manifest.emitters.len())));
    }
    if lightmap.texel_m != baked_m {
        return Err(other(format!("texels of {} m, not {baked_m} m", lightmap.texel_m)));
    }
    let slots = &baked.transport.slots;
    let mut receiver_of = BTreeMap::new();
    for receiver in 0..lightmap.receivers.len() as u32 {
        let (block, texel) = lightmap.name_of(receiver);
        receiver_of.extend(slots.slot_of(block, texel).map(|slot| (slot, receiver)));
    }
    let found = (0..baked.transport.receivers.len() as u32).map(|slot| receiver_of.get(&slot).copied());
    found.collect::<Option<_>>().ok_or_else(|| other("a receiver of the bundle is not there".into()))
}
