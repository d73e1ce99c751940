//! The client's side of the kind: its chunk, and one shading function for adapter and processor.

use glam::Vec3;
use lightkiln_client::bake::{Among, ClientKind, Light, LightPasses, LitScene, SettledLight};
use lightkiln_client::fetch::{Source, decoded};
use lightkiln_client::passes::gpu::{Gpu, uniform};
use lightkiln_client::passes::shade::{IndirectIrradiance, Shading, Surface};
use lightkiln_client::passes::shadow::ShadowPass;
use lightkiln_client::scene::LoadedScene;
use lightkiln_client::{ClientError, Result, wgpu};
use lightkiln_proto::kinds::Kind;
use lightkiln_proto::relight::Limit;

use super::contract::{self, NAME, ROLE, decode};

/// The shading function.
const SNIPPET: &str = "
@group(1) @binding(1) var<uniform> ambient: vec4f;
fn indirect_irradiance(surface: Surface) -> Indirect { return Indirect(ambient.rgb, ambient.rgb); }
";

/// The kind's row in the client's table.
pub struct Ambient;

impl ClientKind for Ambient {
    fn contract(&self) -> &'static dyn Kind {
        &contract::Ambient
    }

    fn load(&self, source: &Source, scene: &LoadedScene) -> Result<Box<dyn Light>> {
        let chunks = decoded(source, &scene.manifest, ROLE, |bytes| Ok(decode(bytes)?))?;
        let [irradiance] = chunks[..] else {
            return Err(ClientError::inconsistent(NAME, "has one chunk"));
        };
        Ok(Box::new(Constant(irradiance.into())))
    }
}

/// Irradiance in W·m⁻².
#[derive(Clone, Copy, Debug)]
struct Constant(Vec3);

impl IndirectIrradiance for Constant {
    fn indirect_irradiance(&self, _: &Surface) -> Vec3 {
        self.0
    }
}

impl Light for Constant {
    fn shading(&self) -> Shading {
        Shading { snippet: SNIPPET, bindings: vec![uniform(false)] }
    }

    fn settle<'a>(&'a self, _: &LitScene<'a>, _: &Among<'_>, _: Limit) -> SettledLight<'a> {
        SettledLight { indirect: Box::new(*self), walks: None, bounces: 0, converged: true }
    }

    fn passes(
        &self,
        gpu: &Gpu,
        _: &LoadedScene,
        _: &ShadowPass,
        _: [u32; 2],
    ) -> Result<Box<dyn LightPasses>> {
        Ok(Box::new(Uploaded(gpu.uniform(NAME, &self.0.extend(0.0)))))
    }
}

/// The irradiance on the adapter.
struct Uploaded(wgpu::Buffer);

impl LightPasses for Uploaded {
    fn bindings(&self) -> Vec<wgpu::BindingResource<'_>> {
        vec![self.0.as_entire_binding()]
    }
}
