//! Small contents to encode.

use crate::content::*;
use crate::ids::Digest;
use crate::kinds::field::{
    FieldPart, MAP_POINTS, PROBE_ROWS, Probe as FieldProbe, ProbeKey as FieldKey, TetrahedronSet,
};
use crate::kinds::sh::*;
use crate::manifest::{ChunkRef, ClusterRow, Layer, PrefixCheck};
use crate::transfer::{PartGlow, PartPatch, TransferLevel, TransferPart};
use crate::voxels::{Brick, BrickKey, Element, Glow, NormalCode, Voxel, VoxelPart, voxel_in_brick};

/// Numbers in 0..1 that look random and are the same everywhere.
pub(super) struct Noise(pub u64);

impl Noise {
    pub fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1_u64 << 24) as f32
    }

    pub fn below(&mut self, count: u32) -> u32 {
        (self.next() * count as f32) as u32
    }
}

/// A cluster of a square wall of `side`² texels, in stored order.
pub(super) fn wall(side: u16, keys: usize, bands: u32, rank: u32, seed: u64) -> ClusterTransport {
    let mut noise = Noise(seed);
    let mut cluster = ClusterTransport {
        bounds_m: [[0.0, -1.0, 2.0], [4.0, 3.0, 2.0]],
        factors: TransportFactors {
            keys: (0..keys as u64).map(|p| p * p * 977 + 5).collect(),
            bands,
            sky: true,
            rank,
            ..TransportFactors::default()
        },
        ..ClusterTransport::default()
    };
    let mut texels: Vec<Texel> = (0..side).flat_map(|y| (0..side).map(move |x| [x, y])).collect();
    texels.sort_by_key(|&texel| (4 - Receivers::level(texel, 3), super::super::order::morton(texel)));
    cluster.receivers.blocks = vec![11];
    for texel in texels {
        let [x, y] = texel.map(|t| f32::from(t) / f32::from(side));
        cluster.receivers.block.push(0);
        cluster.receivers.texel.push(texel);
        cluster.receivers.position_m.push([4.0 * x, 4.0 * y - 1.0, 2.0]);
        cluster.receivers.links.push((texel[0] % 16) as u8);
        cluster.receivers.coverage.push(if texel[0] == 0 { 0xEEEE } else { u16::MAX });
        cluster.receivers.edge.push(TexelEdge(if texel[1] == 0 { 0x1280 } else { 0 }));
        cluster.receivers.normal.push([0.0, 0.0, -1.0]);
        cluster.receivers.albedo.push(if texel[0] < side / 2 { [0.5, 0.25, 0.0] } else { [0.73; 3] });
        cluster.receivers.emission.push(if texel == [1, 1] { [10.0, 8.0, 0.1] } else { [0.0; 3] });
        for i in 0..rank {
            let wave = libm::sinf((1 + i) as f32 * x + 0.7) * libm::cosf(i as f32 * 1.3 * y);
            cluster.factors.u.push((wave + 0.05 * noise.next()) / f32::from(side));
        }
    }
    let coefficients = cluster.factors.coefficients();
    for i in 0..rank {
        for column in 0..cluster.factors.columns() {
            let band = crate::harmonics::band_of(column % coefficients) as f32;
            let strength = libm::expf(-0.25 * i as f32 - 0.4 * band);
            cluster.factors.vt.push((noise.next() - 0.5) * strength);
        }
    }
    let emitter = |r: usize| if r.is_multiple_of(3) { [0.0; 3] } else { [1e-6 * r as f32, 1.0, 1e6] };
    let irradiance = (0..cluster.receivers.len()).map(emitter).collect();
    cluster.emitters = vec![EmitterIrradiance { emitter: 4, irradiance }];
    cluster
}

