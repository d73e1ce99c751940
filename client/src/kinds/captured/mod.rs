//! Light that probes captured under the lights of the scene's file: it lights all surfaces, and no lamp changes it.

mod light;

use lightkiln_proto::kinds::Kind;
use lightkiln_proto::kinds::captured::{self, TETRAHEDRA};
use lightkiln_proto::kinds::field::{FIELD, decode_field, decode_tetrahedra};
use lightkiln_proto::relight::Inconsistent;

use crate::bake::{ClientKind, Light};
use crate::error::{ClientError, Result};
use crate::fetch::{Source, decoded};
use crate::scene::LoadedScene;

pub use light::CapturedLight;

/// The kind.
#[derive(Clone, Copy, Debug)]
pub struct Captured;

impl ClientKind for Captured {
    fn contract(&self) -> &'static dyn Kind {
        &captured::Captured
    }

    fn load(&self, source: &Source, scene: &LoadedScene) -> Result<Box<dyn Light>> {
        let manifest = &scene.manifest;
        let parts = decoded(source, manifest, FIELD, |bytes| Ok(decode_field(bytes)?))?;
        let tetrahedra = decoded(source, manifest, TETRAHEDRA, |bytes| Ok(decode_tetrahedra(bytes)?))?;
        let field = captured::joined(&manifest.body()?, &parts, tetrahedra.first())
            .map_err(|Inconsistent { place, problem }| ClientError::inconsistent(place, problem))?;
        Ok(Box::new(CapturedLight::new(field)))
    }
}

#[cfg(test)]
mod tests;
