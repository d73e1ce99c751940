//! The passes' references against the contract's normative reconstruction.

use std::collections::BTreeMap;
use std::f32::consts::FRAC_1_PI;

use glam::Vec4;
use lightkiln_proto::prt::{BasisKind, ClusterTransport, NearSurface, reconstruct as prt};

use super::{fixture_view, fixture_view_of, prepared};
use crate::fixture;
use crate::passes::basis::reference::basis;
use crate::passes::compare::Difference;
use crate::passes::near::reference::near;
use crate::passes::patches::reference::mean_radiance;
use crate::passes::patches::sky_radiance;
use crate::passes::reconstruct::reference::reconstruct;
use crate::passes::relight::RelightTable;
use crate::passes::relight::reference::{Irradiance, relight};

fn four(values: &[prt::Rgb]) -> Vec<Vec4> {
    values.iter().map(|[r, g, b]| Vec4::new(*r, *g, *b, 0.0)).collect()
}

#[test]
fn references_give_what_the_contract_says() {
    let (bake, view) = fixture_view();
    let contents = fixture::contents(BasisKind::Sh);
    let prepared = prepared(&bake, &view);
    let table = RelightTable::new(&bake, prepared.sky);
    let count = bake.receivers.len();
    let dir: Vec<Vec4> = (0..count).map(|slot| Vec4::new(slot as f32 % 5.0, 1.0, 0.3, 0.0)).collect();
    let ind: Vec<Vec4> = (0..count).map(|slot| Vec4::new(0.1, slot as f32 % 3.0, 0.2, 0.0)).collect();
    let emit = bake.emitter_irradiance(&view.emitter_scale);
    let lambda = relight(&bake, &table, Irradiance { dir: &dir, emit: &emit, ind: &ind });
    let none = vec![Vec4::ZERO; count];
    let got = reconstruct(&bake.clusters, &basis(&bake.clusters, &lambda, table.coefficients), &none, &emit);
    let got: Vec<Vec4> = got.iter().zip(&emit).map(|(ind, emit)| *ind + *emit).collect();

    let settings = &bake.manifest.settings;
    let functions = prt::relight_basis(settings.relight_rays, settings.relight_rays, settings.bands);
    let batch = &contents.probes[0];
    let wanted_lambda = prt::relight(batch, &functions, |block, texel| {
        let slot = bake.atlas.slot(bake.atlas.block_index(block).unwrap(), texel).unwrap() as usize;
        let radiance = bake.receivers.albedo[slot] * FRAC_1_PI * (dir[slot] + emit[slot] + ind[slot]);
        radiance.truncate().into()
    });
    let sky = prt::sky_coefficients(prepared.sky.zenith.into(), prepared.sky.horizon.into(), settings.bands);
    let lambda_of = |key: u64| {
        let probe = batch.probes.iter().position(|probe| probe.key == key)?;
        wanted_lambda.chunks(table.coefficients).nth(probe)
    };
    let scale = |emitter: u16| view.emitter_scale[usize::from(emitter)];
    let wanted: Vec<Vec4> = contents
        .clusters
        .iter()
        .flat_map(|cluster| {
            four(&prt::irradiance(cluster, &prt::cluster_basis(cluster, lambda_of, &sky), Vec::new(), scale))
        })
        .collect();
    let difference = Difference::of(&got, &wanted, 1e-5);
    println!("normative: {difference}");
    assert!(difference.agrees(0.0), "{difference}");
}

#[test]
fn references_of_patches_give_what_the_contract_says() {
    let (_, view) = fixture_view_of(BasisKind::Patches);
    let (bake, contents) = (fixture::narrow_bake(), fixture::narrow_contents());
    let sky = prepared(&bake, &view).sky;
    let count = bake.receivers.len();
    let dir: Vec<Vec4> = (0..count).map(|slot| Vec4::new(slot as f32 % 5.0, 1.0, 0.3, 0.0)).collect();
    let ind = vec![Vec4::new(0.1, 0.0, 0.2, 0.0); count];
    let emit = bake.emitter_irradiance(&view.emitter_scale);
    let irradiance = Irradiance { dir: &dir, emit: &emit, ind: &ind };
    let lambda = mean_radiance(&bake, &sky_radiance(&bake, sky), irradiance);
    // E_dir at hits: what stands for it is their height.
    let dir_near: Vec<Vec4> = bake.near.position_m.iter().map(|at| Vec4::new(at.y, 0.5, 0.1, 0.0)).collect();
    let near = near(&bake, &dir_near, irradiance);
    let got = reconstruct(&bake.clusters, &basis(&bake.clusters, &lambda, 1), &near, &emit);
    let got: Vec<Vec4> = got.iter().zip(&emit).map(|(ind, emit)| *ind + *emit).collect();

    let radiance = |block, texel| match bake.atlas.slot(bake.atlas.block_index(block).unwrap(), texel) {
        Some(slot) => {
            let e = dir[slot as usize] + emit[slot as usize] + ind[slot as usize];
            (bake.receivers.albedo[slot as usize] * FRAC_1_PI * e).truncate().into()
        }
        // No light reaches it.
        None => [0.0; 3],
    };
    let colours = [sky.zenith.into(), sky.horizon.into()];
    let wanted_lambda: BTreeMap<u64, [prt::Rgb; 1]> =
        prt::patch_radiance(&contents.patches[0], radiance, colours)
            .into_iter()
            .map(|(key, mean)| (key.0, [mean]))
            .collect();
    let slot = |(block, texel)| bake.atlas.slot(bake.atlas.block_index(block).unwrap(), texel);
    let near_radiance = |cluster: &ClusterTransport, hit: usize| -> prt::Rgb {
        let own = cluster.near.receivers().nth(hit).unwrap();
        let (light, albedo, normal) = match cluster.near.surface[hit] {
            NearSurface::Own { albedo, normal } => (own, four(&[albedo])[0], normal),
            NearSurface::Texel { block, texel } => {
                let name = (cluster.near.blocks[usize::from(block)], texel);
                let Some(on) = slot(name) else { return [0.0; 3] };
                let on = on as usize;
                (on, bake.receivers.albedo[on], bake.receivers.normal[on].truncate().into())
            }
        };
        let y = cluster.near.position_m(hit, cluster.receivers.position_m[own], normal)[1];
        let e = Vec4::new(y, 0.5, 0.1, 0.0) + emit[light] + ind[light];
        (albedo * FRAC_1_PI * e).truncate().into()
    };
    let scale = |emitter: u16| view.emitter_scale[usize::from(emitter)];
    let of_cluster = |cluster: &ClusterTransport| {
        let basis = prt::cluster_basis(cluster, |key| wanted_lambda.get(&key).map(|mean| &mean[..]), &[]);
        let near = prt::near_irradiance(&cluster.near, |hit| near_radiance(cluster, hit));
        four(&prt::irradiance(cluster, &basis, near, scale))
    };
    let wanted: Vec<Vec4> = contents.clusters.iter().flat_map(of_cluster).collect();
    let difference = Difference::of(&got, &wanted, 1e-5);
    println!("normative, patches: {difference}");
    assert!(difference.agrees(0.0), "{difference}");
}
