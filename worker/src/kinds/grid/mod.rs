//! Kind `grid`: a relightable bake with a field, light at probes in free space on a lattice (METHOD.md §2.13).
//!
//! `grid.plan` (all of `prt.plan`, probes) → `prt.transport`, `prt.colour`, `prt.overview`, and `grid.gather` by cell of probes →
//! `grid.assemble`.

mod assemble;
mod before;
mod cells;
mod depth;
mod evaluated;
mod fit;
mod gather;
mod plan;
mod readings;
mod standing;
mod survey;
mod truncate;

use std::sync::Arc;

use glam::Vec3;
use lightkiln_proto::kinds::grid::{FieldSettings, NAME, Probe, ProbeKey, Settings, tasks};
use lightkiln_proto::manifest::Manifest;
use serde::{Deserialize, Serialize};

use super::{BakeKind, BakeKinds, TaskRow};
use crate::evaluate::{ChunkBytes, Evaluated, EvaluationError};
use crate::factors;
use crate::task::{Context, Progress, TaskError, artefact};

/// The kind's row.
#[derive(Clone, Copy, Debug, Default)]
pub struct Grid;

impl BakeKind for Grid {
    fn name(&self) -> &'static str {
        NAME
    }

    fn tasks(&self) -> Vec<TaskRow> {
        vec![
            TaskRow { name: tasks::PLAN.name, run: plan::run },
            TaskRow { name: tasks::GATHER.name, run: gather::run },
            TaskRow { name: tasks::ASSEMBLE.name, run: assemble::run },
        ]
    }

    fn error_classes(&self) -> Vec<&'static str> {
        [&factors::ERROR_CLASSES[..], &readings::CLASSES].concat()
    }

    fn has_space(&self) -> bool {
        true
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

/// Magic of the artefact of probes.
const PROBES_MAGIC: &[u8; 4] = b"LKfp";
/// Name under which tasks see it.
const PROBES_ARTEFACT: &str = "probes";

/// Probes of a field.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Survey {
    /// Step of the lattice in metres.
    spacing_m: f32,
    /// Keys and moves, ascending by key.
    probes: Vec<(u64, [i8; 3])>,
    /// Points of the lattice that lie in geometry.
    inside: u64,
    /// Probes of cells among all.
    in_cells: u64,
}

impl Survey {
    /// The probes among a task's inputs.
    fn of(context: &Context) -> Result<Arc<Self>, TaskError> {
        context.shared(PROBES_MAGIC, PROBES_ARTEFACT)
    }

    fn encoded(&self) -> Result<Vec<u8>, TaskError> {
        artefact::encode(PROBES_MAGIC, self)
    }

    fn probe(&self, index: usize) -> Probe {
        let (key, moved) = self.probes[index];
        Probe { key: ProbeKey(key), moved }
    }

    /// Places of probes in metres.
    fn positions_m(&self) -> Vec<Vec3> {
        (0..self.probes.len()).map(|index| self.probe(index).position_m(self.spacing_m)).collect()
    }
}

/// Settings that a cell of probes depends on, beside those of its surroundings.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct GatherParams {
    /// Index of the cell.
    cell: usize,
    sky_parts: u32,
    patches_max: u32,
    rank_max: u32,
    emitter_rays: u32,
    field: FieldSettings,
}
