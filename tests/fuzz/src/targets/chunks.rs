//! Chunks of every kind: as they are, and with the bytes taken for the unpacked form of one.

#[path = "../../../../proto/src/chunk/tests/whole.rs"]
mod whole;

use std::ops::Range;

use lightkiln_proto::chunk::*;
use lightkiln_proto::content::*;
use lightkiln_proto::kinds::field::{
    FieldPart, MAP_POINTS, MOVES_MAX, PROBE_ROWS, TetrahedronSet, decode_field, decode_tetrahedra,
    encode_field, encode_tetrahedra,
};
use lightkiln_proto::kinds::sh::*;
use lightkiln_proto::manifest::{ChunkRef, ClusterRow};
use lightkiln_proto::transfer::{
    LEVELS as TRANSFER_LEVELS, TransferLevel, TransferTable, decode_transfer, encode_transfer,
};
use lightkiln_proto::voxels::{
    BRICKS_MAX, Brick, BrickKey, Element, Glow, LEVELS_MAX as VOXEL_LEVELS_MAX, NormalCode, Voxel, VoxelPart,
    decode_voxels, decode_voxels_prefix, encode_voxels, voxel_layers,
};

use super::container::{packed, unpacked};
use super::{Target, taken};
use whole::{
    assert_batch, assert_directory, assert_field, assert_geometry, assert_patches, assert_tetrahedra,
    assert_transfer, assert_voxels, assert_whole,
};

/// A cluster.
pub const CLUSTER: Target = Target {
    name: "cluster",
    read: |bytes| read(bytes, decode_cluster),
    check: |bytes| {
        each_form(bytes, check_cluster);
        each_form(bytes, check_prefix);
    },
    seeds: || {
        seeds(&[
            include_bytes!("../../../../proto/fixtures/cluster-v1.lkc"),
            include_bytes!("../../../../proto/fixtures/cluster-near-v1.lkc"),
            include_bytes!("../../../../proto/fixtures/cluster-near-v4.lkc"),
            &larger_cluster(),
        ])
    },
    memory_max,
};

/// A batch of probes.
pub const PROBES: Target = Target {
    name: "probes",
    read: |bytes| read(bytes, decode_probe_batch),
    check: |bytes| each_form(bytes, check_probes),
    seeds: || seeds(&[include_bytes!("../../../../proto/fixtures/probes-v1.lkc")]),
    memory_max,
};

/// Probes of a field.
pub const FIELD: Target = Target {
    name: "field",
    read: |bytes| read(bytes, decode_field),
    check: |bytes| each_form(bytes, check_field),
    seeds: || seeds(&[include_bytes!("../../../../proto/fixtures/field-v4.lkc")]),
    memory_max,
};

/// Tetrahedra between probes of a field.
pub const TETRAHEDRA: Target = Target {
    name: "tetrahedra",
    read: |bytes| read(bytes, decode_tetrahedra),
    check: |bytes| each_form(bytes, check_tetrahedra),
    seeds: || seeds(&[include_bytes!("../../../../proto/fixtures/tetrahedra-v4.lkc")]),
    memory_max,
};

/// Elements in voxels.
pub const VOXELS: Target = Target {
    name: "voxels",
    read: |bytes| read(bytes, decode_voxels),
    check: |bytes| each_form(bytes, check_voxels),
    seeds: || seeds(&[include_bytes!("../../../../proto/fixtures/voxels-v4.lkc"), &wall_in_voxels()]),
    memory_max,
};

/// A level of a volume.
pub const TRANSFER: Target = Target {
    name: "transfer",
    read: |bytes| read(bytes, decode_transfer),
    check: |bytes| each_form(bytes, check_transfer),
    seeds: || seeds(&[include_bytes!("../../../../proto/fixtures/transfer-v4.lkc")]),
    memory_max,
};

/// Meshes.
pub const GEOMETRY: Target = Target {
    name: "geometry",
    read: |bytes| read(bytes, decode_geometry),
    check: |bytes| each_form(bytes, check_geometry),
    seeds: || seeds(&[include_bytes!("../../../../proto/fixtures/geometry-v1.lkc"), &outside_lightmap()]),
    memory_max,
};

/// An image file.
pub const TEXTURE: Target = Target {
    name: "texture",
    read: |bytes| read(bytes, decode_texture),
    check: |bytes| each_form(bytes, check_texture),
    seeds: || seeds(&[include_bytes!("../../../../proto/fixtures/texture-v1.lkc")]),
    memory_max,
};

