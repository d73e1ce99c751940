//! Volumes of objects on the adapter.

use bytemuck::Zeroable as _;
use glam::{Affine3A, Vec4};
use lightkiln_proto::transfer::{HIDDEN_SIDE, HIDDEN_WIDTHS, LEVELS, Lattice, TransferLevel, TransferTable};

use super::EmitterPoint;
use crate::error::{ClientError, Result};
use crate::passes::gpu::Gpu;
use crate::passes::shadow::{EMITTER_POINTS, SightPlaces};

/// Most objects with volumes.
pub const MOVERS_MAX: usize = 16;
/// Rows of a point of emitters.
const ROWS_OF_POINT: usize = 3;
/// Bits of a draw's number among those of its bake, below the number of its object.
const DRAW_BITS: u32 = 24;
/// Numbers of light of a part: its radiance, and means over caps that it may hide.
const OF_PART: usize = 1 + (HIDDEN_WIDTHS * HIDDEN_SIDE * HIDDEN_SIDE) as usize;

/// A level of a volume; twin of `MoverLevel` in the shaders.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct MoverLevelRow {
    /// First node, nodes before and behind the object, and last node along each axis, in metres.
    pub stops_m: [[f32; 4]; 3],
    /// Intervals on each side of the object along each axis.
    pub outer: [f32; 3],
    /// Half side of its cube in metres.
    pub half_m: f32,
    /// Intervals between.
    pub inner: [f32; 3],
    /// Nodes along each axis.
    pub nodes: u32,
    /// First of its parts among those of all objects.
    pub first_part: u32,
    /// Its parts.
    pub part_count: u32,
    /// First of its codes.
    pub first_code: u32,
    /// 0.
    pub pad: u32,
}

/// An object; twin of `Mover` in the shaders.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct MoverRow {
    /// Rows of the map from the world to its own space.
    pub rows: [[f32; 4]; 3],
    /// Its middle in its own space.
    pub middle_m: [f32; 3],
    /// Half of its longest side.
    pub half_side_m: f32,
    /// Metres of its own space in one of the world.
    pub scale: f32,
    /// Points of emitters before it.
    pub points: u32,
    /// 0.
    pub pad1: u32,
    /// 0.
    pub pad2: u32,
    /// The finest first.
    pub levels: [MoverLevelRow; LEVELS as usize],
}

/// All objects; twin of `Movers` in the shaders.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct MoverNumbers {
    /// Objects.
    pub count: u32,
    /// First of the lights that stand for what objects see.
    pub first_light: u32,
    /// First of their faces.
    pub first_face: u32,
    /// First layer of these.
    pub first_layer: u32,
    /// First number of light of parts, behind their planes and steps.
    pub first_of_light: u32,
    /// First row of points of emitters.
    pub first_point: u32,
    /// First face in which one sees an object.
    pub first_silhouette: u32,
    /// 0.
    pub pad: u32,
    /// The objects.
    pub each: [MoverRow; MOVERS_MAX],
}

/// Volumes on the adapter, with the light of their parts.
#[derive(Debug)]
pub struct MoverTable {
    numbers: wgpu::Buffer,
    codes: wgpu::Buffer,
    /// Of each part its plane and its steps; of each object points of emitters; then of each its radiance and what it may hide.
    pub part_light: wgpu::Buffer,
    rows: Box<MoverNumbers>,
}

