//! A bake that goes on, in the browser: clusters as they land, and at its end the light of a bake that is done.

use std::path::Path;
use std::sync::{Arc, Mutex};

use lightkiln_client::fetch::{MANIFEST_FILE, Source, chunk_path, outline_of};
use lightkiln_client::web::shaders;
use lightkiln_proto::chunk::encode_directory;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::kinds::prt::tasks;
use lightkiln_proto::kinds::{Kinds, OUTLINE_OUTPUT, PAGE_OUTPUT, UnderWay};
use lightkiln_proto::manifest::{CLUSTERS, Manifest};
use serde_json::{Value, json};

use super::bundle::Bundle;
use super::files::{Answer, Files};
use super::{browser_at, root, served};

/// Cells of the bake; each has every so many of its clusters, the last none.
const CELLS: usize = 4;

/// A bake as a server tells of it.
#[derive(Default)]
struct Told {
    /// Cells that have landed, the last first.
    landed: usize,
    state: &'static str,
    /// Fault of a cluster's chunk, or of the plan.
    fault: &'static str,
}

fn stored(folder: &Path, name: &str, bytes: &[u8]) -> Value {
    let digest = Digest::of(bytes);
    std::fs::write(chunk_path(folder, digest), bytes).unwrap();
    json!({ "name": name, "digest": digest, "bytes": bytes.len() })
}

/// Results of the bake: of its outline, and of its cells in the order in which they land.
fn results(folder: &Path) -> Vec<Value> {
    let (_, manifest) = Source::bundle(folder).unwrap().manifest().unwrap();
    let outline = outline_of(&manifest);
    let mut body = manifest.body.clone();
    body["totals"]["clusters"] = json!(0);
    let outline = Manifest { body, ..outline }.stored().unwrap();
    let result = |kind: &str, number: usize, output: Value| {
        json!({ "place": 5 + 2 * number, "key": Digest::of(&number.to_le_bytes()), "kind": kind,
            "label": format!("cluster {number}"), "outputs": [output] })
    };
    let mut all = vec![result(tasks::PLAN.name, 0, stored(folder, OUTLINE_OUTPUT, &outline.json))];
    for cell in (0..CELLS).rev() {
        let of_cell = |index: &usize| cell + 1 < CELLS && index % (CELLS - 1) == cell;
        let own: Vec<usize> = (0..manifest.clusters.len()).filter(of_cell).collect();
        let rows: Vec<_> = own.iter().map(|index| manifest.clusters[*index].clone()).collect();
        let chunks: Vec<_> = own.iter().map(|index| manifest.chunks(CLUSTERS)[*index].clone()).collect();
        let page = stored(folder, PAGE_OUTPUT, &encode_directory(&rows, &chunks).unwrap());
        all.push(result(tasks::COLOUR.name, CELLS - cell, page));
    }
    all
}

/// A server of the bake. Calls of `/land/N/STATE` say how many cells have landed from then on, and the bake's state; those of
/// `/fault/FAULT` whether bytes of a cluster are gone, or damaged, or the plan
/// gave no outline, or pages of results end where they begin.
fn serving(bundle: &Bundle) -> Files {
    let folder = bundle.folder().to_owned();
    let results = results(&folder);
    let (_, manifest) = Source::bundle(&folder).unwrap().manifest().unwrap();
    // A cluster of the first cell that lands with some.
    let faulty = manifest.chunks(CLUSTERS)[CELLS - 2].digest;
    let told = Arc::new(Mutex::new(Told { state: "running", ..Told::default() }));
    let bytes = |path: &Path| Some(std::fs::read(path).map_or_else(|_| Answer::empty(404), Answer::of));
    served(move |request| {
        let mut told = told.lock().unwrap();
        if let Some(now) = request.path.strip_prefix("/land/") {
            let (landed, state) = now.split_once('/')?;
            let states = ["running", "done", "failed"];
            told.state = states.into_iter().find(|known| *known == state)?;
            told.landed = landed.parse().ok()?;
            return Some(Answer::of(Vec::new()));
        }
        if let Some(query) = request.path.strip_prefix("/v1/bakes/bake/results?") {
            let value = |name: &str| query.split('&').find_map(|part| part.strip_prefix(name)).unwrap();
            let (kind, after): (&str, u64) = (value("kind="), value("after=").parse().unwrap());
            let wanted = |result: &&Value| result["kind"] == kind && result["place"].as_u64() > Some(after);
            let found: Vec<&Value> = results[..=told.landed].iter().filter(wanted).take(2).collect();
            if told.fault == "unplanned" && kind == tasks::PLAN.name {
                let old =
                    json!([{ "place": 1, "key": "0", "kind": kind, "label": "clusters", "outputs": [] }]);
                let page =
                    json!({ "results": old, "next_after": 1, "bake": { "state": told.state, "stages": [] } });
                return Some(Answer::of(page.to_string().into_bytes()));
            }
            let last = results[told.landed]["place"].as_u64();
            let next_after = found.get(1).map_or(last, |result| result["place"].as_u64()).max(Some(after));
            let next_after = if told.fault == "still" { Some(after) } else { next_after };
            let stages = json!([{ "kind": tasks::COLOUR.name, "total": CELLS }]);
            let bake = json!({ "state": told.state, "failure": "no ray meets anything", "stages": stages });
            let page = json!({ "results": found, "next_after": next_after, "bake": bake });
            return Some(Answer::of(page.to_string().into_bytes()));
        }
        if let Some(now) = request.path.strip_prefix("/fault/") {
            told.fault =
                ["none", "gone", "damaged", "unplanned", "still"].into_iter().find(|known| *known == now)?;
            return Some(Answer::of(Vec::new()));
        }
        if let Some(digest) = request.path.strip_prefix("/v1/chunks/") {
            let digest: Digest = digest.parse().ok()?;
            let path = chunk_path(&folder, digest);
            return match told.fault {
                "gone" if digest == faulty => Some(Answer::empty(404)),
                "damaged" if digest == faulty => {
                    let mut bytes = std::fs::read(&path).ok()?;
                    *bytes.last_mut()? ^= 1;
                    Some(Answer::of(bytes))
                }
                _ => bytes(&path),
            };
        }
        if let Some(name) = request.path.strip_prefix("/web/shaders/") {
            let name = name.strip_suffix(".wgsl")?;
            let (_, text) = shaders().into_iter().find(|(found, _)| *found == name)?;
            return Some(Answer::of(text.into_owned().into_bytes()));
        }
        (request.path == "/v1/bakes/bake/manifest").then(|| bytes(&folder.join(MANIFEST_FILE)))?
    })
}

