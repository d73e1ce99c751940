//! Radiance at the probes' hits → probe coefficients: `λ_pj = 4π/K Σ_k L(y_pk) Y_j(ω_k)`.

pub mod reference;

use glam::Vec4;
use lightkiln_proto::prt::reconstruct::{relight_basis, sky_coefficients};

use crate::bake::LoadedBake;
use crate::error::Result;
use crate::lights::Sky;
use crate::passes::gpu::Gpu;
use crate::passes::resident::Resident;

/// The shader.
pub const SHADER: &str = include_str!("relight.wgsl");
/// Largest difference from the reference, relative to the largest value: the same sum of K f32 in the same order; the
/// adapter may fuse multiply and add.
pub const TOLERANCE: f32 = 1e-5;

/// What all probes share, and the sky.
#[derive(Clone, Debug, PartialEq)]
pub struct RelightTable {
    /// Rays K.
    pub rays: usize,
    /// Coefficients J.
    pub coefficients: usize,
    /// `4π/K · Y_j(ω_k)` at `k·J + j`.
    pub basis: Vec<f32>,
    /// Coefficients of the sky's radiance, W·m⁻²·sr⁻¹.
    pub sky: Vec<Vec4>,
}

impl RelightTable {
    /// The table of a bake under a sky.
    pub fn new(bake: &LoadedBake, sky: Sky) -> Self {
        let rays = bake.probes.relight_rays;
        let bands = bake.manifest.settings.bands;
        let basis = relight_basis(rays, rays, bands);
        let sky = sky_coefficients(sky.zenith.into(), sky.horizon.into(), bands);
        let sky = sky.into_iter().map(|[r, g, b]| Vec4::new(r, g, b, 0.0)).collect();
        Self { rays: rays as usize, coefficients: bake.coefficients(), basis, sky }
    }
}

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
    /// Uploads hits and table; the sky's coefficients do not change and are written once.
    pub fn new(gpu: &Gpu, bake: &LoadedBake, table: &RelightTable, resident: &Resident) -> Result<Self> {
        let pipeline = gpu.compute("relight", SHADER, "project");
        let basis = gpu.storage("relight basis", &table.basis)?;
        let sky_bytes = size_of_val(&table.sky[..]) as u64;
        let sky_start = (resident.lambda_count * size_of::<Vec4>()) as u64 - sky_bytes;
        gpu.queue.write_buffer(&resident.lambda, sky_start, bytemuck::cast_slice(&table.sky));
        let probes_per_page = (gpu.binding_max as usize / (4 * table.rays)).clamp(1, PROBES_MAX);
        let probe_count = bake.probes.len();
        let mut pages = Vec::new();
        for first in (0..probe_count).step_by(probes_per_page) {
            let end = (first + probes_per_page).min(probe_count);
            let hits = &bake.probes.hits[first * table.rays..end * table.rays];
            let numbers = RelightNumbers {
                first_probe: first as u32,
                receiver_count: bake.receivers.len() as u32,
                rays: table.rays as u32,
                coefficients: table.coefficients as u32,
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

    /// Records the pass.
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>) {
        pass.set_pipeline(&self.pipeline);
        for (group, probes) in &self.pages {
            pass.set_bind_group(0, group, &[]);
            pass.dispatch_workgroups(*probes, 1, 1);
        }
    }
}
