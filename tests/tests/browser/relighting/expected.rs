//! Light and pictures by the references on the processor, and on the adapter.

use std::path::Path;
use std::sync::Arc;

use glam::{Vec3, Vec4};
use lightkiln_client::bake::{Light, LightStream as _, LitScene, LoadedBake, Unshadowed};
use lightkiln_client::fetch::Source;
use lightkiln_client::kinds::prt::{self, PrtStream};
use lightkiln_client::lightmap::LightmapLight;
use lightkiln_client::lights::{Caster, Panorama, Sky, camera_of, lights_of, parse_camera, parse_lights};
use lightkiln_client::passes::gpu::Gpu;
use lightkiln_client::passes::meshes::Meshes;
use lightkiln_client::passes::shadow::reference::draw;
use lightkiln_client::passes::shadow::{Eye, ShadowPass, ShadowPlan, ShadowRoom};
use lightkiln_client::passes::stopwatch::Recorder;
use lightkiln_client::picture::{Exposure, Tone, developed};
use lightkiln_client::preview::{Backend, View, render};
use lightkiln_client::scene::{LoadedScene, Recolour, Tints};
use lightkiln_proto::relight::{Limit, LodEye, LodPlan, PatchTable, Settled};
use lightkiln_proto::scene::{SceneCamera, SceneLight};
use lightkiln_proto::words::lod_from_text;
use serde_json::{Value, json};

use super::SIZE;
use crate::skies;

/// Room of the shadow maps, in the browser too.
pub const ROOM: ShadowRoom = ShadowRoom { lights: 4, faces: 20, side: 512 };
/// End of the bounces.
pub const LIMIT: Limit = Limit { bounces_max: 256, change_max: 1e-5 };

/// A state of a frame.
#[derive(Clone)]
pub struct State {
    /// Name in messages.
    pub name: &'static str,
    /// Lights in words; the bake's own where there are none.
    pub lights: Option<Vec<String>>,
    /// Strength of emitters.
    pub emitters: f32,
    /// Camera in words; the bake's own where there is none.
    pub camera: Option<String>,
    /// Colours of materials other than the bake's.
    pub materials: Vec<Recolour>,
    /// Levels of detail in words; all detail where there are none.
    pub lod: Option<&'static str>,
    /// Turn in degrees and strength of the panorama (`super::super::skies::file`), where it is the sky.
    pub sky: Option<[f32; 2]>,
}

impl State {
    /// As the page reads it.
    pub fn to_json(&self) -> Value {
        let colour = |Recolour { material, base_colour }: &Recolour| json!({ "material": material, "baseColour": base_colour });
        json!({
            "name": self.name,
            "lights": self.lights,
            "emitters": self.emitters,
            "camera": self.camera,
            "materials": self.materials.iter().map(colour).collect::<Vec<_>>(),
            "lod": self.lod,
            "sky": self.sky,
        })
    }
}

/// A bake, with its light in the open.
pub struct Expected {
    bake: LoadedBake,
    /// As it was baked.
    baked: LoadedScene,
    colours: Vec<Recolour>,
    scene: LoadedScene,
    light: LightmapLight<PatchTable>,
    gpu: Gpu,
    source: Source,
}

impl Expected {
    /// Loads a bundle, and gives its materials other colours.
    pub fn new(folder: &Path, colours: &[Recolour]) -> Self {
        let source = Source::bundle(folder).unwrap();
        let baked = LoadedScene::load(&source).unwrap();
        let mut light = prt::load(&source, &baked).unwrap();
        tint(&mut light, &baked, colours);
        let mut bake = LoadedBake::load(&source, &lightkiln_client::kinds::all()).unwrap();
        bake.recolour(colours).unwrap();
        let scene = LoadedScene::clone(&bake.scene);
        Self { bake, baked, colours: colours.to_vec(), scene, light, gpu: Gpu::open().unwrap(), source }
    }

    /// The words with which colours are refused.
    pub fn refusal(&self, colours: &[Recolour]) -> String {
        Tints::of(&self.baked, colours).unwrap_err().to_string()
    }

    /// E_ind by slot, and the picture's radiance, by the references.
    pub fn on_processor(&self, state: &State) -> [Vec<Vec4>; 2] {
        let view = self.view(state);
        let plan = self.plan(&view);
        let maps = draw(&self.scene, &plan);
        let unshadowed = Unshadowed {
            sky: Sky::of(&view.lights),
            panorama: view.panorama.as_deref(),
            emitter_scale: &view.emitter_scale,
        };
        let lod = self.lod_plan(&self.light, &view);
        let lit = LitScene { scene: &self.scene, plan: &plan, maps: &maps, unshadowed, lod: lod.as_ref() };
        let settled = self.light.settled(&lit, &Default::default(), LIMIT).light;
        assert!(settled.converged);
        [settled.ind, self.radiance(&view, Backend::Cpu)]
    }

    /// The same by the adapter's passes.
    pub fn on_adapter(&self, state: &State) -> [Vec<Vec4>; 2] {
        let view = self.view(state);
        [self.indirect_on_adapter(&self.light, &view), self.radiance(&view, Backend::Gpu)]
    }

    /// E_ind by the adapter while the overview alone is there, in the order of its receivers.
    pub fn of_overview(&self, state: &State) -> Vec<Vec4> {
        let stream = PrtStream::begin(&self.source, &self.scene.manifest).unwrap();
        let mut light = stream.light(&self.scene, &self.scene.manifest).unwrap();
        tint(&mut *light, &self.baked, &self.colours);
        self.indirect_on_adapter(&*light, &self.view(state))
    }

