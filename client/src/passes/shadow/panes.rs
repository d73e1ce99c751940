//! Glass in shadow maps on the adapter: depth of the nearest, and the share of light that passes.

use half::f16;
use lightkiln_proto::manifest::Material;
use wgpu::ShaderStages as Stages;

use super::gpu::{cleared_depth, create_maps, face_view, nearer_wins};
use super::{PANES_SHADER, ShadowRoom};
use crate::error::Result;
use crate::passes::gpu::{Gpu, uniform};
use crate::passes::meshes::{Meshes, sampled, uv_rows, vertex_layout};
use crate::scene::LoadedScene;

/// Format of the shares: adapters multiply into it, and its 11 bits are enough for a share of light.
const PASSED: wgpu::TextureFormat = wgpu::TextureFormat::R16Float;

/// Glass of a draw; twin of `Pane` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Pane {
    /// Map from uv to the base-colour texture's coordinates.
    pub base_row0: [f32; 4],
    /// Second row.
    pub base_row1: [f32; 4],
    /// Map from uv to the transmission texture's coordinates.
    pub transmission_row0: [f32; 4],
    /// Second row.
    pub transmission_row1: [f32; 4],
    /// Linear base colour and alpha.
    pub base_colour: [f32; 4],
    /// Share of light that passes what is there, tinted by the base colour.
    pub transmission: f32,
    /// 1 where alpha is the share that is there.
    pub blends: f32,
    /// Alpha below it is a hole.
    pub cutoff: f32,
    /// Nothing.
    pub pad: f32,
}

impl Pane {
    /// The glass of a material, if it is of glass.
    fn of(material: &Material) -> Option<Self> {
        let glass = material.glass.as_ref()?;
        let [base_row0, base_row1] = uv_rows(material.base_colour_texture.as_ref());
        let [transmission_row0, transmission_row1] = uv_rows(glass.transmission_texture.as_ref());
        Some(Self {
            base_row0,
            base_row1,
            transmission_row0,
            transmission_row1,
            base_colour: material.base_colour,
            transmission: glass.transmission,
            blends: f32::from(u8::from(glass.blends)),
            cutoff: material.alpha_cutoff.unwrap_or(-1.0),
            pad: 0.0,
        })
    }
}

/// The passes that draw glass, and their maps.
#[derive(Debug)]
pub(super) struct PanePass {
    depth: wgpu::RenderPipeline,
    passed: wgpu::RenderPipeline,
    depth_views: Vec<wgpu::TextureView>,
    passed_views: Vec<wgpu::TextureView>,
    /// Per mesh: those of glass.
    panes: Vec<Option<wgpu::BindGroup>>,
    /// The maps hold anything; else they are one texel.
    pub is_used: bool,
    pub depth_maps: wgpu::Texture,
    pub passed_maps: wgpu::Texture,
}

impl PanePass {
    /// Makes room for maps in a scene with glass, in others for one texel that nobody reads.
    pub fn new(
        gpu: &Gpu,
        scene: &LoadedScene,
        meshes: &Meshes,
        room: &ShadowRoom,
        faces: &wgpu::BindGroupLayout,
    ) -> Result<Self> {
        let layers = if scene.has_glass() { room.faces } else { 0 };
        let depth_maps = create_maps(gpu, room.side, layers, wgpu::TextureFormat::Depth32Float)?;
        let passed_maps = create_maps(gpu, room.side, layers, PASSED)?;
        let views = |maps| (0..layers).map(|layer| face_view(maps, layer)).collect();
        let (depth_views, passed_views) = (views(&depth_maps), views(&passed_maps));
        let kinds = [vec![(Stages::VERTEX_FRAGMENT, uniform(false))], sampled().into(), sampled().into()];
        let layout = gpu.bind_layout(&kinds.concat());
        let bind = |mesh: &crate::passes::meshes::Mesh| {
            let material = &scene.manifest.materials[mesh.material];
            let pane = Pane::of(material)?;
            let [base, base_sampler] = meshes.texture(material.base_colour_texture.as_ref());
            let glass = material.glass.as_ref()?;
            let [texture, sampler] = meshes.texture(glass.transmission_texture.as_ref());
            let uniform = gpu.uniform("pane", &pane);
            Some(gpu.bind(&layout, &[uniform.as_entire_binding(), base, base_sampler, texture, sampler]))
        };
        let panes = meshes.meshes.iter().map(bind).collect();
        let module = gpu.module("panes", PANES_SHADER);
        let layout = gpu.pipeline_layout(&[faces, &layout]);
        Ok(Self {
            depth: pipeline(gpu, &layout, &module, "depth", None, nearer_wins()),
            passed: pipeline(gpu, &layout, &module, "passed", Some(multiplied()), tested_alone()),
            depth_views,
            passed_views,
            panes,
            is_used: layers > 0,
            depth_maps,
            passed_maps,
        })
    }

