//! Error by chunk: the parts of the scene where a bake is wrong.

use std::collections::BTreeMap;

use glam::DVec3;
use serde::Serialize;

use super::evaluator::{Evaluator, LightResult};
use super::figures::signed_root;
use crate::reference::{IrradianceEstimate, luminance};

/// The error of one cluster over some lights.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ClusterError {
    /// Index in the manifest; `None` for receivers that the bake left out as unreachable.
    pub cluster: Option<usize>,
    /// Mean position of its sampled receivers, in metres.
    pub position_m: [f32; 3],
    /// Sampled receivers in it.
    pub receivers: usize,
    /// Root mean square over lights and sampled receivers of the error over the light's mean, signed as
    /// [`super::Figures::rel_rmse`].
    pub rel_rmse: f64,
    /// Mean of the signed error over the light's mean.
    pub rel_bias: f64,
}

#[derive(Default)]
struct Sums {
    position: glam::Vec3,
    receivers: usize,
    area: f64,
    squares: f64,
    bias: f64,
}

/// Errors of all clusters that the sample meets, worst first.
pub fn cluster_errors(evaluator: &Evaluator, results: &[LightResult]) -> Vec<ClusterError> {
    let mut by_cluster: BTreeMap<Option<usize>, Sums> = BTreeMap::new();
    for (index, sampled) in evaluator.sample().places.iter().enumerate() {
        let cluster = evaluator.bake().chunk_of(&sampled.place);
        let counted: Vec<&LightResult> =
            results.iter().filter(|result| result.counts && result.counted[index]).collect();
        if counted.is_empty() {
            continue;
        }
        let sums = by_cluster.entry(cluster).or_default();
        sums.position += sampled.place.site.position_m;
        sums.receivers += 1;
        for result in counted {
            let mean = result.figures.mean_irradiance;
            if mean <= 0.0 {
                continue;
            }
            let IrradianceEstimate { indirect, halves, .. } = &result.reference[index];
            let error = |light: DVec3| (luminance(result.baked[index]) - luminance(light)) / mean;
            sums.area += sampled.area_m2;
            sums.squares += sampled.area_m2 * error(halves[0]) * error(halves[1]);
            sums.bias += sampled.area_m2 * error(indirect.mean);
        }
    }
    let mut errors: Vec<ClusterError> = by_cluster
        .into_iter()
        .filter(|(_, sums)| sums.area > 0.0)
        .map(|(cluster, sums)| ClusterError {
            cluster,
            position_m: (sums.position / sums.receivers as f32).to_array(),
            receivers: sums.receivers,
            rel_rmse: signed_root(sums.squares / sums.area),
            rel_bias: sums.bias / sums.area,
        })
        .collect();
    errors.sort_by(|a, b| b.rel_rmse.total_cmp(&a.rel_rmse).then(a.cluster.cmp(&b.cluster)));
    errors
}
