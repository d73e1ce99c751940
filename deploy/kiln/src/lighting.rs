//! `--no-emitters`, `--no-sky`, `--sky`: light of the scene that pictures and evaluations leave out, and a sky that they add.

use std::sync::Arc;

use crate::console::say;
use crate::failure::Result;
use crate::sky::{SkyArgument, parse_sky};
use clap::Args;
use lightkiln_client::bake::LoadedBake;
use lightkiln_proto::relight::Panorama;
use lightkiln_proto::scene::{LightKind, SceneLight};
use lightkiln_worker::evaluate::TestLight;

/// Light that is left out, and a panorama.
#[derive(Args, Clone, Debug, Default)]
pub struct LightArguments {
    /// Leaves the light of the scene's emissive surfaces out, of pictures and of evaluations
    #[arg(long, help_heading = "Light")]
    no_emitters: bool,
    /// Leaves skies out, the scene's own too
    #[arg(long, help_heading = "Light")]
    no_sky: bool,
    /// Panorama as a sky, on top of skies among the lights, of pictures and of evaluations: "FILE [turn=degrees] [strength=s]", a Radiance HDR
    /// picture (.hdr) in equirectangular projection, whose middle lies towards -z before it is turned about the vertical. It
    /// lights the scene and is seen behind it; a sun in it shines as wide as its part of the sky is
    #[arg(long, value_name = "FILE", value_parser = parse_sky, help_heading = "Light", conflicts_with = "no_sky")]
    sky: Option<SkyArgument>,
}

impl LightArguments {
    /// The strength of emissive surfaces, unless they are switched off.
    pub fn emitter_scale(&self, scale: f32) -> f32 {
        if self.no_emitters { 0.0 } else { scale }
    }

    /// The lights that are not left out.
    pub fn rest(&self, mut lights: Vec<SceneLight>) -> Vec<SceneLight> {
        lights.retain(|light| !self.no_sky || !matches!(light.kind, LightKind::Sky { .. }));
        lights
    }

    /// Says of other lights than a bake's own, those here or `chosen`, that its bounced light does not follow them, where it does not.
    pub fn tell_of_light_that_stays(&self, bake: &LoadedBake, chosen: bool) {
        let Self { no_emitters, no_sky, sky } = self;
        if (chosen || *no_emitters || *no_sky || sky.is_some()) && !bake.light.follows_lights() {
            let kind = &bake.scene.manifest.kind;
            say!(
                "note: a bake of kind '{kind}' keeps the bounced light of its file's lights, whatever lights shine directly"
            );
        }
    }

    /// Reads the panorama, if there is one.
    pub fn panorama(&self) -> Result<Option<Arc<Panorama>>> {
        self.sky.as_ref().map(SkyArgument::read).transpose()
    }

    /// The same of lights to measure with, without those that have then nothing left; says which on standard error.
    pub fn rest_of_tests(&self, lights: Vec<TestLight>) -> Vec<TestLight> {
        let rest = |mut light: TestLight| {
            let lighting = &mut light.lighting;
            lighting.emitter_scale = self.emitter_scale(lighting.emitter_scale);
            lighting.lights = self.rest(std::mem::take(&mut lighting.lights));
            let dark =
                lighting.emitter_scale <= 0.0 && lighting.lights.is_empty() && lighting.panorama.is_none();
            if dark {
                say!("note: light '{}' is switched off", light.name);
            }
            (!dark).then_some(light)
        };
        lights.into_iter().filter_map(rest).collect()
    }
}
