//! Irradiance from lights by shadow maps: at points, and of receivers as the mean over the points of their texels.

pub mod points;
pub mod reference;
mod texels;

use wgpu::ShaderStages as Stages;

use crate::passes::gpu::{Gpu, groups_2d, storage_read, storage_write, uniform};
use crate::passes::shadow::ShadowPass;

pub use points::TexelPoints;
pub use texels::{TEXELS_SHADER, TexelNumbers, TexelsPass};

/// The shader, with the lights' part in front.
pub const SHADER: &str = concat!(
    include_str!("../shared/light.wgsl"),
    include_str!("../shared/shadow_map.wgsl"),
    include_str!("direct.wgsl")
);
/// Largest difference from the reference on the same shadow maps, relative to the largest value, for all but
/// [`OUTLIERS`]: positions are projected in f32, and the filter's weights follow the projected position.
pub const TOLERANCE: f32 = 2e-3;
/// Share of points that may differ more: a texel's depth comparison can fall to either side by one rounding.
pub const OUTLIERS: f32 = 2e-3;
/// Threads of a workgroup in the shader.
const THREADS: u32 = 64;

/// Numbers of the pass; twin of `DirectNumbers` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct DirectNumbers {
    /// Points.
    pub count: u32,
    /// Threads in a row of the dispatch.
    pub stride: u32,
}

/// The pass on the adapter.
#[derive(Debug)]
pub struct DirectPass {
    pipeline: wgpu::ComputePipeline,
    group: wgpu::BindGroup,
    groups: [u32; 2],
}

/// Points to light.
#[derive(Clone, Copy, Debug)]
pub struct Points<'a> {
    /// Number of points.
    pub count: u32,
    /// Positions in metres.
    pub positions: &'a wgpu::Buffer,
    /// Unit normals.
    pub normals: &'a wgpu::Buffer,
    /// E_dir, written by the pass, W·m⁻².
    pub e_dir: &'a wgpu::Buffer,
}

impl DirectPass {
    /// Binds points; the lights are the shadow pass'.
    pub fn new(gpu: &Gpu, shadow: &ShadowPass, points: Points<'_>) -> Self {
        let kinds = [uniform(false), storage_read(), storage_read(), storage_write()];
        let layout = gpu.bind_layout(&kinds.map(|kind| (Stages::COMPUTE, kind)));
        let pipeline_layout = gpu.pipeline_layout(&[&shadow.light_layout, &layout]);
        let pipeline = gpu.compute_with("direct", SHADER, "direct", Some(&pipeline_layout));
        let groups = groups_2d(points.count.div_ceil(THREADS));
        let numbers = DirectNumbers { count: points.count, stride: groups[0] * THREADS };
        let group = gpu.bind(
            &layout,
            &[
                gpu.uniform("points", &numbers).as_entire_binding(),
                points.positions.as_entire_binding(),
                points.normals.as_entire_binding(),
                points.e_dir.as_entire_binding(),
            ],
        );
        Self { pipeline, group, groups }
    }

    /// Records the pass.
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>, shadow: &ShadowPass) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &shadow.light_group, &[]);
        pass.set_bind_group(1, &self.group, &[]);
        pass.dispatch_workgroups(self.groups[0], self.groups[1], 1);
    }
}