/// Surface patches.
pub const PATCHES: Target = Target {
    name: "patches",
    read: |bytes| read(bytes, decode_patches),
    check: |bytes| each_form(bytes, check_patches),
    seeds: || seeds(&[include_bytes!("../../../../proto/fixtures/patches-v1.lkc"), &larger_patches()]),
    memory_max,
};

/// A page of a directory.
pub const DIRECTORY: Target = Target {
    name: "directory",
    read: |bytes| read(bytes, decode_directory),
    check: |bytes| each_form(bytes, check_directory),
    seeds: || {
        seeds(&[include_bytes!("../../../../proto/fixtures/directory-v4.lkc"), &super::texts::directory(40)])
    },
    memory_max,
};

/// FORMAT.md allows content of 16 MiB + 4096 × the stored bytes; decoding holds sections beside it.
fn memory_max(bytes: usize) -> u64 {
    3 * (limits::EXPANSION_FREE_BYTES + limits::EXPANSION_MAX * (bytes as u64 + 1024))
}

fn seeds(chunks: &[&[u8]]) -> Vec<Vec<u8>> {
    chunks.iter().flat_map(|chunk| [chunk.to_vec(), unpacked(chunk)]).collect()
}

fn read<T>(bytes: &[u8], decode: impl Fn(&[u8]) -> Result<T, ChunkError>) -> bool {
    let as_unpacked = packed(bytes).is_some_and(|bytes| taken(&decode(&bytes)));
    taken(&decode(bytes)) || as_unpacked
}

fn each_form(bytes: &[u8], check: impl Fn(&[u8])) {
    check(bytes);
    if let Some(bytes) = packed(bytes) {
        check(&bytes);
    }
}

fn check_cluster(bytes: &[u8]) {
    let Ok(cluster) = decode_cluster(bytes) else { return };
    assert_whole(&cluster);
    let settings = QuantisationSettings::default();
    let again = encode_cluster(&cluster, settings).expect("what was decoded can be encoded");
    let again = decode_cluster(&again.bytes).expect("what was encoded can be decoded");
    let named = |cluster: &ClusterTransport| -> Vec<BlockKey> {
        cluster.receivers.block.iter().map(|&block| cluster.receivers.blocks[usize::from(block)]).collect()
    };
    assert_eq!(named(&again), named(&cluster));
    assert_eq!(near_hits(&again.near), near_hits(&cluster.near));
    assert_keys_kept(&again.factors, &cluster.factors, settings.relative_error);
    let factors_aside = |cluster: ClusterTransport| {
        // Factors come back within an error; blocks that no receiver lies in are left out, and so are some keys.
        let receivers = Receivers { blocks: Vec::new(), block: Vec::new(), ..cluster.receivers };
        let near = NearHits::default();
        let TransportFactors { bands, sky, rank, .. } = cluster.factors;
        let factors = TransportFactors { bands, sky, rank, ..TransportFactors::default() };
        ClusterTransport { receivers, near, factors, ..cluster }
    };
    assert_eq!(factors_aside(again), factors_aside(cluster));
}

/// Where a key has one column, those worth no code are left out: all of them are within the error of the whole product. No
/// key is made up.
fn assert_keys_kept(again: &TransportFactors, before: &TransportFactors, relative_error: f32) {
    if before.bands > 0 || before.sky {
        assert_eq!(again.keys, before.keys);
        return;
    }
    assert!(again.keys.iter().all(|key| before.keys.contains(key)), "{:?} of {:?}", again.keys, before.keys);
    let (rank, columns) = (before.rank as usize, before.keys.len());
    let square = |column: usize| -> f64 {
        let entry = |row: &[f32]| -> f64 {
            let terms = row.iter().enumerate();
            terms.map(|(i, u)| f64::from(*u) * f64::from(before.vt[i * columns + column])).sum()
        };
        before.u.chunks_exact(rank.max(1)).map(|row| entry(row).powi(2)).sum()
    };
    let (mut lost, mut all) = (0.0, 0.0);
    for (column, key) in before.keys.iter().enumerate() {
        let square = square(column);
        all += square;
        lost += if again.keys.contains(key) { 0.0 } else { square };
    }
    let share = (lost / all.max(f64::MIN_POSITIVE)).sqrt();
    assert!(share <= 1.01 * f64::from(relative_error), "columns left out are {share} of the product");
}

