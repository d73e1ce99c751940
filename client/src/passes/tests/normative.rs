//! The passes' references against the contract's normative reconstruction.

use std::f32::consts::FRAC_1_PI;

use glam::Vec4;
use lightkiln_proto::prt::reconstruct as prt;

use super::{fixture_view, prepared};
use crate::fixture;
use crate::passes::basis::reference::basis;
use crate::passes::compare::Difference;
use crate::passes::reconstruct::reference::reconstruct;
use crate::passes::relight::RelightTable;
use crate::passes::relight::reference::{Irradiance, relight};

fn four(values: &[prt::Rgb]) -> Vec<Vec4> {
    values.iter().map(|[r, g, b]| Vec4::new(*r, *g, *b, 0.0)).collect()
}

#[test]
fn references_give_what_the_contract_says() {
    let (bake, view) = fixture_view();
    let contents = fixture::contents();
    let prepared = prepared(&bake, &view);
    let table = RelightTable::new(&bake, prepared.sky);
    let count = bake.receivers.len();
    let dir: Vec<Vec4> = (0..count).map(|slot| Vec4::new(slot as f32 % 5.0, 1.0, 0.3, 0.0)).collect();
    let ind: Vec<Vec4> = (0..count).map(|slot| Vec4::new(0.1, slot as f32 % 3.0, 0.2, 0.0)).collect();
    let emit = bake.emitter_irradiance(&view.emitter_scale);
    let lambda = relight(&bake, &table, Irradiance { dir: &dir, emit: &emit, ind: &ind });
    let got = reconstruct(&bake.clusters, &basis(&bake.clusters, &lambda, table.coefficients), &emit);
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
            four(&prt::irradiance(cluster, &prt::cluster_basis(cluster, lambda_of, &sky), scale))
        })
        .collect();
    let difference = Difference::of(&got, &wanted, 1e-5);
    println!("normative: {difference}");
    assert!(difference.agrees(0.0), "{difference}");
}
