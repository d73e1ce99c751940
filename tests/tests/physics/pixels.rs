//! Faults that are put into a bake on purpose are found at its pixels: a black texel, texels that are not linked, jumps of a
//! mesh and of a cluster.

use std::collections::BTreeMap;

use glam::Vec3;
use lightkiln_proto::chunk::{QuantisationSettings, decode_cluster, encode_cluster};
use lightkiln_proto::content::{BlockKey, ClusterTransport};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::manifest::CLUSTERS;
use lightkiln_tests::harness::{LocalBake, bake};
use lightkiln_tests::scenes;
use lightkiln_worker::evaluate::{EvaluationError, Evaluator, Options, PixelResult, TestLight};
use lightkiln_worker::kinds::BakeKinds;
use lightkiln_worker::reference::Precision;
use lightkiln_worker::task::Progress;

use super::setup::{lamp_at, with_texels};

const TEXEL_M: f32 = 0.25;
const TILES: u32 = 3;

/// A room with a floor of nine meshes, lit by a lamp; every second one may be turned.
fn room(texel_m: f32, turned: bool) -> LocalBake {
    bake(scenes::tiled_floor(TILES, turned), &with_texels("prt", texel_m, 256)).unwrap()
}

/// The bake at its pixels, each cluster changed by its index.
fn measured(bake: &LocalBake, pixels: u32, change: impl Fn(usize, &mut ClusterTransport)) -> PixelResult {
    let chunks = bake.manifest.chunks(CLUSTERS).iter().enumerate();
    let quantisation = QuantisationSettings { relative_error: 1e-3, ..QuantisationSettings::default() };
    let changed: BTreeMap<Digest, Vec<u8>> = chunks
        .map(|(index, chunk)| {
            let mut cluster = decode_cluster(&bake.chunk(chunk.digest).unwrap()).unwrap();
            change(index, &mut cluster);
            (chunk.digest, encode_cluster(&cluster, quantisation).unwrap().bytes)
        })
        .collect();
    let bytes = |digest| {
        let own = || bake.chunk(digest);
        changed
            .get(&digest)
            .cloned()
            .map_or_else(own, Ok)
            .map_err(|error| EvaluationError::Missing { digest, source: error.into() })
    };
    let (kinds, progress) = (BakeKinds::new(), Progress::new());
    let scene = bake.artefacts[&bake.scene].as_ref().clone();
    let evaluated = kinds.evaluated(&bake.manifest, scene, &bytes, &progress).unwrap();
    let precision = Precision { rel_error: 0.05, ..Precision::default() };
    let options = Options { receivers: pixels, precision, cells: 1, pixels, ..Options::default() };
    let lighting = lamp_at(Vec3::new(-0.8, 1.6, 0.6));
    let light = TestLight { name: "lamp".into(), words: String::new(), lighting };
    let evaluator = Evaluator::new(evaluated, std::slice::from_ref(&light), options, &progress).unwrap();
    evaluator.measure(&light, &progress).unwrap().pixels.unwrap()
}

/// Scales the light of the receivers of a cluster that `chosen` takes by their blocks and positions.
fn scale(cluster: &mut ClusterTransport, factor: f32, chosen: impl Fn(BlockKey, Vec3) -> bool) {
    let (receivers, rank) = (&cluster.receivers, cluster.factors.rank as usize);
    for (row, position_m) in receivers.position_m.iter().enumerate() {
        if !chosen(receivers.blocks[usize::from(receivers.block[row])], Vec3::from(*position_m)) {
            continue;
        }
        cluster.factors.u[row * rank..(row + 1) * rank].iter_mut().for_each(|u| *u *= factor);
        cluster.near.weight.get_mut(row).into_iter().for_each(|weight| *weight *= factor);
    }
}

/// A point of the middle tile's floor.
fn is_on_middle_tile(p: Vec3) -> bool {
    p.y.abs() < 0.01 && p.x.abs().max(p.z.abs()) < 2.0 / TILES as f32
}

