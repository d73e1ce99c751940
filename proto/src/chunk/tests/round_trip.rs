//! Content comes back from its chunk within the stated errors.

use std::collections::BTreeSet;

use super::scenes::{batch, directory, field, narrow, patches, quads, tetrahedra, voxels, wall};
use crate::chunk::*;
use crate::content::*;
use crate::kinds::field::{
    FieldPart, PROBE_ROWS, TetrahedronSet, decode_field, decode_tetrahedra, encode_field, encode_tetrahedra,
};
use crate::kinds::sh::*;
use crate::manifest::{ChunkRef, ClusterRow};
use crate::voxels::{VoxelPart, decode_voxels, encode_voxels};

fn product(cluster: &ClusterTransport) -> Vec<f64> {
    let (rank, columns) = (cluster.factors.rank as usize, cluster.factors.columns());
    let mut product = Vec::new();
    for row in cluster.factors.u.chunks_exact(rank) {
        for column in 0..columns {
            let entry = |i: usize| f64::from(row[i]) * f64::from(cluster.factors.vt[i * columns + column]);
            product.push((0..rank).map(entry).sum());
        }
    }
    product
}

fn relative_error(exact: &[f64], decoded: &[f64]) -> f64 {
    let difference: f64 = exact.iter().zip(decoded).map(|(a, b)| (a - b) * (a - b)).sum();
    (difference / exact.iter().map(|a| a * a).sum::<f64>()).sqrt()
}

#[test]
fn cluster_comes_back_within_its_stated_errors() {
    let cluster = wall(16, 5, 4, 12, 1);
    let encoded = encode_cluster(&cluster, QuantisationSettings::default()).unwrap();
    let decoded = decode_cluster(&encoded.bytes).unwrap();
    let error = relative_error(&product(&cluster), &product(&decoded));
    assert!(error <= 0.003 && (error - f64::from(encoded.quantisation_error)).abs() < 1e-5, "{error}");
    assert_eq!(decoded.factors.keys, cluster.factors.keys);
    assert_eq!(decoded.bounds_m, cluster.bounds_m);
    assert_eq!((decoded.factors.bands, decoded.factors.sky, decoded.factors.rank), (4, true, 12));
    let (got, wanted) = (&decoded.receivers, &cluster.receivers);
    assert_eq!(
        (&got.blocks, &got.block, &got.texel, &got.links, &got.coverage, &got.edge),
        (&wanted.blocks, &wanted.block, &wanted.texel, &wanted.links, &wanted.coverage, &wanted.edge)
    );
    assert_eq!((&got.normal, &got.albedo, &got.emission), (&wanted.normal, &wanted.albedo, &wanted.emission));
    for (got, wanted) in got.position_m.iter().zip(&wanted.position_m) {
        for axis in 0..3 {
            let bounds = [cluster.bounds_m[0][axis], cluster.bounds_m[1][axis]];
            assert!((got[axis] - wanted[axis]).abs() <= position_error_m(bounds));
        }
    }
    for (got, wanted) in decoded.emitters[0].irradiance.iter().zip(&cluster.emitters[0].irradiance) {
        for (got, wanted) in got.iter().zip(wanted) {
            let within = (got - wanted).abs() <= IRRADIANCE_RELATIVE_ERROR * wanted;
            assert!(if *wanted == 0.0 { *got == 0.0 } else { within }, "{got} {wanted}");
        }
    }
}

#[test]
fn decoded_factors_are_whole_numbers_of_their_steps() {
    for cluster in [wall(16, 5, 4, 12, 1), narrow(16, 3)] {
        let encoded = encode_cluster(&cluster, QuantisationSettings::default()).unwrap();
        let TransportFactors { u, vt, rank, steps, .. } = decode_cluster(&encoded.bytes).unwrap().factors;
        let (rank, columns) = (rank as usize, vt.len() / rank as usize);
        let is_whole = |value: f32, step: f32, scale: f32| {
            let whole = (value / (step * scale)).round();
            whole * step * scale == value && whole.abs() < 32_767.0
        };
        assert!(u.iter().enumerate().all(|(index, &u)| is_whole(u, steps.u[index % rank], 1.0)));
        let scale = |column: usize| steps.scale.get(column).copied().unwrap_or(1.0);
        let of_vt =
            |(index, &vt): (usize, &f32)| is_whole(vt, steps.vt[index / columns], scale(index % columns));
        assert!(vt.iter().enumerate().all(of_vt));
    }
}

