//! Layers over a line and from a disk: by ranges, taken up again, verified; what is wrong is refused by name.

use std::fs;

use lightkiln_http::{CallError, DiskCache};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::kinds::prt;
use lightkiln_proto::manifest::{CLUSTERS, ClusterRow, Layer, Manifest, PrefixCheck};

use super::*;
use crate::bake::LoadedBake;
use crate::fixture::{BundleServer, Faults, rewrite_manifest, write_bundle};
use crate::kinds;
use crate::preview::{Backend, StreamedBake, View, render};
use crate::stream::{Budget, Streamed};
use crate::tests::fixture_view;

/// A bundle of the fixture in a folder of its own.
fn bundle() -> (tempfile::TempDir, Manifest) {
    let folder = tempfile::tempdir().unwrap();
    let manifest = write_bundle(folder.path(), prt::NAME);
    (folder, manifest)
}

/// A cluster of several layers.
fn layered(manifest: &Manifest) -> Layers<'_> {
    let of = |cluster: usize| Layers {
        cluster,
        row: &manifest.clusters[cluster],
        chunk: &manifest.chunks(CLUSTERS)[cluster],
    };
    (0..manifest.clusters.len()).map(of).find(|of| of.count() > 2).expect("a cluster of three layers")
}

impl Source {
    /// The layers that were wanted, or the error that came before them.
    fn all_layers(&self, of: Layers<'_>, wanted: usize, have: &[u8]) -> Result<Vec<u8>> {
        let Came { bytes, lost } = self.layers(of, wanted, have)?;
        lost.map_or(Ok(bytes), Err)
    }
}

#[test]
fn each_layer_fetches_what_the_ones_before_it_lack_and_no_byte_twice() {
    let (folder, manifest) = bundle();
    let of = layered(&manifest);
    let (server, disk) =
        (BundleServer::start(folder.path(), Faults::default()), Source::bundle(folder.path()).unwrap());
    let source = server.source();
    let mut bytes = Vec::new();
    for layers in 1..=of.count() {
        bytes = source.all_layers(of, layers, &bytes).unwrap();
        assert_eq!(bytes.len() as u64, of.bytes_of(layers));
        assert_eq!(bytes, disk.all_layers(of, layers, &[]).unwrap());
        let (cluster, decoded) = decoded_layers(of, &bytes).unwrap();
        assert_eq!(decoded, layers);
        assert!(layers < of.count() || cluster.receivers.len() == of.row.receivers as usize);
    }
    let asked = server.take_asked();
    assert_eq!(asked.iter().map(|asked| asked.sent as u64).sum::<u64>(), of.chunk.bytes);
    let ends: Vec<usize> = (0..=of.count()).map(|layers| of.bytes_of(layers) as usize).collect();
    let ranges: Vec<_> = asked.iter().map(|asked| asked.range.unwrap()).collect();
    let wanted: Vec<[usize; 2]> = ends.windows(2).map(|pair| [pair[0], pair[1]]).collect();
    assert_eq!(ranges, wanted);
    // Several layers at once are one request, and all of them none with a range.
    assert_eq!(source.all_layers(of, 2, &[]).unwrap().len() as u64, of.bytes_of(2));
    assert_eq!(source.all_layers(of, of.count(), &[]).unwrap(), bytes);
    assert_eq!(
        server.take_asked().iter().map(|asked| asked.range).collect::<Vec<_>>(),
        [Some([0, ends[2]]), None]
    );
}

#[test]
fn connections_that_break_amid_a_layer_go_on_where_they_were() {
    let (folder, manifest) = bundle();
    let of = layered(&manifest);
    let server = BundleServer::start(folder.path(), Faults { breaks_after: Some(700), ..Faults::default() });
    let source = server.source();
    let first = source.all_layers(of, 1, &[]).unwrap();
    let all = source.all_layers(of, of.count(), &first).unwrap();
    assert_eq!(Digest::of(&all), of.chunk.digest);
    let asked = server.take_asked();
    assert!(asked.len() as u64 >= of.chunk.bytes / 700, "{asked:?}");
    assert_eq!(asked.iter().map(|asked| asked.sent as u64).sum::<u64>(), of.chunk.bytes);
    assert_eq!(source.chunk(of.chunk).unwrap(), all);
    assert_eq!(server.take_asked().iter().map(|asked| asked.sent as u64).sum::<u64>(), of.chunk.bytes);
    // However often: each of them brought something.
    let breaks_after = Some((of.chunk.bytes as usize / 100).max(1));
    server.set(Faults { breaks_after, ..Faults::default() });
    assert_eq!(source.all_layers(of, of.count(), &[]).unwrap(), all);
    assert!(server.take_asked().len() >= 100);
}

