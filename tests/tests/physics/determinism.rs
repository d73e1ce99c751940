//! Same inputs, same settings: the same bytes.

use lightkiln_proto::manifest::{CLUSTERS, PrefixCheck, with_chunks};
use lightkiln_tests::harness::{LocalBake, bake};
use lightkiln_tests::scenes;

use super::setup::{in_both_kinds, small};

in_both_kinds!(bake_has_the_same_bytes_on_one_and_on_four_threads);

fn bake_has_the_same_bytes_on_one_and_on_four_threads(kind: &'static str) {
    let on = |threads: usize| -> LocalBake {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| bake(scenes::two_rooms(0.02), &small(kind, 1000)).unwrap())
    };
    let (one, four) = (on(1), on(4));
    assert_eq!(one.manifest_bytes, four.manifest_bytes);
    assert!(one.manifest.chunks(CLUSTERS).len() > 2);
    for (row, chunk) in with_chunks(&one.manifest) {
        let bytes = one.chunk(chunk.digest).unwrap();
        let checks = row.layers.iter().map(|layer| PrefixCheck::of(&bytes[..layer.bytes as usize]));
        assert!(row.checks.iter().copied().eq(checks.take(row.layers.len() - 1)), "{row:?}");
    }
    assert!(one.manifest.clusters.iter().any(|row| !row.checks.is_empty()), "no cluster has a prefix");
}
