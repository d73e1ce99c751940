//! Mesh primitives to plain triangles in object space: any triangle mode, indexed or not, unused vertices left out.

use glam::{Vec2, Vec3};
use gltf::json::accessor::Type;
use gltf::json::mesh::{Mode, MorphTarget, Primitive, Semantic};
use gltf::json::validation::Checked;
use gltf::json::{Accessor, Index};

use super::Opening;
use super::accessor::{Reader, Wanted};
use super::context::Context;
use super::document::primitive_place;
use super::error::{ImportError, Result};
use super::limits::{self, within};
use super::pose::{self, Influences};

/// Marks a vertex that no triangle has used yet.
const UNUSED: u32 = u32::MAX;

/// A primitive in object space, as the file has it.
#[derive(Debug, Default)]
pub(super) struct LocalMesh {
    pub(super) positions: Vec<Vec3>,
    /// As stated, neither unit nor finite for sure; `None` when the file has none.
    pub(super) normals: Option<Vec<Vec3>>,
    pub(super) uv0: Vec<Vec2>,
    pub(super) uv1: Vec<Vec2>,
    pub(super) colours: Vec<[f32; 4]>,
    pub(super) triangles: Vec<[u32; 3]>,
    /// Joints of a skin that pull at each vertex; empty when the file has none.
    pub(super) influences: Vec<Influences>,
}

/// Reads primitives; keeps its vertex table between them, since many may share one big vertex buffer.
#[derive(Default)]
pub(super) struct PrimitiveReader {
    /// Position in the compacted vertex list by position in the file's; [`UNUSED`] between calls.
    compact_of: Vec<u32>,
}

impl PrimitiveReader {
    /// One primitive in the shape that `weights` of its morph targets give, or `None` (with a warning) if it has no
    /// triangles to read.
    ///
    /// Errors on attributes that do not fit each other or their buffers, and on indices out of range.
    pub(super) fn read(
        &mut self,
        context: &mut Context<'_>,
        mesh_index: usize,
        primitive_index: usize,
        weights: &[f32],
    ) -> Result<Option<LocalMesh>> {
        let root = context.root;
        let primitive = &root.meshes[mesh_index].primitives[primitive_index];
        let place = || primitive_place(root, mesh_index, primitive_index);
        let Some((mode, position_index)) = triangle_source(context, primitive, &place)? else {
            return Ok(None);
        };
        let source = Source { primitive, weights, place: &place };
        let positions = source.open(context, position_index, "POSITION", &[Type::Vec3], 0, false)?;
        let corners = source.corners(context, positions.count())?;
        let triangle_count = triangle_count(context, mode, corners.count, &place);
        context.budgets.triangles.spend(triangle_count as u64)?;
        // The table of used vertices is as long as the highest index.
        within(limits::VERTICES, positions.count() as u64, context.limits.vertices)?;
        let (triangles, vertices) = self.compact(mode, triangle_count, &corners, &source)?;
        let is_flat = !primitive.attributes.contains_key(&Checked::Valid(Semantic::Normals));
        let vertex_count = if is_flat { triangles.len() * 3 } else { vertices.len() };
        context.budgets.vertices.spend(vertex_count as u64)?;
        source.read_attributes(context, &positions, &vertices, triangles).map(Some)
    }

    /// Triangles over a compacted vertex list in order of first use, and for each of its vertices where the file has it.
    fn compact(
        &mut self,
        mode: Mode,
        triangle_count: usize,
        corners: &Corners<'_>,
        source: &Source<'_>,
    ) -> Result<(Vec<[u32; 3]>, Vec<u32>)> {
        let mut triangles = Vec::with_capacity(triangle_count);
        let mut vertices = Vec::new();
        let result = (0..triangle_count).try_for_each(|triangle| {
            let mut compacted = [0; 3];
            for (slot, position) in compacted.iter_mut().zip(triangle_corners(mode, triangle)) {
                let vertex = corners.vertex(position, source.place)?;
                *slot = self.compact_vertex(vertex, &mut vertices);
            }
            triangles.push(compacted);
            Ok(())
        });
        for &vertex in &vertices {
            self.compact_of[vertex as usize] = UNUSED;
        }
        result.map(|()| (triangles, vertices))
    }

    fn compact_vertex(&mut self, vertex: u32, vertices: &mut Vec<u32>) -> u32 {
        let position = vertex as usize;
        if position >= self.compact_of.len() {
            self.compact_of.resize(position + 1, UNUSED);
        }
        if self.compact_of[position] == UNUSED {
            self.compact_of[position] = vertices.len() as u32;
            vertices.push(vertex);
        }
        self.compact_of[position]
    }
}

