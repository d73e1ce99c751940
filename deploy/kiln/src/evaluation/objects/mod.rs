//! `kiln evaluate --objects`: objects amid a bake where they are said to stand, or at places chosen from the scene alone.

mod words;

use std::sync::Arc;

use lightkiln_client::bake::LoadedBake;
use lightkiln_client::fetch::Source;
use lightkiln_client::scene::Stance;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::scene::SceneCamera;
use lightkiln_proto::words::stance_to_text;
use lightkiln_worker::evaluate::{EvaluationError, TestLight, panorama_light};
use lightkiln_worker::scene::model::Scene;
use lightkiln_worker::scene::{Bundle, Limits, import};
use lightkiln_worker::task::Progress;
use lightkiln_worker::vantage::{StandingPlace, standing_places};
use serde::Serialize;

use super::amid::{Amid, AmidLight, Counts, Judged, Posed, Strip, camera_towards};
use super::arguments::EvaluationArguments;
use super::limits::{Held, Limit, check_held};
use super::measure::lights_to_measure;
use super::packed_scene_of_bundle;
use crate::console::say;
use crate::failure::{Exit, Failure, Result};
use crate::interrupt::Interrupt;
use crate::kinds::KindTables;
use crate::lighting::LightArguments;
use crate::objects::ObjectArgument;
use crate::submission::PackedScene;

pub use words::{object_words, write_objects};

/// Of the places near an object, those that are measured elsewhere and on its own surface.
const SHARE: u32 = 2;
/// Name of a place that was said.
const SAID: &str = "said";

/// Figures that a limit may name.
pub const OBJECT_FIGURES: [&str; 7] = [
    "near_rel_rmse",
    "near_energy_ratio",
    "near_ratio",
    "all_rel_rmse",
    "all_energy_ratio",
    "own_rel_rmse",
    "own_energy_ratio",
];

/// A whole evaluation of objects.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ObjectEvaluation {
    /// Scene as given, or as the bundle names it.
    pub scene: String,
    /// Standard error that was asked of the reference.
    pub rel_error: f64,
    /// Objects at places.
    pub objects: Vec<ObjectRow>,
    /// Notes on lights and places that were left out, and why.
    pub notes: Vec<String>,
}

/// An object at a place.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ObjectRow {
    /// Its bundle.
    pub object: String,
    /// Sort of place: `said`, or `floor`, `wall`, `doorway` of those that were chosen.
    pub place: String,
    /// Its stance, in words of --objects.
    pub stance: String,
    /// Radius of its ball, in metres; near it is within three of them.
    pub radius_m: f32,
    /// Places measured near it, elsewhere, and on its own surface.
    pub places: [usize; 3],
    /// Light by light.
    pub lights: Vec<ObjectLight>,
    /// Root mean square of errors over the lights that count, means of energy ratios.
    pub all_lights: AmidLight,
    #[serde(skip)]
    strips: Vec<Strip>,
}

/// Figures under one light.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ObjectLight {
    /// Light's name.
    pub name: String,
    /// Its type and place, in words.
    pub words: String,
    /// Whether it reaches enough places near the object to count among all lights.
    pub counts: bool,
    /// Errors.
    #[serde(flatten)]
    pub errors: AmidLight,
}

/// How objects are measured.
pub struct Wanted<'a> {
    /// Objects, with words for where they stand, or without.
    pub objects: &'a [ObjectArgument],
    /// Precision, lights, limits.
    pub arguments: &'a EvaluationArguments,
    /// Lights that are left out.
    pub lighting: &'a LightArguments,
    /// Pictures, if they are wanted: their camera, or else one that sees the object, and the size of each.
    pub draws: Option<(Option<SceneCamera>, (u32, u32))>,
}

/// Measures objects amid the bake of a source, whose scene that is. Says on standard error what it does.
pub fn evaluate(
    kinds: &KindTables,
    source: &Source,
    scene: PackedScene,
    wanted: &Wanted<'_>,
    interrupt: &Interrupt,
) -> Result<ObjectEvaluation> {
    let own_lights = wanted.arguments.own_lights()?;
    let panorama = wanted.lighting.panorama()?.map(panorama_light);
    let load = || Ok(LoadedBake::load(source, &kinds.client)?);
    let name = scene.name.clone();
    let (_, manifest) = source.manifest()?;
    let statics = scene_of(scene, manifest.scene)?;
    let mut evaluation = ObjectEvaluation {
        scene: name,
        rel_error: wanted.arguments.rel_error,
        ..ObjectEvaluation::default()
    };
    let progress = Progress::new();
    for argument in wanted.objects {
        let (bake, object) = object_of(kinds, argument)?;
        let amid = Amid::new(&load, bake, (statics.clone(), object))?;
        let chosen = lights_to_measure(amid.alone(), own_lights.clone(), panorama.clone(), wanted.lighting)?;
        let (places, notes) = places_of(&amid, argument);
        if places.is_empty() {
            let what = format!("no place was found for {}: {}", argument.file().display(), notes.join("; "));
            return Err(Failure::bad_input(what).try_this("--objects \"FILE pos=x,y,z\""));
        }
        let notes = chosen.notes.into_iter().chain(notes).filter(|note| !evaluation.notes.contains(note));
        evaluation.notes.extend(notes.inspect(|note| say!("note: {note}")).collect::<Vec<_>>());
        for StandingPlace { name, stance } in places {
            let posed = amid.at(&stance, &counts_of(wanted.arguments))?;
            let mut row = ObjectRow {
                object: argument.file().display().to_string(),
                place: name.to_owned(),
                stance: stance_to_text(&stance),
                radius_m: posed.radius_m(),
                places: places_measured(&posed),
                ..ObjectRow::default()
            };
            say!("{} at {}: {}", row.object, row.place, row.stance);
            let draws = wanted
                .draws
                .as_ref()
                .map(|(camera, size)| (camera.clone().unwrap_or_else(|| camera_towards(&posed)), *size));
            for light in &chosen.lights {
                if interrupt.is_raised() {
                    return Err(Failure::new(Exit::Interrupted, "the evaluation was interrupted"));
                }
                say!("{}: {}", light.name, light.words);
                row.add(light, posed.measured(light, wanted.arguments.rel_error, &progress)?);
                if let Some((camera, size)) = &draws {
                    row.strips.push(posed.strip(light, camera, *size, &progress)?);
                }
            }
            row.sum_up()?;
            evaluation.objects.push(row);
        }
    }
    Ok(evaluation)
}