/// As [`wall`], lit by patches of a wall across, where every third receiver has near hits, as they come back: ascending, and
/// no block without any.
pub(super) fn narrow(side: u16, seed: u64) -> ClusterTransport {
    let mut noise = Noise(seed + 1);
    let mut cluster = wall(side, 39, 0, 9, seed);
    let patch = |p: i32| PatchKey::of_cell((p / 32) as u32, [p % 8 - 4, -1, p % 32 / 8], 4, 0);
    let column = |p: i32| if p % 4 == 1 { patch(p).difference().0 } else { patch(p).0 };
    cluster.factors.keys = (0..40).map(column).collect();
    cluster.factors.keys.sort_unstable();
    cluster.factors.sky = false;
    let near = &mut cluster.near;
    (near.reach_m, near.blocks) = (0.125, vec![11, 700]);
    for receiver in 0..cluster.receivers.len() {
        let count = if receiver % 3 == 0 { 2 + receiver as u8 % 7 } else { 0 };
        near.count.push(count);
        near.weight.push(if count > 0 { std::f32::consts::PI / f32::from(count) } else { 0.0 });
        for hit in 0..u16::from(count) {
            near.surface.push(match hit {
                0..3 => NearSurface::Texel { block: hit / 2, texel: [40 + hit, 9] },
                _ => NearSurface::Own { albedo: [0.0; 3], normal: [-1.0, 0.0, 0.0] },
            });
            let across = [-2047.0, 2047.0].map(|most| (most * noise.next()) as i16);
            near.offset.push([hit as i16 * 8, across[0], across[1]].map(NearHits::stored));
        }
    }
    cluster
}

/// A box of two tetrahedra a probe, whose corners are the box's own.
pub(super) fn tetrahedra(probes: u32) -> TetrahedronSet {
    let corner = |at: u32| probes + at;
    let of =
        |probe: u32| [[probe, corner(0), corner(1), corner(3)], [probe, corner(2), corner(5), corner(7)]];
    let vertices = (0..probes).flat_map(of).collect();
    TetrahedronSet { box_m: [[-1.5, 0.0, 2.0], [1.5, 0.25, 9.0]], probes, vertices }
}

/// Probes of a field, in stored order.
pub(super) fn field(probes: usize, rank: u32, seed: u64) -> FieldPart {
    let mut noise = Noise(seed);
    let rows = probes * PROBE_ROWS;
    // Of one level: columns of all have one scale, by which the error of numbers is weighed.
    let mut keys: Vec<u64> = (0..40).map(|p| PatchKey::of_cell(1, [p % 8 - 4, -1, p / 8], 4, 0).0).collect();
    keys.sort_unstable();
    let mut numbers = |count: usize| (0..count).map(|_| noise.next() - 0.5).collect::<Vec<f32>>();
    let factors = TransportFactors {
        rank,
        u: numbers(rows * rank as usize),
        vt: numbers(rank as usize * keys.len()),
        keys,
        ..TransportFactors::default()
    };
    let probe = |at: usize| FieldProbe {
        key: FieldKey::of(glam::IVec3::new(at as i32 % 4 - 2, at as i32 / 4, 3)).unwrap(),
        moved: [at as i8 % 4, -(at as i8 % 3), 0],
    };
    let irradiance = numbers(3 * rows).as_chunks::<3>().0.to_vec();
    FieldPart {
        spacing_m: 0.75,
        probes: (0..probes).map(probe).collect(),
        depths: (0..probes * MAP_POINTS).map(|at| (at % 700 * 90) as u16).collect(),
        factors,
        emitters: vec![EmitterIrradiance { emitter: 2, irradiance }],
    }
}

