//! A kind of the tests' own, without lightmap, whose light follows the camera: either backend prepares it for each view.

use glam::{Vec3, Vec4};
use lightkiln_proto::manifest::Manifest;
use lightkiln_proto::relight::Limit;

use super::view_of;
use crate::bake::{Among, Light, LightPasses, LitScene, LoadedBake, SettledLight};
use crate::error::Result;
use crate::fixture::{geometry, manifest, texture};
use crate::passes::gpu::{Gpu, uniform};
use crate::passes::shade::{IndirectIrradiance, ShadeView, Shading, Surface};
use crate::passes::shadow::ShadowPass;
use crate::passes::stopwatch::Recorder;
use crate::preview::{Backend, View, debug_picture, jitters, render};
use crate::scene::LoadedScene;

const NAME: &str = "facing";
const SNIPPET: &str = "
@group(1) @binding(1) var<uniform> facing: vec4f;
fn indirect_irradiance(surface: Surface) -> Indirect { return Indirect(facing.rgb, facing.rgb); }
";

/// Irradiance in W·m⁻²: how far the picture's middle ray goes along each axis.
fn facing(view: &ShadeView) -> Vec4 {
    Vec4::from(view.ray).abs()
}

/// The kind's light.
#[derive(Debug)]
struct Facing;

/// Irradiance of the view prepared last, W·m⁻².
struct Seen(Vec3);

/// The same on the adapter, by way of a copy.
struct Uploaded {
    written: wgpu::Buffer,
    bound: wgpu::Buffer,
}

impl IndirectIrradiance for Seen {
    fn prepare_view(&mut self, view: &ShadeView, size: [u32; 2]) {
        assert_eq!(size, [160, 120]);
        self.0 = facing(view).truncate();
    }

    fn indirect_irradiance(&self, _: &Surface) -> Vec3 {
        self.0
    }
}

impl Light for Facing {
    fn shading(&self) -> Shading {
        Shading { snippet: SNIPPET, bindings: vec![uniform(false)] }
    }

    fn settle<'a>(&'a self, _: &LitScene<'a>, _: &Among<'_>, _: Limit) -> SettledLight<'a> {
        SettledLight { indirect: Box::new(Seen(Vec3::ZERO)), walks: None, bounces: 0, converged: true }
    }

    fn passes(
        &self,
        gpu: &Gpu,
        _: &LoadedScene,
        _: &ShadowPass,
        size: [u32; 2],
    ) -> Result<Box<dyn LightPasses>> {
        assert_eq!(size, [160, 120]);
        let bytes = size_of::<Vec4>() as u64;
        let written = gpu.buffer("written", bytes, wgpu::BufferUsages::COPY_SRC);
        Ok(Box::new(Uploaded { written, bound: gpu.uniform("bound", &Vec4::ZERO) }))
    }
}

impl LightPasses for Uploaded {
    fn prepare_view(&self, gpu: &Gpu, encoder: &mut Recorder<'_>, view: &ShadeView) {
        gpu.write(&self.written, &[facing(view)]);
        encoder.copy_buffer_to_buffer(&self.written, 0, &self.bound, 0, size_of::<Vec4>() as u64);
    }

    fn bindings(&self) -> Vec<wgpu::BindingResource<'_>> {
        vec![self.bound.as_entire_binding()]
    }
}

/// The fixture's scene, without its lightmap, under this light.
pub(super) fn bake() -> LoadedBake {
    let manifest = Manifest { lightmap: None, ..manifest(NAME) };
    let scene = LoadedScene::assemble(manifest, vec![geometry()], vec![texture()]).unwrap();
    LoadedBake::new(scene, Box::new(Facing))
}

/// As [`bake`], with glass in the room.
pub(crate) fn glazed_bake() -> LoadedBake {
    let manifest = Manifest { lightmap: None, ..manifest(NAME) };
    let mut geometry = geometry();
    geometry.draws.extend(super::glass::glazed());
    let scene = LoadedScene::assemble(manifest, vec![geometry], vec![texture()]).unwrap();
    LoadedBake::new(scene, Box::new(Facing))
}

#[test]
fn light_of_a_kind_without_lightmap_follows_each_view() {
    let bake = bake();
    assert!(bake.scene.warnings.is_empty(), "{:?}", bake.scene.warnings);
    let here = View { lights: Vec::new(), emitter_scale: vec![0.0], ..view_of(&bake) };
    let mut there = here.clone();
    there.camera.eye_m[0] += 0.7;
    for view in [here, there] {
        let picture = render(&bake, &view, Backend::Cpu).unwrap();
        assert_eq!((picture.bounces, picture.converged), (0, true));
        let bounds_m = bake.scene.manifest.bounds_m;
        let of = |jitter| ShadeView::new(&view.camera, view.size(), bounds_m, Default::default(), jitter);
        let rays = jitters(view.samples).into_iter().map(|jitter| facing(&of(jitter).unwrap()).truncate());
        // Grey walls of albedo 0.7: L = ρ/π · E, the mean over samples.
        let wanted = rays.sum::<Vec3>() / view.samples as f32 * 0.7 / std::f32::consts::PI;
        let equal = |found: &&[f32; 3]| Vec3::from(**found).abs_diff_eq(wanted, 1e-6);
        let grey = picture.linear.iter().filter(equal).count();
        assert!(grey > picture.linear.len() / 10, "{grey} of {}", picture.linear.len());
    }
}

#[test]
fn kind_without_pictures_for_finding_faults_says_so() {
    let bake = bake();
    let error = debug_picture(&bake, &view_of(&bake), "atlas", 0).unwrap_err().to_string();
    assert!(error.contains("kind 'facing'") && error.contains("none"), "{error}");
    assert!(bake.light.lightmap(&bake.scene).is_none());
}
