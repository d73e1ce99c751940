//! Meshes to draw. All draws share the sections: one holds all positions, one all normals, and so on.

use super::container::{ContainerWriter, SectionId};
use super::error::{ChunkError, all_finite, in_range};
use super::ints;
use super::limits::{DRAWS_MAX, TRIANGLES_MAX, VERTICES_MAX};
use super::numbers::normal_code;
use super::table::GEOMETRY;
use super::vertices::{Steps, put_vectors};
use crate::content::{Draw, Geometry};

/// Section tags of geometry chunks; parts are 0, 0, 0. Each comes once, in this order.
pub(super) mod tags {
    /// Counts, materials and blocks of the draws.
    pub const DRAWS: u8 = 1;
    /// Positions.
    pub const POSITIONS: u8 = 2;
    /// Normals.
    pub const NORMALS: u8 = 3;
    /// Lightmap coordinates.
    pub const LIGHTMAP: u8 = 4;
    /// Triangles.
    pub const TRIANGLES: u8 = 5;
    /// Texture coordinates.
    pub const UVS: u8 = 6;
    /// Vertex colours.
    pub const COLOURS: u8 = 7;
    /// All of them with their names.
    pub const ALL: [(u8, &str); 7] = [
        (DRAWS, "draws"),
        (POSITIONS, "positions"),
        (NORMALS, "normals"),
        (LIGHTMAP, "lightmap"),
        (TRIANGLES, "triangles"),
        (UVS, "uvs"),
        (COLOURS, "colours"),
    ];
}

/// Bytes of a geometry chunk's head.
pub(super) const GEOMETRY_HEAD_BYTES: usize = 12;
/// Flags of a draw in the draws section.
pub(super) const HAS_BACK: u32 = 1;
/// The draw has texture coordinates.
pub(super) const HAS_UV: u32 = 2;
/// The draw has colours.
pub(super) const HAS_COLOUR: u32 = 4;
/// The draw is outside the lightmap: it has neither blocks nor lightmap coordinates.
pub(super) const NO_LIGHTMAP: u32 = 8;

/// Encodes meshes, in their order. Positions, UVs, colours and triangles are exact; normals within
/// [`NORMAL_ERROR_RAD`](super::NORMAL_ERROR_RAD), lightmap coordinates within
/// [`LIGHTMAP_ERROR_TEXELS`](super::LIGHTMAP_ERROR_TEXELS).
///
/// Errs if arrays disagree in length, a number is not finite, an index names no vertex, or a limit is passed.
pub fn encode_geometry(geometry: &Geometry) -> Result<Vec<u8>, ChunkError> {
    let draws = &geometry.draws;
    let counts = check_input(draws)?;
    let mut writer = ContainerWriter::new(GEOMETRY);
    for (tag, _) in tags::ALL {
        let raw = match tag {
            tags::DRAWS => write_draws(draws),
            tags::POSITIONS => write_vectors(draws, |draw| &draw.position_m, Steps::Never),
            tags::NORMALS => write_normals(draws),
            tags::LIGHTMAP => write_vectors(draws, |draw| &draw.lightmap_texel, Steps::Near256),
            tags::TRIANGLES => write_triangles(draws),
            tags::UVS => write_vectors(draws, |draw| &draw.uv, Steps::Never),
            _ => write_vectors(draws, |draw| &draw.colour, Steps::Exact255),
        };
        writer.push(SectionId::new(tag, [0; 3]), &raw)?;
    }
    let mut head = Vec::with_capacity(GEOMETRY_HEAD_BYTES);
    counts.iter().for_each(|&count| head.extend_from_slice(&(count as u32).to_le_bytes()));
    Ok(writer.finish(&head)?.0)
}

