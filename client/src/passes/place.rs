//! Where a bake's own space stands in that of the lights, for the passes that light an object's receivers.

use bytemuck::Zeroable as _;
use glam::Affine3A;
use wgpu::ShaderStages as Stages;

use super::gpu::{Gpu, uniform};
use super::transfer::rows_of;

/// A place; twin of `Place` in the shaders.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct PlaceNumbers {
    /// Rows of the map from its own space to that of the lights, of uniform scale.
    pub rows: [[f32; 4]; 3],
}

/// A place as shaders bind it: group 2 of `placed.wgsl`.
#[derive(Debug)]
pub struct Place {
    numbers: wgpu::Buffer,
    /// Layout of the group.
    pub layout: wgpu::BindGroupLayout,
    /// The group.
    pub group: wgpu::BindGroup,
}

impl Place {
    /// At the origin.
    pub fn new(gpu: &Gpu) -> Self {
        let numbers = gpu.uniform("place", &PlaceNumbers::zeroed());
        let layout = gpu.bind_layout(&[(Stages::COMPUTE, uniform(false))]);
        let group = gpu.bind(&layout, &[numbers.as_entire_binding()]);
        let place = Self { numbers, layout, group };
        place.set(gpu, &Affine3A::IDENTITY);
        place
    }

    /// Writes it.
    pub fn set(&self, gpu: &Gpu, world_from_own: &Affine3A) {
        gpu.write(&self.numbers, &[PlaceNumbers { rows: rows_of(world_from_own) }]);
    }
}
