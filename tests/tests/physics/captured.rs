//! Light that probes capture under the lights of the scene's file, beside closed forms and the same probes relit.

use std::collections::BTreeMap;
use std::f32::consts::PI;

use glam::{Vec3, Vec4};
use lightkiln_proto::harmonics::relight_direction;
use lightkiln_proto::kinds::{captured, grid};
use lightkiln_tests::harness::{self, Held, Recipe, bake};
use lightkiln_tests::scenes;
use lightkiln_worker::evaluate::{EvaluationError, Evaluator, Options};
use lightkiln_worker::factors::Threads;
use lightkiln_worker::kinds::BakeKinds;
use lightkiln_worker::reference::{Lighting, Precision, luminance};
use lightkiln_worker::task::Progress;
use serde_json::json;

/// Places probes that capture light, so far apart.
fn recipe(structure: u32, spacing_m: f32) -> Recipe {
    let settings = json!({
        "preset": "draft",
        "field_structure": structure,
        "field_spacing_m": spacing_m,
        "probe_rays": 1024,
        "field_paths": 2,
        "field_rank_error": 0.002,
    });
    Recipe { kind: captured::NAME, settings }
}

#[test]
fn white_furnace_is_captured_as_bright_as_it_is() {
    let albedo = 0.5;
    for structure in [0, 1] {
        let bake = bake(scenes::furnace(albedo, 1.0, 4.0), &recipe(structure, 1.0)).unwrap();
        assert!(bake.manifest.lightmap.is_none());
        let (table, rows) = harness::captured(&bake).unwrap();
        let wanted = PI / (1.0 - albedo);
        let found = (0..table.len()).flat_map(|probe| {
            let position_m = table.position_m[probe].truncate();
            let (table, rows) = (&table, &rows);
            (0..8).map(move |index| table.irradiance(rows, position_m, relight_direction(index, 8)).y)
        });
        let found: Vec<f32> = found.map(|light| light / wanted).collect();
        let mean = found.iter().sum::<f32>() / found.len() as f32;
        let worst = found.iter().map(|light| (light - 1.0).abs()).fold(0.0, f32::max);
        println!("structure {structure}: {} probes, mean {mean:.4}, worst {worst:.4}", table.len());
        assert!(
            (mean - 1.0).abs() < 0.01 && worst < 0.1,
            "{mean} of what is wanted, at worst off by {worst}"
        );
    }
}

#[test]
fn captured_light_is_that_of_the_same_probes_relit() {
    let spacing_m = 0.75;
    let of_surfaces = json!({
        "preset": "draft",
        "receivers_target": 40_000,
        "field_spacing_m": spacing_m,
        "probe_rays": 2048,
        "field_rank_error": 0.001,
        "field_fit": 0,
    });
    let relit =
        Held::new(scenes::two_rooms(0.02), &Recipe { kind: grid::NAME, settings: of_surfaces }).unwrap();
    let lights = relit.world.geometry.scene.lights.clone();
    assert!(!lights.is_empty());
    let lit = relit.under(&Lighting { lights, emitter_scale: 1.0, ..Lighting::default() }).unwrap();
    let table = relit.decoded.field(&relit.bake).unwrap();
    let light = lit.light();
    let rows = table.relit(&Threads, &light.settled.lambda, &light.emitter_scale);
    let captured = bake(scenes::two_rooms(0.02), &recipe(0, spacing_m)).unwrap();
    let (still, still_rows) = harness::captured(&captured).unwrap();
    let sorted = |of: &[Vec4]| {
        let mut places: Vec<[u32; 4]> =
            of.iter().map(|position_m| position_m.to_array().map(f32::to_bits)).collect();
        places.sort_unstable();
        places
    };
    assert!(sorted(&table.position_m) == sorted(&still.position_m), "other probes");
    let of_dark = |position_m: &Vec3| position_m.x > 0.03;
    let (mut squares, mut sums, mut count) = (0.0, [0.0; 2], 0.0);
    for position_m in table.position_m.iter().map(|position_m| position_m.truncate()) {
        for normal in [Vec3::X, Vec3::Y, Vec3::Z].into_iter().flat_map(|axis| [axis, -axis]) {
            let read = [
                table.irradiance(&rows, position_m, normal),
                still.irradiance(&still_rows, position_m, normal),
            ];
            let [a, b] = read.map(|light| luminance(light.as_dvec3()));
            assert!(!of_dark(&position_m) || b == 0.0, "{b} in the dark room, at {position_m}");
            squares += (a - b).powi(2);
            sums = [sums[0] + a, sums[1] + b];
            count += 1.0;
        }
    }
    let [energy, error] = [sums[1] / sums[0], f64::sqrt(squares / count) / (sums[0] / count)];
    println!("{} probes: {energy:.4} of the energy, {error:.4} of the mean apart", table.len());
    assert!((energy - 1.0).abs() < 0.03, "{energy} of the energy");
    assert!(error < 0.03, "{error} of the mean apart");
}

