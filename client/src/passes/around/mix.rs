//! Irradiance at an object's receivers of what its viewpoints see, on the adapter.

use glam::Vec4;

use super::{AroundPass, MIX_SHADER, THREADS, VIEWPOINTS_MAX};
use crate::error::Result;
use crate::passes::gpu::{Gpu, groups_2d};

/// Numbers of the pass; twin of `MixNumbers` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct MixNumbers {
    /// Receivers.
    pub count: u32,
    /// Threads in a row of the dispatch.
    pub stride: u32,
    /// The viewpoint whose light is added.
    pub viewpoint: u32,
}

/// The pass on the adapter.
#[derive(Debug)]
pub struct MixPass {
    pipeline: wgpu::ComputePipeline,
    /// One for each viewpoint.
    turns: Vec<wgpu::BindGroup>,
    groups: [u32; 2],
    /// The mean by slot, W·m⁻².
    pub e_around: wgpu::Buffer,
}

impl MixPass {
    /// Of so many receivers at positions; `e_seen` is the light of one viewpoint after the other.
    pub fn new(
        gpu: &Gpu,
        around: &AroundPass,
        count: usize,
        [positions, e_seen]: [&wgpu::Buffer; 2],
    ) -> Result<Self> {
        let pipeline = gpu.compute("light of viewpoints", MIX_SHADER, "mix_viewpoint");
        let groups = groups_2d((count as u32).div_ceil(THREADS));
        let e_around = gpu.blank("E of what is around", (count * size_of::<Vec4>()) as u64)?;
        let turn = |viewpoint: u32| {
            let numbers = MixNumbers { count: count as u32, stride: groups[0] * THREADS, viewpoint };
            let numbers = gpu.uniform("turn of a viewpoint", &numbers);
            let buffers = [&around.viewpoints, &around.present, &numbers, positions, e_seen, &e_around];
            gpu.bind(&pipeline.get_bind_group_layout(0), &buffers.map(wgpu::Buffer::as_entire_binding))
        };
        let turns = (0..VIEWPOINTS_MAX).map(turn).collect();
        Ok(Self { pipeline, turns, groups, e_around })
    }

    /// Records the turn of a viewpoint; that of the first begins anew.
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>, viewpoint: u32) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.turns[viewpoint as usize], &[]);
        pass.dispatch_workgroups(self.groups[0], self.groups[1], 1);
    }
}
