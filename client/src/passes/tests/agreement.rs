//! Every pass on the adapter against its reference on the very same input, in linear f32.

use glam::Vec4;
use lightkiln_proto::prt::BasisKind;

use super::{adapter_or_skip, fixture_view, fixture_view_of, prepared};
use crate::fixture;
use crate::passes::compare::Difference;
use crate::passes::gpu::Gpu;
use crate::passes::near::NearPass;
use crate::passes::relight::RelightTable;
use crate::passes::relight::reference::Irradiance;
use crate::passes::shade::ShadeView;
use crate::passes::shade::reference::Lit;
use crate::passes::{atlas, basis, direct, near, patches, reconstruct, relight, shade, shadow};
use crate::preview::{Backend, Frame, render};

/// Numbers of either sign without pattern, the same every time.
fn noise(count: usize, seed: u32) -> Vec<Vec4> {
    let mut state = seed;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 23) as f32 - 1.0
    };
    (0..count).map(|_| Vec4::new(next(), next(), next(), 0.0)).collect()
}

fn positive_noise(count: usize, seed: u32) -> Vec<Vec4> {
    noise(count, seed).into_iter().map(Vec4::abs).collect()
}

/// E_dir, E_emit and E_ind.
fn irradiance([dir, emit, ind]: &[Vec<Vec4>; 3]) -> Irradiance<'_> {
    Irradiance { dir, emit, ind }
}

/// λ that the adapter makes of E_dir, E_emit and E_ind.
fn lambda_of(gpu: &Gpu, frame: &Frame, [dir, emit, ind]: &[Vec<Vec4>; 3]) -> Vec<Vec4> {
    gpu.write(&frame.resident.e_dir, dir);
    gpu.write(&frame.resident.e_emit, emit);
    gpu.write(&frame.resident.e_ind, ind);
    gpu.submit(|encoder| frame.relight.record(&mut encoder.begin_compute_pass(&Default::default())));
    gpu.read(&frame.resident.lambda, frame.resident.lambda_count).unwrap()
}

fn held(pass: &str, difference: &Difference, outliers: f32) {
    println!("{pass}: {difference}");
    assert!(difference.agrees(outliers), "{pass}: {difference}");
}

/// Runs `test` on the adapter twice: with room for everything, and with so little that every array is paged.
fn with_and_without_paging(name: &str, test: impl Fn(&Gpu)) {
    let Some(mut gpu) = adapter_or_skip(name) else { return };
    test(&gpu);
    // One cluster's factors are 45 · 64 floats.
    gpu.binding_max = 16 << 10;
    test(&gpu);
}

#[test]
fn shadow_maps_agree_with_the_reference() {
    let Some(gpu) = adapter_or_skip("shadow_maps_agree_with_the_reference") else { return };
    let (bake, view) = fixture_view();
    let prepared = prepared(&bake, &view);
    let frame = Frame::new(&gpu, &prepared).unwrap();
    frame.light(&gpu);
    let got = frame.shadow.read(&gpu).unwrap();
    let wanted = shadow::reference::draw(&bake, &prepared.plan);
    assert_eq!((got.side, got.depth.len()), (wanted.side, wanted.depth.len()));
    let off =
        |(got, wanted): (&f32, &f32)| got.is_nan() || (got - wanted).abs() > shadow::TOLERANCE * wanted.abs();
    let outliers = got.depth.iter().zip(&wanted.depth).filter(|pair| off(*pair)).count();
    let drawn = wanted.depth.iter().filter(|depth| **depth > 0.0).count();
    println!("shadow: {outliers} of {} texels differ, {drawn} drawn", got.depth.len());
    assert!(drawn > got.depth.len() / 4, "{drawn}");
    assert!((outliers as f32) < shadow::OUTLIERS * got.depth.len() as f32, "{outliers}");
}

#[test]
fn direct_agrees_with_the_reference_on_the_same_shadow_maps() {
    let Some(gpu) = adapter_or_skip("direct_agrees_with_the_reference_on_the_same_shadow_maps") else {
        return;
    };
    let (bake, view) = fixture_view();
    let prepared = prepared(&bake, &view);
    let frame = Frame::new(&gpu, &prepared).unwrap();
    frame.light(&gpu);
    let got: Vec<Vec4> = gpu.read(&frame.resident.e_dir, bake.receivers.len()).unwrap();
    let maps = frame.shadow.read(&gpu).unwrap();
    let wanted =
        direct::reference::direct(&bake.receivers.position_m, &bake.receivers.normal, &prepared.plan, &maps);
    held("direct", &Difference::of(&got, &wanted, direct::TOLERANCE), direct::OUTLIERS);
}

#[test]
fn relight_agrees_with_the_reference() {
    with_and_without_paging("relight_agrees_with_the_reference", |gpu| {
        let (bake, view) = fixture_view();
        let prepared = prepared(&bake, &view);
        let frame = Frame::new(gpu, &prepared).unwrap();
        let light = [1, 2, 3].map(|seed| positive_noise(bake.receivers.len(), seed));
        // The sky's coefficients lie behind those of the probes and must survive.
        let got = lambda_of(gpu, &frame, &light);
        let table = RelightTable::new(&bake, prepared.sky);
        let wanted = relight::reference::relight(&bake, &table, irradiance(&light));
        held("relight", &Difference::of(&got, &wanted, relight::TOLERANCE), 0.0);
    });
}

