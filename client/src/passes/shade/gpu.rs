//! The picture on the adapter.

use std::ops::Range;

use glam::Vec4;
use lightkiln_proto::manifest::Material;
use wgpu::ShaderStages as Stages;

use super::looks::{MATERIAL_TEXTURES, details_of, looks, textures_of};
use super::objects::{ObjectShading, ShadedObjects};
use super::panes::{Panes, runs};
use super::panorama::PanoramaPass;
use super::pipelines::{Program, blending, pipeline, sky_pipeline};
use super::starts::{self, StartTextures, bind_draws, draw_kinds};
use super::{ShadeView, Shading};
use crate::error::Result;
use crate::lights::Panorama;
use crate::passes::gpu::{Gpu, failed, uniform};
use crate::passes::meshes::{Meshes, sampled};
use crate::passes::shadow::{ShadowPass, cleared_depth};
use crate::passes::stopwatch::{Recorder, Stopwatch};
use crate::passes::walk::walked_texture;
use crate::scene::{LoadedDraw, LoadedScene, Tints};

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
    draw_layout: wgpu::BindGroupLayout,
    /// With what walks found, if anything; without it while walks' starts are drawn.
    draws: [wgpu::BindGroup; 2],
    /// Stand for what no walk has found.
    unwalked: (wgpu::TextureView, StartTextures),
    starts: Option<([wgpu::RenderPipeline; 2], StartTextures)>,
    looks: wgpu::Buffer,
    draw_stride: u32,
    module: wgpu::ShaderModule,
    layout: wgpu::PipelineLayout,
    constants: [(&'static str, f64); 2],
    materials: Vec<wgpu::BindGroup>,
    is_double_sided: Vec<bool>,
    is_glass: Vec<bool>,
    /// With bakes of their own.
    objects: Option<ShadedObjects>,
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
        objects: Option<&ObjectShading<'_>>,
        size: [u32; 2],
    ) -> Result<Self> {
        check_size(gpu, size)?;
        let mut kinds = vec![(Stages::VERTEX_FRAGMENT, uniform(false))];
        kinds.extend(shading.bindings.iter().map(|kind| (Stages::FRAGMENT, *kind)));
        let view_layout = gpu.bind_layout(&kinds);
        let draw_layout = gpu.bind_layout(&draw_kinds(objects.is_some()));
        let material_layout = gpu.bind_layout(&[sampled(); MATERIAL_TEXTURES].concat());
        let layout =
            gpu.pipeline_layout(&[&shadow.light_layout, &view_layout, &draw_layout, &material_layout]);
        let source = if objects.is_some() { shading.shader_with_objects() } else { shading.shader() };
        let module = gpu.module("shade", &source);
        let constants = details_of(&scene.manifest.materials);
        let shade = Program { module: &module, vertex: "corner", fragment: "shade", constants: &constants };
        let view = gpu.buffer("view", size_of::<ShadeView>() as u64, wgpu::BufferUsages::UNIFORM);
        let view_group = gpu.bind(&view_layout, &[&[view.as_entire_binding()], resources].concat());
        let (looks, draw_stride) = gpu.uniforms("draws", &looks(scene, &Tints::default(), &[]));
        let unwalked = (walked_texture(gpu, [1, 1], 1)?, StartTextures::new(gpu, [1, 1])?);
        let tables = objects.map(|objects| objects.table.buffers());
        let draws = [(); 2]
            .map(|()| bind_draws(gpu, &draw_layout, &looks, (&unwalked.0, &unwalked.1), tables.as_ref()));
        let bind_material = |material: &Material| {
            gpu.bind(&material_layout, &textures_of(material).map(|used| meshes.texture(used)).concat())
        };
        let panes = Panes::of(scene);
        let sides = [Some(wgpu::Face::Back), None];
        let glass = if panes.is_empty() { None } else { Some(blending(gpu)?) };
        let (target, depth) = create_targets(gpu, size)?;
        let opaque = sides.map(|cull| pipeline(gpu, &layout, shade, cull, None));
        let glass = glass.map(|blend| sides.map(|cull| pipeline(gpu, &layout, shade, cull, Some(blend))));
        let layouts = [&shadow.light_layout, &view_layout, &draw_layout, &material_layout];
        let objects = objects.map(|objects| {
            let around = (shading, resources);
            ShadedObjects::new(gpu, objects, around, (&opaque, &glass), layouts, (&view, &constants))
        });
        Ok(Self {
            opaque,
            glass,
            objects,
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
            draw_layout,
            draws,
            unwalked,
            starts: None,
            looks,
            draw_stride,
            module: module.clone(),
            layout: layout.clone(),
            constants,
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
        self.bind_walked(gpu, None);
        Ok(())
    }

    /// Makes room for where walks start, if there is none; a picture of another size takes it away. Errs, and changes nothing, where the
    /// adapter cannot.
    pub fn make_starts(&mut self, gpu: &Gpu) -> Result<()> {
        if self.starts.is_none() {
            let textures = StartTextures::new(gpu, [self.target.width(), self.target.height()])?;
            let program = Program {
                module: &self.module,
                vertex: "corner",
                fragment: "start",
                constants: &self.constants,
            };
            let pipelines = starts::pipelines(gpu, &self.layout, program);
            gpu.check()?;
            self.starts = Some((pipelines, textures));
        }
        Ok(())
    }

    /// Where walks start.
    pub fn starts(&self) -> Option<&StartTextures> {
        self.starts.as_ref().map(|(_, textures)| textures)
    }

    /// The view as the shaders read it.
    pub fn view_buffer(&self) -> &wgpu::Buffer {
        &self.view
    }

    /// Shades with what walks from the starts found; without, lets go of the starts.
    pub fn bind_walked(&mut self, gpu: &Gpu, walked: Option<&wgpu::TextureView>) {
        let found = match (walked, &self.starts) {
            (Some(walked), Some((_, starts))) => (walked, starts),
            _ => (&self.unwalked.0, &self.unwalked.1),
        };
        let tables = self.objects.as_ref().map(|objects| &objects.tables);
        self.draws[0] = bind_draws(gpu, &self.draw_layout, &self.looks, found, tables);
        if walked.is_none() {
            self.starts = None;
        }
    }

    /// Writes the view, and where walks of its pixels start.
    pub fn draw_starts(
        &self,
        (gpu, watch): (&Gpu, &mut Stopwatch),
        meshes: &Meshes,
        shadow: &ShadowPass,
        view: &ShadeView,
    ) {
        gpu.write(&self.view, std::slice::from_ref(view));
        let Some((sides, textures)) = &self.starts else { return };
        watch.submit(gpu, |encoder| {
            let mark = encoder.mark("starts of walks");
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("starts of walks"),
                timestamp_writes: mark.as_ref().and_then(|mark| mark.writes(true, true)),
                color_attachments: &textures.attachments(),
                depth_stencil_attachment: Some(cleared_depth(&self.depth)),
                ..Default::default()
            });
            pass.set_bind_group(0, &shadow.light_group, &[]);
            pass.set_bind_group(1, &self.view_group, &[]);
            self.draw_opaque(&mut pass, meshes, &self.draws[1], |_| (sides, &self.view_group));
        });
    }

    /// Draws all but glass; `by` gives the pipelines of a draw and what its light is read from.
    fn draw_opaque<'s>(
        &'s self,
        pass: &mut wgpu::RenderPass<'_>,
        meshes: &Meshes,
        draws: &wgpu::BindGroup,
        by: impl Fn(u32) -> (&'s [wgpu::RenderPipeline; 2], &'s wgpu::BindGroup),
    ) {
        for (mesh, index) in meshes.meshes.iter().zip(0..) {
            if !self.is_glass[mesh.material] {
                self.bind_draw(pass, by(index), draws, (mesh.material, index));
                meshes.draw(pass, mesh);
            }
        }
    }

    fn bind_draw(
        &self,
        pass: &mut wgpu::RenderPass<'_>,
        (sides, light): (&[wgpu::RenderPipeline; 2], &wgpu::BindGroup),
        draws: &wgpu::BindGroup,
        (material, index): (usize, u32),
    ) {
        pass.set_pipeline(&sides[usize::from(self.is_double_sided[material])]);
        pass.set_bind_group(1, light, &[]);
        pass.set_bind_group(2, draws, &[index * self.draw_stride]);
        pass.set_bind_group(3, &self.materials[material], &[]);
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
            pass.set_bind_group(2, &self.draws[0], &[0]);
            pass.set_bind_group(3, material, &[]);
            pass.set_pipeline(&self.sky);
            pass.draw(0..3, 0..1);
        }
        let object = |index: u32| self.objects.as_ref().and_then(|objects| objects.of(index));
        self.draw_opaque(&mut pass, meshes, &self.draws[0], |index| {
            object(index).map_or((&self.opaque, &self.view_group), |(_, opaque, light)| (opaque, light))
        });
        let Some(glass) = &self.glass else { return };
        pass.set_index_buffer(self.pane_corners.slice(..), wgpu::IndexFormat::Uint32);
        for (index, triangles) in panes {
            let material = meshes.meshes[*index as usize].material;
            let own = object(*index).and_then(|(glass, _, light)| Some((glass?, light)));
            let by = own.unwrap_or((glass, &self.view_group));
            self.bind_draw(&mut pass, by, &self.draws[0], (material, *index));
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
