//! Every pass on the adapter against its reference on the very same input, in linear f32.
//!
//! Ignored by default, so that a machine without an adapter never reports them as passed; `tests/run` asks for them where
//! it finds a driver: `cargo test -p lightkiln-client --lib -- --ignored adapter`.

use glam::{Affine3A, Vec4};
use lightkiln_proto::relight::{Irradiance, NearHit, Sky, TAKEN, WalkedRow};
use lightkiln_proto::scene::SceneLight;

use super::{fixture_light, prepared, view_of};
use crate::bake::{Among, Light, LightPasses, LoadedBake, Unshadowed};
use crate::fixture;
use crate::frame::Frame;
use crate::kinds::sh::relight;
use crate::lightmap::{ClientColumns, LightmapLight, LightmapPasses};
use crate::lights::parse_light;
use crate::passes::change::ChangePass;
use crate::passes::compare::Difference;
use crate::passes::gpu::Gpu;
use crate::passes::meshes::Meshes;
use crate::passes::near::NearPass;
use crate::passes::shade::ShadeView;
use crate::passes::shade::reference::Lit;
use crate::passes::shadow::{ShadowPass, ShadowPlan};
use crate::passes::stopwatch::{Recorder, Stopwatch};
use crate::passes::walked::WalkedPass;
use crate::passes::{atlas, change, direct, near, patches, shade, shadow, walked};
use crate::preview::{Backend, View, frame_of, render};
use crate::scene::LoadedScene;

/// Numbers of either sign without pattern, the same every time.
pub(super) fn noise(count: usize, seed: u32) -> Vec<Vec4> {
    let mut state = seed;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 23) as f32 - 1.0
    };
    (0..count).map(|_| Vec4::new(next(), next(), next(), 0.0)).collect()
}

pub(super) fn positive_noise(count: usize, seed: u32) -> Vec<Vec4> {
    noise(count, seed).into_iter().map(Vec4::abs).collect()
}

pub(super) fn held(pass: &str, difference: &Difference, outliers: f32) {
    println!("{pass}: {difference}");
    assert!(difference.agrees(outliers), "{pass}: {difference}");
}

/// Runs `test` on the adapter twice: with room for everything, and with so little that every array is paged.
pub(super) fn with_and_without_paging(test: impl Fn(&Gpu)) {
    let mut gpu = Gpu::open().unwrap();
    test(&gpu);
    gpu.binding_max = 16 << 10;
    test(&gpu);
}

/// Light in a lightmap with its passes.
struct Stage<C> {
    scene: LoadedScene,
    light: LightmapLight<C>,
    plan: ShadowPlan,
    meshes: Meshes,
    shadow: ShadowPass,
    passes: LightmapPasses,
}

impl<C: ClientColumns> Stage<C> {
    fn new(gpu: &Gpu, (scene, light): (LoadedScene, LightmapLight<C>)) -> Self {
        let lights = &scene.manifest.lights;
        let casters = crate::lights::Caster::of(lights);
        let plan = ShadowPlan::new(&casters, scene.manifest.bounds_m, 512, None).unwrap();
        let meshes = Meshes::new(gpu, &scene).unwrap();
        let shadow = ShadowPass::new(gpu, &scene, &meshes, &plan.room()).unwrap();
        shadow.set(gpu, &plan);
        let unshadowed = Unshadowed { sky: Sky::of(lights), panorama: None, emitter_scale: &[1.5] };
        let passes = LightmapPasses::new(gpu, &scene, &light, &shadow).unwrap();
        passes.set_unshadowed(gpu, &light.unshadowed(unshadowed));
        Self { scene, light, plan, meshes, shadow, passes }
    }