#[test]
fn columns_come_back_within_the_error_of_the_light_that_they_are_expected_to_read() {
    let cluster = narrow(16, 3);
    let encoded = encode_cluster(&cluster, QuantisationSettings::default()).unwrap();
    let decoded = decode_cluster(&encoded.bytes).unwrap();
    let differences = |keys: &[u64]| keys.iter().filter(|key| PatchKey(**key).is_difference()).count();
    assert_eq!(decoded.factors.keys, cluster.factors.keys);
    assert_eq!(differences(&decoded.factors.keys), 10);
    let by_light = |cluster: &ClusterTransport| -> Vec<f64> {
        let deviations = cluster.factors.keys.iter().map(|&key| f64::from(column_deviation(key)));
        product(cluster)
            .iter()
            .zip(deviations.collect::<Vec<_>>().iter().cycle())
            .map(|(a, b)| a * b)
            .collect()
    };
    let error = relative_error(&by_light(&cluster), &by_light(&decoded));
    assert!(error <= 0.003 && (error - f64::from(encoded.quantisation_error)).abs() < 1e-5, "{error}");
    // Differences have coarser numbers than patches, so as plain numbers they are further off.
    assert!(relative_error(&product(&cluster), &product(&decoded)) > 0.003);
}

#[test]
fn near_hits_come_back_exactly_and_without_them_nothing_is_stored_of_them() {
    let cluster = narrow(16, 3);
    let bytes = encode_cluster(&cluster, QuantisationSettings::default()).unwrap().bytes;
    let decoded = decode_cluster(&bytes).unwrap().near;
    for (got, wanted) in decoded.weight.iter().zip(&cluster.near.weight) {
        assert!((got - wanted).abs() <= NEAR_WEIGHT_ERROR, "{got} {wanted}");
    }
    assert_eq!(NearHits { weight: cluster.near.weight.clone(), ..decoded }, cluster.near);
    let without = ClusterTransport { near: NearHits::default(), ..cluster };
    let fewer = encode_cluster(&without, QuantisationSettings::default()).unwrap().bytes;
    assert_eq!(decode_cluster(&fewer).unwrap().near, NearHits::default());
    assert!(fewer.len() < bytes.len());
}

#[test]
fn near_hits_that_are_none_are_refused() {
    let refused = |change: fn(&mut NearHits)| {
        let mut cluster = narrow(8, 3);
        change(&mut cluster.near);
        encode_cluster(&cluster, QuantisationSettings::default()).unwrap_err().to_string()
    };
    assert!(refused(|near| near.count[0] += 1).contains("near hits of all receivers"));
    assert!(refused(|near| near.offset[1][2] = 2048).contains("offset of a near hit"));
    assert!(
        refused(|near| near.surface[0] = NearSurface::Texel { block: 2, texel: [0; 2] })
            .contains("block index")
    );
    let own = |near: &mut NearHits| near.surface[0] = NearSurface::Own { albedo: [1.0; 3], normal: [0.0; 3] };
    assert!(refused(own).contains("albedo"));
    assert!(refused(|near| near.weight[0] = 4.0).contains("weight of near hits"));
    assert!(refused(|near| near.reach_m = 0.0).contains("reach of near hits"));
}

#[test]
fn stored_places_around_a_near_hit_are_within_a_step_of_one_above_its_surface() {
    let (from_m, to_m, reach_m) = ([1.0, 2.0, 3.0], [1.1234, 1.8101, 3.0], 0.2);
    let step_m = 8.0 * reach_m / 2047.0;
    let raised = [to_m[0], to_m[1] + step_m, to_m[2]];
    let offsets = NearHits::offsets_around(from_m, to_m, reach_m);
    let distances_m = offsets.map(|offset| {
        let near = NearHits { reach_m, offset: vec![offset], ..NearHits::default() };
        let place_m = near.position_m(0, from_m, [0.0, 1.0, 0.0]);
        [0, 1, 2].map(|axis| (place_m[axis] - raised[axis]).abs())
    });
    let is_within =
        |steps: f32| move |distance_m: &[f32; 3]| distance_m.iter().all(|along_m| *along_m <= steps * step_m);
    assert!(distances_m.iter().all(is_within(1.001)), "{distances_m:?}");
    assert!(distances_m.iter().any(is_within(0.501)), "the nearest is one of them: {distances_m:?}");
    let different: BTreeSet<_> = offsets.into_iter().collect();
    assert_eq!(different.len(), 4, "one is at the hit along z");
    let beyond = NearHits::offsets_around(from_m, [9.0, 2.0, -9.0], 0.2);
    assert!(beyond.iter().all(|offset| *offset == [2040, 0, -2040]), "{beyond:?}");
}

#[test]
fn patches_come_back_exactly_and_by_key() {
    for leaves in [1, 2, 33] {
        let set = patches(leaves);
        let decoded = decode_patches(&encode_patches(&set).unwrap()).unwrap();
        let mut sorted = set.clone();
        sorted.patches.sort_by_key(|patch| patch.key);
        assert_eq!(decoded, sorted);
    }
    let mut twice = patches(2);
    twice.patches[1].key = twice.patches[0].key;
    assert!(matches!(encode_patches(&twice), Err(ChunkError::Order { what: "patch", .. })));
    let mut outside = patches(2);
    outside.patches[0].first_leaf = 2;
    assert!(matches!(encode_patches(&outside), Err(ChunkError::OutOfRange { .. })));
}