/// A near hit: block and texel or normal and albedo, and its offset.
type NamedHit = (Option<(BlockKey, Texel)>, [u32; 6], [i16; 3]);

/// Near hits by receiver in one order; where there are none, nothing.
fn near_hits(near: &NearHits) -> Vec<(u32, Vec<NamedHit>)> {
    if near.is_empty() {
        return Vec::new();
    }
    let named = |hit: usize| match near.surface[hit] {
        NearSurface::Texel { block, texel } => (Some((near.blocks[usize::from(block)], texel)), [0; 6]),
        NearSurface::Own { albedo: [r, g, b], normal: [x, y, z] } => {
            (None, [r, g, b, x, y, z].map(f32::to_bits))
        }
    };
    let of_receiver = |(range, weight): (Range<usize>, &f32)| {
        let weight = if range.is_empty() { 0 } else { weight.to_bits() };
        // Old versions have finer offsets than are stored now.
        let hit = |hit: usize| (named(hit).0, named(hit).1, near.offset[hit].map(NearHits::stored));
        let mut hits: Vec<_> = range.map(hit).collect();
        hits.sort_unstable();
        (weight, hits)
    };
    near.ranges().zip(&near.weight).map(of_receiver).collect()
}

/// The first half of a chunk is a coarser cluster, or an error.
fn check_prefix(bytes: &[u8]) {
    let _ = cluster_layers(bytes, bytes.len() as u64);
    for length in [bytes.len() / 2, bytes.len() * 9 / 10] {
        if let Ok((cluster, layer)) = decode_cluster_prefix(&bytes[..length], bytes.len() as u64) {
            assert_whole(&cluster);
            assert!(layer.bytes <= length as u64);
        }
    }
}

fn check_probes(bytes: &[u8]) {
    let Ok(batch) = decode_probe_batch(bytes) else { return };
    assert_batch(&batch);
    let again = encode_probe_batch(&batch).expect("what was decoded can be encoded");
    let again = decode_probe_batch(&again).expect("what was encoded can be decoded");
    assert_eq!((&again.probes, again.relight_rays), (&batch.probes, batch.relight_rays));
    let named = |batch: &ProbeBatch| -> Vec<(RelightHit, Option<BlockKey>)> {
        let name = |hit: &RelightHit| match *hit {
            RelightHit::Receiver { block, texel } => {
                (RelightHit::Receiver { block: 0, texel }, Some(batch.blocks[usize::from(block)]))
            }
            other => (other, None),
        };
        batch.hits.iter().map(name).collect()
    };
    assert_eq!(named(&again), named(&batch));
}

fn check_tetrahedra(bytes: &[u8]) {
    let Ok(set) = decode_tetrahedra(bytes) else { return };
    assert_tetrahedra(&set);
    let again = encode_tetrahedra(&set).expect("what was decoded can be encoded");
    assert_eq!(decode_tetrahedra(&again).expect("what was encoded can be decoded"), set);
}

fn check_voxels(bytes: &[u8]) {
    let total = bytes.len() as u64;
    let layers = voxel_layers(bytes, total);
    if let Ok((part, layer)) = decode_voxels_prefix(&bytes[..bytes.len() / 2], total) {
        assert_voxels(&part);
        assert!(layer.bytes <= total / 2);
    }
    let Ok(part) = decode_voxels(bytes) else { return };
    assert_voxels(&part);
    assert_eq!(layers.expect("it decodes").last().map(|layer| layer.bytes), Some(total));
    // A chunk that unpacks to nearly more than it may can be too short once it is packed better.
    let again = match encode_voxels(&part) {
        Err(ChunkError::OutOfRange { what: "decoded bytes", .. }) => return,
        again => again.expect("what was decoded can be encoded"),
    };
    assert_eq!(decode_voxels(&again).expect("what was encoded can be decoded"), part);
}

