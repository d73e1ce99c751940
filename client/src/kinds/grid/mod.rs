//! Relightable light over surface patches, with a field on a lattice.

use lightkiln_proto::kinds::field::{FIELD, decode_field};
use lightkiln_proto::kinds::{Kind, grid};

use super::field;
use crate::bake::{ClientKind, Light};
use crate::error::Result;
use crate::fetch::{Source, decoded};
use crate::scene::LoadedScene;

/// The kind.
#[derive(Clone, Copy, Debug)]
pub struct Grid;

impl ClientKind for Grid {
    fn contract(&self) -> &'static dyn Kind {
        &grid::Grid
    }

    fn load(&self, source: &Source, scene: &LoadedScene) -> Result<Box<dyn Light>> {
        let parts = decoded(source, &scene.manifest, FIELD, |bytes| Ok(decode_field(bytes)?))?;
        Ok(Box::new(field::load(source, scene, &parts, None)?))
    }
}