fn counts_of(arguments: &EvaluationArguments) -> Counts {
    let near = arguments.receivers;
    let rest = (near / SHARE).max(1) as usize;
    Counts { near: near as usize, elsewhere: rest, own: rest }
}

fn places_measured(posed: &Posed<'_>) -> [usize; 3] {
    let near = posed.sites.statics.iter().filter(|place| place.is_near).count();
    [near, posed.sites.statics.len() - near, posed.sites.own.len()]
}

/// A scene as it was baked.
fn scene_of(scene: PackedScene, wanted: Digest) -> Result<Scene> {
    let bytes = scene.into_bytes();
    let found = Digest::of(&bytes);
    let refused = |error: &(dyn std::error::Error + 'static)| Failure::of(Exit::BadInput, error);
    if found != wanted {
        return Err(refused(&EvaluationError::OtherScene { wanted, found }));
    }
    let limits = Limits::default();
    let opened = Bundle::from_bytes(bytes, &limits).and_then(|bundle| import(&bundle, &limits));
    Ok(opened.map_err(|error| refused(&error))?.scene)
}

/// An object's bake, and its scene.
fn object_of(kinds: &KindTables, argument: &ObjectArgument) -> Result<(Arc<LoadedBake>, Scene)> {
    let file = argument.file();
    if !file.is_dir() {
        let what = format!("{} is no bundle of an object", file.display());
        return Err(Failure::bad_input(what)
            .try_this("the folder that 'kiln bake OBJECT --kind transfer' or --mover wrote"));
    }
    let source = Source::bundle(file)?;
    let (_, manifest) = source.manifest()?;
    let scene = scene_of(packed_scene_of_bundle(file)?, manifest.scene)?;
    Ok((Arc::new(LoadedBake::load(&source, &kinds.client)?), scene))
}

/// Where an object stands: as it is said, or at places of the scene.
fn places_of(amid: &Amid, argument: &ObjectArgument) -> (Vec<StandingPlace>, Vec<String>) {
    if argument.stance == Stance::default() {
        standing_places(amid.alone(), amid.bounds_m())
    } else {
        (vec![StandingPlace { name: SAID, stance: argument.stance }], Vec::new())
    }
}

impl ObjectRow {
    fn add(&mut self, light: &TestLight, errors: AmidLight) {
        let counts = errors.near.counts();
        self.lights.push(ObjectLight {
            name: light.name.clone(),
            words: light.words.clone(),
            counts,
            errors,
        });
    }

    /// Sums up the lights that count; errs where none does.
    fn sum_up(&mut self) -> Result<()> {
        let counted: Vec<&AmidLight> =
            self.lights.iter().filter(|light| light.counts).map(|light| &light.errors).collect();
        if counted.is_empty() {
            let what = format!("no light reaches enough places near {} at {}", self.object, self.place);
            return Err(
                Failure::bad_input(what).try_this("other --lights, more --receivers, or another place")
            );
        }
        self.all_lights = AmidLight::over_lights(&counted);
        Ok(())
    }
}

/// A figure by its name, with the ends of its interval; one without interval for both.
fn figure_of(errors: &AmidLight, name: &str) -> Option<(f64, [f64; 2])> {
    let rel_rmse = |judged: &Judged| (judged.figures.rel_rmse, judged.figures.interval_95.rel_rmse);
    let energy = |judged: &Judged| (judged.figures.energy_ratio, judged.figures.interval_95.energy_ratio);
    Some(match name {
        "near_rel_rmse" => rel_rmse(&errors.near),
        "near_energy_ratio" => energy(&errors.near),
        "near_ratio" => (errors.ratio(), [errors.ratio(); 2]),
        "all_rel_rmse" => rel_rmse(&errors.all),
        "all_energy_ratio" => energy(&errors.all),
        "own_rel_rmse" => rel_rmse(&errors.own),
        "own_energy_ratio" => energy(&errors.own),
        _ => return None,
    })
}

/// Fails as [`super::check`] does, when one object at one place breaks a limit.
pub fn check_objects(limits: &[Limit], evaluation: &ObjectEvaluation) -> Result<()> {
    let mut held = Vec::new();
    for (limit, row) in limits.iter().flat_map(|limit| evaluation.objects.iter().map(move |row| (limit, row)))
    {
        let light = limit.light_among(&row.lights, |light| (&light.name, light.counts))?;
        let errors = light.map_or(&row.all_lights, |light| &light.errors);
        let value = figure_of(errors, limit.figure()).unwrap_or((f64::NAN, [f64::NAN; 2]));
        held.push(Held { limit, of: format!(" of {} at {}", row.object, row.place), value });
    }
    check_held(held)
}
