//! Same inputs, same settings: the same bytes.

use lightkiln_proto::manifest::CLUSTERS;
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
}
