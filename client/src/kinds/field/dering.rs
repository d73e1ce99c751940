//! Light at probes without ringing, on the adapter; twin: [`deringed`](lightkiln_proto::kinds::field::deringed).

use lightkiln_proto::kinds::field::{PROBE_ROWS, looks};

use crate::error::Result;
use crate::passes::gpu::Gpu;

/// The shader.
pub const SHADER: &str = include_str!("dering.wgsl");

/// Threads of a workgroup in the shader.
const THREADS: u32 = 64;

/// The pass.
#[derive(Debug)]
pub struct DeringPass {
    pipeline: wgpu::ComputePipeline,
    group: wgpu::BindGroup,
    groups: u32,
}

impl DeringPass {
    /// For rows, [`PROBE_ROWS`] a probe.
    pub fn new(gpu: &Gpu, rows: &wgpu::Buffer, row_count: usize) -> Result<Self> {
        let pipeline = gpu.compute("dering", SHADER, "dering");
        let of_looks = gpu.storage("looks", looks().as_flattened())?;
        let layout = pipeline.get_bind_group_layout(0);
        let group = gpu.bind(&layout, &[of_looks.as_entire_binding(), rows.as_entire_binding()]);
        Ok(Self { pipeline, group, groups: ((row_count / PROBE_ROWS) as u32).div_ceil(THREADS) })
    }

    /// Records the pass.
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.group, &[]);
        pass.dispatch_workgroups(self.groups, 1, 1);
    }
}