#[test]
fn patches_agree_with_the_reference() {
    let Some(gpu) = adapter_or_skip("patches_agree_with_the_reference") else { return };
    let (bake, view) = fixture_view_of(BasisKind::Patches);
    let prepared = prepared(&bake, &view);
    let frame = Frame::new(&gpu, &prepared).unwrap();
    let light = [1, 2, 3].map(|seed| positive_noise(bake.receivers.len(), seed));
    let got = lambda_of(&gpu, &frame, &light);
    let sky = patches::sky_radiance(&bake, prepared.sky);
    let wanted = patches::reference::mean_radiance(&bake, &sky, irradiance(&light));
    // Five walls of four leaves, and the sky's parts behind them.
    assert_eq!(wanted.len(), 25 + sky.len());
    assert!(wanted.iter().all(|mean| mean.y > 0.0));
    held("patches", &Difference::of(&got, &wanted, patches::TOLERANCE), 0.0);
}

#[test]
fn near_hits_agree_with_the_reference() {
    let Some(mut gpu) = adapter_or_skip("near_hits_agree_with_the_reference") else { return };
    let (_, view) = fixture_view_of(BasisKind::Patches);
    let bake = fixture::narrow_bake();
    let prepared = prepared(&bake, &view);
    let frame = Frame::new(&gpu, &prepared).unwrap();
    frame.light(&gpu);
    let maps = frame.shadow.read(&gpu).unwrap();
    let (positions_m, normals) = (&bake.near.position_m, &bake.near.normal);
    let wanted = direct::reference::direct(positions_m, normals, &prepared.plan, &maps);
    assert!(wanted.iter().any(|e| e.x > 0.0) && wanted.len() > 40);
    let light = [1, 2, 3].map(|seed| positive_noise(bake.receivers.len(), seed));
    gpu.write(&frame.resident.e_emit, &light[1]);
    gpu.write(&frame.resident.e_ind, &light[2]);
    // In one page, and in pages of at most twenty hits.
    for binding_max in [gpu.binding_max, 20 * size_of::<Vec4>() as u64] {
        gpu.binding_max = binding_max;
        let pass = NearPass::new(&gpu, &bake, &frame.shadow, &frame.resident).unwrap();
        gpu.write(&frame.resident.e_near, &vec![Vec4::ZERO; bake.receivers.len()]);
        gpu.submit(|encoder| {
            let mut compute = encoder.begin_compute_pass(&Default::default());
            pass.light(&mut compute, &frame.shadow);
            pass.record(&mut compute);
        });
        let pages = pass.read_e_dir(&gpu).unwrap();
        assert_eq!(pages.len() > 2, binding_max < 1000);
        let dir = pages.concat();
        held("E_dir of near hits", &Difference::of(&dir, &wanted, direct::TOLERANCE), direct::OUTLIERS);
        let got: Vec<Vec4> = gpu.read(&frame.resident.e_near, bake.receivers.len()).unwrap();
        let sums = near::reference::near(&bake, &dir, irradiance(&light));
        let lit = sums.iter().filter(|e| e.y > 0.0).count();
        assert!(lit > 15 && lit < bake.receivers.len() / 4, "{lit}");
        held("near hits", &Difference::of(&got, &sums, near::TOLERANCE), 0.0);
    }
}

#[test]
fn basis_agrees_with_the_reference() {
    with_and_without_paging("basis_agrees_with_the_reference", |gpu| {
        let (mut bake, view) = fixture_view();
        // The fixture's ΣVᵀ is the identity, which would hide a transposition.
        let values = noise(bake.clusters.vt.len(), 4);
        bake.clusters.vt = values.iter().map(|value| value.x).collect();
        let frame = Frame::new(gpu, &prepared(&bake, &view)).unwrap();
        let lambda = noise(frame.resident.lambda_count, 5);
        gpu.write(&frame.resident.lambda, &lambda);
        gpu.submit(|encoder| frame.basis.record(&mut encoder.begin_compute_pass(&Default::default())));
        let got: Vec<Vec4> = gpu.read(&frame.resident.b, frame.resident.b_count).unwrap();
        let wanted = basis::reference::basis(&bake.clusters, &lambda, bake.coefficients());
        held("basis", &Difference::of(&got, &wanted, basis::TOLERANCE), 0.0);
    });
}

