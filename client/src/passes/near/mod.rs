//! Irradiance that receivers in narrow places get from their near hits: `N(r) = w_r Σ_y ρ/π·(E_dir(y) + E_emit + E_ind)`.

pub mod reference;

use glam::Vec4;

use crate::bake::LoadedBake;
use crate::error::Result;
use crate::passes::direct::{DirectPass, Points};
use crate::passes::gpu::{Gpu, groups_2d};
use crate::passes::resident::Resident;
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
    direct: DirectPass,
    /// E_dir by hit, W·m⁻².
    pub e_dir: wgpu::Buffer,
    pipeline: wgpu::ComputePipeline,
    group: wgpu::BindGroup,
    groups: [u32; 2],
}

impl NearPass {
    /// Uploads the hits.
    pub fn new(gpu: &Gpu, bake: &LoadedBake, shadow: &ShadowPass, resident: &Resident) -> Result<Self> {
        let table = &bake.near;
        let e_dir = gpu.blank("E_dir of near hits", (table.len() * size_of::<Vec4>()) as u64)?;
        let points = Points {
            count: table.len() as u32,
            positions: &gpu.storage("near hits", &table.position_m)?,
            normals: &gpu.storage("normals of near hits", &table.normal)?,
            e_dir: &e_dir,
        };
        let direct = DirectPass::new(gpu, shadow, points);
        let pipeline = gpu.compute("near hits", SHADER, "gather");
        let groups = groups_2d((table.rows.len() as u32).div_ceil(THREADS));
        let numbers = NearNumbers { row_count: table.rows.len() as u32, stride: groups[0] * THREADS };
        let group = gpu.bind(
            &pipeline.get_bind_group_layout(0),
            &[
                gpu.uniform("near", &numbers).as_entire_binding(),
                gpu.storage("receivers with near hits", &table.rows)?.as_entire_binding(),
                gpu.storage("slots of near hits", &table.slots)?.as_entire_binding(),
                gpu.storage("albedo of near hits", &table.albedo)?.as_entire_binding(),
                e_dir.as_entire_binding(),
                resident.e_emit.as_entire_binding(),
                resident.e_ind.as_entire_binding(),
                resident.e_near.as_entire_binding(),
            ],
        );
        Ok(Self { direct, e_dir, pipeline, group, groups })
    }

    /// Records E_dir at hits.
    pub fn light(&self, pass: &mut wgpu::ComputePass<'_>, shadow: &ShadowPass) {
        self.direct.record(pass, shadow);
    }

    /// Records the sums over hits; E_ind is still that of the frame before.
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.group, &[]);
        pass.dispatch_workgroups(self.groups[0], self.groups[1], 1);
    }
}
