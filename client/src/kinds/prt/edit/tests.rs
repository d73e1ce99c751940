//! Edits of the fixture: its bundle over patches before, the same as voxels alone after.

use std::path::Path;

use lightkiln_proto::relight::Limit;
use lightkiln_proto::voxels::VoxelTotals;

use super::*;
use crate::fixture::{add_voxels, rewrite_manifest, write_bundle};
use crate::kinds::all;
use crate::preview::{Backend, View, provisional_share, render};
use crate::tests::view_of;

/// Bundles of before, with or without voxels, and after.
fn bundles(folder: &Path, has_voxels: bool) -> [Source; 2] {
    let [before, after] = ["before", "after"].map(|name| folder.join(name));
    [&before, &after].iter().for_each(|folder| std::fs::create_dir(folder).unwrap());
    let manifest = write_bundle(&before, "prt");
    if has_voxels {
        add_voxels(&before, manifest);
    }
    let mut manifest = write_bundle(&after, "prt");
    manifest.kind = voxels::NAME.to_owned();
    manifest.body["voxels"] = json!(VoxelTotals::default());
    add_voxels(&after, rewrite_manifest(&after, manifest));
    [before, after].map(|folder| Source::bundle(folder).unwrap())
}

fn picture(bake: &LoadedBake, view: &View) -> Vec<[f32; 3]> {
    render(bake, view, Backend::Cpu).unwrap().linear
}

#[test]
fn scene_that_nobody_edited_has_the_light_of_its_bake() {
    for has_voxels in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let [before, after] = bundles(folder.path(), has_voxels);
        let edited = all().of(&before.manifest().unwrap().1).unwrap().edited(&before, &after).unwrap();
        assert!(edited.provisional.iter().all(|share| *share == 0.0));
        let whole = LoadedBake::load(&before, &all()).unwrap();
        let mut view = view_of(&whole);
        view.limit = Limit { bounces_max: 3, change_max: 0.0 };
        assert_eq!(provisional_share(&edited, &view).unwrap(), 0.0);
        let (found, wanted) = (picture(&edited.bake, &view), picture(&whole, &view));
        let mean = wanted.iter().flatten().sum::<f32>() / (3 * wanted.len()) as f32;
        for (found, wanted) in found.iter().flatten().zip(wanted.iter().flatten()) {
            // Numbers of receivers are stored twice.
            assert!((found - wanted).abs() < 0.02 * mean, "{found}, wanted {wanted}");
        }
    }
}

#[test]
fn quick_bake_has_the_texels_of_the_bake_and_no_settings_of_transport() {
    let folder = tempfile::tempdir().unwrap();
    let mut manifest = write_bundle(folder.path(), "prt");
    manifest.settings = json!({ "preset": "draft", "transport_rays": 64, "cavity_m": 0.2, "cluster_receivers": 64, "texel_m": 0.0 });
    let QuickBake { kind, settings } = quick(&manifest).unwrap();
    let texel_m = manifest.layout().unwrap().texel_m;
    assert_eq!(
        (kind, &settings),
        ("voxels", &json!({ "preset": "draft", "cavity_m": 0.2, "texel_m": texel_m }))
    );
    voxels::Settings::from_json(&settings).unwrap();
}

#[test]
fn kinds_that_show_no_edits_say_so() {
    let folder = tempfile::tempdir().unwrap();
    let manifest = write_bundle(folder.path(), "sh");
    let error = all().of(&manifest).unwrap().quick_bake(&manifest).unwrap_err().to_string();
    assert!(error.contains("sh") && error.contains("no edits"), "{error}");
}
