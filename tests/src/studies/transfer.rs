//! Objects that move through a bake, held against paths traced with the object in place: error of indirect light near it and everywhere, beside
//! the object ignored.

use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result};
use glam::{Affine3A, DVec3, EulerRot, Quat, Vec3, Vec4};
use lightkiln_client::bake::{Beside, LoadedBake};
use lightkiln_client::fetch::Source;
use lightkiln_client::kinds;
use lightkiln_client::picture::{Tone, developed, write_png};
use lightkiln_client::preview::{Backend, View, light_receivers_among, render};
use lightkiln_client::scene::Stance;
use lightkiln_proto::scene::SceneCamera;
use lightkiln_worker::evaluate::{TestLight, default_lights};
use lightkiln_worker::geometry::{Geometry, Site};
use lightkiln_worker::reference::{IrradianceEstimate, PictureSize, Precision, Reference, luminance};
use lightkiln_worker::scene::model::Scene;
use lightkiln_worker::scene::{self, Bundle, Limits};
use lightkiln_worker::task::Progress;

use tempfile::TempDir;

use crate::harness::{Recipe, bake};

/// Radii of an object within which its surroundings are near.
const NEAR_RADII: f32 = 3.0;
/// Size of pictures in pixels.
const WIDTH: u32 = 320;
const HEIGHT: u32 = 240;
/// Sites near an object, and elsewhere.
const SITES: [usize; 2] = [400, 200];

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

/// Scene and object, baked, and both for paths.
struct Baked {
    with_object: LoadedBake,
    /// With the object's meshes alone, which indirect light ignores.
    ignored: LoadedBake,
    empty: LoadedBake,
    /// The scene without the object.
    alone: Geometry,
    together: Geometry,
    stance: Stance,
}

/// Errors under one light, as shares of the mean near the object; the reference's own noise is taken off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shares {
    /// Of the bake with the object near it, and over all.
    pub with_object: [f64; 2],
    /// Where indirect light ignores it.
    pub ignored: [f64; 2],
    /// Of the bake without the object, against paths without it, at the same places.
    pub alone: f64,
    /// Mean of the bake over that of the reference near the object.
    pub energy: f64,
}

/// Sums over sites.
struct Errors {
    /// Mean square of the difference less that of noise.
    square: f64,
    mean: f64,
    energy: f64,
}

impl Errors {
    fn of<'a>(
        pairs: impl Iterator<Item = ((&'a (usize, Site, bool), &'a DVec3), &'a IrradianceEstimate)>,
    ) -> Self {
        let (mut square, mut total, mut own, mut count) = (0.0, 0.0, 0.0, 0.0_f64);
        for ((_, found), truth) in pairs {
            let wanted = truth.indirect.mean;
            square += luminance(*found - wanted).powi(2) - truth.indirect.luminance_error.powi(2);
            total += luminance(wanted);
            own += luminance(*found);
            count += 1.0;
        }
        let count = count.max(1.0);
        Self { square: square / count, mean: total / count, energy: own / total }
    }

    fn relative(&self, mean: f64) -> f64 {
        self.square.max(0.0).sqrt() / mean
    }
}

/// Errors by light.
pub type Measured = Vec<(TestLight, Shares)>;

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

fn loaded(folder: &TempDir) -> Result<LoadedBake> {
    Ok(LoadedBake::load(&Source::bundle(folder.path())?, &kinds::all())?)
}

/// Place of a stance.
pub fn place_of(stance: &Stance) -> Affine3A {
    let [yaw, pitch, roll] = stance.turn_deg.map(f32::to_radians);
    let turn = Quat::from_euler(EulerRot::YXZ, yaw, pitch, roll);
    Affine3A::from_scale_rotation_translation(Vec3::splat(stance.scale), turn, stance.position_m.into())
}

impl Baked {
    fn of(setting: &Setting) -> Result<Self> {
        let (statics, object) = (imported(&setting.scene)?, imported(&setting.object)?);
        let place = place_of(&setting.stance);
        let alone = Geometry::new(statics.clone())?;
        let together = Geometry::new(statics.with_object(&object, &place))?;
        let of_object = Arc::new(loaded(&baked(&setting.object, "transfer", &setting.object_settings)?)?);
        let mut settings = setting.settings.clone();
        settings["voxels"] = "on".into();
        let scene = baked(&setting.scene, "prt", &settings)?;
        let [mut with_object, mut ignored, empty] = [loaded(&scene)?, loaded(&scene)?, loaded(&scene)?];
        ignored.put(Beside::meshes_of(&of_object, "object"))?;
        with_object.put(Beside::Baked { name: "object".to_owned(), bake: of_object })?;
        Ok(Self { with_object, ignored, empty, alone, together, stance: setting.stance })
    }

