//! The passes of a bake with a field on the adapter: those of its lightmap, and light at probes once before each picture.

use glam::{IVec4, Vec4};
use lightkiln_proto::kinds::field::{
    Between, FieldTable, LatticeTable, MAP_POINTS, PROBE_ROWS, TetrahedraTable,
};
use lightkiln_proto::relight::{LodPlan, LodTable};

use super::FieldLight;
use super::dering::DeringPass;
use crate::bake::{LightPasses, ReceiverBuffers, UnshadowedArrays};
use crate::error::Result;
use crate::lightmap::LightmapPasses;
use crate::passes::basis::BasisPass;
use crate::passes::gpu::Gpu;
use crate::passes::lod::DetailBuffers;
use crate::passes::reconstruct::{ReconstructPass, RowArrays};
use crate::passes::shadow::ShadowPass;
use crate::passes::stopwatch::Recorder;
use crate::passes::transfer::MovedBuffers;
use crate::scene::LoadedScene;

/// Shading: the lightmap's, and that of a field on a lattice for surfaces without one.
pub const IN_LATTICE: &str = concat!(
    include_str!("../../passes/atlas/lightmap.wgsl"),
    include_str!("lattice.wgsl"),
    include_str!("field.wgsl"),
    include_str!("beside.wgsl")
);
/// Likewise of a field in tetrahedra.
pub const IN_TETRAHEDRA: &str = concat!(
    include_str!("../../passes/atlas/lightmap.wgsl"),
    include_str!("tetrahedra.wgsl"),
    include_str!("field.wgsl"),
    include_str!("beside.wgsl")
);
/// Shading: a field on a lattice lights all.
pub const LATTICE_ALONE: &str =
    concat!(include_str!("lattice.wgsl"), include_str!("field.wgsl"), include_str!("alone.wgsl"));
/// Likewise one in tetrahedra.
pub const TETRAHEDRA_ALONE: &str =
    concat!(include_str!("tetrahedra.wgsl"), include_str!("field.wgsl"), include_str!("alone.wgsl"));
/// Mean radiance for a medium, between probes on a lattice.
pub const LATTICE_MEDIUM: &str =
    concat!(include_str!("lattice.wgsl"), include_str!("field.wgsl"), include_str!("medium.wgsl"));
/// Likewise in tetrahedra.
pub const TETRAHEDRA_MEDIUM: &str =
    concat!(include_str!("tetrahedra.wgsl"), include_str!("field.wgsl"), include_str!("medium.wgsl"));
/// Largest difference of E from the reference, relative to the largest value: sums of some hundred f32 in another order, and depths
/// that say by a hair whether a probe sees a point.
pub const TOLERANCE: f32 = 1e-3;

/// Words of a probe: its place, and a depth map of 16 bits a point.
const PROBE_WORDS: usize = 3 + MAP_POINTS.div_ceil(2);

/// Numbers of a field on a lattice; twin of `LatticeField`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct LatticeNumbers {
    /// Least point of the lattice.
    pub low: IVec4,
    /// Points along each axis.
    pub size: IVec4,
    /// Step of the lattice in metres.
    pub spacing_m: f32,
    /// First word of the first probe.
    pub first_probe: u32,
    /// Probes.
    pub probe_count: u32,
    /// 0.
    pub pad: u32,
}

/// Numbers of a field in tetrahedra; twin of `TetrahedraField`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct TetrahedraNumbers {
    /// Least corner of the box in metres.
    pub low_m: Vec4,
    /// Greatest.
    pub high_m: Vec4,
    /// Cells that walks begin in, along each axis; their number.
    pub cells: IVec4,
    /// Edge of such a cell in metres.
    pub cell_m: f32,
    /// Step of the lattice that depths are in, in metres.
    pub spacing_m: f32,
    /// First word of the first probe.
    pub first_probe: u32,
    /// Probes.
    pub probe_count: u32,
}

/// The passes, with their buffers.
#[derive(Debug)]
pub struct FieldPasses {
    lightmap: LightmapPasses,
    basis: BasisPass,
    reconstruct: ReconstructPass,
    dering: DeringPass,
    /// Coefficients straight from emitters.
    direct: wgpu::Buffer,
    /// Coefficients at probes.
    rows: wgpu::Buffer,
    row_count: usize,
    numbers: wgpu::Buffer,
    probes: wgpu::Buffer,
}

impl FieldPasses {
    /// Uploads the light of a bake.
    pub fn new(gpu: &Gpu, scene: &LoadedScene, light: &FieldLight, shadow: &ShadowPass) -> Result<Self> {
        let lightmap = LightmapPasses::new(gpu, scene, &light.lightmap, shadow)?;
        let field = &light.field;
        let four = size_of::<Vec4>() as u64;
        let bytes = (PROBE_ROWS * field.len()) as u64 * four;
        let (direct, rows) =
            (gpu.blank("light of emitters at probes", bytes)?, gpu.blank("light at probes", bytes)?);
        let b = gpu.blank("b of probes", field.clusters.b_len as u64 * four)?;
        let detail = DetailBuffers::new(gpu, &field.clusters)?;
        let arrays = RowArrays { b: &b, start: &direct, beside: None, result: &rows, detail: &detail };
        Ok(Self {
            basis: BasisPass::new(gpu, &field.clusters, [&lightmap.resident.lambda, &b], &detail)?,
            reconstruct: ReconstructPass::new(gpu, &field.clusters, arrays)?,
            dering: DeringPass::new(gpu, &rows, PROBE_ROWS * field.len())?,
            numbers: numbers(gpu, field),
            probes: gpu.storage("probes", &words(field))?,
            lightmap,
            direct,
            rows,
            row_count: PROBE_ROWS * field.len(),
        })
    }
}

