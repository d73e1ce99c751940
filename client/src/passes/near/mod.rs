//! Irradiance that receivers in narrow places get from their near hits: `N(r) = w_r Σ_y ρ/π·(E_dir(y) + E_emit + E_ind)`.

pub mod reference;

use std::ops::Range;

use glam::Vec4;
use lightkiln_proto::relight::{NearRow, NearTable};

use crate::error::Result;
use crate::passes::direct::{DirectPass, Points};
use crate::passes::gpu::{Gpu, groups_2d};
use crate::passes::resident::{Resident, pages};
use crate::passes::shadow::ShadowPass;

/// The shader.
pub const SHADER: &str = include_str!("near.wgsl");
/// Largest difference from the reference, relative to the largest value: the same sum of at most 255 f32 of one sign in the
/// same order; the adapter may fuse multiply and add.
pub const TOLERANCE: f32 = 1e-5;
/// Threads of a workgroup in the shader.
const THREADS: u32 = 64;

/// Numbers of the pass; twin of `Near` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct NearNumbers {
    /// Receivers with hits.
    pub row_count: u32,
    /// Threads in a row of the dispatch.
    pub stride: u32,
}

/// The pass on the adapter; [`NearPass::light`] gives it E_dir at hits.
#[derive(Debug)]
pub struct NearPass {
    pipeline: wgpu::ComputePipeline,
    pages: Vec<Page>,
}

/// Receivers whose hits fit into one binding.
#[derive(Debug)]
struct Page {
    direct: DirectPass,
    #[cfg_attr(not(test), expect(dead_code, reason = "read by tests"))]
    e_dir: wgpu::Buffer,
    #[cfg_attr(not(test), expect(dead_code, reason = "read by tests"))]
    hits: usize,
    group: wgpu::BindGroup,
    groups: [u32; 2],
}

impl NearPass {
    /// Uploads the hits.
    pub fn new(gpu: &Gpu, table: &NearTable, shadow: &ShadowPass, resident: &Resident) -> Result<Self> {
        let pipeline = gpu.compute("near hits", SHADER, "gather");
        let rows = &table.rows;
        let bytes = rows.iter().map(|row| u64::from(row.count) * size_of::<Vec4>() as u64);
        let page = |run: Range<usize>| Page::new(gpu, table, &rows[run], shadow, resident, &pipeline);
        let pages =
            pages(gpu, "receiver's near hits", bytes)?.into_iter().map(page).collect::<Result<_>>()?;
        Ok(Self { pipeline, pages })
    }

    /// Records E_dir at hits.
    pub fn light(&self, pass: &mut wgpu::ComputePass<'_>, shadow: &ShadowPass) {
        self.pages.iter().for_each(|page| page.direct.record(pass, shadow));
    }

    /// Records the sums over hits; E_ind is still that of the frame before.
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>) {
        pass.set_pipeline(&self.pipeline);
        for page in &self.pages {
            pass.set_bind_group(0, &page.group, &[]);
            pass.dispatch_workgroups(page.groups[0], page.groups[1], 1);
        }
    }

    /// E_dir by hit, W·m⁻², page by page.
    #[cfg(test)]
    pub(crate) fn read_e_dir(&self, gpu: &Gpu) -> Result<Vec<Vec<Vec4>>> {
        self.pages.iter().map(|page| gpu.read(&page.e_dir, page.hits)).collect()
    }
}

impl Page {
    fn new(
        gpu: &Gpu,
        table: &NearTable,
        rows: &[NearRow],
        shadow: &ShadowPass,
        resident: &Resident,
        pipeline: &wgpu::ComputePipeline,
    ) -> Result<Self> {
        let start = rows.first().map_or(0, |row| row.first);
        let end = rows.last().map_or(0, |row| row.first + row.count);
        let hits = start as usize..end as usize;
        let e_dir = gpu.blank("E_dir of near hits", (hits.len() * size_of::<Vec4>()) as u64)?;
        let points = Points {
            count: hits.len() as u32,
            positions: &gpu.storage("near hits", &table.position_m[hits.clone()])?,
            normals: &gpu.storage("normals of near hits", &table.normal[hits.clone()])?,
            e_dir: &e_dir,
        };
        let direct = DirectPass::new(gpu, shadow, points);
        let count = hits.len();
        let rows: Vec<NearRow> =
            rows.iter().map(|row| NearRow { first: row.first - start, ..*row }).collect();
        let groups = groups_2d((rows.len() as u32).div_ceil(THREADS));
        let numbers = NearNumbers { row_count: rows.len() as u32, stride: groups[0] * THREADS };
        let group = gpu.bind(
            &pipeline.get_bind_group_layout(0),
            &[
                gpu.uniform("near", &numbers).as_entire_binding(),
                gpu.storage("receivers with near hits", &rows)?.as_entire_binding(),
                gpu.storage("slots of near hits", &table.slots[hits.clone()])?.as_entire_binding(),
                gpu.storage("albedo of near hits", &table.albedo[hits])?.as_entire_binding(),
                e_dir.as_entire_binding(),
                resident.e_emit.as_entire_binding(),
                resident.e_ind.as_entire_binding(),
                resident.e_near.as_entire_binding(),
            ],
        );
        Ok(Self { direct, e_dir, hits: count, group, groups })
    }
}
