//! Objects with bakes of their own: each is lit by the bake around it, and changes its light and that of the others, bounce by bounce.

use std::ops::Range;
use std::sync::Arc;

use glam::{Affine3A, Vec3, Vec4};
use lightkiln_proto::transfer::TransferTable;
use lightkiln_proto::voxels::first_of_sky;

use super::Frame;
use super::bounces::Bounces;
use super::receivers;
use crate::bake::{LightPasses, LoadedBake, Mover, ReceiverLight, Unshadowed, emitter_radiance};
use crate::error::{ClientError, Result};
use crate::lights::Sky;
use crate::movers::{Before, Emitters, ball_of, is_open, lattice_of};
use crate::passes::around::AroundPass;
use crate::passes::change::ChangePass;
use crate::passes::gpu::Gpu;
use crate::passes::shade::ObjectShading;
use crate::passes::shadow::ShadowPass;
use crate::passes::stopwatch::{Recorder, Stopwatch};
use crate::passes::transfer::reference::Sight;
use crate::passes::transfer::{MovedPass, MoverTable, silhouette_plan};
use crate::passes::walk::WalkTable;
use crate::scene::{Recolour, Stance, Tints};

/// Objects of a bake on the adapter.
pub(super) struct Movers {
    table: MoverTable,
    each: Vec<Own>,
    /// None while the light of one bake is gone and that of another not there yet.
    pub(super) around: Option<Around>,
}

/// The bake around objects.
pub(super) struct Around {
    /// Its elements.
    pub(super) walks: Arc<WalkTable>,
    /// Bytes of λ before the sky's.
    lambda_bytes: u64,
    /// At its receivers; none of a kind without.
    statics: Option<MovedPass>,
    emitters: Emitters,
}

/// One of them.
struct Own {
    bake: Arc<LoadedBake>,
    draws: [usize; 2],
    light: Box<dyn LightPasses>,
    around: AroundPass,
    /// At its receivers, by the others and by points of emitters.
    moved: Option<MovedPass>,
    change: Option<ChangePass>,
    bounces: Bounces,
    /// Points of emitters before it.
    points: usize,
}

impl Movers {
    /// Uploads the objects of a bake whose passes are `light`; `None` where it has none.
    pub(super) fn new(
        gpu: &Gpu,
        bake: &LoadedBake,
        shadow: &ShadowPass,
        light: &mut dyn LightPasses,
        size: [u32; 2],
    ) -> Result<Option<Self>> {
        if bake.movers.is_empty() {
            return Ok(None);
        }
        let volumes = bake.movers.iter().map(|mover| Ok((volume_of(mover)?, mover.draws)));
        let volumes = volumes.collect::<Result<Vec<_>>>()?;
        let table = MoverTable::new(gpu, &volumes, bake.scene.draws.draws.len())?;
        let walks = walk_table(gpu, bake, light)?;
        if light.feedback().is_none() {
            return Err(lacking());
        }
        let mut each = Vec::new();
        for (index, (mover, (volume, draws))) in bake.movers.iter().zip(&volumes).enumerate() {
            let Mover { bake: own, .. } = mover;
            let mut light = own.light.passes(gpu, &own.scene, shadow, size)?;
            let dark = Unshadowed { sky: Sky::default(), panorama: None, emitter_scale: &[] };
            light.set_unshadowed(gpu, &own.light.unshadowed(dark));
            let emitters = emitter_radiance(&own.scene.manifest, &[]);
            let parts = own.light.voxels().map_or(0, |(_, patches)| patches.sky_parts);
            let lambda = light.lambda().ok_or_else(lacking)?;
            let around = AroundPass::new(gpu, &walks, (volume, parts), (&emitters, lambda), (&table, index))?;
            light.make_around(gpu, &around, own.light.sky_rows().ok_or_else(lacking)?)?;
            light.make_moved(gpu)?;
            let moved = light.moved().map(|at| MovedPass::new(gpu, shadow, &table, at, Some(index)));
            let change = light.feedback().map(|feedback| ChangePass::new(gpu, feedback)).transpose()?;
            let (bake, draws, bounces) = (own.clone(), *draws, Bounces::default());
            each.push(Own { bake, draws, light, around, moved, change, bounces, points: 0 });
        }
        let mut movers = Self { table, each, around: None };
        movers.around = Some(movers.around(gpu, (bake, walks), shadow, light)?);
        Ok(Some(movers))
    }

