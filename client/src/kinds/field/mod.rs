//! Relightable light over surface patches, with a field: light at probes in free space, for what has no lightmap.

mod dering;
mod light;
mod passes;

use lightkiln_proto::kinds::field::{Body, FieldPart, FieldTable, TetrahedronSet};
use lightkiln_proto::relight::{Inconsistent, PatchTable};

use crate::error::{ClientError, Result};
use crate::fetch::Source;
use crate::kinds::prt;
use crate::lightmap::LightmapLight;
use crate::scene::LoadedScene;

pub use dering::SHADER as DERING_SHADER;
pub use light::FieldLight;
pub use passes::{
    FieldPasses, IN_LATTICE, IN_TETRAHEDRA, LATTICE_ALONE, LATTICE_MEDIUM, LatticeNumbers, TETRAHEDRA_ALONE,
    TETRAHEDRA_MEDIUM, TOLERANCE, TetrahedraNumbers, medium, numbers, words,
};

/// Light of a bundle with a field; its parts and tetrahedra are decoded already.
pub fn load(
    source: &Source,
    scene: &LoadedScene,
    parts: &[FieldPart],
    tetrahedra: Option<&TetrahedronSet>,
) -> Result<FieldLight> {
    let light = assemble(scene, prt::load(source, scene)?, parts, tetrahedra)?;
    scene.manifest.body::<Body>()?.field.check(&light.field).map_err(contradicts)?;
    Ok(light)
}

fn contradicts(Inconsistent { place, problem }: Inconsistent) -> ClientError {
    ClientError::inconsistent(place, problem)
}

/// Joins the decoded parts of a field, and the tetrahedra between its probes where these stand on no lattice, with the light of surfaces;
/// anything that contradicts the manifest or another chunk is an error.
pub fn assemble(
    scene: &LoadedScene,
    lightmap: LightmapLight<PatchTable>,
    parts: &[FieldPart],
    tetrahedra: Option<&TetrahedronSet>,
) -> Result<FieldLight> {
    let columns = &lightmap.transport.columns;
    let field =
        FieldTable::join(parts, tetrahedra, scene.manifest.emitters.len(), columns).map_err(contradicts)?;
    Ok(FieldLight { lightmap, field })
}
