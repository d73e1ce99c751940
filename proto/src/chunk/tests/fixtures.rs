//! Stored chunks of every version, which must decode for ever.

use std::path::PathBuf;

use super::scenes::directory;
use crate::chunk::*;
use crate::content::*;
use crate::kinds::field::{
    FieldPart, MAP_POINTS, PROBE_ROWS, Probe as FieldProbe, ProbeKey as FieldKey, TetrahedronSet,
    decode_field, decode_tetrahedra, encode_field, encode_tetrahedra,
};
use crate::kinds::sh::*;
use crate::transfer::{PartGlow, PartPatch, TransferLevel, TransferPart, decode_transfer, encode_transfer};
use crate::voxels::{
    Brick, BrickKey, Element, Glow, NormalCode, Voxel, VoxelPart, decode_voxels, encode_voxels,
};

/// Chunks of each kind in one version.
struct Fixtures {
    cluster: &'static [u8],
    near: &'static [u8],
    probes: &'static [u8],
    patches: &'static [u8],
    geometry: &'static [u8],
    texture: &'static [u8],
}

macro_rules! fixtures {
    ($version:literal) => {
        Fixtures {
            cluster: include_bytes!(concat!("../../../fixtures/cluster-", $version, ".lkc")),
            near: include_bytes!(concat!("../../../fixtures/cluster-near-", $version, ".lkc")),
            probes: include_bytes!(concat!("../../../fixtures/probes-", $version, ".lkc")),
            patches: include_bytes!(concat!("../../../fixtures/patches-", $version, ".lkc")),
            geometry: include_bytes!(concat!("../../../fixtures/geometry-", $version, ".lkc")),
            texture: include_bytes!(concat!("../../../fixtures/texture-", $version, ".lkc")),
        }
    };
}

const V1: Fixtures = fixtures!("v1");
const V2: Fixtures = fixtures!("v2");
const V3: Fixtures = fixtures!("v3");
const V4: Fixtures = fixtures!("v4");

/// Probes of a field, of which there are none in older versions.
const FIELD_V4: &[u8] = include_bytes!("../../../fixtures/field-v4.lkc");
/// Tetrahedra between probes, likewise.
const TETRAHEDRA_V4: &[u8] = include_bytes!("../../../fixtures/tetrahedra-v4.lkc");

/// Elements in voxels, likewise.
const VOXELS_V4: &[u8] = include_bytes!("../../../fixtures/voxels-v4.lkc");

/// A level of a volume, likewise.
const TRANSFER_V4: &[u8] = include_bytes!("../../../fixtures/transfer-v4.lkc");

/// A page of a directory, of which there are none in older versions.
const DIRECTORY_V4: &[u8] = include_bytes!("../../../fixtures/directory-v4.lkc");

/// A wall of 2 × 2 texels that one probe and the sky light. All its numbers survive quantisation but U, ΣVᵀ and the
/// irradiance.
fn cluster() -> ClusterTransport {
    ClusterTransport {
        bounds_m: [[0.0, 0.0, -1.0], [1.0, 2.0, -1.0]],
        receivers: Receivers {
            blocks: vec![0x0123_4567_89ab_cdef],
            block: vec![0; 4],
            texel: vec![[0, 0], [1, 0], [0, 1], [1, 1]],
            position_m: vec![[0.0, 0.0, -1.0], [1.0, 0.0, -1.0], [0.0, 2.0, -1.0], [1.0, 2.0, -1.0]],
            normal: vec![[0.0, 0.0, 1.0]; 4],
            albedo: vec![[0.5, 0.25, 0.125], [0.5, 0.25, 0.125], [0.75; 3], [0.5, 0.25, 0.125]],
            emission: vec![[0.0; 3], [0.0; 3], [0.0; 3], [20.0, 10.0, 5.0]],
            links: vec![0b0111, 0b1010, 0b0001, 0],
            coverage: vec![u16::MAX, 0, 0x000F, 0x8001],
            edge: [0, 0, 0x4080, 0x2090].map(TexelEdge).to_vec(),
        },
        factors: TransportFactors {
            keys: vec![0xfeed_0000_0000_0001],
            bands: 1,
            sky: true,
            rank: 2,
            u: vec![0.5, 0.5, 0.5, -0.5, 0.5, 0.5, 0.5, -0.5],
            vt: [8.0, 4.0, 2.0, 1.0, 0.5, 0.0, 0.0, -0.25, 0.0, 0.5, -0.5, 0.0, 0.0, 0.25, 0.0, 0.0].into(),
            ..TransportFactors::default()
        },
        emitters: vec![EmitterIrradiance {
            emitter: 3,
            irradiance: vec![[4.0, 2.0, 1.0], [0.0; 3], [8.0, 4.0, 2.0], [0.0; 3]],
        }],
        near: NearHits::default(),
    }
}

