//! Task `scene.place`: which texels have receivers, and where each stands.
//!
//! ```text
//! cover ──▶ test ──▶ choose ──▶ number ──▶ leave out ──▶ points ─────────▶ share ───────────▶ link
//! texels    each     one point  in order   cavities      of a texel on     the light of       texels that
//! of a      candi-   per texel  of blocks                its receiver's    coplanar surfaces  no wall parts
//! block     date                                         side of walls     beside each other
//! ```
//! Every step takes plain data and gives plain data. Where a step casts rays, a [`World`](super::World) is built of the
//! lightmap that the step before it gave.

mod attributes;
mod blocks;
mod candidate;
mod cavities;
mod choose;
mod cover;
mod edges;
mod links;
mod points;
mod regions;
mod shared;
mod squares;

use std::sync::Arc;

use glam::Vec3;
use lightkiln_proto::content::AreaCode;
use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::settings::PlaceSettings;
use serde::Deserialize;

use super::{ARTEFACT_MAGIC, Block, Charts, Lightmap, NO_RECEIVER, Receiver};
use crate::geometry::Geometry;
use crate::task::{Cancelled, Context, Progress, TaskError, TaskOutput, artefact, params};
use crate::unwrap::{UnwrapBlock, UnwrappedTriangle};
use attributes::{Attributes, turned};
use candidate::{Candidate, Tester};
use cover::{Coverage, TexelPoint, areas, cover};

pub use blocks::{blocks, sides};
pub use shared::SharedTexels;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Params {
    place: PlaceSettings,
}

/// Runs the task: inputs `import/scene`, `unwrap/unwrap`; output `lightmap`.
pub fn run(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let Params { place: settings } = params(task)?;
    let geometry = Geometry::of(context)?;
    let charts = Charts::of(context)?;
    let (lightmap, counts) = place(&geometry, &charts, &settings, context.progress)?;
    let counters = [
        ("texels_in_cavities", counts.in_cavities),
        ("texels_shared", counts.shared.borrowers),
        ("texels_of_guests", counts.shared.guests),
    ];
    Ok(TaskOutput {
        artefacts: vec![("lightmap".into(), artefact::encode(ARTEFACT_MAGIC, &lightmap)?)],
        counters: counters.map(|(name, count)| (name.to_owned(), count as f64)).into(),
        ..TaskOutput::default()
    })
}

/// Counts of texels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Counts {
    /// Those in cavities.
    pub in_cavities: usize,
    /// Those with the light of others.
    pub shared: SharedTexels,
}

/// The lightmap of a scene, and how many of its texels are of special kinds.
pub fn place(
    geometry: &Arc<Geometry>,
    charts: &Charts,
    settings: &PlaceSettings,
    progress: &Progress,
) -> Result<(Lightmap, Counts), TaskError> {
    let texel_m = charts.texel_m;
    let mut lightmap = Lightmap {
        texel_m,
        first_block: blocks::first_blocks(&geometry.scene, charts),
        blocks: blocks(&geometry.scene, charts)?,
        receivers: Vec::new(),
    };
    progress.begin(0.0, 0.6, charts.unwraps.len() as u64);
    let mut next_block = lightmap.blocks.iter_mut().zip(0..);
    for (instance, unwrap) in charts.unwraps.iter().enumerate() {
        let sides = blocks::sides(&geometry.scene, instance) as usize;
        for chart in &unwrap.blocks {
            let attributes = Attributes { geometry, instance, texel_m: chart.texel_m };
            let tester = Tester::new(geometry, settings, chart.texel_m, progress);
            let coverage = cover(chart, |triangle| attributes.face_normal(triangle), progress)?;
            for ((block, index), is_back) in next_block.by_ref().take(sides).zip([false, true]) {
                let side =
                    Side { attributes: &attributes, tester: &tester, block: index, key: block.key, is_back };
                number(block, side.points(chart, coverage.clone())?, &mut lightmap.receivers);
            }
        }
        progress.advance(1);
    }
    if lightmap.receivers.is_empty() {
        return Err(TaskError::bad_input(format!(
            "no texel of {texel_m} m fits any surface: give a smaller texel_m, or more receivers_target"
        )));
    }
    progress.begin(0.6, 1.0, 1);
    let (lightmap, in_cavities) = cavities::left_out(geometry, charts, lightmap, settings, progress)?;
    let lightmap = points::covered(geometry, charts, lightmap, progress)?;
    let (lightmap, shared) = shared::shared(geometry, charts, lightmap, progress)?;
    let lightmap = links::linked(geometry, charts, lightmap, progress)?;
    Ok((lightmap, Counts { in_cavities, shared }))
}

/// One side of a block while its points are chosen.
struct Side<'a> {
    attributes: &'a Attributes<'a>,
    tester: &'a Tester<'a>,
    block: u32,
    key: u64,
    is_back: bool,
}

/// Receivers of a block: those of covered texels in the raster's order, and the texels that each stands for.
struct BlockPoints {
    receivers: Vec<Option<Receiver>>,
    stands_for: Vec<u32>,
}

impl Side<'_> {
    /// Tests candidates, chooses one for each texel, and gives texels behind walls points of their own.
    fn points(&self, chart: &UnwrapBlock, mut coverage: Coverage) -> Result<BlockPoints, Cancelled> {
        let mut chosen = choose::chosen(chart, &coverage.covered, self)?;
        let parted = choose::parted(chart, &coverage, &chosen, self)?;
        if !parted.is_empty() {
            let parted: Vec<_> = parted.into_iter().map(|(point, own)| (point, Some(own))).collect();
            coverage.set_apart(&parted, &mut chosen, chart.width);
        }
        let area = |triangle: &UnwrappedTriangle| self.attributes.area_texels(triangle);
        let areas = areas(chart, &coverage, area, self.tester.progress())?;
        let receiver = |(candidate, area): (Option<Candidate>, &f32)| {
            candidate.map(|found| Receiver { area: AreaCode::of(*area), ..found.receiver })
        };
        let receivers = chosen.into_iter().zip(&areas).map(receiver).collect();
        Ok(BlockPoints { receivers, stands_for: coverage.stands_for })
    }
}

impl choose::Site for Side<'_> {
    fn receiver(&self, point: &TexelPoint) -> Receiver {
        let front = Receiver { block: self.block, ..self.attributes.receiver(point) };
        if self.is_back { turned(&front) } else { front }
    }

    fn candidate(&self, point: &TexelPoint) -> Option<Candidate> {
        self.tester.progress().casting(|| self.tester.candidate(self.receiver(point), self.key))
    }

    fn check(&self) -> Result<(), Cancelled> {
        self.tester.progress().check()
    }

    fn face_normal(&self, point: &TexelPoint) -> Vec3 {
        self.attributes.face_normal(point.triangle)
    }

    fn is_parted(&self, a: &Receiver, b: &Receiver) -> bool {
        self.tester.progress().casting(|| self.tester.is_parted(a, b))
    }
}

/// Appends a block's receivers to those of the scene and fills in the block's table of them.
fn number(block: &mut Block, points: BlockPoints, receivers: &mut Vec<Receiver>) {
    let mut index_of = vec![NO_RECEIVER; points.receivers.len()];
    for (slot, receiver) in index_of.iter_mut().zip(&points.receivers) {
        if let Some(receiver) = receiver {
            *slot = receivers.len() as u32;
            receivers.push(*receiver);
        }
    }
    let stand_in = |&covered: &u32| index_of.get(covered as usize).copied().unwrap_or(NO_RECEIVER);
    block.receiver_of_texel = points.stands_for.iter().map(stand_in).collect();
}