#[test]
fn browsers_follow_the_tasks_that_the_kind_names() {
    let UnderWay { outline, clusters } = Kinds::new().default_kind().under_way().unwrap();
    let text = std::fs::read_to_string(root().join("client/web/relight/following.js")).unwrap();
    let tasks = format!("TASKS = {{ outline: \"{outline}\", clusters: \"{clusters}\" }}");
    assert!(text.contains(&tasks), "wanted {tasks}");
    let outputs = format!("OUTPUTS = {{ outline: \"{OUTLINE_OUTPUT}\", page: \"{PAGE_OUTPUT}\" }}");
    assert!(text.contains(&outputs), "wanted {outputs}");
}

#[test]
#[ignore = "needs chromium"]
fn chromium_takes_clusters_as_they_land_and_ends_with_the_light_of_a_load_at_once() {
    for bundle in [Bundle::cornell(), Bundle::flat()] {
        let files = serving(&bundle);
        let browser = browser_at(&files);
        for workers in [0, 2] {
            let found = browser.run("/pages/landing.js", "landed", json!([CELLS, workers]));
            let steps = found["steps"].as_array().unwrap();
            assert_eq!(steps.len(), CELLS + 1);
            let clusters: Vec<u64> = steps.iter().map(|step| step["clusters"][0].as_u64().unwrap()).collect();
            assert!(clusters[..2] == [0, 0] && clusters[1..].is_sorted_by(|a, b| a < b), "{clusters:?}");
            for (cells, step) in steps.iter().enumerate() {
                assert_eq!(step["cells"], json!([cells, CELLS]), "{step}");
                assert_eq!((&step["isWhole"], &step["clusters"][0]), (&json!(false), &step["clusters"][1]));
            }
            assert_eq!(found["ended"], json!([true, clusters[CELLS], clusters[CELLS]]));
            assert_eq!(found["light"], found["whole"], "with {workers} Workers");
            let early = found["early"].as_str().unwrap();
            assert!(!early.is_empty() && json!(early) != found["whole"]);
            let failed = browser.run("/pages/landing.js", "failed", json!([]));
            assert_eq!(failed, json!("the bake failed: no ray meets anything"));
            for (fault, words) in [("unplanned", "plan of an earlier version"), ("still", "end at place 0")] {
                let told = browser.run("/pages/landing.js", "refused", json!([fault]));
                assert!(told.as_str().unwrap().contains(words), "{told}");
            }
        }
    }
}

#[test]
#[ignore = "needs chromium"]
fn chromium_takes_the_other_clusters_where_one_is_lost_and_that_one_with_its_task() {
    let bundle = Bundle::cornell();
    let files = serving(&bundle);
    let browser = browser_at(&files);
    for fault in ["gone", "damaged"] {
        let found = browser.run("/pages/landing.js", "lost", json!([fault]));
        let [without, after] =
            ["without", "after"].map(|name| serde_json::from_value::<[u64; 3]>(found[name].clone()).unwrap());
        assert!(without[0] == 1 && without[1] > 0 && without[1] + 1 == without[2], "{fault}: {without:?}");
        assert!(after[0] == 0 && after[1] == after[2] && after[2] > without[2], "{fault}: {after:?}");
    }
}

#[test]
#[ignore = "needs chromium"]
fn chromium_shows_a_bake_without_a_cell_and_all_of_its_light_at_its_end() {
    let bundle = Bundle::cornell();
    let files = serving(&bundle);
    let found = browser_at(&files).run("/pages/landing.js", "seen", json!([CELLS]));
    assert_eq!(found["failures"], json!([]));
    let words: Vec<&str> = found["words"].as_array().unwrap().iter().filter_map(Value::as_str).collect();
    assert!(words.contains(&"the bake goes on: 0 of 4 cells are baked"), "{words:?}");
    assert!(words.iter().any(|words| words.contains("goes on: 3 of 4")), "{words:?}");
    let [early, landed, whole] = ["early", "landed", "whole"].map(|name| found[name].as_f64().unwrap());
    assert!(early < 0.9 * landed && (landed / whole - 1.0).abs() < 0.02, "{early}, {landed}, {whole}");
}
