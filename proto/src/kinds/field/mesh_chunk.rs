//! Chunk of the tetrahedra between a field's probes.

use serde_json::{Value, json};

use super::tetrahedra::{CORNERS, TetrahedronSet};
use crate::chunk::bytes::Reader;
use crate::chunk::container::{Container, ContainerWriter, SectionId};
use crate::chunk::error::{all_numbers, in_range};
use crate::chunk::{ChunkError, ChunkKind, ChunkRow, ints};

/// Most tetrahedra of a bake.
pub const TETRAHEDRA_MAX: usize = 1 << 23;
/// Most probes that they are of.
const PROBES_MAX: u64 = 1 << 20;

/// Tetrahedra between probes.
pub const MESH: ChunkKind = ChunkKind(8);

/// Its row in the table of chunk kinds.
pub const ROW: ChunkRow = ChunkRow {
    kind: MESH,
    name: "tetrahedra",
    sections: &[(tags::VERTICES, "vertices")],
    describe,
    layers: None,
};

/// Section tags of chunks of tetrahedra; their parts are 0, 0, 0.
pub(crate) mod tags {
    /// Vertices of each.
    pub const VERTICES: u8 = 1;
}

const SECTIONS: [SectionId; 1] = [SectionId::new(tags::VERTICES, [0; 3])];

fn describe(bytes: &[u8]) -> Result<Value, ChunkError> {
    let set = decode_tetrahedra(bytes)?;
    Ok(json!({ "tetrahedra": set.vertices.len(), "probes": set.probes, "box_m": set.box_m }))
}

/// Encodes tetrahedra, whose vertices ascend and which ascend themselves. Nothing is lost.
///
/// Errs if they do not, a vertex is none of the probes and corners, the box is empty or not finite, or a limit is passed.
pub fn encode_tetrahedra(set: &TetrahedronSet) -> Result<Vec<u8>, ChunkError> {
    check(set, set.vertices.len() as u64)?;
    let mut before = [0; 4];
    for (index, &vertices) in set.vertices.iter().enumerate() {
        if vertices.windows(2).any(|pair| pair[0] >= pair[1]) || (index > 0 && vertices <= before) {
            return Err(ChunkError::Order { section: "encoder", what: "tetrahedron", index });
        }
        in_range("encoder", "vertex", vertices[3].into(), 0, u64::from(set.probes) + CORNERS as u64 - 1)?;
        before = vertices;
    }
    let mut raw = Vec::new();
    // The first vertices of neighbours are much alike, and so are the steps to the others.
    ints::put_deltas(&mut raw, set.vertices.iter().map(|of| of[0] as i32));
    for corner in 1..4 {
        ints::put_u32s(
            &mut raw,
            &set.vertices.iter().map(|of| of[corner] - of[corner - 1]).collect::<Vec<_>>(),
        );
    }
    let mut writer = ContainerWriter::new(MESH);
    writer.push(SECTIONS[0], &raw)?;
    let mut head = Vec::new();
    for count in [set.vertices.len() as u32, set.probes] {
        head.extend_from_slice(&count.to_le_bytes());
    }
    set.box_m.as_flattened().iter().for_each(|number| head.extend_from_slice(&number.to_le_bytes()));
    Ok(writer.finish(&head)?.0)
}

fn check(set: &TetrahedronSet, tetrahedra: u64) -> Result<(), ChunkError> {
    let section = "tetrahedra head";
    in_range(section, "tetrahedra", tetrahedra, 0, TETRAHEDRA_MAX as u64)?;
    in_range(section, "probes", set.probes.into(), 0, PROBES_MAX)?;
    let numbers = set.box_m.as_flattened();
    all_numbers(section, "box", numbers, "-1e9..=1e9 m", |x| (-1e9..=1e9).contains(&x))?;
    let [low, high] = set.box_m;
    let edges: Vec<f32> = low.iter().zip(high).map(|(low, high)| high - low).collect();
    let is_edge = |x: f32| if tetrahedra == 0 { x >= 0.0 } else { x > 0.0 };
    all_numbers(section, "edges of the box", &edges, "more than 0 m", is_edge)
}

/// Decodes tetrahedra.
pub fn decode_tetrahedra(bytes: &[u8]) -> Result<TetrahedronSet, ChunkError> {
    let container = Container::whole(MESH, bytes)?;
    let mut reader = Reader::new("tetrahedra head", container.head);
    let [count, probes] = [reader.u32("tetrahedra")?, reader.u32("probes")?];
    let mut numbers = [0.0; 6];
    for number in &mut numbers {
        *number = reader.f32("box")?;
    }
    reader.end()?;
    let [x, y, z, far_x, far_y, far_z] = numbers;
    let mut set = TetrahedronSet { box_m: [[x, y, z], [far_x, far_y, far_z]], probes, vertices: Vec::new() };
    check(&set, count.into())?;
    container.check_sections(&SECTIONS)?;
    let count = count as usize;
    container.check_expansion(16 * count as u64 + 4 * ints::bytes_max(count))?;
    let raw = container.section(0, "vertices", 4 * ints::bytes_max(count))?;
    let mut reader = Reader::new("vertices", &raw);
    let last = u64::from(probes) + CORNERS as u64 - 1;
    let first = ints::take_deltas(&mut reader, "first vertex", count, 0..=last as i32)?;
    set.vertices = first.into_iter().map(|vertex| [vertex as u32, 0, 0, 0]).collect();
    for corner in 1..4 {
        let steps = ints::take_u32s(&mut reader, "step to the next vertex", count)?;
        for (of, step) in set.vertices.iter_mut().zip(steps) {
            let vertex = u64::from(of[corner - 1]) + u64::from(step);
            in_range("vertices", "vertex", vertex, u64::from(of[corner - 1]) + 1, last)?;
            of[corner] = vertex as u32;
        }
    }
    reader.end()?;
    if let Some(index) = set.vertices.windows(2).position(|pair| pair[0] >= pair[1]) {
        return Err(ChunkError::Order { section: "vertices", what: "tetrahedron", index: index + 1 });
    }
    Ok(set)
}