/// The triangle mode and positions of a primitive that has them; warns about those that do not.
fn triangle_source(
    context: &mut Context<'_>,
    primitive: &Primitive,
    place: &dyn Fn() -> String,
) -> Result<Option<(Mode, Index<Accessor>)>> {
    let fail = |problem: &str| ImportError::Accessor { place: place(), problem: problem.to_owned() };
    let Checked::Valid(mode) = primitive.mode else { return Err(fail("its mode is not one of glTF's")) };
    if !matches!(mode, Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
        context.warnings.add("points-and-lines-skipped", || format!("{} has no triangles", place()));
        return Ok(None);
    }
    let has_targets = primitive.targets.as_ref().is_some_and(|targets| !targets.is_empty());
    if has_targets && context.opening == Opening::Still {
        context
            .warnings
            .add("morph-at-rest", || format!("{} is baked in the shape of its default weights", place()));
    }
    let Some(&position_index) = primitive.attributes.get(&Checked::Valid(Semantic::Positions)) else {
        context.warnings.add("no-positions-skipped", || format!("{} has no positions", place()));
        return Ok(None);
    };
    Ok(Some((mode, position_index)))
}

/// Count of whole triangles that `corner_count` corners make.
fn triangle_count(
    context: &mut Context<'_>,
    mode: Mode,
    corner_count: usize,
    place: &dyn Fn() -> String,
) -> usize {
    if mode != Mode::Triangles {
        return corner_count.saturating_sub(2);
    }
    if !corner_count.is_multiple_of(3) {
        context.warnings.add("incomplete-triangle-dropped", || {
            format!("{} has {corner_count} corners, which is not a multiple of 3", place())
        });
    }
    corner_count / 3
}

/// Which corners make triangle `i`, counter-clockwise (glTF 2.0 §3.7.2.1).
fn triangle_corners(mode: Mode, i: usize) -> [usize; 3] {
    match mode {
        Mode::TriangleStrip => [i, i + 1 + i % 2, i + 2 - i % 2],
        Mode::TriangleFan => [i + 1, i + 2, 0],
        _ => [3 * i, 3 * i + 1, 3 * i + 2],
    }
}

/// The index list of a primitive, or the plain count when it has none.
struct Corners<'a> {
    indices: Option<Reader<'a>>,
    count: usize,
    vertex_count: usize,
}

impl Corners<'_> {
    fn vertex(&self, position: usize, place: &dyn Fn() -> String) -> Result<u32> {
        let index = match &self.indices {
            Some(indices) => indices.unsigned(position),
            None => position as u32,
        };
        if (index as usize) < self.vertex_count {
            return Ok(index);
        }
        Err(ImportError::IndexOutOfRange { place: place(), position, index, vertex_count: self.vertex_count })
    }
}

/// An attribute of a vertex under its morph targets: `base + Σ w · displacement`.
fn displaced(base: &Reader<'_>, targets: &[(f32, Reader<'_>)], vertex: u32) -> Vec3 {
    let at = |reader: &Reader<'_>| Vec3::from(reader.floats(vertex as usize, 0.0));
    targets.iter().fold(at(base), |sum, (weight, target)| sum + at(target) * *weight)
}

/// A primitive being read, with its name for messages.
struct Source<'s> {
    primitive: &'s Primitive,
    /// Weights of its morph targets.
    weights: &'s [f32],
    place: &'s dyn Fn() -> String,
}