    fn indirect_on_adapter(&self, light: &dyn Light, view: &View) -> Vec<Vec4> {
        let gpu = &self.gpu;
        let meshes = Meshes::new(gpu, &self.scene).unwrap();
        let shadow = ShadowPass::new(gpu, &self.scene, &meshes, &ROOM).unwrap();
        let plan = self.plan(view);
        shadow.set(gpu, &plan);
        let mut passes = light.passes(gpu, &self.scene, &shadow, SIZE).unwrap();
        let lod = self.lod_plan(light, view);
        if lod.is_some() {
            passes.make_lod(gpu, light.lod_table().unwrap()).unwrap();
            passes.set_lod(gpu, lod.as_ref());
        }
        let unshadowed = Unshadowed {
            sky: Sky::of(&view.lights),
            panorama: view.panorama.as_deref(),
            emitter_scale: &view.emitter_scale,
        };
        passes.set_unshadowed(gpu, &light.unshadowed(unshadowed));
        gpu.submit(|encoder| {
            let mut recorder = Recorder::untimed(encoder);
            shadow.record(&mut recorder, &meshes, 0..plan.faces.len());
            passes.relit(&mut recorder, &shadow);
        });
        let (e_ind, count) = passes.feedback().unwrap();
        let mut last = vec![Vec4::ZERO; count];
        let cycle = lod.as_ref().map_or(1, LodPlan::cycle) as usize;
        let mut changes = Vec::new();
        for bounce in 0..LIMIT.bounces_max {
            passes.set_turn(gpu, bounce);
            gpu.submit(|encoder| passes.bounce(&mut Recorder::untimed(encoder)));
            let next = gpu.read(e_ind, count).unwrap();
            changes.push(Settled::change(&last, &next));
            last = next;
            let in_cycle = changes.rchunks(cycle).next().filter(|latest| latest.len() == cycle);
            if in_cycle.is_some_and(|latest| latest.iter().sum::<f32>() < LIMIT.change_max) {
                break;
            }
        }
        last
    }

    /// The detail of each cluster for the camera of a view.
    fn lod_plan(&self, light: &dyn Light, view: &View) -> Option<LodPlan> {
        let [eye, target] = [view.camera.eye_m, view.camera.target_m].map(Vec3::from);
        let [low, high] = self.scene.manifest.bounds_m.map(Vec3::from);
        let to_corner = (0.5 * view.camera.fov_y_rad).tan() * (SIZE[0] as f32 / SIZE[1] as f32).hypot(1.0);
        let eye = LodEye {
            position_m: eye,
            forward: (target - eye).normalize(),
            view_cos: 1.0 / to_corner.hypot(1.0),
            diagonal_m: low.distance(high),
        };
        light.plan_lod(&view.lod?, eye, None)
    }

    /// The screen by the references, under an exposure and with so many samples a pixel: four bytes each.
    pub fn on_screen_of_processor(&self, state: &State, exposure: f32, samples: u32) -> Vec<u8> {
        let view = View { samples, exposure: Exposure::Fixed(exposure), ..self.view(state) };
        render(&self.bake, &view, Backend::Cpu).unwrap().ldr.concat()
    }

    fn radiance(&self, view: &View, backend: Backend) -> Vec<Vec4> {
        let picture = render(&self.bake, view, backend).unwrap();
        picture.linear.iter().map(|[r, g, b]| Vec4::new(*r, *g, *b, 1.0)).collect()
    }

    fn view(&self, state: &State) -> View {
        let manifest = &self.scene.manifest;
        let camera: SceneCamera = match &state.camera {
            Some(words) => parse_camera(words).unwrap(),
            None => camera_of(manifest).unwrap().0,
        };
        let lights: Vec<SceneLight> = match &state.lights {
            Some(words) => parse_lights(words).unwrap().lights,
            None => lights_of(manifest).0,
        };
        View {
            width: SIZE[0],
            height: SIZE[1],
            samples: 1,
            shadow_side: ROOM.side,
            limit: LIMIT,
            emitter_scale: vec![state.emitters; manifest.emitters.len()],
            lod: state.lod.map(|words| lod_from_text(words).unwrap()),
            panorama: state.sky.map(|[turn_deg, strength]| {
                Arc::new(Panorama::new(Arc::new(skies::image(&skies::file())), turn_deg, strength).unwrap())
            }),
            ..View::new(camera, lights)
        }
    }

    fn plan(&self, view: &View) -> ShadowPlan {
        let [eye, target] = [view.camera.eye_m, view.camera.target_m].map(glam::Vec3::from);
        let eye = Eye { position_m: eye, forward: (target - eye).normalize() };
        let bounds_m = self.scene.manifest.bounds_m;
        ShadowPlan::within(&ROOM, &Caster::of(&view.lights), bounds_m, Some(eye)).unwrap()
    }
}

/// Gives a light the albedo of other colours.
fn tint(light: &mut dyn Light, baked: &LoadedScene, colours: &[Recolour]) {
    let tints = Tints::of(baked, colours).unwrap();
    let albedo = light.tinted_albedo(baked, &tints).unwrap();
    light.set_albedo(albedo);
}

/// Radiance on the screen, four bytes a pixel.
pub fn on_screen(radiance: &[Vec4], exposure: f32) -> Vec<u8> {
    let rgb: Vec<[f32; 3]> = radiance.iter().map(|value| value.truncate().into()).collect();
    developed(&rgb, exposure, Tone::default()).concat()
}
