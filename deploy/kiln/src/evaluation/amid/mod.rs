//! An object amid a bake, held against paths traced with it in place: error of indirect light near it, everywhere and on itself, beside the same
//! where indirect light ignores it, and beside the bake alone.

mod picture;
mod sites;

use std::sync::Arc;

use glam::{DVec3, Vec3};
use lightkiln_client::bake::{Beside, LoadedBake, ReceiverLight};
use lightkiln_client::preview::{Backend, light_receivers_among};
use lightkiln_client::scene::{Stance, world_from_object};
use lightkiln_worker::evaluate::{Draw, Figures, Pair, TestLight};
use lightkiln_worker::geometry::{Geometry, Site};
use lightkiln_worker::reference::{IrradianceEstimate, Precision, Reference};
use lightkiln_worker::scene::model::Scene;
use lightkiln_worker::task::Progress;
use serde::Serialize;

use crate::failure::{Exit, Failure, Result};

pub use picture::{Strip, camera_towards};
pub use sites::{Counts, Sites};

/// Radii of an object within which its surroundings are near.
pub const NEAR_RADII: f32 = 3.0;
/// Most paths of a place.
const PATHS_MAX: u32 = 1 << 15;

/// A bake, an object with a bake of its own, and the scenes of both, which paths are traced in.
pub struct Amid {
    with_object: LoadedBake,
    /// With the object's meshes alone, which indirect light ignores.
    ignored: LoadedBake,
    empty: LoadedBake,
    of_object: Arc<LoadedBake>,
    object: Scene,
    alone: Geometry,
}

/// The object at a place.
pub struct Posed<'a> {
    amid: &'a Amid,
    stance: Stance,
    together: Geometry,
    middle_m: Vec3,
    radius_m: f32,
    /// Where it is measured.
    pub sites: Sites,
}

/// Figures of some places.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Judged {
    /// The figures.
    #[serde(flatten)]
    pub figures: Figures,
    /// Those of draws of the places.
    #[serde(skip)]
    pub draws: Vec<Draw>,
}

/// Errors of E_ind under one light, over the mean of the reference at the same places.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct AmidLight {
    /// Near the object.
    pub near: Judged,
    /// The same where indirect light ignores it.
    pub near_ignored: Judged,
    /// Of the bake without the object, against paths without it, at the same places.
    pub near_alone: Judged,
    /// At all receivers, near the object and elsewhere.
    pub all: Judged,
    /// The same where indirect light ignores it.
    pub all_ignored: Judged,
    /// On the object's own surface, but where it touches others.
    pub own: Judged,
}

impl Judged {
    fn of<'a>(places: impl Iterator<Item = (f64, DVec3, &'a IrradianceEstimate)>) -> Self {
        let pair = |(area_m2, found, reference): (f64, DVec3, &IrradianceEstimate)| Pair {
            area_m2,
            found,
            reference: *reference,
        };
        let (figures, draws) = Figures::of(&places.map(pair).collect::<Vec<_>>());
        Self { figures, draws }
    }

    /// The places have enough of the light for figures that say something.
    pub fn counts(&self) -> bool {
        self.figures.says_something(&self.draws)
    }

    /// Over several lights.
    pub fn over_lights<'a>(lights: impl Iterator<Item = &'a Self>) -> Self {
        let lights: Vec<(Figures, &[Draw])> = lights.map(|light| (light.figures, &light.draws[..])).collect();
        Self { figures: Figures::over_lights(&lights), draws: Vec::new() }
    }
}

impl AmidLight {
    /// Over several lights.
    pub fn over_lights(lights: &[&Self]) -> Self {
        let over = |of: fn(&Self) -> &Judged| Judged::over_lights(lights.iter().map(|light| of(light)));
        Self {
            near: over(|light| &light.near),
            near_ignored: over(|light| &light.near_ignored),
            near_alone: over(|light| &light.near_alone),
            all: over(|light| &light.all),
            all_ignored: over(|light| &light.all_ignored),
            own: over(|light| &light.own),
        }
    }

    /// Error near the object over that where indirect light ignores it.
    pub fn ratio(&self) -> f64 {
        self.near.figures.rel_rmse / self.near_ignored.figures.rel_rmse
    }
}

impl Amid {
    /// Of a bake, which is loaded as often as it is needed, the bake of an object, and the scenes of both. Errs where one cannot stand in the other.
    pub fn new(
        load: &dyn Fn() -> Result<LoadedBake>,
        of_object: Arc<LoadedBake>,
        (statics, object): (Scene, Scene),
    ) -> Result<Self> {
        let [mut with_object, mut ignored, empty] = [load()?, load()?, load()?];
        let name = "object".to_owned();
        ignored.put(Beside::meshes_of(&of_object, &name))?;
        with_object.put(Beside::Baked { name, bake: of_object.clone() })?;
        if object.materials.iter().any(|material| material.emissive != [0.0; 3]) {
            let what = "an object that emits light cannot be measured: paths switch it off with the scene's emitters, and the bake does not";
            return Err(Failure::bad_input(what).try_this("an object without emissive materials"));
        }
        let alone = Geometry::new(statics).map_err(|error| failure(&error))?;
        Ok(Self { with_object, ignored, empty, of_object, object, alone })
    }

