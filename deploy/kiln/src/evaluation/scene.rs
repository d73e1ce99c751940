//! Where the scene of a bundle is: `bake` notes its path, relative to the bundle, in the bundle's report.

use std::fs;
use std::path::{Component, Path, PathBuf};

use lightkiln_client::fetch::REPORT_FILE;
use serde_json::Value;

use crate::failure::{Failure, Result};

/// Path of the scene that a bundle was baked from, as its report notes it.
///
/// Errors when the report names none, as that of a fetched bundle, or when the file is gone.
pub fn scene_of_bundle(bundle: &Path) -> Result<PathBuf> {
    let give = "--scene SCENE, with the file that was baked";
    let report = fs::read(bundle.join(REPORT_FILE)).ok();
    let report: Option<Value> = report.and_then(|bytes| serde_json::from_slice(&bytes).ok());
    let noted = report.as_ref().and_then(|report| report["scene_path"].as_str());
    let Some(noted) = noted else {
        let what = format!("the bundle {} does not say where its scene is", bundle.display());
        return Err(Failure::bad_input(what).try_this(give));
    };
    let path = bundle.join(noted);
    if path.is_file() {
        return Ok(path);
    }
    let what = format!("the scene of {} is no more at {}", bundle.display(), path.display());
    Err(Failure::bad_input(what).try_this(give))
}

/// The way from a folder to a file, both of which exist; `None` when there is none, or it is not text.
pub fn relative_path(folder: &Path, file: &Path) -> Option<String> {
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
        let way = relative_path(&bundle, &scene).unwrap();
        assert_eq!(Path::new(&way), Path::new("../../scenes/a.glb"));
        assert!(scene_of_bundle(&bundle).unwrap_err().to_string().contains("does not say"));
        fs::write(bundle.join(REPORT_FILE), serde_json::json!({ "scene_path": way }).to_string()).unwrap();
        assert_eq!(scene_of_bundle(&bundle).unwrap().canonicalize().unwrap(), scene.canonicalize().unwrap());
        fs::remove_file(&scene).unwrap();
        assert!(scene_of_bundle(&bundle).unwrap_err().to_string().contains("--scene"));
    }
}
