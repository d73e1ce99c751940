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
    /// That of them whose bake it is, of a node that moves.
    #[serde(skip_serializing_if = "Option::is_none")]
    scene_object: Option<String>,
}

impl NotedScene {
    /// That of a scene.
    pub fn of(scene: &SceneArguments, movers: &[String], bundle: &Path) -> Self {
        let scene_root = scene.root.as_ref().and_then(|root| relative_path(bundle, root));
        let (scene_path, scene_movers) = (relative_path(bundle, &scene.path), movers.to_vec());
        Self { scene_path, scene_root, scene_movers, scene_object: None }
    }

    /// That of a node that moves, with those that were left out beside it.
    pub fn of_object(scene: &SceneArguments, movers: &[String], node: &str, bundle: &Path) -> Self {
        Self { scene_object: Some(node.to_owned()), ..Self::of(scene, movers, bundle) }
    }
}

/// The scene that a bundle was baked from, as its report notes it.
pub fn packed_scene_of_bundle(bundle: &Path) -> Result<PackedScene> {
    part_of_bundle(PackedScene::read(&scene_of_bundle(bundle)?)?, bundle)
}

/// The part of a scene that a bundle was baked from, as its report notes it: without nodes that move, or one of these alone.
pub fn part_of_bundle(scene: PackedScene, bundle: &Path) -> Result<PackedScene> {
    let report = report_of(bundle).unwrap_or_default();
    let movers = serde_json::from_value(report["scene_movers"].clone()).unwrap_or_default();
    let Some(nodes) = nodes_that_move(movers) else { return Ok(scene) };
    let name = scene.name.clone();
    let (rest, split) = scene.split(&nodes)?;
    let Some(node) = report["scene_object"].as_str() else { return Ok(rest) };
    let own = split.objects.into_iter().find(|object| object.name == node);
    own.map(|object| PackedScene::new(&name, object.scene)).ok_or_else(|| {
        let what =
            format!("the scene has no more the node '{node}', which {} was baked from", bundle.display());
        Failure::bad_input(what).try_this("the scene as it was then")
    })
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
