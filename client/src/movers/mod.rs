//! A bake with objects that have bakes of their own, on the processor: each is lit by the bake around it, and changes the light of the bake and
//! of the others, until nothing changes any more (METHOD.md §2.17).

mod emitters;

use std::sync::Arc;

use glam::{Affine3A, Vec3, Vec4};
use lightkiln_proto::relight::Limit;
use lightkiln_proto::transfer::{
    Hidden, PartRadiance, Standing, Surroundings, TransferTable, ViewpointLattice, Viewpoints,
};
use lightkiln_proto::voxels::{Start, VoxelTable, walk_within};
use rayon::prelude::*;

use crate::bake::{
    Among, LitScene, LoadedBake, Mover, ReceiverLight, SettledLight, SettledReceivers, Unshadowed,
};
use crate::error::Result;
use crate::passes::shade::{IndirectIrradiance, ShadeView, Surface};
use crate::passes::transfer::reference::{Effect, Sight, change};
use crate::passes::transfer::{Silhouettes, silhouette_plan};
use crate::scene::Stance;

pub(crate) use emitters::{Before, Emitters};

/// Times that light goes to and fro between a bake and its objects, at most: each brings a share of an object's albedo times that of its
/// surroundings times what it fills of their view.
const ROUNDS_MAX: usize = 6;
/// Change of ΔE by a round, as a share of it, that ends them: bounces end sooner than they would tell less apart.
const CHANGE_MAX: f64 = 5e-3;

/// Objects of a bake where they stand.
pub struct Standings<'a> {
    bake: &'a LoadedBake,
    placed: Vec<Placed<'a>>,
}

/// One of them.
struct Placed<'a> {
    mover: &'a Mover,
    volume: &'a TransferTable,
    world_from_object: Affine3A,
    sight: Sight,
    silhouettes: Silhouettes,
    /// Of each emitter of the bake the share for which those stand.
    shares: Vec<f32>,
}

/// Light of an object.
struct Lit<'a> {
    indirect: Box<dyn IndirectIrradiance + 'a>,
    /// Radiance that each part hides, by level and part.
    hidden: Arc<Vec<Vec<Hidden>>>,
    /// By level and part.
    radiance: Arc<PartRadiance>,
}

impl<'a> Standings<'a> {
    /// Where stances have them, under such scales of the bake's emitters.
    pub fn new(bake: &'a LoadedBake, stances: &[Stance], emitter_scale: &[f32]) -> Result<Self> {
        let emitters = if bake.movers.is_empty() { Emitters::default() } else { Emitters::of(&bake.scene) };
        let placed = bake.movers.iter().filter_map(|mover| Some((mover, mover.bake.light.volume()?)));
        let placed = placed.map(|(mover, volume)| {
            let world_from_object = mover.world_from_object(stances);
            let sight = Sight::from(&bake.scene, world_from_object.transform_point3(volume.middle_m()))?;
            let Before { points, shares } =
                emitters.before(bake, emitter_scale, (volume, &world_from_object));
            let ball = ball_of(volume, &world_from_object);
            let plan = silhouette_plan(&points, ball, bake.scene.manifest.bounds_m);
            let silhouettes = Silhouettes::new(points, plan, (&mover.bake.scene, &world_from_object));
            Ok(Placed { mover, volume, world_from_object, sight, silhouettes, shares })
        });
        Ok(Self { bake, placed: placed.collect::<Result<_>>()? })
    }

