//! Irradiance that objects change at receivers, on the adapter.

use glam::Affine3A;
use wgpu::ShaderStages as Stages;

use super::table::rows_of;
use super::{MoverTable, TEXELS_SHADER};
use crate::passes::gpu::{Gpu, groups_2d, storage_read, storage_write, uniform};
use crate::passes::shadow::ShadowPass;

/// Threads of a workgroup in the shader.
const THREADS: u32 = 64;
/// The number of no object.
const NOBODY: u32 = u32::MAX;

/// Numbers of the pass; twin of `MovedNumbers` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct MovedNumbers {
    /// Rows of the map from the receivers' space to the world.
    pub rows: [[f32; 4]; 3],
    /// Receivers.
    pub count: u32,
    /// Threads in a row of the dispatch.
    pub stride: u32,
    /// The object whose receivers they are, or none.
    pub own: u32,
    /// 0.
    pub pad: u32,
}

/// The receivers of a bake on the adapter, and the irradiance that objects beside it give and take there, each of so many [`Vec4`](glam::Vec4).
#[derive(Clone, Copy, Debug)]
pub struct MovedBuffers<'a> {
    /// Positions in the bake's own space, in metres.
    pub positions: &'a wgpu::Buffer,
    /// Normals.
    pub normals: &'a wgpu::Buffer,
    /// ΔE, W·m⁻².
    pub moved: &'a wgpu::Buffer,
    /// Receivers.
    pub count: usize,
}

/// The pass on the adapter.
#[derive(Debug)]
pub struct MovedPass {
    pipeline: wgpu::ComputePipeline,
    group: wgpu::BindGroup,
    groups: [u32; 2],
    numbers: wgpu::Buffer,
    own: MovedNumbers,
}

impl MovedPass {
    /// At the receivers of a bake, or of one of the objects.
    pub fn new(
        gpu: &Gpu,
        shadow: &ShadowPass,
        table: &MoverTable,
        at: MovedBuffers<'_>,
        own: Option<usize>,
    ) -> Self {
        let read = storage_read;
        let kinds = [uniform(false), read(), read(), storage_write(), read(), read(), read()];
        let layout = gpu.bind_layout(&kinds.map(|kind| (Stages::COMPUTE, kind)));
        let pipeline_layout = gpu.pipeline_layout(&[&shadow.light_layout, &layout]);
        let pipeline = gpu.compute_with(
            ("light by objects", TEXELS_SHADER, "change_texels"),
            Some(&pipeline_layout),
            &[],
        );
        let groups = groups_2d((at.count as u32).div_ceil(THREADS));
        let own = MovedNumbers {
            rows: rows_of(&Affine3A::IDENTITY),
            count: at.count as u32,
            stride: groups[0] * THREADS,
            own: own.map_or(NOBODY, |own| own as u32),
            pad: 0,
        };
        let numbers = gpu.uniform("light by objects", &own);
        let tables = table.buffers();
        let buffers = [&numbers, at.positions, at.normals, at.moved].into_iter().chain(&tables);
        let group = gpu.bind(&layout, &buffers.map(wgpu::Buffer::as_entire_binding).collect::<Vec<_>>());
        Self { pipeline, group, groups, numbers, own }
    }

    /// Writes where the receivers' space stands.
    pub fn set_place(&self, gpu: &Gpu, world_from_own: &Affine3A) {
        gpu.write(&self.numbers, &[MovedNumbers { rows: rows_of(world_from_own), ..self.own }]);
    }

    /// Records the pass.
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>, shadow: &ShadowPass) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &shadow.light_group, &[]);
        pass.set_bind_group(1, &self.group, &[]);
        pass.dispatch_workgroups(self.groups[0], self.groups[1], 1);
    }
}
