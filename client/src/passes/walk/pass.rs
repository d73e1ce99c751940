//! Walks on the adapter.

use glam::{IVec3, Vec3, Vec4};
use lightkiln_proto::relight::PatchTable;
use lightkiln_proto::voxels::{
    Glow, IRRADIANCE_WALKS, OCCLUSION_WALKS, REFLECTION_WALKS, VoxelTable, first_of_sky, glows_of,
    sky_directions,
};
use wgpu::ShaderStages as Stages;

use super::{SHADER, Walks, sample_identity};
use crate::error::Result;
use crate::passes::gpu::{Gpu, array_view, storage_read, texture, uniform};
use crate::passes::shade::{ShadeView, StartTextures};
use crate::passes::show::whole_pipeline;
use crate::passes::stopwatch::Recorder;

/// Side of a workgroup in pixels.
const GROUP: u32 = 8;

/// Numbers of a table; twin of `Voxels` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct WalkNumbers {
    /// Least tick of all bricks' box.
    pub low: IVec3,
    /// The coarsest level.
    pub top: u32,
    /// The box's end.
    pub high: IVec3,
    /// Levels above 0 that have elements of surfaces without elements below, a bit each.
    pub finest: u32,
    /// Side of voxels of level 0 in metres.
    pub voxel_m: f32,
    /// Levels that have bricks, a bit each.
    pub levels: u32,
    /// The last slot.
    pub slot_last: u32,
    /// Place of the sky's first part in λ.
    pub first_of_sky: u32,
    /// Parts of the sky.
    pub sky_parts: u32,
    /// Place of their directions behind the glows.
    pub first_direction: u32,
    /// Bricks.
    pub bricks: u32,
    /// 0.
    pub pad: u32,
}

/// Numbers of a picture's pixels; twin of `Pixels` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct WalkPixels {
    /// Of the picture.
    pub size: [u32; 2],
    /// Pixels that walks are of.
    pub cells: [u32; 2],
    /// Pixels of the picture along a side of such a one.
    pub step: u32,
    /// Identity of the sample.
    pub turn: u32,
    /// Walks for reflections, 0 without.
    pub reflections: u32,
    /// For occlusion.
    pub occlusion: u32,
    /// For irradiance.
    pub irradiance: u32,
    /// Reach of occlusion in metres.
    pub reach_m: f32,
    /// 0.
    pub pad: [u32; 2],
    /// Columns of the inverse projection.
    pub world_from_clip: [[f32; 4]; 4],
}

/// Elements on the adapter, with the light that they name.
#[derive(Debug)]
pub struct WalkTable {
    layout: wgpu::BindGroupLayout,
    group: wgpu::BindGroup,
    glows: wgpu::Buffer,
    glow_count: usize,
}

impl WalkTable {
    /// Uploads a table whose elements have their radiance in λ.
    pub fn new(
        gpu: &Gpu,
        (table, patches): (&VoxelTable, &PatchTable),
        lambda: &wgpu::Buffer,
    ) -> Result<Self> {
        let mut kinds = vec![(Stages::COMPUTE | Stages::FRAGMENT, uniform(false))];
        kinds.extend([(Stages::COMPUTE | Stages::FRAGMENT, storage_read()); 7]);
        let layout = gpu.bind_layout(&kinds);
        let glow_count = table.glows.len();
        let numbers = WalkNumbers {
            low: table.low,
            top: table.top_level(),
            high: table.high,
            finest: table.finest,
            voxel_m: table.voxel_m,
            levels: table.levels,
            slot_last: table.slots.len().saturating_sub(1) as u32,
            first_of_sky: first_of_sky(patches) as u32,
            sky_parts: patches.sky_parts,
            first_direction: glow_count as u32,
            bricks: table.len() as u32,
            pad: 0,
        };
        let dark = std::iter::repeat_n(Vec4::ZERO, glow_count);
        let directions = sky_directions(patches).into_iter().map(|direction| direction.extend(0.0));
        let glows = gpu.storage("glows", &dark.chain(directions).collect::<Vec<_>>())?;
        let buffers = [
            gpu.uniform("walk", &numbers),
            gpu.storage("slots of bricks", &table.slots)?,
            gpu.storage("bricks", &table.bricks)?,
            gpu.storage("masks of bricks", &table.words)?,
            gpu.storage("elements of voxels", &table.first_elements)?,
            gpu.storage("elements", &table.elements)?,
        ];
        let mut resources: Vec<_> = buffers.iter().map(wgpu::Buffer::as_entire_binding).collect();
        resources.extend([lambda, &glows].map(wgpu::Buffer::as_entire_binding));
        let group = gpu.bind(&layout, &resources);
        Ok(Self { layout, group, glows, glow_count })
    }