    fn run(&self, gpu: &Gpu, record: impl FnOnce(&mut wgpu::ComputePass<'_>)) {
        gpu.submit(|encoder| record(&mut encoder.begin_compute_pass(&Default::default())));
    }

    /// Shadow maps, and E_dir.
    fn relit(&self, gpu: &Gpu) {
        gpu.submit(|encoder| {
            let recorder = &mut Recorder::untimed(encoder);
            self.shadow.record(recorder, &self.meshes, 0..self.plan.faces.len());
            self.passes.relit(recorder, &self.shadow);
        });
    }

    fn receivers(&self) -> usize {
        self.light.transport.receivers.len()
    }

    /// λ that the adapter makes of E_dir, E_emit and E_ind, and the reference's.
    fn lambdas(&self, gpu: &Gpu) -> [Vec<Vec4>; 2] {
        let [dir, emit, ind] = [1, 2, 3].map(|seed| positive_noise(self.receivers(), seed));
        let resident = &self.passes.resident;
        gpu.write(&resident.e_dir, &dir);
        gpu.write(&resident.e_emit, &emit);
        gpu.write(&resident.e_ind, &ind);
        self.run(gpu, |pass| self.passes.columns.record(pass));
        let got = gpu.read(&resident.lambda, resident.lambda_count).unwrap();
        let sky = self.light.transport.columns.sky_lambda(Sky::of(&self.scene.manifest.lights));
        let irradiance = Irradiance { dir: &dir, emit: &emit, ind: &ind };
        [got, self.light.transport.lambda(&crate::Threads, irradiance, &sky)]
    }
}

#[test]
#[ignore = "needs a graphics adapter"]
fn shadow_maps_agree_with_the_reference() {
    let gpu = Gpu::open().unwrap();
    let stage = Stage::new(&gpu, fixture_light());
    stage.relit(&gpu);
    let got = stage.shadow.read(&gpu).unwrap();
    let wanted = shadow::reference::draw(&stage.scene, &stage.plan);
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
#[ignore = "needs a graphics adapter"]
fn shadow_maps_of_glass_agree_with_the_reference() {
    let gpu = Gpu::open().unwrap();
    let bake = super::facing::glazed_bake();
    let view = view_of(&bake);
    let plan = prepared(&bake, &view).plan;
    let meshes = Meshes::new(&gpu, &bake.scene).unwrap();
    let pass = ShadowPass::new(&gpu, &bake.scene, &meshes, &plan.room()).unwrap();
    pass.set(&gpu, &plan);
    gpu.submit(|encoder| pass.record(&mut Recorder::untimed(encoder), &meshes, 0..plan.faces.len()));
    let got = pass.read(&gpu).unwrap();
    let wanted = shadow::reference::draw(&bake.scene, &plan);
    let count = wanted.depth.len();
    for (what, got, wanted) in [
        ("opaque", &got.depth, &wanted.depth),
        ("nearest glass", &got.pane_depth, &wanted.pane_depth),
        ("light through glass", &got.passed, &wanted.passed),
    ] {
        assert_eq!((got.len(), wanted.len()), (count, count), "{what}");
        let off = |(got, wanted): (&f32, &f32)| {
            got.is_nan() || (got - wanted).abs() > shadow::TOLERANCE * wanted.abs()
        };
        let outliers = got.iter().zip(wanted).filter(|pair| off(*pair)).count();
        println!("{what}: {outliers} of {count} texels differ");
        assert!((outliers as f32) < shadow::OUTLIERS * count as f32, "{what}: {outliers}");
    }
    // One pane, and one before another.
    for share in [0.75, 0.375] {
        let drawn = wanted.passed.iter().filter(|passed| (**passed - share).abs() < 1e-6).count();
        assert!(drawn > 50, "{drawn} texels let {share} through");
    }
}

/// Rectangles before the walls, one of them upright and cut by the floor's horizon.
fn rects() -> Vec<SceneLight> {
    let words = [
        "rect pos=2.1,2.7,1.8 dir=0.1,-1,0 size=1.3,0.7 color=1,0.8,0.6 radiance=4",
        "rect pos=0.4,0.3,2.2 dir=1,0.2,0.1 size=0.5,1.4 color=0.5,0.8,1 radiance=3 points=3",
    ];
    words.map(|words| parse_light(words).unwrap()).into()
}

fn under_rects<C>((mut scene, light): (LoadedScene, C)) -> (LoadedScene, C) {
    scene.manifest.lights = rects();
    (scene, light)
}

#[test]
#[ignore = "needs a graphics adapter"]
fn direct_agrees_with_the_reference_on_the_same_shadow_maps() {
    let gpu = Gpu::open().unwrap();
    for stage in [fixture_light(), under_rects(fixture_light())] {
        direct_agrees(&gpu, &Stage::new(&gpu, stage));
    }
}

fn direct_agrees<C: ClientColumns>(gpu: &Gpu, stage: &Stage<C>) {
    stage.relit(gpu);
    let got: Vec<Vec4> = gpu.read(&stage.passes.resident.e_dir, stage.receivers()).unwrap();
    let maps = stage.shadow.read(gpu).unwrap();
    let receivers = &stage.light.transport.receivers;
    let points = &stage.light.points;
    let wanted = direct::reference::direct_texels(receivers, points, &Affine3A::IDENTITY, &stage.plan, &maps);
    assert!(wanted.iter().any(|e| e.x > 0.1));
    held("direct", &Difference::of(&got, &wanted, direct::TOLERANCE), direct::OUTLIERS);
}

#[test]
#[ignore = "needs a graphics adapter"]
fn relight_agrees_with_the_reference() {
    with_and_without_paging(|gpu| {
        // The sky's coefficients lie behind those of the probes and must survive.
        let [got, wanted] = Stage::new(gpu, fixture::sh_light(&fixture::sh_contents())).lambdas(gpu);
        held("relight", &Difference::of(&got, &wanted, relight::TOLERANCE), 0.0);
    });
}

#[test]
#[ignore = "needs a graphics adapter"]
fn patches_agree_with_the_reference() {
    let gpu = Gpu::open().unwrap();
    let stage = Stage::new(&gpu, fixture_light());
    let [got, wanted] = stage.lambdas(&gpu);
    // Five walls of four leaves, their differences, and the sky's parts behind them.
    assert_eq!(wanted.len(), 50 + stage.light.transport.columns.sky_parts as usize);
    assert!(wanted[..25].iter().all(|mean| mean.y > 0.0) && wanted[25..50].iter().any(|less| less.y < 0.0));
    held("patches", &Difference::of(&got, &wanted, patches::TOLERANCE), 0.0);
}

#[test]
#[ignore = "needs a graphics adapter"]
fn near_hits_agree_with_the_reference() {
    let narrow = || fixture::prt_light(&fixture::narrow_contents());
    for stage in [narrow(), under_rects(narrow())] {
        let gpu = Gpu::open().unwrap();
        let stage = Stage::new(&gpu, stage);
        near_hits_agree(gpu, &stage);
    }
}

fn near_hits_agree<C: ClientColumns>(mut gpu: Gpu, stage: &Stage<C>) {
    stage.relit(&gpu);
    let maps = stage.shadow.read(&gpu).unwrap();
    let table = &stage.light.transport.near;
    let receivers = &stage.light.transport.receivers;
    let [positions_m, normals] = table.surfaces(receivers);
    let dir = direct::reference::direct(&positions_m, &normals, &Affine3A::IDENTITY, &stage.plan, &maps);
    assert!(dir.iter().any(|e| e.x > 0.0) && dir.len() > 40 && !table.own.is_empty());
    let count = stage.receivers();
    let black = vec![Vec4::ZERO; count];
    let unlit = Irradiance { dir: &black, emit: &black, ind: &black };
    // Light straight from lights, by receiver without its weight.
    let by_slot = near::reference::near(table, receivers, &dir, unlit);
    let lit: Vec<Vec4> = table.rows.iter().map(|row| by_slot[row.slot as usize] / row.weight).collect();
    let [emit, ind] = [2, 3].map(|seed| positive_noise(count, seed));
    let resident = &stage.passes.resident;
    gpu.write(&resident.e_emit, &emit);
    gpu.write(&resident.e_ind, &ind);
    // In one page, and in pages of at most 32 hits.
    for binding_max in [gpu.binding_max, 32 * size_of::<NearHit>() as u64] {
        gpu.binding_max = binding_max;
        let pass = NearPass::new(&gpu, table, &stage.shadow, resident).unwrap();
        gpu.write(&resident.e_near, &vec![Vec4::ZERO; count]);
        stage.run(&gpu, |compute| {
            pass.light(compute, &stage.shadow);
            pass.record(compute);
        });
        let pages = pass.read_lit(&gpu).unwrap();
        assert_eq!(pages.len() > 1, binding_max < 1000);
        let found = pages.concat();
        held("light of near hits", &Difference::of(&found, &lit, direct::TOLERANCE), direct::OUTLIERS);
        let got: Vec<Vec4> = gpu.read(&resident.e_near, count).unwrap();
        let irradiance = Irradiance { dir: &ind, emit: &emit, ind: &ind };
        // The reference's bounces, beside what the adapter has found straight from lights.
        let no_lights = vec![Vec4::ZERO; table.len()];
        let mut sums = near::reference::near(table, receivers, &no_lights, irradiance);
        for (row, lit) in table.rows.iter().zip(&found) {
            sums[row.slot as usize] += row.weight * *lit;
        }
        let lit = sums.iter().filter(|e| e.y > 0.0).count();
        assert!(lit > 15 && lit < count / 4, "{lit}");
        held("near hits", &Difference::of(&got, &sums, near::TOLERANCE), 0.0);
    }
}

#[test]
#[ignore = "needs a graphics adapter"]
fn light_of_walks_agrees_with_the_reference() {
    let mut gpu = Gpu::open().unwrap();
    let stage = Stage::new(&gpu, fixture::walked_light());
    let resident = &stage.passes.resident;
    let lambda = positive_noise(resident.lambda_count, 4);
    gpu.write(&resident.lambda, &lambda);
    let count = stage.receivers();
    // Some receivers have near hits, and some ends are taken away.
    let mut table = stage.light.transport.walked.clone();
    table.rows.iter_mut().step_by(3).for_each(|row| row.has_near = 1);
    table.places.iter_mut().step_by(5).for_each(|place| *place |= TAKEN);
    let before = positive_noise(count, 5);
    let near = |rows: &[WalkedRow]| {
        let mut by_slot = vec![Vec4::ZERO; count];
        for row in rows.iter().filter(|row| row.has_near == 1) {
            by_slot[row.slot as usize] = before[row.slot as usize];
        }
        by_slot
    };
    let mut wanted = near(&table.rows);
    walked::reference::walked(&table, &lambda, &mut wanted);
    assert!(wanted.iter().filter(|e| e.y > 0.0).count() > count / 2);
    // In one page, and in pages of a few receivers.
    for binding_max in [gpu.binding_max, 4096] {
        gpu.binding_max = binding_max;
        let pass = WalkedPass::new(&gpu, &table, resident).unwrap().unwrap();
        gpu.write(&resident.e_near, &before);
        stage.run(&gpu, |compute| pass.record(compute));
        let got: Vec<Vec4> = gpu.read(&resident.e_near, count).unwrap();
        held("light of walks", &Difference::of(&got, &wanted, walked::TOLERANCE), 0.0);
    }
    // One end of each receiver elsewhere.
    let mut other = table.clone();
    for row in &table.rows {
        let place = &mut other.places[row.first as usize];
        *place = ((*place & !TAKEN) + 1) % resident.lambda_count as u32;
    }
    let mut wanted = near(&table.rows);
    walked::reference::walked(&other, &lambda, &mut wanted);
    let got: Vec<Vec4> = gpu.read(&resident.e_near, count).unwrap();
    assert!(!Difference::of(&got, &wanted, walked::TOLERANCE).agrees(0.0));
}

#[test]
#[ignore = "needs a graphics adapter"]
fn change_agrees_with_the_reference() {
    let gpu = Gpu::open().unwrap();
    let mut watch = Stopwatch::new(&gpu);
    // More receivers than the first step has threads, fewer than a workgroup, and none.
    for count in [200_000, 50, 0] {
        let e_ind = gpu.blank("E_ind", (count * size_of::<Vec4>()) as u64).unwrap();
        let mut pass = ChangePass::new(&gpu, (&e_ind, count)).unwrap();
        let mut before = vec![Vec4::ZERO; count];
        for (call, scale) in [(1, 1.0), (2, 0.01), (3, 0.0)] {
            let now: Vec<Vec4> = before
                .iter()
                .zip(noise(count, call))
                .map(|(before, noise)| *before + scale * noise)
                .collect();
            gpu.write(&e_ind, &now);
            assert_eq!(pass.ask(&gpu, &mut watch), u64::from(call));
            let [answer] = pass.answers(&gpu, true).unwrap()[..] else { panic!("one answer") };
            let wanted = change::reference::change(&before, &now);
            println!("{answer:?}, reference {wanted}");
            assert_eq!(answer.call, u64::from(call));
            assert!((answer.change - wanted).abs() <= change::TOLERANCE * wanted);
            assert_eq!(wanted > 0.0, scale > 0.0 && count > 0);
            before = now;
        }
        // More calls than there are landings: the last have no answer, and the next tells of them too.
        let mut calls: Vec<u64> = (0..3).map(|_| pass.ask(&gpu, &mut watch)).collect();
        let now = noise(count, 4);
        gpu.write(&e_ind, &now);
        calls.extend((0..2).map(|_| pass.ask(&gpu, &mut watch)));
        assert_eq!(calls, [4, 5, 6, 7, 8]);
        let answers = pass.answers(&gpu, true).unwrap();
        let answered: Vec<[u64; 2]> = answers.iter().map(|answer| [answer.since, answer.call]).collect();
        assert_eq!(answered, [[3, 4], [4, 5], [5, 6]]);
        assert!(answers.iter().all(|answer| answer.change == 0.0));
        assert_eq!(pass.ask(&gpu, &mut watch), 9);
        let [answer] = pass.answers(&gpu, true).unwrap()[..] else { panic!("one answer") };
        let wanted = change::reference::change(&before, &now);
        assert_eq!((answer.since, answer.call, wanted > 0.0), (6, 9, count > 0));
        assert!((answer.change - wanted).abs() <= change::TOLERANCE * wanted);
        gpu.write(&e_ind, &vec![Vec4::splat(f32::NAN); count]);
        let call = pass.ask(&gpu, &mut watch);
        let [answer] = pass.answers(&gpu, true).unwrap()[..] else { panic!("one answer") };
        assert_eq!((answer.call, answer.change.is_finite()), (call, count == 0));
    }
}

#[test]
#[ignore = "needs a graphics adapter"]
fn atlas_agrees_with_the_reference() {
    let gpu = Gpu::open().unwrap();
    let stage = Stage::new(&gpu, fixture_light());
    let [emit, ind] = [7, 8].map(|seed| positive_noise(stage.receivers(), seed));
    gpu.write(&stage.passes.resident.e_emit, &emit);
    gpu.write(&stage.passes.resident.e_ind, &ind);
    gpu.submit(|encoder| stage.passes.publish(&mut Recorder::untimed(encoder)));
    let wanted = atlas::reference::spread(&stage.scene.lightmap, &stage.light.texels, &emit, &ind);
    let texture = &stage.passes.atlas.texture;
    let stride = texture.width() as usize;
    for (page, (texels, size)) in wanted.pages.iter().zip(&wanted.sizes).enumerate() {
        let layer: Vec<Vec4> = gpu.read_layer(texture, page as u32, wgpu::TextureAspect::All).unwrap();
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
#[ignore = "needs a graphics adapter"]
fn shade_agrees_with_the_reference_on_the_same_maps_and_light() {
    let gpu = Gpu::open().unwrap();
    let bakes = [
        fixture::prt_bake(&fixture::prt_contents()),
        super::facing::bake(),
        super::facing::glazed_bake(),
        fixture::walked_bake(),
    ];
    let sun = parse_light("sun dir=0.3,-0.8,0.4 irradiance=3").unwrap();
    // So small a side gives suns cascades.
    let with_cascades = |view: View| View { lights: vec![sun.clone()], shadow_side: 128, ..view };
    let views = [
        (&bakes[0], view_of(&bakes[0])),
        (&bakes[0], with_cascades(view_of(&bakes[0]))),
        (&bakes[1], view_of(&bakes[1])),
        (&bakes[2], view_of(&bakes[2])),
        (&bakes[2], with_cascades(view_of(&bakes[2]))),
        (&bakes[0], View { lights: rects(), ..view_of(&bakes[0]) }),
        (&bakes[3], view_of(&bakes[3])),
    ];
    for (bake, view) in views {
        let prepared = prepared(bake, &view);
        let mut frame = frame_of(&gpu, bake, &view).unwrap();
        let limit = lightkiln_proto::relight::Limit { bounces_max: 3, change_max: 0.0 };
        frame.settle(limit).unwrap();
        let maps = frame.shadow.read(&gpu).unwrap();
        let mut settled = bake.light.settle(&prepared.lit(&maps), &Among::default(), limit);
        for jitter in [[0.0, 0.0], [0.375, -0.125]] {
            agree_on_a_picture(bake, &view, &mut frame, &mut settled, &maps, jitter);
        }
    }
}

fn agree_on_a_picture(
    bake: &LoadedBake,
    view: &View,
    frame: &mut Frame<'_>,
    settled: &mut crate::bake::SettledLight<'_>,
    maps: &shadow::reference::ShadowMaps,
    jitter: [f32; 2],
) {
    let prepared = prepared(bake, view);
    let (scene, bounds_m) = (&bake.scene, bake.scene.manifest.bounds_m);
    let shade_view = ShadeView::new(&view.camera, view.size(), bounds_m, prepared.sky, jitter).unwrap();
    frame.draw(jitter).unwrap();
    let got = frame.read().unwrap();
    settled.indirect.prepare_view(&shade_view, view.size());
    let (indirect, emitter_scale) = (&*settled.indirect, &view.emitter_scale[..]);
    let panorama = view.panorama.as_deref();
    let lit =
        Lit { scene, plan: &prepared.plan, maps, indirect, panorama, emitter_scale, fog: None, walked: None };
    let wanted = shade::reference::shade(lit, &shade_view, view.size());
    held("shade", &Difference::of_mean(&got, &wanted, shade::TOLERANCE), shade::OUTLIERS);
    let sky = |pixels: &[Vec4]| pixels.iter().filter(|pixel| pixel.w < 0.5).count();
    let (drawn, found) = (sky(&wanted), sky(&got));
    assert!(drawn > 100 && drawn.abs_diff(found) < 40, "{drawn} {found}");
}

#[test]
#[ignore = "needs a graphics adapter"]
fn whole_pictures_of_adapter_and_processor_agree() {
    let [patches, narrow] =
        [fixture::prt_contents(), fixture::narrow_contents()].map(|contents| fixture::prt_bake(&contents));
    for bake in [patches, narrow, fixture::sh_bake(), super::facing::bake(), super::facing::glazed_bake()] {
        let view = view_of(&bake);
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
