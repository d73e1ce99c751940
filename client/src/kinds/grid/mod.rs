//! Relightable light over surface patches, with a field: light at probes in free space, for what has no lightmap.

mod light;
mod passes;

use lightkiln_proto::kinds::Kind;
use lightkiln_proto::kinds::grid::{self, FieldPart, FieldTable, decode_field};
use lightkiln_proto::relight::{Inconsistent, PatchTable};

use super::prt;
use crate::bake::{ClientKind, Light};
use crate::error::{ClientError, Result};
use crate::fetch::{Source, decoded};
use crate::lightmap::LightmapLight;
use crate::scene::LoadedScene;

pub use light::FieldLight;
pub use passes::{FieldNumbers, FieldPasses, SNIPPET, TOLERANCE};

/// The kind.
#[derive(Clone, Copy, Debug)]
pub struct Grid;

impl ClientKind for Grid {
    fn contract(&self) -> &'static dyn Kind {
        &grid::Grid
    }

    fn load(&self, source: &Source, scene: &LoadedScene) -> Result<Box<dyn Light>> {
        let parts = decoded(source, &scene.manifest, grid::FIELD, |bytes| Ok(decode_field(bytes)?))?;
        Ok(Box::new(assemble(scene, prt::load(source, scene)?, &parts)?))
    }
}

/// Joins the decoded parts of a field with the light of surfaces; anything that contradicts the manifest or another chunk is an error.
pub fn assemble(
    scene: &LoadedScene,
    lightmap: LightmapLight<PatchTable>,
    parts: &[FieldPart],
) -> Result<FieldLight> {
    let field = FieldTable::join(parts, scene.manifest.emitters.len(), &lightmap.transport.columns)
        .map_err(|Inconsistent { place, problem }| ClientError::inconsistent(place, problem))?;
    Ok(FieldLight { lightmap, field })
}