/// The wall lit by patches of the floor and a part of the sky, and beside its second texel something of another block.
fn cluster_with_near_hits() -> ClusterTransport {
    let keys = floor(|cell, key| if cell % 4 == 0 { key } else { key.difference() });
    let vt = (0..2 * keys.len()).map(|entry| 1.0 + entry as f32).collect();
    let factors = TransportFactors { keys, bands: 0, sky: false, vt, ..cluster().factors };
    let near = NearHits {
        reach_m: 0.25,
        count: vec![0, 2, 0, 0],
        weight: vec![0.0, std::f32::consts::PI, 0.0, 0.0],
        blocks: vec![7],
        surface: vec![
            NearSurface::Texel { block: 0, texel: [3, 4] },
            NearSurface::Own { albedo: [0.0; 3], normal: [0.0, 1.0, 0.0] },
        ],
        offset: vec![[-2047, 0, 1], [2047, 300, 20]],
    };
    ClusterTransport { near, factors, ..cluster() }
}

/// Column keys of the floor's sixteen patches of level 0, each as `column` has it, of two of level 2 around them, and of a part
/// of the sky.
fn floor(column: impl Fn(i32, PatchKey) -> PatchKey) -> Vec<ColumnKey> {
    let fine = |cell: i32| column(cell, PatchKey::of_cell(0, [cell % 4 - 2, -1, cell / 4], 2, 0)).0;
    let coarse = [0, 3].map(|ordinal| PatchKey::of_cell(2, [-1, -1, 0], 2, ordinal).0);
    let mut keys: Vec<ColumnKey> = (0..16).map(fine).chain(coarse).chain([PatchKey::of_sky(7).0]).collect();
    keys.sort_unstable();
    keys
}

fn probes() -> ProbeBatch {
    let hit = |x| RelightHit::Receiver { block: 0, texel: [x, 9] };
    ProbeBatch {
        probes: vec![
            Probe { key: 1, position_m: [0.5, 1.0, -0.5], radius_m: 2.0 },
            Probe { key: 0xfeed_0000_0000_0001, position_m: [-1.5, 1.0, -0.5], radius_m: 2.5 },
        ],
        relight_rays: 4,
        blocks: vec![0x0123_4567_89ab_cdef],
        hits: vec![
            hit(0),
            hit(1),
            RelightHit::Sky,
            hit(700),
            RelightHit::Dark,
            hit(3),
            hit(4),
            RelightHit::Sky,
        ],
    }
}

/// The four texels of the wall as one patch, and its lower and upper half as leaves of two and one; the fourth texel is by
/// itself.
fn patches() -> PatchSet {
    let patch = |level, cell, first_leaf, leaf_count| Patch {
        key: PatchKey::of_cell(level, cell, 4, 0),
        first_leaf,
        leaf_count,
    };
    PatchSet {
        patches: vec![
            patch(0, [0, 0, -1], 0, 1),
            patch(0, [0, 1, -1], 1, 1),
            patch(0, [1, 1, -1], 2, 1),
            patch(1, [0, 0, -1], 0, 3),
        ],
        leaf_starts: vec![0, 2, 3, 4],
        blocks: vec![0x0123_4567_89ab_cdef],
        block: vec![0; 4],
        texel: vec![[0, 0], [1, 0], [0, 1], [1, 1]],
        area: [128, 128, 112, 3].map(AreaCode).to_vec(),
        sky_parts: 64,
    }
}