#[test]
fn faces_of_thin_walls_have_no_light_of_the_other_side() {
    for (structure, thickness_m) in [(0, 0.02), (0, 0.0), (1, 0.02), (1, 0.0)] {
        let bake = bake(scenes::two_rooms(thickness_m), &recipe(structure, 0.5)).unwrap();
        let (table, rows) = harness::captured(&bake).unwrap();
        let half_m = 0.5 * thickness_m;
        let face = |side: f32, at: u16| {
            let [y_m, z_m] = [at / 20, at % 20].map(|at| 0.075 + 0.15 * f32::from(at));
            let place_m = Vec3::new(side * half_m, y_m, z_m - 1.5);
            let normal = Vec3::X * side;
            luminance(table.irradiance(&rows, table.raised(place_m, normal), normal).as_dvec3())
        };
        let mean = |side: f32| (0..400).map(|at| face(side, at)).sum::<f64>() / 400.0;
        let [lit, dark] = [mean(-1.0), mean(1.0)];
        println!("structure {structure}, {thickness_m} m: {dark} beside {lit}");
        assert!(
            lit > 0.1 && dark <= 1e-3 * lit,
            "structure {structure}, {thickness_m} m: {dark} beside {lit}"
        );
    }
}

#[test]
fn captured_light_has_the_same_bytes_on_any_number_of_threads() {
    for structure in [0, 1] {
        let fitted = recipe(structure, 1.0).with("field_fit", 1).with("probe_rays", 128);
        let baked = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| bake(scenes::two_rooms(0.02), &fitted).unwrap().manifest_bytes)
        };
        assert!(baked(1) == baked(3), "structure {structure}");
    }
}

/// Classes of error of captured light in space, over the mean of the reference.
fn classes(settings: &[(&str, serde_json::Value)]) -> BTreeMap<&'static str, f64> {
    let all = settings.iter().fold(recipe(0, 0.75), |recipe, (name, value)| recipe.with(name, value.clone()));
    let scene = scenes::two_rooms(0.02);
    let bake = bake(scene.clone(), &all).unwrap();
    let bytes = |digest| {
        bake.chunk(digest).map_err(|error| EvaluationError::Missing { digest, source: error.into() })
    };
    let progress = Progress::new();
    let bake = BakeKinds::new().evaluated(&bake.manifest, scene, &bytes, &progress).unwrap();
    let space = bake.in_space().unwrap();
    let light = space.own_light().unwrap();
    let precision = Precision { rel_error: 0.05, ..Precision::default() };
    let options = Options { receivers: 240, precision, pixels: 0, ..Options::default() };
    let evaluator = Evaluator::new(space, std::slice::from_ref(&light), options, &progress).unwrap();
    let result = evaluator.measure(&light, &progress).unwrap();
    let all = result.figures.rel_rmse;
    println!("{settings:?}: {all:.3}");
    result
        .classes
        .iter()
        .map(|class| (class.name, class.rel_rmse))
        .inspect(|class| println!("{class:?}"))
        .collect()
}

#[test]
fn classes_of_error_grow_with_their_causes() {
    let usual = classes(&[]);
    let noisy = classes(&[("probe_rays", 64.into()), ("field_rank_error", 0.3.into())]);
    assert!(
        noisy["held"] > 1.5 * usual["held"],
        "fewer rays and digits: {} {}",
        noisy["held"],
        usual["held"]
    );
    assert!(noisy["interpolation"] < 1.2 * usual["interpolation"], "{}", noisy["interpolation"]);
    let wide = classes(&[("field_spacing_m", 1.5.into())]);
    assert!(wide["interpolation"] > 1.3 * usual["interpolation"], "{}", wide["interpolation"]);
    assert!(wide["angular"] < 1.2 * usual["angular"], "{} {}", wide["angular"], usual["angular"]);
    // Without depth maps light of the lit room would be in the dark one.
    assert!(usual["valid"] > 1.5 * usual["exact"] && usual["visibility"] < usual["exact"]);
}
