//! The reader's hand on the page: skies and objects are dropped, turned, dragged, played and taken away.

use serde_json::{Value, json};

use super::bundle::Bundle;
use super::files::Answer;
use super::objects::toy::toy;
use super::{browser_at, bundle_opened, served, skies};

const MODULE: &str = "/pages/hand.js";
/// Place of a drop on the picture of 160 × 120 pixels: the floor before Cornell's boxes.
const PLACE: [u32; 2] = [66, 104];

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

#[test]
#[ignore = "needs chromium"]
fn chromium_loses_no_work_by_that_of_another_kind() {
    let server = served(|_| None);
    let told = browser_at(&server).run(MODULE, "turns", json!([]));
    assert_eq!(told["ran"], json!(["second picture", "second turn", "third picture"]));
    let ends = json!([["how", null], ["picture", "no picture"], ["how", null], ["picture", null]]);
    assert_eq!(told["told"], ends);
}

#[test]
#[ignore = "needs chromium"]
fn chromium_turns_and_scales_a_sky_by_the_pages_sliders() {
    let bundle = Bundle::cornell();
    let (_files, browser) = bundle_opened(&bundle, sky_and_toy);
    let found = browser.run(MODULE, "sky", json!(["/bundle"]));
    println!("{found:#}");
    let names = found["names"].as_array().expect("names");
    assert_eq!(names.last(), Some(&json!("three.hdr")), "{names:?}");
    assert!(number(&found["lit"]["ratio"]) > 1.01, "the sky sends no light");
    assert_eq!(found["turned"]["how"], json!({ "turnDeg": 90, "strength": 1 }));
    assert!(number(&found["turned"]["apart"]) > 0.01, "a turn changes nothing");
    assert!(number(&found["back"]["apart"]) < 0.005, "a turn back is none");
    assert_eq!(found["brighter"]["how"], json!({ "turnDeg": 0, "strength": 4 }));
    assert!(number(&found["brighter"]["ratio"]) > 1.02);
    assert_eq!(found["dark"]["how"]["strength"], 0);
    assert!(number(&found["unlit"]["apart"]) < 0.01, "a sky without strength sends light");
    assert!(found["told"].as_str().is_some_and(|told| told.contains("wrong.hdr")), "{}", found["told"]);
    let gone = &found["gone"];
    assert!(gone[0].is_null() && gone[1] == true && number(&gone[2]["apart"]) < 0.01, "{gone}");
}

#[test]
#[ignore = "needs chromium"]
fn chromium_drops_drags_plays_and_removes_an_object() {
    let bundle = Bundle::cornell();
    let (_files, browser) = bundle_opened(&bundle, sky_and_toy);
    let found = browser.run(MODULE, "objects", json!(["/bundle", PLACE]));
    println!("{found:#}");
    // It stands on the floor of Cornell's box where it was dropped.
    let [at, to] = [&found["stands"]["at"], &found["dragged"]["at"]];
    assert!(number(&found["stands"]["low"]).abs() < 1e-3, "{}", found["stands"]);
    assert!((-4.0..-1.0).contains(&number(&at[2])), "{at}");
    assert!(number(&found["shadow"]["ratio"]) < 0.97, "its shadow changes no light: {}", found["shadow"]);
    // A drag to the right moves it along the floor, and the camera stays.
    assert!(number(&to[0]) - number(&at[0]) > 0.05, "{at} to {to}");
    assert!((number(&to[1]) - number(&at[1])).abs() < 1e-6 && found["dragged"]["isEyeSame"] == true, "{to}");
    let turned = &found["turned"];
    assert!(
        (number(&turned[0]) - 90.0).abs() < 1e-3 && (number(&turned[1]) - 8.0_f64.sqrt()).abs() < 1e-3,
        "{turned}"
    );
    assert_eq!(found["played"], json!([true, true]));
    assert_eq!(found["timeS"], 1.0, "half of the first animation");
    assert_eq!(found["made"], 0, "an object that moves makes nothing");
    assert!(found["told"].as_str().is_some_and(|told| told.contains("no.glb")), "{}", found["told"]);
    assert_eq!([&found["kept"], &found["left"]], [&json!(1), &json!(0)]);
    assert!(number(&found["gone"]["apart"]) < 0.01, "{}", found["gone"]);
}

fn sky_and_toy(request: &super::files::Request) -> Option<Answer> {
    match request.path.as_str() {
        "/sky.hdr" => Some(Answer::of(skies::file())),
        "/toy.glb" => Some(Answer::of(toy(None, 1.0).glb())),
        _ => None,
    }
}