/// A level of a volume of so many nodes along each axis, of one part in three that is dark.
pub(super) fn transfer(nodes: u32) -> TransferLevel {
    let count = (nodes as usize).pow(3);
    let part = |number: u32| TransferPart {
        patches: (0..3 * (number % 3))
            .map(|at| PartPatch { key: PatchKey(u64::from(at)), share: 0.1 })
            .collect(),
        glows: (0..number).map(|emitter| PartGlow { emitter: emitter as u16, share: [0.5; 3] }).collect(),
        middle_m: [number as f32, 0.5, -0.5],
        plane: if number == 1 { [0.0; 4] } else { [0.6, 0.0, 0.8, number as f32] },
        steps: [0.01, 0.02],
    };
    let code =
        |index: usize| [(index % 100) as i8, (index % 7) as i8, -((index % 11) as i8), (index % 127) as i8];
    let codes = (0..4 * count).map(code).collect();
    TransferLevel {
        level: 2,
        box_m: [[-1.0; 3], [1.0, 2.0, 0.5]],
        nodes,
        parts: (0..4).map(part).collect(),
        codes,
    }
}

/// Voxels of so many levels with every kind of element: of one normal and of many, of patches near and far, dark, glowing.
pub(super) fn voxels(levels: u32, seed: u64) -> VoxelPart {
    let mut noise = Noise(seed);
    let glow = |emitter: u16| Glow { emitter, share: [1.0, 0.25 * f32::from(emitter), 1e-3] };
    let mut bricks = Vec::new();
    for level in (0..levels).rev() {
        for cell in 0..1 << (levels - level) {
            let key = BrickKey::new(level, glam::IVec3::new(cell - 3, -1, cell / 4));
            bricks.push(brick(key, &mut noise));
        }
    }
    VoxelPart { voxel_m: 0.125, glows: (0..3).map(glow).collect(), bricks }
}

fn brick(key: BrickKey, noise: &mut Noise) -> Brick {
    let mut brick = Brick { key, voxels: Vec::new(), elements: Vec::new() };
    let mut place = 0;
    while place < 512 {
        let elements = 1 + noise.below(3) as u16;
        brick.voxels.push(Voxel { place: place as u16, elements });
        for _ in 0..elements {
            let voxel = key.first_voxel() + voxel_in_brick(place as u16);
            brick.elements.push(element(voxel, key.level, noise));
        }
        place += 1 + noise.below(90);
    }
    brick
}

fn element(voxel: glam::IVec3, level: u32, noise: &mut Noise) -> Element {
    let normal = match noise.below(3) {
        0 => NormalCode([0, 32_767]),
        1 => NormalCode([1234, -77]),
        _ => NormalCode([0; 2].map(|_| noise.below(65_535) as i32 - 32_767).map(|at| at as i16)),
    };
    let cell = (2 * voxel).to_array().map(|at| at + noise.below(2) as i32);
    let patch = match noise.below(8) {
        0 => None,
        1 => Some(PatchKey::of_cell(noise.below(15), [noise.below(300) as i32 - 150, 7, -9], 3, 5)),
        2 => Some(PatchKey::of_cell(level / 2, cell.map(|at| at << (level - level / 2)), 5, 1023)),
        direction => Some(PatchKey::of_cell(level, cell, direction as u8 - 3, noise.below(2))),
    };
    Element {
        normal,
        plane: (noise.below(65_536) as i32 - 32_768) as i16,
        bits: u64::from(1 + noise.below(65_535)) << noise.below(48),
        patch,
        glow: noise.below(4) as u16,
        is_backed: noise.below(2) == 0,
        is_finest: noise.below(2) == 0,
    }
}

/// A batch with every kind of hit.
pub(super) fn batch(probes: usize, rays: u32, seed: u64) -> ProbeBatch {
    let mut noise = Noise(seed);
    let probe = |p: usize| Probe {
        key: 3 + 10 * p as u64,
        position_m: [p as f32, 0.1, -2.5],
        radius_m: 1.5 + p as f32,
    };
    let hit = |_| match noise.below(4) {
        0 => RelightHit::Sky,
        1 => RelightHit::Dark,
        kind => RelightHit::Receiver {
            block: kind as u16 - 2,
            texel: [noise.below(40) as u16, noise.below(65_536) as u16],
        },
    };
    let hits = (0..probes * rays as usize).map(hit).collect();
    ProbeBatch {
        probes: (0..probes).map(probe).collect(),
        relight_rays: rays,
        blocks: vec![8, 9, u64::MAX],
        hits,
    }
}

