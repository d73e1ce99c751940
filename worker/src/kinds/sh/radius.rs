//! Support radii: the distance at which receivers have about `n_overlaps` probes; varies in space.
//!
//! We differ: five probes, not ten, see `tests/studies/no_hit.md`.

use glam::Vec3;
use lightkiln_proto::kinds::sh::Probe;
use rayon::prelude::*;

use crate::lightmap::Receiver;
use crate::rays::sampling::seed_of;
use crate::task::{Cancelled, Progress};

/// Share of receivers that are asked, chosen by identity.
const SAMPLE_ONE_IN: u64 = 8;

/// Sets every probe's radius: the mean, over sampled receivers that count it among their `n_overlaps` nearest, of
/// the distance to the farthest of those; at least `spacing_m`. A probe that none counts has `spacing_m`.
///
/// Errors soon after `progress` is cancelled.
pub fn set_radii(
    probes: &mut [Probe],
    receivers: &[Receiver],
    n_overlaps: u32,
    spacing_m: f32,
    progress: &Progress,
) -> Result<(), Cancelled> {
    let asked: Vec<&Receiver> = receivers.iter().filter(|receiver| is_sampled(receiver)).collect();
    let positions: Vec<Vec3> = probes.iter().map(|probe| Vec3::from_array(probe.position_m)).collect();
    let nearest = |receiver: &&Receiver| {
        progress.check()?;
        Ok(nearest_probes(&positions, receiver.position_m, n_overlaps as usize))
    };
    let nearest: Vec<Vec<(f32, u32)>> = asked.par_iter().map(nearest).collect::<Result<_, Cancelled>>()?;
    let mut sums = vec![(0.0_f64, 0_u32); probes.len()];
    for near in &nearest {
        let Some(&(farthest_m, _)) = near.last() else { continue };
        for &(_, probe) in near {
            sums[probe as usize].0 += f64::from(farthest_m);
            sums[probe as usize].1 += 1;
        }
    }
    for (probe, (sum_m, count)) in probes.iter_mut().zip(sums) {
        let mean_m = if count == 0 { 0.0 } else { (sum_m / f64::from(count)) as f32 };
        probe.radius_m = mean_m.max(spacing_m);
    }
    Ok(())
}

/// Whether a receiver is among the sampled ones.
pub fn is_sampled(receiver: &Receiver) -> bool {
    let [x, y] = receiver.texel.map(u64::from);
    seed_of(&[u64::from(receiver.position_m.x.to_bits()), x, y]).is_multiple_of(SAMPLE_ONE_IN)
}

/// Distances and indices of the nearest probes, nearest first.
fn nearest_probes(positions: &[Vec3], point_m: Vec3, count: usize) -> Vec<(f32, u32)> {
    let mut all: Vec<(f32, u32)> =
        positions.iter().enumerate().map(|(index, p)| (p.distance(point_m), index as u32)).collect();
    let order = |a: &(f32, u32), b: &(f32, u32)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
    if all.len() > count {
        all.select_nth_unstable_by(count - 1, order);
        all.truncate(count);
    }
    all.sort_by(order);
    all
}
