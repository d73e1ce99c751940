//! Objects that move through a bake, held against paths traced with the object in place: error of indirect light near it and everywhere, beside
//! the object ignored.

use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;

use anyhow::Result;
use kiln::amid::{Amid, AmidLight, Counts, Judged};
use lightkiln_client::bake::LoadedBake;
use lightkiln_client::fetch::Source;
use lightkiln_client::kinds;
use lightkiln_client::picture::write_png;
use lightkiln_client::scene::Stance;
use lightkiln_proto::scene::SceneCamera;
use lightkiln_worker::evaluate::{TestLight, default_lights};
use lightkiln_worker::scene::model::Scene;
use lightkiln_worker::scene::{self, Bundle, Limits};
use lightkiln_worker::task::Progress;
use tempfile::TempDir;

use crate::harness::{Recipe, bake};

/// Size of pictures in pixels.
const SIZE: (u32, u32) = (320, 240);
/// Places near an object, elsewhere, and on its own surface.
const COUNTS: Counts = Counts { near: 400, elsewhere: 200, own: 200 };

/// An object in a scene.
pub struct Setting {
    /// Bundle of the scene.
    pub scene: Vec<u8>,
    /// Bundle of the object.
    pub object: Vec<u8>,
    /// Where it stands.
    pub stance: Stance,
    /// Settings of the scene's bake.
    pub settings: serde_json::Value,
    /// Settings of the object's.
    pub object_settings: serde_json::Value,
    /// Standard error of the reference.
    pub rel_error: f64,
    /// Names of lights; all that suit the scene without.
    pub lights: Vec<String>,
}

/// Errors by light.
pub type Measured = Vec<(TestLight, AmidLight)>;

fn imported(bundle: &[u8]) -> Result<Scene> {
    let opened = Bundle::from_bytes(bundle.to_vec(), &Limits::default())?;
    Ok(scene::import(&opened, &Limits::default())?.scene)
}

fn baked(bundle: &[u8], kind: &'static str, settings: &serde_json::Value) -> Result<TempDir> {
    let made = bake(bundle.to_vec(), &Recipe { kind, settings: settings.clone() })?;
    let folder = tempfile::tempdir()?;
    made.write(folder.path())?;
    Ok(folder)
}

fn loaded(folder: &TempDir) -> kiln::Result<LoadedBake> {
    Ok(LoadedBake::load(&Source::bundle(folder.path())?, &kinds::all())?)
}

/// Scene and object, baked.
fn amid(setting: &Setting) -> Result<Amid> {
    let scenes = (imported(&setting.scene)?, imported(&setting.object)?);
    let mut settings = setting.settings.clone();
    settings["voxels"] = "on".into();
    let scene = baked(&setting.scene, "prt", &settings)?;
    let of_object = loaded(&baked(&setting.object, "transfer", &setting.object_settings)?)?;
    Ok(Amid::new(&|| loaded(&scene), Arc::new(of_object), scenes)?)
}

/// The scene's own choice of lights, as far as they are wanted.
fn lights_of(amid: &Amid, wanted: &[String]) -> Vec<TestLight> {
    let all = default_lights(amid.alone()).lights.into_iter();
    all.filter(|light| wanted.is_empty() || wanted.contains(&light.name)).collect()
}

/// Bakes scene and object and measures under the scene's own choice of lights.
pub fn measured(setting: &Setting) -> Result<Measured> {
    let amid = amid(setting)?;
    let posed = amid.at(&setting.stance, &COUNTS)?;
    let of = |light: TestLight| {
        let errors = posed.measured(&light, setting.rel_error, &Progress::new())?;
        Ok((light, errors))
    };
    lights_of(&amid, &setting.lights).into_iter().map(of).collect()
}

/// A table in Markdown of one setting, measured.
pub fn table(name: &str, found: &Measured) -> Result<String> {
    let mut page = String::new();
    let share = |judged: &Judged| 100.0 * judged.figures.rel_rmse;
    for (light, errors) in found {
        writeln!(
            page,
            "| {name} | {} | {:.1} | {:.1} | {:.2} | {:.1} | {:.1} | {:.1} | {:.3} | {:.1} | {:.3} |",
            light.name,
            share(&errors.near),
            share(&errors.near_ignored),
            errors.ratio(),
            share(&errors.near_alone),
            share(&errors.all),
            share(&errors.all_ignored),
            errors.near.figures.energy_ratio,
            share(&errors.own),
            errors.own.figures.energy_ratio,
        )?;
    }
    Ok(page)
}

/// Head of such tables.
pub const HEAD: &str = "| object | light | near, % | ignored, % | ratio | bake alone, % | all, % | ignored, % | energy near | own surface, % | its energy |\n|---|---|---|---|---|---|---|---|---|---|---|\n";

/// Reads a bundle of a file.
pub fn packed(path: &Path) -> Result<Vec<u8>> {
    Ok(Bundle::pack_path(path, &Limits::default())?)
}

/// Draws pictures of each light from a camera: with the object, where indirect light ignores it, by paths; and the first two less the third, blue
/// where too dark, red where too bright.
pub fn pictures(setting: &Setting, camera: &SceneCamera, folder: &Path) -> Result<()> {
    let amid = amid(setting)?;
    let posed = amid.at(&setting.stance, &COUNTS)?;
    std::fs::create_dir_all(folder)?;
    for light in lights_of(&amid, &setting.lights) {
        let strip = posed.strip(&light, camera, SIZE, &Progress::new())?;
        write_png(&folder.join(format!("{}.png", light.name)), strip.width, strip.height, &strip.pixels)?;
    }
    Ok(())
}