fn geometry() -> Geometry {
    Geometry {
        draws: vec![Draw {
            material: 2,
            front: Some(0x0123_4567_89ab_cdef),
            back: Some(7),
            position_m: vec![[0.0, 0.0, -1.0], [1.0, 0.0, -1.0], [0.1, 2.0, -1.0]],
            normal: vec![[0.0, 0.0, 1.0]; 3],
            uv: vec![[0.0, 0.0], [12.5, 0.0], [0.3, -1.0]],
            colour: vec![[1.0, 0.2, 0.0, 1.0], [0.4, 0.6, 0.8, 1.0], [0.0; 4]],
            lightmap_texel: vec![[0.5, 0.5], [1.5, 0.5], [0.75, 1.5]],
            triangles: vec![[0, 1, 2]],
        }],
    }
}

fn encoded() -> [(&'static str, Vec<u8>, &'static [u8]); 11] {
    let encode = |cluster| encode_cluster(&cluster, QuantisationSettings::default()).unwrap().bytes;
    [
        ("cluster-v4.lkc", encode(cluster()), V4.cluster),
        ("cluster-near-v4.lkc", encode(cluster_with_near_hits()), V4.near),
        ("probes-v4.lkc", encode_probe_batch(&probes()).unwrap(), V4.probes),
        ("patches-v4.lkc", encode_patches(&patches()).unwrap(), V4.patches),
        ("directory-v4.lkc", encode_directory(&directory(3).0, &directory(3).1).unwrap(), DIRECTORY_V4),
        ("field-v4.lkc", encode_field(&field(), 0.01).unwrap().bytes, FIELD_V4),
        ("tetrahedra-v4.lkc", encode_tetrahedra(&tetrahedra()).unwrap(), TETRAHEDRA_V4),
        ("voxels-v4.lkc", encode_voxels(&voxels()).unwrap(), VOXELS_V4),
        ("transfer-v4.lkc", encode_transfer(&transfer()).unwrap(), TRANSFER_V4),
        ("geometry-v4.lkc", encode_geometry(&geometry()).unwrap(), V4.geometry),
        ("texture-v4.lkc", encode_texture("image/png", b"\x89PNG of no size").unwrap(), V4.texture),
    ]
}

#[test]
fn version_1_still_decodes_to_what_went_in() {
    // It knew receivers' own points alone.
    let points = |cluster: &mut ClusterTransport| {
        cluster.receivers.coverage.fill(0);
        cluster.receivers.edge.fill(TexelEdge::NONE);
    };
    assert_decoded(&V1, points);
}

#[test]
fn version_2_still_decodes_to_what_went_in() {
    assert_decoded(&V2, |_| {});
}

#[test]
fn version_3_still_decodes_to_what_went_in() {
    assert_decoded(&V3, |_| {});
    // The versions before had the key of a probe here too.
    let near = decode_cluster(V3.near).unwrap();
    assert_eq!(near.near, cluster_with_near_hits().near, "in single steps");
    // It had no differences.
    assert_eq!(near.factors.keys, floor(|_, key| key));
}

#[test]
fn version_4_still_decodes_to_what_went_in() {
    assert_decoded(&V4, |_| {});
    assert_eq!(decode_directory(DIRECTORY_V4).unwrap(), directory(3));
    let near = decode_cluster(V4.near).unwrap();
    assert_eq!(near.factors.keys, cluster_with_near_hits().factors.keys);
}

/// Near hits as version 4 has them.
fn in_stored_steps(near: NearHits) -> NearHits {
    NearHits { offset: near.offset.iter().map(|offset| offset.map(NearHits::stored)).collect(), ..near }
}