/// A whole of `leaves` leaves of one to three receivers, and a patch for each leaf.
pub(super) fn patches(leaves: u32) -> PatchSet {
    let whole = Patch { key: PatchKey::of_cell(3, [0, -1, 2], 2, 0), first_leaf: 0, leaf_count: leaves };
    let leaf = |leaf: u32| Patch {
        key: PatchKey::of_cell(0, [leaf as i32 - 1, -4, 9], 2, leaf % 2),
        first_leaf: leaf,
        leaf_count: 1,
    };
    let leaf_starts: Vec<u32> = (0..=leaves).map(|leaf| leaf + leaf / 2).collect();
    let count = leaf_starts[leaves as usize];
    PatchSet {
        patches: (0..leaves).map(leaf).chain([whole]).collect(),
        leaf_starts,
        blocks: vec![8, 9],
        block: (0..count).map(|r| r % 2).collect(),
        texel: (0..count).map(|r| [(r as u16).wrapping_mul(7), 65_535 - r as u16]).collect(),
        area: (0..count).map(|r| AreaCode((r * 37 % 256) as u8)).collect(),
        sky_parts: 64,
    }
}

/// Three draws: a plain quad, one outside the lightmap, and a double-sided one with texture coordinates and colours.
pub(super) fn quads() -> Geometry {
    let plain = Draw {
        material: 3,
        front: Some(77),
        position_m: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.1, 1.0], [0.0, 0.1, 1.0]],
        normal: vec![[0.0, 1.0, 0.0]; 4],
        lightmap_texel: vec![[0.5, 0.5], [10.5, 0.5], [10.5, 12.25], [0.5, 12.25]],
        triangles: vec![[0, 2, 1], [0, 3, 2]],
        ..Draw::default()
    };
    let rich = Draw {
        back: Some(u64::MAX),
        uv: vec![[0.0, 0.0], [37.25, 0.1], [1e5, -3.0], [0.1, 0.7]],
        colour: vec![[1.0, 0.5, 0.25, 1.0], [0.1, 0.2, 0.3, 0.4], [0.0; 4], [2.0; 4]],
        ..plain.clone()
    };
    let outside = Draw { front: None, back: None, lightmap_texel: Vec::new(), ..rich.clone() };
    Geometry { draws: vec![plain, outside, rich] }
}

/// Clusters of one to three layers, and their chunks.
pub(super) fn directory(clusters: u32) -> (Vec<ClusterRow>, Vec<ChunkRef>) {
    let row = |index: u32| {
        let at = index as f32 * 0.75;
        let layer = |layer: u32| Layer {
            bytes: u64::from(300 * (layer + 1) + index),
            level: 2 - layer,
            bands: 0,
            rank: 8 + layer,
        };
        let layers: Vec<Layer> = (0..=index % 3).map(layer).collect();
        ClusterRow {
            bounds_m: [[at, -1.0, 0.0], [at + 1.0, 2.5, 0.0]],
            receivers: 100 + index,
            keys: 7,
            rank: 10,
            truncation_error: 0.01 * at,
            quantisation_error: 0.002,
            uncovered_fraction: 0.0,
            checks: layers[1..].iter().map(|layer| PrefixCheck::of(&[layer.rank as u8])).collect(),
            layers,
        }
    };
    let rows: Vec<ClusterRow> = (0..clusters).map(row).collect();
    let chunk = |row: &ClusterRow| ChunkRef {
        digest: Digest::of(&row.receivers.to_le_bytes()),
        bytes: row.layers.last().unwrap().bytes,
    };
    let chunks = rows.iter().map(chunk).collect();
    (rows, chunks)
}
