//! The evaluation of one bake, light by light.

use glam::DVec3;
use lightkiln_proto::scene::LightKind;

use super::error::EvaluationError;
use super::evaluated::{Evaluated, EvaluatedLightmap, Measure, Place, Relit};
use super::figures::{Draw, Figures, Pair};
use super::hunt::{Hunt, hunt};
use super::lights::TestLight;
use super::open::OpenSpace;
use super::pixels::{PixelFigures, Pixels, ShownLight};
use super::sample::{Sample, Sampled, SampledHit};
use super::seams::{Borders, Seams};
use super::shadow::{ClientLights, DirectShares, MappedLight};
use crate::geometry::{Geometry, Site};
use crate::reference::{
    IrradianceEstimate, Lighting, LightingError, Precision, Reference, Target, luminance,
};
use crate::task::Progress;

/// Places without baked light are left out of the figures where the reference has less than this share of its mean:
/// insides of solids.
const LIGHTLESS_SHARE: f64 = 1e-3;

/// Places that are looked at by the bake alone, for each that is measured. More → surer figures, a little more time.
const FIRST_LOOK: u32 = 16;

/// Error that is expected of light's change to the next texel, over that of the light itself.
const ROUGHNESS: f64 = 2.0;

/// Work to spend.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Places, about. More → surer figures, more time.
    pub receivers: u32,
    /// Precision of the reference.
    pub precision: Precision,
    /// Parts of the bake that are made anew to tell its classes of error apart. More → surer, more time.
    pub cells: usize,
    /// Points of surfaces whose light is measured as pictures show it, one stratum at most for each. More → surer figures,
    /// more time; 0 leaves out everything about pixels, seams and texels that stand out.
    pub pixels: u32,
    /// Texels that stand out from their neighbours and are path-traced, the worst first. More → fewer missed, more time.
    pub hunted: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self { receivers: 2000, precision: Precision::default(), cells: 12, pixels: 667, hunted: 64 }
    }
}

/// Names of the classes of error that come with pixels, beside those of kinds.
pub const PIXEL_CLASSES: [&str; 2] = ["interpolation", "shadow"];

/// A bake and everything that it is measured with.
pub struct Evaluator {
    bake: Box<dyn Evaluated>,
    sample: Sample,
    pixels: Pixels,
    borders: Borders,
    open: OpenSpace,
    client: Option<Box<dyn ClientLights>>,
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

/// Findings under one light as pictures show the bake.
#[derive(Clone, Debug)]
pub struct PixelResult {
    /// Error figures.
    pub shown: PixelFigures,
    /// Whether E_dir was by the client's shadow maps; else by exact rays.
    pub by_shadow_maps: bool,
    /// Faults of direct light by those.
    pub direct: Option<DirectShares>,
    /// Relative squares of draws of the error of direct light.
    pub direct_draws: Vec<f64>,
    /// Jumps across borders of the lightmap, if there is one.
    pub seams: Option<Seams>,
    /// Texels that stand out, likewise.
    pub hunt: Option<Hunt>,
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
    /// Findings at pixels, if any were asked for.
    pub pixels: Option<PixelResult>,
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
    /// Draws the sample, and lets the bake prepare its classes of error there. Places are the likelier the more light the
    /// bake has there under `lights`, and the faster it changes, as errors are of the size of both.
    pub fn new(
        mut bake: Box<dyn Evaluated>,
        lights: &[TestLight],
        options: Options,
        progress: &Progress,
    ) -> Result<Self, EvaluationError> {
        let first_look = bake.sample(options.receivers.saturating_mul(FIRST_LOOK));
        let sample = if first_look.hits.is_empty() {
            bake.sample(options.receivers)
        } else {
            let expected = expected_errors(bake.as_ref(), &first_look, lights, progress)?;
            first_look.focused(&expected, options.receivers)
        };
        bake.trace(&sample.bare(), options.cells, progress)?;
        let mut evaluator = Self {
            bake,
            sample,
            pixels: Pixels::default(),
            borders: Borders::default(),
            open: OpenSpace::default(),
            client: None,
            options,
        };
        if evaluator.options.pixels > 0 {
            let bake = evaluator.bake.as_ref();
            let open = OpenSpace::of(bake.geometry());
            let pixels = Pixels::of(bake, &open, &evaluator.sample, evaluator.options.pixels);
            let borders = bake.lightmap().map(|map| Borders::of(bake, &open, map)).unwrap_or_default();
            (evaluator.pixels, evaluator.borders, evaluator.open) = (pixels, borders, open);
        }
        Ok(evaluator)
    }

