//! Light around an object: walks from its viewpoints through the voxels of the bake that it stands in, their means over parts of the sphere and over
//! caps, and the light of its own parts. References: `Surroundings`, `Hidden` and `TransferTable` of the contract.

mod mix;

use glam::{Affine3A, Vec3, Vec4};
use lightkiln_proto::transfer::{
    HIDDEN_WIDTHS, TransferTable, VIEWPOINTS_A_SIDE, ViewpointLattice, WALKS_OF_PART, directions_of_walks,
    hidden_axes, hidden_cosine, tangent_of_walks,
};
use wgpu::ShaderStages as Stages;

use crate::error::{ClientError, Result};
use crate::passes::gpu::{Gpu, storage_read, storage_write, uniform};
use crate::passes::shadow::EMITTER_POINTS;
use crate::passes::stopwatch::Recorder;
use crate::passes::transfer::{MoverTable, rows_of};
use crate::passes::walk::{WalkTable, walks_source};

pub use mix::{MixNumbers, MixPass};

/// The shader of walks.
pub const LOOK_SHADER: &str = concat!(
    walks_source!(),
    include_str!("../walk/seen.wgsl"),
    include_str!("viewpoints.wgsl"),
    include_str!("look.wgsl")
);
/// The shader of means.
pub const MEANS_SHADER: &str = concat!(include_str!("viewpoints.wgsl"), include_str!("means.wgsl"));
/// The shader of light of parts.
pub const PARTS_SHADER: &str =
    concat!(include_str!("viewpoints.wgsl"), include_str!("weights.wgsl"), include_str!("parts.wgsl"));
/// The shader that mixes the light of viewpoints.
pub const MIX_SHADER: &str =
    concat!(include_str!("viewpoints.wgsl"), include_str!("weights.wgsl"), include_str!("mix.wgsl"));
/// Threads of a workgroup in the shaders.
const THREADS: u32 = 64;
/// Most viewpoints.
const VIEWPOINTS_MAX: u32 = VIEWPOINTS_A_SIDE.pow(3);
/// Most walks of a viewpoint.
const WALKS_MAX: u32 = 256;

/// Numbers of an object's viewpoints; twin of `Viewpoints` in the shaders.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct ViewpointNumbers {
    /// Rows of the map from the object's space to the world.
    pub rows: [[f32; 4]; 3],
    /// Middle of its bounds.
    pub middle_m: [f32; 3],
    /// How many there are.
    pub count: u32,
    /// From the middle to a corner.
    pub half_m: [f32; 3],
    /// Walks of each.
    pub walks: u32,
    /// Viewpoints along each axis.
    pub counts: [u32; 3],
    /// Parts of the sphere around.
    pub parts: u32,
    /// A bit of each to which nothing is in the way from the middle.
    pub open: [u32; 2],
    /// Tangent of the half angle of walks.
    pub tangent: f32,
    /// Parts of the volume.
    pub part_count: u32,
    /// First number of their light.
    pub first_light: u32,
    /// 0.
    pub pad0: u32,
    /// 0.
    pub pad1: u32,
    /// 0.
    pub pad2: u32,
    /// Emitters, and of each the share for which points stand.
    pub pointed: [[f32; 4]; EMITTER_POINTS],
}

/// Radiance of emitters of a part, and its patches; twin of `PartOwn` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct PartOwn {
    /// Mean place.
    pub middle_m: [f32; 3],
    /// First of its patches.
    pub first: u32,
    /// Radiance of emitters, W·m⁻²·sr⁻¹.
    pub emitted: [f32; 3],
    /// Its patches.
    pub count: u32,
}

/// A patch of a part; twin of `PartShare` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct PartShare {
    /// Place in λ.
    pub place: u32,
    /// Share of the part's area.
    pub share: f32,
}

/// The passes of one object on the adapter.
#[derive(Debug)]
pub struct AroundPass {
    own: ViewpointNumbers,
    /// [`ViewpointNumbers`].
    pub viewpoints: wgpu::Buffer,
    /// 1 of each viewpoint that sees something.
    pub present: wgpu::Buffer,
    /// Radiance of parts of the sphere, viewpoint after viewpoint, W·m⁻²·sr⁻¹.
    pub around: wgpu::Buffer,
    look: (wgpu::ComputePipeline, wgpu::BindGroup),
    means: [(wgpu::ComputePipeline, wgpu::BindGroup); 2],
    parts: (wgpu::ComputePipeline, wgpu::BindGroup),
}