/// More blocks than 16 bits can name.
const MANY_BLOCKS: u32 = 70_000;

#[test]
fn patches_of_more_blocks_than_16_bits_name_come_back_exactly() {
    let mut set = patches(2 * MANY_BLOCKS);
    set.blocks = (0..u64::from(MANY_BLOCKS)).map(|block| 3 * block).collect();
    set.block = (0..set.texel.len() as u32).map(|receiver| receiver * 11 % MANY_BLOCKS).collect();
    // Cells of the helper's keys end at 2¹⁴.
    for (index, patch) in set.patches.iter_mut().enumerate().take(2 * MANY_BLOCKS as usize) {
        let [x, y] = [index as i32 % 10_000, index as i32 / 10_000];
        patch.key = PatchKey::of_cell(0, [x, y, 9], 2, 0);
    }
    set.patches.sort_by_key(|patch| patch.key);
    let decoded = decode_patches(&encode_patches(&set).unwrap()).unwrap();
    assert!(decoded == set, "something is lost");
    assert!(decoded.block.contains(&(MANY_BLOCKS - 1)));
}

/// Hits with the blocks that they name, whatever the order of blocks.
fn named(batch: &ProbeBatch) -> Vec<(RelightHit, Option<BlockKey>)> {
    let name = |hit: &RelightHit| match *hit {
        RelightHit::Receiver { block, texel } => {
            (RelightHit::Receiver { block: 0, texel }, Some(batch.blocks[usize::from(block)]))
        }
        other => (other, None),
    };
    batch.hits.iter().map(name).collect()
}

#[test]
fn batch_comes_back_exactly() {
    for rays in [1, 2, 4, 64] {
        let batch = batch(7, rays, 3);
        let decoded = decode_probe_batch(&encode_probe_batch(&batch).unwrap()).unwrap();
        assert_eq!((&decoded.probes, decoded.relight_rays), (&batch.probes, rays));
        assert_eq!(named(&decoded), named(&batch));
        assert!(!decoded.blocks.contains(&u64::MAX), "a block that no hit names is kept");
    }
}

#[test]
fn field_comes_back_exactly_but_for_its_factors_which_are_within_their_error() {
    for (probes, rank) in [(0, 0), (1, 1), (7, 9), (40, 64)] {
        let part = field(probes, rank, 5);
        let encoded = encode_field(&part, 0.01).unwrap();
        assert!(encoded.quantisation_error <= 0.01);
        let decoded = decode_field(&encoded.bytes).unwrap();
        assert_eq!((decoded.spacing_m, &decoded.probes), (part.spacing_m, &part.probes));
        assert!(decoded.depths == part.depths && decoded.emitters == part.emitters);
        let product = |part: &FieldPart, row: usize, key: u64| -> f32 {
            let TransportFactors { keys, rank, u, vt, .. } = &part.factors;
            let (rank, column) = (*rank as usize, keys.iter().position(|&other| other == key));
            let at = |i: usize| column.map_or(0.0, |column| u[row * rank + i] * vt[i * keys.len() + column]);
            (0..rank).map(at).sum()
        };
        let (mut errors, mut all) = (0.0, 0.0);
        for row in 0..PROBE_ROWS * probes {
            for &key in &part.factors.keys {
                let exact = product(&part, row, key);
                errors += (product(&decoded, row, key) - exact).powi(2);
                all += exact * exact;
            }
        }
        assert!(errors.sqrt() <= 0.0101 * all.sqrt(), "{errors} of {all}");
    }
}

#[test]
fn field_that_contradicts_itself_is_refused() {
    let refused = |change: fn(&mut FieldPart)| {
        let mut part = field(3, 2, 1);
        change(&mut part);
        encode_field(&part, 0.01).unwrap_err().to_string()
    };
    assert!(refused(|part| part.probes.swap(0, 1)).contains("probes in their order"));
    assert!(refused(|part| part.probes[1] = part.probes[0]).contains("does not ascend"));
    assert!(refused(|part| part.probes[2].moved[1] = 4).contains("steps moved"));
    assert!(refused(|part| part.probes[2].moved[1] = -4).contains("steps moved"));
    assert!(refused(|part| _ = part.depths.pop()).contains("depths"));
    assert!(refused(|part| part.spacing_m = 0.0).contains("spacing"));
    assert!(refused(|part| _ = part.factors.u.pop()).contains("entries of U"));
    assert!(refused(|part| part.emitters[0].irradiance.truncate(5)).contains("coefficients of an emitter"));
    assert!(refused(|part| part.emitters[0].irradiance[5][1] = f32::NAN).contains("coefficients"));
}

