//! A hunt over all texels for those that stand out from their neighbours without the reference doing so.

use lightkiln_proto::content::Texel;
use rayon::prelude::*;
use serde::Serialize;

use super::evaluated::{Evaluated, EvaluatedLightmap, Relit};
use crate::geometry::Site;
use crate::reference::{IrradianceEstimate, Precision, Reference, Target, luminance};
use crate::task::{Cancelled, Progress};

/// Factor between the light of a texel and of its neighbours from which on it stands out.
const FACTOR: f64 = 1.5;
/// Light that is added to both, as a share of the mean: none stands out in the dark.
const FLOOR: f64 = 0.05;
/// Fewest linked neighbours whose median says something.
const NEIGHBOURS_MIN: usize = 3;
/// Neighbours that are path-traced: those whose light is nearest to the median.
const TRACED_NEIGHBOURS: usize = 3;
/// Precision of the paths: a factor of 1.5 is told from none by far less than that of figures.
const REL_ERROR: f64 = 0.15;
/// Standard errors by which bake and reference must differ.
const SIGMAS: f64 = 3.0;
/// Outliers that are named.
const NAMED: usize = 8;

/// Steps to the eight neighbours.
const AROUND: [[i32; 2]; 8] = [[-1, -1], [0, -1], [1, -1], [-1, 0], [1, 0], [-1, 1], [0, 1], [1, 1]];

/// Findings under one light.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Hunt {
    /// Texels looked at: those with receiver and enough neighbours.
    pub texels: usize,
    /// Those of them that stand out from their neighbours.
    pub standing_out: usize,
    /// The worst of these that can be looked at; they were path-traced.
    pub traced: usize,
    /// Those of them where the reference does not stand out so.
    pub outliers: usize,
    /// The worst of these.
    pub worst: Vec<Outlier>,
}

/// A texel that stands out without the reference doing so.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Outlier {
    /// Its block: path, part and side.
    pub block: String,
    /// Its place in the block.
    pub texel: Texel,
    /// Position of its receiver in metres.
    pub position_m: [f32; 3],
    /// Its luminance, W·m⁻².
    pub light: f64,
    /// Median of its neighbours'.
    pub around: f64,
    /// The reference of both.
    pub reference: f64,
    /// See `reference`.
    pub reference_around: f64,
}

/// A texel that stands out.
struct Candidate {
    index: u32,
    /// Neighbours whose light is nearest to their median.
    beside: Vec<u32>,
    light: f64,
    around: f64,
    /// Logarithm of the factor between the two, with the floor.
    factor: f64,
}

/// Looks at every texel, and path-traces the `traced_max` that stand out most.
pub(super) fn hunt(
    (bake, lightmap): (&dyn Evaluated, &dyn EvaluatedLightmap),
    relit: &dyn Relit,
    reference: &Reference,
    (traced_max, is_seen): (usize, &dyn Fn(&Site) -> bool),
    progress: &Progress,
) -> Result<Hunt, Cancelled> {
    let receivers = 0..lightmap.receivers();
    let light_of = |index: u32| relit.irradiance(&lightmap.receiver(index)).map_or(0.0, luminance);
    let lights: Vec<f64> = receivers.clone().into_par_iter().map(light_of).collect();
    let finite = || lights.iter().filter(|light| light.is_finite());
    let floor = FLOOR * finite().sum::<f64>() / finite().count().max(1) as f64;
    let looked_at: Vec<Candidate> =
        receivers.into_par_iter().filter_map(|index| candidate(lightmap, &lights, floor, index)).collect();
    let texels = looked_at.len();
    let mut candidates: Vec<Candidate> =
        looked_at.into_iter().filter(|candidate| candidate.factor.abs() > FACTOR.ln()).collect();
    candidates.sort_by(|a, b| b.factor.abs().total_cmp(&a.factor.abs()).then(a.index.cmp(&b.index)));
    let standing_out = candidates.len();
    let seen = candidates.into_iter().filter(|candidate| is_seen(&lightmap.receiver(candidate.index).site));
    let candidates: Vec<Candidate> = seen.take(traced_max).collect();
    let found = traced((bake, lightmap), reference, &candidates, floor, progress)?;
    let outliers: Vec<Outlier> = found.into_iter().flatten().collect();
    Ok(Hunt {
        texels,
        standing_out,
        traced: candidates.len(),
        outliers: outliers.len(),
        worst: outliers.into_iter().take(NAMED).collect(),
    })
}

/// A texel against the median of its linked neighbours; `None` where these are too few.
fn candidate(lightmap: &dyn EvaluatedLightmap, lights: &[f64], floor: f64, index: u32) -> Option<Candidate> {
    let mut beside: Vec<u32> = AROUND.into_iter().filter_map(|step| lightmap.linked(index, step)).collect();
    if beside.len() < NEIGHBOURS_MIN || floor <= 0.0 {
        return None;
    }
    beside.sort_by(|&a, &b| lights[a as usize].total_cmp(&lights[b as usize]).then(a.cmp(&b)));
    let around = median(&beside.iter().map(|&other| lights[other as usize]).collect::<Vec<_>>());
    let light = lights[index as usize];
    let first = (beside.len() - TRACED_NEIGHBOURS) / 2;
    let beside = beside[first..first + TRACED_NEIGHBOURS].to_vec();
    // A number that is none stands out from all.
    let factor = if light.is_finite() { ((light + floor) / (around + floor)).ln() } else { f64::INFINITY };
    Some(Candidate { index, beside, light, around, factor })
}