    /// Lets objects change the light of a bake's passes, whose elements are `walks`.
    fn around(
        &self,
        gpu: &Gpu,
        (bake, walks): (&LoadedBake, Arc<WalkTable>),
        shadow: &ShadowPass,
        light: &mut dyn LightPasses,
    ) -> Result<Around> {
        light.make_moved(gpu)?;
        let statics = light.moved().map(|at| MovedPass::new(gpu, shadow, &self.table, at, None));
        let entries = bake.light.voxels().map_or(0, |(_, patches)| first_of_sky(patches));
        let emitters = Emitters::of(&bake.scene);
        Ok(Around { walks, lambda_bytes: (entries * size_of::<Vec4>()) as u64, statics, emitters })
    }

    /// Makes what is of other light of the bake around, for [`Movers::around`].
    pub(super) fn around_of(
        &self,
        gpu: &Gpu,
        bake: &LoadedBake,
        shadow: &ShadowPass,
        light: &mut dyn LightPasses,
    ) -> Result<Around> {
        let walks = walk_table(gpu, bake, light)?;
        self.around(gpu, (bake, walks), shadow, light)
    }

    /// Writes where objects of a bake stand, under such scales of its emitters.
    pub(super) fn set_places(
        &mut self,
        gpu: &Gpu,
        shadow: &ShadowPass,
        bake: &LoadedBake,
        (stances, emitter_scale): (&[Stance], &[f32]),
    ) -> Result<()> {
        let places: Vec<Affine3A> =
            bake.movers.iter().map(|mover| mover.world_from_object(stances)).collect();
        let (mut plans, mut before) = (Vec::new(), Vec::new());
        for (index, (own, place)) in self.each.iter_mut().zip(&places).enumerate() {
            let Some(volume) = own.bake.light.volume() else { continue };
            let middle_m = place.transform_point3(volume.middle_m());
            plans.push(Sight::plan(&bake.scene, middle_m)?);
            let lattice = lattice_of(volume, place);
            let is_open = |at_m: Vec3| {
                let voxels = bake.light.voxels();
                voxels.is_some_and(|(voxels, _)| is_open(voxels, middle_m, place.transform_point3(at_m)))
            };
            let emitters = self.around.as_ref().map(|around| &around.emitters);
            let of_emitters = emitters.map(|emitters| emitters.before(bake, emitter_scale, (volume, place)));
            let Before { points, shares } = of_emitters.unwrap_or_default();
            let plan = silhouette_plan(&points, ball_of(volume, place), bake.scene.manifest.bounds_m);
            shadow.set_silhouettes(gpu, index, &plan.faces);
            own.points = points.len();
            before.push(points);
            own.around.set(gpu, place, (&lattice, is_open), &shares);
            own.light.set_place(gpu, place);
            if let Some(moved) = &own.moved {
                moved.set_place(gpu, place);
            }
        }
        let each = places.into_iter().zip(before.iter().map(Vec::as_slice));
        self.table.set(gpu, each, shadow.sight_places());
        shadow.set_sights(gpu, plans.iter());
        Ok(())
    }

    /// Gives materials of objects other colours, those that they have.
    pub(super) fn set_materials(&self, gpu: &Gpu, colours: &[Recolour]) -> Result<()> {
        for own in &self.each {
            let scene = &own.bake.scene;
            if let Some(albedo) = own.bake.light.tinted_albedo(scene, &Tints::of_named(scene, colours)?) {
                own.light.set_albedo(gpu, &albedo);
            }
        }
        Ok(())
    }

    /// Objects.
    pub(super) fn len(&self) -> usize {
        self.each.len()
    }

    /// Meshes of each, and how many points of emitters see it.
    pub(super) fn drawn(&self) -> Vec<(Range<usize>, usize)> {
        self.each.iter().map(|own| (own.draws[0]..own.draws[1], own.points)).collect()
    }

    /// Records the work that a change of lights asks for, with new shadow maps.
    pub(super) fn relit(&self, encoder: &mut Recorder<'_>, shadow: &ShadowPass) {
        self.each.iter().for_each(|own| own.light.relit(encoder, shadow));
    }

