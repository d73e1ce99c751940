//! The evaluation of one bake, light by light.

use glam::DVec3;
use lightkiln_proto::scene::LightKind;

use super::error::EvaluationError;
use super::evaluated::{Evaluated, Measure, Place, Relit};
use super::figures::{Draw, Figures, Pair};
use super::lights::{Chosen, TestLight, default_lights};
use super::sample::Sample;
use super::solid::check_place;
use crate::geometry::{Geometry, Site};
use crate::reference::{IrradianceEstimate, Lighting, LightingError, Precision, Reference};
use crate::task::Progress;
use crate::vantage::Openness;

/// Places without baked light are left out of the figures where the reference has less than this share of its mean:
/// insides of solids.
const LIGHTLESS_SHARE: f64 = 1e-3;

/// Work to spend.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Strata of area, with a place in each. More → surer figures, more time.
    pub receivers: u32,
    /// Precision of the reference.
    pub precision: Precision,
    /// Parts of the bake that are made anew to tell its classes of error apart. More → surer, more time.
    pub cells: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self { receivers: 2000, precision: Precision::default(), cells: 12 }
    }
}

/// A bake and everything that it is measured with.
pub struct Evaluator {
    bake: Box<dyn Evaluated>,
    sample: Sample,
    options: Options,
}

/// One class of error under one light.
#[derive(Clone, Debug, PartialEq)]
pub struct ClassResult {
    /// Short name.
    pub name: &'static str,
    /// Its cause, in a few words.
    pub about: &'static str,
    /// Root mean square error over the mean of the reference.
    pub rel_rmse: f64,
    /// Light at the sample's places with no other error than this one, W·m⁻²; empty where that is not known.
    pub at_sample: Vec<DVec3>,
}

/// Findings under one light.
#[derive(Clone, Debug)]
pub struct LightResult {
    /// The light.
    pub light: TestLight,
    /// Error figures.
    pub figures: Figures,
    /// Those of draws of the sample.
    pub draws: Vec<Draw>,
    /// Whether the light reaches enough of the sample for figures that say something.
    pub counts: bool,
    /// The error by the kind's classes.
    pub classes: Vec<ClassResult>,
    /// Baked E_ind of the sample's places, W·m⁻²; zero for those that the bake left out as unreachable.
    pub baked: Vec<DVec3>,
    /// The reference of the same.
    pub reference: Vec<IrradianceEstimate>,
    /// Whether the figures count a place of the sample: all but insides of solids.
    pub counted: Vec<bool>,
    /// Bounces until the light changed no more.
    pub bounces: usize,
    /// Whether it did before the last bounce allowed.
    pub converged: bool,
}

impl Evaluator {
    /// Draws the sample, and lets the bake prepare its classes of error there.
    pub fn new(
        mut bake: Box<dyn Evaluated>,
        options: Options,
        progress: &Progress,
    ) -> Result<Self, EvaluationError> {
        let sample = bake.sample(options.receivers);
        bake.trace(&sample.bare(), options.cells, progress)?;
        Ok(Self { bake, sample, options })
    }

    /// The bake.
    pub fn bake(&self) -> &dyn Evaluated {
        self.bake.as_ref()
    }

    /// The places that are measured.
    pub fn sample(&self) -> &Sample {
        &self.sample
    }

    /// Lights chosen from the scene.
    pub fn default_lights(&self) -> Chosen {
        default_lights(self.geometry())
    }

    /// Refuses lights that stand inside solids; leaves out suns and skies where the scene has no opening, and says so.
    ///
    /// Errors when that leaves none.
    pub fn usable(&self, lights: Vec<TestLight>) -> Result<Chosen, EvaluationError> {
        let mut openness = None;
        let mut usable = Chosen::default();
        for light in lights {
            check_place(self.geometry(), &light)?;
            let from_outside =
                |kind: &LightKind| matches!(kind, LightKind::Sky { .. } | LightKind::Sun { .. });
            let needs_opening = light.lighting.lights.iter().any(|lamp| from_outside(&lamp.kind));
            let openness = openness.get_or_insert_with(|| Openness::of(self.geometry()));
            if needs_opening && !openness.has_opening() {
                let note = format!("light '{}' is left out: the scene has no opening to the sky", light.name);
                usable.notes.push(note);
            } else if light.lighting.emitter_scale > 0.0 && self.emits_nothing() {
                usable.notes.push(format!("light '{}' is left out: nothing in the scene emits", light.name));
            } else {
                usable.lights.push(light);
            }
        }
        if usable.lights.is_empty() {
            return Err(EvaluationError::NoLight { problem: usable.notes.join("; ") });
        }
        Ok(usable)
    }

