//! Light of the fixture that comes piece by piece.

use lightkiln_proto::kinds::prt as prt_kind;
use lightkiln_proto::manifest::OVERVIEW;

use super::*;
use crate::bake::LoadedBake;
use crate::fixture::write_bundle;
use crate::kinds;
use crate::preview::{Backend, StreamedBake, View, render};
use crate::tests::fixture_view;

/// The fixture's bundle, a quarter of whose receivers are in the overview.
fn streamed(folder: &std::path::Path) -> (Source, StreamedBake) {
    write_bundle(folder, prt_kind::NAME);
    let source = Source::bundle(folder).unwrap();
    let streamed = StreamedBake::begin(&source, &kinds::all(), Budget::NONE).unwrap();
    (source, streamed)
}

fn picture(bake: &LoadedBake, view: &View) -> Vec<[f32; 3]> {
    render(bake, view, Backend::Cpu).unwrap().linear
}

fn mean(picture: &[[f32; 3]]) -> Vec3 {
    picture.iter().map(|pixel| Vec3::from(*pixel)).sum::<Vec3>() / picture.len() as f32
}

#[test]
fn light_of_all_pieces_is_that_of_the_whole_bit_for_bit_and_the_overview_is_near_it() {
    let folder = tempfile::tempdir().unwrap();
    let (source, mut streamed) = streamed(folder.path());
    let (_, view) = fixture_view();
    let whole = picture(&LoadedBake::load(&source, &kinds::all()).unwrap(), &view);
    let first = picture(&streamed.bake, &view);
    assert_ne!(first, whole);
    let ratio = mean(&first) / mean(&whole);
    // A room of some hundred receivers, every fourth of which is there.
    assert!((ratio - 1.0).abs().max_element() < 0.1, "{ratio}");
    streamed.refine(&view, Budget::NONE).unwrap();
    let all = streamed.streamed();
    assert_eq!((all.bytes, all.clusters), (all.bytes_all, all.clusters_all));
    assert_eq!(picture(&streamed.bake, &view), whole);
}

#[test]
fn layers_that_came_one_by_one_make_the_light_of_the_whole_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let (source, mut streamed) = streamed(folder.path());
    let (_, view) = fixture_view();
    let whole = picture(&LoadedBake::load(&source, &kinds::all()).unwrap(), &view);
    let Streamed { bytes, bytes_all, .. } = streamed.streamed();
    let (mut in_part, mut step) = (0, (bytes_all - bytes) / 5);
    while !streamed.streamed().is_whole() {
        let before = streamed.streamed();
        streamed.refine(&view, Budget { step, ..Budget::NONE }).unwrap();
        let after = streamed.streamed();
        assert!(after.bytes - before.bytes <= step);
        step += if after == before { step } else { 0 };
        in_part = in_part.max(after.clusters - after.whole);
        let energy = mean(&picture(&streamed.bake, &view)) / mean(&whole);
        // The fixture's ranks do not fall: those that are cut off weigh as much as others.
        assert!((energy - 1.0).abs().max_element() < 0.5, "{energy} after {after:?}");
    }
    assert!(in_part > 1, "clusters came by layers");
    assert_eq!(streamed.streamed().bytes, streamed.streamed().bytes_all);
    assert_eq!(picture(&streamed.bake, &view), whole);
}

#[test]
fn clusters_that_memory_has_no_room_for_go_back_to_fewer_layers_and_come_again() {
    let folder = tempfile::tempdir().unwrap();
    let (source, mut streamed) = streamed(folder.path());
    let (_, view) = fixture_view();
    let whole = picture(&LoadedBake::load(&source, &kinds::all()).unwrap(), &view);
    let least = streamed.streamed().memory;
    streamed.refine(&view, Budget::NONE).unwrap();
    let all = streamed.streamed();
    let memory = least + (all.memory - least) / 2;
    streamed.refine(&view, Budget { memory, ..Budget::NONE }).unwrap();
    let part = streamed.streamed();
    assert!(part.memory <= memory && part.memory > least && part.bytes < all.bytes, "{part:?}");
    assert_ne!(picture(&streamed.bake, &view), whole);
    streamed.refine(&view, Budget { memory, ..Budget::NONE }).unwrap();
    assert_eq!(streamed.streamed(), part, "the same view lets nothing go");
    streamed.refine(&view, Budget::NONE).unwrap();
    assert!(streamed.streamed().is_whole());
    assert_eq!(picture(&streamed.bake, &view), whole);
    let less: Vec<u64> =
        std::iter::successors(Some(u64::MAX), |memory| streamed.less_memory(*memory)).skip(1).collect();
    assert!(less[0] < all.memory && less.windows(2).all(|pair| pair[1] < pair[0]), "{less:?}");
    assert_eq!((less.last(), less.len() > 4), (Some(&least), true), "{less:?}");
    let too_few = Budget { memory: least - 1, ..Budget::NONE };
    let error = StreamedBake::begin(&source, &kinds::all(), too_few).err().unwrap().to_string();
    assert!(error.contains(&least.to_string()), "{error}");
}