    /// Light after the last bounce of all.
    pub fn settle(&'a self, lit: &LitScene<'a>, limit: Limit) -> SettledLight<'a> {
        let (settled, moved) = self.balanced(lit, limit);
        let placed = &self.placed;
        if placed.is_empty() {
            return settled;
        }
        let lights = self.light_objects(lit, &settled, &moved, limit);
        let effects = effects(placed, &lights);
        let lights = lights.into_iter().map(|light| light.indirect).collect();
        let indirect = Box::new(WithObjects { indirect: settled.indirect, placed, lights, effects });
        SettledLight { indirect, ..settled }
    }

    /// Light at the bake's own receivers and at those of its objects, E_ind with what objects give and take; `None` for a kind without receivers.
    pub fn at_receivers(
        &'a self,
        lit: &LitScene<'a>,
        limit: Limit,
    ) -> Option<(SettledReceivers, Vec<ReceiverLight>)> {
        let light = &self.bake.light;
        if self.placed.is_empty() {
            return Some((light.at_receivers(lit, &Among::default(), limit)?, Vec::new()));
        }
        let (settled, moved) = self.balanced(lit, limit);
        let mut found = light.at_receivers(lit, &moved.among(), limit)?;
        found.light.add_moved(&moved.statics);
        let of_object = |placed: &Placed<'_>, own: &LitScene<'_>, among: &Among<'_>, _: &Viewpoints| {
            let found = placed.mover.bake.light.at_receivers(own, among, limit);
            let mut light = found.map(|found| found.light).unwrap_or_default();
            light.add_moved(among.moved.unwrap_or_default());
            light
        };
        let objects = self.of_objects(lit, &settled, &moved, of_object);
        Some((SettledReceivers { converged: settled.converged, ..found }, objects))
    }

    /// Light of the bake, without what objects add at its pixels, and that, after as many rounds as change it.
    fn balanced(&'a self, lit: &LitScene<'a>, limit: Limit) -> (SettledLight<'a>, Moved) {
        let mut moved = Moved { statics: Vec::new(), objects: self.given() };
        let mut settled = self.bake.light.settle(lit, &moved.among(), limit);
        if self.placed.is_empty() {
            return (settled, moved);
        }
        for round in 1..=ROUNDS_MAX {
            let lights = self.light_objects(lit, &settled, &moved, limit);
            let next = self.moved(&effects(&self.placed, &lights));
            let change = next.change_from(&moved);
            moved = next;
            settled = self.bake.light.settle(lit, &moved.among(), limit);
            if change < CHANGE_MAX {
                break;
            }
            settled.converged &= round < ROUNDS_MAX;
        }
        (settled, moved)
    }

    /// Each object in the light around it.
    fn light_objects(
        &'a self,
        lit: &LitScene<'a>,
        settled: &SettledLight<'_>,
        moved: &Moved,
        limit: Limit,
    ) -> Vec<Lit<'a>> {
        let of = |placed: &'a Placed<'a>, own: &LitScene<'a>, among: &Among<'_>, viewpoints: &Viewpoints| {
            let Placed { mover, volume, .. } = placed;
            let settled = mover.bake.light.settle(own, among, limit);
            let radiance =
                settled.walks.as_ref().map(|walks| volume.radiance(&walks.lambda, &walks.emitters));
            let radiance = Arc::new(radiance.unwrap_or_default());
            let hidden = Arc::new(volume.hidden(viewpoints));
            Lit { indirect: settled.indirect, hidden, radiance }
        };
        self.of_objects(lit, settled, moved, of)
    }

    /// Calls for each object with its scene under the lights, with where it stands and what comes to it, and with its viewpoints.
    fn of_objects<T>(
        &'a self,
        lit: &LitScene<'a>,
        settled: &SettledLight<'_>,
        moved: &Moved,
        call: impl Fn(&'a Placed<'a>, &LitScene<'a>, &Among<'_>, &Viewpoints) -> T,
    ) -> Vec<T> {
        let of = |(index, placed): (usize, &'a Placed<'a>)| {
            let Placed { mover, volume, world_from_object, shares, .. } = placed;
            let walked = settled.walks.as_ref().map(|walks| walks.light_without(shares));
            let among = Among { world_from_scene: *world_from_object, ..Among::default() };
            let parts = mover.bake.light.voxels().map_or(0, |(_, patches)| patches.sky_parts);
            let viewpoints = Viewpoints::new(lattice_of(volume, world_from_object), |from_m| {
                let light = walked.as_ref()?;
                let [middle_m, from_m] =
                    [volume.middle_m(), from_m].map(|at_m| world_from_object.transform_point3(at_m));
                is_open(light.table(), middle_m, from_m)
                    .then(|| Surroundings::walked(light, from_m, among.turn(), parts))
                    .flatten()
            });
            let around = around_of(&mover.bake, &viewpoints);
            let own = moved.objects.get(index).map(Vec::as_slice);
            let unshadowed = Unshadowed { emitter_scale: &[], panorama: None, ..lit.unshadowed };
            let of_object = LitScene { scene: &mover.bake.scene, unshadowed, lod: None, ..*lit };
            let among = Among { around: Some(&around), moved: own, ..among };
            call(placed, &of_object, &among, &viewpoints)
        };
        self.placed.iter().enumerate().map(of).collect()
    }

    /// Irradiance of points of emitters at the receivers of each object by slot, W·m⁻².
    fn given(&self) -> Vec<Vec<Vec4>> {
        let of_object = |placed: &Placed<'_>| {
            let given = |at_m, normal| placed.silhouettes.given(at_m, normal, normal);
            at_receivers(&placed.mover.bake, placed.world_from_object, given)
        };
        self.placed.iter().map(of_object).collect()
    }

    /// `Σ v ΔE` at the receivers of the bake and of the objects, and what points of emitters give to these.
    fn moved(&self, effects: &[Effect<'_>]) -> Moved {
        let at = |bake: &LoadedBake, but: Option<usize>, place: Affine3A| {
            at_receivers(bake, place, |at_m, normal| change(effects, but, at_m, normal, normal))
        };
        let of_object = |(index, placed): (usize, &Placed<'_>)| {
            at(&placed.mover.bake, Some(index), placed.world_from_object)
        };
        Moved {
            statics: at(self.bake, None, Affine3A::IDENTITY),
            objects: self.placed.iter().enumerate().map(of_object).collect(),
        }
    }
}

