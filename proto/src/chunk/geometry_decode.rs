//! Decoding meshes.

use super::bytes::Reader;
use super::container::{Container, SectionId};
use super::error::{ChunkError, in_range};
use super::geometry::{HAS_BACK, HAS_COLOUR, HAS_UV, NO_LIGHTMAP, tags};
use super::ints;
use super::limits::{DRAWS_MAX, TRIANGLES_MAX, VERTICES_MAX};
use super::numbers::normal_of;
use super::table::GEOMETRY;
use super::vertices::{Steps, take_vectors, vectors_bytes_max};
use crate::content::{Draw, Geometry};

/// Most raw bytes of a draw's entry in the draws section: four numbers and two keys.
const DRAW_BYTES_MAX: u64 = 4 * 4 + 2 * 8;

/// Decodes a geometry chunk.
pub fn decode_geometry(bytes: &[u8]) -> Result<Geometry, ChunkError> {
    let container = Container::whole(GEOMETRY, bytes)?;
    let mut reader = Reader::new("geometry head", container.head);
    let mut count = |what, max: usize| -> Result<usize, ChunkError> {
        in_range("geometry head", what, reader.u32(what)?.into(), 0, max as u64)
    };
    let draws = count("draws", DRAWS_MAX)?;
    let vertices = count("vertices", VERTICES_MAX)?;
    let triangles = count("triangles", TRIANGLES_MAX)?;
    reader.end()?;
    container.check_sections(&tags::ALL.map(|(tag, _)| SectionId::new(tag, [0; 3])))?;
    container.check_expansion((size_of::<Draw>() * draws + 56 * vertices + 12 * triangles) as u64)?;
    let raw = container.section(0, "draws", 4 + DRAW_BYTES_MAX * draws as u64)?;
    let (draws, shapes) = read_shapes(&raw, draws, vertices, triangles)?;
    let mut decoder = Decoder { draws, shapes };
    for (index, (tag, name)) in tags::ALL.into_iter().enumerate().skip(1) {
        let max =
            if tag == tags::TRIANGLES { ints::bytes_max(3 * triangles) } else { vectors_bytes_max(vertices) };
        let raw = container.section(index, name, max)?;
        let mut reader = Reader::new(name, &raw);
        decoder.section(tag, &mut reader)?;
        reader.end()?;
    }
    Ok(Geometry { draws: decoder.draws })
}

/// How long a draw's arrays are.
struct DrawShape {
    vertices: usize,
    triangles: usize,
    lightmap_texels: usize,
    uvs: usize,
    colours: usize,
}

/// Draws without their arrays, and how long those are.
fn read_shapes(
    raw: &[u8],
    count: usize,
    vertices: usize,
    triangles: usize,
) -> Result<(Vec<Draw>, Vec<DrawShape>), ChunkError> {
    let section = "draws";
    let mut reader = Reader::new(section, raw);
    let materials = ints::take_u32s(&mut reader, "material", count)?;
    let flags = ints::take_u32s(&mut reader, "flags", count)?;
    let vertex_counts = ints::take_u32s(&mut reader, "vertices of a draw", count)?;
    let triangle_counts = ints::take_u32s(&mut reader, "triangles of a draw", count)?;
    let total = |counts: &[u32]| counts.iter().map(|&n| u64::from(n)).sum();
    in_range(section, "vertices", total(&vertex_counts), vertices as u64, vertices as u64)?;
    in_range(section, "triangles", total(&triangle_counts), triangles as u64, triangles as u64)?;
    flags.iter().try_for_each(|&flags| check_flags(flags))?;
    let with = |flag: u32| flags.iter().filter(|&&flags| flags & flag != 0).count();
    let mut fronts = reader.u64s("front block", count - with(NO_LIGHTMAP))?.into_iter();
    let mut backs = reader.u64s("back block", with(HAS_BACK))?.into_iter();
    reader.end()?;
    let (mut draws, mut shapes) = (Vec::with_capacity(count), Vec::with_capacity(count));
    for index in 0..count {
        let has = |flag: u32| flags[index] & flag != 0;
        let vertices = vertex_counts[index] as usize;
        let vertices_if = |set: bool| if set { vertices } else { 0 };
        let front = if has(NO_LIGHTMAP) { None } else { fronts.next() };
        let back = if has(HAS_BACK) { backs.next() } else { None };
        draws.push(Draw { material: materials[index], front, back, ..Draw::default() });
        shapes.push(DrawShape {
            vertices,
            triangles: triangle_counts[index] as usize,
            lightmap_texels: vertices_if(!has(NO_LIGHTMAP)),
            uvs: vertices_if(has(HAS_UV)),
            colours: vertices_if(has(HAS_COLOUR)),
        });
    }
    Ok((draws, shapes))
}