fn assert_decoded(stored: &Fixtures, less: impl Fn(&mut ClusterTransport)) {
    let mut wanted = cluster();
    less(&mut wanted);
    let found = decode_cluster(stored.cluster).unwrap();
    // The weaker rank is stored coarsely; the product is what stays within 0.3 %.
    let near = |found: &[f32], wanted: &[f32], error: f32| {
        found.len() == wanted.len()
            && found.iter().zip(wanted).all(|(a, b)| (a - b).abs() <= error * b.abs().max(0.1))
    };
    assert!(
        near(&found.factors.u, &wanted.factors.u, 0.03) && near(&found.factors.vt, &wanted.factors.vt, 0.03),
        "{:?} {:?}",
        found.factors.u,
        found.factors.vt
    );
    let lit = |cluster: &ClusterTransport| cluster.emitters[0].irradiance.as_flattened().to_vec();
    assert!(near(&lit(&found), &lit(&wanted), IRRADIANCE_RELATIVE_ERROR));
    assert_eq!(
        ClusterTransport {
            factors: TransportFactors {
                u: wanted.factors.u.clone(),
                vt: wanted.factors.vt.clone(),
                steps: FactorSteps::default(),
                ..found.factors
            },
            emitters: wanted.emitters.clone(),
            ..found
        },
        wanted
    );
    let near = decode_cluster(stored.near).unwrap().near;
    assert_eq!(in_stored_steps(near), in_stored_steps(cluster_with_near_hits().near));
    assert_eq!(decode_probe_batch(stored.probes).unwrap(), probes());
    assert_eq!(decode_patches(stored.patches).unwrap(), patches());
    assert_eq!(decode_geometry(stored.geometry).unwrap(), geometry());
    let texture = decode_texture(stored.texture).unwrap();
    assert_eq!((texture.media_type.as_str(), &texture.bytes[..]), ("image/png", &b"\x89PNG of no size"[..]));
}

/// Two probes that a patch of the floor and a lamp light. All numbers survive quantisation but ΣVᵀ.
fn field() -> FieldPart {
    let probe =
        |x: i32, moved: [i8; 3]| FieldProbe { key: FieldKey::of(glam::IVec3::new(x, 1, -2)).unwrap(), moved };
    let u: Vec<f32> = (0..2 * PROBE_ROWS).map(|row| if row % PROBE_ROWS == 0 { 0.5 } else { 0.0 }).collect();
    let of_lamp = |row: usize| [0.25 * row as f32, -1.0, 0.0];
    FieldPart {
        spacing_m: 0.5,
        probes: vec![probe(-3, [0; 3]), probe(-2, [0, -2, 3])],
        depths: (0..2 * MAP_POINTS).map(|at| if at < 20 { 0 } else { 1000 + at as u16 }).collect(),
        factors: TransportFactors {
            keys: vec![PatchKey::of_cell(1, [2, 3, -1], 2, 0).0],
            rank: 1,
            u,
            vt: vec![4.0],
            ..TransportFactors::default()
        },
        emitters: vec![EmitterIrradiance {
            emitter: 1,
            irradiance: (0..2 * PROBE_ROWS).map(of_lamp).collect(),
        }],
    }
}

/// Tetrahedra about two probes.
fn tetrahedra() -> TetrahedronSet {
    let vertices = vec![[0, 1, 2, 3], [0, 1, 3, 9], [0, 2, 5, 6], [1, 7, 8, 9]];
    TetrahedronSet { box_m: [[-1.5, 0.0, -2.0], [1.5, 2.5, 0.25]], probes: 2, vertices }
}