#[test]
fn tetrahedra_come_back_exactly_and_those_that_contradict_themselves_are_refused() {
    for probes in [0, 1, 5000] {
        let set = tetrahedra(probes);
        let bytes = encode_tetrahedra(&set).unwrap();
        println!("{} tetrahedra in {} bytes", set.vertices.len(), bytes.len());
        assert_eq!(decode_tetrahedra(&bytes).unwrap(), set);
    }
    let refused = |change: fn(&mut TetrahedronSet)| {
        let mut set = tetrahedra(5);
        change(&mut set);
        encode_tetrahedra(&set).unwrap_err().to_string()
    };
    assert!(refused(|set| set.vertices.swap(0, 1)).contains("does not ascend"));
    assert!(refused(|set| set.vertices[3].swap(1, 2)).contains("does not ascend"));
    assert!(refused(|set| set.vertices[9][3] = 13).contains("vertex"));
    assert!(refused(|set| set.box_m[1][2] = 2.0).contains("edges of the box"));
    assert!(refused(|set| set.box_m[0][1] = f32::NAN).contains("box"));
}

#[test]
fn voxels_come_back_exactly_whatever_is_in_them() {
    for (levels, seed) in [(0, 1), (1, 2), (3, 3), (5, 4)] {
        let part = voxels(levels, seed);
        let bytes = encode_voxels(&part).unwrap();
        let elements = part.elements();
        println!("{elements} elements without order in {} bytes", bytes.len());
        assert_eq!(decode_voxels(&bytes).unwrap(), part);
    }
    let far = VoxelPart { voxel_m: 1e-9, glows: Vec::new(), bricks: Vec::new() };
    assert_eq!(decode_voxels(&encode_voxels(&far).unwrap()).unwrap(), far);
}

#[test]
fn directory_comes_back_exactly_and_refuses_rows_that_do_not_fit_their_chunks() {
    for clusters in [0, 1, 300] {
        let (rows, chunks) = directory(clusters);
        let bytes = encode_directory(&rows, &chunks).unwrap();
        assert_eq!(decode_directory(&bytes).unwrap(), (rows, chunks));
        println!("{clusters} clusters in {} bytes", bytes.len());
    }
    let refused = |change: fn(&mut ClusterRow, &mut ChunkRef)| {
        let (mut rows, mut chunks) = directory(3);
        change(&mut rows[2], &mut chunks[2]);
        encode_directory(&rows, &chunks).unwrap_err()
    };
    let changes: [fn(&mut ClusterRow, &mut ChunkRef); 5] = [
        |_, chunk| chunk.bytes += 1,
        |row, _| row.checks.clear(),
        |row, _| row.layers.clear(),
        |row, _| row.layers[0].bytes = row.layers[1].bytes,
        |row, _| row.bounds_m[1][2] = f32::NAN,
    ];
    for change in changes {
        assert!(matches!(refused(change), ChunkError::OutOfRange { .. } | ChunkError::BadNumber { .. }));
    }
    let (rows, chunks) = directory(3);
    assert!(encode_directory(&rows, &chunks[1..]).is_err());
}

#[test]
fn geometry_comes_back() {
    let decoded = decode_geometry(&encode_geometry(&quads()).unwrap()).unwrap();
    assert_eq!(decoded, quads());
}

#[test]
fn texture_comes_back_exactly() {
    let file = [137, b'P', b'N', b'G', 0, 1, 2, 3];
    let decoded = decode_texture(&encode_texture("image/png", &file).unwrap()).unwrap();
    assert_eq!((decoded.media_type.as_str(), decoded.bytes.as_slice()), ("image/png", &file[..]));
    assert!(encode_texture("", &file).is_err() && encode_texture("a b", &file).is_err());
}

#[test]
fn albedos_are_a_palette_where_it_is_shorter_and_codes_elsewhere() {
    let with = |colours: usize| {
        let mut cluster = wall(16, 5, 0, 4, 1);
        let count = cluster.receivers.len();
        cluster.receivers.albedo =
            (0..count).map(|r| [0.1 + 0.7 * (r % colours) as f32 / 256.0, 0.3, 0.5]).collect();
        let decoded =
            decode_cluster(&encode_cluster(&cluster, QuantisationSettings::default()).unwrap().bytes);
        (decoded.unwrap().receivers.albedo, cluster.receivers.albedo)
    };
    for few in [1, 8, 42] {
        let (got, wanted) = with(few);
        assert_eq!(got, wanted, "{few} colours of 256 receivers");
    }
    let (got, wanted) = with(43);
    assert_ne!(got, wanted);
    let near = |(a, b): (&f32, &f32)| (a - b).abs() <= ALBEDO_ERROR;
    assert!(got.as_flattened().iter().zip(wanted.as_flattened()).all(near));
}
