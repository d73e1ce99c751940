//! Edits that are shown before they are baked: walks bring what they change, and the bake of before the rest.

use std::path::Path;

use glam::{DVec3, Vec3};
use lightkiln_client::bake::{Edited, LoadedBake};
use lightkiln_client::fetch::Source;
use lightkiln_client::kinds;
use lightkiln_client::lights::{parse_camera, parse_lights};
use lightkiln_client::preview::{Backend, View, render};
use lightkiln_proto::manifest::CLUSTERS;
use lightkiln_tests::harness::{Recipe, bake};
use lightkiln_tests::scenes::{FLAT_WALL_M, Flat, cornell, cornell_of_one_box, flat};
use lightkiln_worker::reference::luminance;

use super::setup::with_texels;

/// A scene before and after an edit.
struct Edit {
    before: LoadedBake,
    /// The quick bake alone: walks.
    walks: LoadedBake,
    shown: Edited,
    baked: LoadedBake,
}

impl Edit {
    fn of([before, after]: [Vec<u8>; 2], recipe: &Recipe) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let opened =
            |name: &str, scene: &[u8], recipe: &Recipe| opened(&folder.path().join(name), scene, recipe);
        let was = opened("before", &before, recipe);
        let (_, manifest) = was.manifest().unwrap();
        let kinds = kinds::all();
        let kind = kinds.of(&manifest).unwrap();
        let quick = kind.quick_bake(&manifest).unwrap();
        let quick = opened("quick", &after, &Recipe { kind: quick.kind, settings: quick.settings });
        let loaded = |source: &Source| LoadedBake::load(source, &kinds).unwrap();
        Self {
            before: loaded(&was),
            walks: loaded(&quick),
            shown: kind.edited(&was, &quick).unwrap(),
            baked: loaded(&opened("baked", &after, recipe)),
        }
    }

    /// Errors of the picture that is shown, of that of the bake of before and of that of walks alone, beside that of the scene's bake.
    fn errors(&self, seen: impl Fn(&LoadedBake) -> Vec<f64>) -> [f64; 3] {
        let wanted = seen(&self.baked);
        [&self.shown.bake, &self.before, &self.walks].map(|bake| {
            let squares: f64 = seen(bake).iter().zip(&wanted).map(|(a, b)| (a - b).powi(2)).sum();
            (squares / wanted.len() as f64).sqrt() / (wanted.iter().sum::<f64>() / wanted.len() as f64)
        })
    }
}

fn opened(folder: &Path, scene: &[u8], recipe: &Recipe) -> Source {
    bake(scene.to_vec(), recipe).unwrap().write(folder).unwrap();
    Source::bundle(folder).unwrap()
}

/// Luminances of a small picture.
fn seen(bake: &LoadedBake, camera: &str, light: &str) -> Vec<f64> {
    let lights = parse_lights(&[light]).unwrap().lights;
    let (mut view, _) = View::of_bake(bake, Some(parse_camera(camera).unwrap()), Some(lights)).unwrap();
    (view.width, view.height, view.samples) = (160, 90, 1);
    let picture = render(bake, &view, Backend::Cpu).unwrap();
    picture.linear.iter().map(|rgb| luminance(DVec3::from(rgb.map(f64::from)))).collect()
}

/// The flat from above a thing in it.
fn seen_from_above(bake: &LoadedBake, at_m: Vec3) -> Vec<f64> {
    let eye = at_m + Vec3::new(0.9, 1.1, 0.8);
    let camera = format!("eye={},{},{} target={},{},{} fov=70", eye.x, eye.y, eye.z, at_m.x, at_m.y, at_m.z);
    let light = format!("point pos={},{},{} power=60", at_m.x - 0.8, at_m.y + 1.6, at_m.z + 0.7);
    seen(bake, &camera, &light)
}

