//! JSON that roles say to each other: manifests, bakes, plans.

use lightkiln_proto::api::{ClaimRequest, NewBake};
use lightkiln_proto::chunk::encode_directory;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{TaskInput, TaskResult, TaskSpec};
use lightkiln_proto::kinds::{BakeError, Kinds};
use lightkiln_proto::manifest::{
    CLUSTERS, ChunkRef, ClusterRow, DIRECTORY, Layer, Manifest, ManifestError, PrefixCheck,
};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{Target, taken};

/// A bake's manifest.
pub const MANIFEST: Target = Target {
    name: "manifest",
    read: |bytes| {
        let manifest = whole(bytes);
        taken(&manifest) && manifest.is_ok_and(|manifest| taken(&Kinds::new().check(&manifest).map(drop)))
    },
    check: |bytes| {
        let Ok(manifest) = whole(bytes) else { return };
        let stored = manifest.clone().stored().expect("what was read can be written");
        let again = Manifest::from_json(&stored.json).and_then(|again| again.with_directory(&stored.pages));
        let again = again.expect("what was written can be read");
        // The pages of the input may have been others, of the same clusters.
        assert_eq!(again.clone().stored().expect("and written again"), stored);
        assert_eq!(
            (&again.clusters, again.chunks(CLUSTERS)),
            (&manifest.clusters, manifest.chunks(CLUSTERS))
        );
        assert_eq!((&again.materials, &again.body), (&manifest.materials, &manifest.body));
        if let Ok(kind) = Kinds::new().check(&manifest) {
            kind.summary(&manifest).expect("a checked manifest has a summary");
            kind.inspection(&manifest).expect("a checked manifest has figures");
            let _ = kind.warnings(&manifest);
        }
    },
    seeds: || vec![manifest().to_string().into_bytes()],
    memory_max,
};

/// Calls of people and workers, and the first tasks of a bake.
pub const JOB: Target = Target {
    name: "job",
    read: |bytes| {
        let bake = serde_json::from_slice::<NewBake>(bytes);
        let planned = bake.as_ref().is_ok_and(|bake| taken(&first_tasks(bake)));
        let claim = taken(&serde_json::from_slice::<ClaimRequest>(bytes));
        let result = taken(&serde_json::from_slice::<TaskResult>(bytes));
        taken(&bake) || planned || claim || result
    },
    check: |bytes| {
        check_again::<NewBake>(bytes);
        check_again::<ClaimRequest>(bytes);
        check_again::<TaskResult>(bytes);
        let Ok(bake) = serde_json::from_slice::<NewBake>(bytes) else { return };
        let Ok(plan) = first_tasks(&bake) else { return };
        assert_eq!(plan, first_tasks(&bake).expect("it was planned"));
        assert!(!plan.is_empty(), "a bake has tasks");
    },
    seeds: jobs,
    memory_max,
};

fn first_tasks(bake: &NewBake) -> Result<Vec<TaskSpec>, BakeError> {
    Kinds::new().first_tasks(&bake.kind, bake.scene, &bake.settings)
}

/// Values are read as they come, so memory follows the bytes.
fn memory_max(bytes: usize) -> u64 {
    (1 << 20) + 400 * bytes as u64
}

fn check_again<T: DeserializeOwned + Serialize + PartialEq + std::fmt::Debug>(bytes: &[u8]) {
    let Ok(value) = serde_json::from_slice::<T>(bytes) else { return };
    let text = serde_json::to_string(&value).expect("what was read can be written");
    assert_eq!(serde_json::from_str::<T>(&text).expect("what was written can be read"), value);
}

fn digest() -> String {
    Digest::of(b"seed").to_string()
}

