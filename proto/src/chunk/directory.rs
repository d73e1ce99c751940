//! Pages of a bake's directory: its clusters, as one must know them to choose which to fetch, and how much of each.

use super::bytes::Reader;
use super::container::{Container, ContainerWriter, SectionId};
use super::error::{ChunkError, all_finite, in_range};
use super::ints;
use super::limits::*;
use super::table::DIRECTORY;
use super::{CHUNK_BYTES_MAX, LAYERS_MAX, LEVELS_MAX};
use crate::ids::Digest;
use crate::manifest::{ChunkRef, ClusterRow, Layer, PrefixCheck};

/// Section tags of directory pages; part is 0, 0, 0.
pub(super) mod tags {
    /// Rows of clusters.
    pub const CLUSTERS: u8 = 1;
}

const SECTIONS: [SectionId; 1] = [SectionId::new(tags::CLUSTERS, [0; 3])];
/// Name of the section in errors.
const SECTION: &str = "directory";
/// Bytes of a digest, and of a check.
const DIGEST_BYTES: usize = 32;
const CHECK_BYTES: usize = 8;
/// Bounds and errors of a row, as numbers.
const NUMBERS: usize = 9;

/// Encodes the clusters of a page with their chunks, in their order. Nothing is lost.
///
/// Errs if a cluster's last layer is not its whole chunk, a prefix has no check, a number is out of its range, or a limit is passed.
pub fn encode_directory(rows: &[ClusterRow], chunks: &[ChunkRef]) -> Result<Vec<u8>, ChunkError> {
    in_range(SECTION, "chunks of clusters", chunks.len() as u64, rows.len() as u64, rows.len() as u64)?;
    in_range(SECTION, "clusters", rows.len() as u64, 0, DIRECTORY_CLUSTERS_MAX as u64)?;
    rows.iter().zip(chunks).try_for_each(|(row, chunk)| check(row, chunk))?;
    let mut writer = ContainerWriter::new(DIRECTORY);
    writer.push(SECTIONS[0], &write(rows, chunks))?;
    let layers: usize = rows.iter().map(|row| row.layers.len()).sum();
    let head: Vec<u8> = [rows.len(), layers].iter().flat_map(|&count| (count as u32).to_le_bytes()).collect();
    Ok(writer.finish(&head)?.0)
}

/// Errs unless a row fits its chunk.
fn check(row: &ClusterRow, chunk: &ChunkRef) -> Result<(), ChunkError> {
    let layers = row.layers.len() as u64;
    in_range(SECTION, "layers of a cluster", layers, 1, LAYERS_MAX as u64)?;
    in_range(SECTION, "checks of a cluster's prefixes", row.checks.len() as u64, layers - 1, layers - 1)?;
    all_finite(SECTION, "bounds or error", &numbers(row))?;
    let mut least = 1;
    for layer in &row.layers {
        in_range(SECTION, "bytes of a layer", layer.bytes, least, CHUNK_BYTES_MAX as u64)?;
        in_range(SECTION, "level of a layer", layer.level.into(), 0, u64::from(LEVELS_MAX) - 1)?;
        in_range(SECTION, "bands of a layer", layer.bands.into(), 0, BANDS_MAX as u64)?;
        in_range(SECTION, "rank of a layer", layer.rank.into(), 0, RANK_MAX as u64)?;
        least = layer.bytes + 1;
    }
    in_range(SECTION, "bytes of the last layer", least - 1, chunk.bytes, chunk.bytes)?;
    in_range(SECTION, "receivers of a cluster", row.receivers.into(), 0, RECEIVERS_MAX as u64)?;
    in_range(SECTION, "column keys of a cluster", row.keys.into(), 0, CLUSTER_KEYS_MAX as u64)?;
    in_range(SECTION, "rank of a cluster", row.rank.into(), 0, RANK_MAX as u64).map(drop)
}

/// Bounds and errors of a row.
fn numbers(row: &ClusterRow) -> [f32; NUMBERS] {
    let [[a, b, c], [d, e, f]] = row.bounds_m;
    [a, b, c, d, e, f, row.truncation_error, row.quantisation_error, row.uncovered_fraction]
}

fn write(rows: &[ClusterRow], chunks: &[ChunkRef]) -> Vec<u8> {
    let mut out = Vec::new();
    chunks.iter().for_each(|chunk| out.extend_from_slice(&chunk.digest.0));
    let counts: [fn(&ClusterRow) -> u32; 4] =
        [|row| row.receivers, |row| row.keys, |row| row.rank, |row| row.layers.len() as u32 - 1];
    for count in counts {
        ints::put_u32s(&mut out, &rows.iter().map(count).collect::<Vec<_>>());
    }
    let grown = rows.iter().flat_map(|row| {
        let before = std::iter::once(0).chain(row.layers.iter().map(|layer| layer.bytes));
        row.layers.iter().zip(before).map(|(layer, before)| (layer.bytes - before) as u32)
    });
    ints::put_u32s(&mut out, &grown.collect::<Vec<_>>());
    let parts: [fn(&Layer) -> u32; 3] = [|layer| layer.level, |layer| layer.bands, |layer| layer.rank];
    for part in parts {
        ints::put_u32s(&mut out, &rows.iter().flat_map(|row| &row.layers).map(part).collect::<Vec<_>>());
    }
    let checks = rows.iter().flat_map(|row| &row.checks);
    checks.for_each(|check| out.extend_from_slice(&check.0));
    for column in 0..NUMBERS {
        ints::put_f32_planes(&mut out, &rows.iter().map(|row| numbers(row)[column]).collect::<Vec<_>>());
    }
    out
}

