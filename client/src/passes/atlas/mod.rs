//! Irradiance of receivers spread into the lightmap's pages, chart edges extended into empty texels; and how a surface
//! reads it.

mod placement;
pub mod reference;
mod texels;

use lightkiln_proto::relight::{ReceiverTable, SlotTable};

use crate::error::Result;
use crate::passes::gpu::{Gpu, array_view, groups_2d};
use crate::passes::resident::Resident;
use crate::scene::LightmapLayout;

pub use placement::{Placement, placements};
pub use texels::{AtlasTexel, AtlasTexels};

/// The shader.
pub const SHADER: &str = include_str!("atlas.wgsl");
/// Indirect light of a surface from the pages, for the shading pass: `indirect_irradiance`.
pub const INDIRECT: &str = concat!(include_str!("lightmap.wgsl"), include_str!("indirect.wgsl"));
/// Largest difference from the reference, relative to the largest value: a mean of at most 32 f32 in the same order.
pub const TOLERANCE: f32 = 1e-6;
/// Threads of a workgroup in the shader.
const THREADS: u32 = 64;

/// A lightmap: its layout, which texel is which receiver, and which texels hold irradiance.
#[derive(Clone, Copy, Debug)]
pub struct Lightmap<'a> {
    /// Pages and blocks.
    pub layout: &'a LightmapLayout,
    /// Slot of each texel.
    pub slots: &'a SlotTable,
    /// Receivers by slot.
    pub receivers: &'a ReceiverTable,
    /// Texels that hold irradiance.
    pub texels: &'a AtlasTexels,
}

/// Numbers of the pass; twin of `Atlas` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct AtlasNumbers {
    /// Texels that hold irradiance.
    pub texel_count: u32,
    /// Threads in a row of the dispatch.
    pub stride: u32,
}

/// The pass on the adapter, and the pages that it writes: rgb irradiance, in alpha [`AtlasTexel::kind`].
#[derive(Debug)]
pub struct AtlasPass {
    pipeline: wgpu::ComputePipeline,
    group: wgpu::BindGroup,
    /// Numbers, texels and sources.
    layout: [wgpu::Buffer; 3],
    groups: [u32; 2],
    /// One layer per page, all as large as the largest.
    pub texture: wgpu::Texture,
    /// All layers, even when there is one.
    pub view: wgpu::TextureView,
}

impl AtlasPass {
    /// Uploads the layout.
    pub fn new(
        gpu: &Gpu,
        layout: &LightmapLayout,
        texels: &AtlasTexels,
        resident: &Resident,
    ) -> Result<Self> {
        let pipeline = gpu.compute("atlas", SHADER, "spread");
        let groups = groups_2d((texels.texels.len() as u32).div_ceil(THREADS));
        let numbers = AtlasNumbers { texel_count: texels.texels.len() as u32, stride: groups[0] * THREADS };
        let texture = gpu.texture(&wgpu::TextureDescriptor {
            label: Some("atlas"),
            size: texture_size(layout),
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Rgba32Float,
            usage: wgpu::TextureUsages::STORAGE_BINDING
                | wgpu::TextureUsages::TEXTURE_BINDING
                | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        })?;
        let view = array_view(&texture);
        let layout = [
            gpu.uniform("atlas", &numbers),
            gpu.storage("atlas texels", &texels.texels)?,
            gpu.storage("atlas sources", &texels.sources)?,
        ];
        let group = bind(gpu, &pipeline, &layout, [&resident.e_emit, &resident.e_ind], &view);
        Ok(Self { pipeline, group, layout, groups, texture, view })
    }

    /// The pass with other values by slot, in two parts of which it takes the sum.
    pub fn bind(&self, gpu: &Gpu, parts: [&wgpu::Buffer; 2]) -> wgpu::BindGroup {
        bind(gpu, &self.pipeline, &self.layout, parts, &self.view)
    }

    /// Records the pass.
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>) {
        self.record_of(pass, &self.group);
    }

    /// Records the pass over the values of a group of [`AtlasPass::bind`].
    pub fn record_of(&self, pass: &mut wgpu::ComputePass<'_>, group: &wgpu::BindGroup) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, group, &[]);
        pass.dispatch_workgroups(self.groups[0], self.groups[1], 1);
    }
}

fn bind(
    gpu: &Gpu,
    pipeline: &wgpu::ComputePipeline,
    layout: &[wgpu::Buffer; 3],
    parts: [&wgpu::Buffer; 2],
    pages: &wgpu::TextureView,
) -> wgpu::BindGroup {
    let buffers = layout.iter().chain(parts).map(wgpu::Buffer::as_entire_binding);
    let resources: Vec<_> = buffers.chain([wgpu::BindingResource::TextureView(pages)]).collect();
    gpu.bind(&pipeline.get_bind_group_layout(0), &resources)
}

fn texture_size(layout: &LightmapLayout) -> wgpu::Extent3d {
    let longest = |axis: usize| layout.pages.iter().map(|page| page[axis]).max().unwrap_or(1);
    let depth_or_array_layers = layout.pages.len().max(1) as u32;
    wgpu::Extent3d { width: longest(0), height: longest(1), depth_or_array_layers }
}
