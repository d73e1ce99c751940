//! Kind `prt`: light from surface patches and parts of the sky to lightmap receivers (METHOD.md §2).
//!
//! `prt.plan` (cells, the chunk of patches, the outline) → `prt.transport` and `prt.colour` by cell → `prt.overview` → `prt.assemble`.

mod assemble;
mod colourless;
mod evaluated;
mod gather;
mod near;
pub mod overview;
mod plan;
mod rows;
mod transport;
mod truncate;

use std::sync::Arc;

use lightkiln_proto::kinds::prt::{NAME, PatchSettings, Settings, tasks};
use lightkiln_proto::manifest::Manifest;
use lightkiln_proto::settings::{FactorSettings, TransportSettings};
use serde::{Deserialize, Serialize};

use super::voxels::DIRECTIONS;
use super::{BakeKind, BakeKinds, TaskRow};
use crate::emitters::{EmitterSet, Radiance};
use crate::evaluate::{ChunkBytes, Evaluated, EvaluationError};
use crate::factors::{self, CellIndex, CellRows, ClusterCell, Detail, Piece, Transport, TruncationBounds};
use crate::lightmap::World;
use crate::patches::PatchTree;
use crate::reads::{Record, Stage};
use crate::task::{Cancelled, Context, Progress, TaskError};
use crate::transport::{self as shared, DEAD_PATH_TEXELS};
pub(super) use assemble::Assembled;
pub(super) use evaluated::evaluated_of;
use near::NearHit;
pub(super) use plan::{Rays, cells_of, is_read_by_transport, planned, planned_of};
use rows::{KeptRows, Known};
pub(super) use transport::{KnownRow, of_known_rows, quantisation_error, run as run_transport};
use truncate::NamedPiece;

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
            TaskRow { name: tasks::TRANSPORT.name, run: transport::run },
            TaskRow { name: tasks::COLOUR.name, run: colourless::run },
            TaskRow { name: tasks::OVERVIEW.name, run: overview::run },
            TaskRow { name: tasks::ASSEMBLE.name, run: assemble::run },
        ]
    }

    fn error_classes(&self) -> Vec<&'static str> {
        [&factors::ERROR_CLASSES[..], &[DIRECTIONS]].concat()
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
    /// Rays find the receivers that light can reach and the light of emitters alone: clusters have no factors.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    is_bare: bool,
}

impl TracedSettings {
    /// Those of clusters without factors.
    #[must_use]
    pub(super) fn bare(self) -> Self {
        Self { is_bare: true, ..self }
    }

    fn truncation(&self) -> TruncationBounds {
        TruncationBounds { rank_max: self.factors.rank_max as usize, error_max: self.patches.rank_error }
    }
}

impl From<&Settings> for TracedSettings {
    fn from(settings: &Settings) -> Self {
        Self {
            lod_levels: settings.texels.lod_levels,
            transport: settings.transport.clone(),
            patches: settings.patches.clone(),
            factors: settings.factors.clone(),
            is_bare: false,
        }
    }
}

/// One receiver's row over patches.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Row {
    /// The part that every kind has.
    pub shared: shared::Row,
    /// As in [`shared::PatchRow`].
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

/// A cell's pieces with their account.
struct Recorded {
    pieces: Vec<NamedPiece>,
    index: CellIndex,
    /// As in [`gather::Traced`].
    record: Option<(Record, KeptRows)>,
    /// Receivers whose rays were cast.
    traced: usize,
}

/// Transport from patches to receivers.
pub struct PatchTransport {
    world: Arc<World>,
    emitters: Arc<EmitterSet>,
    tree: Arc<PatchTree>,
    /// Empty where nobody wants to know what was read.
    stage: Arc<Stage>,
    radiance: Radiance,
    settings: TracedSettings,
}

impl PatchTransport {
    /// Of the scene, lightmap and patches among a task's inputs.
    pub fn of(context: &Context, settings: TracedSettings) -> Result<Self, TaskError> {
        let world = World::of(context)?;
        let emitters = EmitterSet::of(context, &world.geometry)?;
        let (tree, stage) = (PatchTree::of(context)?, Arc::default());
        Ok(Self { emitters, tree, world, stage, radiance: Radiance::OfMaterials, settings })
    }
}

impl Transport for PatchTransport {
    fn rows(&self, receivers: &[u32], detail: Detail, progress: &Progress) -> Result<CellRows, Cancelled> {
        let found = gather::trace(self, receivers, Vec::new(), detail, progress)?;
        Ok(CellRows { keys: found.keys, rows: found.rows.into_iter().map(|row| row.shared).collect() })
    }

    fn pieces(&self, cell: &ClusterCell, progress: &Progress) -> Result<(Vec<Piece>, CellIndex), Cancelled> {
        let Recorded { pieces, index, .. } = self.recorded(cell, Vec::new(), progress)?;
        Ok((pieces.into_iter().map(|(piece, _)| piece).collect(), index))
    }
}

impl PatchTransport {
    /// As [`Transport::pieces`], with the record of all that was read; rays of receivers that are `known` are not cast.
    fn recorded(
        &self,
        cell: &ClusterCell,
        known: Vec<Option<Known>>,
        progress: &Progress,
    ) -> Result<Recorded, Cancelled> {
        let found = gather::trace(self, &cell.receivers, known, Detail::AsBaked, progress)?;
        let cavity_m = DEAD_PATH_TEXELS * self.world.lightmap.texel_m;
        let index = CellIndex::of(found.rows.iter().map(|row| (&row.shared, row.is_dead())), cavity_m);
        let pieces =
            truncate::pieces((&self.world, &self.settings), &found.keys, cell, &found.rows, progress)?;
        Ok(Recorded { pieces, index, record: found.record, traced: found.traced })
    }
}