    fn geometry(&self) -> &Geometry {
        self.bake.geometry()
    }

    fn emits_nothing(&self) -> bool {
        self.geometry().scene.materials.iter().all(|material| material.emissive == [0.0; 3])
    }

    /// The reference of the scene under some light.
    pub fn reference(&self, lighting: &Lighting) -> Result<Reference<'_>, LightingError> {
        Reference::new(self.geometry(), lighting)
    }

    /// The bake under some light.
    pub fn relit(
        &self,
        light: &TestLight,
        progress: &Progress,
    ) -> Result<Box<dyn Relit + '_>, EvaluationError> {
        Ok(self.bake.relit(&self.reference(&light.lighting)?, &light.lighting, progress)?)
    }

    /// Measures the bake under one light. One that reaches nothing does not count ([`LightResult::counts`]).
    pub fn measure(&self, light: &TestLight, progress: &Progress) -> Result<LightResult, EvaluationError> {
        let reference = self.reference(&light.lighting)?;
        let relit = self.bake.relit(&reference, &light.lighting, progress)?;
        let places = self.sample.bare();
        let sites: Vec<Site> = places.iter().map(|place| place.site).collect();
        let estimates = reference.irradiance(&sites, &self.options.precision, progress)?;
        let found: Vec<Option<DVec3>> = places.iter().map(|place| relit.irradiance(place)).collect();
        let counted = counted(&found, &estimates);
        let baked: Vec<DVec3> = found.into_iter().map(Option::unwrap_or_default).collect();
        let (figures, draws) = Figures::of(&self.pairs(&baked, &estimates, &counted));
        let counts = figures.says_something(&draws);
        let classes = self.classes(relit.as_ref(), &places, &estimates, &counted, figures.mean_irradiance);
        let (bounces, converged) = relit.bounces();
        let light = light.clone();
        let reference = estimates;
        Ok(LightResult {
            light,
            figures,
            draws,
            counts,
            classes,
            baked,
            reference,
            counted,
            bounces,
            converged,
        })
    }

    /// The kind's classes, relative to the mean of the reference.
    fn classes(
        &self,
        relit: &dyn Relit,
        places: &[Place],
        estimates: &[IrradianceEstimate],
        counted: &[bool],
        mean_irradiance: f64,
    ) -> Vec<ClassResult> {
        let of_class = |class: super::ErrorClass| {
            let (rel_rmse, at_sample) = match class.measure {
                Measure::Rms(rms) => (rms / mean_irradiance.max(f64::MIN_POSITIVE), Vec::new()),
                Measure::AtSample(found) => {
                    (Figures::rel_rmse_of(&self.pairs(&found, estimates, counted)), found)
                }
            };
            ClassResult { name: class.name, about: class.about, rel_rmse, at_sample }
        };
        relit.classes(places).into_iter().map(of_class).collect()
    }

    fn pairs(&self, found: &[DVec3], estimates: &[IrradianceEstimate], counted: &[bool]) -> Vec<Pair> {
        let all = self.sample.places.iter().zip(found).zip(estimates).zip(counted);
        // A place that does not count keeps its number, with no area: draws are then of the same places under all lights.
        all.map(|(((sampled, found), estimate), counted)| Pair {
            area_m2: if *counted { sampled.area_m2 } else { 0.0 },
            found: *found,
            reference: *estimate,
        })
        .collect()
    }
}

/// All but places that neither the bake nor the reference lights.
fn counted(found: &[Option<DVec3>], estimates: &[IrradianceEstimate]) -> Vec<bool> {
    let total: f64 = estimates.iter().map(|estimate| estimate.indirect.luminance()).sum();
    let least = LIGHTLESS_SHARE * total / estimates.len().max(1) as f64;
    let counts = |(found, estimate): (&Option<DVec3>, &IrradianceEstimate)| {
        found.is_some() || estimate.indirect.luminance() > least
    };
    found.iter().zip(estimates).map(counts).collect()
}
