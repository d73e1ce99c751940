//! Nodes of a scene that move: left out of its bake, and baked as objects of their own.

use std::collections::BTreeSet;
use std::path::Path;

use clap::Args;
use lightkiln_proto::kinds::{Kinds, Warning};
use lightkiln_proto::scene::Stance;
use lightkiln_worker::scene::model::Warning as SceneWarning;
use lightkiln_worker::scene::movers::SplitObject;
use serde_json::{Map, json};

use crate::bundle::refuse_foreign_folder;
use crate::console::say;
use crate::failure::{Failure, Result};
use crate::objects::ObjectArgument;
use crate::outputs::check_folder;
use crate::settings::{PRESET, Wanted, assign};
use crate::submission::{PackedScene, nodes_that_move};

/// Ending of a bundle's folder.
const ENDING: &str = "kiln";
/// Most characters of a node's name in that of a folder.
const NAME_CHARS_MAX: usize = 60;

/// Arguments that name nodes that move.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "Objects that move")]
pub struct MoverArguments {
    /// Node that moves, with all below it, by its name in the glTF: it is left out of the scene, and baked as an object of its own into
    /// OUT.NODE.kiln beside OUT.kiln, for --object of 'kiln preview'; may be given often. 'animated' stands for all nodes that an animation
    /// moves, turns or scales, each a rigid object. The scene is baked with voxels=on, unless its kind has them anyhow. Lights and cameras
    /// below the node stay in the scene
    #[arg(long, value_name = "NODE")]
    pub mover: Vec<String>,
    /// Sets one setting of the movers' bakes, e.g. --mover-set texel_m=0.01; may be given often. They have the scene's preset, and else
    /// settings of their own: --set is the scene's
    #[arg(long, value_name = "SETTING=VALUE", requires = "mover")]
    mover_set: Vec<String>,
}

/// The bake of a node that moves, to be made.
pub struct MoverBake {
    /// Name of the node.
    pub node: String,
    /// Its scene.
    pub scene: PackedScene,
    /// Its kind and settings.
    pub wanted: Wanted,
    /// Folder of its bundle, and where the scene has it.
    pub object: ObjectArgument,
}

/// A scene without what moves in it, and what does.
pub struct Parted {
    /// The scene.
    pub scene: PackedScene,
    /// Its kind, with settings under which it lights objects.
    pub wanted: Wanted,
    /// Bakes of its movers.
    pub movers: Vec<MoverBake>,
    /// What was not honoured.
    pub warnings: Vec<Warning>,
}

impl MoverArguments {
    /// Takes the nodes out of a scene, which is to be baked as `wanted` into `out`.
    ///
    /// Errors, before any work is done, on nodes that cannot move, on a bake that cannot light objects, and on folders that cannot be written.
    pub fn part(&self, kinds: &Kinds, scene: PackedScene, wanted: Wanted, out: &Path) -> Result<Parted> {
        let Some(nodes) = nodes_that_move(self.mover.clone()) else {
            return Ok(Parted { scene, wanted, movers: Vec::new(), warnings: Vec::new() });
        };
        if out.file_name().is_none() {
            let what =
                format!("bundles of movers have names after that of --out, and {} has none", out.display());
            return Err(Failure::bad_input(what).try_this("--out with a name, as ./room.kiln"));
        }
        let scene_wanted = wanted_beside_objects(&wanted)?;
        let has_more = scene_wanted.settings != wanted.settings;
        let wanted = self.of_objects(kinds, &wanted)?;
        let (scene, split) = scene.split(&nodes)?;
        let warnings = split.warnings.into_iter().map(|SceneWarning { code, message }| {
            say!("warning: {message}");
            Warning { code, message, try_setting: None }
        });
        let warnings = warnings.collect();
        let mut taken = BTreeSet::new();
        let of = |SplitObject { name, scene: bytes, stance }: SplitObject| {
            let object = object_at(out, &name, stance, &mut taken);
            refuse_foreign_folder(object.file())?;
            check_folder(object.file())?;
            let scene = PackedScene::new(&format!("{} {name}", scene.name), bytes);
            Ok(MoverBake { node: name, scene, wanted: wanted.clone(), object })
        };
        let movers = split.objects.into_iter().map(of).collect::<Result<_>>()?;
        if has_more {
            say!("note: the scene is baked with voxels, which tell its light to the movers");
        }
        Ok(Parted { scene, wanted: scene_wanted, movers, warnings })
    }