    /// The same, direct light at pixels by a client's shadow maps.
    #[must_use]
    pub fn with_client(self, client: Box<dyn ClientLights>) -> Self {
        Self { client: Some(client), ..self }
    }

    /// The pixels that are measured.
    pub fn pixels(&self) -> &Pixels {
        &self.pixels
    }

    /// The bake.
    pub fn bake(&self) -> &dyn Evaluated {
        self.bake.as_ref()
    }

    /// The places that are measured.
    pub fn sample(&self) -> &Sample {
        &self.sample
    }

    fn geometry(&self) -> &Geometry {
        self.bake.geometry()
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
        let target = |sampled: &Sampled| Target {
            site: sampled.place.site,
            points: self.bake.points_of(&sampled.place),
            weight: sampled.area_m2,
        };
        let targets: Vec<Target> = self.sample.places.iter().map(target).collect();
        let estimates = reference.mean_irradiance(&targets, &self.options.precision, progress)?;
        let found: Vec<Option<DVec3>> = places.iter().map(|place| relit.irradiance(place)).collect();
        let areas_m2 = self.sample.places.iter().map(|sampled| sampled.area_m2);
        let counted = counted(&found, &estimates, areas_m2);
        let baked: Vec<DVec3> = found.iter().map(|found| found.unwrap_or_default()).collect();
        let (figures, draws) = Figures::of(&self.pairs(&baked, &estimates, &counted));
        let counts = figures.says_something(&draws);
        let mean_irradiance = figures.mean_irradiance;
        let mut classes = self.classes(relit.as_ref(), &places, &estimates, &counted, mean_irradiance);
        let client = self.client.as_deref().filter(|_| self.options.pixels > 0 && has_shadows(light));
        let maps = client.map(|client| client.under(&light.lighting)).transpose()?.flatten();
        let incoming = maps.as_ref().and_then(|maps| maps.incoming());
        let mapped = incoming.and_then(|incoming| self.bake.relit_by_maps(&light.lighting, &incoming));
        let shown = ShownLight {
            exact: relit.as_ref(),
            mapped: mapped.as_deref(),
            found: &found,
            estimates: &estimates,
            counted: &counted,
        };
        let pixels = self.pixels_under(&reference, &shown, (maps.as_deref(), mean_irradiance), progress)?;
        let interpolation = pixels.as_ref().and_then(|pixels| pixels.shown.interpolation);
        classes.extend(interpolation.map(|interpolation| ClassResult {
            name: PIXEL_CLASSES[0],
            about: "of reading texels between their receivers",
            rel_rmse: interpolation.rel_rmse,
            at_sample: Vec::new(),
        }));
        classes.extend(mapped.as_deref().map(|mapped| ClassResult {
            name: PIXEL_CLASSES[1],
            about: "of the client's shadow maps",
            rel_rmse: self.shadow_rms(&baked, mapped, &counted) / mean_irradiance.max(f64::MIN_POSITIVE),
            at_sample: Vec::new(),
        }));
        let (bounces, converged) = relit.bounces();
        drop(mapped);
        drop(relit);
        let light = light.clone();
        let reference = estimates;
        Ok(LightResult {
            light,
            figures,
            draws,
            counts,
            classes,
            pixels,
            baked,
            reference,
            counted,
            bounces,
            converged,
        })
    }

    /// Figures at pixels, seams, and texels that stand out.
    fn pixels_under(
        &self,
        reference: &Reference,
        light: &ShownLight<'_>,
        (maps, mean_irradiance): (Option<&dyn MappedLight>, f64),
        progress: &Progress,
    ) -> Result<Option<PixelResult>, EvaluationError> {
        let precision = &self.options.precision;
        let bake = self.bake.as_ref();
        let Some(shown) = self.pixels.figures(bake, light, reference, (precision, progress))? else {
            return Ok(None);
        };
        let direct = maps.map(|maps| {
            let site = |sampled: &SampledHit| (self.geometry().site_at(&sampled.hit), sampled.area_m2);
            let sites: Vec<(Site, f64)> = self.pixels.seen.iter().map(site).collect();
            DirectShares::of(&sites, maps, reference)
        });
        let (direct, direct_draws) = direct.unzip();
        let direct_draws = direct_draws.unwrap_or_default();
        let relit = light.mapped.unwrap_or(light.exact);
        let lightmap = bake.lightmap();
        let seams = lightmap.map(|lightmap| {
            self.borders.jumps((bake, lightmap), (relit, mean_irradiance), reference, progress)
        });
        let seams = seams.transpose()?;
        let is_seen = |site: &Site| self.open.sees(self.geometry(), site);
        let hunt = lightmap
            .map(|lightmap| {
                hunt((bake, lightmap), relit, reference, (self.options.hunted, &is_seen), progress)
            })
            .transpose()?;
        let by_shadow_maps = light.mapped.is_some();
        Ok(Some(PixelResult { shown, by_shadow_maps, direct, direct_draws, seams, hunt }))
    }