/// Decodes a page: clusters and their chunks.
pub fn decode_directory(bytes: &[u8]) -> Result<(Vec<ClusterRow>, Vec<ChunkRef>), ChunkError> {
    let container = Container::whole(DIRECTORY, bytes)?;
    let mut reader = Reader::new("directory head", container.head);
    let [clusters, layers] = [reader.u32("clusters")?, reader.u32("layers")?].map(u64::from);
    reader.end()?;
    let clusters = in_range("directory head", "clusters", clusters, 0, DIRECTORY_CLUSTERS_MAX as u64)?;
    let most = clusters as u64 * LAYERS_MAX as u64;
    let layers = in_range("directory head", "layers", layers, clusters as u64, most)?;
    container.check_sections(&SECTIONS)?;
    let raw_max = (DIGEST_BYTES * clusters + CHECK_BYTES * (layers - clusters)) as u64
        + (4 + NUMBERS as u64) * ints::bytes_max(clusters)
        + 4 * ints::bytes_max(layers);
    let raw = container.section(0, SECTION, raw_max)?;
    let mut reader = Reader::new(SECTION, &raw);
    let found = read(&mut reader, clusters, layers)?;
    reader.end()?;
    Ok(found)
}

fn read(
    reader: &mut Reader,
    clusters: usize,
    layers: usize,
) -> Result<(Vec<ClusterRow>, Vec<ChunkRef>), ChunkError> {
    let digests: Vec<Digest> = reader
        .take("digest", clusters, DIGEST_BYTES)?
        .chunks_exact(DIGEST_BYTES)
        .map(|digest| Digest(std::array::from_fn(|index| digest[index])))
        .collect();
    let [receivers, keys, rank, more] = [
        ints::take_u32s(reader, "receivers", clusters)?,
        ints::take_u32s(reader, "column keys", clusters)?,
        ints::take_u32s(reader, "rank", clusters)?,
        ints::take_u32s(reader, "layers", clusters)?,
    ];
    let all: u64 = more.iter().map(|&more| u64::from(more) + 1).sum();
    in_range(SECTION, "layers of all clusters", all, layers as u64, layers as u64)?;
    let [grown, level, bands, ranks] = [
        ints::take_u32s(reader, "bytes of a layer", layers)?,
        ints::take_u32s(reader, "level of a layer", layers)?,
        ints::take_u32s(reader, "bands of a layer", layers)?,
        ints::take_u32s(reader, "rank of a layer", layers)?,
    ];
    let mut checks = reader
        .take("check", layers - clusters, CHECK_BYTES)?
        .chunks_exact(CHECK_BYTES)
        .map(|check| PrefixCheck(std::array::from_fn(|index| check[index])));
    let mut numbers = vec![[0.0; NUMBERS]; clusters];
    for column in 0..NUMBERS {
        let read = ints::take_f32_planes(reader, "bounds or error", clusters)?;
        numbers.iter_mut().zip(read).for_each(|(row, read)| row[column] = read);
    }
    let mut rows: Vec<ClusterRow> = Vec::with_capacity(clusters);
    let mut next = 0;
    for index in 0..clusters {
        let own = next..next + more[index] as usize + 1;
        next = own.end;
        let ends = grown[own.clone()].iter().scan(0, |end, &grown| {
            *end += u64::from(grown);
            Some(*end)
        });
        let layer =
            |(at, bytes): (usize, u64)| Layer { bytes, level: level[at], bands: bands[at], rank: ranks[at] };
        let [a, b, c, d, e, f, truncation_error, quantisation_error, uncovered_fraction] = numbers[index];
        rows.push(ClusterRow {
            bounds_m: [[a, b, c], [d, e, f]],
            receivers: receivers[index],
            keys: keys[index],
            rank: rank[index],
            truncation_error,
            quantisation_error,
            uncovered_fraction,
            checks: checks.by_ref().take(own.len() - 1).collect(),
            layers: own.zip(ends).map(layer).collect(),
        });
    }
    let bytes = |row: &ClusterRow| row.layers.last().map_or(0, |layer| layer.bytes);
    let chunks: Vec<ChunkRef> =
        digests.into_iter().zip(&rows).map(|(digest, row)| ChunkRef { digest, bytes: bytes(row) }).collect();
    rows.iter().zip(&chunks).try_for_each(|(row, chunk)| check(row, chunk))?;
    Ok((rows, chunks))
}