    /// Layout and group of what walks read: group 0.
    pub(in crate::passes) fn bound(&self) -> (&wgpu::BindGroupLayout, &wgpu::BindGroup) {
        (&self.layout, &self.group)
    }

    /// Writes the radiance of glows from that of each emitter, W·m⁻²·sr⁻¹.
    pub fn set_emitters(&self, gpu: &Gpu, table: &VoxelTable, emitters: impl Fn(u16) -> Vec3) {
        let row = |(radiance, glow): (Vec3, &Glow)| radiance.extend(glow.emitter.into());
        let glows: Vec<Vec4> = glows_of(table, emitters).into_iter().zip(&table.glows).map(row).collect();
        debug_assert_eq!(glows.len(), self.glow_count);
        gpu.write(&self.glows, &glows);
    }
}

#[cfg(test)]
impl WalkTable {
    /// Runs a shader of walks with bindings of its own in group 1.
    pub(super) fn run(
        &self,
        gpu: &Gpu,
        (source, entry): (&str, &str),
        (layout, group): (&wgpu::BindGroupLayout, &wgpu::BindGroup),
        groups: u32,
    ) {
        let of_both = gpu.pipeline_layout(&[&self.layout, layout]);
        let pipeline = gpu.compute_with((entry, source, entry), Some(&of_both), &[]);
        gpu.submit(|encoder| {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, &self.group, &[]);
            pass.set_bind_group(1, group, &[]);
            pass.dispatch_workgroups(groups, 1, 1);
        });
    }
}

/// Walks of the pixels of pictures of one size.
#[derive(Debug)]
pub struct WalkPass {
    walk: wgpu::ComputePipeline,
    seen: wgpu::RenderPipeline,
    layout: wgpu::BindGroupLayout,
    seen_group: wgpu::BindGroup,
    pixels: wgpu::Buffer,
    found: Option<(wgpu::BindGroup, wgpu::TextureView, [u32; 2])>,
}

impl WalkPass {
    /// Makes pipelines; `view` is the shading's.
    pub fn new(gpu: &Gpu, table: &WalkTable, view: &wgpu::Buffer) -> Self {
        let flat = wgpu::TextureViewDimension::D2;
        let layout = gpu.bind_layout(&[
            (Stages::COMPUTE, uniform(false)),
            (Stages::COMPUTE, uniform(false)),
            (Stages::COMPUTE, texture(wgpu::TextureSampleType::Float { filterable: false }, flat)),
            (Stages::COMPUTE, texture(wgpu::TextureSampleType::Uint, flat)),
            (
                Stages::COMPUTE,
                wgpu::BindingType::StorageTexture {
                    access: wgpu::StorageTextureAccess::WriteOnly,
                    format: wgpu::TextureFormat::Rgba32Float,
                    view_dimension: wgpu::TextureViewDimension::D2Array,
                },
            ),
        ]);
        let of_pixels = gpu.pipeline_layout(&[&table.layout, &layout]);
        let walk = gpu.compute_with(("walks of pixels", SHADER, "walk_pixels"), Some(&of_pixels), &[]);
        let both = Stages::VERTEX_FRAGMENT;
        let seen_layout = gpu.bind_layout(&[(both, uniform(false)), (Stages::FRAGMENT, uniform(false))]);
        let pixels = gpu.buffer("pixels", size_of::<WalkPixels>() as u64, wgpu::BufferUsages::UNIFORM);
        let seen_group = gpu.bind(&seen_layout, &[view.as_entire_binding(), pixels.as_entire_binding()]);
        let of_eye = gpu.pipeline_layout(&[&table.layout, &seen_layout]);
        let module = gpu.module("walks of the eye", SHADER);
        let format = wgpu::TextureFormat::Rgba32Float;
        let seen = whole_pipeline(gpu, &of_eye, (&module, ["sky_corner", "seen"]), (format, None));
        Self { walk, seen, layout, seen_group, pixels, found: None }
    }