/// A lamp on a floor and the floor's dark back, in two levels of voxels.
fn voxels() -> VoxelPart {
    let floor = |level: u32, cell: [i32; 3]| Element {
        normal: NormalCode([0, 32_767]),
        plane: 1000 >> level,
        bits: if level == 0 { 0x0000_00c0_0000_00c0 } else { 0xf0 },
        patch: Some(PatchKey::of_cell(level, cell, 2, 0)),
        glow: 0,
        is_backed: true,
        is_finest: false,
    };
    let lamp = Element { glow: 1, patch: Some(PatchKey::of_cell(5, [-1, 0, 0], 2, 3)), ..floor(0, [0; 3]) };
    let back = Element { normal: NormalCode([0, -32_767]), plane: -400, patch: None, ..floor(0, [0; 3]) };
    let brick = |level: u32, x: i32, elements: Vec<Element>| Brick {
        key: BrickKey::new(level, glam::IVec3::new(x, 0, 0)),
        voxels: vec![Voxel { place: 9, elements: elements.len() as u16 }],
        elements,
    };
    VoxelPart {
        voxel_m: 0.25,
        glows: vec![Glow { emitter: 2, share: [1.0, 0.5, 0.25] }],
        bricks: vec![
            brick(1, -1, vec![floor(1, [-14, 2, 0])]),
            brick(0, -2, vec![floor(0, [-30, 2, 1]), lamp, back]),
            brick(0, -1, vec![floor(0, [-13, 3, 0])]),
        ],
    }
}

/// A glowing side and a dark back, at 5³ nodes.
fn transfer() -> TransferLevel {
    let side = TransferPart {
        patches: vec![
            PartPatch { key: PatchKey::of_cell(2, [-1, 0, 3], 0, 0), share: 0.25 },
            PartPatch { key: PatchKey::of_cell(2, [0, 0, 3], 0, 1), share: 0.75 },
        ],
        glows: vec![PartGlow { emitter: 1, share: [0.5, 0.25, 0.0] }],
        middle_m: [0.5, 0.25, -1.5],
        plane: [0.0, 1.0, 0.0, -0.25],
        steps: [0.015625, 0.03125],
    };
    let back = TransferPart { steps: [0.0, 0.0078125], ..TransferPart::default() };
    let code = |index: usize| [index as i8, -(index as i8), 7, 127 - index as i8];
    let codes = (0..125).map(code).chain((0..125).map(|index| [0, 0, 0, index as i8])).collect();
    TransferLevel {
        level: 1,
        box_m: [[-1.0, 0.0, -2.0], [1.0, 2.5, -1.0]],
        nodes: 5,
        parts: vec![side, back],
        codes,
    }
}

#[test]
fn transfer_of_version_4_still_decodes_to_what_went_in() {
    assert_eq!(decode_transfer(TRANSFER_V4).unwrap(), transfer());
}

#[test]
fn voxels_of_version_4_still_decode_to_what_went_in() {
    assert_eq!(decode_voxels(VOXELS_V4).unwrap(), voxels());
}

#[test]
fn tetrahedra_of_version_4_still_decode_to_what_went_in() {
    assert_eq!(decode_tetrahedra(TETRAHEDRA_V4).unwrap(), tetrahedra());
}

#[test]
fn field_of_version_4_still_decodes_to_what_went_in() {
    let mut found = decode_field(FIELD_V4).unwrap();
    assert!((found.factors.vt[0] - 4.0).abs() < 0.044, "{:?}", found.factors.vt);
    (found.factors.steps, found.factors.vt) = (FactorSteps::default(), field().factors.vt);
    assert_eq!(found, field());
}

#[test]
fn encoders_still_write_the_same_bytes() {
    for (name, bytes, fixture) in encoded() {
        let advice = "digests change: raise TaskKind::version, and FORMAT.md's version where old decoders cannot read it";
        assert_eq!(bytes, fixture, "{name} comes out otherwise; {advice}");
    }
}

#[test]
#[ignore = "writes proto/fixtures; run by hand when a version is added"]
fn write_fixtures() {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("fixtures");
    for (name, bytes, _) in encoded() {
        std::fs::write(folder.join(name), bytes).unwrap();
    }
}
