//! Captured light: coefficients at probes that stay as they are.

use glam::{Vec3, Vec4};
use lightkiln_proto::kinds::captured;
use lightkiln_proto::kinds::field::{Between, FieldTable};
use lightkiln_proto::relight::Limit;

use crate::bake::{
    Among, FreeSpace, Light, LightPasses, LitScene, ReceiverBuffers, ReceiverLight, SettledLight,
    SettledReceivers,
};
use crate::error::Result;
use crate::kinds::field::{LATTICE_ALONE, TETRAHEDRA_ALONE, medium, numbers, words};
use crate::passes::gpu::{Gpu, storage_read, uniform};
use crate::passes::shade::{IndirectIrradiance, Shading, Surface};
use crate::passes::shadow::ShadowPass;
use crate::scene::LoadedScene;
use crate::threads::Threads;

/// Bindings of a lightmap, whose places stay empty.
const OF_LIGHTMAP: usize = 2;

/// The light of a bake.
#[derive(Debug)]
pub struct CapturedLight {
    /// Probes.
    pub field: FieldTable,
    /// Coefficients at them.
    pub rows: Vec<Vec4>,
}

impl CapturedLight {
    /// Of the kind's field.
    pub fn new(field: FieldTable) -> Self {
        let rows = captured::light(&field, &Threads);
        Self { field, rows }
    }
}

/// The light, for shading on the processor.
struct Shown<'a>(&'a CapturedLight);

impl IndirectIrradiance for Shown<'_> {
    fn indirect_irradiance(&self, surface: &Surface) -> Vec3 {
        let CapturedLight { field, rows } = self.0;
        field.irradiance(rows, field.raised(surface.position, surface.facet), surface.towards)
    }

    fn mean_radiance(&self, point: Vec3) -> Vec3 {
        self.0.field.mean_radiance(&self.0.rows, point)
    }
}

impl Light for CapturedLight {
    fn shading(&self) -> Shading {
        let mut bindings = vec![storage_read(); OF_LIGHTMAP];
        bindings.extend([uniform(false), storage_read(), storage_read()]);
        let snippet = match self.field.between {
            Between::Lattice(_) => LATTICE_ALONE,
            Between::Tetrahedra(_) => TETRAHEDRA_ALONE,
        };
        Shading { snippet, bindings }
    }

    fn medium(&self) -> Option<&'static str> {
        Some(medium(&self.field))
    }

    fn settle<'a>(&'a self, _: &LitScene<'a>, _: &Among<'_>, _: Limit) -> SettledLight<'a> {
        SettledLight { indirect: Box::new(Shown(self)), walks: None, bounces: 0, converged: true }
    }

    fn at_receivers(&self, _: &LitScene<'_>, _: &Among<'_>, _: Limit) -> Option<SettledReceivers> {
        let light = ReceiverLight { probes: self.rows.clone(), ..ReceiverLight::default() };
        Some(SettledReceivers { light, bounces: 0, converged: true })
    }

    fn passes(
        &self,
        gpu: &Gpu,
        _: &LoadedScene,
        _: &ShadowPass,
        _: [u32; 2],
    ) -> Result<Box<dyn LightPasses>> {
        Ok(Box::new(CapturedPasses {
            numbers: numbers(gpu, &self.field),
            probes: gpu.storage("probes", &words(&self.field))?,
            rows: gpu.storage("light at probes", &self.rows)?,
            row_count: self.rows.len(),
        }))
    }

    fn follows_lights(&self) -> bool {
        false
    }

    fn free_space(&self) -> Option<&dyn FreeSpace> {
        Some(&self.field)
    }
}

/// Buffers of the field; nothing is computed.
#[derive(Debug)]
struct CapturedPasses {
    numbers: wgpu::Buffer,
    probes: wgpu::Buffer,
    rows: wgpu::Buffer,
    row_count: usize,
}

impl LightPasses for CapturedPasses {
    fn at_receivers(&self) -> Option<ReceiverBuffers<'_>> {
        let none = &self.rows;
        let probes = Some((&self.rows, self.row_count));
        Some(ReceiverBuffers { direct: none, emit: none, indirect: none, count: 0, probes })
    }

    fn bindings(&self) -> Vec<wgpu::BindingResource<'_>> {
        let of_lightmap = std::iter::repeat_n(&self.rows, OF_LIGHTMAP);
        let all = of_lightmap.chain([&self.numbers, &self.probes, &self.rows]);
        all.map(wgpu::Buffer::as_entire_binding).collect()
    }
}