impl AroundPass {
    /// Of an object whose transport knows `sky_parts` parts of the sphere around it, whose emitters have such radiance and whose patches have λ.
    pub fn new(
        gpu: &Gpu,
        walks: &WalkTable,
        (volume, sky_parts): (&TransferTable, u32),
        (emitters, lambda): (&[Vec3], &wgpu::Buffer),
        (table, mover): (&MoverTable, usize),
    ) -> Result<Self> {
        let count = WALKS_OF_PART * sky_parts;
        if count > WALKS_MAX {
            let problem =
                format!("objects know at most {} parts of the sphere around them", WALKS_MAX / WALKS_OF_PART);
            return Err(ClientError::Adapter { problem });
        }
        let lattice = ViewpointLattice::of_corners(volume.box_m());
        let own = ViewpointNumbers {
            rows: rows_of(&Affine3A::IDENTITY),
            middle_m: lattice.middle_m.into(),
            count: lattice.count() as u32,
            half_m: lattice.half_m.into(),
            walks: count,
            counts: lattice.counts.into(),
            parts: sky_parts,
            open: [0; 2],
            tangent: tangent_of_walks(sky_parts),
            part_count: volume.levels().map(|(level, _)| level.parts.len() as u32).sum(),
            first_light: table.first_light_of(mover),
            pad0: 0,
            pad1: 0,
            pad2: 0,
            pointed: [[0.0; 4]; EMITTER_POINTS],
        };
        let four = size_of::<Vec4>() as u64;
        let most = |each: u32| u64::from(VIEWPOINTS_MAX * each) * four;
        let caps = HIDDEN_WIDTHS * hidden_axes().count() as u32;
        let viewpoints = gpu.uniform("viewpoints", &own);
        let met = gpu.blank("what walks met", most(count))?;
        let present = gpu.blank("viewpoints that see", u64::from(VIEWPOINTS_MAX) * 4)?;
        let around = gpu.blank("light around", most(sky_parts))?;
        let over_caps = gpu.blank("light over caps", most(caps))?;
        let mut directions = vec![Vec4::ZERO; WALKS_MAX as usize];
        for (row, (direction, part)) in directions.iter_mut().zip(directions_of_walks(sky_parts)) {
            *row = direction.extend(part as f32);
        }
        let directions = uniform_rows(gpu, "directions of walks", &directions);
        let cosines = (0..HIDDEN_WIDTHS).map(|width| Vec4::splat(hidden_cosine(width)));
        let axes: Vec<Vec4> = hidden_axes().map(|axis| axis.extend(0.0)).chain(cosines).collect();
        let axes = uniform_rows(gpu, "axes of caps", &axes);
        let look_layout = gpu.bind_layout(
            &[uniform(false), storage_write(), uniform(false)].map(|kind| (Stages::COMPUTE, kind)),
        );
        let look = gpu.compute_with(
            ("look around", LOOK_SHADER, "look"),
            Some(&gpu.pipeline_layout(&[walks.bound().0, &look_layout])),
            &[],
        );
        let look_group =
            gpu.bind(&look_layout, &[&viewpoints, &met, &directions].map(wgpu::Buffer::as_entire_binding));
        let read = storage_read;
        let means_kinds = [
            uniform(false),
            read(),
            uniform(false),
            storage_write(),
            storage_write(),
            storage_write(),
            uniform(false),
        ];
        let means_layout = gpu.bind_layout(&means_kinds.map(|kind| (Stages::COMPUTE, kind)));
        let means_group = gpu.bind(
            &means_layout,
            &[&viewpoints, &met, &directions, &present, &around, &over_caps, &axes]
                .map(wgpu::Buffer::as_entire_binding),
        );
        let means = ["mean_of_parts", "mean_over_caps"].map(|entry| {
            let layout = gpu.pipeline_layout(&[&means_layout]);
            (gpu.compute_with((entry, MEANS_SHADER, entry), Some(&layout), &[]), means_group.clone())
        });
        let (rows, shares) = own_parts(volume, emitters);
        let parts = gpu.compute("light of parts", PARTS_SHADER, "light_parts");
        let (rows, shares) = (gpu.storage("parts", &rows)?, gpu.storage("patches of parts", &shares)?);
        let parts_group = gpu.bind(
            &parts.get_bind_group_layout(0),
            &[&viewpoints, &present, &over_caps, &rows, &shares, lambda, &table.part_light]
                .map(wgpu::Buffer::as_entire_binding),
        );
        let (look, parts) = ((look, look_group), (parts, parts_group));
        Ok(Self { own, viewpoints, present, around, look, means, parts })
    }

