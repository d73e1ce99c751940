//! The picture on the adapter.

use std::ops::Range;

use glam::Vec4;
use lightkiln_proto::manifest::{Material, TextureUse};
use wgpu::ShaderStages as Stages;

use super::panes::{Panes, runs};
use super::panorama::PanoramaPass;
use super::{ShadeView, Shading};
use crate::error::Result;
use crate::lights::Panorama;
use crate::passes::gpu::{Gpu, failed, uniform};
use crate::passes::meshes::{Meshes, sampled, uv_rows, vertex_layout};
use crate::passes::shadow::{ShadowPass, cleared_depth, nearer_wins, tested_alone};
use crate::passes::stopwatch::{Recorder, Stopwatch};
use crate::scene::{LoadedDraw, LoadedScene, Tints};

/// Look of a draw; twin of `ShadeDraw` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct ShadeDraw {
    /// Linear base colour and alpha.
    pub base_colour: [f32; 4],
    /// Emitted radiance times the emitter's scale.
    pub emissive: [f32; 4],
    /// Map from uv to the base-colour texture's coordinates.
    pub base_row0: [f32; 4],
    /// Second row.
    pub base_row1: [f32; 4],
    /// Map from uv to the emissive texture's coordinates.
    pub emissive_row0: [f32; 4],
    /// Second row.
    pub emissive_row1: [f32; 4],
    /// Map from uv to the transmission texture's coordinates.
    pub transmission_row0: [f32; 4],
    /// Second row.
    pub transmission_row1: [f32; 4],
    /// Map from uv to the normal map's coordinates.
    pub normal_row0: [f32; 4],
    /// Second row.
    pub normal_row1: [f32; 4],
    /// Map from uv to the metallic-roughness texture's coordinates.
    pub specular_row0: [f32; 4],
    /// Second row.
    pub specular_row1: [f32; 4],
    /// Alpha below it is not drawn.
    pub cutoff: f32,
    /// Number of the draw.
    pub index: u32,
    /// Share of light that passes what is there, tinted by the base colour.
    pub transmission: f32,
    /// 1 where alpha is the share that is there.
    pub blends: f32,
    /// Factor on x and y of the normal map's normals.
    pub normal_scale: f32,
    /// 1 where there is a normal map.
    pub has_normals: f32,
    /// Share of metal.
    pub metallic: f32,
    /// Below 0 where all reflection is diffuse.
    pub roughness: f32,
}

/// Textures of a material, each with its sampler.
const MATERIAL_TEXTURES: usize = 5;

/// Textures of a material in the order of their bindings.
fn textures_of(material: &Material) -> [Option<&TextureUse>; MATERIAL_TEXTURES] {
    [
        material.base_colour_texture.as_ref(),
        material.emissive_texture.as_ref(),
        material.glass.as_ref().and_then(|glass| glass.transmission_texture.as_ref()),
        material.normal_map.as_ref().map(|map| &map.texture),
        material.specular.as_ref().and_then(|specular| specular.texture.as_ref()),
    ]
}

