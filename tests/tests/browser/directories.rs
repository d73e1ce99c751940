//! Directories of none, of very many, and of lies, in the browser.

use lightkiln_client::fetch::{MANIFEST_FILE, Source, chunk_path};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::manifest::{CLUSTERS, ClusterRow, Manifest};
use serde_json::{Value, json};

use super::bundle::Bundle;
use super::bundle_opened;

/// Clusters of a bundle that are told of again and again.
const REPEATED: usize = 7;

/// The bundle with another manifest.
fn rewritten(bundle: &Bundle, manifest: Manifest) {
    let stored = manifest.stored().unwrap();
    for page in stored.pages {
        std::fs::write(chunk_path(bundle.folder(), Digest::of(&page)), page).unwrap();
    }
    std::fs::write(bundle.folder().join(MANIFEST_FILE), stored.json).unwrap();
}

/// The manifest with so many clusters, of the first few in turn.
fn of_count(manifest: &Manifest, count: usize) -> Manifest {
    let chunks = manifest.chunks(CLUSTERS);
    // Pages that are alike are refused for that alone.
    let row = |index: usize| ClusterRow {
        truncation_error: index as f32,
        ..manifest.clusters[index % REPEATED].clone()
    };
    let mut many = manifest.clone();
    many.clusters = (0..count).map(row).collect();
    many.chunks
        .insert(CLUSTERS.to_owned(), (0..count).map(|index| chunks[index % REPEATED].clone()).collect());
    many.body["totals"]["clusters"] = json!(count);
    many
}

/// Clusters of the bundle, and its light by its first bytes, or the words of its refusal.
fn told(bundle: &Bundle, bytes: Option<u64>) -> Value {
    let (_files, browser) = bundle_opened(bundle, |_| None);
    browser.run("/pages/landing.js", "opened", json!(["/bundle", bytes]))
}

#[test]
#[ignore = "needs chromium"]
fn chromium_refuses_ten_thousand_clusters_of_one_place_and_shows_none_and_those_that_are_lied_about() {
    let bundle = Bundle::cornell();
    let (_, manifest) = Source::bundle(bundle.folder()).unwrap().manifest().unwrap();
    let whole = told(&bundle, None);
    let count = manifest.clusters.len();
    assert_eq!((&whole["clusters"], &whole["isWhole"]), (&json!([count, count]), &json!(true)), "{whole}");

    // Of clusters that come whole, places and bounds are their chunks' own.
    let mut lying = manifest.clone();
    for row in &mut lying.clusters {
        row.layers[0].bytes -= 1;
        row.receivers += 1;
        row.bounds_m = [[0.0; 3]; 2];
    }
    rewritten(&bundle, lying);
    assert_eq!(told(&bundle, None), whole);

    rewritten(&bundle, of_count(&manifest, 10_000));
    let step = 20 * manifest.chunks(CLUSTERS).iter().map(|chunk| chunk.bytes).max().unwrap();
    let many = told(&bundle, Some(step));
    let refusal = many["error"].as_str().unwrap();
    assert!(refusal.contains("another receiver"), "{refusal}");

    rewritten(&bundle, of_count(&manifest, 0));
    let none = told(&bundle, None);
    assert_eq!((&none["clusters"], &none["isWhole"]), (&json!([0, 0]), &json!(true)), "{none}");
    assert_ne!(none["light"], whole["light"]);
}