#[test]
fn texel_made_black_is_hunted_down() {
    let bake = room(TEXEL_M, false);
    let clusters = bake.manifest.chunks(CLUSTERS).iter();
    let receivers = clusters
        .flat_map(|chunk| decode_cluster(&bake.chunk(chunk.digest).unwrap()).unwrap().receivers.position_m);
    let middle = receivers
        .map(Vec3::from)
        .min_by(|a, b| a.length().total_cmp(&b.length()))
        .filter(|position_m| is_on_middle_tile(*position_m))
        .unwrap();
    let black = |_: usize, cluster: &mut ClusterTransport| scale(cluster, 0.0, |_, at| at == middle);
    let is_found = |result: &PixelResult| {
        result
            .hunt
            .as_ref()
            .unwrap()
            .worst
            .iter()
            .any(|outlier| Vec3::from(outlier.position_m).distance(middle) < 0.1 * TEXEL_M)
    };
    let (whole, spoiled) = (measured(&bake, 100, |_, _| {}), measured(&bake, 100, black));
    assert!(whole.hunt.as_ref().unwrap().texels > 500 && !is_found(&whole), "{:?}", whole.hunt);
    assert!(is_found(&spoiled), "{:?}", spoiled.hunt);
    let [before, after] = [&whole, &spoiled].map(|result| result.hunt.as_ref().unwrap().outliers);
    assert!(after > before, "{before} and {after}");
    let worst = &spoiled.hunt.as_ref().unwrap().worst[0];
    assert!(worst.light < 0.1 * worst.around && worst.reference > 0.5 * worst.reference_around, "{worst:?}");
    assert!(worst.block.contains("tile"), "{worst:?}");
}

#[test]
fn texels_without_links_bring_an_error_of_interpolation() {
    let bake = room(2.0 * TEXEL_M, false);
    let unlinked =
        |_: usize, cluster: &mut ClusterTransport| cluster.receivers.links.iter_mut().for_each(|l| *l = 0);
    let [linked, unlinked] =
        [measured(&bake, 600, |_, _| {}), measured(&bake, 600, unlinked)].map(|result| result.shown);
    // The same pixels, the same paths: the difference is of the taps alone.
    let square = |root: f64| root * root.abs();
    let [before, after] = [&linked, &unlinked].map(|shown| square(shown.interpolation.unwrap().rel_rmse));
    assert!(after - before > square(0.02), "{:?} and {:?}", linked.interpolation, unlinked.interpolation);
    assert!(unlinked.figures.rel_rmse > linked.figures.rel_rmse);
}

#[test]
fn mesh_and_cluster_that_are_too_bright_show_as_seams() {
    let bake = room(TEXEL_M, false);
    // Its neighbours have receivers with its light.
    let blocks = &bake.manifest.layout().unwrap().blocks;
    let middle = blocks.iter().find(|block| block.name.contains("tile 1 1")).unwrap().key;
    let brighter_tile =
        |_: usize, cluster: &mut ClusterTransport| scale(cluster, 1.5, |block, _| block == middle);
    let brighter_cluster = |index: usize, cluster: &mut ClusterTransport| {
        if index == 0 {
            scale(cluster, 1.5, |_, _| true);
        }
    };
    let [whole, tile, cluster] = [
        measured(&bake, 20, |_, _| {}),
        measured(&bake, 20, brighter_tile),
        measured(&bake, 20, brighter_cluster),
    ]
    .map(|result| result.seams.unwrap());
    assert!(whole.blocks.pairs > 100 && whole.clusters.pairs > 50, "{whole:?}");
    assert!(whole.blocks.p95 < 0.15, "{whole:?}");
    // Four of the twelve edges between tiles are its own.
    assert!(tile.blocks.mean > whole.blocks.mean + 0.08 && tile.blocks.p95 > 0.3, "{whole:?} and {tile:?}");
    // Tiles are wider than texels.
    assert!(
        whole.wide.pairs > 50 && whole.wide.pairs <= whole.blocks.pairs + whole.charts.pairs,
        "{whole:?}"
    );
    assert!(tile.wide.mean > whole.wide.mean + 0.08, "{whole:?} and {tile:?}");
    let narrow = measured(&room(1.0, false), 20, |_, _| {}).seams.unwrap();
    assert!(narrow.blocks.pairs > 50 && 10 * narrow.wide.pairs < narrow.blocks.pairs, "{narrow:?}");
    assert!(cluster.clusters.mean > whole.clusters.mean + 0.02, "{whole:?} and {cluster:?}");
    assert!((cluster.inside.mean - whole.inside.mean).abs() < 0.02, "{whole:?} and {cluster:?}");
}

#[test]
fn light_goes_on_evenly_across_meshes_whichever_way_they_are_wound() {
    for turned in [false, true] {
        let seams = measured(&room(TEXEL_M, turned), 20, |_, _| {}).seams.unwrap();
        assert!(seams.blocks.pairs > 100 && seams.blocks.mean < 0.002, "turned: {turned}: {seams:?}");
    }
}
