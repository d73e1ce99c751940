//! Fields: light at probes in free space, for what moves through a scene and has no lightmap, over the patches of a relightable bake's
//! surfaces (\[Sedlacek2019\] §4.1). Depth maps say which probes see a point (\[Luo2022\]). Kinds of bake differ in how probes stand, and
//! in what is between them.

mod chunk;
mod content;
mod dering;
mod lattice;
mod mesh_chunk;
mod octahedron;
mod settings;
mod table;
mod tetrahedra;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::json;

use super::{Figures, Warning, prt};
use crate::manifest::{ClusterTotals, Manifest, ManifestError, all_finite};
use crate::relight::Inconsistent;
use crate::voxels::VoxelTotals;

pub use chunk::{EncodedField, FIELD as FIELD_CHUNK, PART_PROBES_MAX, ROW, decode_field, encode_field};
pub use content::{
    FieldPart, LATTICE_MAX, MOVE_SHARE, MOVES_MAX, PROBE_ROWS, Probe, ProbeKey, depth_code, depth_of,
};
pub use dering::{deringed, looks};
pub use lattice::{LatticeTable, NO_PROBE};
pub use mesh_chunk::{MESH, ROW as MESH_ROW, TETRAHEDRA_MAX, decode_tetrahedra, encode_tetrahedra};
pub use octahedron::{MAP_POINTS, MAP_SIDE, map_direction, map_points, octahedral_length};
pub use settings::{FieldSettings, LitSettings};
pub use table::{Between, FieldTable, normalised};
pub use tetrahedra::{CORNERS, NONE as NO_TETRAHEDRON, TetrahedraTable, TetrahedronSet};

/// Role of the chunks of probes.
pub const FIELD: &str = "field";

/// Body of manifests of bakes with a field.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// Sums over clusters.
    pub totals: ClusterTotals,
    /// Surface patches.
    pub patches: u64,
    /// The field.
    pub field: FieldTotals,
    /// Voxels, if there are some.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub voxels: Option<VoxelTotals>,
}

/// Sums over a field's probes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FieldTotals {
    /// Distance between probes in metres.
    pub spacing_m: f32,
    /// Probes.
    pub probes: u64,
    /// Places without a probe, as they lie in geometry.
    pub inside: u64,
    /// Mean rank of the probes' factors.
    pub mean_rank: f64,
    /// Counts of how they were placed, by round, where they do not stand evenly.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub placement: BTreeMap<String, u64>,
}

impl FieldTotals {
    /// Checks that the field of a bundle's chunks has as many probes as its manifest says.
    pub fn check(&self, field: &FieldTable) -> Result<(), Inconsistent> {
        if field.len() as u64 == self.probes {
            return Ok(());
        }
        let problem = format!("its chunks hold {} probes, the manifest says {}", field.len(), self.probes);
        Err(Inconsistent::new("field".to_owned(), problem))
    }

    /// For people.
    pub(super) fn words(&self, bytes: u64) -> String {
        let Self { spacing_m, probes, inside, mean_rank, placement: _ } = self;
        let each = bytes as f64 / (*probes).max(1) as f64;
        format!(
            "{probes} probes {spacing_m} m apart, {inside} left out in geometry; mean rank {mean_rank:.1}, {each:.0} bytes a probe\n"
        )
    }
}

/// Bytes of the chunks of probes and of what is between them.
pub(super) fn bytes_of(manifest: &Manifest, roles: &[&str]) -> u64 {
    roles.iter().flat_map(|role| manifest.chunks(role)).map(|chunk| chunk.bytes).sum()
}

/// Checks a manifest of a bake with a field.
pub(super) fn check(manifest: &Manifest) -> Result<(), ManifestError> {
    let body: Body = manifest.body()?;
    all_finite("the probes' spacing", &[body.field.spacing_m])?;
    prt::check_relightable(manifest, &body.totals)
}

/// Figures for a summary; `roles` are those of the field's chunks.
pub(super) fn summary(manifest: &Manifest, roles: &[&str]) -> Result<Figures, ManifestError> {
    let Body { totals, patches, field, voxels } = manifest.body()?;
    let mut figures = prt::summary(manifest, &totals, patches);
    prt::add_voxels(&mut figures, manifest, voxels);
    figures.json.insert("field".into(), json!(field));
    figures.words += &field.words(bytes_of(manifest, roles));
    Ok(figures)
}

/// Warnings.
pub(super) fn warnings(manifest: &Manifest) -> Result<Vec<Warning>, ManifestError> {
    prt::warnings(manifest, &manifest.body::<Body>()?.totals)
}

/// All figures.
pub(super) fn inspection(manifest: &Manifest, roles: &[&str]) -> Result<Figures, ManifestError> {
    let Body { totals, patches, field, voxels } = manifest.body()?;
    let mut figures = prt::inspection(manifest, &totals, patches);
    prt::add_voxels(&mut figures, manifest, voxels);
    figures.json.insert("field".into(), json!(field));
    figures.words += &format!("field       {}", field.words(bytes_of(manifest, roles)));
    Ok(figures)
}
