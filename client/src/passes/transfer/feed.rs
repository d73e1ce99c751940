//! Light that is added to receivers on the adapter.

use crate::passes::gpu::{Gpu, groups_2d};

use super::FEED_SHADER;

/// Threads of a workgroup in the shader.
const THREADS: u32 = 64;

/// Numbers of the pass; twin of `FeedNumbers` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct FeedNumbers {
    /// Receivers.
    pub count: u32,
    /// Threads in a row of the dispatch.
    pub stride: u32,
}

/// The pass on the adapter.
#[derive(Debug)]
pub struct FeedPass {
    pipeline: wgpu::ComputePipeline,
    group: wgpu::BindGroup,
    groups: [u32; 2],
}

impl FeedPass {
    /// `max(result + added, −emit)` by slot.
    pub fn clamped(gpu: &Gpu, count: usize, [added, result, emit]: [&wgpu::Buffer; 3]) -> Self {
        Self::of(gpu, "feed", count, &[(1, added), (2, result), (3, emit)])
    }

    /// `result + added` by slot.
    pub fn plain(gpu: &Gpu, count: usize, [added, result]: [&wgpu::Buffer; 2]) -> Self {
        Self::of(gpu, "add", count, &[(1, added), (2, result)])
    }

    fn of(gpu: &Gpu, entry: &str, count: usize, buffers: &[(u32, &wgpu::Buffer)]) -> Self {
        let pipeline = gpu.compute("feed", FEED_SHADER, entry);
        let groups = groups_2d((count as u32).div_ceil(THREADS));
        let numbers = gpu.uniform("feed", &FeedNumbers { count: count as u32, stride: groups[0] * THREADS });
        let own = buffers.iter().map(|(binding, buffer)| (*binding, buffer.as_entire_binding()));
        let resources: Vec<_> = std::iter::once((0, numbers.as_entire_binding())).chain(own).collect();
        let group = gpu.bind_at(&pipeline.get_bind_group_layout(0), &resources);
        Self { pipeline, group, groups }
    }

    /// Records the pass.
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.group, &[]);
        pass.dispatch_workgroups(self.groups[0], self.groups[1], 1);
    }
}
