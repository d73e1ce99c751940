//! Irradiance that receivers in narrow places get from their near hits: `N(r) = w_r Σ_y ρ/π·(E_dir(y) + E_emit + E_ind)`.

pub mod reference;

use std::ops::Range;

use glam::Vec4;
use lightkiln_proto::relight::{NearHit, NearRow, NearTable};
use wgpu::ShaderStages as Stages;

use crate::error::Result;
use crate::passes::gpu::{Gpu, groups_2d, storage_read, storage_write, uniform};
use crate::passes::resident::{Resident, pages};
use crate::passes::shadow::ShadowPass;

/// The shader of the sums.
pub const SHADER: &str = concat!(include_str!("hits.wgsl"), include_str!("near.wgsl"));
/// The shader of what comes straight from lights, with the lights' part in front.
pub const LIT_SHADER: &str = concat!(
    include_str!("../shared/light.wgsl"),
    include_str!("../shared/rect.wgsl"),
    include_str!("../shared/shadow_map.wgsl"),
    include_str!("../shared/whole_maps.wgsl"),
    include_str!("../shared/unplaced.wgsl"),
    include_str!("hits.wgsl"),
    include_str!("lit.wgsl")
);
/// That shader for an object's receivers.
pub const PLACED_LIT_SHADER: &str = concat!(
    include_str!("../shared/light.wgsl"),
    include_str!("../shared/rect.wgsl"),
    include_str!("../shared/shadow_map.wgsl"),
    include_str!("../shared/whole_maps.wgsl"),
    include_str!("../shared/placed.wgsl"),
    include_str!("hits.wgsl"),
    include_str!("lit.wgsl")
);
/// Largest difference from the reference, relative to the largest value: the same sum of at most 255 f32 of one sign in the
/// same order; the adapter may fuse multiply and add.
pub const TOLERANCE: f32 = 1e-5;
/// Threads of a workgroup in the shaders.
const THREADS: u32 = 64;

/// Numbers of the pass; twin of `Near` in the shaders.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct NearNumbers {
    /// Receivers with hits.
    pub row_count: u32,
    /// Threads in a row of the dispatch.
    pub stride: u32,
}

/// The pass on the adapter; [`NearPass::light`] gives it what comes straight from lights.
#[derive(Debug)]
pub struct NearPass {
    light: wgpu::ComputePipeline,
    gather: wgpu::ComputePipeline,
    pages: Vec<Page>,
    /// Of an object's receivers.
    place: Option<wgpu::BindGroup>,
}

/// Receivers whose hits fit into one binding.
#[derive(Debug)]
struct Page {
    light: wgpu::BindGroup,
    gather: wgpu::BindGroup,
    groups: [u32; 2],
    #[cfg_attr(not(test), expect(dead_code, reason = "read by tests"))]
    lit: wgpu::Buffer,
    #[cfg_attr(not(test), expect(dead_code, reason = "read by tests"))]
    rows: usize,
}

impl NearPass {
    /// Uploads the hits.
    pub fn new(gpu: &Gpu, table: &NearTable, shadow: &ShadowPass, resident: &Resident) -> Result<Self> {
        let read = storage_read;
        let kinds = [uniform(false), read(), read(), read(), read(), read(), storage_write()];
        let layout = gpu.bind_layout(&kinds.map(|kind| (Stages::COMPUTE, kind)));
        let (pipeline_layout, shader) = match &resident.place {
            None => (gpu.pipeline_layout(&[&shadow.light_layout, &layout]), LIT_SHADER),
            Some(place) => {
                let groups = [&shadow.light_layout, &layout, &place.layout];
                (gpu.pipeline_layout(&groups), PLACED_LIT_SHADER)
            }
        };
        let light =
            gpu.compute_with(("light of near hits", shader, "light_hits"), Some(&pipeline_layout), &[]);
        let gather = gpu.compute("near hits", SHADER, "gather");
        let own = gpu.storage("surfaces of near hits", &table.own)?;
        let page = |run: Range<usize>| {
            let rows = &table.rows[run];
            let start = rows.first().map_or(0, |row| row.first);
            let end = rows.last().map_or(0, |row| row.first + row.count);
            let of_page: Vec<NearRow> =
                rows.iter().map(|row| NearRow { first: row.first - start, ..*row }).collect();
            let groups = groups_2d((rows.len() as u32).div_ceil(THREADS));
            let numbers = NearNumbers { row_count: rows.len() as u32, stride: groups[0] * THREADS };
            let numbers = gpu.uniform("near", &numbers);
            let rows_buffer = gpu.storage("receivers with near hits", &of_page)?;
            let hits = gpu.storage("near hits", &table.hits[start as usize..end as usize])?;
            let lit = gpu.blank("light of near hits", (rows.len() * size_of::<Vec4>()) as u64)?;
            let shared = [&numbers, &rows_buffer, &hits, &own];
            let bound = |others: &[&wgpu::Buffer], layout: &wgpu::BindGroupLayout| {
                let buffers = shared.iter().chain(others);
                let resources: Vec<_> = buffers.map(|buffer| buffer.as_entire_binding()).collect();
                gpu.bind(layout, &resources)
            };
            let Resident { normals, albedo, e_emit, e_ind, e_near, .. } = resident;
            Ok(Page {
                light: bound(&[normals, albedo, &lit], &layout),
                gather: bound(&[albedo, &lit, e_emit, e_ind, e_near], &gather.get_bind_group_layout(0)),
                groups,
                lit,
                rows: rows.len(),
            })
        };
        // Rows and sums have as many bytes as hits, of which each has one at least.
        let bytes = table.rows.iter().map(|row| u64::from(row.count) * size_of::<NearHit>() as u64);
        let pages =
            pages(gpu, "receiver's near hits", bytes)?.into_iter().map(page).collect::<Result<_>>()?;
        let place = resident.place.as_ref().map(|place| place.group.clone());
        Ok(Self { light, gather, pages, place })
    }

    /// Records what comes straight from lights.
    pub fn light(&self, pass: &mut wgpu::ComputePass<'_>, shadow: &ShadowPass) {
        pass.set_pipeline(&self.light);
        pass.set_bind_group(0, &shadow.light_group, &[]);
        if let Some(place) = &self.place {
            pass.set_bind_group(2, place, &[]);
        }
        for page in &self.pages {
            pass.set_bind_group(1, &page.light, &[]);
            pass.dispatch_workgroups(page.groups[0], page.groups[1], 1);
        }
    }

    /// Records the sums over hits; E_ind is still that of the frame before.
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>) {
        pass.set_pipeline(&self.gather);
        for page in &self.pages {
            pass.set_bind_group(0, &page.gather, &[]);
            pass.dispatch_workgroups(page.groups[0], page.groups[1], 1);
        }
    }

    /// Σ ρ/π E_dir by receiver with hits, W·m⁻², page by page.
    #[cfg(test)]
    pub(crate) fn read_lit(&self, gpu: &Gpu) -> Result<Vec<Vec<Vec4>>> {
        self.pages.iter().map(|page| gpu.read(&page.lit, page.rows)).collect()
    }
}
