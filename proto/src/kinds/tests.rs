//! The table of kinds.

use serde_json::json;

use super::*;
use crate::ids::Digest;

fn scene() -> Digest {
    Digest::of(b"scene")
}

#[test]
fn names_and_chunk_kinds_are_unique_and_the_first_kind_is_the_default() {
    let kinds = Kinds::new();
    assert_eq!(kinds.named("").unwrap().name(), kinds.default_kind().name());
    let mut names: Vec<&str> = kinds.iter().map(Kind::name).collect();
    let mut numbers: Vec<u8> = kinds.chunks().map(|row| row.kind.0).collect();
    let counts = (names.len(), numbers.len());
    names.sort_unstable();
    names.dedup();
    numbers.sort_unstable();
    numbers.dedup();
    assert_eq!((names.len(), numbers.len()), counts);
}

#[test]
#[should_panic(expected = "two kinds are named")]
fn a_kind_is_registered_once() {
    let _ = Kinds::new().with(&prt::Prt);
}

#[test]
fn unknown_kind_is_refused_with_the_known_ones() {
    let error = Kinds::new().first_tasks("photons", scene(), &json!(null)).unwrap_err().to_string();
    assert!(error.contains("photons") && error.contains("prt") && error.contains("sh"), "{error}");
}

#[test]
fn one_kind_is_of_objects_and_those_with_voxels_light_them() {
    let kinds = Kinds::new();
    assert_eq!(kinds.iter().filter(|kind| kind.is_of_objects()).count(), 1);
    let beside = |name: &str, settings: serde_json::Value| kinds.get(name).unwrap().beside_objects(&settings);
    for name in ["prt", "grid", "cloud"] {
        assert_eq!(beside(name, json!(null)), Some(json!({"voxels": "on"})));
        assert_eq!(
            beside(name, json!({"voxels": "on", "preset": "high"})),
            Some(json!({"voxels": "on", "preset": "high"}))
        );
        assert_eq!(beside(name, json!({"voxels": "off"})), None);
        let settings = beside(name, json!({})).unwrap();
        assert!(kinds.get(name).unwrap().resolve(&settings).is_ok(), "{name}");
    }
    assert_eq!(beside("voxels", json!({"preset": "draft"})), Some(json!({"preset": "draft"})));
    for name in ["sh", "captured", "transfer"] {
        assert_eq!(beside(name, json!({})), None);
    }
}

#[test]
fn kinds_of_one_scene_share_their_scene_tasks_by_key() {
    let kinds = Kinds::new();
    let keys = |kind: &str, settings| -> Vec<_> {
        let tasks = kinds.first_tasks(kind, scene(), &settings).unwrap();
        tasks.iter().filter(|task| task.kind.starts_with("scene.")).map(|task| task.key).collect()
    };
    let (prt, sh) = (keys("prt", json!(null)), keys("sh", json!({ "bands": 3 })));
    assert!(sh.len() >= 5 && sh.iter().all(|key| prt.contains(key)));
    assert_eq!(prt, keys("prt", json!({ "rank_error": 0.3 })), "settings of transport change no shared task");
    assert_ne!(prt, keys("prt", json!({ "texel_m": 0.5 })));
}

#[test]
fn a_plan_names_only_tasks_of_itself() {
    for kind in Kinds::new().iter() {
        let tasks = kind.first_tasks(scene(), &json!(null)).unwrap();
        for task in &tasks {
            let is_planned = |key| tasks.iter().any(|other| other.key == key);
            assert!(task.dependencies().all(is_planned), "{}", task.kind);
        }
    }
}
