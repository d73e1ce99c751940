//! Kind `sh`: light carried by spherical harmonics at probes, as \[Sedlacek2019\] has it (METHOD.md §2).
//!
//! `sh.plan` (probes, cells) → `sh.relight` by batch of probes, `sh.transport` by cell → `sh.assemble`.

mod alpha;
mod assemble;
mod candidates;
mod coverage;
mod evaluated;
mod plan;
mod probes;
mod radius;
mod relight;
mod supporters;
mod truncate;

use std::sync::Arc;

use lightkiln_proto::chunk::QuantisationSettings;
use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::kinds::sh::{NAME, Probe, ProbeSettings, Settings, tasks};
use lightkiln_proto::manifest::Manifest;
use lightkiln_proto::settings::{FactorSettings, TransportSettings};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{BakeKind, BakeKinds, TaskRow};
use crate::emitters::EmitterSet;
use crate::evaluate::{ChunkBytes, Evaluated, EvaluationError};
use crate::factors::{
    self, CellIndex, CellRows, ClusterCell, Detail, Piece, Transport, cell_of_task, stored,
};
use crate::lightmap::World;
use crate::task::{Cancelled, Context, Progress, TaskError, TaskOutput, artefact, params};
use crate::transport::DEAD_PATH_TEXELS;
use alpha::AlphaSampler;

/// Magic of the probes' artefact.
const PROBES_MAGIC: &[u8; 4] = b"LKpr";
/// Name of the probes' artefact among outputs of the plan, and among inputs of later tasks.
const PROBES_ARTEFACT: &str = "probes";

/// The kind's row.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sh;

impl BakeKind for Sh {
    fn name(&self) -> &'static str {
        NAME
    }

    fn tasks(&self) -> Vec<TaskRow> {
        vec![
            TaskRow { name: tasks::PLAN.name, run: plan::run },
            TaskRow { name: tasks::RELIGHT.name, run: relight::run },
            TaskRow { name: tasks::TRANSPORT.name, run: run_transport },
            TaskRow { name: tasks::ASSEMBLE.name, run: assemble::run },
        ]
    }

    fn error_classes(&self) -> Vec<&'static str> {
        factors::ERROR_CLASSES.into()
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
    probes: ProbeSettings,
    factors: FactorSettings,
}

impl From<&Settings> for TracedSettings {
    fn from(settings: &Settings) -> Self {
        Self {
            lod_levels: settings.texels.lod_levels,
            transport: settings.transport.clone(),
            probes: settings.probes.clone(),
            factors: settings.factors.clone(),
        }
    }
}

/// Probes of a bake: an artefact of the plan.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
struct ProbeSet {
    /// Distance between probes in metres.
    spacing_m: f32,
    /// Ascending by key.
    probes: Vec<Probe>,
}

impl ProbeSet {
    /// The probes among a task's inputs.
    fn of(context: &Context) -> Result<Arc<Self>, TaskError> {
        context.shared(PROBES_MAGIC, PROBES_ARTEFACT)
    }

    fn encoded(&self) -> Result<Vec<u8>, TaskError> {
        artefact::encode(PROBES_MAGIC, self)
    }
}

/// Transport from probes to receivers.
pub struct ProbeTransport {
    world: Arc<World>,
    emitters: Arc<EmitterSet>,
    probes: Arc<ProbeSet>,
    settings: TracedSettings,
}

impl ProbeTransport {
    /// Of the scene, lightmap and probes among a task's inputs.
    pub fn of(context: &Context, settings: TracedSettings) -> Result<Self, TaskError> {
        let world = World::of(context)?;
        let emitters = EmitterSet::of(context, &world.geometry)?;
        Ok(Self { emitters, probes: ProbeSet::of(context)?, world, settings })
    }
}

impl Transport for ProbeTransport {
    // The columns are the probes themselves: they cannot tell light apart more finely.
    fn rows(&self, receivers: &[u32], _: Detail, progress: &Progress) -> Result<CellRows, Cancelled> {
        progress.begin(0.0, 0.9, receivers.len() as u64);
        let sampler = AlphaSampler::new(self, receivers);
        let keys = sampler.probes().iter().map(|&probe| self.probes.probes[probe as usize].key).collect();
        let trace = |&receiver: &u32| {
            progress.check()?;
            let row = progress.casting(|| sampler.row(receiver));
            progress.advance(1);
            Ok(row)
        };
        Ok(CellRows { keys, rows: receivers.par_iter().map(trace).collect::<Result<_, Cancelled>>()? })
    }

    fn pieces(&self, cell: &ClusterCell, progress: &Progress) -> Result<(Vec<Piece>, CellIndex), Cancelled> {
        let CellRows { keys, rows } = self.rows(&cell.receivers, Detail::AsBaked, progress)?;
        let cavity_m = DEAD_PATH_TEXELS * self.world.lightmap.texel_m;
        let index = CellIndex::of(rows.iter().map(|row| (row, row.is_dark())), cavity_m);
        Ok((truncate::pieces(self, &keys, cell, &rows, progress)?, index))
    }
}

/// Runs task `sh.transport`: inputs of [`ProbeTransport::of`] and `cells`; outputs `chunk/N` and `index`.
fn run_transport(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let TransportParams { cluster, settings } = params(task)?;
    let quantisation =
        QuantisationSettings { levels: settings.lod_levels, ..QuantisationSettings::default() };
    let cell = cell_of_task(context, cluster)?;
    let (pieces, index) = ProbeTransport::of(context, settings)?.pieces(&cell, context.progress)?;
    stored(&pieces, quantisation, index)
}
