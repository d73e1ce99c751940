//! Relightable light over surface patches, with a field: light at probes in free space, for what has no lightmap.

mod dering;
mod light;
mod passes;

use lightkiln_proto::kinds::field::{FieldPart, FieldTable, TetrahedronSet};
use lightkiln_proto::relight::{Inconsistent, PatchTable};

use crate::error::{ClientError, Result};
use crate::lightmap::LightmapLight;
use crate::scene::LoadedScene;

pub use dering::SHADER as DERING_SHADER;
pub use light::FieldLight;
pub use passes::{
    FieldPasses, IN_LATTICE, IN_TETRAHEDRA, LATTICE_ALONE, LatticeNumbers, TETRAHEDRA_ALONE, TOLERANCE,
    TetrahedraNumbers, numbers, words,
};

/// Joins the decoded parts of a field, and the tetrahedra between its probes where these stand on no lattice, with the light of surfaces;
/// anything that contradicts the manifest or another chunk is an error.
pub fn assemble(
    scene: &LoadedScene,
    lightmap: LightmapLight<PatchTable>,
    parts: &[FieldPart],
    tetrahedra: Option<&TetrahedronSet>,
) -> Result<FieldLight> {
    let columns = &lightmap.transport.columns;
    let field = FieldTable::join(parts, tetrahedra, scene.manifest.emitters.len(), columns)
        .map_err(|Inconsistent { place, problem }| ClientError::inconsistent(place, problem))?;
    Ok(FieldLight { lightmap, field })
}
