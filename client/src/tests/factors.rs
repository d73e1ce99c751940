//! Passes over clusters and patches on the adapter against their references, on clusters whose numbers are kept in every way
//! there is, and on patches of many leaves. Ignored by default, as those of `adapter.rs`, whose name theirs have.

use glam::Vec4;
use lightkiln_proto::content::{AreaCode, FactorSteps, Patch, PatchKey, PatchSet, TransportFactors};
use lightkiln_proto::relight::{
    Cluster, ClusterTable, Columns, Irradiance, Panorama, Parallel, PatchTable, ReceiverTable, Sky,
};

use super::adapter::{held, noise, positive_noise, with_and_without_paging};
use super::fixture_light;
use crate::fixture;
use crate::passes::basis::BasisPass;
use crate::passes::compare::Difference;
use crate::passes::gpu::Gpu;
use crate::passes::lod::DetailBuffers;
use crate::passes::patches::PatchesPass;
use crate::passes::reconstruct::{ReconstructPass, RowArrays};
use crate::passes::resident::{ColumnsPass, Resident};
use crate::passes::{basis, patches, reconstruct};

/// Factors of a cluster of so many rows without pattern: whole numbers of their steps up to `largest` in the first ranks of
/// either factor, up to 120 in the others; of no steps where `largest` is none.
fn factors_of(
    (rank, rows): (usize, usize),
    keys: &[u64],
    largest: Option<f32>,
    seed: u32,
) -> TransportFactors {
    let steps = match largest {
        Some(_) => FactorSteps {
            u: (0..rank).map(|i| 0.01 + 0.001 * i as f32).collect(),
            vt: (0..rank).map(|i| 0.3 / (1 + i) as f32).collect(),
            scale: (0..keys.len()).map(|column| [1.0, 2.0, 1.189_207_1][column % 3]).collect(),
        },
        None => FactorSteps::default(),
    };
    let numbers = |count: usize, most: &dyn Fn(usize, f32) -> f32, seed: u32| -> Vec<f32> {
        let of = |(index, noise): (usize, Vec4)| match largest {
            Some(largest) => (noise.x * most(index, largest)).round(),
            None => noise.x,
        };
        noise(count, seed).into_iter().enumerate().map(of).collect()
    };
    let columns = keys.len();
    let most_of_u = |index: usize, largest: f32| if index % rank < 3 { largest } else { 120.0 };
    let most_of_vt = |index: usize, largest: f32| [largest, 100.0, 7.0][index % columns % 3];
    let u = numbers(rows * rank, &most_of_u, seed);
    let vt = numbers(rank * columns, &most_of_vt, seed + 1);
    let [step_u, step_vt] =
        [&steps.u, &steps.vt].map(|steps| move |i: usize| steps.get(i).copied().unwrap_or(1.0));
    let scale = |column: usize| steps.scale.get(column).copied().unwrap_or(1.0);
    TransportFactors {
        keys: keys.to_vec(),
        rank: rank as u32,
        u: u.iter().enumerate().map(|(index, number)| number * step_u(index % rank)).collect(),
        vt: vt
            .iter()
            .enumerate()
            .map(|(index, number)| number * step_vt(index / columns) * scale(index % columns))
            .collect(),
        steps,
        ..TransportFactors::default()
    }
}

/// So many columns, of the light of nothing in particular.
#[derive(Debug)]
struct Many(u32);

impl Columns for Many {
    fn bands(&self) -> u32 {
        0
    }

    fn lambda_count(&self) -> usize {
        self.0 as usize
    }

    fn index(&self, key: u64) -> Option<u32> {
        u32::try_from(key).ok().filter(|key| *key < self.0)
    }

    fn sky_index(&self) -> Option<u32> {
        None
    }

    fn panorama_lambda(&self, _: &Panorama) -> Vec<Vec4> {
        Vec::new()
    }

    fn sky_lambda(&self, _: Sky) -> Vec<Vec4> {
        Vec::new()
    }