    /// Middle and radius of the object where it stands, in metres.
    fn ball(&self) -> Result<(Vec3, f32)> {
        let mover = self.with_object.movers.first().context("there is no object")?;
        let [low, high] = mover.bake.scene.manifest.bounds_m.map(Vec3::from);
        let middle_m = place_of(&self.stance).transform_point3(0.5 * (low + high));
        Ok((middle_m, 0.5 * (high - low).length() * self.stance.scale))
    }

    /// The scene's own choice of lights, as far as they are wanted.
    fn lights(&self, wanted: &[String]) -> Vec<TestLight> {
        let all = default_lights(&self.alone).lights.into_iter();
        all.filter(|light| wanted.is_empty() || wanted.contains(&light.name)).collect()
    }
}

/// Bakes scene and object and measures under the scene's own choice of lights.
pub fn measured(setting: &Setting) -> Result<Measured> {
    let baked = Baked::of(setting)?;
    let Baked { with_object: with, ignored: without, empty, alone, together, .. } = &baked;
    let (middle_m, radius_m) = baked.ball()?;
    let sites = sites(with, together, middle_m, radius_m)?;
    let mut found = Vec::new();
    for chosen in baked.lights(&setting.lights) {
        let reference = Reference::new(together, &chosen.lighting)?;
        let precision = Precision { rel_error: setting.rel_error, paths_max: 1 << 15 };
        let places: Vec<Site> = sites.iter().map(|(_, site, _)| *site).collect();
        let traced = |reference: &Reference<'_>| {
            reference.irradiance(&places, &precision, &Progress::new()).context("cancelled")
        };
        let truth = traced(&reference)?;
        let truth_alone = traced(&Reference::new(alone, &chosen.lighting)?)?;
        let emitters = vec![chosen.lighting.emitter_scale; with.scene.manifest.emitters.len()];
        let lit = |bake: &LoadedBake| -> Result<Vec<DVec3>> {
            let (lights, panorama) = (chosen.lighting.lights.clone(), chosen.lighting.panorama.clone());
            let stances = vec![setting.stance; bake.scene.objects()];
            let lit =
                light_receivers_among(bake, lights, panorama, emitters.clone(), &stances, Backend::Cpu)?;
            let light = lit.settled.light;
            let of = |(slot, ..): &(usize, Site, bool)| {
                let sum: Vec4 = light.indirect[*slot] + light.emit[*slot];
                sum.truncate().as_dvec3()
            };
            Ok(sites.iter().map(of).collect())
        };
        let ours = lit(with)?;
        let near = Errors::of(sites.iter().zip(&ours).zip(&truth).filter(|((site, _), _)| site.2));
        let share = |found: &[DVec3], truth: &[IrradianceEstimate], is_near: bool| {
            let pairs = sites.iter().zip(found).zip(truth).filter(|((site, _), _)| site.2 || !is_near);
            Errors::of(pairs).relative(near.mean)
        };
        let ignored = lit(without)?;
        let shares = Shares {
            with_object: [share(&ours, &truth, true), share(&ours, &truth, false)],
            ignored: [share(&ignored, &truth, true), share(&ignored, &truth, false)],
            alone: share(&lit(empty)?, &truth_alone, true),
            energy: near.energy,
        };
        found.push((chosen, shares));
    }
    Ok(found)
}

/// Receivers with their slots: near the object and elsewhere, evenly chosen; none within it.
fn sites(
    bake: &LoadedBake,
    together: &Geometry,
    middle_m: Vec3,
    radius_m: f32,
) -> Result<Vec<(usize, Site, bool)>> {
    let lightmap = bake.light.lightmap(&bake.scene).context("the bake has no lightmap")?;
    let receivers = lightmap.receivers;
    let site = |slot: usize| {
        let [position_m, normal] = [receivers.position_m[slot].truncate(), receivers.normal[slot].truncate()];
        Site { position_m, normal, face_normal: normal }
    };
    let is_free = |slot: usize| {
        let Site { position_m, normal, .. } = site(slot);
        !lightkiln_worker::kinds::field::is_inside(together, together.lifted(position_m, normal))
    };
    let is_near = |slot: usize| site(slot).position_m.distance(middle_m) < NEAR_RADII * radius_m;
    let mut chosen = Vec::new();
    for (count, near) in SITES.into_iter().zip([true, false]) {
        let all: Vec<usize> = (0..receivers.len()).filter(|slot| is_near(*slot) == near).collect();
        let step = (all.len() / count).max(1);
        let some = all.into_iter().step_by(step).filter(|slot| is_free(*slot));
        chosen.extend(some.map(|slot| (slot, site(slot), near)));
    }
    Ok(chosen)
}

