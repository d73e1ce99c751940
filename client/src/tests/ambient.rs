//! A kind of bake of the tests' own, without lightmap: constant ambient light from one chunk.

use glam::Vec3;
use lightkiln_proto::relight::Limit;
use wgpu::util::DeviceExt;

use super::view_of;
use crate::bake::{
    ClientKind, ClientKinds, Light, LightPasses, LitScene, LoadedBake, SettledLight, Unshadowed,
};
use crate::error::{ClientError, Result};
use crate::fetch::Source;
use crate::fixture::{self, BundleWriter};
use crate::kinds;
use crate::passes::gpu::{Gpu, uniform};
use crate::passes::shade::{IndirectIrradiance, Shading, Surface};
use crate::passes::shadow::ShadowPass;
use crate::preview::{Backend, debug_picture, render};
use crate::scene::{LoadedScene, decoded};

const NAME: &str = "ambient";
const SNIPPET: &str = "
@group(1) @binding(1) var<uniform> ambient: vec4f;
fn indirect_irradiance(surface: Surface) -> vec3f { return ambient.rgb; }
";

/// The kind.
struct Ambient;

/// Irradiance, W·m⁻².
#[derive(Clone, Copy, Debug, PartialEq)]
struct Constant(Vec3);

/// The same on the adapter.
struct Uploaded(wgpu::Buffer);

impl ClientKind for Ambient {
    fn name(&self) -> &'static str {
        NAME
    }

    fn load(&self, source: &Source, scene: &LoadedScene) -> Result<Box<dyn Light>> {
        let chunks = decoded(source, &scene.manifest, NAME, |bytes| Ok(serde_json::from_slice(bytes)?))?;
        let [irradiance] = chunks[..] else {
            return Err(ClientError::inconsistent(NAME, "has one chunk"));
        };
        let irradiance: [f32; 3] = irradiance;
        Ok(Box::new(Constant(irradiance.into())))
    }
}

impl IndirectIrradiance for Constant {
    fn indirect_irradiance(&self, _: &Surface) -> Vec3 {
        self.0
    }
}

impl Light for Constant {
    fn shading(&self) -> Shading {
        Shading { snippet: SNIPPET, bindings: vec![uniform(false)] }
    }

    fn settle<'a>(&'a self, _: &LitScene<'a>, _: Limit) -> SettledLight<'a> {
        SettledLight { indirect: Box::new(*self), bounces: 0, converged: true }
    }

    fn passes(
        &self,
        gpu: &Gpu,
        _: &LoadedScene,
        _: &ShadowPass,
        _: Unshadowed<'_>,
    ) -> Result<Box<dyn LightPasses>> {
        let irradiance = self.0.extend(0.0).to_array();
        Ok(Box::new(Uploaded(gpu.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some(NAME),
            contents: bytemuck::bytes_of(&irradiance),
            usage: wgpu::BufferUsages::UNIFORM,
        }))))
    }
}

impl LightPasses for Uploaded {
    fn bindings(&self) -> Vec<wgpu::BindingResource<'_>> {
        vec![self.0.as_entire_binding()]
    }
}

fn kinds() -> ClientKinds {
    kinds::all().with(Ambient)
}

/// The fixture's scene under constant light.
pub(super) fn bake() -> LoadedBake {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = BundleWriter::new(folder.path(), NAME);
    writer.manifest.lightmap = None;
    writer.add(NAME, b"[3.0, 2.0, 1.0]".to_vec());
    writer.finish();
    LoadedBake::load(&Source::bundle(folder.path()).unwrap(), &kinds()).unwrap()
}

#[test]
fn kind_without_lightmap_lights_a_picture() {
    let bake = bake();
    assert!(bake.scene.warnings.is_empty(), "{:?}", bake.scene.warnings);
    let view = view_of(&bake);
    let dark = crate::preview::View { lights: Vec::new(), emitter_scale: vec![0.0], samples: 1, ..view };
    let picture = render(&bake, &dark, Backend::Cpu).unwrap();
    assert_eq!((picture.bounces, picture.converged), (0, true));
    // Grey walls of albedo 0.7: L = ρ/π · E.
    let wanted = Vec3::new(3.0, 2.0, 1.0) * 0.7 / std::f32::consts::PI;
    let grey = picture.linear.iter().filter(|found| Vec3::from(**found).abs_diff_eq(wanted, 1e-5)).count();
    assert!(grey > picture.linear.len() / 10, "{grey} of {}", picture.linear.len());
}

#[test]
fn kind_without_pictures_for_finding_faults_says_so() {
    let bake = bake();
    let error = debug_picture(&bake, &view_of(&bake), "atlas", 0).unwrap_err().to_string();
    assert!(error.contains("kind 'ambient'") && error.contains("none"), "{error}");
    assert!(bake.light.lightmap(&bake.scene).is_none());
}

#[test]
fn kind_that_is_not_in_the_table_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    fixture::write_bundle(folder.path(), lightkiln_proto::kinds::prt::NAME);
    let alone = ClientKinds::new().with(Ambient);
    let error = LoadedBake::load(&Source::bundle(folder.path()).unwrap(), &alone).unwrap_err().to_string();
    assert!(error.contains("'prt'") && error.contains("ambient"), "{error}");
}
