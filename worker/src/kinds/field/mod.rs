//! Fields, as far as kinds of bake share them: from probes, wherever they stand, to their depth maps, rows and factors, and to how evaluation
//! reads them (METHOD.md §2.13).

mod assemble;
mod before;
mod capture;
mod depth;
mod evaluated;
mod fit;
mod gather;
mod lit;
mod looks;
mod plan;
mod readings;
mod spacing;
mod surveyed;
mod truncate;
mod truth;
mod volume;

use std::sync::Arc;

use glam::{BVec3, Vec3};
use lightkiln_proto::kinds::field::{FieldSettings, Probe, ProbeKey, TetrahedronSet};
use serde::{Deserialize, Serialize};

use crate::task::{Context, TaskError, artefact};

pub use assemble::{Assembled, field_assembled};
pub use capture::{Capture, CaptureRays, Coefficients, light_of_file};
pub use depth::depths;
pub use evaluated::{FieldBake, SpaceLight, evaluated, in_space, parts};
pub use fit::{Around, Place as FitPlace, fitted_emitters, places as fit_places, shares as fit_shares};
pub use gather::{
    Account, RAYS_OF_PLACE, run as gather, turn as uniform_turn, weights as irradiance_weights,
};
pub use lit::run as lit;
pub use looks::{Place, is_free, is_inside, narrow_clearance_m, place};
pub use plan::{FieldPlan, planned};
pub use readings::{CLASSES, Reading};
pub use spacing::{lattice, points, spacing_m};
pub use surveyed::Surveyed;
pub use volume::Volume;

/// Magic of the artefact of probes.
const PROBES_MAGIC: &[u8; 4] = b"LKfp";
/// Name under which tasks see it.
const PROBES_ARTEFACT: &str = "probes";
/// Name of the counts of their placement, as JSON.
const PLACEMENT_ARTEFACT: &str = "placement";

/// Probes of a field.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Survey {
    /// Distance between probes in metres.
    pub spacing_m: f32,
    /// Step of the lattice that their keys name points of, in metres.
    pub step_m: f32,
    /// Keys and moves, ascending by key.
    pub probes: Vec<(u64, [i8; 3])>,
    /// Places that have none as they lie in geometry.
    pub inside: u64,
    /// Probes of cells among all.
    pub in_cells: u64,
    /// Tetrahedra between them, where there is no lattice.
    pub tessellation: Option<Tessellation>,
    /// Counts of their placement, by name; tasks of probes do not see them.
    #[serde(skip)]
    pub account: Vec<(String, u64)>,
}

/// Tetrahedra between probes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Tessellation {
    /// Least and greatest corner of the box that they fill, in metres.
    pub box_m: [[f32; 3]; 2],
    /// Vertices: numbers of probes, then of the corners of the box, x fastest.
    pub tetrahedra: Vec<[u32; 4]>,
}

impl Survey {
    /// The probes among a task's inputs.
    pub fn of(context: &Context) -> Result<Arc<Self>, TaskError> {
        context.shared(PROBES_MAGIC, PROBES_ARTEFACT)
    }

    fn encoded(&self) -> Result<Vec<u8>, TaskError> {
        artefact::encode(PROBES_MAGIC, self)
    }

    /// A probe.
    pub fn probe(&self, index: usize) -> Probe {
        let (key, moved) = self.probes[index];
        Probe { key: ProbeKey(key), moved }
    }

    /// Places of probes in metres.
    pub fn positions_m(&self) -> Vec<Vec3> {
        (0..self.probes.len()).map(|index| self.probe(index).position_m(self.step_m)).collect()
    }

    /// Its tetrahedra as they are stored: vertices ascend, and so do tetrahedra.
    pub fn tetrahedra(&self) -> Option<TetrahedronSet> {
        let Tessellation { box_m, tetrahedra: mut vertices } = self.tessellation.clone()?;
        vertices.iter_mut().for_each(|of| of.sort_unstable());
        vertices.sort_unstable();
        Some(TetrahedronSet { box_m, probes: self.probes.len() as u32, vertices })
    }

    /// A corner of the box of tetrahedra, x fastest.
    fn corner_m(&self, corner: u32) -> Vec3 {
        let of = |tessellation: &Tessellation| {
            let [low_m, high_m] = tessellation.box_m.map(Vec3::from);
            Vec3::select(BVec3::new(corner & 1 != 0, corner & 2 != 0, corner & 4 != 0), high_m, low_m)
        };
        self.tessellation.as_ref().map_or(Vec3::ZERO, of)
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
    is_fitted: bool,
    field: FieldSettings,
}