#[test]
fn layers_before_those_that_a_lost_server_owes_are_kept_with_the_error() {
    let (folder, manifest) = bundle();
    let of = layered(&manifest);
    let server = BundleServer::start(folder.path(), Faults::default());
    let source = server.source();
    let whole = source.all_layers(of, of.count(), &[]).unwrap();
    let part = &whole[..of.bytes_of(1) as usize];
    // A server that begins anew each time gives the same first bytes again: no try brings more than the one before.
    let breaks = |breaks_after: u64| {
        let breaks_after = Some(breaks_after as usize);
        server.set(Faults { ignores_ranges: true, breaks_after, ..Faults::default() });
    };
    breaks(of.bytes_of(1) + 1);
    let Came { bytes, lost } = source.layers(of, of.count(), &[]).unwrap();
    assert_eq!(bytes, part);
    assert!(matches!(lost, Some(ClientError::Call(CallError::Network { .. }))), "{lost:?}");
    assert!(source.all_layers(of, of.count(), &[]).is_err());
    // Nothing comes after the layer that is there.
    assert!(source.layers(of, of.count(), part).is_err());
    breaks(of.bytes_of(1) - 1);
    assert!(source.layers(of, of.count(), &[]).is_err());
}

#[test]
fn server_that_ignores_ranges_gives_all_layers_at_once() {
    let (folder, manifest) = bundle();
    let of = layered(&manifest);
    let server = BundleServer::start(folder.path(), Faults { ignores_ranges: true, ..Faults::default() });
    let source = server.source();
    let all = source.all_layers(of, 1, &[]).unwrap();
    assert_eq!(Digest::of(&all), of.chunk.digest);
    assert_eq!(decoded_layers(of, &all).unwrap().1, of.count());
    assert_eq!(server.take_asked().len(), 1);
    // Each try gives the same first bytes: too few for a layer, or enough.
    for (breaks_after, is_enough) in [(of.bytes_of(1) - 1, false), (of.bytes_of(1) + 1, true)] {
        let breaks_after = Some(breaks_after as usize);
        server.set(Faults { ignores_ranges: true, breaks_after, ..Faults::default() });
        let first = source.all_layers(of, 1, &[]);
        assert_eq!(first.is_ok(), is_enough, "{first:?}");
        assert!(first.is_err() || first.unwrap() == all[..of.bytes_of(1) as usize]);
    }
}

#[test]
fn layers_that_were_not_chosen_are_cut_so_that_caches_and_servers_change_no_picture() {
    let (folder, _) = bundle();
    let (_, view) = fixture_view();
    let kept = tempfile::tempdir().unwrap();
    let server = BundleServer::start(folder.path(), Faults::default());
    let warm = server.source().with_cache(DiskCache::open(kept.path(), 1 << 28).unwrap());
    LoadedBake::load(&warm, &kinds::all()).unwrap();
    let ignores =
        BundleServer::start(folder.path(), Faults { ignores_ranges: true, ..Faults::default() }).source();
    let begin = |source: &Source| StreamedBake::begin(source, &kinds::all(), Budget::NONE).unwrap();
    let mut streams = [begin(&server.source()), begin(&warm), begin(&ignores)];
    let Streamed { bytes, bytes_all, .. } = streams[0].streamed();
    let (mut in_part, mut step) = (0, (bytes_all - bytes) / 5);
    while !streams[0].streamed().is_whole() {
        let before = streams[0].streamed();
        for streamed in &mut streams {
            streamed.refine(&view, Budget { step, ..Budget::NONE }).unwrap();
        }
        let after = streams.each_ref().map(StreamedBake::streamed);
        assert!(after[0].bytes - before.bytes <= step);
        assert_eq!(after, [after[0]; 3]);
        step += if after[0] == before { step } else { 0 };
        if after[0].clusters > after[0].whole {
            in_part += 1;
            let light = |of: &StreamedBake| render(&of.bake, &view, Backend::Cpu).unwrap().linear;
            let [cold, warm, ignores] = streams.each_ref().map(light);
            assert!(cold == warm && cold == ignores, "{:?}", after[0]);
        }
    }
    assert!(in_part > 0, "clusters came by layers");
}