/// Mean radiance of a field for a medium.
pub fn medium(field: &FieldTable) -> &'static str {
    match field.between {
        Between::Lattice(_) => LATTICE_MEDIUM,
        Between::Tetrahedra(_) => TETRAHEDRA_MEDIUM,
    }
}

/// The uniform of a field: [`LatticeNumbers`] or [`TetrahedraNumbers`].
pub fn numbers(gpu: &Gpu, field: &FieldTable) -> wgpu::Buffer {
    let (spacing_m, probe_count) = (field.spacing_m, field.len() as u32);
    let first_probe = between(field).len() as u32;
    match &field.between {
        Between::Lattice(LatticeTable { low, size, .. }) => {
            let (low, size) = (low.extend(0), size.extend(0));
            gpu.uniform("field", &LatticeNumbers { low, size, spacing_m, first_probe, probe_count, pad: 0 })
        }
        Between::Tetrahedra(TetrahedraTable { low_m, high_m, cells, cell_m, starts, .. }) => {
            let numbers = TetrahedraNumbers {
                low_m: low_m.extend(0.0),
                high_m: high_m.extend(0.0),
                cells: cells.extend(starts.len() as i32),
                cell_m: *cell_m,
                spacing_m,
                first_probe,
                probe_count,
            };
            gpu.uniform("field", &numbers)
        }
    }
}

/// Words of what is between probes: the probe of each point of the lattice and of each cell; or the tetrahedron of each cell, and four
/// vertices and what is beyond four faces of each tetrahedron.
fn between(field: &FieldTable) -> Vec<u32> {
    match &field.between {
        Between::Lattice(lattice) => [&lattice.probe_at[..], &lattice.probe_in].concat(),
        Between::Tetrahedra(TetrahedraTable { starts, vertices, beyond, .. }) => {
            let each =
                vertices.iter().zip(beyond).flat_map(|(vertices, beyond)| [*vertices, *beyond].concat());
            starts.iter().copied().chain(each).collect()
        }
    }
}

/// Words of the buffer of probes: those of the lattice or the tetrahedra, then each probe's place and depth map.
pub fn words(field: &FieldTable) -> Vec<u32> {
    let mut words = between(field);
    words.reserve(PROBE_WORDS * field.len());
    for (position_m, depths) in field.position_m.iter().zip(field.depths.chunks_exact(MAP_POINTS)) {
        words.extend(position_m.truncate().to_array().map(f32::to_bits));
        let pair = |pair: &[u16]| u32::from(pair[0]) | pair.get(1).map_or(0, |&high| u32::from(high) << 16);
        words.extend(depths.chunks(2).map(pair));
    }
    words
}

impl LightPasses for FieldPasses {
    fn set_unshadowed(&self, gpu: &Gpu, UnshadowedArrays { emit, sky }: &UnshadowedArrays) {
        let (receivers, probes) = emit.split_at(self.lightmap.resident.receiver_count.min(emit.len()));
        self.lightmap.set_unshadowed(gpu, &UnshadowedArrays { emit: receivers.to_vec(), sky: sky.clone() });
        gpu.write(&self.direct, probes);
    }

    fn set_albedo(&self, gpu: &Gpu, albedo: &[Vec4]) {
        self.lightmap.set_albedo(gpu, albedo);
    }

    fn relit(&self, encoder: &mut Recorder<'_>, shadow: &ShadowPass) {
        self.lightmap.relit(encoder, shadow);
    }

    fn bounce(&self, encoder: &mut Recorder<'_>) {
        self.lightmap.bounce(encoder);
    }

    fn make_moved(&mut self, gpu: &Gpu) -> Result<()> {
        self.lightmap.make_moved(gpu)
    }

    fn moved(&self) -> Option<MovedBuffers<'_>> {
        self.lightmap.moved()
    }

    fn make_lod(&mut self, gpu: &Gpu, table: &LodTable) -> Result<()> {
        self.lightmap.make_lod(gpu, table)
    }

    fn set_lod(&mut self, gpu: &Gpu, plan: Option<&LodPlan>) {
        self.lightmap.set_lod(gpu, plan);
    }

    fn set_turn(&self, gpu: &Gpu, bounce: u32) {
        self.lightmap.set_turn(gpu, bounce);
    }

    /// Light at probes from the λ of the last bounce, which no picture needs before.
    fn publish(&self, encoder: &mut Recorder<'_>) {
        self.lightmap.publish(encoder);
        self.basis.record(&mut encoder.compute("basis of probes"));
        self.reconstruct.record(&mut encoder.compute("light at probes"));
        self.dering.record(&mut encoder.compute("dering"));
    }

    fn make_paint(&mut self, gpu: &Gpu) -> Result<()> {
        self.lightmap.make_paint(gpu)
    }

    fn paint(&self, gpu: &Gpu, encoder: &mut Recorder<'_>, colours: &[Vec4]) {
        self.lightmap.paint(gpu, encoder, colours);
    }

    fn feedback(&self) -> Option<(&wgpu::Buffer, usize)> {
        self.lightmap.feedback()
    }

    fn at_receivers(&self) -> Option<ReceiverBuffers<'_>> {
        let probes = Some((&self.rows, self.row_count));
        Some(ReceiverBuffers { probes, ..self.lightmap.at_receivers()? })
    }

    fn lambda(&self) -> Option<&wgpu::Buffer> {
        self.lightmap.lambda()
    }

    fn bindings(&self) -> Vec<wgpu::BindingResource<'_>> {
        let mut bindings = self.lightmap.bindings();
        bindings.extend([&self.numbers, &self.probes, &self.rows].map(wgpu::Buffer::as_entire_binding));
        bindings
    }
}