impl Source<'_> {
    fn open<'a>(
        &self,
        context: &mut Context<'a>,
        index: Index<Accessor>,
        attribute: &str,
        types: &[Type],
        min_count: usize,
        is_always_normalized: bool,
    ) -> Result<Reader<'a>> {
        let place = || format!("{attribute} of {}", (self.place)());
        let wanted = Wanted { place: &place, types, min_count, is_always_normalized };
        Reader::open(context.root, context.buffers, &mut context.budgets.sparse_elements, index, &wanted)
    }

    fn corners<'a>(&self, context: &mut Context<'a>, vertex_count: usize) -> Result<Corners<'a>> {
        let Some(index) = self.primitive.indices else {
            return Ok(Corners { indices: None, count: vertex_count, vertex_count });
        };
        let indices = self.open(context, index, "indices", &[Type::Scalar], 0, false)?;
        if !indices.is_unsigned() {
            let problem = "its indices are not unsigned integers".to_owned();
            return Err(ImportError::Accessor { place: (self.place)(), problem });
        }
        Ok(Corners { count: indices.count(), indices: Some(indices), vertex_count })
    }

    fn read_attributes(
        &self,
        context: &mut Context<'_>,
        positions: &Reader<'_>,
        vertices: &[u32],
        triangles: Vec<[u32; 3]>,
    ) -> Result<LocalMesh> {
        let count = positions.count();
        let moved = self.open_targets(context, "POSITION", count, |target| target.positions)?;
        let read_position = |&vertex: &u32| {
            let position = displaced(positions, &moved, vertex);
            let vertex = vertex as usize;
            let not_finite = || ImportError::NonFinitePosition { place: (self.place)(), vertex };
            position.is_finite().then_some(position).ok_or_else(not_finite)
        };
        let positions = vertices.iter().map(read_position).collect::<Result<_, _>>()?;
        let normals = match self.find(Semantic::Normals) {
            Some(index) => {
                let normals = self.open(context, index, "NORMAL", &[Type::Vec3], count, false)?;
                let turned = self.open_targets(context, "NORMAL", count, |target| target.normals)?;
                let read = |&vertex: &u32| {
                    let normal = displaced(&normals, &turned, vertex);
                    if turned.is_empty() { normal } else { normal.normalize_or(normal) }
                };
                Some(vertices.iter().map(read).collect())
            }
            None => None,
        };
        Ok(LocalMesh {
            positions,
            normals,
            uv0: self.read_uvs(context, 0, vertices, count)?,
            uv1: self.read_uvs(context, 1, vertices, count)?,
            colours: self.read_colours(context, vertices, count)?,
            influences: self.read_influences(context, vertices, count)?,
            triangles,
        })
    }

    /// The displacements of one attribute by morph targets that are not at 0, each with its weight.
    fn open_targets<'a>(
        &self,
        context: &mut Context<'a>,
        attribute: &str,
        count: usize,
        of_target: impl Fn(&MorphTarget) -> Option<Index<Accessor>>,
    ) -> Result<Vec<(f32, Reader<'a>)>> {
        let mut opened = Vec::new();
        for (target, &weight) in self.primitive.targets.iter().flatten().zip(self.weights) {
            let Some(index) = of_target(target).filter(|_| weight != 0.0 && weight.is_finite()) else {
                continue;
            };
            let attribute = format!("morph target {attribute}");
            opened.push((weight, self.open(context, index, &attribute, &[Type::Vec3], count, false)?));
        }
        Ok(opened)
    }

    fn read_influences(
        &self,
        context: &mut Context<'_>,
        vertices: &[u32],
        count: usize,
    ) -> Result<Vec<Influences>> {
        let mut sets = Vec::new();
        for (joints, weights) in pose::SETS {
            let (Some(joints), Some(weights)) = (self.find(joints), self.find(weights)) else { break };
            let joints = self.open(context, joints, "JOINTS", &[Type::Vec4], count, false)?;
            let weights = self.open(context, weights, "WEIGHTS", &[Type::Vec4], count, true)?;
            let joint = |&vertex: &u32| joints.floats(vertex as usize, 0.0).map(|joint: f32| joint as u32);
            let weight = |&vertex: &u32| weights.floats(vertex as usize, 0.0);
            sets.push(Influences {
                joints: vertices.iter().map(joint).collect(),
                weights: vertices.iter().map(weight).collect(),
            });
        }
        Ok(sets)
    }

    fn find(&self, semantic: Semantic) -> Option<Index<Accessor>> {
        self.primitive.attributes.get(&Checked::Valid(semantic)).copied()
    }

    fn read_uvs(
        &self,
        context: &mut Context<'_>,
        set: u32,
        vertices: &[u32],
        count: usize,
    ) -> Result<Vec<Vec2>> {
        let Some(index) = self.find(Semantic::TexCoords(set)) else { return Ok(Vec::new()) };
        let reader = self.open(context, index, &format!("TEXCOORD_{set}"), &[Type::Vec2], count, false)?;
        let mut bad_count = 0;
        let read = |&vertex: &u32| {
            let uv = Vec2::from(reader.floats(vertex as usize, 0.0));
            bad_count += u64::from(!uv.is_finite());
            if uv.is_finite() { uv } else { Vec2::ZERO }
        };
        let uvs = vertices.iter().map(read).collect();
        context.warnings.add_many("uv-not-finite", bad_count, || {
            format!("TEXCOORD_{set} of {} is not finite and was set to 0", (self.place)())
        });
        Ok(uvs)
    }

    fn read_colours(
        &self,
        context: &mut Context<'_>,
        vertices: &[u32],
        count: usize,
    ) -> Result<Vec<[f32; 4]>> {
        let Some(index) = self.find(Semantic::Colors(0)) else { return Ok(Vec::new()) };
        // Integer colours are always fractions in glTF; exporters forget the flag.
        let reader = self.open(context, index, "COLOR_0", &[Type::Vec3, Type::Vec4], count, true)?;
        let mut clamped_count = 0;
        let read = |&vertex: &u32| {
            let colour: [f32; 4] = reader.floats(vertex as usize, 1.0);
            let clamped = colour.map(|channel| if channel.is_nan() { 0.0 } else { channel.clamp(0.0, 1.0) });
            clamped_count += u64::from(clamped != colour);
            clamped
        };
        let colours = vertices.iter().map(read).collect();
        context.warnings.add_many("vertex-colour-clamped", clamped_count, || {
            format!("COLOR_0 of {} was outside 0 to 1", (self.place)())
        });
        Ok(colours)
    }
}
