//! Bounces fed back until the light changes no more.

use glam::Vec4;

use super::lod::BounceArrays;
use super::{Columns, Irradiance, LodPlan, LodTable, Panorama, Parallel, Sky, Transport};

/// Light that the bake is lit by.
#[derive(Clone, Copy, Debug, Default)]
pub struct Incoming<'a> {
    /// E_dir at receivers by slot, W·m⁻².
    pub dir: &'a [Vec4],
    /// E_dir by near hit, W·m⁻².
    pub near: &'a [Vec4],
    /// The sky.
    pub sky: Sky,
    /// A panorama on top of it.
    pub panorama: Option<&'a Panorama>,
    /// Irradiance at receivers by slot, W·m⁻², of what is around in place of the sky: what [`Transport::sky_rows`] make of it.
    pub around: Option<&'a [Vec4]>,
    /// Irradiance by slot that objects give and take, W·m⁻²; none without them.
    pub moved: Option<&'a [Vec4]>,
    /// One factor per emitter of the manifest; 1 where absent.
    pub emitter_scale: &'a [f32],
}

/// End of the bounces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limit {
    /// Most bounces. More → brighter where bounces have not converged yet.
    pub bounces_max: u32,
    /// Relative change of E_ind from bounce to bounce below which they have converged. Smaller → more bounces.
    pub change_max: f32,
}

impl Default for Limit {
    fn default() -> Self {
        Self { bounces_max: 200, change_max: 1e-3 }
    }
}

/// Light after the last bounce, by slot in W·m⁻².
#[derive(Clone, Debug, Default)]
pub struct Settled {
    /// E_emit.
    pub emit: Vec<Vec4>,
    /// E_ind.
    pub ind: Vec<Vec4>,
    /// The part of it from near hits and from walks.
    pub near: Vec<Vec4>,
    /// λ that gave it.
    pub lambda: Vec<Vec4>,
    /// Bounces.
    pub bounces: u32,
    /// Whether they had converged before the last one allowed.
    pub converged: bool,
}

impl Settled {
    /// E_emit + E_ind at a slot: everything that did not come straight from a light.
    pub fn indirect(&self, slot: u32) -> Vec4 {
        self.emit[slot as usize] + self.ind[slot as usize]
    }

    /// Relative change from one bounce's E_ind to the next: Σ|next − last| / Σ|next|; 0 when both are black, no finite
    /// number where light is none.
    pub fn change(last: &[Vec4], next: &[Vec4]) -> f32 {
        let (mut difference, mut total) = (0.0_f64, 0.0_f64);
        for (last, next) in last.iter().zip(next) {
            difference += f64::from((*next - *last).truncate().abs().element_sum());
            total += f64::from(next.truncate().abs().element_sum());
        }
        if [difference, total] == [0.0; 2] { 0.0 } else { (difference / total) as f32 }
    }
}

/// `max(E_ind + ΔE, −E_emit)`: no more is taken from a receiver than it has.
fn moved_by(settled: &Settled, moved: &[Vec4]) -> Vec<Vec4> {
    let each = settled.ind.iter().zip(moved).zip(&settled.emit);
    each.map(|((ind, moved), emit)| (*ind + *moved).max(-*emit)).collect()
}

impl<C: Columns> Transport<C> {
    /// Feeds bounces back until E_ind changes by less than the limit: the run time's passes, one after the other.
    pub fn settle(&self, parallel: &impl Parallel, incoming: &Incoming<'_>, limit: Limit) -> Settled {
        self.settle_in(parallel, incoming, limit, None)
    }

    /// As [`Transport::settle`], in some detail. E_ind has settled when bounces in which each cluster takes part once change it by
    /// less than the limit together.
    pub fn settle_in(
        &self,
        parallel: &impl Parallel,
        incoming: &Incoming<'_>,
        limit: Limit,
        detail: Option<(&LodTable, &LodPlan)>,
    ) -> Settled {
        let Self { receivers, clusters, near, walked, columns, .. } = self;
        let mut sky = columns.skies_lambda(incoming.sky, incoming.panorama);
        if incoming.around.is_some() {
            sky.fill(Vec4::ZERO);
        }
        let mut settled = Settled {
            emit: self.emitter_irradiance(incoming.emitter_scale),
            ind: vec![Vec4::ZERO; receivers.len()],
            ..Settled::default()
        };
        let cycle = detail.map_or(1, |(_, plan)| plan.cycle() as usize);
        let mut changes = vec![f32::INFINITY; cycle];
        while settled.bounces < limit.bounces_max && !settled.converged {
            let fed = incoming.moved.map(|moved| moved_by(&settled, moved));
            let ind = fed.as_ref().unwrap_or(&settled.ind);
            let irradiance = Irradiance { dir: incoming.dir, emit: &settled.emit, ind };
            let lambda = self.lambda(parallel, irradiance, &sky);
            let mut gathered = near.gather(parallel, receivers, incoming.near, irradiance);
            walked.gather(parallel, &lambda, &mut gathered);
            if let Some(around) = incoming.around {
                gathered.iter_mut().zip(around).for_each(|(start, around)| *start += *around);
            }
            let next = match detail {
                None => {
                    let b = clusters.basis(parallel, &lambda);
                    clusters.reconstruct(parallel, &b, &gathered, Some(&settled.emit))
                }
                Some((table, plan)) => {
                    let Settled { emit, ind, .. } = &settled;
                    let arrays = BounceArrays { lambda: &lambda, near: &gathered, emit, ind };
                    table.bounce(parallel, (clusters, receivers), plan, arrays, settled.bounces)
                }
            };
            changes[settled.bounces as usize % cycle] = Settled::change(&settled.ind, &next);
            settled.converged = changes.iter().sum::<f32>() < limit.change_max;
            (settled.lambda, settled.near, settled.ind) = (lambda, gathered, next);
            settled.bounces += 1;
        }
        settled
    }
}
