//! Bakes that contradict themselves are errors that say where.

use lightkiln_proto::kinds::sh::{HIT_DARK, RelightHit};
use lightkiln_proto::manifest::Manifest;

use crate::fixture::{geometry, manifest, prt_contents, prt_light, scene, sh_contents, sh_light, texture};
use crate::kinds::{prt, sh};
use crate::passes::atlas::AtlasTexel;
use crate::scene::LoadedScene;

fn refused(change: impl FnOnce(&mut prt::Contents)) -> String {
    let mut contents = prt_contents();
    change(&mut contents);
    prt::assemble(&scene("prt"), &contents).unwrap_err().to_string()
}

fn refused_scene(change: impl FnOnce(&mut Manifest)) -> String {
    let mut manifest = manifest("prt");
    change(&mut manifest);
    LoadedScene::assemble(manifest, vec![geometry()], vec![texture()]).unwrap_err().to_string()
}

#[test]
fn receivers_get_slots_in_the_order_of_clusters() {
    let (scene, light) = prt_light(&prt_contents());
    let transport = &light.transport;
    let mut next = 0;
    for cluster in &transport.clusters.clusters {
        assert_eq!(cluster.first_row, next);
        next += cluster.row_count;
    }
    assert_eq!(next, transport.receivers.len());
    let block = scene.lightmap.block_index(100).unwrap();
    let slot = |texel| transport.slots.slot(block, texel);
    assert_eq!((slot([1, 0]), slot([0, 0]), slot([8, 0])), (Some(0), None, None));
}

#[test]
fn every_empty_texel_near_a_receiver_is_filled_from_its_neighbours() {
    let (scene, light) = prt_light(&prt_contents());
    let texels = &light.texels.texels;
    let filled: Vec<u32> = texels.iter().map(AtlasTexel::count).filter(|count| *count > 1).collect();
    // A corner of every block has three neighbours, the hole in the floor eight.
    assert_eq!(filled.iter().filter(|count| **count == 3).count(), scene.lightmap.blocks.len());
    assert_eq!(filled.iter().filter(|count| **count == 8).count(), 1);
    assert_eq!(texels.len(), scene.lightmap.blocks.len() * 64);
}

#[test]
fn contradictions_of_the_scene_are_named() {
    let geometry_names_a_vertex = {
        let mut geometry = geometry();
        geometry.draws[0].triangles[0] = [0, 1, 4];
        LoadedScene::assemble(manifest("prt"), vec![geometry], vec![texture()]).unwrap_err().to_string()
    };
    let without_texture = LoadedScene::assemble(manifest("prt"), vec![geometry()], Vec::new());
    let cases = [
        (
            "does not fit",
            refused_scene(|manifest| manifest.lightmap.as_mut().unwrap().blocks[0].origin = [39, 0]),
        ),
        (
            "page that does not exist",
            refused_scene(|manifest| manifest.lightmap.as_mut().unwrap().blocks[0].page = 9),
        ),
        ("no texels", refused_scene(|manifest| manifest.lightmap.as_mut().unwrap().blocks[0].size = [0, 4])),
        ("key of another", refused_scene(|manifest| manifest.lightmap.as_mut().unwrap().blocks[1].key = 100)),
        (
            "atlas pages",
            refused_scene(|manifest| manifest.lightmap.as_mut().unwrap().pages[0] = [u32::MAX; 2]),
        ),
        ("names a vertex", geometry_names_a_vertex),
        ("names texture", without_texture.unwrap_err().to_string()),
    ];
    for (wanted, error) in cases {
        assert!(error.contains(wanted), "'{wanted}' is not in '{error}'");
    }
}

#[test]
fn contradictions_of_the_light_are_named() {
    let cases = [
        ("outside its block", refused(|contents| contents.clusters[0].receivers.texel[0] = [8, 0])),
        ("another receiver", refused(|contents| contents.clusters[0].receivers.texel[0] = [2, 0])),
        ("lengths", refused(|contents| contents.clusters[2].factors.u.truncate(5))),
        ("is in no chunk", refused(|contents| contents.clusters[0].factors.keys[2] = 7)),
        ("one set of them, not 0", refused(|contents| contents.patches.clear())),
        ("names block 99", refused(|contents| contents.patches[0].block[3] = 99)),
        ("parts of the sky", refused(|contents| contents.patches[0].sky_parts = u32::MAX)),
    ];
    for (wanted, error) in cases {
        assert!(error.contains(wanted), "'{wanted}' is not in '{error}'");
    }
    let mut contents = sh_contents();
    contents.probes[0].hits[0] = RelightHit::Receiver { block: 99, texel: [0, 0] };
    let error = sh::assemble(&scene("sh"), &contents).unwrap_err().to_string();
    assert!(error.contains("a ray hits block 99"), "{error}");
}

#[test]
fn hit_on_a_texel_that_no_light_reaches_is_dark() {
    let mut contents = sh_contents();
    contents.probes[0].hits[0] = RelightHit::Receiver { block: 0, texel: [0, 0] };
    assert_eq!(sh_light(&contents).1.transport.columns.hits[0], HIT_DARK);
}

#[test]
fn mesh_without_receivers_is_drawn_and_said() {
    let mut geometry = geometry();
    geometry.draws[0].front = Some(999);
    let scene = LoadedScene::assemble(manifest("prt"), vec![geometry], vec![texture()]).unwrap();
    assert!(scene.warnings[0].contains("1 mesh"), "{:?}", scene.warnings);
}

#[test]
fn emitters_scale_their_own_irradiance() {
    let (_, light) = prt_light(&prt_contents());
    let once = light.transport.emitter_irradiance(&[]);
    let thrice = light.transport.emitter_irradiance(&[3.0]);
    assert!(once.iter().any(|e| e.x > 0.0) && once.iter().any(|e| e.x == 0.0));
    assert!(once.iter().zip(&thrice).all(|(once, thrice)| (*once * 3.0 - *thrice).length() < 1e-6));
}

#[test]
fn kind_that_needs_a_lightmap_refuses_a_manifest_without() {
    let kinds = lightkiln_proto::kinds::Kinds::new();
    for kind in ["prt", "sh"] {
        let folder = tempfile::tempdir().unwrap();
        crate::fixture::write_bundle(folder.path(), kind);
        let (_, whole) = crate::fetch::Source::bundle(folder.path()).unwrap().manifest().unwrap();
        kinds.check(&whole).map(|_| ()).unwrap();
        let without = Manifest { lightmap: None, ..whole };
        let error = kinds.check(&without).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("no lightmap"), "{error}");
    }
}
