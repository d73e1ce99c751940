//! Relightable light over surface patches, with a field in tetrahedra.

use lightkiln_proto::kinds::Kind;
use lightkiln_proto::kinds::cloud::{self, TETRAHEDRA};
use lightkiln_proto::kinds::field::{FIELD, TetrahedronSet, decode_field, decode_tetrahedra};

use super::field;
use crate::bake::{ClientKind, Light};
use crate::error::Result;
use crate::fetch::{Source, decoded};
use crate::scene::LoadedScene;

/// The kind.
#[derive(Clone, Copy, Debug)]
pub struct Cloud;

impl ClientKind for Cloud {
    fn contract(&self) -> &'static dyn Kind {
        &cloud::Cloud
    }

    fn load(&self, source: &Source, scene: &LoadedScene) -> Result<Box<dyn Light>> {
        let parts = decoded(source, &scene.manifest, FIELD, |bytes| Ok(decode_field(bytes)?))?;
        let sets = decoded(source, &scene.manifest, TETRAHEDRA, |bytes| Ok(decode_tetrahedra(bytes)?))?;
        let none = TetrahedronSet::default();
        let tetrahedra = Some(sets.first().unwrap_or(&none));
        Ok(Box::new(field::load(source, scene, &parts, tetrahedra)?))
    }
}
