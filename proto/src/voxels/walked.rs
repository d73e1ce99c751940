//! Walks of receivers, once and for all: where they end hangs on no light.

use std::f32::consts::PI;

use glam::Vec3;

use super::cones::{Bundle, Cone, IRRADIANCE_WALKS};
use super::content::Glow;
use super::light::{first_of_sky, nearest_of_sky, sky_directions};
use super::table::{DARK_PATCH, VoxelTable, mixed};
use super::walk::{Start, walk};
use crate::relight::{Inconsistent, NearTable, Parallel, PatchTable, ReceiverTable, WalkedTable};

/// Steps of a voxel's side that tell places apart.
const STEPS: f32 = 16.0;

/// Irradiance at a receiver straight from what walks see glow.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Emission {
    /// Slot of the receiver.
    pub slot: u32,
    /// Emitter and its share: W·m⁻² a radiance of 1 W·m⁻²·sr⁻¹, by channel.
    pub shares: Vec<(u16, Vec3)>,
}

/// Ends of a receiver's walks.
#[derive(Default)]
struct Ends {
    places: Vec<u32>,
    shares: Vec<(u16, Vec3)>,
}

/// Walks of the receivers that are `wanted`: the ends in λ, and what glows there.
pub fn walked(
    voxels: &VoxelTable,
    patches: &PatchTable,
    (receivers, near): (&ReceiverTable, &NearTable),
    wanted: impl Fn(u32) -> bool,
    parallel: &impl Parallel,
) -> Result<(WalkedTable, Vec<Emission>), Inconsistent> {
    let slots: Vec<u32> = (0..receivers.len() as u32).filter(|slot| wanted(*slot)).collect();
    let (sky, first_of_sky) = (sky_directions(patches), first_of_sky(patches) as u32);
    let weight = PI / IRRADIANCE_WALKS as f32;
    let found: Vec<Ends> = parallel.map(slots.len(), |index| {
        let [at_m, normal] =
            [&receivers.position_m, &receivers.normal].map(|of| of[slots[index] as usize].truncate());
        let (start, bundle) =
            (Start::on(at_m, normal), Bundle::new(IRRADIANCE_WALKS, walk_identity(voxels.voxel_m, at_m)));
        let mut ends = Ends::default();
        for index in 0..bundle.walks() {
            let Cone { direction, tangent } = bundle.cosine(index, normal);
            match walk(voxels, &start, direction, tangent) {
                None => ends.places.push(first_of_sky + nearest_of_sky(&sky, direction)),
                Some(hit) => {
                    ends.places.extend((hit.patch != DARK_PATCH).then_some(hit.patch));
                    let row = voxels.elements.get(hit.element as usize).filter(|_| !hit.is_back);
                    if let Some(glow) = row.and_then(|row| row.glow()) {
                        ends.add(voxels.glows[glow as usize], weight);
                    }
                }
            }
        }
        ends
    });
    let (mut emission, mut all) = (Vec::new(), Vec::with_capacity(found.len()));
    for (slot, Ends { places, shares }) in slots.into_iter().zip(found) {
        all.push((slot, places));
        if !shares.is_empty() {
            emission.push(Emission { slot, shares });
        }
    }
    Ok((WalkedTable::new(all, weight, near)?, emission))
}

impl Ends {
    fn add(&mut self, glow: Glow, weight: f32) {
        let share = weight * Vec3::from(glow.share);
        match self.shares.iter_mut().find(|(emitter, _)| *emitter == glow.emitter) {
            Some((_, sum)) => *sum += share,
            None => self.shares.push((glow.emitter, share)),
        }
    }
}

/// Identity of the walks of a receiver: its place in steps, as texels of two charts that are one square have one place, which clusters store by
/// numbers of their own, and shall have the same light.
pub fn walk_identity(voxel_m: f32, at_m: Vec3) -> u32 {
    // Middles and borders of texels lie amid steps.
    let step = (at_m / (voxel_m / STEPS) + 0.37).floor().as_ivec3();
    step.to_array().iter().fold(0, |identity, along| mixed(identity ^ *along as u32))
}
