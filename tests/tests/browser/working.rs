//! Workers put the same light together as the page's own thread, which does it where they are refused.

use std::path::Path;

use lightkiln_client::fetch::{CHUNKS_FOLDER, Source, chunk_path};
use lightkiln_proto::manifest::CLUSTERS;
use serde_json::{Value, json};

use super::bundle::Bundle;
use super::driver::Browser;
use super::files::{Answer, Files};
use super::served;

const MODULE: &str = "/pages/workers.js";
/// Workers that are asked for where there may be some.
const WORKERS: u32 = 2;

/// A server of a bundle, and of the same with a byte of a cluster flipped.
fn serving(folder: &Path) -> Files {
    let (_, manifest) = Source::bundle(folder).unwrap().manifest().unwrap();
    let damaged = chunk_path(folder, manifest.chunks[CLUSTERS][0].digest);
    let folder = folder.to_owned();
    served(move |request| {
        let (name, file) = request.path.strip_prefix('/')?.split_once('/')?;
        let path = folder.join(file);
        let is_damaged = match name {
            "bundle" => false,
            "damaged" => path == damaged,
            _ => return None,
        };
        let mut bytes = std::fs::read(&path).ok()?;
        if is_damaged {
            *bytes.last_mut()? ^= 1;
        }
        Some(Answer::of(bytes))
    })
}

/// A browser on one of the tests' pages.
fn at(files: &Files, page: &str) -> Browser {
    let browser = Browser::start();
    browser.open(&files.url(page));
    browser
}

fn fetched_worker(files: &Files) -> bool {
    files.calls().iter().any(|call| call.ends_with("relight/worker.js"))
}

#[test]
#[ignore = "needs chromium"]
fn chromium_puts_light_together_in_workers_as_on_its_own_thread() {
    let bundle = Bundle::flat();
    assert!(bundle.folder().join(CHUNKS_FOLDER).is_dir());
    let files = serving(bundle.folder());
    let browser = at(&files, "/pages/empty.html");
    let lights = |workers: u32| browser.run(MODULE, "lights", json!(["/bundle", workers]));
    let here = lights(0);
    assert!(here["isElsewhere"] == false && !fetched_worker(&files));
    let there = lights(WORKERS);
    assert!(there["isElsewhere"] == true && fetched_worker(&files));
    let found = here["found"].as_array().unwrap();
    let come: Vec<u64> = found.iter().map(|found| found["clusters"][0].as_u64().unwrap()).collect();
    assert!(come[0] == 0 && come[1] > 0 && come[1] < come[2], "{come:?}");
    assert_ne!(found[1]["light"], found[2]["light"], "the comparison sees no difference");
    assert_eq!(here["found"], there["found"]);
    for dead in [1, WORKERS] {
        let bereft = browser.run(MODULE, "bereft", json!(["/bundle", WORKERS, dead]));
        assert_eq!(bereft["made"], WORKERS + 1);
        assert_eq!(bereft["light"], found[2]["light"], "{dead} of {WORKERS} decoders have failed");
    }
    let told = browser.run(MODULE, "failures", json!(["/damaged", "/bundle"]));
    assert_eq!(told, json!(["ChunkError ChunkError digest", "AbortError"]));
}

#[test]
#[ignore = "needs chromium"]
fn chromium_puts_light_together_on_its_own_thread_where_workers_are_refused() {
    let bundle = Bundle::flat();
    let files = serving(bundle.folder());
    let browser = at(&files, "/pages/no-workers.html");
    let lights: Value = browser.run(MODULE, "lights", json!(["/bundle", WORKERS]));
    assert_eq!(lights["isElsewhere"], false);
    assert!(!fetched_worker(&files));
    let found = lights["found"].as_array().unwrap();
    assert!(
        found[2]["clusters"][0].as_u64().unwrap() > 0 && found[2]["clusters"][0] == found[2]["clusters"][1]
    );
}