#[test]
fn layers_that_end_early_are_damaged_or_of_another_place_are_refused() {
    let (folder, manifest) = bundle();
    let of = layered(&manifest);
    let server = BundleServer::start(folder.path(), Faults::default());
    let source = server.source();
    let first = source.all_layers(of, 1, &[]).unwrap();
    let refused = |faults: Faults, layers: usize| {
        server.set(faults);
        source.all_layers(of, layers, &first).unwrap_err()
    };
    let ends = Faults { ends_after: Some(5), ..Faults::default() };
    let damages = Faults { damages: true, ..Faults::default() };
    for faults in [ends, damages] {
        let error = refused(faults, 2);
        assert!(matches!(error, ClientError::WrongPrefix { .. }), "{error}");
        assert!(error.to_string().contains(&of.chunk.digest.to_string()), "{error}");
    }
    assert!(matches!(refused(damages, of.count()), ClientError::WrongDigest { .. }));
    let shifted = refused(Faults { shifts: true, ..Faults::default() }, 2);
    assert!(matches!(shifted, ClientError::Call(CallError::WrongPart { .. })), "{shifted}");
    // The layer that was there is as good as before.
    server.set(Faults::default());
    assert_eq!(Digest::of(&source.all_layers(of, of.count(), &first).unwrap()), of.chunk.digest);
}

#[test]
fn bundles_on_disk_are_read_as_far_as_a_layer_goes() {
    let (folder, manifest) = bundle();
    let of = layered(&manifest);
    let path = chunk_path(folder.path(), of.chunk.digest);
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..of.bytes_of(1) as usize + 1]).unwrap();
    let source = Source::bundle(folder.path()).unwrap();
    let first = source.all_layers(of, 1, &[]).unwrap();
    assert_eq!(first, bytes[..of.bytes_of(1) as usize]);
    assert!(matches!(source.all_layers(of, 2, &first), Err(ClientError::WrongPrefix { .. })));
    assert!(matches!(source.all_layers(of, of.count(), &first), Err(ClientError::WrongPrefix { .. })));
}

#[test]
fn layers_of_a_server_are_kept_on_disk_and_taken_from_there_where_they_are_whole() {
    let (folder, manifest) = bundle();
    let of = layered(&manifest);
    let kept = tempfile::tempdir().unwrap();
    let server = BundleServer::start(folder.path(), Faults::default());
    let open = || server.source().with_cache(DiskCache::open(kept.path(), 1 << 20).unwrap());
    let first = open().all_layers(of, 1, &[]).unwrap();
    assert_eq!(server.take_asked().len(), 1);
    assert_eq!(open().all_layers(of, 1, &[]).unwrap(), first);
    assert_eq!(server.take_asked(), []);
    // The next layer is fetched alone.
    open().all_layers(of, 2, &[]).unwrap();
    assert_eq!(server.take_asked()[0].range, Some([1, 2].map(|layers| of.bytes_of(layers) as usize)));
    let name = of.chunk.digest.to_string();
    let file = kept.path().join(&name[..2]).join(format!("{name}.prefix"));
    let mut damaged = fs::read(&file).unwrap();
    damaged[40] ^= 1;
    fs::write(&file, damaged).unwrap();
    assert_eq!(open().all_layers(of, 1, &[]).unwrap(), first);
    assert_eq!(server.take_asked().len(), 1, "a damaged file is fetched again");
    let all = open().all_layers(of, of.count(), &[]).unwrap();
    server.take_asked();
    assert_eq!(open().all_layers(of, 1, &[]).unwrap(), all, "all of it is at hand");
    assert_eq!((server.take_asked(), file.exists()), (Vec::new(), false));
}

/// The manifest with the layers of its clusters as `change` makes them, and the chunks' own checks.
fn lying(manifest: &Manifest, folder: &Path, change: impl Fn(&mut Vec<Layer>)) -> Manifest {
    let mut manifest = manifest.clone();
    let chunks = manifest.chunks(CLUSTERS).to_vec();
    for (row, chunk) in manifest.clusters.iter_mut().zip(chunks) {
        change(&mut row.layers);
        let bytes = fs::read(chunk_path(folder, chunk.digest)).unwrap();
        row.checks = PrefixCheck::of_prefixes(&bytes, &row.layers);
    }
    rewrite_manifest(folder, manifest)
}

#[test]
fn directory_whose_layers_are_not_the_chunks_is_named_before_any_light_is_made_of_it() {
    let (folder, manifest) = bundle();
    let source = Source::bundle(folder.path()).unwrap();
    let (_, view) = fixture_view();
    type Lie<'a> = &'a dyn Fn(&mut Vec<Layer>);
    let lies: [Lie<'_>; 3] = [&|layers| layers[0].bytes -= 1, &|layers| layers[0].rank += 1, &|layers| {
        drop(layers.drain(..layers.len() - 1))
    }];
    for (number, lie) in lies.into_iter().enumerate() {
        lying(&manifest, folder.path(), lie);
        let mut streamed = StreamedBake::begin(&source, &kinds::all(), Budget::NONE).unwrap();
        let before = streamed.streamed();
        let error =
            streamed.refine(&view, Budget { step: before.bytes_all / 2, ..Budget::NONE }).unwrap_err();
        let told = error.to_string();
        let of_prefix = matches!(&error, ClientError::Chunk { .. });
        assert!(of_prefix || told.contains("its directory lists layers"), "lie {number}: {told}");
        assert_eq!(streamed.streamed(), before, "nothing of it is kept");
    }
}