    fn surface_lambda(&self, _: &impl Parallel, _: &ReceiverTable, _: Irradiance<'_>) -> Vec<Vec4> {
        Vec::new()
    }
}

/// More than the shader gathers at a time, and than twice as many.
const COLUMNS: Many = Many(700);

/// Clusters with numbers in 4 and 8 bits, in 16, in f32, with more ranks than a workgroup has
/// threads, with none, and with one rank.
fn packed_clusters() -> ClusterTable {
    let keys: Vec<u64> = (0..u64::from(COLUMNS.0)).collect();
    let few = &keys[..7];
    let clusters = [
        (factors_of((20, 50), &keys, Some(120.0), 1), 50),
        (factors_of((9, 130), &keys, Some(9000.0), 3), 130),
        (factors_of((5, 64), few, Some(1e6), 5), 64),
        (factors_of((70, 100), few, Some(300.0), 7), 100),
        (factors_of((0, 10), &[], None, 9), 10),
        (factors_of((33, 65), &keys[..20], None, 11), 65),
        (factors_of((1, 1), few, Some(100.0), 13), 1),
    ];
    let table =
        ClusterTable::join(clusters.iter().map(|(factors, rows)| (factors, *rows)), &COLUMNS).unwrap();
    let packed: Vec<[usize; 3]> =
        table.clusters.iter().map(|Cluster { vt, .. }| [vt.wide, vt.wide_words, vt.bytes]).collect();
    let third = keys.len().div_ceil(3);
    let second = (keys.len() + 1) / 3;
    assert_eq!(packed[..3], [[0, 4, third + second], [third, 4, second], [3, 8, 2]]);
    assert_eq!(packed[3..6], [[3, 4, 2], [0, 4, 0], [20, 8, 0]]);
    assert!(4 * table.vt.len() > 16 << 10 && third > 200, "pages, and classes that end within a tile");
    let wide_of_u: Vec<usize> = table.clusters.iter().map(|cluster| cluster.u.wide).collect();
    assert_eq!(wide_of_u[..6], [0, 1, 1, 1, 0, 5]);
    table
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_basis_agrees_with_the_reference() {
    with_and_without_paging(|gpu| {
        let table = packed_clusters();
        let values = noise(COLUMNS.lambda_count(), 5);
        let lambda = gpu.storage("lambda", &values).unwrap();
        let b = gpu.blank("b", (table.b_len * size_of::<Vec4>()) as u64).unwrap();
        let detail = DetailBuffers::new(gpu, &table).unwrap();
        let pass = BasisPass::new(gpu, &table, [&lambda, &b], &detail).unwrap();
        gpu.submit(|encoder| pass.record(&mut encoder.begin_compute_pass(&Default::default())));
        let got: Vec<Vec4> = gpu.read(&b, table.b_len).unwrap();
        let wanted = basis::reference::basis(&table, &values);
        // By cluster: numbers of one are far larger than those of another.
        for cluster in table.clusters.iter().filter(|cluster| cluster.rank > 0) {
            let own = cluster.first_b..cluster.first_b + cluster.rank;
            let difference = Difference::of(&got[own.clone()], &wanted[own], basis::TOLERANCE);
            held("basis", &difference, 0.0);
        }
    });
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_reconstruct_agrees_with_the_reference() {
    with_and_without_paging(|gpu| {
        let table = packed_clusters();
        let rows: usize = table.clusters.iter().map(|cluster| cluster.row_count).sum();
        // Light of one size, whatever the numbers of the cluster.
        let mut b = noise(table.b_len, 6);
        for cluster in &table.clusters {
            let largest = [100.0, 9000.0, 1e6, 300.0, 1.0, 1.0, 100.0];
            let index = table.clusters.iter().position(|other| other == cluster).unwrap();
            b[cluster.first_b..][..cluster.rank].iter_mut().for_each(|b| *b /= largest[index]);
        }
        let (start, beside) = (positive_noise(rows, 11), positive_noise(rows, 12));
        let [b_buffer, start_buffer, beside_buffer] =
            [&b, &start, &beside].map(|values| gpu.storage("given", values).unwrap());
        let result = gpu.blank("E", (rows * size_of::<Vec4>()) as u64).unwrap();
        let detail = DetailBuffers::new(gpu, &table).unwrap();
        let arrays = RowArrays {
            b: &b_buffer,
            start: &start_buffer,
            beside: Some(&beside_buffer),
            result: &result,
            detail: &detail,
        };
        let made = |rows_of: RowArrays<'_>| -> Vec<Vec4> {
            let pass = ReconstructPass::new(gpu, &table, rows_of).unwrap();
            gpu.submit(|encoder| pass.record(&mut encoder.begin_compute_pass(&Default::default())));
            gpu.read(&result, rows).unwrap()
        };
        let wanted = reconstruct::reference::reconstruct(&table, &b, &start, Some(&beside));
        held("reconstruct", &Difference::of(&made(arrays), &wanted, reconstruct::TOLERANCE), 0.0);
        // Rows that have a sign are not clamped.
        let sums = reconstruct::reference::reconstruct(&table, &b, &start, None);
        assert!(sums.iter().zip(&wanted).any(|(sum, clamped)| sum.x < clamped.x));
        let signed = made(RowArrays { beside: None, ..arrays });
        held("signed rows", &Difference::of(&signed, &sums, reconstruct::TOLERANCE), 0.0);
    });
}

/// Patches of 9,000 leaves, of which some begin and end within blocks.
#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_patches_of_many_leaves_agree_with_the_reference() {
    let gpu = Gpu::open().unwrap();
    let mut transport = fixture_light().1.transport;
    let leaves = 9000_u32;
    let runs = [(0, leaves), (0, 4096), (63, 2), (64, 8192), (65, 127), (4095, 4098), (8999, 1)];
    let mut patches: Vec<Patch> = runs
        .iter()
        .enumerate()
        .map(|(index, &(first_leaf, leaf_count))| Patch {
            key: PatchKey(index as u64),
            first_leaf,
            leaf_count,
        })
        .collect();
    patches.sort_by_key(|patch| patch.key);
    let (name, count) = (fixture::block_key(0, false), leaves as usize);
    let set = PatchSet {
        patches,
        leaf_starts: (0..=leaves).collect(),
        blocks: vec![name],
        block: vec![0; count],
        texel: (0..count).map(|leaf| [(leaf % 7) as u16, (leaf / 7 % 5) as u16]).collect(),
        area: (0..count).map(|leaf| AreaCode(120 + (leaf % 16) as u8)).collect(),
        sky_parts: 0,
    };
    transport.columns = PatchTable::new(&set, &transport.slots).unwrap();
    let resident = Resident::new(&gpu, &transport).unwrap();
    let [dir, emit, ind] = [1, 2, 3].map(|seed| positive_noise(transport.receivers.len(), seed));
    for (buffer, values) in [(&resident.e_dir, &dir), (&resident.e_emit, &emit), (&resident.e_ind, &ind)] {
        gpu.write(buffer, values);
    }
    let pass = PatchesPass::new(&gpu, &transport.columns, &resident).unwrap();
    gpu.submit(|encoder| pass.record(&mut encoder.begin_compute_pass(&Default::default())));
    let got = gpu.read(&resident.lambda, resident.lambda_count).unwrap();
    let wanted = transport.lambda(&crate::Threads, Irradiance { dir: &dir, emit: &emit, ind: &ind }, &[]);
    assert_eq!((wanted.len(), got.len()), (14, 14));
    held("patches of many leaves", &Difference::of(&got, &wanted, patches::TOLERANCE), 0.0);
    // Other runs have other means: none stands for another.
    assert!(wanted[..7].windows(2).all(|pair| pair[0].distance(pair[1]) > 1e-5), "{wanted:?}");
}
