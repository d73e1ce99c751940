//! Pipelines that draw into a picture.

use crate::error::Result;
use crate::passes::gpu::{Gpu, failed};
use crate::passes::meshes::vertex_layout;
use crate::passes::shadow::{nearer_wins, tested_alone};

/// Blending of glass, whose alpha is the share that it stops, over what is behind it.
///
/// Errors on adapters that blend no 32-bit radiance.
pub(super) fn blending(gpu: &Gpu) -> Result<wgpu::BlendState> {
    if !gpu.device.features().contains(wgpu::Features::FLOAT32_BLENDABLE) {
        return Err(failed(format!("{} draws no glass over 32-bit radiance", gpu.name)));
    }
    let over = |src_factor| wgpu::BlendComponent {
        src_factor,
        dst_factor: wgpu::BlendFactor::OneMinusSrcAlpha,
        operation: wgpu::BlendOperation::Add,
    };
    Ok(wgpu::BlendState { color: over(wgpu::BlendFactor::SrcAlpha), alpha: over(wgpu::BlendFactor::One) })
}

pub(super) fn pipeline(
    gpu: &Gpu,
    layout: &wgpu::PipelineLayout,
    shade: Program<'_>,
    cull_mode: Option<wgpu::Face>,
    blend: Option<wgpu::BlendState>,
) -> wgpu::RenderPipeline {
    let primitive = wgpu::PrimitiveState { cull_mode, ..Default::default() };
    let buffers = [Some(vertex_layout())];
    let depth = if blend.is_some() { tested_alone() } else { nearer_wins() };
    render_pipeline(gpu, layout, shade, &buffers, primitive, (depth, blend))
}

/// Behind everything, without touching the depth.
pub(super) fn sky_pipeline(
    gpu: &Gpu,
    layout: &wgpu::PipelineLayout,
    module: &wgpu::ShaderModule,
) -> wgpu::RenderPipeline {
    let primitive = wgpu::PrimitiveState::default();
    let sky = Program { module, vertex: "sky_corner", fragment: "sky", constants: &[] };
    render_pipeline(gpu, layout, sky, &[], primitive, (behind(), None))
}

pub(super) fn behind() -> wgpu::DepthStencilState {
    wgpu::DepthStencilState {
        depth_write_enabled: Some(false),
        depth_compare: Some(wgpu::CompareFunction::Always),
        ..nearer_wins()
    }
}

/// Entry points of a render pipeline in one module, and the fragment shader's override constants.
#[derive(Clone, Copy)]
pub(super) struct Program<'a> {
    pub(super) module: &'a wgpu::ShaderModule,
    pub(super) vertex: &'a str,
    pub(super) fragment: &'a str,
    pub(super) constants: &'a [(&'a str, f64)],
}

pub(super) fn render_pipeline(
    gpu: &Gpu,
    layout: &wgpu::PipelineLayout,
    program: Program<'_>,
    buffers: &[Option<wgpu::VertexBufferLayout<'_>>],
    primitive: wgpu::PrimitiveState,
    (depth, blend): (wgpu::DepthStencilState, Option<wgpu::BlendState>),
) -> wgpu::RenderPipeline {
    let target = wgpu::ColorTargetState {
        format: wgpu::TextureFormat::Rgba32Float,
        blend,
        write_mask: wgpu::ColorWrites::ALL,
    };
    pipeline_to(gpu, layout, program, buffers, primitive, (depth, &[Some(target)]))
}

pub(super) fn pipeline_to(
    gpu: &Gpu,
    layout: &wgpu::PipelineLayout,
    Program { module, vertex, fragment, constants }: Program<'_>,
    buffers: &[Option<wgpu::VertexBufferLayout<'_>>],
    primitive: wgpu::PrimitiveState,
    (depth, targets): (wgpu::DepthStencilState, &[Option<wgpu::ColorTargetState>]),
) -> wgpu::RenderPipeline {
    gpu.render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(fragment),
        layout: Some(layout),
        vertex: wgpu::VertexState {
            module,
            entry_point: Some(vertex),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers,
        },
        primitive,
        depth_stencil: Some(depth),
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module,
            entry_point: Some(fragment),
            compilation_options: wgpu::PipelineCompilationOptions { constants, ..Default::default() },
            targets,
        }),
        multiview_mask: None,
        cache: None,
    })
}
