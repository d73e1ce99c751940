//! The relightable bake with a field: light at probes in free space, for what moves through a scene and has no lightmap. Probes
//! stand on a lattice; their transport comes from the patches of the bake's surfaces (\[Sedlacek2019\] §4.1), and depth maps say which of
//! them see a point (\[Luo2022\]).

mod chunk;
mod content;
mod octahedron;
mod settings;
mod table;
pub mod tasks;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::{Figures, Kind, Rates, Warning, prt};
use crate::chunk::ChunkRow;
use crate::ids::Digest;
use crate::jobs::TaskSpec;
use crate::manifest::{ClusterTotals, Manifest, ManifestError, all_finite};
use crate::settings::{SettingRow, SettingsError};

pub use chunk::{EncodedField, FIELD as FIELD_CHUNK, PART_PROBES_MAX, ROW, decode_field, encode_field};
pub use content::{
    FieldPart, LATTICE_MAX, MOVE_SHARE, MOVES_MAX, PROBE_ROWS, Probe, ProbeKey, depth_code, depth_of,
};
pub use octahedron::{MAP_POINTS, MAP_SIDE, map_direction, map_points, octahedral_length};
pub use settings::{FieldSettings, Settings};
pub use table::{FieldTable, NO_PROBE};
pub use tasks::first_tasks;

/// Name of the kind.
pub const NAME: &str = "grid";
/// Role of the chunks of the field.
pub const FIELD: &str = "field";

/// The kind's row.
#[derive(Clone, Copy, Debug, Default)]
pub struct Grid;

/// Body of manifests of this kind.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// Sums over clusters.
    pub totals: ClusterTotals,
    /// Surface patches.
    pub patches: u64,
    /// The field.
    pub field: FieldTotals,
}

/// Sums over a field's probes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FieldTotals {
    /// Distance between probes in metres.
    pub spacing_m: f32,
    /// Probes.
    pub probes: u64,
    /// Points of the lattice without a probe, as they lie in geometry.
    pub inside: u64,
    /// Mean rank of the probes' factors.
    pub mean_rank: f64,
}

impl FieldTotals {
    /// For people.
    fn words(&self, bytes: u64) -> String {
        let Self { spacing_m, probes, inside, mean_rank } = self;
        let each = bytes as f64 / (*probes).max(1) as f64;
        format!(
            "{probes} probes {spacing_m} m apart, {inside} left out in geometry; mean rank {mean_rank:.1}, {each:.0} bytes a probe\n"
        )
    }
}

/// Bytes of the field's chunks.
fn field_bytes(manifest: &Manifest) -> u64 {
    manifest.chunks(FIELD).iter().map(|chunk| chunk.bytes).sum()
}

impl Kind for Grid {
    fn name(&self) -> &'static str {
        NAME
    }

    fn about(&self) -> &'static str {
        "as prt, with light at probes in free space for objects that move"
    }

    fn settings(&self) -> Vec<SettingRow> {
        Settings::rows()
    }

    fn resolve(&self, settings: &Value) -> Result<Value, SettingsError> {
        Ok(Settings::from_json(settings)?.stated())
    }

    fn first_tasks(&self, scene: Digest, settings: &Value) -> Result<Vec<TaskSpec>, SettingsError> {
        Ok(first_tasks(scene, &Settings::from_json(settings)?))
    }

    fn rates(&self, settings: &Value) -> Result<Option<Rates>, SettingsError> {
        prt::Prt.rates(&Settings::from_json(settings)?.relightable().stated())
    }

    fn chunks(&self) -> &'static [ChunkRow] {
        &[ROW]
    }

    fn check(&self, manifest: &Manifest) -> Result<(), ManifestError> {
        let body: Body = manifest.body()?;
        all_finite("the probes' spacing", &[body.field.spacing_m])?;
        prt::check_relightable(manifest, &body.totals)
    }

    fn summary(&self, manifest: &Manifest) -> Result<Figures, ManifestError> {
        let Body { totals, patches, field } = manifest.body()?;
        let mut figures = prt::summary(manifest, &totals, patches);
        figures.json.insert("field".into(), json!(field));
        figures.words += &field.words(field_bytes(manifest));
        Ok(figures)
    }

    fn warnings(&self, manifest: &Manifest) -> Result<Vec<Warning>, ManifestError> {
        prt::warnings(manifest, &manifest.body::<Body>()?.totals)
    }

    fn inspection(&self, manifest: &Manifest) -> Result<Figures, ManifestError> {
        let Body { totals, patches, field } = manifest.body()?;
        let mut figures = prt::inspection(manifest, &totals, patches);
        figures.json.insert("field".into(), json!(field));
        figures.words += &format!("field       {}", field.words(field_bytes(manifest)));
        Ok(figures)
    }
}