    /// The scene without the object.
    pub fn alone(&self) -> &Geometry {
        &self.alone
    }

    /// Lower and upper corner of the object in its own frame.
    pub fn bounds_m(&self) -> [Vec3; 2] {
        self.of_object.scene.manifest.bounds_m.map(Vec3::from)
    }

    /// The object where a stance has it, to be measured at so many places.
    pub fn at(&self, stance: &Stance, counts: &Counts) -> Result<Posed<'_>> {
        let place = world_from_object(stance);
        let together = self.alone.scene.clone().with_object(&self.object, &place);
        let together = Geometry::new(together).map_err(|error| failure(&error))?;
        let [low, high] = self.bounds_m();
        let middle_m = place.transform_point3(0.5 * (low + high));
        let radius_m = 0.5 * (high - low).length() * stance.scale;
        let sites = Sites::of(
            (&self.empty, &self.of_object),
            (&self.alone, &together),
            &place,
            (middle_m, NEAR_RADII * radius_m),
            counts,
        )?;
        Ok(Posed { amid: self, stance: *stance, together, middle_m, radius_m, sites })
    }
}

impl Posed<'_> {
    /// Radius of the object's ball in metres.
    pub fn radius_m(&self) -> f32 {
        self.radius_m
    }

    /// Measures under a light, the reference to such a standard error.
    pub fn measured(&self, light: &TestLight, rel_error: f64, progress: &Progress) -> Result<AmidLight> {
        let Amid { with_object, ignored, empty, alone, .. } = self.amid;
        let precision = Precision { rel_error, paths_max: PATHS_MAX };
        let traced = |geometry: &Geometry, sites: &[Site]| -> Result<Vec<IrradianceEstimate>> {
            let reference = Reference::new(geometry, &light.lighting).map_err(|error| failure(&error))?;
            reference.irradiance(sites, &precision, progress).map_err(|error| failure(&error))
        };
        let Sites { statics, own } = &self.sites;
        let places: Vec<Site> = statics.iter().map(|place| place.site).collect();
        let (truth, truth_alone) = (traced(&self.together, &places)?, traced(alone, &places)?);
        let (lit, of_object) = self.lit(with_object, light)?;
        let [(without, _), (alone, _)] = [self.lit(ignored, light)?, self.lit(empty, light)?];
        let judged = |found: &[DVec3], truth: &[IrradianceEstimate], is_near: bool| {
            let all = statics.iter().zip(truth).filter(|(place, _)| place.is_near || !is_near);
            Judged::of(all.map(|(place, truth)| (place.weight, found[place.slot], truth)))
        };
        let own_places: Vec<Site> = own.iter().map(|place| place.site).collect();
        let own_truth = traced(&self.together, &own_places)?;
        let own =
            own.iter().zip(&own_truth).map(|(place, truth)| (place.weight, of_object[place.slot], truth));
        Ok(AmidLight {
            near: judged(&lit, &truth, true),
            near_ignored: judged(&without, &truth, true),
            near_alone: judged(&alone, &truth_alone, true),
            all: judged(&lit, &truth, false),
            all_ignored: judged(&without, &truth, false),
            own: Judged::of(own),
        })
    }

    /// E_ind by slot of a bake, and of its object if it has a bake of its own.
    fn lit(&self, bake: &LoadedBake, light: &TestLight) -> Result<(Vec<DVec3>, Vec<DVec3>)> {
        let lighting = &light.lighting;
        let emitters = vec![lighting.emitter_scale; bake.scene.manifest.emitters.len()];
        let stances = vec![self.stance; bake.scene.objects()];
        let (lights, panorama) = (lighting.lights.clone(), lighting.panorama.clone());
        let lit = light_receivers_among(bake, lights, panorama, emitters, &stances, Backend::Cpu)?;
        let values = |light: &ReceiverLight| -> Vec<DVec3> {
            light.without_direct().map(|light| light.truncate().as_dvec3()).collect()
        };
        Ok((values(&lit.settled.light), lit.objects.first().map(values).unwrap_or_default()))
    }
}

/// Whatever stops a measurement, as the command's failure.
fn failure(error: &(dyn std::error::Error + 'static)) -> Failure {
    Failure::of(Exit::Failed, error)
}
