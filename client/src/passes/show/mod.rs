//! The picture on a screen: exposure, tone curve, the mean over samples, sRGB.
//!
//! Samples are summed tone-mapped, as those of a written picture are, so that the edge of a lamp is smooth.

pub mod reference;

use wgpu::ShaderStages as Stages;

use super::gpu::{Gpu, texture, uniform};
use crate::error::Result;
use crate::picture::Tone;

/// The shader.
pub const SHADER: &str = concat!(include_str!("../shared/curve.wgsl"), include_str!("show.wgsl"));
/// Largest difference from the reference in sRGB of 0 to 1: sums have 11 bits, the result 8.
pub const TOLERANCE: f32 = 1.1 / 255.0;
/// Format of the sum: adapters blend it, and 11 bits are finer than a screen's 8.
const SUM: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;
/// Format of pictures that are read back.
const KEPT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;

/// Numbers of the pass; twin of `Show` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct ShowNumbers {
    /// Factor on radiance.
    pub exposure: f32,
    /// Curve: 0 none, 1 Reinhard's, 2 filmic.
    pub tone: u32,
    /// 1 where the screen takes sRGB numbers, 0 where it makes them itself.
    pub encodes: u32,
    /// Nothing.
    pub pad: u32,
}

/// Pipelines of the pass.
#[derive(Debug)]
pub struct ShowPass {
    layout: wgpu::BindGroupLayout,
    add: wgpu::RenderPipeline,
    present: wgpu::RenderPipeline,
    keep: wgpu::RenderPipeline,
    numbers: wgpu::Buffer,
    kept_numbers: wgpu::Buffer,
    encodes: bool,
}

/// The sum of samples of one size.
#[derive(Clone, Debug)]
pub struct ShowSum {
    size: [u32; 2],
    sum: wgpu::TextureView,
    kept: wgpu::Texture,
    add: wgpu::BindGroup,
    present: wgpu::BindGroup,
    keep: wgpu::BindGroup,
}

impl ShowPass {
    /// Pipelines for a screen of that format.
    pub fn new(gpu: &Gpu, screen: wgpu::TextureFormat) -> Self {
        let picture =
            texture(wgpu::TextureSampleType::Float { filterable: false }, wgpu::TextureViewDimension::D2);
        let layout = gpu.bind_layout(&[(Stages::FRAGMENT, uniform(false)), (Stages::FRAGMENT, picture)]);
        let module = gpu.module("show", SHADER);
        let one = wgpu::BlendComponent {
            src_factor: wgpu::BlendFactor::One,
            dst_factor: wgpu::BlendFactor::One,
            operation: wgpu::BlendOperation::Add,
        };
        let blend = wgpu::BlendState { color: one, alpha: one };
        let groups = gpu.pipeline_layout(&[&layout]);
        let pipeline =
            |entry, format, blend| whole_pipeline(gpu, &groups, (&module, ["whole", entry]), (format, blend));
        let bytes = size_of::<ShowNumbers>() as u64;
        Self {
            add: pipeline("add", SUM, Some(blend)),
            present: pipeline("present", screen, None),
            keep: pipeline("present", KEPT, None),
            layout,
            numbers: gpu.buffer("show", bytes, wgpu::BufferUsages::UNIFORM),
            kept_numbers: gpu.buffer("show for keeping", bytes, wgpu::BufferUsages::UNIFORM),
            encodes: !screen.is_srgb(),
        }
    }

