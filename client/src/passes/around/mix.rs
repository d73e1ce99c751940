//! Irradiance at an object's receivers of what its viewpoints see, on the adapter.

use glam::Vec4;
use lightkiln_proto::relight::SkyRows;

use super::{AroundPass, MIX_SHADER, THREADS};
use crate::error::Result;
use crate::passes::gpu::{Gpu, groups_2d};

/// Parts of the sphere in a word of a receiver's row.
const PARTS_A_WORD: usize = 4;

/// Numbers of the pass; twin of `MixNumbers` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct MixNumbers {
    /// Receivers.
    pub count: u32,
    /// Threads in a row of the dispatch.
    pub stride: u32,
    /// Words of a receiver's row.
    pub words: u32,
}

/// The pass on the adapter.
#[derive(Debug)]
pub struct MixPass {
    pipeline: wgpu::ComputePipeline,
    group: wgpu::BindGroup,
    groups: [u32; 2],
    /// The mean by slot, W·m⁻².
    pub e_around: wgpu::Buffer,
}

impl MixPass {
    /// Of receivers at positions, with the irradiance that parts of the sphere give them.
    pub fn new(gpu: &Gpu, around: &AroundPass, rows: &SkyRows, positions: &wgpu::Buffer) -> Result<Self> {
        let pipeline = gpu.compute("light of viewpoints", MIX_SHADER, "mix_viewpoints");
        let count = rows.receivers();
        let groups = groups_2d((count as u32).div_ceil(THREADS));
        let e_around = gpu.blank("E of what is around", (count * size_of::<Vec4>()) as u64)?;
        let words = rows.parts().div_ceil(PARTS_A_WORD);
        let numbers = MixNumbers { count: count as u32, stride: groups[0] * THREADS, words: words as u32 };
        let mut table = Vec::with_capacity(count * words);
        for slot in 0..count {
            let word = |parts: &[f32]| {
                let mut four = [0.0; PARTS_A_WORD];
                four[..parts.len()].copy_from_slice(parts);
                Vec4::from(four)
            };
            table.extend(rows.row(slot).chunks(PARTS_A_WORD).map(word));
        }
        let (numbers, table) = (
            gpu.uniform("light of viewpoints", &numbers),
            gpu.storage("parts of the sphere at receivers", &table)?,
        );
        let buffers =
            [&around.viewpoints, &around.present, &numbers, positions, &around.around, &table, &e_around];
        let group =
            gpu.bind(&pipeline.get_bind_group_layout(0), &buffers.map(wgpu::Buffer::as_entire_binding));
        Ok(Self { pipeline, group, groups, e_around })
    }

    /// Records the pass.
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.group, &[]);
        pass.dispatch_workgroups(self.groups[0], self.groups[1], 1);
    }
}
