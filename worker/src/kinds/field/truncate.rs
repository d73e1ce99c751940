//! From the rows of a cell's probes to factorised parts of a field.

use glam::Vec3;
use lightkiln_proto::content::{EmitterIrradiance, TransportFactors};
use lightkiln_proto::kinds::field::{FieldPart, PROBE_ROWS};

use super::{GatherParams, Survey};
use crate::factors::{ClusterCell, Factored, Part, PatchMatrix, Truncation, TruncationBounds, split};
use crate::task::{Cancelled, Progress};
use crate::transport::PatchRow;

/// Fewest probes of a cell that is still halved where the highest rank does not suffice.
const SPLIT_PROBES_MIN: usize = 8;

/// Rows of a cell's probes.
pub struct ProbeRows {
    /// Patches, then parts of the sky.
    pub keys: Vec<u64>,
    /// [`PROBE_ROWS`] a probe.
    pub rows: Vec<PatchRow>,
    /// Coefficients of each emitter, by probe, W·m⁻².
    pub emitters: Vec<Vec<[[f32; 3]; PROBE_ROWS]>>,
}

/// A cell while it is factorised: its rows take the places of receivers, nine for each probe.
struct Cell<'a> {
    positions_m: Vec<Vec3>,
    matrix: PatchMatrix<'a>,
    bounds: TruncationBounds,
}

impl Truncation for Cell<'_> {
    fn factored(&self, rows: &[u32]) -> (Factored, bool) {
        let places: Vec<usize> = rows.iter().map(|&row| row as usize).collect();
        let (factors, suffices) = self.matrix.factored(&places, self.bounds);
        (Factored { factors, groups: self.matrix.used(&places) }, suffices)
    }

    fn has_columns(&self, row: u32) -> bool {
        // A probe's rows stay together.
        let first = row as usize / PROBE_ROWS * PROBE_ROWS;
        let all: Vec<usize> = (first..first + PROBE_ROWS).collect();
        !self.matrix.used(&all).is_empty()
    }

    fn position_m(&self, row: u32) -> Vec3 {
        self.positions_m[row as usize / PROBE_ROWS]
    }

    fn may_split(&self, rows: usize, size_m: f32) -> bool {
        rows > SPLIT_PROBES_MIN * PROBE_ROWS && size_m > 0.0
    }

    fn rank_max(&self) -> usize {
        self.bounds.rank_max
    }
}

/// Parts of the field, each with its probes' numbers in the survey, but for their depth maps. Probes that nothing joins are factorised
/// apart, so that no error of a lit room shines into a dark one.
pub fn parts(
    cell: &ClusterCell,
    survey: &Survey,
    ProbeRows { keys, rows, emitters }: ProbeRows,
    settings: &GatherParams,
    progress: &Progress,
) -> Result<Vec<(Vec<u32>, FieldPart)>, Cancelled> {
    let of_probe = |probe: &u32| survey.probe(*probe as usize);
    let own = Cell {
        positions_m: cell.receivers.iter().map(|probe| of_probe(probe).position_m(survey.step_m)).collect(),
        matrix: PatchMatrix::new(&keys, rows.iter().map(|row| (&row.alpha[..], &row.importance))),
        bounds: TruncationBounds {
            rank_max: settings.rank_max as usize,
            error_max: settings.field.field_rank_error,
        },
    };
    let links = (0..rows.len()).map(|row| {
        let first = row / PROBE_ROWS * PROBE_ROWS;
        let mut links: Vec<u32> =
            (first..first + PROBE_ROWS).flat_map(|row| own.matrix.met_patches(row)).collect();
        links.sort_unstable();
        links.dedup();
        // A node of its own joins the rows of a probe that meets none.
        links.push((keys.len() + row / PROBE_ROWS) as u32);
        links
    });
    let links: Vec<Vec<u32>> = links.collect();
    let all = ClusterCell { bounds_m: cell.bounds_m, receivers: (0..rows.len() as u32).collect() };
    let found = split(&own, &all, &links, keys.len() + cell.receivers.len(), progress)?;
    let part = |Part { receivers: rows, factored: Factored { factors, groups } }: Part| {
        // Joined parts follow each other; probes ascend in a chunk.
        let mut order: Vec<usize> = (0..rows.len()).collect();
        order.sort_by_key(|&place| rows[place]);
        let u = order.iter().flat_map(|&place| &factors.u[place * factors.rank..][..factors.rank]).copied();
        let places: Vec<usize> =
            order.iter().step_by(PROBE_ROWS).map(|&place| rows[place] as usize / PROBE_ROWS).collect();
        let numbers: Vec<u32> = places.iter().map(|&place| cell.receivers[place]).collect();
        let field = FieldPart {
            spacing_m: survey.step_m,
            probes: numbers.iter().map(of_probe).collect(),
            depths: Vec::new(),
            factors: TransportFactors {
                keys: groups.iter().map(|&column| keys[column as usize]).collect(),
                rank: factors.rank as u32,
                u: u.collect(),
                vt: factors.vt,
                ..TransportFactors::default()
            },
            emitters: of_emitters(&places, &emitters),
        };
        (numbers, field)
    };
    Ok(found.into_iter().map(part).collect())
}

/// Coefficients of the emitters that reach any of some probes.
fn of_emitters(places: &[usize], all: &[Vec<[[f32; 3]; PROBE_ROWS]>]) -> Vec<EmitterIrradiance> {
    let count = places.first().map_or(0, |&place| all[place].len());
    (0..count)
        .map(|emitter| EmitterIrradiance {
            emitter: emitter as u16,
            irradiance: places.iter().flat_map(|&place| all[place][emitter]).collect(),
        })
        .filter(|column| column.irradiance.iter().flatten().any(|channel| *channel != 0.0))
        .collect()
}
