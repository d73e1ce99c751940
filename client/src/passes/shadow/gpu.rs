//! Shadow maps on the adapter.

use std::ops::Range;

use bytemuck::Zeroable as _;
use lightkiln_proto::manifest::Material;
use wgpu::{ShaderStages as Stages, TextureViewDimension as Dimension};

use super::panes::PanePass;
use super::reference::ShadowMaps;
use super::sights::{SIGHT_FACES, TILES};
use super::{Face, Light, LightCount, SHADER, SIGHT_SIDE, ShadowPlan, ShadowRoom, SightPlaces};
use crate::error::{ClientError, Result};
use crate::passes::gpu::{Gpu, array_view, storage_read, texture, uniform};
use crate::passes::meshes::{Meshes, sampled, uv_rows, vertex_layout};
use crate::passes::stopwatch::Recorder;
use crate::scene::LoadedScene;

/// Alpha mask of a draw; twin of `Mask` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Mask {
    /// First row of the map from uv to the base-colour texture's coordinates.
    pub uv_row0: [f32; 4],
    /// Second row.
    pub uv_row1: [f32; 4],
    /// Base colour's alpha.
    pub alpha: f32,
    /// Alpha below it lets light through.
    pub cutoff: f32,
    /// Nothing.
    pub pad0: f32,
    /// Nothing.
    pub pad1: f32,
}

/// Buffers of the bind group of lights.
#[derive(Debug)]
pub(super) struct LightRows {
    pub(super) lights: wgpu::Buffer,
    pub(super) faces: wgpu::Buffer,
    count: wgpu::Buffer,
}

/// The pass, its maps, and the bind group of lights that other passes read them by.
#[derive(Debug)]
pub struct ShadowPass {
    solid: wgpu::RenderPipeline,
    masked: wgpu::RenderPipeline,
    faces: wgpu::BindGroup,
    pub(super) projections: wgpu::Buffer,
    pub(super) face_stride: u32,
    pub(super) rows: LightRows,
    pub(super) face_views: Vec<wgpu::TextureView>,
    /// Per mesh: the mask of alpha-masked ones.
    masks: Vec<Option<wgpu::BindGroup>>,
    maps: wgpu::Texture,
    panes: PanePass,
    pub(super) sights: SightPlaces,
    /// Texels along a side of a layer.
    pub(super) side: u32,
    /// Layout of [`Self::light_group`]: group 0 of `light.wgsl`.
    pub light_layout: wgpu::BindGroupLayout,
    /// Lights, faces and maps.
    pub light_group: wgpu::BindGroup,
}

impl ShadowPass {
    /// Makes room for lights and their maps; there are none until [`ShadowPass::set`].
    pub fn new(gpu: &Gpu, scene: &LoadedScene, meshes: &Meshes, room: &ShadowRoom) -> Result<Self> {
        Self::with_sights(gpu, scene, meshes, room, 0)
    }

    /// Makes room for what so many objects see, too.
    pub fn with_sights(
        gpu: &Gpu,
        scene: &LoadedScene,
        meshes: &Meshes,
        room: &ShadowRoom,
        sights: u32,
    ) -> Result<Self> {
        let face_layout = gpu.bind_layout(&[(Stages::VERTEX, uniform(true))]);
        let [base, sampler] = sampled();
        let mask_layout = gpu.bind_layout(&[(Stages::VERTEX_FRAGMENT, uniform(false)), base, sampler]);
        let module = gpu.module("shadow", SHADER);
        let solid = pipeline(gpu, &module, &[&face_layout], "solid", None);
        let masked = pipeline(gpu, &module, &[&face_layout, &mask_layout], "masked", Some("mask"));
        let places = SightPlaces {
            first_light: room.lights,
            first_face: room.faces,
            first_silhouette: room.faces + SIGHT_FACES * sights,
            first_layer: room.faces,
        };
        let [lights, faces] = [room.lights + sights, room.faces + TILES * sights];
        let tiles = (room.side / SIGHT_SIDE).pow(2).max(1);
        let layers = room.faces + (TILES * sights).div_ceil(tiles);
        if sights > 0 && layers > gpu.device.limits().max_texture_array_layers {
            let what = format!("{} shadow maps, and {sights} objects with bakes of their own", room.faces);
            let problem = "are more than the adapter has layers for; use fewer lights".to_owned();
            return Err(ClientError::Argument { what, problem });
        }
        let blank = vec![[[0.0_f32; 4]; 4]; faces as usize];
        let (projections, face_stride) = gpu.uniforms("faces", &blank);
        let window = wgpu::BufferBinding {
            buffer: &projections,
            offset: 0,
            size: wgpu::BufferSize::new(size_of::<[[f32; 4]; 4]>() as u64),
        };
        let bound_faces = gpu.bind(&face_layout, &[wgpu::BindingResource::Buffer(window)]);
        let maps = create_maps(gpu, room.side, layers, wgpu::TextureFormat::Depth32Float)?;
        let panes = PanePass::new(gpu, scene, meshes, room, &face_layout)?;
        let rows = LightRows {
            lights: gpu.blank("lights", u64::from(lights) * size_of::<Light>() as u64)?,
            faces: gpu.blank("faces", u64::from(faces) * size_of::<Face>() as u64)?,
            count: gpu.uniform("light count", &LightCount::zeroed()),
        };
        let (light_layout, light_group) = bind_lights(gpu, &rows, &maps, &panes);
        let face_views = (0..layers).map(|layer| face_view(&maps, layer)).collect();
        let material = |material: usize| &scene.manifest.materials[material];
        let masks = meshes
            .meshes
            .iter()
            .map(|mesh| mask(gpu, meshes, &mask_layout, material(mesh.material)))
            .collect();
        Ok(Self {
            solid,
            masked,
            faces: bound_faces,
            projections,
            face_stride,
            rows,
            face_views,
            masks,
            maps,
            panes,
            sights: places,
            side: room.side,
            light_layout,
            light_group,
        })
    }