fn jobs() -> Vec<Vec<u8>> {
    let scene = Digest::of(b"seed");
    let input = TaskInput::Artefact { name: "scene".into(), digest: scene };
    let task = TaskSpec::new("sh.relight", 1, "batch 0", serde_json::json!({ "rays": 64 }), vec![input], 9);
    let result = serde_json::json!({
        "outputs": [{ "name": "chunk/0", "digest": digest(), "bytes": 12 }],
        "plan": [task],
        "counters": { "secs": 1.25 },
    });
    let bake = serde_json::json!({
        "name": "hall", "scene": digest(), "settings": { "preset": "draft", "rank_max": 16 }, "priority": -3,
        "needs": { "memory_mib": 4096, "threads": 2, "labels": ["gpu"] }, "attempt_limit_secs": 60,
        "limits": { "max_workers": 4, "attempts": 2, "lost_workers": 9 },
    });
    let claim = serde_json::json!({
        "worker": "oven", "kinds": ["sh.relight"], "threads": 4, "memory_mib": 2048, "labels": ["gpu"],
        "max": 2, "ttl_secs": 60, "wait_secs": 20,
    });
    [bake, claim, result].map(|value| value.to_string().into_bytes()).to_vec()
}

/// A manifest with a directory whose pages hold a cluster each.
fn whole(bytes: &[u8]) -> Result<Manifest, ManifestError> {
    let manifest = Manifest::from_json(bytes)?;
    let pages = manifest.chunks(DIRECTORY).len().min(4);
    manifest.with_directory(&vec![directory(1); pages])
}

/// A page of a directory.
pub fn directory(clusters: u32) -> Vec<u8> {
    let layers =
        [(120, 1, 2), (300, 0, 3)].map(|(bytes, level, rank)| Layer { bytes, level, bands: 0, rank });
    let row = |index: u32| ClusterRow {
        bounds_m: [[index as f32, 0.0, 0.0], [4.0 + index as f32, 3.0, 5.5]],
        receivers: 9,
        keys: 2,
        rank: 3,
        truncation_error: 0.01,
        quantisation_error: 0.002,
        uncovered_fraction: 0.0,
        checks: vec![PrefixCheck::of(b"")],
        layers: layers.to_vec(),
    };
    let rows: Vec<ClusterRow> = (0..clusters).map(row).collect();
    let chunks = vec![ChunkRef { digest: Digest::of(b"seed"), bytes: 300 }; rows.len()];
    encode_directory(&rows, &chunks).expect("good rows")
}

fn manifest() -> serde_json::Value {
    let settings =
        Kinds::new().default_kind().resolve(&serde_json::Value::Null).expect("the defaults are good");
    let chunk = serde_json::json!({ "digest": digest(), "bytes": 300 });
    serde_json::json!({
        "format": "lightkiln-manifest", "version": 3, "kind": "prt", "scene": digest(), "settings": settings,
        "bounds_m": [[0.0, 0.0, 0.0], [4.0, 3.0, 5.5]], "triangles": 12,
        "lightmap": {
            "texel_m": 0.25, "pages": [[64, 32]],
            "blocks": [{ "key": "00000000000000ff", "name": "wall", "size": [8, 8], "page": 0, "origin": [1, 1] }],
        },
        "materials": [{
            "name": "red", "base_colour": [0.5, 0.1, 0.1, 1.0],
            "base_colour_texture": { "texture": 0, "wrap": ["repeat", "mirror"], "transform": null },
            "emissive": [0.0, 0.0, 0.0], "emissive_texture": null, "emitter": 0, "alpha_cutoff": 0.5,
            "normal_map": { "texture": { "texture": 1, "wrap": ["clamp", "clamp"], "transform": null }, "scale": 0.5 },
            "specular": { "metallic": 0.25, "roughness": 0.75, "texture": null },
            "double_sided": true,
        }],
        "emitters": [{ "name": "lamp", "area_m2": 0.5 }],
        "lights": [], "cameras": [],
        "framing": { "light": { "note": "chosen", "value": {
            "name": "sun", "kind": { "type": "sun", "direction": [0.0, -1.0, 0.0] }, "strength": [1.0, 1.0, 1.0],
        } } },
        "chunks": { "textures": [chunk], "geometry": [chunk], "patches": [chunk], "directory": [chunk] },
        "directory": [{ "bounds_m": [[0.0, 0.0, 0.0], [4.0, 3.0, 5.5]], "clusters": 1 }],
        "body": {
            "totals": {
                "receivers": 9, "clusters": 1, "mean_rank": 3.5, "rank_max": 4, "uncovered_fraction": 0.01,
                "left_out_fraction": 0.0, "receivers_without_light": 1,
            },
            "patches": 3,
        },
    })
}
