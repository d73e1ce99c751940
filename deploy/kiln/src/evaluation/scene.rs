//! Where the scene of a bundle is: `bake` notes its path and its root, relative to the bundle, in the bundle's report.

use std::fs;
use std::path::{Component, Path, PathBuf};

use lightkiln_client::fetch::REPORT_FILE;
use serde::Serialize;
use serde_json::Value;

use crate::failure::{Failure, Result};
use crate::submission::{PackedScene, SceneArguments, nodes_that_move};

/// Where a scene is, seen from a bundle of it.
#[derive(Clone, Debug, Serialize)]
pub struct NotedScene {
    scene_path: Option<String>,
    scene_root: Option<String>,
    /// Nodes that were left out of it.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    scene_movers: Vec<String>,
}

impl NotedScene {
    /// That of a scene.
    pub fn of(scene: &SceneArguments, movers: &[String], bundle: &Path) -> Self {
        let scene_root = scene.root.as_ref().and_then(|root| relative_path(bundle, root));
        let scene_movers = movers.to_vec();
        Self { scene_path: relative_path(bundle, &scene.path), scene_root, scene_movers }
    }
}

/// The scene that a bundle was baked from, as its report notes it, without the nodes that were left out.
pub fn packed_scene_of_bundle(bundle: &Path) -> Result<PackedScene> {
    let scene = PackedScene::read(&scene_of_bundle(bundle)?)?;
    let movers = report_of(bundle).map(|report| report["scene_movers"].clone());
    let movers = movers.and_then(|movers| serde_json::from_value(movers).ok()).unwrap_or_default();
    Ok(if let Some(nodes) = nodes_that_move(movers) { scene.split(&nodes)?.0 } else { scene })
}

fn report_of(bundle: &Path) -> Option<Value> {
    serde_json::from_slice(&fs::read(bundle.join(REPORT_FILE)).ok()?).ok()
}

/// The scene's file, as the bundle's report notes it.
///
/// Errors when the report names none, as that of a fetched bundle, or when the file is gone.
fn scene_of_bundle(bundle: &Path) -> Result<SceneArguments> {
    let give = "--scene SCENE, with the file that was baked";
    let report = report_of(bundle);
    let noted =
        |name: &str| report.as_ref().and_then(|report| report[name].as_str()).map(|way| bundle.join(way));
    let Some(path) = noted("scene_path") else {
        let what = format!("the bundle {} does not say where its scene is", bundle.display());
        return Err(Failure::bad_input(what).try_this(give));
    };
    if path.is_file() {
        return Ok(SceneArguments { path, root: noted("scene_root") });
    }
    let what = format!("the scene of {} is no more at {}", bundle.display(), path.display());
    Err(Failure::bad_input(what).try_this(give))
}

/// The way from a folder to a file or folder, both of which exist; `None` when there is none, or it is not text.
fn relative_path(folder: &Path, file: &Path) -> Option<String> {
    let (folder, file) = (folder.canonicalize().ok()?, file.canonicalize().ok()?);
    let (from, to): (Vec<Component>, Vec<Component>) =
        (folder.components().collect(), file.components().collect());
    let shared = from.iter().zip(&to).take_while(|(a, b)| a == b).count();
    if shared == 0 {
        return None;
    }
    let up = from[shared..].iter().map(|_| Component::ParentDir);
    let way: PathBuf = up.chain(to[shared..].iter().copied()).collect();
    way.to_str().map(str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scene_is_found_again_from_the_bundles_report() {
        let folder = tempfile::tempdir().unwrap();
        let (bundle, scenes) = (folder.path().join("out/a.kiln"), folder.path().join("scenes"));
        fs::create_dir_all(&bundle).unwrap();
        fs::create_dir_all(&scenes).unwrap();
        let scene = scenes.join("a.glb");
        fs::write(&scene, "glTF").unwrap();
        let noted = |root: Option<&Path>| {
            let scene = SceneArguments { path: scene.clone(), root: root.map(Path::to_owned) };
            serde_json::to_string(&NotedScene::of(&scene, &[], &bundle)).unwrap()
        };
        assert!(noted(None).contains("../../scenes/a.glb"), "{}", noted(None));
        assert!(scene_of_bundle(&bundle).unwrap_err().to_string().contains("does not say"));
        for root in [None, Some(folder.path())] {
            fs::write(bundle.join(REPORT_FILE), noted(root)).unwrap();
            let found = scene_of_bundle(&bundle).unwrap();
            assert_eq!(found.path.canonicalize().unwrap(), scene.canonicalize().unwrap());
            let real = |path: &Path| path.canonicalize().unwrap();
            assert_eq!(found.root.as_deref().map(real), root.map(real));
        }
        fs::remove_file(&scene).unwrap();
        assert!(scene_of_bundle(&bundle).unwrap_err().to_string().contains("--scene"));
    }
}