    /// Writes the lights and faces of a plan within the room.
    pub fn set(&self, gpu: &Gpu, plan: &ShadowPlan) {
        let projections: Vec<_> = plan.faces.iter().map(|face| face.clip_from_world).collect();
        gpu.write_strided(&self.projections, &projections, self.face_stride);
        let mark = |face: &Face| Face { panes: f32::from(u8::from(self.panes.is_used)), ..*face };
        gpu.write(&self.rows.lights, &plan.lights);
        gpu.write(&self.rows.faces, &plan.faces.iter().map(mark).collect::<Vec<_>>());
        gpu.write(&self.rows.count, &[plan.count]);
    }

    /// Records some faces of the plan that was set last: every mesh into each, then its glass.
    pub fn record(&self, encoder: &mut Recorder<'_>, meshes: &Meshes, faces: Range<usize>) {
        let (first, last) = (faces.start, faces.end);
        let mark = if faces.is_empty() { None } else { encoder.mark("shadow") };
        for face in faces {
            let view = &self.face_views[face];
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("shadow"),
                depth_stencil_attachment: Some(cleared_depth(view)),
                // Glass of the last face comes behind its mark.
                timestamp_writes: mark.as_ref().and_then(|mark| mark.writes(face == first, face + 1 == last)),
                ..Default::default()
            });
            let offset = face as u32 * self.face_stride;
            self.draw_opaque(&mut pass, (meshes, 0..meshes.meshes.len()), offset);
            drop(pass);
            self.panes.record(encoder, meshes, (face, view), |pass| {
                pass.set_bind_group(0, &self.faces, &[offset]);
            });
        }
    }

    /// Draws some meshes but glass into a face, whose projection lies at that offset.
    pub(super) fn draw_opaque(
        &self,
        pass: &mut wgpu::RenderPass<'_>,
        (meshes, drawn): (&Meshes, Range<usize>),
        offset: u32,
    ) {
        for index in drawn.filter(|index| !self.panes.is_glass(*index)) {
            let mask = self.masks[index].as_ref();
            pass.set_pipeline(if mask.is_some() { &self.masked } else { &self.solid });
            pass.set_bind_group(0, &self.faces, &[offset]);
            if let Some(mask) = mask {
                pass.set_bind_group(1, mask, &[]);
            }
            meshes.draw(pass, &meshes.meshes[index]);
        }
    }

    /// The maps of the whole room, read back.
    pub fn read(&self, gpu: &Gpu) -> Result<ShadowMaps> {
        let mut depth = Vec::new();
        for layer in 0..self.face_views.len() as u32 {
            depth.extend(gpu.read_layer::<f32>(&self.maps, layer, wgpu::TextureAspect::DepthOnly)?);
        }
        let (pane_depth, passed) = self.panes.read(gpu)?;
        Ok(ShadowMaps { side: self.maps.width(), depth, pane_depth, passed })
    }
}