fn check_transfer(bytes: &[u8]) {
    let Ok(level) = decode_transfer(bytes) else { return };
    assert_transfer(&level);
    let again = match encode_transfer(&level) {
        Err(ChunkError::OutOfRange { what: "decoded bytes", .. }) => return,
        again => again.expect("what was decoded can be encoded"),
    };
    assert_eq!(decode_transfer(&again).expect("what was encoded can be decoded"), level);
    // Whatever its numbers are, points around it are told something finite.
    let slots = lightkiln_proto::relight::SlotTable::new([]).expect("there are none");
    let none = PatchSet { leaf_starts: vec![0], ..PatchSet::default() };
    let patches = lightkiln_proto::relight::PatchTable::new(&none, &slots).expect("there are none");
    let levels =
        (0..TRANSFER_LEVELS).map(|level_number| TransferLevel { level: level_number, ..level.clone() });
    if let Ok(table) = TransferTable::new(levels.collect(), &patches) {
        for at in [[0.0; 3], [1.0, 2.0, 3.0], level.box_m[0], level.box_m[1]] {
            table.covered(at.into(), |covered, weight| {
                assert!(covered.vector.is_finite() && covered.solid_angle.is_finite() && weight.is_finite());
            });
        }
    }
}

fn check_field(bytes: &[u8]) {
    let Ok(part) = decode_field(bytes) else { return };
    assert_field(&part);
    let again = encode_field(&part, 0.001).expect("what was decoded can be encoded");
    let again = decode_field(&again.bytes).expect("what was encoded can be decoded");
    assert_eq!((&again.probes, &again.depths), (&part.probes, &part.depths));
    assert_eq!((again.spacing_m, &again.emitters), (part.spacing_m, &part.emitters));
}

fn check_geometry(bytes: &[u8]) {
    let Ok(geometry) = decode_geometry(bytes) else { return };
    assert_geometry(&geometry);
    // Lightmap coordinates may be rounded once; rounded ones stay.
    let once = encode_geometry(&geometry).expect("what was decoded can be encoded");
    let decoded = decode_geometry(&once).expect("what was encoded can be decoded");
    assert_eq!(encode_geometry(&decoded).expect("and encoded again"), once);
    for (draw, again) in geometry.draws.iter().zip(&decoded.draws) {
        let exact = |draw: &Draw| Draw { lightmap_texel: Vec::new(), ..draw.clone() };
        assert_eq!(exact(draw), exact(again));
    }
}

fn check_texture(bytes: &[u8]) {
    let Ok(texture) = decode_texture(bytes) else { return };
    let again = encode_texture(&texture.media_type, &texture.bytes).expect("what was decoded can be encoded");
    assert_eq!(decode_texture(&again).expect("what was encoded can be decoded"), texture);
}

fn check_patches(bytes: &[u8]) {
    let Ok(set) = decode_patches(bytes) else { return };
    assert_patches(&set);
    for patch in &set.patches {
        assert!(patch.key.sky().is_none(), "a patch has the key of a part of the sky");
    }
    let again = encode_patches(&set).expect("what was decoded can be encoded");
    assert_eq!(decode_patches(&again).expect("what was encoded can be decoded"), set);
}

fn check_directory(bytes: &[u8]) {
    let Ok((rows, chunks)) = decode_directory(bytes) else { return };
    assert_directory(&rows, &chunks);
    let again = encode_directory(&rows, &chunks).expect("what was decoded can be encoded");
    assert_eq!(decode_directory(&again).expect("what was encoded can be decoded"), (rows, chunks));
}

/// A wall of 12² texels in two blocks, with several layers.
fn larger_cluster() -> Vec<u8> {
    let mut cluster = ClusterTransport {
        bounds_m: [[0.0, -1.0, 2.0], [4.0, 3.0, 2.0]],
        factors: TransportFactors {
            keys: vec![3, 70, 900],
            bands: 3,
            sky: true,
            rank: 9,
            ..TransportFactors::default()
        },
        ..ClusterTransport::default()
    };
    cluster.receivers.blocks = vec![11, 12];
    let mut texels: Vec<(u16, Texel)> =
        (0..144_u16).map(|i| (u16::from(i >= 100), [i % 12, i / 12])).collect();
    texels.sort_by_key(|&(block, texel)| (4 - Receivers::level(texel, 3), block, texel[1], texel[0]));
    for (block, texel) in texels {
        let [x, y] = texel.map(|t| f32::from(t) / 12.0);
        cluster.receivers.block.push(block);
        cluster.receivers.texel.push(texel);
        cluster.receivers.position_m.push([4.0 * x, 4.0 * y - 1.0, 2.0]);
        cluster.receivers.links.push((texel[0] % 16) as u8);
        cluster.receivers.coverage.push(u16::MAX << texel[0]);
        cluster.receivers.edge.push(TexelEdge(texel[0]));
        cluster.receivers.normal.push([0.0, 0.0, -1.0]);
        cluster.receivers.albedo.push(if x < 0.5 { [0.5, 0.25, 0.0] } else { [0.73; 3] });
        cluster.receivers.emission.push(if texel == [1, 1] { [10.0, 8.0, 0.1] } else { [0.0; 3] });
        cluster.factors.u.extend((0..9).map(|i| (x * (1 + i) as f32 + y).sin() / 12.0));
    }
    let columns = cluster.factors.columns();
    cluster.factors.vt = (0..9 * columns).map(|i| (i as f32).cos() * (-0.01 * i as f32).exp()).collect();
    let lit = |r: usize| if r.is_multiple_of(3) { [0.0; 3] } else { [1e-6 * r as f32, 1.0, 1e6] };
    let irradiance = (0..144).map(lit).collect();
    cluster.emitters = vec![EmitterIrradiance { emitter: 4, irradiance }];
    encode_cluster(&cluster, QuantisationSettings::default()).expect("a good cluster").bytes
}

