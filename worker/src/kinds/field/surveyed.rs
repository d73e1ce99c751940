//! Probes of a plan, the cells that they are gathered in, and their artefacts.

use std::collections::BTreeMap;

use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::TaskInput;
use lightkiln_proto::kinds::field::encode_tetrahedra;
use serde_json::json;

use super::{PLACEMENT_ARTEFACT, PROBES_ARTEFACT, Survey};
use crate::factors::{CELLS_ARTEFACT, ClusterCell, cells, encoded_cells};
use crate::task::TaskError;

/// Most probes of a cell: one factorisation.
const CELL_PROBES: u32 = 32;

/// Name of the cells of probes among outputs; tasks of probes see them as [`CELLS_ARTEFACT`].
const FIELD_CELLS: &str = "field-cells";

/// Probes, and the cells that they are gathered in.
pub struct Surveyed {
    /// The probes.
    pub survey: Survey,
    /// Their cells.
    pub cells: Vec<ClusterCell>,
    /// `probes`, `field-cells`, the chunk of tetrahedra and `placement`, counts, where there are some.
    artefacts: Vec<(String, Vec<u8>)>,
    /// Role of the chunk of tetrahedra.
    role: Option<&'static str>,
}

impl Surveyed {
    /// Of a survey; `tetrahedra` is the role of their chunk.
    pub fn of(survey: Survey, tetrahedra: Option<&'static str>) -> Result<Self, TaskError> {
        let cells = cells(&survey.positions_m(), CELL_PROBES);
        let mut artefacts = vec![
            (PROBES_ARTEFACT.to_owned(), survey.encoded()?),
            (FIELD_CELLS.to_owned(), encoded_cells(&cells)?),
        ];
        if let (Some(role), Some(set)) = (tetrahedra, survey.tetrahedra()) {
            let chunk = encode_tetrahedra(&set)
                .map_err(|error| TaskError::bad_input_from("the tetrahedra cannot be stored", error))?;
            artefacts.push((role.to_owned(), chunk));
        }
        if !survey.account.is_empty() {
            let account: BTreeMap<&String, u64> =
                survey.account.iter().map(|(name, count)| (name, *count)).collect();
            artefacts.push((PLACEMENT_ARTEFACT.to_owned(), json!(account).to_string().into_bytes()));
        }
        Ok(Self { survey, cells, artefacts, role: tetrahedra })
    }

    fn input(&self, name: &str, which: usize) -> TaskInput {
        TaskInput::Artefact { name: name.into(), digest: Digest::of(&self.artefacts[which].1) }
    }

    /// Inputs of tasks of probes: probes and cells.
    pub fn inputs_of_gather(&self) -> [TaskInput; 2] {
        [self.input(PROBES_ARTEFACT, 0), self.input(CELLS_ARTEFACT, 1)]
    }

    /// The chunk of tetrahedra as an input, where there is one.
    pub fn tetrahedra(&self) -> Option<TaskInput> {
        let is_it = |(name, _): &&(String, Vec<u8>)| Some(&name[..]) == self.role;
        let found = self.artefacts.iter().find(is_it);
        found.map(|(name, bytes)| TaskInput::Artefact { name: name.clone(), digest: Digest::of(bytes) })
    }

    /// Inputs of assemble: all but the cells.
    pub fn inputs_of_assemble(&self) -> impl Iterator<Item = TaskInput> + '_ {
        let all = self.artefacts.iter().enumerate().filter(|(which, _)| *which != 1);
        all.map(|(which, (name, _))| self.input(name, which))
    }

    /// Counters of the plan.
    pub fn counters(&self) -> BTreeMap<String, f64> {
        let counters = [
            ("probes", self.survey.probes.len() as u64),
            ("probes_in_cells", self.survey.in_cells),
            ("places_inside", self.survey.inside),
        ];
        let own = counters.map(|(name, count)| (name.to_owned(), count as f64));
        let placement = self.survey.account.iter().map(|(name, count)| (name.clone(), *count as f64));
        own.into_iter().chain(placement).collect()
    }

    /// The outputs.
    pub fn into_artefacts(self) -> Vec<(String, Vec<u8>)> {
        self.artefacts
    }
}