/// A depth attachment that starts infinitely far.
pub(in crate::passes) fn cleared_depth(
    view: &wgpu::TextureView,
) -> wgpu::RenderPassDepthStencilAttachment<'_> {
    let depth_ops = wgpu::Operations { load: wgpu::LoadOp::Clear(0.0), store: wgpu::StoreOp::Store };
    wgpu::RenderPassDepthStencilAttachment { view, depth_ops: Some(depth_ops), stencil_ops: None }
}

/// Depth test of reversed depth.
pub(in crate::passes) fn nearer_wins() -> wgpu::DepthStencilState {
    wgpu::DepthStencilState {
        format: wgpu::TextureFormat::Depth32Float,
        depth_write_enabled: Some(true),
        depth_compare: Some(wgpu::CompareFunction::Greater),
        stencil: wgpu::StencilState::default(),
        bias: wgpu::DepthBiasState::default(),
    }
}

fn pipeline(
    gpu: &Gpu,
    module: &wgpu::ShaderModule,
    groups: &[&wgpu::BindGroupLayout],
    vertex: &str,
    fragment: Option<&str>,
) -> wgpu::RenderPipeline {
    gpu.render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(vertex),
        layout: Some(&gpu.pipeline_layout(groups)),
        vertex: wgpu::VertexState {
            module,
            entry_point: Some(vertex),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[Some(vertex_layout())],
        },
        // Nothing is culled: both sides block light.
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: Some(nearer_wins()),
        multisample: wgpu::MultisampleState::default(),
        fragment: fragment.map(|entry| wgpu::FragmentState {
            module,
            entry_point: Some(entry),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &[],
        }),
        multiview_mask: None,
        cache: None,
    })
}

/// A map for each of so many faces; of none, one texel that nobody reads.
pub(super) fn create_maps(
    gpu: &Gpu,
    side: u32,
    layers: u32,
    format: wgpu::TextureFormat,
) -> Result<wgpu::Texture> {
    let side = if layers == 0 { 1 } else { side };
    let layers = layers.max(1);
    gpu.texture(&wgpu::TextureDescriptor {
        label: Some("shadow maps"),
        size: wgpu::Extent3d { width: side, height: side, depth_or_array_layers: layers },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT
            | wgpu::TextureUsages::TEXTURE_BINDING
            | wgpu::TextureUsages::COPY_SRC,
        view_formats: &[],
    })
}

pub(super) fn face_view(maps: &wgpu::Texture, layer: u32) -> wgpu::TextureView {
    maps.create_view(&wgpu::TextureViewDescriptor {
        dimension: Some(Dimension::D2),
        base_array_layer: layer,
        array_layer_count: Some(1),
        ..Default::default()
    })
}

fn bind_lights(
    gpu: &Gpu,
    rows: &LightRows,
    maps: &wgpu::Texture,
    panes: &PanePass,
) -> (wgpu::BindGroupLayout, wgpu::BindGroup) {
    let map = texture(wgpu::TextureSampleType::Depth, Dimension::D2Array);
    let passed = texture(wgpu::TextureSampleType::Float { filterable: false }, Dimension::D2Array);
    let kinds = [storage_read(), storage_read(), uniform(false), map, map, passed];
    let layout = gpu.bind_layout(&kinds.map(|kind| (Stages::COMPUTE | Stages::FRAGMENT, kind)));
    let group = gpu.bind(
        &layout,
        &[
            rows.lights.as_entire_binding(),
            rows.faces.as_entire_binding(),
            rows.count.as_entire_binding(),
            wgpu::BindingResource::TextureView(&array_view(maps)),
            wgpu::BindingResource::TextureView(&array_view(&panes.depth_maps)),
            wgpu::BindingResource::TextureView(&array_view(&panes.passed_maps)),
        ],
    );
    (layout, group)
}

fn mask(
    gpu: &Gpu,
    meshes: &Meshes,
    layout: &wgpu::BindGroupLayout,
    material: &Material,
) -> Option<wgpu::BindGroup> {
    let cutoff = material.alpha_cutoff?;
    let used = material.base_colour_texture.as_ref();
    let [uv_row0, uv_row1] = uv_rows(used);
    let mask = Mask { uv_row0, uv_row1, alpha: material.base_colour[3], cutoff, pad0: 0.0, pad1: 0.0 };
    let [base, sampler] = meshes.texture(used);
    Some(gpu.bind(layout, &[gpu.uniform("mask", &mask).as_entire_binding(), base, sampler]))
}
