//! Radiance at the probes' hits → probe coefficients: `λ_pj = 4π/K Σ_k L(y_pk) Y_j(ω_k)`.

pub mod reference;

use lightkiln_proto::kinds::sh::ProbeTable;
use lightkiln_proto::relight::Columns;

use crate::error::Result;
use crate::passes::gpu::Gpu;
use crate::passes::resident::{ColumnsPass, Resident};

/// The shader.
pub const SHADER: &str = include_str!("relight.wgsl");
/// Largest difference from the reference, relative to the largest value: the same sum of K f32 in the same order; the
/// adapter may fuse multiply and add.
pub const TOLERANCE: f32 = 1e-5;

/// Numbers of one page of hits; twin of `Relight` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct RelightNumbers {
    /// First probe of the page.
    pub first_probe: u32,
    /// Receivers; hits above are the sky or dark and give nothing.
    pub receiver_count: u32,
    /// Relight rays per probe K.
    pub rays: u32,
    /// Coefficients per probe J.
    pub coefficients: u32,
}

/// The pass on the adapter: one dispatch per page of hits.
#[derive(Debug)]
pub struct RelightPass {
    pipeline: wgpu::ComputePipeline,
    pages: Vec<(wgpu::BindGroup, u32)>,
}

/// Most probes of one dispatch.
const PROBES_MAX: usize = 32_768;

impl RelightPass {
    /// Uploads hits and the rays' basis.
    pub fn new(gpu: &Gpu, table: &ProbeTable, resident: &Resident) -> Result<Self> {
        let pipeline = gpu.compute("relight", SHADER, "project");
        let basis = gpu.storage("relight basis", &table.basis)?;
        let rays = table.relight_rays as usize;
        let probes_per_page = (gpu.binding_max as usize / (4 * rays)).clamp(1, PROBES_MAX);
        let probe_count = table.len();
        let mut pages = Vec::new();
        for first in (0..probe_count).step_by(probes_per_page) {
            let end = (first + probes_per_page).min(probe_count);
            let hits = &table.hits[first * rays..end * rays];
            let numbers = RelightNumbers {
                first_probe: first as u32,
                receiver_count: resident.receiver_count as u32,
                rays: table.relight_rays,
                coefficients: table.coefficients() as u32,
            };
            let group = gpu.bind(
                &pipeline.get_bind_group_layout(0),
                &[
                    gpu.uniform("relight", &numbers).as_entire_binding(),
                    gpu.storage("hits", hits)?.as_entire_binding(),
                    resident.albedo.as_entire_binding(),
                    resident.e_dir.as_entire_binding(),
                    resident.e_emit.as_entire_binding(),
                    resident.e_ind.as_entire_binding(),
                    basis.as_entire_binding(),
                    resident.lambda.as_entire_binding(),
                ],
            );
            pages.push((group, (end - first) as u32));
        }
        Ok(Self { pipeline, pages })
    }
}

impl ColumnsPass for RelightPass {
    fn record(&self, pass: &mut wgpu::ComputePass<'_>) {
        pass.set_pipeline(&self.pipeline);
        for (group, probes) in &self.pages {
            pass.set_bind_group(0, group, &[]);
            pass.dispatch_workgroups(*probes, 1, 1);
        }
    }
}