#[test]
fn chunk_of_another_version_says_which() {
    let (folder, mut manifest) = bundle();
    let mut chunks = manifest.chunks(CLUSTERS).to_vec();
    for (row, chunk) in manifest.clusters.iter_mut().zip(&mut chunks) {
        let mut bytes = fs::read(chunk_path(folder.path(), chunk.digest)).unwrap();
        bytes[4] = 99;
        chunk.digest = Digest::of(&bytes);
        row.checks = PrefixCheck::of_prefixes(&bytes, &row.layers);
        fs::write(chunk_path(folder.path(), chunk.digest), bytes).unwrap();
    }
    manifest.chunks.insert(CLUSTERS.to_owned(), chunks);
    rewrite_manifest(folder.path(), manifest);
    let source = Source::bundle(folder.path()).unwrap();
    let mut streamed = StreamedBake::begin(&source, &kinds::all(), Budget::NONE).unwrap();
    let error = streamed.refine(&fixture_view().1, Budget::NONE).unwrap_err();
    let why = std::error::Error::source(&error).unwrap().to_string();
    assert!(matches!(error, ClientError::Chunk { .. }) && why.contains("99"), "{error}: {why}");
}

#[test]
fn server_lost_amid_a_stream_leaves_the_light_that_came() {
    let (folder, _) = bundle();
    let server = BundleServer::start(folder.path(), Faults::default());
    let source = server.source();
    let (_, view) = fixture_view();
    let mut streamed = StreamedBake::begin(&source, &kinds::all(), Budget::NONE).unwrap();
    let before = streamed.streamed();
    server.take_asked();
    server.set(Faults { lost_after: Some(3), ..Faults::default() });
    let error = streamed.refine(&view, Budget::NONE).unwrap_err();
    assert!(matches!(error, ClientError::Call(CallError::Network { .. })), "{error}");
    let after = streamed.streamed();
    assert!(after.clusters >= 1 && after.clusters <= 3 && after.bytes > before.bytes, "{after:?}");
    let light = |bake: &LoadedBake, view: &View| render(bake, view, Backend::Cpu).unwrap().linear;
    assert!(light(&streamed.bake, &view).iter().flatten().all(|radiance| radiance.is_finite()));
    // The server is back: what came is not fetched again, and the end is that of a load at once.
    server.set(Faults::default());
    let had: Vec<String> = server.take_asked().into_iter().map(|asked| asked.file).collect();
    streamed.refine(&view, Budget::NONE).unwrap();
    assert!(server.take_asked().iter().all(|asked| !had.contains(&asked.file)));
    let whole = LoadedBake::load(&source, &kinds::all()).unwrap();
    assert_eq!(light(&streamed.bake, &view), light(&whole, &view));
}

#[test]
fn directory_of_ten_thousand_clusters_of_one_place_is_refused_and_one_of_none_is_dark() {
    let (folder, manifest) = bundle();
    let source = Source::bundle(folder.path()).unwrap();
    let (_, view) = fixture_view();
    let of = |count: usize| {
        let mut many = manifest.clone();
        let chunks = manifest.chunks(CLUSTERS);
        // Pages that are alike are refused for that alone.
        let row = |index: usize| ClusterRow {
            truncation_error: index as f32,
            ..manifest.clusters[index % 7].clone()
        };
        many.clusters = (0..count).map(row).collect();
        many.chunks.insert(CLUSTERS.to_owned(), (0..count).map(|index| chunks[index % 7].clone()).collect());
        many.body["totals"]["clusters"] = serde_json::json!(count);
        rewrite_manifest(folder.path(), many)
    };
    let many = of(10_000);
    assert_eq!((many.clusters.len(), many.directory.len()), (10_000, 40));
    let mut streamed = StreamedBake::begin(&source, &kinds::all(), Budget::NONE).unwrap();
    assert_eq!(streamed.streamed().clusters_all, 10_000);
    let step = 20 * many.chunks(CLUSTERS).iter().map(|chunk| chunk.bytes).max().unwrap();
    let error = streamed.refine(&view, Budget { step, ..Budget::NONE }).unwrap_err().to_string();
    assert!(error.contains("inconsistent") && error.contains("another receiver"), "{error}");
    of(0);
    let mut none = StreamedBake::begin(&source, &kinds::all(), Budget::NONE).unwrap();
    assert!(none.streamed().is_whole());
    none.refine(&view, Budget::NONE).unwrap();
    let drawn = render(&LoadedBake::load(&source, &kinds::all()).unwrap(), &view, Backend::Cpu).unwrap();
    assert_eq!(render(&none.bake, &view, Backend::Cpu).unwrap().linear, drawn.linear);
}