/// Errs on flags that mean nothing, and on a back block outside the lightmap.
fn check_flags(flags: u32) -> Result<(), ChunkError> {
    in_range("draws", "flags", flags.into(), 0, 15)?;
    let both = NO_LIGHTMAP | HAS_BACK;
    in_range("draws", "back blocks outside the lightmap", u64::from(flags & both == both), 0, 0)?;
    Ok(())
}

/// Hands the shared arrays out to the draws.
struct Decoder {
    draws: Vec<Draw>,
    shapes: Vec<DrawShape>,
}

impl Decoder {
    fn section(&mut self, tag: u8, reader: &mut Reader) -> Result<(), ChunkError> {
        match tag {
            tags::POSITIONS => self.vectors(reader, Steps::Never, |s| s.vertices, |d| &mut d.position_m),
            tags::NORMALS => self.normals(reader),
            tags::LIGHTMAP => {
                self.vectors(reader, Steps::Near256, |s| s.lightmap_texels, |d| &mut d.lightmap_texel)
            }
            tags::TRIANGLES => self.triangles(reader),
            tags::UVS => self.vectors(reader, Steps::Never, |s| s.uvs, |d| &mut d.uv),
            _ => self.vectors(reader, Steps::Exact255, |s| s.colours, |d| &mut d.colour),
        }
    }

    fn vectors<const N: usize>(
        &mut self,
        reader: &mut Reader,
        steps: Steps,
        length: fn(&DrawShape) -> usize,
        array: fn(&mut Draw) -> &mut Vec<[f32; N]>,
    ) -> Result<(), ChunkError> {
        let total = self.shapes.iter().map(length).sum();
        let mut vectors = take_vectors(reader, total, steps)?.into_iter();
        for (draw, shape) in self.draws.iter_mut().zip(&self.shapes) {
            *array(draw) = vectors.by_ref().take(length(shape)).collect();
        }
        Ok(())
    }

    fn normals(&mut self, reader: &mut Reader) -> Result<(), ChunkError> {
        let total = self.shapes.iter().map(|shape| shape.vertices).sum();
        let u = ints::take_deltas(reader, "normal", total, -32_767..=32_767)?;
        let v = ints::take_deltas(reader, "normal", total, -32_767..=32_767)?;
        let mut normals = u.into_iter().zip(v).map(|(u, v)| normal_of([u as i16, v as i16]));
        for (draw, shape) in self.draws.iter_mut().zip(&self.shapes) {
            draw.normal = normals.by_ref().take(shape.vertices).collect();
        }
        Ok(())
    }

    fn triangles(&mut self, reader: &mut Reader) -> Result<(), ChunkError> {
        let total: usize = self.shapes.iter().map(|shape| shape.triangles).sum();
        let corners = ints::take_deltas(reader, "vertex index", 3 * total, 0..=VERTICES_MAX as i32)?;
        let mut triangles = corners.chunks_exact(3).map(|c| [c[0] as u32, c[1] as u32, c[2] as u32]);
        for (draw, shape) in self.draws.iter_mut().zip(&self.shapes) {
            draw.triangles = triangles.by_ref().take(shape.triangles).collect();
            for &index in draw.triangles.as_flattened() {
                in_range("triangles", "vertex index + 1", u64::from(index) + 1, 1, shape.vertices as u64)?;
            }
        }
        Ok(())
    }
}
