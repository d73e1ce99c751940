//! Where walks of a picture's pixels start: a point, its slopes' width, its normals.

use wgpu::ShaderStages as Stages;

use crate::error::Result;
use crate::passes::gpu::{Gpu, storage_read, texture, uniform};
use crate::passes::meshes::vertex_layout;
use crate::passes::shadow::nearer_wins;

use super::looks::ShadeDraw;
use super::pipelines::{Program, pipeline_to};

/// Formats: points and slopes' width; octahedral normal and facet.
const FORMATS: [wgpu::TextureFormat; 2] = [wgpu::TextureFormat::Rgba32Float, wgpu::TextureFormat::Rg32Uint];

/// Textures of one size.
#[derive(Debug)]
pub struct StartTextures {
    /// Points in metres; then slopes' width, below 0 where nothing is seen.
    pub points: wgpu::TextureView,
    /// Codes of shading normals and facets.
    pub normals: wgpu::TextureView,
}

impl StartTextures {
    /// For pictures of `size` pixels.
    pub(super) fn new(gpu: &Gpu, size: [u32; 2]) -> Result<Self> {
        let create = |label, format| -> Result<wgpu::TextureView> {
            let texture = gpu.texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d { width: size[0], height: size[1], depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING,
                view_formats: &[],
            })?;
            Ok(texture.create_view(&wgpu::TextureViewDescriptor::default()))
        };
        Ok(Self { points: create("starts of walks", FORMATS[0])?, normals: create("normals", FORMATS[1])? })
    }

    /// Attachments of a pass that begins with nothing seen.
    pub(super) fn attachments(&self) -> [Option<wgpu::RenderPassColorAttachment<'_>>; 2] {
        let nothing = wgpu::Color { a: -1.0, ..wgpu::Color::TRANSPARENT };
        [(&self.points, nothing), (&self.normals, wgpu::Color::TRANSPARENT)].map(|(view, clear)| {
            let ops = wgpu::Operations { load: wgpu::LoadOp::Clear(clear), store: wgpu::StoreOp::Store };
            Some(wgpu::RenderPassColorAttachment { view, depth_slice: None, resolve_target: None, ops })
        })
    }
}

/// Pipelines that write them, of single-sided and of double-sided surfaces.
pub(super) fn pipelines(
    gpu: &Gpu,
    layout: &wgpu::PipelineLayout,
    program: Program<'_>,
) -> [wgpu::RenderPipeline; 2] {
    let targets = FORMATS.map(|format| {
        Some(wgpu::ColorTargetState { format, blend: None, write_mask: wgpu::ColorWrites::ALL })
    });
    [Some(wgpu::Face::Back), None].map(|cull_mode| {
        let primitive = wgpu::PrimitiveState { cull_mode, ..Default::default() };
        let buffers = [Some(vertex_layout())];
        pipeline_to(gpu, layout, program, &buffers, primitive, (nearer_wins(), &targets))
    })
}

/// Kinds of the bindings of a draw: its look, what walks found, where they started, and objects with bakes of their own, if any.
pub(super) fn draw_kinds(has_objects: bool) -> Vec<(Stages, wgpu::BindingType)> {
    let (layers, one) = (wgpu::TextureViewDimension::D2Array, wgpu::TextureViewDimension::D2);
    let float = wgpu::TextureSampleType::Float { filterable: false };
    let mut kinds = vec![
        (Stages::VERTEX_FRAGMENT, uniform(true)),
        (Stages::FRAGMENT, texture(float, layers)),
        (Stages::FRAGMENT, texture(float, one)),
        (Stages::FRAGMENT, texture(wgpu::TextureSampleType::Uint, one)),
    ];
    if has_objects {
        kinds.extend([(); 3].map(|()| (Stages::FRAGMENT, storage_read())));
    }
    kinds
}

/// Binds looks of draws, what walks found, where they started, and objects with bakes of their own.
pub(super) fn bind_draws(
    gpu: &Gpu,
    layout: &wgpu::BindGroupLayout,
    looks: &wgpu::Buffer,
    (walked, starts): (&wgpu::TextureView, &StartTextures),
    objects: Option<&[wgpu::Buffer; 3]>,
) -> wgpu::BindGroup {
    let size = wgpu::BufferSize::new(size_of::<ShadeDraw>() as u64);
    let window = wgpu::BufferBinding { buffer: looks, offset: 0, size };
    let mut resources = vec![
        wgpu::BindingResource::Buffer(window),
        wgpu::BindingResource::TextureView(walked),
        wgpu::BindingResource::TextureView(&starts.points),
        wgpu::BindingResource::TextureView(&starts.normals),
    ];
    resources.extend(objects.into_iter().flatten().map(wgpu::Buffer::as_entire_binding));
    gpu.bind(layout, &resources)
}
