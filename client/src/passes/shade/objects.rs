//! Objects with bakes of their own in the picture: their light is read from their own bakes.

use wgpu::ShaderStages as Stages;

use super::Shading;
use super::pipelines::{Program, blending, pipeline};
use crate::passes::gpu::{Gpu, uniform};
use crate::passes::transfer::MoverTable;

/// Objects to be shaded.
#[derive(Debug)]
pub struct ObjectShading<'a> {
    /// Their volumes.
    pub table: &'a MoverTable,
    /// The shading of all of them.
    pub shading: Shading,
    /// Of each, the first and the end of its draws, and the resources of its bindings.
    pub each: Vec<([usize; 2], Vec<wgpu::BindingResource<'a>>)>,
}

/// Pipelines of single-sided and of double-sided surfaces.
type Sides = [wgpu::RenderPipeline; 2];

/// Objects as the pass draws them.
#[derive(Debug)]
pub(super) struct ShadedObjects {
    pub(super) tables: [wgpu::Buffer; 3],
    opaque: Sides,
    glass: Option<Sides>,
    each: Vec<([usize; 2], wgpu::BindGroup)>,
}

impl ShadedObjects {
    /// With the pipelines of the bake around them where these do, else with their own.
    pub(super) fn new(
        gpu: &Gpu,
        objects: &ObjectShading<'_>,
        (around, beside): (&Shading, &[wgpu::BindingResource<'_>]),
        (opaque, glass): (&Sides, &Option<Sides>),
        [lights, view_layout, draws, materials]: [&wgpu::BindGroupLayout; 4],
        (view, constants): (&wgpu::Buffer, &[(&str, f64)]),
    ) -> Self {
        let shading = &objects.shading;
        // One layout for all where it can be: what the objects' own shader does not read is that of the bake around them.
        let (mut view_layout, mut beside) = (view_layout.clone(), beside);
        if around.bindings.starts_with(&shading.bindings) {
            beside = &beside[shading.bindings.len()..];
        } else {
            let mut kinds = vec![(Stages::VERTEX_FRAGMENT, uniform(false))];
            kinds.extend(shading.bindings.iter().map(|kind| (Stages::FRAGMENT, *kind)));
            (view_layout, beside) = (gpu.bind_layout(&kinds), &[]);
        }
        let (mut opaque, mut glass) = (opaque.clone(), glass.clone());
        if shading != around {
            let layout = gpu.pipeline_layout(&[lights, &view_layout, draws, materials]);
            let module = gpu.module("shade objects", &shading.shader_with_objects());
            let shade = Program { module: &module, vertex: "corner", fragment: "shade", constants };
            let sides = [Some(wgpu::Face::Back), None];
            opaque = sides.map(|cull| pipeline(gpu, &layout, shade, cull, None));
            let blend = glass.is_some().then(|| blending(gpu).ok()).flatten();
            glass = blend.map(|blend| sides.map(|cull| pipeline(gpu, &layout, shade, cull, Some(blend))));
        }
        let bind = |(draws, resources): &([usize; 2], Vec<wgpu::BindingResource<'_>>)| {
            let all = [&[view.as_entire_binding()], &resources[..], beside].concat();
            (*draws, gpu.bind(&view_layout, &all))
        };
        Self { tables: objects.table.buffers(), opaque, glass, each: objects.each.iter().map(bind).collect() }
    }

    /// Pipelines for glass and for all else, and the light, of a draw that is an object's.
    pub(super) fn of(&self, draw: u32) -> Option<(Option<&Sides>, &Sides, &wgpu::BindGroup)> {
        let draw = draw as usize;
        let own = self.each.iter().find(|([first, end], _)| (*first..*end).contains(&draw));
        own.map(|(_, light)| (self.glass.as_ref(), &self.opaque, light))
    }
}
