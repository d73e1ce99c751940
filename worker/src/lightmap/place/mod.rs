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
pub mod seen;
mod shared;
mod squares;

use std::sync::Arc;

use glam::Vec3;
use lightkiln_proto::content::AreaCode;
use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::settings::PlaceSettings;
use rayon::prelude::*;
use serde::Deserialize;

use super::{ARTEFACT_MAGIC, Block, Charts, Lightmap, NO_RECEIVER, Receiver};
use crate::geometry::Geometry;
use crate::task::{Cancelled, Context, Progress, TaskError, TaskOutput, artefact, params};
use crate::unwrap::{Unwrap, UnwrapBlock, UnwrappedTriangle};
use attributes::{Attributes, turned};
use candidate::{Candidate, Tester};
use cover::{Coverage, TexelPoint, areas, cover};

pub use blocks::{blocks, sides};
pub use shared::SharedTexels;

/// Texels of blocks whose points are chosen at once; a larger block has threads of its own.
const BATCH_TEXELS: usize = 1 << 18;

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
    let parts = Part::all(geometry, charts, &lightmap);
    progress.begin(0.0, 0.6, parts.len() as u64);
    let mut blocks = lightmap.blocks.iter_mut();
    for batch in batches(&parts) {
        // Parts of one texel have no work for several threads each, a hundred thousand of them do.
        let points = |part: &Part| {
            let found = part.points(geometry, settings, progress)?;
            progress.advance(1);
            Ok(found)
        };
        let found: Vec<Vec<BlockPoints>> = batch.par_iter().map(points).collect::<Result<_, Cancelled>>()?;
        for (points, block) in found.into_iter().flatten().zip(blocks.by_ref()) {
            number(block, points, &mut lightmap.receivers);
        }
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

/// A part of an instance's unwrap, which has a block for each side.
struct Part<'a> {
    instance: usize,
    chart: &'a UnwrapBlock,
    /// Index of the first block, and the keys of all.
    first_block: u32,
    keys: Vec<u64>,
}

impl<'a> Part<'a> {
    /// Those of a scene, in the order of blocks.
    fn all(geometry: &Geometry, charts: &'a Charts, lightmap: &Lightmap) -> Vec<Self> {
        let of_instance = |(instance, unwrap): (usize, &'a Unwrap)| {
            let sides = blocks::sides(&geometry.scene, instance);
            (lightmap.first_block[instance]..).step_by(sides as usize).zip(&unwrap.blocks).map(
                move |(first_block, chart)| {
                    let of_part = &lightmap.blocks[first_block as usize..(first_block + sides) as usize];
                    let keys = of_part.iter().map(|block| block.key).collect();
                    Self { instance, chart, first_block, keys }
                },
            )
        };
        charts.unwraps.iter().enumerate().flat_map(of_instance).collect()
    }

    /// The points of each side.
    fn points(
        &self,
        geometry: &Geometry,
        settings: &PlaceSettings,
        progress: &Progress,
    ) -> Result<Vec<BlockPoints>, Cancelled> {
        let Self { instance, chart, first_block, ref keys } = *self;
        let attributes = Attributes { geometry, instance, texel_m: chart.texel_m };
        let tester = Tester::new(geometry, settings, chart.texel_m, progress);
        let coverage = cover(chart, |triangle| attributes.face_normal(triangle), progress)?;
        let side = |(block, &key): (u32, &u64)| {
            let side =
                Side { attributes: &attributes, tester: &tester, block, key, is_back: block > first_block };
            side.points(chart, coverage.clone())
        };
        (first_block..).zip(keys).map(side).collect()
    }
}

/// Parts in batches that are worked on at once, of so many texels that their points take little memory.
fn batches<'p, 'a>(parts: &'p [Part<'a>]) -> impl Iterator<Item = &'p [Part<'a>]> {
    let texels = |part: &Part| part.chart.width as usize * part.chart.height as usize;
    let mut left = parts;
    std::iter::from_fn(move || {
        let mut sum = 0;
        let fits = left.iter().take_while(|part| {
            let is_first = sum == 0;
            sum += texels(part);
            is_first || sum <= BATCH_TEXELS
        });
        let (batch, rest) = left.split_at(fits.count());
        left = rest;
        (!batch.is_empty()).then_some(batch)
    })
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

    fn is_beyond(&self, a: &Receiver, b: &Receiver) -> bool {
        self.tester.progress().casting(|| self.tester.is_beyond(a, b))
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