    /// Makes room for what walks from the starts of a picture of `size` pixels find.
    pub fn make_room(
        &mut self,
        gpu: &Gpu,
        view: &wgpu::Buffer,
        starts: &StartTextures,
        (size, walks): ([u32; 2], &Walks),
    ) -> Result<()> {
        let cells = size.map(|side| side.div_ceil(walks.step));
        let layers = if walks.irradiance { 2 } else { 1 };
        let walked = walked_texture(gpu, cells, layers)?;
        let resources = [
            view.as_entire_binding(),
            self.pixels.as_entire_binding(),
            wgpu::BindingResource::TextureView(&starts.points),
            wgpu::BindingResource::TextureView(&starts.normals),
            wgpu::BindingResource::TextureView(&walked),
        ];
        self.found = Some((gpu.bind(&self.layout, &resources), walked, cells));
        Ok(())
    }

    /// Lets go of that room.
    pub fn drop_room(&mut self) {
        self.found = None;
    }

    /// Radiance and shares that walks found.
    pub fn walked(&self) -> Option<&wgpu::TextureView> {
        self.found.as_ref().map(|(_, walked, _)| walked)
    }

    /// Sets the view and what is to be found.
    pub fn set(&self, gpu: &Gpu, view: &ShadeView, (size, walks): ([u32; 2], &Walks), jitter: [f32; 2]) {
        let count = |is: bool, walks: u32| if is { walks } else { 0 };
        let pixels = WalkPixels {
            size,
            cells: size.map(|side| side.div_ceil(walks.step)),
            step: walks.step,
            turn: sample_identity(jitter),
            reflections: count(walks.reflections, REFLECTION_WALKS),
            occlusion: count(walks.occlusion_m.is_some(), OCCLUSION_WALKS),
            irradiance: count(walks.irradiance, IRRADIANCE_WALKS),
            reach_m: walks.occlusion_m.unwrap_or(1.0),
            pad: [0; 2],
            world_from_clip: view.projection().inverse().to_cols_array_2d(),
        };
        gpu.write(&self.pixels, &[pixels]);
    }

    /// Walks from the starts.
    pub fn record(&self, encoder: &mut Recorder<'_>, table: &WalkTable) {
        let Some((group, _, cells)) = &self.found else { return };
        let mut pass = encoder.compute("walk");
        pass.set_pipeline(&self.walk);
        pass.set_bind_group(0, &table.group, &[]);
        pass.set_bind_group(1, group, &[]);
        let [columns, rows] = cells.map(|along| along.div_ceil(GROUP));
        pass.dispatch_workgroups(columns, rows, 1);
    }

    /// Draws what walks from the eye meet over a picture.
    pub fn draw_seen(&self, encoder: &mut Recorder<'_>, table: &WalkTable, picture: &wgpu::TextureView) {
        let mark = encoder.mark("walks of the eye");
        let ops = wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("walks of the eye"),
            timestamp_writes: mark.as_ref().and_then(|mark| mark.writes(true, true)),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: picture,
                depth_slice: None,
                resolve_target: None,
                ops,
            })],
            ..Default::default()
        });
        pass.set_pipeline(&self.seen);
        pass.set_bind_group(0, &table.group, &[]);
        pass.set_bind_group(1, &self.seen_group, &[]);
        pass.draw(0..3, 0..1);
    }
}

/// A texture for what walks find: reflected radiance and the share that is open; irradiance in a second layer.
pub fn walked_texture(gpu: &Gpu, size: [u32; 2], layers: u32) -> Result<wgpu::TextureView> {
    let texture = gpu.texture(&wgpu::TextureDescriptor {
        label: Some("walked"),
        size: wgpu::Extent3d { width: size[0], height: size[1], depth_or_array_layers: layers },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::Rgba32Float,
        usage: wgpu::TextureUsages::STORAGE_BINDING | wgpu::TextureUsages::TEXTURE_BINDING,
        view_formats: &[],
    })?;
    Ok(array_view(&texture))
}