/// A table in Markdown of one setting, measured.
pub fn table(name: &str, found: &Measured) -> Result<String> {
    let mut page = String::new();
    for (light, Shares { with_object, ignored, alone, energy }) in found {
        writeln!(
            page,
            "| {name} | {} | {:.1} | {:.1} | {:.2} | {:.1} | {:.1} | {:.1} | {energy:.3} |",
            light.name,
            100.0 * with_object[0],
            100.0 * ignored[0],
            with_object[0] / ignored[0],
            100.0 * alone,
            100.0 * with_object[1],
            100.0 * ignored[1],
        )?;
    }
    Ok(page)
}

/// Head of such tables.
pub const HEAD: &str = "| object | light | near, % | ignored, % | ratio | bake alone, % | all, % | ignored, % | energy near |\n|---|---|---|---|---|---|---|---|---|\n";

/// Reads a bundle of a file.
pub fn packed(path: &Path) -> Result<Vec<u8>> {
    Ok(Bundle::pack_path(path, &Limits::default())?)
}

/// Draws pictures of each light from a camera: with the object, where indirect light ignores it, by paths; and the first two less the third, blue
/// where too dark, red where too bright.
pub fn pictures(setting: &Setting, camera: &SceneCamera, folder: &Path) -> Result<()> {
    let baked = Baked::of(setting)?;
    std::fs::create_dir_all(folder)?;
    for chosen in baked.lights(&setting.lights) {
        let size = PictureSize { width: WIDTH, height: HEIGHT, grid: 24 };
        let reference = Reference::new(&baked.together, &chosen.lighting)?;
        let traced = reference.picture(camera, &size, &Progress::new()).context("cancelled")?.radiance;
        let emitters = baked.empty.scene.manifest.emitters.len();
        let drawn = |bake: &LoadedBake| -> Result<Vec<[f32; 3]>> {
            let view = View {
                width: WIDTH,
                height: HEIGHT,
                samples: 4,
                panorama: chosen.lighting.panorama.clone(),
                emitter_scale: vec![chosen.lighting.emitter_scale; emitters],
                objects: vec![baked.stance],
                ..View::new(camera.clone(), chosen.lighting.lights.clone())
            };
            Ok(render(bake, &view, Backend::Cpu)?.linear)
        };
        let all = [drawn(&baked.with_object)?, drawn(&baked.ignored)?, traced];
        let value = |rgb: &[f32; 3]| luminance(DVec3::from(rgb.map(f64::from))) as f32;
        let mean = all[2].iter().map(value).sum::<f32>() / all[2].len() as f32;
        let heat = |picture: &[[f32; 3]]| -> Vec<[u8; 4]> {
            let of = |(own, truth): (&[f32; 3], &[f32; 3])| {
                let off = ((value(own) - value(truth)) / (0.3 * mean)).clamp(-1.0, 1.0);
                let [less, more] = [-off, off].map(|off| ((1.0 - off.max(0.0)) * 255.0) as u8);
                [less, less.min(more), more, 255]
            };
            picture.iter().zip(&all[2]).map(of).collect()
        };
        let exposure = 0.35 / mean;
        let mut panels: Vec<Vec<[u8; 4]>> =
            all.iter().map(|picture| developed(picture, exposure, Tone::default())).collect();
        panels.extend([heat(&all[0]), heat(&all[1])]);
        let across = WIDTH as usize * panels.len();
        let mut pixels = vec![[0; 4]; across * HEIGHT as usize];
        for (number, panel) in panels.iter().enumerate() {
            for (row, line) in panel.chunks(WIDTH as usize).enumerate() {
                let first = row * across + number * WIDTH as usize;
                pixels[first..first + WIDTH as usize].copy_from_slice(line);
            }
        }
        write_png(&folder.join(format!("{}.png", chosen.name)), across as u32, HEIGHT, &pixels)?;
    }
    Ok(())
}