impl MoverTable {
    /// Uploads volumes, each with the first and the end of its draws among so many. Errs where they are more than [`MOVERS_MAX`].
    pub fn new(gpu: &Gpu, volumes: &[(&TransferTable, [usize; 2])], draws: usize) -> Result<Self> {
        if volumes.len() > MOVERS_MAX {
            let what = format!("{} objects with bakes of their own", volumes.len());
            let problem = format!("an adapter lights at most {MOVERS_MAX}");
            return Err(ClientError::Argument { what, problem });
        }
        let (mut parts, mut codes) = (Vec::new(), (0..draws as u32).collect::<Vec<u32>>());
        for ((_, [first, end]), mover) in volumes.iter().zip(1_u32..) {
            let numbered = (mover << DRAW_BITS..).zip(&mut codes[*first..*end]);
            numbered.for_each(|(number, code)| *code = number);
        }
        let mut rows = Box::new(MoverNumbers { count: volumes.len() as u32, ..MoverNumbers::zeroed() });
        for (row, (volume, _)) in rows.each.iter_mut().zip(volumes) {
            row.middle_m = volume.middle_m().into();
            row.half_side_m = volume.half_side_m();
            for (row, (level, lattice)) in row.levels.iter_mut().zip(volume.levels()) {
                *row = level_row(level, lattice, [parts.len() / 2, codes.len()]);
                for part in &level.parts {
                    let [of_vector, of_angle] = part.steps;
                    parts.extend([Vec4::from(part.plane), Vec4::new(of_vector, of_angle, 0.0, 0.0)]);
                }
                codes.extend(level.codes.iter().map(|code| u32::from_le_bytes(code.map(|one| one as u8))));
            }
        }
        let light = parts.len() / 2 * OF_PART;
        rows.first_point = parts.len() as u32;
        parts.resize(parts.len() + volumes.len() * EMITTER_POINTS * ROWS_OF_POINT, Vec4::ZERO);
        rows.first_of_light = parts.len() as u32;
        parts.resize(parts.len() + light, Vec4::ZERO);
        Ok(Self {
            numbers: gpu.storage("objects", std::slice::from_ref(&*rows))?,
            part_light: gpu.storage("light of parts", &parts)?,
            codes: gpu.storage("volumes", &codes)?,
            rows,
        })
    }

    /// Writes where objects stand and which emitters they have before them, and where what they see is.
    pub fn set<'a>(
        &mut self,
        gpu: &Gpu,
        each: impl Iterator<Item = (Affine3A, &'a [EmitterPoint])>,
        sights: SightPlaces,
    ) {
        let SightPlaces { first_light, first_face, first_silhouette, first_layer } = sights;
        *self.rows = MoverNumbers { first_light, first_face, first_silhouette, first_layer, ..*self.rows };
        let mut points = Vec::new();
        for ((row, (world_from_object, before)), index) in self.rows.each.iter_mut().zip(each).zip(1..) {
            row.points = before.len() as u32;
            points.extend(before.iter().flat_map(EmitterPoint::rows));
            points.resize(index * EMITTER_POINTS * ROWS_OF_POINT, Vec4::ZERO);
            let object_from_world = world_from_object.inverse();
            row.rows = rows_of(&object_from_world);
            row.scale = object_from_world.matrix3.x_axis.length().max(f32::MIN_POSITIVE);
        }
        gpu.write(&self.numbers, &[*self.rows]);
        let at = u64::from(self.rows.first_point) * size_of::<Vec4>() as u64;
        gpu.queue.write_buffer(&self.part_light, at, bytemuck::cast_slice(&points));
    }

    /// First number of light of an object's parts.
    pub fn first_light_of(&self, mover: usize) -> u32 {
        self.rows.first_of_light + self.rows.each[mover].levels[0].first_part * OF_PART as u32
    }

    /// Bytes of [`Self::part_light`] before all light.
    pub fn bytes_before_light(&self) -> u64 {
        u64::from(self.rows.first_of_light) * size_of::<Vec4>() as u64
    }

    /// Objects, their codes and their parts, in the order of the shaders' bindings.
    pub fn buffers(&self) -> [wgpu::Buffer; 3] {
        [&self.numbers, &self.codes, &self.part_light].map(Clone::clone)
    }
}

/// Rows of a map.
pub(in crate::passes) fn rows_of(map: &Affine3A) -> [[f32; 4]; 3] {
    [0, 1, 2].map(|row| {
        let along = map.matrix3.row(row);
        [along.x, along.y, along.z, map.translation[row]]
    })
}

fn level_row(level: &TransferLevel, lattice: &Lattice, [part, code]: [usize; 2]) -> MoverLevelRow {
    MoverLevelRow {
        stops_m: lattice.axes.map(|axis| axis.stops_m),
        outer: lattice.axes.map(|axis| axis.outer as f32),
        half_m: lattice.half_m,
        inner: lattice.axes.map(|axis| axis.inner as f32),
        nodes: level.nodes,
        first_part: part as u32,
        part_count: level.parts.len() as u32,
        first_code: code as u32,
        pad: 0,
    }
}
