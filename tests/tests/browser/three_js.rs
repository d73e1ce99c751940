//! An export in three.js, by the page of `deploy/examples/three`: its picture is that of the processor's reference under the same light.
//!
//! three.js lies in the folder that `KILN_TEST_THREE` names, the `three` of `node_modules`; `tests/run` installs it by the example's
//! lock file.

use std::path::PathBuf;

use lightkiln_client::bake::LoadedBake;
use lightkiln_client::export::{LIGHTMAP, Options, SCENE_FILE, export, texture_files};
use lightkiln_client::fetch::Source;
use lightkiln_client::lights::parse_lights;
use lightkiln_client::picture::{Picture, Tone};
use lightkiln_client::preview::{Backend, View, light_receivers, render};
use serde_json::{Value, json};

use super::bundle::Bundle;
use super::driver::Browser;
use super::files::{Answer, Files};
use super::{bytes_of_hex, root};

/// Folder of three.js.
const FOLDER: &str = "KILN_TEST_THREE";
/// Reads a page's canvas.
const MODULE: &str = "/pages/canvas.js";
/// The window; its page is somewhat smaller.
const WINDOW: [u32; 2] = [520, 480];
const LIGHT: &str = "point pos=0,1.6,0.3 color=1,0.9,0.7 power=60";
/// Share of a channel's linear energy by which the pictures may differ.
const ENERGY_TOLERANCE: f64 = 0.01;
/// Share of white by which a channel on the screen may differ: rims of shadows are as sharp as texels.
const SCREEN_TOLERANCE: f64 = 0.04;
/// Share of pixels that may differ more.
const OUTLIERS: f64 = 0.02;
/// A page's picture beside the reference: how much they differ.
#[derive(Debug)]
struct Difference {
    /// Energy of a channel over the reference's, minus 1, where it is largest.
    energy: f64,
    /// Share of pixels that differ by more than the tolerance.
    outliers: f64,
}

impl Difference {
    fn of(got: &[u8], wanted: &Picture) -> Self {
        let wanted = wanted.ldr.concat();
        assert_eq!(got.len(), wanted.len());
        let energy = |of: &[u8], channel| of.iter().skip(channel).step_by(4).map(linear).sum::<f64>();
        let ratios = (0..3).map(|channel| energy(got, channel) / energy(&wanted, channel) - 1.0);
        let differs = |(got, wanted): (&[u8], &[u8])| {
            let mut steps = got.iter().zip(wanted).map(|(got, wanted)| got.abs_diff(*wanted));
            steps.any(|steps| f64::from(steps) > SCREEN_TOLERANCE * 255.0)
        };
        let pixels = got.chunks_exact(4).zip(wanted.chunks_exact(4));
        let count = pixels.filter(|pair| differs(*pair)).count();
        Self {
            energy: ratios
                .fold(0.0, |worst: f64, ratio| if ratio.abs() > worst.abs() { ratio } else { worst }),
            outliers: count as f64 / (got.len() / 4) as f64,
        }
    }

    fn agrees(&self) -> bool {
        self.energy.abs() <= ENERGY_TOLERANCE && self.outliers <= OUTLIERS
    }
}

/// Share of white that a byte of sRGB is.
fn linear(byte: &u8) -> f64 {
    let value = f64::from(*byte) / 255.0;
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

/// Files of an export of a bake under the light.
fn exported(source: &Source, bake: &LoadedBake) -> Vec<(String, Vec<u8>)> {
    let emitters = vec![1.0; bake.scene.manifest.emitters.len()];
    let lights = parse_lights(&[LIGHT]).unwrap().lights;
    let lit = light_receivers(bake, lights, None, emitters.clone(), Backend::Cpu).unwrap();
    let files = texture_files(source, bake).unwrap();
    export(bake, &files, &lit.settled.light, &emitters, Options::default()).unwrap().files
}

/// A scene without its lightmaps: no material names one.
fn without_lightmaps(glb: &[u8]) -> Vec<u8> {
    let other = format!("X{}", &LIGHTMAP[1..]);
    let mut glb = glb.to_vec();
    let found: Vec<usize> = glb
        .windows(LIGHTMAP.len())
        .enumerate()
        .filter(|(_, at)| *at == LIGHTMAP.as_bytes())
        .map(|(at, _)| at)
        .collect();
    assert!(found.len() > 1, "no material has a lightmap");
    for at in found {
        glb[at..at + other.len()].copy_from_slice(other.as_bytes());
    }
    glb
}

/// A scene whose coordinates in lightmaps are swapped: u is v.
fn with_swapped_coordinates(glb: &[u8]) -> Vec<u8> {
    let word = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().unwrap()) as usize;
    let json_bytes = word(12);
    let document: Value = serde_json::from_slice(&glb[20..20 + json_bytes]).unwrap();
    let binary = 20 + json_bytes + 8;
    let mut swapped = glb.to_vec();
    let number = |value: &Value| value.as_u64().unwrap_or(0) as usize;
    let primitives =
        document["meshes"].as_array().unwrap().iter().flat_map(|mesh| mesh["primitives"].as_array().unwrap());
    let mut count = 0;
    for coordinates in primitives.filter_map(|primitive| primitive["attributes"].get("TEXCOORD_1")) {
        let accessor = &document["accessors"][number(coordinates)];
        let view = &document["bufferViews"][number(&accessor["bufferView"])];
        let first = binary + number(&view["byteOffset"]) + number(&accessor["byteOffset"]);
        let stride = view.get("byteStride").map_or(8, number);
        for vertex in 0..number(&accessor["count"]) {
            let at = first + stride * vertex;
            swapped[at..at + 8].rotate_left(4);
            count += 1;
        }
    }
    assert!(count > 20, "next to no vertex has coordinates in a lightmap");
    swapped
}

