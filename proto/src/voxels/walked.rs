//! Walks of receivers, once and for all: where they end hangs on no light.

use std::collections::HashSet;
use std::f32::consts::PI;

use glam::Vec3;

use super::WalkedBlocks;
use super::cones::{Bundle, Cone, IRRADIANCE_WALKS};
use super::light::{first_of_sky, nearest_of_sky, sky_directions};
use super::table::{DARK_PATCH, VoxelTable, mixed};
use super::walk::{Start, walk};
use crate::relight::{Ends, Inconsistent, Parallel, PatchTable, ReceiverTable, Transport, WalkedTable};

/// Weight of each walk's end.
pub const WALK_WEIGHT: f32 = PI / IRRADIANCE_WALKS as f32;
/// Steps of a voxel's side that tell places apart.
const STEPS: f32 = 16.0;

/// Ends in λ of the walks of the receivers that are `wanted`; what glows is left out, as E_emit has it.
pub fn walked(
    voxels: &VoxelTable,
    patches: &PatchTable,
    receivers: &ReceiverTable,
    wanted: impl Fn(u32) -> bool,
    parallel: &impl Parallel,
) -> Vec<Ends> {
    let slots: Vec<u32> = (0..receivers.len() as u32).filter(|slot| wanted(*slot)).collect();
    let (sky, first_of_sky) = (sky_directions(patches), first_of_sky(patches) as u32);
    parallel.map(slots.len(), |index| {
        let slot = slots[index];
        let [at_m, normal] =
            [&receivers.position_m, &receivers.normal].map(|of| of[slot as usize].truncate());
        let start = Start::on(at_m, normal);
        let bundle = Bundle::new(IRRADIANCE_WALKS, walk_identity(voxels.voxel_m, at_m));
        let end = |index: u32| {
            let Cone { direction, tangent } = bundle.cosine(index, normal);
            match walk(voxels, &start, direction, tangent) {
                None => Some(first_of_sky + nearest_of_sky(&sky, direction)),
                Some(hit) => (hit.patch != DARK_PATCH).then_some(hit.patch),
            }
        };
        let mut added: Vec<u32> = (0..bundle.walks()).filter_map(end).collect();
        added.sort_unstable();
        Ends { slot, added, taken: Vec::new() }
    })
}

/// Receivers whose indirect light is that of walks.
#[derive(Clone, Copy, Debug)]
pub enum LitByWalks<'a> {
    /// All of a bake.
    All,
    /// Those of blocks.
    Of(&'a WalkedBlocks),
}

/// The light of walks of such receivers.
pub fn light_of_walks(
    voxels: &VoxelTable,
    Transport { slots, receivers, columns, near, .. }: &Transport<PatchTable>,
    of: LitByWalks<'_>,
    parallel: &impl Parallel,
) -> Result<WalkedTable, Inconsistent> {
    let mut is_wanted = vec![matches!(of, LitByWalks::All); receivers.len()];
    if let LitByWalks::Of(blocks) = of
        && !blocks.is_empty()
    {
        let blocks: HashSet<u32> = blocks.keys().filter_map(|key| slots.block_index(key)).collect();
        for (slot, block, _) in slots.receivers() {
            if let Some(is_wanted) = is_wanted.get_mut(slot as usize) {
                *is_wanted = blocks.contains(&block);
            }
        }
    }
    let ends = walked(voxels, columns, receivers, |slot| is_wanted[slot as usize], parallel);
    WalkedTable::new(ends, WALK_WEIGHT, near)
}

/// Identity of the walks of a receiver: its place in steps, as texels of two charts that are one square have one place, which clusters store by
/// numbers of their own, and shall have the same light.
pub fn walk_identity(voxel_m: f32, at_m: Vec3) -> u32 {
    // Middles and borders of texels lie amid steps.
    let step = (at_m / (voxel_m / STEPS) + 0.37).floor().as_ivec3();
    step.to_array().iter().fold(0, |identity, along| mixed(identity ^ *along as u32))
}
