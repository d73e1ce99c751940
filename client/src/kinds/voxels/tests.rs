//! Light of walks beside the walks themselves, and bundles that lack what it needs.

use std::collections::HashSet;

use glam::{Vec3, Vec4};
use lightkiln_proto::kinds::voxels::NAME;
use lightkiln_proto::relight::{Columns as _, PatchTable, Transport};
use lightkiln_proto::voxels::{
    Bundle, IRRADIANCE_WALKS, Start, VoxelTotals, WalkLight, WalkedBlocks, irradiance, walk_identity, walked,
};

use super::*;
use crate::bake::LoadedBake;
use crate::fixture::{
    add_voxels, prt_contents, prt_light, rewrite_manifest, voxel_light, walked_light, write_bundle,
};
use crate::kinds::all;
use crate::lightmap::LightmapLight;
use crate::threads::Threads;

/// λ without pattern.
fn lambda(light: &LightmapLight<PatchTable>) -> Vec<Vec4> {
    let count = light.transport.columns.lambda_count() as u32;
    let number = |place: u32| f64::from(place.wrapping_mul(2_654_435_769) >> 8) as f32 / 16_777_216.0;
    (0..count).map(|place| Vec4::new(number(place), number(place + count), 0.5, 0.0)).collect()
}

#[test]
fn receivers_have_the_irradiance_of_their_walks_without_what_glows_there() {
    let (_, light) = walked_light();
    let lambda = lambda(&light);
    let Transport { receivers, columns, walked: ends, .. } = &light.transport;
    let table = light.voxels.as_ref().unwrap();
    let mut found = vec![Vec4::ZERO; receivers.len()];
    ends.gather(&Threads, &lambda, &mut found);
    let of_all = WalkLight::new(table, columns, &lambda, |_| Vec3::ZERO);
    for slot in 0..receivers.len() {
        let [at_m, normal] = [&receivers.position_m, &receivers.normal].map(|of| of[slot].truncate());
        let bundle = Bundle::new(IRRADIANCE_WALKS, walk_identity(table.voxel_m, at_m));
        let start = Start::on(at_m, normal);
        let wanted = irradiance(table, &start, normal, &bundle, |seen| of_all.radiance(seen));
        let found = found[slot].truncate();
        assert!((found - wanted).abs().max_element() < 1e-4, "receiver {slot}: {found}, wanted {wanted}");
    }
    assert!(found.iter().filter(|light| light.x > 0.0).count() > receivers.len() / 2);
}

#[test]
fn some_receivers_alone_are_walked() {
    let (_, light) = voxel_light();
    let Transport { receivers, columns, .. } = &light.transport;
    let table = light.voxels.as_ref().unwrap();
    let is_wanted = |slot: u32| slot.is_multiple_of(3);
    let ends = walked(table, columns, receivers, is_wanted, &Threads);
    assert!(ends.iter().all(|of| is_wanted(of.slot)));
    assert_eq!(ends.len(), receivers.len().div_ceil(3));
}

#[test]
fn receivers_of_blocks_that_walks_light_are_walked_and_no_others() {
    let contents = prt_contents();
    let (_, with_elements) = voxel_light();
    let (_, mut light) = prt_light(&contents);
    light.voxels = with_elements.voxels;
    let wanted = contents.clusters[1].receivers.blocks[0];
    let blocks = WalkedBlocks::new(vec![wanted, 17]);
    assert_eq!(serde_json::to_string(&blocks).unwrap(), format!(r#"["0000000000000011","{wanted:016x}"]"#));
    prt::walk(&mut light, LitByWalks::Of(&blocks)).unwrap();
    let slots = &light.transport.slots;
    let block = slots.block_index(wanted).unwrap();
    let of_block: HashSet<usize> =
        slots.receivers().filter(|(_, of, _)| *of == block).map(|(slot, ..)| slot as usize).collect();
    let lambda = vec![Vec4::ONE; light.transport.columns.lambda_count()];
    let mut found = vec![Vec4::ZERO; light.transport.receivers.len()];
    light.transport.walked.gather(&Threads, &lambda, &mut found);
    for (slot, found) in found.iter().enumerate() {
        // Under a light that is 1 everywhere, but for walks that end in the dark.
        assert_eq!(found.x > 1.0, of_block.contains(&slot), "receiver {slot}: {found}");
    }
    // Without elements nothing is walked.
    let (_, mut light) = prt_light(&contents);
    prt::walk(&mut light, LitByWalks::Of(&blocks)).unwrap();
    assert!(light.transport.walked.is_empty());
}

/// A bundle of the kind, with or without its elements.
fn opened(folder: &std::path::Path, has_voxels: bool) -> Result<LoadedBake> {
    let mut manifest = write_bundle(folder, "prt");
    manifest.kind = NAME.to_owned();
    manifest.body["voxels"] = serde_json::json!(VoxelTotals::default());
    let manifest = rewrite_manifest(folder, manifest);
    if has_voxels {
        add_voxels(folder, manifest);
    }
    LoadedBake::load(&Source::bundle(folder)?, &all())
}

#[test]
fn bundle_without_elements_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let error = format!("{:?}", opened(folder.path(), false).err().unwrap());
    assert!(error.contains("no voxels"), "{error}");
}

#[test]
fn bundle_with_elements_has_light() {
    let folder = tempfile::tempdir().unwrap();
    let bake = opened(folder.path(), true).unwrap();
    assert!(bake.light.voxels().is_some() && bake.light.lightmap(&bake.scene).is_some());
}
