//! Radiance of receivers → mean radiance of surface patches, and its difference from that of the patch around each.

pub mod reference;

use glam::Vec4;
use lightkiln_proto::relight::{LEAF_BLOCK, PatchTable};

use crate::error::Result;
use crate::passes::gpu::{Gpu, groups_2d};
use crate::passes::resident::{ColumnsPass, Resident};

/// The shader.
pub const SHADER: &str = include_str!("patches.wgsl");
/// Largest difference from the reference, relative to the largest value: the same sums in the same order, of numbers of
/// one sign; the adapter may fuse multiply and add.
pub const TOLERANCE: f32 = 1e-5;
/// Threads of a workgroup in the shader.
const THREADS: u32 = 64;

/// Numbers of the pass; twin of `Patches` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct PatchNumbers {
    /// Receivers; slots above are dark.
    pub receiver_count: u32,
    /// Leaves.
    pub leaf_count: u32,
    /// Patches.
    pub patch_count: u32,
    /// Threads in a row of the dispatch.
    pub stride: u32,
    /// First sum of a block of leaves, behind the leaves.
    pub first_block: u32,
    /// First sum of a block of such sums, behind them.
    pub first_large: u32,
    /// Where the step that sums blocks begins to read, and where it ends.
    pub block_source: [u32; 2],
}

/// The pass on the adapter: leaves, then blocks of them, then patches, then differences.
#[derive(Debug)]
pub struct PatchesPass {
    steps: Vec<(wgpu::ComputePipeline, wgpu::BindGroup, [u32; 2])>,
}

impl PatchesPass {
    /// Uploads the patches.
    pub fn new(gpu: &Gpu, table: &PatchTable, resident: &Resident) -> Result<Self> {
        let leaf_starts = gpu.storage("leaf starts", &table.leaf_starts)?;
        let leaf_count = table.leaf_count() as u32;
        let block_count = leaf_count.div_ceil(LEAF_BLOCK);
        let (first_block, first_large) = (leaf_count, leaf_count + block_count);
        let all = (first_large + block_count.div_ceil(LEAF_BLOCK)).max(1);
        let leaves = gpu.blank("leaves", u64::from(all) * size_of::<Vec4>() as u64)?;
        let numbers = |groups: [u32; 2]| PatchNumbers {
            receiver_count: resident.receiver_count as u32,
            leaf_count,
            patch_count: table.patches.len() as u32,
            stride: groups[0] * THREADS,
            first_block,
            first_large,
            block_source: [0; 2],
        };
        let leaf_groups = groups_2d(leaf_count.div_ceil(THREADS));
        let sum = gpu.compute("leaves of patches", SHADER, "sum_leaves");
        let sum_group = gpu.bind_at(
            &sum.get_bind_group_layout(0),
            &[
                (0, gpu.uniform("leaves", &numbers(leaf_groups)).as_entire_binding()),
                (1, leaf_starts.as_entire_binding()),
                (2, gpu.storage("slots", &table.slots)?.as_entire_binding()),
                (3, resident.albedo.as_entire_binding()),
                (4, resident.e_dir.as_entire_binding()),
                (5, resident.e_emit.as_entire_binding()),
                (6, resident.e_ind.as_entire_binding()),
                (7, leaves.as_entire_binding()),
                (10, gpu.storage("areas", &table.areas)?.as_entire_binding()),
            ],
        );
        let blocks = gpu.compute("blocks of leaves", SHADER, "sum_blocks");
        let block_step = |[from, to]: [u32; 2]| {
            let groups = groups_2d((to - from).div_ceil(LEAF_BLOCK * THREADS));
            let numbers = PatchNumbers { block_source: [from, to], ..numbers(groups) };
            let group = gpu.bind_at(
                &blocks.get_bind_group_layout(0),
                &[(0, gpu.uniform("blocks", &numbers).as_entire_binding()), (7, leaves.as_entire_binding())],
            );
            (blocks.clone(), group, groups)
        };
        let patch_groups = groups_2d((table.patches.len() as u32).div_ceil(THREADS));
        let patches = gpu.storage("patches", &table.patches)?;
        let patch_numbers = gpu.uniform("patches", &numbers(patch_groups));
        let mean = gpu.compute("patches", SHADER, "mean_of_patches");
        let mean_group = gpu.bind_at(
            &mean.get_bind_group_layout(0),
            &[
                (0, patch_numbers.as_entire_binding()),
                (7, leaves.as_entire_binding()),
                (8, patches.as_entire_binding()),
                (9, resident.lambda.as_entire_binding()),
            ],
        );
        let difference = gpu.compute("differences of patches", SHADER, "difference_of_patches");
        let difference_group = gpu.bind_at(
            &difference.get_bind_group_layout(0),
            &[
                (0, patch_numbers.as_entire_binding()),
                (8, patches.as_entire_binding()),
                (9, resident.lambda.as_entire_binding()),
            ],
        );
        let steps = vec![
            (sum, sum_group, leaf_groups),
            block_step([0, first_block]),
            block_step([first_block, first_large]),
            (mean, mean_group, patch_groups),
            (difference, difference_group, patch_groups),
        ];
        Ok(Self { steps })
    }
}

impl ColumnsPass for PatchesPass {
    fn record(&self, pass: &mut wgpu::ComputePass<'_>) {
        for (pipeline, group, [x, y]) in &self.steps {
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, group, &[]);
            pass.dispatch_workgroups(*x, *y, 1);
        }
    }
}