    /// Whether a mesh is of glass.
    pub fn is_glass(&self, mesh: usize) -> bool {
        self.panes[mesh].is_some()
    }

    /// Records both passes of a face, whose opaque surfaces are drawn.
    pub fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        meshes: &Meshes,
        (face, opaque): (usize, &wgpu::TextureView),
        bind_face: impl Fn(&mut wgpu::RenderPass<'_>),
    ) {
        if !self.is_used {
            return;
        }
        let (depth, passed) = (&self.depth_views[face], &self.passed_views[face]);
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("depth of glass"),
            depth_stencil_attachment: Some(cleared_depth(depth)),
            ..Default::default()
        });
        pass.set_pipeline(&self.depth);
        bind_face(&mut pass);
        self.draw(&mut pass, meshes);
        drop(pass);
        let kept = wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("light through glass"),
            color_attachments: &[Some(cleared_white(passed))],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: opaque,
                depth_ops: Some(kept),
                stencil_ops: None,
            }),
            ..Default::default()
        });
        pass.set_pipeline(&self.passed);
        bind_face(&mut pass);
        self.draw(&mut pass, meshes);
    }

    fn draw(&self, pass: &mut wgpu::RenderPass<'_>, meshes: &Meshes) {
        for (mesh, pane) in meshes.meshes.iter().zip(&self.panes) {
            if let Some(pane) = pane {
                pass.set_bind_group(1, pane, &[]);
                meshes.draw(pass, mesh);
            }
        }
    }

    /// Depth and shares, read back.
    pub fn read(&self, gpu: &Gpu) -> Result<(Vec<f32>, Vec<f32>)> {
        let (mut depth, mut passed) = (Vec::new(), Vec::new());
        let layers = if self.is_used { self.depth_views.len() as u32 } else { 0 };
        for layer in 0..layers {
            depth.extend(gpu.read_layer::<f32>(&self.depth_maps, layer, wgpu::TextureAspect::DepthOnly)?);
            let shares = gpu.read_layer::<f16>(&self.passed_maps, layer, wgpu::TextureAspect::All)?;
            passed.extend(shares.into_iter().map(f32::from));
        }
        Ok((depth, passed))
    }
}

/// Shares that start at 1.
fn cleared_white(view: &wgpu::TextureView) -> wgpu::RenderPassColorAttachment<'_> {
    let ops = wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::WHITE), store: wgpu::StoreOp::Store };
    wgpu::RenderPassColorAttachment { view, depth_slice: None, resolve_target: None, ops }
}

/// Blending that multiplies: the target's share by the fragment's.
fn multiplied() -> wgpu::BlendState {
    let component = wgpu::BlendComponent {
        src_factor: wgpu::BlendFactor::Dst,
        dst_factor: wgpu::BlendFactor::Zero,
        operation: wgpu::BlendOperation::Add,
    };
    wgpu::BlendState { color: component, alpha: component }
}

/// Depth test that leaves the depth as it is.
pub(in crate::passes) fn tested_alone() -> wgpu::DepthStencilState {
    wgpu::DepthStencilState { depth_write_enabled: Some(false), ..nearer_wins() }
}

fn pipeline(
    gpu: &Gpu,
    layout: &wgpu::PipelineLayout,
    module: &wgpu::ShaderModule,
    fragment: &str,
    blend: Option<wgpu::BlendState>,
    depth: wgpu::DepthStencilState,
) -> wgpu::RenderPipeline {
    let target = wgpu::ColorTargetState { format: PASSED, blend, write_mask: wgpu::ColorWrites::ALL };
    let targets = if blend.is_some() { vec![Some(target)] } else { Vec::new() };
    gpu.render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(fragment),
        layout: Some(layout),
        vertex: wgpu::VertexState {
            module,
            entry_point: Some("corner"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[Some(vertex_layout())],
        },
        // Nothing is culled: both sides stop as much light.
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: Some(depth),
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module,
            entry_point: Some(fragment),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &targets,
        }),
        multiview_mask: None,
        cache: None,
    })
}
