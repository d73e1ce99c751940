//! Pictures of a site for browsers without WebGPU: a bake under its own lights, from its own cameras.

use std::path::Path;

use lightkiln_client::bake::{ClientKinds, LoadedBake};
use lightkiln_client::fetch::Source;
use lightkiln_client::preview::{Backend, View, render_png};
use serde_json::{Value, json};

use crate::console::say;
use crate::failure::{Failure, Result};

/// Most pictures.
pub const STILLS_MAX: u32 = 16;
/// Folder of the pictures in a site.
pub const FOLDER: &str = "stills";
/// Width and height in pixels.
const SIZE: [u32; 2] = [960, 540];

/// Draws a bake from the first `count` of its cameras, or from the one that it chose where it has none; lists them as the page reads
/// them.
pub fn draw(bundle: &Path, kinds: &ClientKinds, count: u32, site: &Path) -> Result<Vec<Value>> {
    if count == 0 {
        return Ok(Vec::new());
    }
    let bake = LoadedBake::load(&Source::bundle(bundle)?, kinds)?;
    let own = bake.scene.manifest.cameras.iter().cloned().map(Some);
    let cameras: Vec<_> = own.chain([None]).take(bake.scene.manifest.cameras.len().max(1)).collect();
    let folder = site.join(FOLDER);
    std::fs::create_dir_all(&folder).map_err(|error| {
        Failure::bad_input(format!("the folder {} cannot be made", folder.display())).caused_by(&error)
    })?;
    let mut listed = Vec::new();
    for (camera, number) in cameras.into_iter().take(count as usize).zip(1..) {
        let (view, _) = View::of_bake(&bake, camera, None)?;
        let [width, height] = SIZE;
        let view = View { width, height, ..view };
        let file = format!("{FOLDER}/{number}.png");
        let picture = render_png(&bake, &view, Backend::Auto, &site.join(&file))?;
        say!("{file}: drawn by {}", picture.drawn_by);
        let words = format!("from camera '{}', under the lights of the bake", view.camera.name);
        listed.push(json!({ "file": file, "words": words, "width": width, "height": height }));
    }
    Ok(listed)
}
