//! `--no-emitters`, `--no-sky`: light of the scene that pictures and evaluations leave out.

use std::sync::Arc;

use crate::console::say;
use clap::Args;
use lightkiln_proto::relight::Panorama;
use lightkiln_proto::scene::{LightKind, SceneLight};
use lightkiln_worker::evaluate::TestLight;

/// Light that is left out.
#[derive(Args, Clone, Copy, Debug, Default)]
pub struct SwitchedOff {
    /// Leaves the light of the scene's emissive surfaces out, of pictures and of evaluations
    #[arg(long, help_heading = "Light")]
    no_emitters: bool,
    /// Leaves skies out, the scene's own too
    #[arg(long, help_heading = "Light")]
    no_sky: bool,
}

impl SwitchedOff {
    /// The strength of emissive surfaces, unless they are switched off.
    pub fn emitter_scale(&self, scale: f32) -> f32 {
        if self.no_emitters { 0.0 } else { scale }
    }

    /// The lights that are not left out.
    pub fn rest(&self, mut lights: Vec<SceneLight>) -> Vec<SceneLight> {
        lights.retain(|light| !self.no_sky || !matches!(light.kind, LightKind::Sky { .. }));
        lights
    }

    /// The panorama, unless skies are left out.
    pub fn panorama(&self, panorama: Option<Arc<Panorama>>) -> Option<Arc<Panorama>> {
        panorama.filter(|_| !self.no_sky)
    }

    /// The same of lights to measure with, without those that have then nothing left; says which on standard error.
    pub fn rest_of_tests(&self, lights: Vec<TestLight>) -> Vec<TestLight> {
        let rest = |mut light: TestLight| {
            let lighting = &mut light.lighting;
            lighting.emitter_scale = self.emitter_scale(lighting.emitter_scale);
            lighting.lights = self.rest(std::mem::take(&mut lighting.lights));
            lighting.panorama = self.panorama(lighting.panorama.take());
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
