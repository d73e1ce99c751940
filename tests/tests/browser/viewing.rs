//! A bake on a canvas: light comes in stages, the lamp and the camera follow the hand.

use lightkiln_client::web::shaders;
use serde_json::{Value, json};

use super::bundle::Bundle;
use super::files::{Answer, Files};
use super::{browser_at, served};

fn numbers(json: &Value) -> Vec<f64> {
    json.as_array().expect("a list").iter().map(|number| number.as_f64().expect("a number")).collect()
}

/// A server of a bundle below `/bake`, and of shaders.
fn serving(bundle: &Bundle) -> Files {
    let folder = bundle.folder().to_owned();
    served(move |request| {
        if let Some(file) = request.path.strip_prefix("/bake/") {
            return Some(std::fs::read(folder.join(file)).map_or_else(|_| Answer::empty(404), Answer::of));
        }
        let name = request.path.strip_prefix("/web/shaders/")?.strip_suffix(".wgsl")?.to_owned();
        let (_, text) = shaders().into_iter().find(|(found, _)| *found == name)?;
        Some(Answer::of(text.into_owned().into_bytes()))
    })
}

#[test]
#[ignore = "needs chromium"]
fn chromium_ends_the_opening_of_a_bake_whose_device_is_lost_meanwhile() {
    let bundle = Bundle::cornell();
    let files = serving(&bundle);
    let found = browser_at(&files).run("/pages/view.js", "lost", json!(["/bake"]));
    let message = found["message"].as_str().expect("words");
    assert!(message.contains("graphics device is gone"), "{message}");
    assert_eq!(found["words"], json!(["reading the scene"]), "nothing is drawn on it");
    assert_eq!(found["workers"], 0, "Workers live on");
}

#[test]
#[ignore = "needs chromium"]
fn chromium_shows_a_bake_that_follows_lamp_and_camera() {
    let bundle = Bundle::cornell();
    let files = serving(&bundle);
    let found = browser_at(&files).run("/pages/view.js", "view", json!(["/bake"]));
    assert_eq!(found["failures"], json!([]));
    assert_eq!(found["size"], json!([160, 120]));
    let [first, clusters] = ["first", "clusters"].map(|name| numbers(&found[name]));
    assert!(
        first[0] < first[1] && clusters[0] == clusters[1] && clusters[1] > 24.0,
        "{first:?} {clusters:?}"
    );
    let [whole, off] = ["whole", "off"].map(|name| found[name].as_f64().expect("a number"));
    assert!(off > 0.0 && whole > 1.02 * off, "{whole} with the lamp, {off} without");
    let painted = &found["painted"];
    assert_eq!(painted["names"], json!(["white", "red", "green", "panel"]));
    let [black, again] = ["black", "again"].map(|name| painted[name].as_f64().expect("a number"));
    assert!(black < 0.7 * whole && (again / whole - 1.0).abs() < 0.02, "{whole}, {black}, {again}");
    let detail = &found["detail"];
    let said = |name: &str| detail[name].as_str().expect("words").to_owned();
    assert!(said("coarse").contains("% of the receivers"), "{detail}");
    assert!(said("wrong").contains("'rough' is not key=value") && detail["kept"] == true, "{detail}");
    assert!(said("all").is_empty() && detail["counts"].is_null(), "{detail}");
    let [in_detail, again] = ["inDetail", "again"].map(|name| detail[name].as_f64().expect("a number"));
    assert!((in_detail / whole - 1.0).abs() < 0.1 && (again / whole - 1.0).abs() < 0.02, "{whole}, {detail}");
    let moved = numbers(&found["moved"]);
    assert!(moved.iter().map(|by| by * by).sum::<f64>().sqrt() > 0.05, "{moved:?}");
    let turned = numbers(&found["turned"]);
    assert!(turned.iter().map(|by| by * by).sum::<f64>().sqrt() > 0.05, "{turned:?}");
}

#[test]
#[ignore = "needs chromium"]
fn chromium_shows_a_lone_triangle_darkness_and_windows_without_size_and_says_that_a_device_is_gone() {
    for bundle in [Bundle::cornell(), Bundle::triangle()] {
        let files = serving(&bundle);
        let found = browser_at(&files).run("/pages/view.js", "odd", json!(["/bake"]));
        assert_eq!(found["early"], json!([]));
        let mean = |of: &Value| of.as_f64().expect("a finite number");
        let whole = mean(&found["whole"]);
        assert!(whole > 0.0 && mean(&found["dark"]) < 1e-3 * whole, "{found}");
        for name in ["none", "again"] {
            assert_eq!(found[name]["size"], json!([160, 120]), "{name}");
            assert!((mean(&found[name]["mean"]) / whole - 1.0).abs() < 0.02, "{name}: {found}");
        }
        assert_eq!(found["line"]["size"], json!([160, 1]));
        assert!(mean(&found["line"]["mean"]) >= 0.0);
        let end = found["end"].as_str().expect("words");
        assert!(end.contains("graphics device is gone") && end.contains("open the page again"), "{end}");
    }
}