#[test]
fn moved_chair_is_shown_before_its_bake_as_it_is_after_it() {
    // Walks pass a pane as if it were not there.
    let was = Flat { pane: 0.0, ..Flat::default() };
    let mut of = was.clone();
    of.things[0].at_m += Vec3::new(0.3, 0.0, -0.1);
    let at_m = of.things[0].at_m;
    let edit = Edit::of([flat(&was), flat(&of)], &with_texels("prt", 0.125, 128).with("voxels", "on"));
    let [shown, stale, walks] = edit.errors(|bake| seen_from_above(bake, at_m));
    println!("error {shown:.4}, of the bake of before {stale:.4}, of walks alone {walks:.4}");
    assert!(shown < 0.25 * stale && shown < 0.8 * walks, "{shown}, {stale}, {walks}");
    let map = edit.shown.bake.light.lightmap(&edit.shown.bake.scene).unwrap();
    let far = map.receivers.position_m.iter().map(|at_m| at_m.x > FLAT_WALL_M + 0.2);
    let far: Vec<f32> =
        far.zip(&edit.shown.provisional).filter(|(is_far, _)| *is_far).map(|(_, share)| *share).collect();
    assert!(
        far.len() > 500 && far.iter().all(|share| *share == 0.0),
        "behind the wall nothing is provisional"
    );
}

/// Patches lose the parts that are gone, and others become one.
#[test]
fn box_that_is_gone_leaves_the_light_of_what_stood_beside_it() {
    let recipe = with_texels("prt", 0.1875, 128).with("voxels", "on");
    let edit = Edit::of([cornell(), cornell_of_one_box()], &recipe);
    let errors = |camera: &str| edit.errors(|bake| seen(bake, camera, "point pos=1.5,4.5,-1.5 power=200"));
    for camera in ["eye=0,2.75,7.85 target=0,2.75,0 fov=40", "eye=-2.5,0.6,-0.5 target=-1.3,1,-3.5 fov=70"] {
        let [shown, stale, walks] = errors(camera);
        println!("error {shown:.4}, of the bake of before {stale:.4}, of walks alone {walks:.4}");
        assert!(shown < 0.25 * stale && shown < 0.8 * walks, "{camera}: {shown}, {stale}, {walks}");
    }
}

/// Things whose bounced light is that of walks look as they do with rows of their own, and cost less; what stands around them is the same.
#[test]
fn things_that_walks_light_look_as_with_rows_of_their_own_and_cost_less() {
    let of = Flat { pane: 0.0, ..Flat::default() };
    let recipe = with_texels("prt", 0.125, 128).with("voxels", "on");
    let folder = tempfile::tempdir().unwrap();
    let kinds = kinds::all();
    let baked = |name: &str, recipe: &Recipe| {
        let source = opened(&folder.path().join(name), &flat(&of), recipe);
        let (_, manifest) = source.manifest().unwrap();
        (LoadedBake::load(&source, &kinds).unwrap(), manifest.bytes_of(CLUSTERS))
    };
    let (own, own_bytes) = baked("own", &recipe);
    let (walked, walked_bytes) = baked("walked", &recipe.clone().with("walk_lit_m", 1.0));
    assert!(walked_bytes < own_bytes, "{walked_bytes} of {own_bytes} bytes");
    let at_m = of.things[0].at_m;
    let [wanted, found] = [&own, &walked].map(|bake| seen_from_above(bake, at_m));
    let mean = wanted.iter().sum::<f64>() / wanted.len() as f64;
    let squares: f64 = found.iter().zip(&wanted).map(|(a, b)| (a - b).powi(2)).sum();
    let error = (squares / wanted.len() as f64).sqrt() / mean;
    let energy = found.iter().sum::<f64>() / wanted.len() as f64 / mean;
    println!("difference {error:.4}, energy {energy:.4}, {walked_bytes} of {own_bytes} bytes");
    assert!(error < 0.06 && (energy - 1.0).abs() < 0.02 && error > 0.0, "{error}, {energy}");
}