    /// Writes where the object stands, its viewpoints, and to which nothing is in the way; and of each emitter the share for which points stand.
    pub fn set(
        &mut self,
        gpu: &Gpu,
        world_from_object: &Affine3A,
        (lattice, is_open): (&ViewpointLattice, impl Fn(Vec3) -> bool),
        shares: &[f32],
    ) {
        let mut open = [0; 2];
        for (viewpoint, at_m) in lattice.places().enumerate() {
            open[viewpoint / 32] |= u32::from(is_open(at_m)) << (viewpoint % 32);
        }
        let mut pointed = [[0.0; 4]; EMITTER_POINTS];
        let of_points = (0..).zip(shares).filter(|(_, share)| **share > 0.0);
        for (row, (emitter, share)) in pointed.iter_mut().zip(of_points) {
            *row = [emitter as f32, *share, 0.0, 0.0];
        }
        let (count, counts) = (lattice.count() as u32, lattice.counts.into());
        self.own =
            ViewpointNumbers { rows: rows_of(world_from_object), count, counts, open, pointed, ..self.own };
        gpu.write(&self.viewpoints, &[self.own]);
    }

    /// Records walks and their means, of λ as it is.
    pub fn look(&self, encoder: &mut Recorder<'_>, walks: &WalkTable) {
        let mut pass = encoder.compute("light around objects");
        let groups = |threads: u32| threads.div_ceil(THREADS);
        pass.set_pipeline(&self.look.0);
        pass.set_bind_group(0, walks.bound().1, &[]);
        pass.set_bind_group(1, &self.look.1, &[]);
        pass.dispatch_workgroups(groups(self.own.count * self.own.walks), 1, 1);
        let caps = HIDDEN_WIDTHS * hidden_axes().count() as u32;
        for ((pipeline, group), each) in self.means.iter().zip([self.own.parts, caps]) {
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, group, &[]);
            pass.dispatch_workgroups(groups(self.own.count * each), 1, 1);
        }
    }

    /// Records the light of parts, of the object's λ as it is.
    pub fn light_parts(&self, encoder: &mut Recorder<'_>) {
        let caps = HIDDEN_WIDTHS * hidden_axes().count() as u32;
        let mut pass = encoder.compute("light of parts");
        pass.set_pipeline(&self.parts.0);
        pass.set_bind_group(0, &self.parts.1, &[]);
        pass.dispatch_workgroups((self.own.part_count * (1 + caps)).div_ceil(THREADS), 1, 1);
    }
}

fn uniform_rows(gpu: &Gpu, label: &str, rows: &[Vec4]) -> wgpu::Buffer {
    let buffer = gpu.buffer(label, size_of_val(rows) as u64, wgpu::BufferUsages::UNIFORM);
    gpu.write(&buffer, rows);
    buffer
}

fn own_parts(volume: &TransferTable, emitters: &[Vec3]) -> (Vec<PartOwn>, Vec<PartShare>) {
    let emitted = volume.radiance(&[], emitters);
    let (mut rows, mut shares) = (Vec::new(), Vec::new());
    for (((level, _), patches), emitted) in volume.levels().zip(volume.patches()).zip(emitted) {
        for ((part, patches), emitted) in level.parts.iter().zip(patches).zip(emitted) {
            let (first, count) = (shares.len() as u32, patches.len() as u32);
            rows.push(PartOwn { middle_m: part.middle_m, first, emitted: emitted.into(), count });
            shares.extend(patches.iter().map(|(place, share)| PartShare { place: *place, share: *share }));
        }
    }
    // A binding holds one at least.
    if shares.is_empty() {
        shares.push(PartShare { place: 0, share: 0.0 });
    }
    (rows, shares)
}