/// The outliers among candidates, by paths from each and from its neighbours.
fn traced(
    (bake, lightmap): (&dyn Evaluated, &dyn EvaluatedLightmap),
    reference: &Reference,
    candidates: &[Candidate],
    floor: f64,
    progress: &Progress,
) -> Result<Vec<Option<Outlier>>, Cancelled> {
    if candidates.is_empty() {
        return Ok(Vec::new());
    }
    let target = |index: u32| {
        let place = lightmap.receiver(index);
        Target { points: bake.points_of(&place), ..Target::of(place.site) }
    };
    let own_and_beside = |candidate: &Candidate| {
        std::iter::once(candidate.index)
            .chain(candidate.beside.iter().copied())
            .map(target)
            .collect::<Vec<_>>()
    };
    let targets: Vec<Target> = candidates.iter().flat_map(own_and_beside).collect();
    let precision = Precision { rel_error: REL_ERROR, ..Precision::default() };
    let estimates = reference.mean_irradiance(&targets, &precision, progress)?;
    let groups = estimates.chunks_exact(1 + TRACED_NEIGHBOURS);
    let outlier = |(candidate, estimates): (&Candidate, &[IrradianceEstimate])| {
        judged(candidate, estimates, floor).map(|[reference, reference_around]| {
            let place = lightmap.receiver(candidate.index);
            let (block, texel) = lightmap.texel_of(&place).unwrap_or_default();
            Outlier {
                block: lightmap.block_name(block).to_owned(),
                texel,
                position_m: place.site.position_m.to_array(),
                light: candidate.light,
                around: candidate.around,
                reference,
                reference_around,
            }
        })
    };
    Ok(candidates.iter().zip(groups).map(outlier).collect())
}

/// Luminances of the reference at the texel and around it, unless it stands out there at least half as much, or its noise
/// leaves that open.
fn judged(candidate: &Candidate, estimates: &[IrradianceEstimate], floor: f64) -> Option<[f64; 2]> {
    let light = |estimate: &IrradianceEstimate| estimate.indirect.luminance();
    let own = light(&estimates[0]);
    let mut others: Vec<f64> = estimates[1..].iter().map(light).collect();
    others.sort_by(f64::total_cmp);
    let around = median(&others);
    let rel_error = |estimate: &IrradianceEstimate| {
        estimate.indirect.luminance_error / (estimate.indirect.luminance() + floor)
    };
    let error = rel_error(&estimates[0]).hypot(estimates[1..].iter().map(rel_error).fold(0.0, f64::max));
    let true_factor = ((own + floor) / (around + floor)).ln();
    let off = (candidate.factor - true_factor) * candidate.factor.signum();
    (off > 0.5 * candidate.factor.abs() && off > SIGMAS * error).then_some([own, around])
}

/// Median of ascending values; 0 without any.
fn median(values: &[f64]) -> f64 {
    let middle = values.len() / 2;
    match values.len() {
        0 => 0.0,
        count if count % 2 == 1 => values[middle],
        _ => 0.5 * (values[middle - 1] + values[middle]),
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::reference::Estimate;

    fn estimate(light: f64, error: f64) -> IrradianceEstimate {
        let mean = DVec3::splat(light);
        let indirect = Estimate { mean, error: DVec3::splat(error), luminance_error: error };
        IrradianceEstimate { direct: Estimate::default(), indirect, halves: [mean; 2], paths: 128 }
    }

    fn black(factor: f64) -> Candidate {
        Candidate { index: 0, beside: vec![1, 2, 3], light: 0.0, around: 1.0, factor }
    }

    #[test]
    fn black_texel_is_an_outlier_unless_the_reference_is_as_dark_or_too_noisy_to_tell() {
        let factor = (0.05_f64 / 1.05).ln();
        let judge = |own: f64, error: f64| {
            let around = estimate(1.0, error);
            judged(&black(factor), &[estimate(own, error), around, around, around], 0.05)
        };
        let [own, around] = judge(0.9, 0.05).unwrap();
        assert!((own - 0.9).abs() < 1e-9 && (around - 1.0).abs() < 1e-9, "{own} {around}");
        assert_eq!(judge(0.01, 0.05), None, "truly dark");
        assert_eq!(judge(0.9, 1.0), None, "noise");
    }

    #[test]
    fn bright_texel_is_an_outlier_where_the_reference_is_dim() {
        let candidate = Candidate { light: 4.0, ..black((4.05_f64 / 1.05).ln()) };
        let around = estimate(1.0, 0.05);
        assert!(judged(&candidate, &[estimate(1.1, 0.05), around, around, around], 0.05).is_some());
        assert!(judged(&candidate, &[estimate(3.9, 0.05), around, around, around], 0.05).is_none());
    }

    #[test]
    fn median_of_an_even_count_is_between_the_middle_two() {
        assert_eq!([median(&[]), median(&[2.0]), median(&[1.0, 3.0])], [0.0, 2.0, 2.0]);
    }
}