/// A mesh outside the lightmap beside one in it.
fn outside_lightmap() -> Vec<u8> {
    let outside = Draw {
        material: 1,
        position_m: vec![[0.0; 3], [1.0, 0.0, 0.5], [0.0, 2.0, 0.25]],
        normal: vec![[0.0, 0.0, 1.0]; 3],
        triangles: vec![[0, 1, 2]],
        ..Draw::default()
    };
    let inside = Draw { front: Some(7), lightmap_texel: vec![[1.5, 2.0]; 3], ..outside.clone() };
    encode_geometry(&Geometry { draws: vec![outside, inside] }).expect("the meshes are whole")
}

/// A slanted wall of two sides in two levels of voxels.
fn wall_in_voxels() -> Vec<u8> {
    let element = |level: u32, voxel: [i32; 3], direction: u8| Element {
        normal: NormalCode([[9000, 23_000], [-9000, -23_000]][usize::from(direction % 2)]),
        plane: (voxel[0] * 700) as i16,
        bits: 0xff00_0000_0ff0_00ff << voxel[2],
        patch: (direction < 5).then(|| PatchKey::of_cell(level, voxel.map(|at| 2 * at + 1), direction, 1)),
        glow: (voxel[0] % 3 == 0).into(),
        is_backed: direction == 4,
        is_finest: voxel[2] == 1,
    };
    let brick = |level: u32, x: i32| {
        let key = BrickKey::new(level, [x, -1, 0].into());
        let place = |index: u16| 65 * (index % 7) + index / 7;
        let mut voxels: Vec<Voxel> =
            (0..20).map(|index| Voxel { place: place(index), elements: 1 + index % 2 }).collect();
        voxels.sort_by_key(|voxel| voxel.place);
        let of_voxel = |voxel: &Voxel| {
            let place = i32::from(voxel.place);
            let first = key.first_voxel();
            let at = [first.x + place % 8, first.y + place / 8 % 8, first.z + place / 64];
            (0..voxel.elements).map(move |side| element(level, at, 4 + side as u8)).collect::<Vec<_>>()
        };
        Brick { key, elements: voxels.iter().flat_map(of_voxel).collect(), voxels }
    };
    let bricks = vec![brick(1, 0), brick(0, 0), brick(0, 1)];
    let glows = vec![Glow { emitter: 3, share: [0.5, 1.0, 0.0] }];
    encode_voxels(&VoxelPart { voxel_m: 0.25, glows, bricks }).expect("a good wall")
}

/// Two levels of a tree of patches over 24 receivers, and a sky.
fn larger_patches() -> Vec<u8> {
    let patch = |level: u32, x: i32, first_leaf: u32, leaf_count: u32| Patch {
        key: PatchKey::of_cell(level, [x, -3, 14], (x % 6) as u8, 0),
        first_leaf,
        leaf_count,
    };
    let mut patches: Vec<Patch> = (0..8).map(|x| patch(2, x, x as u32, 1)).collect();
    patches.extend((0..4).map(|x| patch(3, x, 2 * x as u32, 2)));
    patches.sort_by_key(|patch| patch.key);
    let set = PatchSet {
        patches,
        leaf_starts: (0..=8).map(|leaf| 3 * leaf).collect(),
        blocks: vec![5, 6],
        block: (0..24).map(|r| u32::from(r >= 12)).collect(),
        texel: (0..24).map(|r| [r % 5, r / 5]).collect(),
        area: (0..24).map(|r| AreaCode(100 + r)).collect(),
        sky_parts: 64,
    };
    encode_patches(&set).expect("good patches")
}
