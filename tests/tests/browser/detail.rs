//! Levels of detail in the browser: words, plans and the table behind them are those of the contract, and stay while light comes.

use glam::Vec3;
use lightkiln_client::fetch::Source;
use lightkiln_client::kinds::prt;
use lightkiln_client::scene::LoadedScene;
use lightkiln_proto::relight::{Detail, LodEye, LodPlan, LodView, StandIn};
use lightkiln_proto::words::lod_from_text;
use serde_json::{Value, json};

use super::bundle::Bundle;
use super::{browser_at, bundle_opened, bytes_of_hex, served};

const MODULE: &str = "/pages/detail.js";
/// Levels that meet within small scenes.
const SETTINGS: [&str; 7] = [
    "fine",
    "balanced",
    "coarse",
    "level0=0,0,all,0,1 level1=0.3,1,16,1,1 level2=0.5,1,8,2,2 level3=0.7,1,8,3,4",
    "coarse level1=0.5m,3,8,1,2 level2=1.25m,4,24,2,16 level3=inf,5,all,3,2 margin=0.5",
    "level2=0.3,3,16,3,2 beside=3 behind=9 blend=1",
    "level0=0,0,all,3,1 level1=0,0,all,3,1 level2=0,0,all,3,1 level3=0,0,all,3,1 blend=0",
];
/// Words that are none.
const WRONG: [&str; 14] = [
    "rough",
    "level1=0.5,3,16,1",
    "level1=0.5,3,16,1,2,3",
    "level1=,3,16,1,2",
    "level1=0x10,3,16,1,2",
    "level1=0.5,3,16,1,3",
    "level1=0.5,3,16,4,1",
    "level1=0.5,3,0,1,1",
    "level1=0.5,16,8,1,1",
    "coarse level1=0.1,3,8,3,2",
    "coarse beside=0.5",
    "coarse beside=4 behind=2",
    "coarse blend=1 blend=1",
    "coarse level4=0,1,2,3,4",
];

/// Eyes on a way through bounds and out of them, forth and back.
fn eyes([low, high]: [Vec3; 2]) -> Vec<LodEye> {
    let at = |step: i32| {
        let share = 0.07 * (12 - (step - 12).abs()) as f32;
        let forward = Vec3::new((0.7 * step as f32).cos(), 0.1, (0.7 * step as f32).sin()).normalize();
        let position_m = low + (high - low) * Vec3::new(share, 0.4, 1.3 - share);
        LodEye { position_m, forward, view_cos: 0.77, diagonal_m: low.distance(high) }
    };
    (0..24).map(at).collect()
}

fn numbers(hex: &Value) -> Vec<u32> {
    let word = |four: &[u8]| u32::from_le_bytes(four.try_into().unwrap());
    bytes_of_hex(hex).chunks_exact(4).map(word).collect()
}

fn words_of_stand_in(StandIn { slot, cluster, sources: [a, b, c, d] }: &StandIn) -> [u32; 6] {
    [*slot, *cluster, *a, *b, *c, *d]
}

fn words_of_detail(detail: &Detail) -> [u32; 9] {
    let &Detail { first_row, row_count, rows, wide, bytes, rest, groups, level, interval } = detail;
    [first_row, row_count, rows, wide, bytes, rest, groups, level, interval]
}

fn words_of_view(view: &LodView) -> Vec<u32> {
    let LodView { position_m, view_cos, forward, beside, starts_m, behind, ends_m, pad } = view;
    let vectors = [(position_m, view_cos), (forward, beside), (starts_m, behind), (ends_m, pad)];
    vectors
        .iter()
        .flat_map(|(vector, last)| vector.iter().chain([*last]))
        .map(|value| value.to_bits())
        .collect()
}

