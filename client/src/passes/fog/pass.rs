//! The medium on the adapter.

use wgpu::ShaderStages as Stages;

use super::{FILL_SHADER, FogNumbers, NO_RADIANCE, OVER_SHADER};
use crate::error::Result;
use crate::passes::gpu::{Gpu, failed, storage_read, storage_write, texture, uniform};
use crate::passes::shade::Shading;
use crate::passes::shadow::ShadowPass;
use crate::passes::show::whole_pipeline;
use crate::passes::stopwatch::Recorder;

/// Side of a workgroup in columns.
const GROUP: u32 = 8;

/// Pipelines and froxels for pictures of one size.
#[derive(Debug)]
pub struct FogPass {
    fill: wgpu::ComputePipeline,
    light: wgpu::BindGroup,
    fill_froxels: wgpu::BindGroup,
    over: wgpu::RenderPipeline,
    over_group: wgpu::BindGroup,
    numbers: wgpu::Buffer,
    columns: [u32; 2],
}

impl FogPass {
    /// Makes room for froxels of a view. `radiance` is what tells the mean radiance of a point, with the bindings and resources of shading;
    /// `depth` is the picture's. Errs on adapters that blend no 32-bit radiance.
    pub fn new(
        gpu: &Gpu,
        shadow: &ShadowPass,
        radiance: Option<(&'static str, &Shading, &[wgpu::BindingResource<'_>])>,
        depth: &wgpu::TextureView,
        numbers: &FogNumbers,
    ) -> Result<Self> {
        if !gpu.device.features().contains(wgpu::Features::FLOAT32_BLENDABLE) {
            return Err(failed(format!("{} draws no fog over 32-bit radiance", gpu.name)));
        }
        let froxels = gpu.blank("froxels", (numbers.froxels() * size_of::<glam::Vec4>()) as u64)?;
        let buffer = gpu.buffer("fog", size_of::<FogNumbers>() as u64, wgpu::BufferUsages::UNIFORM);
        let mut kinds = vec![(Stages::COMPUTE, uniform(false))];
        kinds.extend(
            radiance
                .iter()
                .flat_map(|(_, shading, _)| &shading.bindings)
                .map(|kind| (Stages::COMPUTE, *kind)),
        );
        let light_layout = gpu.bind_layout(&kinds);
        let froxel_layout = gpu.bind_layout(&[(Stages::COMPUTE, storage_write())]);
        let layout = gpu.pipeline_layout(&[&shadow.light_layout, &light_layout, &froxel_layout]);
        let snippet = radiance.as_ref().map_or(NO_RADIANCE, |(snippet, ..)| snippet);
        let fill = gpu.compute_with(("fog", &[FILL_SHADER, snippet].concat(), "fill"), Some(&layout), &[]);
        let resources = radiance.as_ref().map_or(&[][..], |(_, _, resources)| resources);
        let light = gpu.bind(&light_layout, &[&[buffer.as_entire_binding()], resources].concat());
        let of_picture = texture(wgpu::TextureSampleType::Depth, wgpu::TextureViewDimension::D2);
        let over_layout = gpu.bind_layout(&[
            (Stages::FRAGMENT, uniform(false)),
            (Stages::FRAGMENT, storage_read()),
            (Stages::FRAGMENT, of_picture),
        ]);
        let bound = [
            buffer.as_entire_binding(),
            froxels.as_entire_binding(),
            wgpu::BindingResource::TextureView(depth),
        ];
        Ok(Self {
            fill,
            light,
            fill_froxels: gpu.bind(&froxel_layout, &[froxels.as_entire_binding()]),
            over: over_pipeline(gpu, &over_layout),
            over_group: gpu.bind(&over_layout, &bound),
            numbers: buffer,
            columns: [numbers.size[0], numbers.size[1]],
        })
    }

    /// Sets the medium and the view.
    pub fn set(&self, gpu: &Gpu, numbers: &FogNumbers) {
        gpu.write(&self.numbers, std::slice::from_ref(numbers));
    }

    /// Fills the froxels.
    pub fn fill(&self, encoder: &mut Recorder<'_>, shadow: &ShadowPass) {
        let mut pass = encoder.compute("fog");
        pass.set_pipeline(&self.fill);
        pass.set_bind_group(0, &shadow.light_group, &[]);
        pass.set_bind_group(1, &self.light, &[]);
        pass.set_bind_group(2, &self.fill_froxels, &[]);
        let [columns, rows] = self.columns.map(|along| along.div_ceil(GROUP));
        pass.dispatch_workgroups(columns, rows, 1);
    }

    /// Draws the medium before a picture.
    pub fn draw_over(&self, encoder: &mut Recorder<'_>, picture: &wgpu::TextureView) {
        let mark = encoder.mark("fog over the picture");
        let ops = wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("fog"),
            timestamp_writes: mark.as_ref().and_then(|mark| mark.writes(true, true)),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: picture,
                depth_slice: None,
                resolve_target: None,
                ops,
            })],
            ..Default::default()
        });
        pass.set_pipeline(&self.over);
        pass.set_bind_group(0, &self.over_group, &[]);
        pass.draw(0..3, 0..1);
    }
}

/// Scattered light on top of what the medium lets through of the picture, whose alpha stays.
fn over_pipeline(gpu: &Gpu, layout: &wgpu::BindGroupLayout) -> wgpu::RenderPipeline {
    let module = gpu.module("fog", OVER_SHADER);
    let part = |src_factor, dst_factor| wgpu::BlendComponent {
        src_factor,
        dst_factor,
        operation: wgpu::BlendOperation::Add,
    };
    let blend = wgpu::BlendState {
        color: part(wgpu::BlendFactor::One, wgpu::BlendFactor::SrcAlpha),
        alpha: part(wgpu::BlendFactor::Zero, wgpu::BlendFactor::One),
    };
    let layout = gpu.pipeline_layout(&[layout]);
    whole_pipeline(
        gpu,
        &layout,
        (&module, ["whole", "over"]),
        (wgpu::TextureFormat::Rgba32Float, Some(blend)),
    )
}
