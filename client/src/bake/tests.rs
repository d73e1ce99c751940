//! Bakes that contradict themselves are errors that say where.

use super::*;
use crate::fixture::{contents, manifest};
use lightkiln_proto::prt::RelightHit;

fn refused(change: impl FnOnce(&mut Manifest, &mut Contents)) -> String {
    refused_in(BasisKind::Sh, change)
}

fn refused_in(basis: BasisKind, change: impl FnOnce(&mut Manifest, &mut Contents)) -> String {
    let (mut manifest, mut contents) = (manifest(basis), contents(basis));
    change(&mut manifest, &mut contents);
    LoadedBake::assemble(manifest, contents).unwrap_err().to_string()
}

#[test]
fn receivers_get_slots_in_the_order_of_clusters() {
    let bake = crate::fixture::bake(BasisKind::Sh);
    let mut next = 0;
    for cluster in &bake.clusters.clusters {
        assert_eq!(cluster.first_receiver, next);
        next += cluster.receiver_count;
    }
    assert_eq!(next, bake.receivers.len());
    let block = bake.atlas.block_index(100).unwrap();
    assert_eq!(bake.atlas.slot(block, [1, 0]), Some(0));
    assert_eq!((bake.atlas.slot(block, [0, 0]), bake.atlas.slot(block, [8, 0])), (None, None));
}

#[test]
fn every_empty_texel_near_a_receiver_is_filled_from_its_neighbours() {
    let bake = crate::fixture::bake(BasisKind::Sh);
    let filled: Vec<u32> =
        bake.atlas.texels.iter().map(AtlasTexel::count).filter(|count| *count > 1).collect();
    // A corner of every block has three neighbours, the hole in the floor eight.
    assert_eq!(filled.iter().filter(|count| **count == 3).count(), bake.atlas.blocks.len());
    assert_eq!(filled.iter().filter(|count| **count == 8).count(), 1);
    assert_eq!(bake.atlas.texels.len(), bake.atlas.blocks.len() * 64);
}

#[test]
fn contradictions_are_named() {
    let cases: [(&str, String); 14] = [
        ("does not fit", refused(|manifest, _| manifest.blocks[0].origin = [39, 0])),
        ("page that does not exist", refused(|manifest, _| manifest.blocks[0].page = 9)),
        ("no texels", refused(|manifest, _| manifest.blocks[0].size = [0, 4])),
        ("key of another", refused(|manifest, _| manifest.blocks[1].key = manifest.blocks[0].key)),
        ("atlas pages", refused(|manifest, _| manifest.pages[0] = [u32::MAX; 2])),
        ("outside its block", refused(|_, contents| contents.clusters[0].receivers.texel[0] = [8, 0])),
        ("another receiver", refused(|_, contents| contents.clusters[0].receivers.texel[0] = [2, 0])),
        ("names no block", refused(|_, contents| contents.clusters[0].receivers.block[0] = 7)),
        ("not finite", refused(|_, contents| contents.clusters[0].receivers.position_m[0] = [f32::NAN; 3])),
        ("lengths", refused(|_, contents| contents.clusters[2].u.truncate(5))),
        ("is in no chunk", refused(|_, contents| contents.clusters[0].probes[0] = 77)),
        (
            "a ray hits block 99",
            refused(|_, contents| {
                contents.probes[0].hits[0] = RelightHit::Receiver { block: 99, texel: [0, 0] };
            }),
        ),
        ("names a vertex", refused(|_, contents| contents.geometry[0].draws[0].triangles[0] = [0, 1, 4])),
        ("names texture", refused(|_, contents| contents.textures.clear())),
    ];
    for (wanted, error) in cases {
        assert!(error.contains(wanted), "'{wanted}' is not in '{error}'");
    }
}

#[test]
fn hit_on_a_texel_that_no_light_reaches_is_dark() {
    let (manifest, mut contents) = (manifest(BasisKind::Sh), contents(BasisKind::Sh));
    contents.probes[0].hits[0] = RelightHit::Receiver { block: 0, texel: [0, 0] };
    let bake = LoadedBake::assemble(manifest, contents).unwrap();
    assert_eq!(bake.probes.hits[0], HIT_DARK);
}

#[test]
fn mesh_without_receivers_is_drawn_and_said() {
    let (manifest, mut contents) = (manifest(BasisKind::Sh), contents(BasisKind::Sh));
    contents.geometry[0].draws[0].front = 999;
    let bake = LoadedBake::assemble(manifest, contents).unwrap();
    assert!(bake.warnings[0].contains("1 mesh"), "{:?}", bake.warnings);
}

#[test]
fn emitters_scale_their_own_irradiance() {
    let bake = crate::fixture::bake(BasisKind::Sh);
    let once = bake.emitter_irradiance(&[]);
    let thrice = bake.emitter_irradiance(&[3.0]);
    assert!(once.iter().any(|e| e.x > 0.0) && once.iter().any(|e| e.x == 0.0));
    assert!(once.iter().zip(&thrice).all(|(once, thrice)| (*once * 3.0 - *thrice).length() < 1e-6));
}

#[test]
fn patches_that_contradict_the_rest_are_refused() {
    let none = refused_in(BasisKind::Patches, |_, contents| contents.patches.clear());
    assert!(none.contains("one set of them, not 0"), "{none}");
    let block = refused_in(BasisKind::Patches, |_, contents| contents.patches[0].block[3] = 99);
    assert!(block.contains("names block 99"), "{block}");
    let key = refused_in(BasisKind::Patches, |_, contents| contents.clusters[0].probes[2] = 7);
    assert!(key.contains("patch"), "{key}");
    let sky = refused_in(BasisKind::Patches, |_, contents| contents.patches[0].sky_parts = u32::MAX);
    assert!(sky.contains("parts of the sky"), "{sky}");
}