/// Overrides of the shader: it holds maps and gloss only where a material of the scene, or of its objects, has such.
pub fn details_of(materials: &[Material]) -> [(&'static str, f64); 2] {
    let any = |has: fn(&Material) -> bool| f64::from(u8::from(materials.iter().any(has)));
    [
        ("HAS_MAPS", any(|material| material.normal_map.is_some())),
        ("HAS_GLOSS", any(|material| material.specular.is_some())),
    ]
}

/// The pass and its target.
#[derive(Debug)]
pub struct ShadePass {
    /// Of single-sided and of double-sided surfaces.
    opaque: [wgpu::RenderPipeline; 2],
    /// Of glass, as well.
    glass: Option<[wgpu::RenderPipeline; 2]>,
    panes: Panes,
    /// Corners of the glass, in the order of a view.
    pane_corners: wgpu::Buffer,
    sky: wgpu::RenderPipeline,
    panorama: Option<PanoramaPass>,
    view: wgpu::Buffer,
    view_layout: wgpu::BindGroupLayout,
    view_group: wgpu::BindGroup,
    draws: wgpu::BindGroup,
    looks: wgpu::Buffer,
    draw_stride: u32,
    materials: Vec<wgpu::BindGroup>,
    is_double_sided: Vec<bool>,
    is_glass: Vec<bool>,
    target: wgpu::Texture,
    target_view: wgpu::TextureView,
    depth: wgpu::TextureView,
}

impl ShadePass {
    /// Makes pipelines and a target of `size` pixels; `resources` are those of `shading`'s bindings.
    pub fn new(
        gpu: &Gpu,
        scene: &LoadedScene,
        meshes: &Meshes,
        shadow: &ShadowPass,
        (shading, resources): (&Shading, &[wgpu::BindingResource<'_>]),
        size: [u32; 2],
    ) -> Result<Self> {
        check_size(gpu, size)?;
        let mut kinds = vec![(Stages::VERTEX_FRAGMENT, uniform(false))];
        kinds.extend(shading.bindings.iter().map(|kind| (Stages::FRAGMENT, *kind)));
        let view_layout = gpu.bind_layout(&kinds);
        let draw_layout = gpu.bind_layout(&[(Stages::VERTEX_FRAGMENT, uniform(true))]);
        let material_layout = gpu.bind_layout(&[sampled(); MATERIAL_TEXTURES].concat());
        let layout =
            gpu.pipeline_layout(&[&shadow.light_layout, &view_layout, &draw_layout, &material_layout]);
        let module = gpu.module("shade", &shading.shader());
        let constants = details_of(&scene.manifest.materials);
        let shade = Program { module: &module, vertex: "corner", fragment: "shade", constants: &constants };
        let view = gpu.buffer("view", size_of::<ShadeView>() as u64, wgpu::BufferUsages::UNIFORM);
        let view_group = gpu.bind(&view_layout, &[&[view.as_entire_binding()], resources].concat());
        let (looks, draw_stride) = gpu.uniforms("draws", &looks(scene, &Tints::default(), &[]));
        let window = wgpu::BufferBinding {
            buffer: &looks,
            offset: 0,
            size: wgpu::BufferSize::new(size_of::<ShadeDraw>() as u64),
        };
        let draws = gpu.bind(&draw_layout, &[wgpu::BindingResource::Buffer(window)]);
        let bind_material = |material: &Material| {
            gpu.bind(&material_layout, &textures_of(material).map(|used| meshes.texture(used)).concat())
        };
        let panes = Panes::of(scene);
        let sides = [Some(wgpu::Face::Back), None];
        let glass = if panes.is_empty() { None } else { Some(blending(gpu)?) };
        let (target, depth) = create_targets(gpu, size)?;
        Ok(Self {
            opaque: sides.map(|cull| pipeline(gpu, &layout, shade, cull, None)),
            glass: glass.map(|blend| sides.map(|cull| pipeline(gpu, &layout, shade, cull, Some(blend)))),
            pane_corners: gpu.buffer(
                "corners of glass",
                (panes.len() * size_of::<[u32; 3]>()) as u64,
                wgpu::BufferUsages::INDEX,
            ),
            panes,
            sky: sky_pipeline(gpu, &layout, &module),
            panorama: None,
            view,
            view_layout,
            view_group,
            draws,
            looks,
            draw_stride,
            materials: scene.manifest.materials.iter().map(bind_material).collect(),
            is_double_sided: scene.manifest.materials.iter().map(|material| material.double_sided).collect(),
            is_glass: scene.manifest.materials.iter().map(|material| material.glass.is_some()).collect(),
            target_view: target.create_view(&wgpu::TextureViewDescriptor::default()),
            target,
            depth,
        })
    }

    /// Writes looks of materials: tints, and the emitters' scale, 1 where absent.
    pub fn set_looks(&self, gpu: &Gpu, scene: &LoadedScene, tints: &Tints, emitter_scale: &[f32]) {
        gpu.write_strided(&self.looks, &looks(scene, tints, emitter_scale), self.draw_stride);
    }

    /// Sets or takes away a panorama behind the scene. Another picture makes a texture and what binds it. Errs, and changes
    /// nothing, where the adapter has no room.
    pub fn set_panorama(&mut self, gpu: &Gpu, panorama: Option<&Panorama>) -> Result<()> {
        let Some(panorama) = panorama else {
            self.panorama = None;
            return Ok(());
        };
        match &self.panorama {
            Some(pass) if pass.is_of(panorama) => pass.set(gpu, panorama),
            _ => self.panorama = Some(PanoramaPass::new(gpu, panorama, &self.view)?),
        }
        Ok(())
    }

    /// Moves a mesh.
    pub fn move_mesh(&mut self, gpu: &Gpu, meshes: &Meshes, index: usize, mesh: &LoadedDraw) {
        meshes.set(gpu, index, mesh);
        self.panes.set(index as u32, mesh);
    }

    /// Makes targets of another size. Errs, and changes nothing, where the adapter cannot.
    pub fn resize(&mut self, gpu: &Gpu, size: [u32; 2]) -> Result<()> {
        check_size(gpu, size)?;
        let (target, depth) = create_targets(gpu, size)?;
        let target_view = target.create_view(&wgpu::TextureViewDescriptor::default());
        gpu.check()?;
        (self.target, self.target_view, self.depth) = (target, target_view, depth);
        Ok(())
    }

    /// Binds other resources for shading. Errs, and changes nothing, where anything has gone wrong so far.
    pub fn bind(&mut self, gpu: &Gpu, resources: &[wgpu::BindingResource<'_>]) -> Result<()> {
        let resources = [&[self.view.as_entire_binding()], resources].concat();
        let view_group = gpu.bind(&self.view_layout, &resources);
        gpu.check()?;
        self.view_group = view_group;
        Ok(())
    }

    /// The sample drawn last: rgb radiance, alpha 1 on surfaces.
    pub fn radiance(&self) -> &wgpu::TextureView {
        &self.target_view
    }

    /// Depths of the sample drawn last, reversed: 0 where no surface is.
    pub fn depth(&self) -> &wgpu::TextureView {
        &self.depth
    }

    /// Draws one sample per pixel.
    pub fn draw(
        &self,
        (gpu, watch): (&Gpu, &mut Stopwatch),
        meshes: &Meshes,
        shadow: &ShadowPass,
        view: &ShadeView,
    ) {
        gpu.write(&self.view, std::slice::from_ref(view));
        let sorted = self.panes.farthest_first(view);
        gpu.write(&self.pane_corners, &sorted.iter().map(|pane| pane.corners).collect::<Vec<_>>());
        watch.submit(gpu, |encoder| self.record(encoder, meshes, shadow, &runs(&sorted)));
    }

    /// The sample drawn last, read back: rgb radiance, alpha 1 on surfaces.
    pub fn read(&self, gpu: &Gpu) -> Result<Vec<Vec4>> {
        gpu.read_layer(&self.target, 0, wgpu::TextureAspect::All)
    }

    fn record(
        &self,
        encoder: &mut Recorder<'_>,
        meshes: &Meshes,
        shadow: &ShadowPass,
        panes: &[(u32, Range<u32>)],
    ) {
        let ops = wgpu::Operations {
            load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
            store: wgpu::StoreOp::Store,
        };
        let attachment = wgpu::RenderPassColorAttachment {
            view: &self.target_view,
            depth_slice: None,
            resolve_target: None,
            ops,
        };
        let mark = encoder.mark("shade");
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("shade"),
            timestamp_writes: mark.as_ref().and_then(|mark| mark.writes(true, true)),
            color_attachments: &[Some(attachment)],
            depth_stencil_attachment: Some(cleared_depth(&self.depth)),
            ..Default::default()
        });
        if let Some(panorama) = &self.panorama {
            panorama.draw(&mut pass);
        }
        pass.set_bind_group(0, &shadow.light_group, &[]);
        pass.set_bind_group(1, &self.view_group, &[]);
        if let Some(material) = self.materials.first().filter(|_| self.panorama.is_none()) {
            // The sky reads neither, but its pipeline's layout names them.
            pass.set_bind_group(2, &self.draws, &[0]);
            pass.set_bind_group(3, material, &[]);
            pass.set_pipeline(&self.sky);
            pass.draw(0..3, 0..1);
        }
        let bind = |pass: &mut wgpu::RenderPass<'_>, sides: &[wgpu::RenderPipeline; 2], index: u32| {
            let material = meshes.meshes[index as usize].material;
            pass.set_pipeline(&sides[usize::from(self.is_double_sided[material])]);
            pass.set_bind_group(2, &self.draws, &[index * self.draw_stride]);
            pass.set_bind_group(3, &self.materials[material], &[]);
        };
        for (mesh, index) in meshes.meshes.iter().zip(0..) {
            if !self.is_glass[mesh.material] {
                bind(&mut pass, &self.opaque, index);
                meshes.draw(&mut pass, mesh);
            }
        }
        let Some(glass) = &self.glass else { return };
        pass.set_index_buffer(self.pane_corners.slice(..), wgpu::IndexFormat::Uint32);
        for (index, triangles) in panes {
            bind(&mut pass, glass, *index);
            pass.set_vertex_buffer(0, meshes.meshes[*index as usize].vertices.slice(..));
            pass.draw_indexed(3 * triangles.start..3 * triangles.end, 0, 0..1);
        }
    }
}

fn check_size(gpu: &Gpu, size: [u32; 2]) -> Result<()> {
    let limits = gpu.device.limits();
    let bytes = u64::from(size[0] + 16) * u64::from(size[1]) * size_of::<Vec4>() as u64;
    if size[0].max(size[1]) > limits.max_texture_dimension_2d || bytes > limits.max_buffer_size {
        return Err(failed(format!("{} × {} pixels are more than {} draws", size[0], size[1], gpu.name)));
    }
    Ok(())
}

/// Looks of all draws.
fn looks(scene: &LoadedScene, tints: &Tints, emitter_scale: &[f32]) -> Vec<ShadeDraw> {
    let draws = scene.draws.draws.iter().zip(0..);
    draws.map(|(draw, index)| shade_draw((scene, tints), draw, index, emitter_scale)).collect()
}

fn shade_draw(
    (scene, tints): (&LoadedScene, &Tints),
    draw: &LoadedDraw,
    index: u32,
    emitter_scale: &[f32],
) -> ShadeDraw {
    let material = &scene.manifest.materials[draw.material as usize];
    let scale =
        material.emitter.and_then(|emitter| emitter_scale.get(usize::from(emitter))).copied().unwrap_or(1.0);
    let [
        [base_row0, base_row1],
        [emissive_row0, emissive_row1],
        [transmission_row0, transmission_row1],
        [normal_row0, normal_row1],
        [specular_row0, specular_row1],
    ] = textures_of(material).map(uv_rows);
    let (glass, normals) = (material.glass.as_ref(), material.normal_map.as_ref());
    let specular = material.specular.as_ref();
    let [r, g, b] = material.emissive.map(|channel| channel * scale);
    ShadeDraw {
        base_colour: tints.base_colour(scene, draw.material),
        emissive: [r, g, b, 0.0],
        base_row0,
        base_row1,
        emissive_row0,
        emissive_row1,
        transmission_row0,
        transmission_row1,
        normal_row0,
        normal_row1,
        specular_row0,
        specular_row1,
        cutoff: material.alpha_cutoff.unwrap_or(-1.0),
        index,
        transmission: glass.map_or(0.0, |glass| glass.transmission),
        blends: f32::from(u8::from(glass.is_some_and(|glass| glass.blends))),
        normal_scale: normals.map_or(0.0, |map| map.scale),
        has_normals: f32::from(u8::from(normals.is_some())),
        metallic: specular.map_or(0.0, |specular| specular.metallic),
        roughness: specular.map_or(-1.0, |specular| specular.roughness),
    }
}

fn create_targets(gpu: &Gpu, size: [u32; 2]) -> Result<(wgpu::Texture, wgpu::TextureView)> {
    let create = |label, format, usage| {
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
    let read = wgpu::TextureUsages::COPY_SRC | wgpu::TextureUsages::TEXTURE_BINDING;
    let target = create("picture", wgpu::TextureFormat::Rgba32Float, read)?;
    let depth = create("depth", wgpu::TextureFormat::Depth32Float, wgpu::TextureUsages::TEXTURE_BINDING)?;
    Ok((target, depth.create_view(&wgpu::TextureViewDescriptor::default())))
}

/// Blending of glass, whose alpha is the share that it stops, over what is behind it.
///
/// Errors on adapters that blend no 32-bit radiance.
fn blending(gpu: &Gpu) -> Result<wgpu::BlendState> {
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

fn pipeline(
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
fn sky_pipeline(
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
    Program { module, vertex, fragment, constants }: Program<'_>,
    buffers: &[Option<wgpu::VertexBufferLayout<'_>>],
    primitive: wgpu::PrimitiveState,
    (depth, blend): (wgpu::DepthStencilState, Option<wgpu::BlendState>),
) -> wgpu::RenderPipeline {
    let target = wgpu::ColorTargetState {
        format: wgpu::TextureFormat::Rgba32Float,
        blend,
        write_mask: wgpu::ColorWrites::ALL,
    };
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
            targets: &[Some(target)],
        }),
        multiview_mask: None,
        cache: None,
    })
}
