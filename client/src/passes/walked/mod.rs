//! Irradiance that receivers get from where their walks end: `N(r) += w Σ ±λ`. The walks themselves were taken once, as no light moves their ends.

pub mod reference;

use std::ops::Range;

use lightkiln_proto::relight::{WalkedRow, WalkedTable};

use crate::error::Result;
use crate::passes::gpu::{Gpu, groups_2d};
use crate::passes::resident::{Resident, pages};

/// The shader.
pub const SHADER: &str = include_str!("walked.wgsl");
/// Largest difference from the reference, relative to the largest value: the same sum of at most 128 f32 in the same order.
pub const TOLERANCE: f32 = 1e-5;
/// Threads of a workgroup in the shader.
const THREADS: u32 = 64;

/// Numbers of the pass; twin of `Walked` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct WalkedNumbers {
    /// Receivers with ends.
    pub row_count: u32,
    /// Threads in a row of the dispatch.
    pub stride: u32,
    /// Weight of an end.
    pub weight: f32,
}

/// The pass on the adapter.
#[derive(Debug)]
pub struct WalkedPass {
    pipeline: wgpu::ComputePipeline,
    /// Receivers whose ends fit into one binding.
    pages: Vec<(wgpu::BindGroup, [u32; 2])>,
}

impl WalkedPass {
    /// Uploads the ends; `None` where there are none.
    pub fn new(gpu: &Gpu, table: &WalkedTable, resident: &Resident) -> Result<Option<Self>> {
        if table.is_empty() {
            return Ok(None);
        }
        let pipeline = gpu.compute("light of walks", SHADER, "gather");
        let page = |run: Range<usize>| {
            let rows = &table.rows[run];
            let start = rows.first().map_or(0, |row| row.first);
            let end = rows.last().map_or(0, |row| row.first + row.count);
            let of_page: Vec<WalkedRow> =
                rows.iter().map(|row| WalkedRow { first: row.first - start, ..*row }).collect();
            let groups = groups_2d((rows.len() as u32).div_ceil(THREADS));
            let row_count = rows.len() as u32;
            let numbers = WalkedNumbers { row_count, stride: groups[0] * THREADS, weight: table.weight };
            let group = gpu.bind(
                &pipeline.get_bind_group_layout(0),
                &[
                    gpu.uniform("walked", &numbers).as_entire_binding(),
                    gpu.storage("receivers with walks", &of_page)?.as_entire_binding(),
                    gpu.storage("ends of walks", &table.places[start as usize..end as usize])?
                        .as_entire_binding(),
                    resident.lambda.as_entire_binding(),
                    resident.e_near.as_entire_binding(),
                ],
            );
            Ok((group, groups))
        };
        // Of rows and of ends, whichever are more.
        let bytes = |row: &WalkedRow| (size_of::<WalkedRow>() as u64).max(4 * u64::from(row.count));
        let pages = pages(gpu, "receiver's walks", table.rows.iter().map(bytes))?;
        let pages = pages.into_iter().map(page).collect::<Result<_>>()?;
        Ok(Some(Self { pipeline, pages }))
    }

    /// Records the sums, from λ of this bounce.
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>) {
        pass.set_pipeline(&self.pipeline);
        for (group, [x, y]) in &self.pages {
            pass.set_bind_group(0, group, &[]);
            pass.dispatch_workgroups(*x, *y, 1);
        }
    }
}