/// A server of the example, of three.js, and of scenes by the folders of their names with one export's pages in each.
fn serve(scenes: Vec<(&'static str, Vec<u8>)>, pages: Vec<(String, Vec<u8>)>) -> Files {
    let three = std::env::var(FOLDER)
        .unwrap_or_else(|_| panic!("{FOLDER} names no folder of three.js: tests/run installs it"));
    // The longer path first.
    let folders = [
        ("/node_modules/three/", PathBuf::from(three)),
        ("/pages/", root().join("tests/tests/browser/pages")),
        ("/", root().join("deploy/examples/three")),
    ];
    Files::start(folders.to_vec(), move |request| {
        let (folder, file) = request.path.strip_prefix('/')?.split_once('/')?;
        let (_, scene) = scenes.iter().find(|(name, _)| *name == folder)?;
        let page = || pages.iter().find(|(name, _)| name == file).map(|(_, bytes)| bytes);
        let bytes = if file == SCENE_FILE { Some(scene) } else { page() };
        Some(bytes.map_or_else(|| Answer::empty(404), |bytes| Answer::of(bytes.clone())))
    })
}

/// The page's picture of a scene: four bytes a pixel.
fn drawn(browser: &Browser, files: &Files, scene: &str, wanted: &Picture) -> Vec<u8> {
    let exposure = wanted.exposure;
    let path = format!("/index.html?scene={scene}/&exposure={exposure}&tone=linear");
    browser.open(&files.url(&path));
    let found = browser.run(MODULE, "picture", json!([]));
    assert!(found.get("failed").is_none(), "{scene}: {}", found["failed"]);
    assert_eq!(found["size"], json!([wanted.width, wanted.height]));
    bytes_of_hex(&found["hex"])
}

#[test]
#[ignore = "needs chromium and three.js"]
fn chromium_shows_an_export_in_three_js_as_the_reference_shows_the_bake() {
    let bundle = Bundle::cornell();
    let source = Source::bundle(bundle.folder()).unwrap();
    let bake = LoadedBake::load(&source, &lightkiln_client::kinds::all()).unwrap();
    let mut files = exported(&source, &bake);
    assert_eq!(files[0].0, SCENE_FILE);
    let scene = files.remove(0).1;
    let scenes = vec![
        ("dark", without_lightmaps(&scene)),
        ("swapped", with_swapped_coordinates(&scene)),
        ("lit", scene),
    ];
    let files = serve(scenes, files);
    let browser = Browser::start();
    browser.resize(WINDOW);
    browser.open(&files.url("/moz-lightmap.js"));
    let size = browser.script("return [innerWidth, innerHeight]", json!([]));
    let [width, height]: [u32; 2] = serde_json::from_value(size).unwrap();
    let lights = parse_lights(&[LIGHT]).unwrap().lights;
    let (view, _) = View::of_bake(&bake, None, Some(lights)).unwrap();
    let view = View { width, height, tone: Tone::Linear, ..view };
    let wanted = render(&bake, &view, Backend::Cpu).unwrap();
    let [lit, dark, swapped] = ["lit", "dark", "swapped"]
        .map(|name| Difference::of(&drawn(&browser, &files, name, &wanted), &wanted));
    println!("{width} × {height}: lit {lit:?}, without lightmaps {dark:?}, swapped {swapped:?}");
    assert!(lit.agrees(), "{lit:?}");
    assert!(!dark.agrees() && dark.energy < -0.5, "{dark:?}");
    assert!(!swapped.agrees() && swapped.outliers > 10.0 * OUTLIERS, "{swapped:?}");
}