/// Some irradiance at a bake's receivers by slot, of its place there: from position and normal.
fn at_receivers(bake: &LoadedBake, place: Affine3A, of: impl Fn(Vec3, Vec3) -> Vec3 + Sync) -> Vec<Vec4> {
    let turn = Among { world_from_scene: place, ..Among::default() }.turn();
    let Some(lightmap) = bake.light.lightmap(&bake.scene) else { return Vec::new() };
    let receivers = lightmap.receivers.position_m.par_iter().zip(&lightmap.receivers.normal);
    let at = |(at_m, normal): (&Vec4, &Vec4)| {
        of(place.transform_point3(at_m.truncate()), turn * normal.truncate()).extend(0.0)
    };
    receivers.map(at).collect()
}

/// Irradiance at an object's receivers by slot of what its viewpoints see, each receiver's by its place among them, W·m⁻².
fn around_of(bake: &LoadedBake, viewpoints: &Viewpoints) -> Vec<Vec4> {
    let map = bake.light.lightmap(&bake.scene).zip(bake.light.sky_rows());
    let Some((lightmap, rows)) = map else { return Vec::new() };
    let receivers = lightmap.receivers.position_m.par_iter().enumerate();
    let of_slot = |(slot, at_m): (usize, &Vec4)| {
        let weights = viewpoints.weights(at_m.truncate());
        let of = |(seen, weight): (&Option<Surroundings>, f32)| {
            let seen = seen.as_ref().filter(|_| weight > 0.0)?;
            let parts = rows.row(slot).iter().zip(seen.radiance());
            Some(weight * parts.map(|(share, radiance)| *share * *radiance).sum::<Vec4>())
        };
        viewpoints.seen().iter().zip(weights).filter_map(of).sum::<Vec4>().max(Vec4::ZERO)
    };
    receivers.map(of_slot).collect()
}

/// Viewpoints of an object where it stands.
pub(crate) fn lattice_of(volume: &TransferTable, world_from_object: &Affine3A) -> ViewpointLattice {
    ViewpointLattice::new(volume.box_m(), world_from_object.matrix3.x_axis.length())
}