    /// Root mean square difference of luminance at the sample's places between light relit by shadow maps and by exact rays.
    fn shadow_rms(&self, exact: &[DVec3], mapped: &dyn Relit, counted: &[bool]) -> f64 {
        let (mut squares, mut area) = (0.0, 0.0);
        for ((sampled, exact), _) in
            self.sample.places.iter().zip(exact).zip(counted).filter(|(_, counted)| **counted)
        {
            let mapped = mapped.irradiance(&sampled.place).unwrap_or_default();
            squares += sampled.area_m2 * (luminance(mapped) - luminance(*exact)).powi(2);
            area += sampled.area_m2;
        }
        if area > 0.0 { (squares / area).sqrt() } else { 0.0 }
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

/// Root mean square over lights of the error that is expected at each place, over the light's mean. Skies are not asked: they
/// vary least, and cost most.
pub(super) fn expected_errors(
    bake: &dyn Evaluated,
    sample: &Sample,
    lights: &[TestLight],
    progress: &Progress,
) -> Result<Vec<f64>, EvaluationError> {
    let mut squares = vec![0.0; sample.places.len()];
    let is_sky = |light: &&TestLight| {
        let lights = &light.lighting.lights;
        light.lighting.panorama.is_some()
            || lights.iter().any(|lamp| matches!(lamp.kind, LightKind::Sky { .. }))
    };
    let around: Vec<Vec<Place>> =
        sample.places.iter().map(|sampled| neighbours_of(bake, &sampled.place)).collect();
    for light in lights.iter().filter(|light| !is_sky(light)) {
        let reference = Reference::new(bake.geometry(), &light.lighting)?;
        let relit = bake.relit(&reference, &light.lighting, progress)?;
        let found_at = |place: &Place| luminance(relit.irradiance(place).unwrap_or_default());
        let (mut area_m2, mut light) = (0.0, 0.0);
        let mut expected = Vec::with_capacity(squares.len());
        for (sampled, around) in sample.places.iter().zip(&around) {
            let found = found_at(&sampled.place);
            (area_m2, light) = (area_m2 + sampled.area_m2, light + sampled.area_m2 * found);
            let rough = around.iter().map(|place| (found_at(place) - found).abs()).fold(0.0, f64::max);
            expected.push(found + ROUGHNESS * rough);
        }
        if light > 0.0 {
            squares
                .iter_mut()
                .zip(expected)
                .for_each(|(sum, error)| *sum += (error * area_m2 / light).powi(2));
        }
    }
    Ok(squares.into_iter().map(f64::sqrt).collect())
}

/// Places of the four texels beside a place's.
fn neighbours_of(bake: &dyn Evaluated, place: &Place) -> Vec<Place> {
    let beside = |lightmap: &dyn EvaluatedLightmap| {
        let (block, [x, y]) = lightmap.texel_of(place)?;
        let beside = [(1, 0), (-1, 0), (0, 1), (0, -1)].into_iter().filter_map(|(dx, dy): (i32, i32)| {
            let texel = [u16::try_from(i32::from(x) + dx).ok()?, u16::try_from(i32::from(y) + dy).ok()?];
            lightmap.place_of(block, texel)
        });
        Some(beside.collect())
    };
    bake.lightmap().and_then(beside).unwrap_or_default()
}

/// Some light of it can cast a shadow.
fn has_shadows(light: &TestLight) -> bool {
    light.lighting.lights.iter().any(|lamp| !matches!(lamp.kind, LightKind::Sky { .. }))
}

/// All but places that neither the bake nor the reference lights.
pub(super) fn counted(
    found: &[Option<DVec3>],
    estimates: &[IrradianceEstimate],
    weights: impl Iterator<Item = f64>,
) -> Vec<bool> {
    let (total, weight) = weights.zip(estimates).fold((0.0, 0.0), |(total, sum), (weight, estimate)| {
        (total + weight * estimate.indirect.luminance(), sum + weight)
    });
    let least = if weight > 0.0 { LIGHTLESS_SHARE * total / weight } else { 0.0 };
    let counts = |(found, estimate): (&Option<DVec3>, &IrradianceEstimate)| {
        found.is_some() || estimate.indirect.luminance() > least
    };
    found.iter().zip(estimates).map(counts).collect()
}
