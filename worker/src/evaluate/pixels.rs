//! Figures at pixels: points of surfaces that read the bake as pictures do, beside the same figures at receivers.

use glam::DVec3;
use rayon::prelude::*;

use super::evaluated::{Answer, Evaluated, Relit};
use super::evaluator::counted;
use super::figures::{Draw, Figures, Pair, RelativeRoot, SquareTerm};
use super::open::OpenSpace;
use super::sample::{Sample, SampledHit};
use crate::reference::{IrradianceEstimate, Precision, Reference, Target, luminance};
use crate::task::{Cancelled, Progress};

/// Pixels of a sample.
#[derive(Clone, Debug, Default)]
pub struct Pixels {
    /// All that can be looked at, in the order of strata.
    pub seen: Vec<SampledHit>,
    /// Those of them whose indirect light is measured, spread evenly.
    pub measured: Vec<SampledHit>,
}

/// Figures at pixels under one light.
#[derive(Clone, Debug, Default)]
pub struct PixelFigures {
    /// Of E_ind as shown, by shadow maps where the client has the light.
    pub figures: Figures,
    /// Those of draws of the pixels.
    pub draws: Vec<Draw>,
    /// E_ind as shown beside the reference, of each measured pixel; without area where the figures do not count it.
    pub pairs: Vec<Pair>,
    /// Signed root of the mean square error at pixels less that at the receivers of the same pixels, E_dir by exact rays in
    /// both; `None` for a kind without a lightmap, which reads nothing between receivers.
    pub interpolation: Option<RelativeRoot>,
    /// Its relative squares of draws of the pixels.
    pub interpolation_draws: Vec<f64>,
}

/// Light of a bake by pixel and by receiver.
pub(super) struct ShownLight<'a> {
    /// E_dir by exact rays.
    pub exact: &'a dyn Relit,
    /// E_dir by shadow maps, where they are known.
    pub mapped: Option<&'a dyn Relit>,
    /// E_ind of each place of the sample, E_dir by exact rays.
    pub found: &'a [Option<DVec3>],
    /// Reference of the same.
    pub estimates: &'a [IrradianceEstimate],
    /// Whether a place counts.
    pub counted: &'a [bool],
}

impl Pixels {
    /// Those of a sample that can be looked at; about `count` to be measured.
    pub fn of(bake: &dyn Evaluated, open: &OpenSpace, sample: &Sample, count: u32) -> Self {
        let geometry = bake.geometry();
        let is_seen = |sampled: &&SampledHit| open.sees(geometry, &geometry.site_at(&sampled.hit));
        let seen: Vec<SampledHit> = sample.hits.par_iter().filter(is_seen).copied().collect();
        let count = (count as usize).min(seen.len());
        // The middles of equal runs.
        let measured = (0..count).map(|index| seen[(2 * index + 1) * seen.len() / (2 * count)]).collect();
        Self { seen, measured }
    }

    /// Measures E_ind at pixels. `None` without any.
    pub(super) fn figures(
        &self,
        bake: &dyn Evaluated,
        light: &ShownLight<'_>,
        reference: &Reference,
        (precision, progress): (&Precision, &Progress),
    ) -> Result<Option<PixelFigures>, Cancelled> {
        if self.measured.is_empty() {
            return Ok(None);
        }
        let target = |sampled: &SampledHit| Target {
            weight: sampled.area_m2,
            ..Target::of(bake.geometry().site_at(&sampled.hit))
        };
        let targets: Vec<Target> = self.measured.iter().map(target).collect();
        let estimates = reference.mean_irradiance(&targets, precision, progress)?;
        let shown = |relit: &dyn Relit| -> Vec<Option<DVec3>> {
            self.measured.iter().map(|sampled| shown_at(bake, relit, sampled)).collect()
        };
        let exact = shown(light.exact);
        let found = light.mapped.map_or_else(|| exact.clone(), shown);
        let areas_m2 = self.measured.iter().map(|sampled| sampled.area_m2);
        let counts = counted(&found, &estimates, areas_m2);
        let pairs: Vec<Pair> = found
            .iter()
            .zip(&estimates)
            .zip(counts.iter().zip(&self.measured))
            .map(|((found, estimate), (counts, sampled))| Pair {
                area_m2: if *counts { sampled.area_m2 } else { 0.0 },
                found: found.unwrap_or_default(),
                reference: *estimate,
            })
            .collect();
        let (figures, draws) = Figures::of(&pairs);
        let terms = || self.interpolation_terms(light, &exact, (&estimates, &counts));
        let (interpolation, interpolation_draws) =
            bake.lightmap().map(|_| RelativeRoot::of(&terms())).unzip();
        let interpolation_draws = interpolation_draws.unwrap_or_default();
        Ok(Some(PixelFigures { figures, pairs, draws, interpolation, interpolation_draws }))
    }

    /// Squared errors at pixels less those at their receivers, which are free of the reference's noise in the mean. A pixel
    /// without receiver has no such difference, and no weight.
    fn interpolation_terms(
        &self,
        light: &ShownLight<'_>,
        exact: &[Option<DVec3>],
        (estimates, counts): (&[IrradianceEstimate], &[bool]),
    ) -> Vec<SquareTerm> {
        let square = |found: Option<DVec3>, estimate: &IrradianceEstimate| {
            let found = luminance(found.unwrap_or_default());
            estimate.halves.iter().map(|half| found - luminance(*half)).product::<f64>()
        };
        let term = |index: usize| {
            let own = self.measured[index];
            let place = own.place.filter(|place| counts[index] && light.counted[*place]);
            let reference = estimates[index].indirect.luminance();
            let Some(place) = place else { return SquareTerm { weight: 0.0, square: 0.0, reference } };
            let at_receiver = square(light.found[place], &light.estimates[place]);
            let square = square(exact[index], &estimates[index]) - at_receiver;
            SquareTerm { weight: own.area_m2, square, reference }
        };
        (0..self.measured.len()).map(term).collect()
    }
}

/// E_ind that a picture shows at a pixel.
fn shown_at(bake: &dyn Evaluated, relit: &dyn Relit, sampled: &SampledHit) -> Option<DVec3> {
    if bake.lightmap().is_some() {
        return relit.shown_at(&sampled.hit);
    }
    match bake.answer_at(&sampled.hit) {
        Answer::Place(place) => relit.irradiance(&place),
        Answer::Cavity | Answer::TooSmall => None,
    }
}
