//! JSON that the typed reader refuses: an older glTF, or a valid one that leaves out a list which the reader wants.

use gltf::json::Root;
use serde::Deserialize;
use serde_json::Value;
use serde_json::value::RawValue;

use super::error::{ImportError, Result, shown};

/// The members that tell versions apart, unread; all others are passed over.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Outline<'a> {
    #[serde(borrow)]
    asset: Option<&'a RawValue>,
    #[serde(borrow)]
    accessors: Option<&'a RawValue>,
    #[serde(borrow)]
    buffer_views: Option<&'a RawValue>,
    #[serde(borrow)]
    materials: Option<&'a RawValue>,
    #[serde(borrow)]
    meshes: Option<&'a RawValue>,
    #[serde(borrow)]
    nodes: Option<&'a RawValue>,
    #[serde(borrow)]
    scenes: Option<&'a RawValue>,
}

/// The version that an asset states.
#[derive(Deserialize)]
struct Asset {
    /// A text; exporters of glTF 1.0 wrote numbers too.
    version: Option<Value>,
}

/// The one list of a scene.
#[derive(Deserialize)]
struct SceneOutline<'a> {
    #[serde(borrow)]
    nodes: Option<&'a RawValue>,
}

/// Reads a glTF's JSON as typed.
///
/// Errors say which it is: broken JSON, an older glTF, or JSON that is no glTF.
pub(super) fn read(json: &[u8]) -> Result<Root> {
    let source = match Root::from_slice(json) {
        Ok(root) => return Ok(root),
        Err(source) => source,
    };
    if !source.is_data() {
        return Err(ImportError::Json { source });
    }
    let Ok(outline) = serde_json::from_slice::<Outline<'_>>(json) else {
        return Err(ImportError::NotGltf { source });
    };
    if let Some(version) = outline.other_version() {
        return Err(ImportError::version(&version));
    }
    let completed = outline.with_node_lists(json);
    completed.and_then(|json| Root::from_slice(&json).ok()).ok_or(ImportError::NotGltf { source })
}

impl Outline<'_> {
    /// The version, if it is not 2: as stated, or told by tables of named objects where glTF 2.0 has lists.
    fn other_version(&self) -> Option<String> {
        let asset = self.asset.and_then(|asset| serde_json::from_str::<Asset>(asset.get()).ok());
        if let Some(version) = asset.and_then(|asset| asset.version) {
            let version = version.as_str().map_or_else(|| version.to_string(), str::to_owned);
            return (version != "2" && !version.starts_with("2.")).then(|| shown(&version));
        }
        let lists = [self.accessors, self.buffer_views, self.materials, self.meshes, self.nodes, self.scenes];
        let is_table = lists.into_iter().flatten().any(|list| list.get().starts_with('{'));
        (self.asset.is_none() && is_table).then(|| "1.0".to_owned())
    }

    /// The JSON with an empty list of nodes in each scene that has none; `None` if all have one.
    fn with_node_lists(&self, json: &[u8]) -> Option<Vec<u8>> {
        let scenes: Vec<&RawValue> = serde_json::from_str(self.scenes?.get()).ok()?;
        let mut completed = Vec::with_capacity(json.len());
        let mut copied = 0;
        for scene in scenes {
            let is_complete = serde_json::from_str::<SceneOutline<'_>>(scene.get())
                .map_or(true, |scene| scene.nodes.is_some());
            if is_complete {
                continue;
            }
            // Both are slices of one text, so their distance is the scene's place in it.
            let inside = scene.get().as_ptr().addr().checked_sub(json.as_ptr().addr())? + 1;
            let members = scene.get().get(1..)?.trim_start();
            completed.extend_from_slice(json.get(copied..inside)?);
            completed.extend_from_slice(if members.starts_with('}') {
                b"\"nodes\":[]"
            } else {
                b"\"nodes\":[],"
            });
            copied = inside;
        }
        completed.extend_from_slice(json.get(copied..)?);
        (copied > 0).then_some(completed)
    }
}
