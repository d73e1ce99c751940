//! Kind `prt`: light from surface patches and parts of the sky to lightmap receivers (METHOD.md §2).
//!
//! `prt.plan` (cells, the chunk of patches) → `prt.transport` by cell → `prt.assemble`.

mod assemble;
mod evaluated;
mod gather;
mod near;
mod plan;
mod truncate;

use std::sync::Arc;

use lightkiln_proto::chunk::QuantisationSettings;
use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::kinds::prt::{NAME, PatchSettings, Settings, tasks};
use lightkiln_proto::manifest::Manifest;
use lightkiln_proto::settings::{FactorSettings, TransportSettings};
use serde::{Deserialize, Serialize};

use super::{BakeKind, BakeKinds, TaskRow};
use crate::emitters::EmitterSet;
use crate::evaluate::{ChunkBytes, Evaluated, EvaluationError};
use crate::factors::{
    self, CellIndex, CellRows, ClusterCell, Detail, Piece, Transport, cell_of_task, stored,
};
use crate::lightmap::World;
use crate::patches::PatchTree;
use crate::task::{Cancelled, Context, Progress, TaskError, TaskOutput, params};
use crate::transport::{self, DEAD_PATH_TEXELS};
use near::NearHit;

/// Error of quantisation as a share of that of truncation. What truncation drops is noise of rays for a good part, what
/// quantisation adds is not.
const QUANTISATION_SHARE: f32 = 0.55;
/// Least and most error of quantisation.
const QUANTISATION_ERROR: [f32; 2] = [2e-4, 0.05];

/// The kind's row.
#[derive(Clone, Copy, Debug, Default)]
pub struct Prt;

impl BakeKind for Prt {
    fn name(&self) -> &'static str {
        NAME
    }

    fn tasks(&self) -> Vec<TaskRow> {
        vec![
            TaskRow { name: tasks::PLAN.name, run: plan::run },
            TaskRow { name: tasks::TRANSPORT.name, run: run_transport },
            TaskRow { name: tasks::ASSEMBLE.name, run: assemble::run },
        ]
    }

    fn error_classes(&self) -> &'static [&'static str] {
        &factors::ERROR_CLASSES
    }

    fn evaluated(
        &self,
        kinds: &BakeKinds,
        manifest: &Manifest,
        scene: Vec<u8>,
        bytes: ChunkBytes,
        progress: &Progress,
    ) -> Result<Box<dyn Evaluated>, EvaluationError> {
        Ok(Box::new(evaluated::evaluated(kinds, manifest, scene, bytes, progress)?))
    }
}

type BakeParams = super::BakeParams<Settings>;
type TransportParams = super::TransportParams<TracedSettings>;

/// The settings that transport depends on: bakes that agree in them share its results by key.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct TracedSettings {
    lod_levels: u32,
    transport: TransportSettings,
    patches: PatchSettings,
    factors: FactorSettings,
}

impl From<&Settings> for TracedSettings {
    fn from(settings: &Settings) -> Self {
        Self {
            lod_levels: settings.texels.lod_levels,
            transport: settings.transport.clone(),
            patches: settings.patches.clone(),
            factors: settings.factors.clone(),
        }
    }
}

/// One receiver's row over patches.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Row {
    /// The part that every kind has.
    pub shared: transport::Row,
    /// As in [`transport::PatchRow`].
    pub importance: [Vec<f32>; 2],
    /// Near hits, whose light is not in the columns.
    pub near: Vec<NearHit>,
    /// Weight of each of them, `∫ cosθ dω`.
    pub near_weight: f32,
}

impl Row {
    /// No light can ever come here: no receiver, sky or emitter is in sight. So it is in cavities of solids and on parts of
    /// surfaces that are sunk in others.
    fn is_dead(&self) -> bool {
        self.near.iter().all(|hit| hit.texel().is_none()) && self.shared.is_dark()
    }
}

/// Transport from patches to receivers.
pub struct PatchTransport {
    world: Arc<World>,
    emitters: Arc<EmitterSet>,
    tree: Arc<PatchTree>,
    settings: TracedSettings,
}

impl PatchTransport {
    /// Of the scene, lightmap and patches among a task's inputs.
    pub fn of(context: &Context, settings: TracedSettings) -> Result<Self, TaskError> {
        let world = World::of(context)?;
        let emitters = EmitterSet::of(context, &world.geometry)?;
        Ok(Self { emitters, tree: PatchTree::of(context)?, world, settings })
    }
}

impl Transport for PatchTransport {
    fn rows(&self, receivers: &[u32], detail: Detail, progress: &Progress) -> Result<CellRows, Cancelled> {
        let found = gather::trace(self, receivers, detail, progress)?;
        Ok(CellRows { keys: found.keys, rows: found.rows.into_iter().map(|row| row.shared).collect() })
    }

    fn pieces(&self, cell: &ClusterCell, progress: &Progress) -> Result<(Vec<Piece>, CellIndex), Cancelled> {
        let found = gather::trace(self, &cell.receivers, Detail::AsBaked, progress)?;
        let cavity_m = DEAD_PATH_TEXELS * self.world.lightmap.texel_m;
        let index = CellIndex::of(found.rows.iter().map(|row| (&row.shared, row.is_dead())), cavity_m);
        Ok((truncate::pieces(self, &found.keys, cell, &found.rows, progress)?, index))
    }
}

/// Runs task `prt.transport`: inputs of [`PatchTransport::of`] and `cells`; outputs `chunk/N` and `index`.
fn run_transport(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let TransportParams { cluster, settings } = params(task)?;
    let quantisation = QuantisationSettings {
        relative_error: (QUANTISATION_SHARE * settings.factors.rank_error)
            .clamp(QUANTISATION_ERROR[0], QUANTISATION_ERROR[1]),
        levels: settings.lod_levels,
    };
    let cell = cell_of_task(context, cluster)?;
    let (pieces, index) = PatchTransport::of(context, settings)?.pieces(&cell, context.progress)?;
    stored(&pieces, quantisation, index)
}