    /// Kind and settings of the movers' bakes: the preset of the scene's, and their own.
    fn of_objects(&self, kinds: &Kinds, of_scene: &Wanted) -> Result<Wanted> {
        let Some(kind) = kinds.of_objects() else {
            return Err(Failure::bad_input("no kind of bake is one of objects that move"));
        };
        let mut settings = Map::new();
        if let Some(preset) = of_scene.settings.get(PRESET) {
            settings.insert(PRESET.to_owned(), preset.clone());
        }
        assign(&mut settings, "--mover-set", &self.mover_set)?;
        Wanted::new(kind, settings)
    }
}

/// The scene's kind, with settings under which it lights objects.
fn wanted_beside_objects(wanted: &Wanted) -> Result<Wanted> {
    let (kind, name) = (wanted.kind, wanted.kind.name());
    if kind.is_of_objects() {
        let what =
            format!("--mover takes objects out of a scene, and kind {name} bakes a file as one object");
        return Err(Failure::bad_input(what).try_this("it without --mover, or another --kind"));
    }
    let Some(settings) = kind.beside_objects(&wanted.settings) else {
        let is_ruled_out = kind.beside_objects(&json!({})).is_some();
        let what = format!(
            "a scene with movers is baked with voxels, which tell its light to them, and kind {name}"
        );
        return Err(if is_ruled_out {
            Failure::bad_input(format!("{what} has them switched off")).try_this("it with --set voxels=on")
        } else {
            Failure::bad_input(format!("{what} has none"))
                .try_this("another --kind, as 'kiln settings' lists them")
        });
    };
    Ok(Wanted { kind, settings })
}

/// The bundle of a node's bake beside that of its scene: `a.kiln` and `a.chair.kiln`.
fn object_at(out: &Path, node: &str, stance: Stance, taken: &mut BTreeSet<String>) -> ObjectArgument {
    let is_plain = |c: char| c.is_alphanumeric() || matches!(c, '-' | '_' | '.');
    let plain = node.chars().take(NAME_CHARS_MAX).map(|c| if is_plain(c) { c } else { '_' });
    let plain: String = plain.collect();
    let mut name = plain.clone();
    // Some file systems do not tell capitals apart.
    for number in 2.. {
        if taken.insert(name.to_lowercase()) {
            break;
        }
        name = format!("{plain}-{number}");
    }
    let is_bundle = out.extension().is_some_and(|ending| ending == ENDING);
    let stem = if is_bundle { out.with_extension("") } else { out.to_owned() };
    ObjectArgument::new(stem.with_added_extension(name).with_added_extension(ENDING), stance)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bundles_of_movers_lie_beside_that_of_the_scene_under_names_that_are_files() {
        let mut taken = BTreeSet::new();
        let mut at = |out: &str, node: &str| {
            object_at(Path::new(out), node, Stance::default(), &mut taken).file().display().to_string()
        };
        assert_eq!(at("a/room.kiln", "chair"), "a/room.chair.kiln");
        assert_eq!(at("a/room.kiln", "Chair"), "a/room.Chair-2.kiln");
        assert_eq!(at("room.v2", "stuhl für gäste"), "room.v2.stuhl_für_gäste.kiln");
        assert_eq!(at("room.kiln", "../a/b c"), "room..._a_b_c.kiln");
        assert_eq!(at("room.kiln", "chair.001"), "room.chair.001.kiln");
        assert_eq!(at("room.kiln", &"é".repeat(300)).chars().count(), "room..kiln".len() + NAME_CHARS_MAX);
    }

    #[test]
    fn movers_have_the_scenes_preset_and_settings_of_their_own() {
        let kinds = Kinds::new();
        let wanted = |settings: serde_json::Value| Wanted {
            kind: kinds.default_kind(),
            settings: settings.as_object().unwrap().clone().into(),
        };
        let arguments = MoverArguments { mover: Vec::new(), mover_set: vec!["texel_m=0.1".to_owned()] };
        let own = arguments.of_objects(&kinds, &wanted(json!({"preset": "draft", "voxels": "on"}))).unwrap();
        assert!(own.kind.is_of_objects());
        assert_eq!(own.settings, json!({"preset": "draft", "texel_m": 0.1}));
        let scene = wanted_beside_objects(&wanted(json!({"texel_m": 0.2}))).unwrap();
        assert_eq!(scene.settings, json!({"texel_m": 0.2, "voxels": "on"}));
        let off = wanted_beside_objects(&wanted(json!({"voxels": "off"}))).err().unwrap().to_string();
        assert!(off.contains("switched off"), "{off}");
    }
}
