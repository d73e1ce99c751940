//! Pictures of a site for browsers without WebGPU: a bake under its own lights, from its own cameras.

use std::path::Path;

use lightkiln_client::bake::{ClientKinds, LoadedBake};
use lightkiln_client::fetch::Source;
use lightkiln_client::picture::encode_png;
use lightkiln_client::preview::{Backend, View, render};
use serde_json::{Value, json};

use super::{remove_files, whole_name, write};
use crate::console::say;
use crate::failure::{Exit, Failure, Result};

/// Most pictures.
pub const STILLS_MAX: u32 = 16;
/// Folder of the pictures in a site.
pub const FOLDER: &str = "stills";
/// Width and height in pixels.
const SIZE: [u32; 2] = [960, 540];

/// A picture of a bake.
pub struct Still {
    file: String,
    words: String,
    png: Vec<u8>,
}

/// Draws a bake from the first `count` of its cameras, or from the one that it chose where it has none.
pub fn draw(source: &Source, kinds: &ClientKinds, count: u32) -> Result<Vec<Still>> {
    if count == 0 {
        return Ok(Vec::new());
    }
    let bake = LoadedBake::load(source, kinds)?;
    let own = bake.scene.manifest.cameras.iter().cloned().map(Some);
    let cameras: Vec<_> = own.chain([None]).take(bake.scene.manifest.cameras.len().max(1)).collect();
    let mut drawn = Vec::new();
    for (camera, number) in cameras.into_iter().take(count as usize).zip(1_u32..) {
        let (view, _) = View::of_bake(&bake, camera, None)?;
        let [width, height] = SIZE;
        let view = View { width, height, ..view };
        let file = format!("{FOLDER}/{}", name(number));
        let picture = render(&bake, &view, Backend::Auto)?;
        say!("{file}: drawn by {}", picture.drawn_by);
        let png = encode_png(width, height, &picture.ldr).map_err(|error| {
            Failure::new(Exit::Failed, format!("{file} cannot be encoded")).caused_by(&*error)
        })?;
        let words = format!("from camera '{}', under the lights of the bake", view.camera.name);
        drawn.push(Still { file, words, png });
    }
    Ok(drawn)
}

/// Pictures as pages read their list.
pub fn list(stills: &[Still]) -> Vec<Value> {
    let [width, height] = SIZE;
    let listed =
        |still: &Still| json!({ "file": still.file, "words": still.words, "width": width, "height": height });
    stills.iter().map(listed).collect()
}

/// Names and bytes of pictures.
pub fn files(stills: &[Still]) -> impl Iterator<Item = (&str, &[u8])> {
    stills.iter().map(|still| (still.file.as_str(), still.png.as_slice()))
}

/// Writes pictures into a site; lists them as its page reads them.
pub fn place(stills: &[Still], site: &Path) -> Result<Vec<Value>> {
    files(stills).try_for_each(|(file, png)| write(&site.join(file), png))?;
    Ok(list(stills))
}

/// Removes what `place` wrote into a site.
pub fn remove(site: &Path) -> Result<()> {
    let is_still = |file: &str| (1..=STILLS_MAX).any(|number| name(number) == whole_name(file, "png"));
    remove_files(&site.join(FOLDER), is_still)
}

/// Name of a picture in its folder.
fn name(number: u32) -> String {
    format!("{number}.png")
}