    /// Lets all be black that the next bounce begins with: E_ind of objects, and λ of the bake around but for the sky.
    pub(super) fn clear(&self, encoder: &mut Recorder<'_>, light: &dyn LightPasses) {
        if let (Some(lambda), Some(around)) = (light.lambda(), &self.around) {
            encoder.clear_buffer(lambda, 0, Some(around.lambda_bytes));
        }
        encoder.clear_buffer(&self.table.part_light, self.table.bytes_before_light(), None);
        for (e_ind, _) in self.each.iter().filter_map(|own| own.light.feedback()) {
            encoder.clear_buffer(e_ind, 0, None);
        }
    }

    /// A bounce of each object, in light as the bake around had it, and what they change of that.
    pub(super) fn bounce(&self, encoder: &mut Recorder<'_>, shadow: &ShadowPass) {
        let Some(around) = &self.around else { return };
        for own in &self.each {
            own.around.look(encoder, &around.walks);
            own.light.light_around(encoder);
        }
        for moved in self.each.iter().filter_map(|own| own.moved.as_ref()) {
            moved.record(&mut encoder.compute("light by objects"), shadow);
        }
        for own in &self.each {
            own.light.bounce(encoder);
            own.around.light_parts(encoder);
        }
        if let Some(statics) = &around.statics {
            statics.record(&mut encoder.compute("light by objects"), shadow);
        }
    }

    /// Asks for the change of E_ind of each object by the bounce that was recorded last, the first of other light where `is_first`.
    pub(super) fn ask(&mut self, gpu: &Gpu, watch: &mut Stopwatch, is_first: bool) {
        for own in &mut self.each {
            if is_first {
                own.bounces = Bounces::default();
            }
            if let Some(change) = &mut own.change {
                own.bounces.add(change.ask(gpu, watch));
            }
        }
    }

    /// Takes the answers that are there, or waits for them; whether light is no number.
    pub(super) fn hear(&mut self, gpu: &Gpu, waits: bool) -> Result<bool> {
        let mut is_none = false;
        for own in &mut self.each {
            let Some(change) = &mut own.change else { continue };
            for answer in change.answers(gpu, waits)? {
                is_none |= !answer.change.is_finite();
                own.bounces.hear(answer, 1);
            }
        }
        Ok(is_none)
    }

    /// The largest change of an object's E_ind that was heard of; `None` while one has not been heard of.
    pub(super) fn change(&self) -> Option<f32> {
        self.each.iter().try_fold(0.0_f32, |most, own| Some(most.max(own.bounces.change(1)?)))
    }

    /// Records the step from the bounces' result to the bindings of shading.
    pub(super) fn publish(&self, encoder: &mut Recorder<'_>) {
        self.each.iter().for_each(|own| own.light.publish(encoder));
    }

    /// Light at receivers of each as of the last [`Movers::publish`], after a wait.
    pub(super) fn read(&self, gpu: &Gpu) -> Result<Vec<ReceiverLight>> {
        self.each.iter().map(|own| Ok(receivers::read(gpu, &*own.light)?.unwrap_or_default())).collect()
    }

    /// How they are shaded.
    pub(super) fn shading(&self) -> Option<ObjectShading<'_>> {
        let shading = self.each.first()?.bake.light.shading();
        let each = self.each.iter().map(|own| (own.draws, own.light.bindings())).collect();
        Some(ObjectShading { table: &self.table, shading, each })
    }
}

impl Frame<'_> {
    /// Writes where objects with bakes of their own stand, and what they see.
    pub(super) fn place_movers(&mut self) -> Result<()> {
        if let Some(movers) = &mut self.movers {
            let light = (&self.stances[..], &self.emitter_scale[..]);
            movers.set_places(&self.gpu, &self.shadow, &self.bake, light)?;
            self.stale.sights = true;
        }
        Ok(())
    }
}

fn volume_of(mover: &Mover) -> Result<&TransferTable> {
    mover.bake.light.volume().ok_or_else(lacking)
}

fn lacking() -> ClientError {
    ClientError::Adapter { problem: "an object lacks what its light is made of".to_owned() }
}

/// Elements of a bake, which have their radiance in λ of its passes.
fn walk_table(gpu: &Gpu, bake: &LoadedBake, light: &dyn LightPasses) -> Result<Arc<WalkTable>> {
    let elements = bake.light.voxels().zip(light.lambda());
    let (elements, lambda) = elements.ok_or_else(|| ClientError::Adapter {
        problem: "objects with bakes of their own are lit by voxels of the bake around them, which has none"
            .to_owned(),
    })?;
    Ok(Arc::new(WalkTable::new(gpu, elements, lambda)?))
}
