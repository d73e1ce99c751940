//! JSON that the typed reader refuses: an older glTF, or a valid one that leaves out a member which the reader wants.

use std::ops::Range;

use gltf::json::Root;
use serde::Deserialize;
use serde::de::IgnoredAny;
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
    animations: Option<&'a RawValue>,
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
    let completed = outline.completed(json);
    completed.and_then(|json| Root::from_slice(&json).ok()).ok_or(ImportError::NotGltf { source })
}

/// Bytes of a text that others take the place of.
struct Edit {
    place: Range<usize>,
    with: String,
}

/// Place of a slice of a text in it: its distance from the text's start.
fn place_of(slice: &str, text: &[u8]) -> Option<Range<usize>> {
    let start = slice.as_ptr().addr().checked_sub(text.as_ptr().addr())?;
    Some(start..start + slice.len())
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

    /// The JSON without what the typed reader cannot do with or without: scenes have lists of nodes, animations, which no bake
    /// plays, are empty. `None` if that changes nothing.
    fn completed(&self, json: &[u8]) -> Option<Vec<u8>> {
        let mut edits = self.node_lists(json).unwrap_or_default();
        edits.extend(self.emptied_animations(json));
        if edits.is_empty() {
            return None;
        }
        edits.sort_by_key(|edit| edit.place.start);
        let mut completed = Vec::with_capacity(json.len());
        let mut copied = 0;
        for Edit { place, with } in edits {
            completed.extend_from_slice(json.get(copied..place.start)?);
            completed.extend_from_slice(with.as_bytes());
            copied = place.end;
        }
        completed.extend_from_slice(json.get(copied..)?);
        Some(completed)
    }

    /// An empty list of nodes for each scene that has none.
    fn node_lists(&self, json: &[u8]) -> Option<Vec<Edit>> {
        let scenes: Vec<&RawValue> = serde_json::from_str(self.scenes?.get()).ok()?;
        let mut edits = Vec::new();
        for scene in scenes {
            let is_complete = serde_json::from_str::<SceneOutline<'_>>(scene.get())
                .map_or(true, |scene| scene.nodes.is_some());
            if is_complete {
                continue;
            }
            let inside = place_of(scene.get(), json)?.start + 1;
            let members = scene.get().get(1..)?.trim_start();
            let with = if members.starts_with('}') { "\"nodes\":[]" } else { "\"nodes\":[]," };
            edits.push(Edit { place: inside..inside, with: with.to_owned() });
        }
        Some(edits)
    }

    /// As many animations, without channels: a channel whose target has no node is valid, and not read.
    fn emptied_animations(&self, json: &[u8]) -> Option<Edit> {
        let animations = self.animations?.get();
        let count = serde_json::from_str::<Vec<IgnoredAny>>(animations).ok()?.len();
        let empty = vec!["{\"channels\":[],\"samplers\":[]}"; count].join(",");
        Some(Edit { place: place_of(animations, json)?, with: format!("[{empty}]") })
    }
}