/// Middle and radius of the ball around an object's bounds where it stands.
pub(crate) fn ball_of(volume: &TransferTable, world_from_object: &Affine3A) -> (Vec3, f32) {
    let [low, high] = volume.box_m().map(Vec3::from);
    let scale = world_from_object.matrix3.x_axis.length();
    (world_from_object.transform_point3(volume.middle_m()), 0.5 * scale * (high - low).length())
}

/// Nothing of the bake stands between two points, or the first lies in something.
pub(crate) fn is_open(voxels: &VoxelTable, from_m: Vec3, to_m: Vec3) -> bool {
    let way_m = to_m - from_m;
    let Some(direction) = way_m.try_normalize() else { return true };
    walk_within(voxels, &Start::free(from_m), direction, 0.0, way_m.length()).is_none_or(|hit| hit.is_back)
}

fn effects<'b>(placed: &'b [Placed<'_>], lights: &[Lit<'_>]) -> Vec<Effect<'b>> {
    let of = |(placed, light): (&'b Placed<'_>, &Lit<'_>)| {
        let Placed { volume, world_from_object, sight, silhouettes, .. } = placed;
        let (radiance, hidden) = (light.radiance.clone(), light.hidden.clone());
        Effect { standing: Standing::new(volume, *world_from_object, radiance, hidden), sight, silhouettes }
    };
    placed.iter().zip(lights).map(of).collect()
}

/// `Σ v ΔE` by slot, W·m⁻².
#[derive(Clone, Debug, Default)]
struct Moved {
    /// Of the bake.
    statics: Vec<Vec4>,
    /// Of each object, by the others.
    objects: Vec<Vec<Vec4>>,
}

impl Moved {
    /// The bake with it.
    fn among(&self) -> Among<'_> {
        Among { moved: (!self.statics.is_empty()).then_some(&self.statics), ..Among::default() }
    }

    /// Relative change.
    fn change_from(&self, before: &Self) -> f64 {
        if before.statics.len() != self.statics.len() {
            return f64::INFINITY;
        }
        let (mut difference, mut total) = (0.0, 0.0);
        let all = self.statics.iter().chain(self.objects.iter().flatten());
        for (now, before) in all.zip(before.statics.iter().chain(before.objects.iter().flatten())) {
            difference += f64::from((*now - *before).abs().element_sum());
            total += f64::from(now.abs().element_sum());
        }
        if total > 0.0 { difference / total } else { difference }
    }
}

/// Light of a bake and of the objects in it.
struct WithObjects<'a> {
    indirect: Box<dyn IndirectIrradiance + 'a>,
    placed: &'a [Placed<'a>],
    /// Of each object.
    lights: Vec<Box<dyn IndirectIrradiance + 'a>>,
    effects: Vec<Effect<'a>>,
}

impl IndirectIrradiance for WithObjects<'_> {
    fn prepare_view(&mut self, view: &ShadeView, size: [u32; 2]) {
        self.indirect.prepare_view(view, size);
        self.lights.iter_mut().for_each(|light| light.prepare_view(view, size));
    }

    fn indirect_irradiance(&self, surface: &Surface) -> Vec3 {
        let draw = surface.draw as usize;
        let own = self.placed.iter().position(|placed| {
            let [first, end] = placed.mover.draws;
            (first..end).contains(&draw)
        });
        let light = match own {
            None => self.indirect.indirect_irradiance(surface),
            Some(index) => {
                let first = self.placed[index].mover.draws[0] as u32;
                let of_object = Surface { draw: surface.draw - first, ..*surface };
                self.lights[index].indirect_irradiance(&of_object)
            }
        };
        let moved = change(&self.effects, own, surface.position, surface.towards, surface.facet);
        (light + moved).max(Vec3::ZERO)
    }

    fn mean_radiance(&self, point: Vec3) -> Vec3 {
        self.indirect.mean_radiance(point)
    }
}
