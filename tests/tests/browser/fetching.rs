//! Bakes over HTTP from a bundle's folder: whole and in parts, with an answer that fails once, and with wrong ones.

use std::sync::atomic::{AtomicUsize, Ordering};

use lightkiln_proto::chunk::cluster_layers;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::manifest::{
    CLUSTERS, ChunkRef, ClusterRow, FORMAT, Layer, Manifest, PrefixCheck, Stored, VERSION,
};
use serde_json::json;

use super::files::{Answer, Files, Request};
use super::{browser_at, root, served};

const MODULE: &str = "/pages/fetch.js";

/// Bytes of a chunk, and its name.
struct Chunk {
    digest: Digest,
    bytes: Vec<u8>,
}

fn chunk(name: &str) -> Chunk {
    let bytes = std::fs::read(root().join("proto/fixtures").join(name)).expect("a fixture");
    Chunk { digest: Digest::of(&bytes), bytes }
}

/// A bundle of two clusters and their patches: its manifest and chunks.
fn bundle() -> (Vec<u8>, Vec<Chunk>) {
    let (clusters, patches) =
        ([chunk("cluster-v4.lkc"), chunk("cluster-near-v4.lkc")], chunk("patches-v4.lkc"));
    let of = |chunk: &Chunk| ChunkRef { digest: chunk.digest, bytes: chunk.bytes.len() as u64 };
    let manifest = json!({
        "format": FORMAT, "version": VERSION, "kind": "prt", "scene": Digest::of(b""), "settings": {},
        "bounds_m": [[0, 0, -1], [1, 2, -1]], "triangles": 2, "lightmap": null, "materials": [], "emitters": [],
        "lights": [], "cameras": [], "framing": {}, "chunks": { "patches": [of(&patches)] }, "body": {},
    });
    let mut manifest = Manifest::from_json(manifest.to_string().as_bytes()).expect("a manifest");
    manifest.clusters = clusters.iter().map(row).collect();
    manifest.chunks.insert(CLUSTERS.to_owned(), clusters.iter().map(of).collect());
    let Stored { json, pages } = manifest.stored().expect("it can be stored");
    let pages = pages.into_iter().map(|bytes| Chunk { digest: Digest::of(&bytes), bytes });
    (json, clusters.into_iter().chain([patches]).chain(pages).collect())
}

fn row(chunk: &Chunk) -> ClusterRow {
    let layers: Vec<Layer> = cluster_layers(&chunk.bytes, chunk.bytes.len() as u64).expect("a cluster");
    assert!(layers.len() > 1, "a cluster of one layer has no prefix");
    ClusterRow {
        bounds_m: [[0.0, 0.0, -1.0], [1.0, 2.0, -1.0]],
        receivers: 4,
        keys: 1,
        rank: 2,
        truncation_error: 0.0,
        quantisation_error: 0.0,
        uncovered_fraction: 0.0,
        checks: PrefixCheck::of_prefixes(&chunk.bytes, &layers),
        layers,
    }
}

/// A server of the bundle at `/bake`; `change` sees each answer and how many were given before.
fn serving(
    honours_ranges: bool,
    change: impl Fn(&Request, usize, Answer) -> Answer + Send + Sync + 'static,
) -> Files {
    let (manifest, chunks) = bundle();
    let count = AtomicUsize::new(0);
    served(move |request| {
        let file = request.path.strip_prefix("/bake/")?;
        let bytes = match file.strip_prefix("chunks/") {
            Some(digest) => &chunks.iter().find(|chunk| chunk.digest.to_string() == digest)?.bytes,
            None => &manifest,
        };
        let end = request.range.as_ref().filter(|_| honours_ranges).and_then(|range| {
            let last: usize = range.strip_prefix("bytes=0-")?.parse().ok()?;
            Some(last + 1)
        });
        let mut answer = Answer::of(bytes[..end.unwrap_or(bytes.len())].to_vec());
        answer.status = if end.is_some() { 206 } else { 200 };
        Some(change(request, count.fetch_add(1, Ordering::Relaxed), answer))
    })
}

#[test]
#[ignore = "needs chromium"]
fn chromium_fetches_a_bake_whole_and_in_layers() {
    for (honours_ranges, first) in [(true, 1), (false, 4)] {
        // The first answer of all fails in a way that may pass.
        let files =
            serving(honours_ranges, |_, count, answer| if count == 0 { Answer::empty(503) } else { answer });
        let found = browser_at(&files).run(MODULE, "bake", json!(["/bake"]));
        assert_eq!(found, json!({ "kind": "prt", "receivers": [[first, 4], [first, 4]], "patches": 4 }));
        let calls = files.calls();
        assert_eq!(calls.iter().filter(|call| call.contains("manifest.json")).count(), 2, "{calls:?}");
        assert!(calls.iter().any(|call| call.contains("bytes=0-")), "{calls:?}");
    }
}

#[test]
#[ignore = "needs chromium"]
fn chromium_refuses_bytes_that_are_not_those_asked_for() {
    let flipped = |mut answer: Answer| {
        *answer.bytes.last_mut().expect("bytes") ^= 1;
        answer
    };
    let longer = |mut answer: Answer| {
        answer.bytes.resize(answer.bytes.len() + 100_000, 0);
        answer
    };
    let is_chunk = |request: &Request| request.path.contains("/chunks/");
    type Change = Box<dyn Fn(&Request, usize, Answer) -> Answer + Send + Sync>;
    let cases: [(Change, &str); 5] = [
        (
            Box::new(move |request, _, answer| if is_chunk(request) { flipped(answer) } else { answer }),
            "ChunkError digest",
        ),
        (
            Box::new(
                move |request, _, answer| if request.range.is_some() { flipped(answer) } else { answer },
            ),
            "ChunkError digest",
        ),
        (
            Box::new(
                move |request, count, answer| {
                    if is_chunk(request) && count < 3 { longer(answer) } else { answer }
                },
            ),
            "no error",
        ),
        (Box::new(|_, _, _| Answer::of(b"<html>".to_vec())), "ManifestError json"),
        (Box::new(|_, _, _| Answer::empty(404)), "FetchError status"),
    ];
    for (place, (change, wanted)) in cases.into_iter().enumerate() {
        let told = browser_at(&serving(true, change)).run(MODULE, "failure", json!(["/bake"]));
        assert!(
            told.as_str().is_some_and(|told| told.starts_with(wanted)),
            "case {place}: {told}, wanted {wanted}"
        );
    }
}