/// Draws, vertices and triangles, if all is as it should be.
fn check_input(draws: &[Draw]) -> Result<[usize; 3], ChunkError> {
    let section = "encoder";
    draws.iter().try_for_each(check_draw)?;
    let vertices = draws.iter().map(|draw| draw.position_m.len()).sum();
    let triangles = draws.iter().map(|draw| draw.triangles.len()).sum();
    for (what, count, max) in [
        ("draws", draws.len(), DRAWS_MAX),
        ("vertices", vertices, VERTICES_MAX),
        ("triangles", triangles, TRIANGLES_MAX),
    ] {
        in_range(section, what, count as u64, 0, max as u64)?;
    }
    Ok([draws.len(), vertices, triangles])
}

fn check_draw(draw: &Draw) -> Result<(), ChunkError> {
    let section = "encoder";
    let vertices = draw.position_m.len();
    let or_none = |length: usize| if length == 0 { 0 } else { vertices };
    for (what, length, wanted) in [
        ("normals", draw.normal.len(), vertices),
        ("lightmap coordinates", draw.lightmap_texel.len(), if draw.front.is_some() { vertices } else { 0 }),
        ("texture coordinates", draw.uv.len(), or_none(draw.uv.len())),
        ("colours", draw.colour.len(), or_none(draw.colour.len())),
    ] {
        in_range(section, what, length as u64, wanted as u64, wanted as u64)?;
    }
    let blocks_max = if draw.front.is_some() { 1 } else { 0 };
    in_range(section, "back blocks", draw.back.iter().len() as u64, 0, blocks_max)?;
    for (what, numbers) in [
        ("position", draw.position_m.as_flattened()),
        ("normal", draw.normal.as_flattened()),
        ("lightmap coordinate", draw.lightmap_texel.as_flattened()),
        ("texture coordinate", draw.uv.as_flattened()),
        ("colour", draw.colour.as_flattened()),
    ] {
        all_finite(section, what, numbers)?;
    }
    for &index in draw.triangles.as_flattened() {
        in_range(section, "vertex index + 1", u64::from(index) + 1, 1, vertices as u64)?;
    }
    Ok(())
}

/// Arrays over draws: material, flags, vertices, triangles, then keys of front and of back blocks, of draws that have them.
fn write_draws(draws: &[Draw]) -> Vec<u8> {
    let mut out = Vec::new();
    let mut put =
        |value: fn(&Draw) -> u32| ints::put_u32s(&mut out, &draws.iter().map(value).collect::<Vec<_>>());
    put(|draw| draw.material);
    put(|draw| {
        let flag = |set: bool, flag: u32| if set { flag } else { 0 };
        flag(draw.back.is_some(), HAS_BACK)
            | flag(!draw.uv.is_empty(), HAS_UV)
            | flag(!draw.colour.is_empty(), HAS_COLOUR)
            | flag(draw.front.is_none(), NO_LIGHTMAP)
    });
    put(|draw| draw.position_m.len() as u32);
    put(|draw| draw.triangles.len() as u32);
    let fronts = draws.iter().filter_map(|draw| draw.front);
    let backs = draws.iter().filter_map(|draw| draw.back);
    fronts.chain(backs).for_each(|key| out.extend_from_slice(&key.to_le_bytes()));
    out
}

fn write_vectors<const N: usize>(
    draws: &[Draw],
    array: fn(&Draw) -> &Vec<[f32; N]>,
    steps: Steps,
) -> Vec<u8> {
    let mut out = Vec::new();
    put_vectors(&mut out, draws.iter().flat_map(array), steps);
    out
}

fn write_normals(draws: &[Draw]) -> Vec<u8> {
    let mut out = Vec::new();
    let codes: Vec<[i16; 2]> =
        draws.iter().flat_map(|draw| draw.normal.iter().map(|&n| normal_code(n))).collect();
    for axis in 0..2 {
        ints::put_deltas(&mut out, codes.iter().map(|code| code[axis].into()));
    }
    out
}

fn write_triangles(draws: &[Draw]) -> Vec<u8> {
    let mut out = Vec::new();
    ints::put_deltas(
        &mut out,
        draws.iter().flat_map(|draw| draw.triangles.as_flattened().iter().map(|&i| i as i32)),
    );
    out
}
