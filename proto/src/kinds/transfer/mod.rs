//! The bake of an object that moves through other scenes: a relightable bake of its own surfaces under parts of a sphere, its voxels, and the
//! volume of what it covers around it.

mod settings;
pub mod tasks;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::{Figures, Kind, Rates, Warning, prt};
use crate::chunk::ChunkRow;
use crate::ids::Digest;
use crate::jobs::TaskSpec;
use crate::manifest::{ClusterTotals, Manifest, ManifestError, all_finite};
use crate::settings::{SettingRow, SettingsError};
use crate::transfer::{LEVELS, ROW, TRANSFER};
use crate::voxels::{VOXELS, VoxelTotals};

pub use settings::{Settings, TransferSettings};
pub use tasks::first_tasks;

/// Name of the kind.
pub const NAME: &str = "transfer";

/// The kind's row.
#[derive(Clone, Copy, Debug, Default)]
pub struct Transfer;

/// Body of manifests of this kind.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// Sums over clusters.
    pub totals: ClusterTotals,
    /// Surface patches.
    pub patches: u64,
    /// Voxels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub voxels: Option<VoxelTotals>,
    /// The volume.
    pub transfer: TransferTotals,
}

/// Sums over the levels of a volume.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TransferTotals {
    /// Half of the object's largest side in metres: the unit of the volume's reach.
    pub half_side_m: f32,
    /// Nodes of each level, the finest first.
    pub nodes: Vec<u64>,
    /// Parts of the object's surface in each level, the finest first.
    pub parts: Vec<u64>,
    /// Bytes that the levels take when they are loaded.
    pub resident_bytes: u64,
}

impl TransferTotals {
    /// For people; `bytes` are those of all chunks.
    fn words(&self, bytes: u64) -> String {
        let Self { half_side_m, nodes, parts, resident_bytes } = self;
        let listed = |all: &[u64]| all.iter().map(u64::to_string).collect::<Vec<_>>().join(" ");
        format!(
            "levels of {} nodes, {} parts, out to {:.2} m; {bytes} bytes stored, {resident_bytes} loaded\n",
            listed(nodes),
            listed(parts),
            crate::transfer::REACH_H * half_side_m,
        )
    }
}

/// Adds the figures of the volume.
fn add_volume(mut figures: Figures, manifest: &Manifest, body: &Body) -> Figures {
    prt::add_voxels(&mut figures, manifest, body.voxels.clone());
    let bytes = manifest.chunks(TRANSFER).iter().map(|chunk| chunk.bytes).sum();
    figures.words += &format!("volume      {}", body.transfer.words(bytes));
    figures.json.insert("transfer".into(), json!(body.transfer));
    figures
}

impl Kind for Transfer {
    fn name(&self) -> &'static str {
        NAME
    }

    fn about(&self) -> &'static str {
        "an object that moves through other bakes: lit by them, it casts indirect light and shadow"
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

    fn is_of_objects(&self) -> bool {
        true
    }

    fn chunks(&self) -> &'static [ChunkRow] {
        &[ROW]
    }

    fn check(&self, manifest: &Manifest) -> Result<(), ManifestError> {
        let body: Body = manifest.body()?;
        all_finite("the volume's unit", &[body.transfer.half_side_m])?;
        for (role, wanted) in [(TRANSFER, LEVELS as usize), (VOXELS, 1)] {
            let count = manifest.chunks(role).len();
            if count < wanted || (role == TRANSFER && count > wanted) {
                let problem = format!("it has {count} chunks of {role}, wanted {wanted}");
                return Err(ManifestError::Contradiction { problem });
            }
        }
        prt::check_relightable(manifest, &body.totals)
    }

    fn summary(&self, manifest: &Manifest) -> Result<Figures, ManifestError> {
        let body: Body = manifest.body()?;
        Ok(add_volume(prt::summary(manifest, &body.totals, body.patches), manifest, &body))
    }

    fn warnings(&self, manifest: &Manifest) -> Result<Vec<Warning>, ManifestError> {
        prt::warnings(manifest, &manifest.body::<Body>()?.totals)
    }

    fn inspection(&self, manifest: &Manifest) -> Result<Figures, ManifestError> {
        let body: Body = manifest.body()?;
        Ok(add_volume(prt::inspection(manifest, &body.totals, body.patches), manifest, &body))
    }
}