#[test]
fn reconstruct_agrees_with_the_reference() {
    with_and_without_paging("reconstruct_agrees_with_the_reference", |gpu| {
        let (bake, view) = fixture_view();
        let frame = Frame::new(gpu, &prepared(&bake, &view)).unwrap();
        let b = noise(frame.resident.b_count, 6);
        gpu.write(&frame.resident.b, &b);
        let emit = bake.emitter_irradiance(&view.emitter_scale);
        let near = positive_noise(bake.receivers.len(), 11);
        gpu.write(&frame.resident.e_near, &near);
        gpu.submit(|encoder| frame.reconstruct.record(&mut encoder.begin_compute_pass(&Default::default())));
        let got: Vec<Vec4> = gpu.read(&frame.resident.e_ind, bake.receivers.len()).unwrap();
        let wanted = reconstruct::reference::reconstruct(&bake.clusters, &b, &near, &emit);
        assert!(wanted.iter().any(|e| e.x == 0.0) && wanted.iter().any(|e| e.x < 0.0));
        held("reconstruct", &Difference::of(&got, &wanted, reconstruct::TOLERANCE), 0.0);
    });
}

#[test]
fn atlas_agrees_with_the_reference() {
    let Some(gpu) = adapter_or_skip("atlas_agrees_with_the_reference") else { return };
    let (bake, view) = fixture_view();
    let frame = Frame::new(&gpu, &prepared(&bake, &view)).unwrap();
    let count = bake.receivers.len();
    let (emit, ind) = (positive_noise(count, 7), positive_noise(count, 8));
    gpu.write(&frame.resident.e_emit, &emit);
    gpu.write(&frame.resident.e_ind, &ind);
    frame.spread(&gpu);
    let wanted = atlas::reference::spread(&bake.atlas, &emit, &ind);
    let stride = frame.atlas.texture.width() as usize;
    for (page, (texels, size)) in wanted.pages.iter().zip(&wanted.sizes).enumerate() {
        let layer: Vec<Vec4> =
            gpu.read_layer(&frame.atlas.texture, page as u32, wgpu::TextureAspect::All).unwrap();
        let rows = layer.chunks(stride).take(size[1] as usize);
        let got: Vec<Vec4> = rows.flat_map(|row| row[..size[0] as usize].to_vec()).collect();
        assert!(
            got.iter().zip(texels).all(|(got, wanted)| got.w == wanted.w),
            "page {page}: other texels are lit"
        );
        held("atlas", &Difference::of(&got, texels, atlas::TOLERANCE), 0.0);
    }
}

#[test]
fn shade_agrees_with_the_reference_on_the_same_maps_and_atlas() {
    let Some(gpu) = adapter_or_skip("shade_agrees_with_the_reference_on_the_same_maps_and_atlas") else {
        return;
    };
    let (bake, view) = fixture_view();
    let prepared = prepared(&bake, &view);
    let frame = Frame::new(&gpu, &prepared).unwrap();
    frame.light(&gpu);
    let count = bake.receivers.len();
    let (emit, ind) = (positive_noise(count, 9), positive_noise(count, 10));
    gpu.write(&frame.resident.e_emit, &emit);
    gpu.write(&frame.resident.e_ind, &ind);
    frame.spread(&gpu);
    let maps = frame.shadow.read(&gpu).unwrap();
    let atlas = atlas::reference::spread(&bake.atlas, &emit, &ind);
    for jitter in [[0.0, 0.0], [0.375, -0.125]] {
        let shade_view =
            ShadeView::new(&view.camera, view.size(), bake.manifest.bounds_m, prepared.sky, jitter).unwrap();
        let got = frame.shade.draw(&gpu, &frame.meshes, &frame.shadow, &shade_view).unwrap();
        let emitter_scale = &view.emitter_scale;
        let lit = Lit { bake: &bake, plan: &prepared.plan, maps: &maps, atlas: &atlas, emitter_scale };
        let wanted = shade::reference::shade(lit, &shade_view, view.size());
        held("shade", &Difference::of_mean(&got, &wanted, shade::TOLERANCE), shade::OUTLIERS);
        let sky = |pixels: &[Vec4]| pixels.iter().filter(|pixel| pixel.w < 0.5).count();
        assert!(
            sky(&wanted) > 100 && sky(&wanted).abs_diff(sky(&got)) < 40,
            "{} {}",
            sky(&wanted),
            sky(&got)
        );
    }
}

#[test]
fn whole_pictures_of_adapter_and_processor_agree() {
    if adapter_or_skip("whole_pictures_of_adapter_and_processor_agree").is_none() {
        return;
    }
    let [(sh, view), (patches, _)] = [BasisKind::Sh, BasisKind::Patches].map(fixture_view_of);
    for bake in [sh, patches, fixture::narrow_bake()] {
        let [got, wanted] =
            [Backend::Gpu, Backend::Cpu].map(|backend| render(&bake, &view, backend).unwrap());
        assert!(got.converged && wanted.converged && !got.by_reference && wanted.by_reference);
        let four = |pixels: &[[f32; 3]]| -> Vec<Vec4> {
            pixels.iter().map(|[r, g, b]| Vec4::new(*r, *g, *b, 0.0)).collect()
        };
        let difference = Difference::of_mean(&four(&got.linear), &four(&wanted.linear), shade::TOLERANCE);
        // Samples at outlines are shared among more pixels than without supersampling.
        held("picture", &difference, 2.0 * shade::OUTLIERS);
    }
}