/// Holds the plans of a bundle in the browser against those of the contract; the levels that were seen.
fn plans_agree(bundle: &Bundle) -> Vec<u8> {
    let source = Source::bundle(bundle.folder()).unwrap();
    let scene = LoadedScene::load(&source).unwrap();
    let light = prt::load(&source, &scene).unwrap();
    let (table, clusters) = (light.lod(), &light.transport.clusters);
    let eyes = eyes(scene.manifest.bounds_m.map(Vec3::from));
    let of_page = |eye: &LodEye| {
        let LodEye { position_m, forward, view_cos, diagonal_m } = eye;
        json!({
            "positionM": position_m.to_array(), "forward": forward.to_array(),
            "viewCos": view_cos, "diagonalM": diagonal_m,
        })
    };
    let eyes_of_page: Vec<Value> = eyes.iter().map(of_page).collect();
    let (_files, browser) = bundle_opened(bundle, |_| None);
    let told = browser.run(MODULE, "plans", json!([SETTINGS, eyes_of_page]));
    assert_eq!(numbers(&told["order"]), table.order);
    for (level, wanted) in table.stand_ins.iter().enumerate() {
        assert!(!wanted.is_empty(), "level {level} has no stand-ins: the comparison is of nothing");
        let words: Vec<u32> = wanted.iter().flat_map(words_of_stand_in).collect();
        assert_eq!(numbers(&told["standIns"][level]), words, "level {level}");
    }
    let mut seen = Vec::new();
    for (words, plans) in SETTINGS.iter().zip(told["planned"].as_array().unwrap()) {
        let lod = lod_from_text(words).unwrap();
        let mut before: Option<LodPlan> = None;
        for (step, (eye, got)) in eyes.iter().zip(plans.as_array().unwrap()).enumerate() {
            let plan = table.plan(clusters, &lod, *eye, before.as_ref());
            assert_eq!(got["levels"], json!(plan.levels), "'{words}', eye {step}");
            let details: Vec<u32> = plan.details.iter().flat_map(words_of_detail).collect();
            assert_eq!(numbers(&got["details"]), details, "'{words}', eye {step}");
            assert_eq!(numbers(&got["view"]), words_of_view(&plan.view), "'{words}', eye {step}");
            assert_eq!(got["cycle"], json!(plan.cycle()));
            for (got, wanted) in got["counts"].as_array().unwrap().iter().zip(plan.counts(clusters)) {
                assert_eq!(got["receiversComputed"], wanted.receivers_computed);
                assert_eq!([&got["numbersRead"], &got["numbers"]], [wanted.numbers_read, wanted.numbers]);
            }
            seen.extend(&plan.levels);
            before = Some(plan);
        }
    }
    seen
}

#[test]
#[ignore = "needs chromium"]
fn chromium_plans_levels_of_detail_to_the_numbers_of_rust() {
    for bundle in [Bundle::cornell(), Bundle::flat()] {
        let seen = plans_agree(&bundle);
        for level in 0..4 {
            assert!(seen.contains(&level), "no cluster was ever of level {level}");
        }
    }
}

#[test]
#[ignore = "needs chromium"]
fn chromium_refuses_words_of_detail_as_rust_does() {
    let files = served(|_| None);
    let texts: Vec<&str> = WRONG.iter().chain(&SETTINGS).copied().collect();
    let told = browser_at(&files).run(MODULE, "refusals", json!([texts]));
    let wanted: Vec<Option<String>> =
        texts.iter().map(|text| lod_from_text(text).err().map(|error| error.to_string())).collect();
    assert!(wanted[..WRONG.len()].iter().all(Option::is_some));
    assert_eq!(told, json!(wanted));
}

#[test]
#[ignore = "needs chromium and a graphics adapter"]
fn chromium_keeps_levels_of_detail_while_light_comes() {
    let bundle = Bundle::flat();
    let (_files, browser) = bundle_opened(&bundle, |_| None);
    let told = browser.run(MODULE, "growing", json!([SETTINGS[3]]));
    assert_eq!(told["errors"], json!([]));
    assert!(told["refusal"].as_str().is_some_and(|words| words.contains("'rough'")), "{}", told["refusal"]);
    let found = told["found"].as_array().unwrap();
    assert!(found[0].is_null() && found[1].as_u64() > Some(0) && found[1] != found[2], "{found:?}");
    assert_eq!(found[2], told["all"]);
    let differences: Vec<f64> = serde_json::from_value(told["differences"].clone()).unwrap();
    println!("in detail, one apart, both whole, in detail elsewhere: {differences:?}");
    // Clusters that take turns settle within the limit, each its own way.
    assert!(differences[0] < 1e-3 && differences[2] < 1e-3, "{differences:?}");
    assert!(differences[3] > 0.01, "{differences:?}");
    assert_eq!(told["made"], 0, "what changes makes nothing");
}