#[test]
fn as_many_clusters_go_as_room_is_needed_for_and_those_that_came_for_the_view_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let (source, streamed) = streamed(folder.path());
    let scene = &streamed.bake.scene;
    let manifest = &scene.manifest;
    let mut stream = PrtStream::begin(&source, &scene.manifest).unwrap();
    for (index, chunk) in manifest.chunks(CLUSTERS).iter().enumerate() {
        stream.clusters.insert(index, source.chunk(chunk).unwrap());
    }
    stream.count(manifest);
    let all = stream.streamed;
    let evict = [(2, 0), (4, 0)];
    let of_memory = |memory| Budget { memory, ..Budget::NONE };
    // As where a server was lost before anything came.
    assert!(!stream.make_room(manifest, &evict, of_memory(all.memory)));
    assert_eq!(stream.streamed, all);
    assert!(stream.make_room(manifest, &evict, of_memory(all.memory - 1)));
    assert_eq!(stream.clusters.keys().copied().collect::<Vec<usize>>(), [0, 1, 3, 4, 5, 6]);
    assert_eq!(stream.streamed.bytes, all.bytes - manifest.chunks(CLUSTERS)[2].bytes);
    stream.fresh.insert(1);
    let kept = |stream: &PrtStream, index: usize| stream.candidate(layers_of(manifest, index)).kept;
    assert_eq!([0, 1].map(|index| kept(&stream, index)), [0, layers_of(manifest, 1).count()]);
    stream.change_view();
    assert_eq!(kept(&stream, 1), 0);
}

#[test]
fn clusters_come_as_far_as_the_bytes_go() {
    let folder = tempfile::tempdir().unwrap();
    let (source, mut streamed) = streamed(folder.path());
    let (_, view) = fixture_view();
    let before = streamed.streamed();
    assert_eq!((before.clusters, before.clusters_all), (0, 7));
    let error = StreamedBake::begin(&source, &kinds::all(), Budget::of_bytes(before.bytes - 1))
        .err()
        .unwrap()
        .to_string();
    assert!(error.contains(&before.bytes.to_string()), "{error}");
    streamed.refine(&view, Budget::of_bytes(before.bytes)).unwrap();
    assert_eq!(streamed.streamed(), before);
    let half = (before.bytes + before.bytes_all) / 2;
    streamed.refine(&view, Budget::of_bytes(half)).unwrap();
    let after = streamed.streamed();
    assert!(after.clusters > 0 && after.whole < 7 && after.bytes <= half, "{after:?}");
    assert!(mean(&picture(&streamed.bake, &view)).is_finite());
}

#[test]
fn bakes_without_an_overview_say_so_before_anything_is_fetched() {
    for kind in ["sh", "prt"] {
        let folder = tempfile::tempdir().unwrap();
        write_bundle(folder.path(), kind);
        let path = folder.path().join(crate::fetch::MANIFEST_FILE);
        let mut manifest: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        manifest["chunks"].as_object_mut().unwrap().remove(OVERVIEW);
        std::fs::write(&path, manifest.to_string()).unwrap();
        let source = Source::bundle(folder.path()).unwrap();
        let problem = StreamedBake::begin(&source, &kinds::all(), Budget::NONE).err().unwrap().to_string();
        assert!(problem.contains(kind) && problem.contains("no overview"), "{problem}");
    }
}