    /// Room for samples of a picture of radiance.
    pub fn sum(&self, gpu: &Gpu, radiance: &wgpu::TextureView, size: [u32; 2]) -> Result<ShowSum> {
        let make = |label, format, usage| {
            gpu.texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d { width: size[0], height: size[1], depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage: usage | wgpu::TextureUsages::RENDER_ATTACHMENT,
                view_formats: &[],
            })
        };
        let sum = make("sum of samples", SUM, wgpu::TextureUsages::TEXTURE_BINDING)?;
        let sum = sum.create_view(&wgpu::TextureViewDescriptor::default());
        let bind = |numbers: &wgpu::Buffer, view| {
            gpu.bind(&self.layout, &[numbers.as_entire_binding(), wgpu::BindingResource::TextureView(view)])
        };
        Ok(ShowSum {
            size,
            add: bind(&self.numbers, radiance),
            present: bind(&self.numbers, &sum),
            keep: bind(&self.kept_numbers, &sum),
            kept: make("kept picture", KEPT, wgpu::TextureUsages::COPY_SRC)?,
            sum,
        })
    }

    /// The same sum, to which samples of another picture of radiance of its size are added.
    pub fn sum_with(&self, gpu: &Gpu, sum: &ShowSum, radiance: &wgpu::TextureView) -> ShowSum {
        let add = gpu.bind(
            &self.layout,
            &[self.numbers.as_entire_binding(), wgpu::BindingResource::TextureView(radiance)],
        );
        ShowSum { add, ..sum.clone() }
    }

    /// Adds the sample that the picture of radiance holds; the first one starts anew.
    pub fn add(&self, gpu: &Gpu, sum: &ShowSum, is_first: bool, (exposure, tone): (f32, Tone)) {
        let tone = match tone {
            Tone::Linear => 0,
            Tone::Reinhard => 1,
            Tone::Filmic => 2,
        };
        let numbers = ShowNumbers { exposure, tone, encodes: u32::from(self.encodes), pad: 0 };
        gpu.write(&self.numbers, &[numbers]);
        gpu.write(&self.kept_numbers, &[ShowNumbers { encodes: 1, ..numbers }]);
        let load = if is_first { wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT) } else { wgpu::LoadOp::Load };
        gpu.submit(|encoder| whole(encoder, &sum.sum, load, &self.add, &sum.add));
    }

    /// Records the picture for the screen; a screen of another size than the samples' shows the part that both have.
    pub fn present(&self, encoder: &mut wgpu::CommandEncoder, sum: &ShowSum, screen: &wgpu::TextureView) {
        let load = wgpu::LoadOp::Clear(wgpu::Color::BLACK);
        whole(encoder, screen, load, &self.present, &sum.present);
    }

    /// The picture as sRGB bytes, after a wait.
    pub fn keep(&self, gpu: &Gpu, sum: &ShowSum) -> Result<Vec<[u8; 4]>> {
        let view = sum.kept.create_view(&wgpu::TextureViewDescriptor::default());
        let load = wgpu::LoadOp::Clear(wgpu::Color::BLACK);
        gpu.submit(|encoder| whole(encoder, &view, load, &self.keep, &sum.keep));
        gpu.read_layer(&sum.kept, 0, wgpu::TextureAspect::All)
    }
}

impl ShowSum {
    /// Width and height in pixels.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }
}

/// One triangle over all of a target.
fn whole(
    encoder: &mut wgpu::CommandEncoder,
    view: &wgpu::TextureView,
    load: wgpu::LoadOp<wgpu::Color>,
    pipeline: &wgpu::RenderPipeline,
    group: &wgpu::BindGroup,
) {
    let ops = wgpu::Operations { load, store: wgpu::StoreOp::Store };
    let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some("show"),
        color_attachments: &[Some(wgpu::RenderPassColorAttachment {
            view,
            depth_slice: None,
            resolve_target: None,
            ops,
        })],
        ..Default::default()
    });
    pass.set_pipeline(pipeline);
    pass.set_bind_group(0, group, &[]);
    pass.draw(0..3, 0..1);
}

/// A pipeline that draws one triangle over all of a target, whose shader has it as `whole`.
pub(in crate::passes) fn whole_pipeline(
    gpu: &Gpu,
    layout: &wgpu::PipelineLayout,
    (module, [vertex, fragment]): (&wgpu::ShaderModule, [&str; 2]),
    (format, blend): (wgpu::TextureFormat, Option<wgpu::BlendState>),
) -> wgpu::RenderPipeline {
    gpu.render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(fragment),
        layout: Some(layout),
        vertex: wgpu::VertexState {
            module,
            entry_point: Some(vertex),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: None,
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module,
            entry_point: Some(fragment),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &[Some(wgpu::ColorTargetState { format, blend, write_mask: wgpu::ColorWrites::ALL })],
        }),
        multiview_mask: None,
        cache: None,
    })
}
