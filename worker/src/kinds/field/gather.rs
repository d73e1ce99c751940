//! Task `….gather`: rows of the probes of a cell over surface patches and parts of the sky, their factors, and depth maps.
//!
//! `T_pj,s = A_l 4π/N Σ_{k: y_pk ∈ s} Y_j(ω_k)`, A_l = (π, 2π/3, π/4): coefficients of irradiance by normal, for the N rays of probe p that
//! the probe's key turns.

use std::sync::LazyLock;

use glam::{Quat, Vec3};
use lightkiln_proto::harmonics::{ShBasis, relight_direction};
use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::kinds::field::PROBE_ROWS;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::fit::{Around, Place, fitted, fitted_emitters, places, shares};
use super::truncate::{ProbeRows, parts};
use super::{GatherParams, Survey, depth};
use crate::emitters::{EmitterSet, EmitterSphereSum};
use crate::factors::cell_of_task;
use crate::geometry::Bits;
use crate::kinds::prt::quantisation_error;
use crate::lightmap::World;
use crate::patches::PatchTree;
use crate::rays::sampling::{Sequence, seed_of};
use crate::reads::{Before, Name, RECORD_ARTEFACT, Reads, Record, Stage, before, union};
use crate::task::{Cancelled, Context, TaskError, TaskOutput, params};
use crate::transport::{CutBounds, RayHit, RowHits, Sources, patch_rows};

/// Error of taking patches whole as a share of that of truncation, as of receivers.
const CUT_SHARE: f32 = 0.16;

/// Rays of a probe for each of a place that probes are fitted to: there are about four places a probe, in tetrahedra seven.
pub const RAYS_OF_PLACE: u32 = 4;

/// Account of a cell's chunks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Account {
    /// Probes.
    pub probes: u64,
    /// Sum over probes of the rank of their factors.
    pub ranks: u64,
}

/// Runs the task: inputs of [`World::of`] and [`PatchTree::of`], `probes`, `cells`, `stage`; outputs `chunk/N`, `account` and `record`, those of a
/// task alike where its record still holds.
pub fn run(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let settings: GatherParams = params(task)?;
    let stage = Stage::of(context)?;
    let why = match before(context, &stage, "as before: nothing that the rays of its probes met has changed")?
    {
        Before::Kept(output) => return Ok(output),
        Before::Changed(why) => why,
    };
    let survey = Survey::of(context)?;
    let cell = cell_of_task(context, settings.cell)?;
    if cell.receivers.iter().any(|&probe| probe as usize >= survey.probes.len()) {
        return Err(TaskError::bad_input("the task names probes that the plan does not have"));
    }
    let world = World::of(context)?;
    let gathering = Gathering {
        emitters: &*EmitterSet::of(context, &world.geometry)?,
        tree: &*PatchTree::of(context)?,
        world: &world,
        stage: &stage,
        survey: &survey,
        settings: &settings,
    };
    let around = Around::of(&survey, &cell.receivers, settings.is_fitted);
    let depths = |&probe: &u32| {
        context.progress.check()?;
        let position_m = survey.probe(probe as usize).position_m(survey.step_m);
        let reads = Reads::new(&world, &stage);
        let depths = || depth::depths(&world.geometry, position_m, survey.step_m, &reads.trail);
        Ok((context.progress.casting(depths), reads.into_names()))
    };
    let found: Vec<_> = around.probes.par_iter().map(depths).collect::<Result<_, Cancelled>>()?;
    let (maps, mut read): (Vec<Vec<u16>>, Vec<Vec<Name>>) = found.into_iter().unzip();
    let reads = Reads::new(&world, &stage);
    let places = || places(&world.geometry, &survey, &around, maps.concat(), &reads.trail);
    let places = context.progress.casting(places);
    let places =
        places.map_err(|error| TaskError::bad_input_from("the probes contradict each other", error))?;
    read.push(reads.into_names());
    let (rows, record) = gathering.rows(&around, cell.receivers.len(), &places, read, context)?;
    let parts = parts(&cell, &survey, rows, &settings, context.progress)?;
    let map_of = |probe: &u32| cell.receivers.iter().position(|own| own == probe).map(|own| &maps[own][..]);
    let note = format!("{} probes gathered: {why}", cell.receivers.len());
    let mut output = TaskOutput { note, ..TaskOutput::default() };
    let mut account = Account::default();
    for (number, (probes, mut part)) in parts.into_iter().enumerate() {
        part.depths = probes.iter().filter_map(map_of).flatten().copied().collect();
        account.probes += probes.len() as u64;
        account.ranks += probes.len() as u64 * u64::from(part.factors.rank);
        let encoded = lightkiln_proto::kinds::field::encode_field(
            &part,
            quantisation_error(settings.field.field_rank_error),
        )
        .map_err(|error| TaskError::bad_input_from("the probes cannot be stored", error))?;
        output.artefacts.push((format!("chunk/{number}"), encoded.bytes));
    }
    let account = serde_json::to_vec(&account)
        .map_err(|error| TaskError::bad_input_from("the account of probes cannot be written", error))?;
    output.artefacts.push(("account".into(), account));
    if let Some(record) = record {
        output.artefacts.push((RECORD_ARTEFACT.to_owned(), record.encoded()?));
    }
    Ok(output)
}

/// Surroundings of a cell's probes.
struct Gathering<'a> {
    world: &'a World,
    tree: &'a PatchTree,
    emitters: &'a EmitterSet,
    stage: &'a Stage,
    survey: &'a Survey,
    settings: &'a GatherParams,
}

/// Hits of a point's rays, as rows, and light straight from emitters.
struct Cast {
    hits: Vec<RowHits>,
    /// By emitter.
    emitters: Vec<[[f32; 3]; PROBE_ROWS]>,
    /// Names of the parts of the stage that were read for them.
    read: Vec<Name>,
}

/// A point that rays leave.
struct Start {
    position_m: Vec3,
    seed: u64,
    rays: u32,
}

impl Gathering<'_> {
    /// Rows of the first `own` probes, fitted to those of places where there are some; and what was `read` for them, with what already was,
    /// unless it is too much.
    fn rows(
        &self,
        around: &Around,
        own: usize,
        places: &[Place],
        mut read: Vec<Vec<Name>>,
        context: &Context,
    ) -> Result<(ProbeRows, Option<Record>), TaskError> {
        let Self { world, tree, settings, survey, stage, .. } = self;
        let sources = Sources::new(world, tree, settings.sky_parts);
        let rays = settings.field.probe_rays;
        let of_probe = |&probe: &u32| {
            let probe = survey.probe(probe as usize);
            let position_m = probe.position_m(survey.step_m);
            Start { position_m, seed: seed_of(&[probe.key.0, 8]), rays }
        };
        let of_place = |place: &Place| {
            let Place { position_m, seed, .. } = *place;
            Start { position_m, seed, rays: rays / RAYS_OF_PLACE }
        };
        let starts: Vec<Start> =
            around.probes.iter().map(of_probe).chain(places.iter().map(of_place)).collect();
        context.progress.begin(0.0, 0.9, starts.len() as u64);
        let cast: Vec<Cast> = starts
            .par_iter()
            .map(|start| {
                context.progress.check()?;
                let cast = context.progress.casting(|| self.cast(start, &sources));
                context.progress.advance(1);
                Ok(cast)
            })
            .collect::<Result<_, Cancelled>>()?;
        let (mut hits, mut emitters) = (Vec::new(), Vec::new());
        for Cast { hits: of_start, emitters: own, read: own_read } in cast {
            hits.extend(of_start);
            emitters.push(own);
            read.push(own_read);
        }
        let met = Bits::new(tree.leaf_starts.len());
        hits.iter().flat_map(|row: &RowHits| &row.leaves).for_each(|hit| met.add(hit.at as usize));
        let leaves: Vec<u32> = met.iter().map(|leaf| leaf as u32).collect();
        let bounds = CutBounds {
            columns_max: settings.patches_max as usize,
            error: CUT_SHARE * settings.field.field_rank_error,
        };
        let scale = 4.0 * std::f32::consts::PI / rays as f32;
        let traced = patch_rows(tree, world.lightmap.texel_m, &mut hits, scale, Some(bounds));
        let read = union(read.par_iter().map(Vec::as_slice));
        let record = Record::of(stage, tree, &read, &leaves, &traced.by_share);
        if places.is_empty() {
            let (mut rows, mut emitters) = (traced.rows, emitters);
            rows.truncate(own * PROBE_ROWS);
            emitters.truncate(own);
            return Ok((ProbeRows { keys: traced.keys, rows, emitters }, record));
        }
        let shares = shares(around.probes.len(), own, places);
        let of_probe = |shares: &Vec<f64>| {
            context.progress.check()?;
            Ok((fitted(shares, &traced.rows), fitted_emitters(shares, &emitters)))
        };
        let fitted: Vec<_> = shares.par_iter().map(of_probe).collect::<Result<_, Cancelled>>()?;
        let (rows, emitters): (Vec<_>, Vec<_>) = fitted.into_iter().unzip();
        let rows = rows.into_iter().flatten().collect();
        Ok((ProbeRows { keys: traced.keys, rows, emitters }, record))
    }

    /// Casts the rays of a point.
    fn cast(&self, start: &Start, sources: &Sources<'_>) -> Cast {
        let Self { world, emitters, settings, stage, .. } = self;
        let Start { position_m, seed, rays } = *start;
        let turn = turn(seed);
        // Rows share the scale of a ray of a probe.
        let of_ray = settings.field.probe_rays as f32 / rays as f32;
        let emitter_rays = (settings.emitter_rays as f32 / of_ray) as u32;
        let mut emitted =
            EmitterSphereSum::new(&world.geometry, emitters, position_m, [rays, emitter_rays.max(1)]);
        let mut hits = vec![RowHits::default(); PROBE_ROWS];
        let reads = Reads::new(world, stage);
        let trail = reads.trail.from(position_m);
        for ray in 0..rays {
            // Rays come in bit-reversed order: each half of them is spread evenly, but every other one lies on one side.
            let is_even = 2 * ray < rays;
            let direction = turn * relight_direction(ray, rays);
            let weights = weights(direction);
            let hit = world.geometry.tracer.met(position_m, direction, f32::INFINITY);
            trail.mark(direction, hit.map(|hit| hit.t));
            let at = match &hit {
                None => Some((true, sources.sky(direction))),
                Some(hit) => {
                    emitted.add_hit(hit, direction, &weights);
                    let point_m = position_m + direction * hit.t;
                    let met = sources.at(hit, point_m);
                    reads.note_hit(&met.found, point_m);
                    met.leaf.map(|leaf| (false, leaf))
                }
            };
            let Some((is_sky, at)) = at else { continue };
            for (row, weight) in hits.iter_mut().zip(weights) {
                let met = RayHit { at, is_even, weight: weight * of_ray };
                if is_sky { row.sky.push(met) } else { row.leaves.push(met) }
            }
        }
        emitted.sample(seed, &trail, weights);
        drop(trail);
        Cast { hits, emitters: emitted.finish(), read: reads.into_names() }
    }
}

/// `A_l Y_j(ω)`.
pub fn weights(direction: Vec3) -> [f32; PROBE_ROWS] {
    const OF_BANDS: [f32; 3] =
        [std::f32::consts::PI, 2.0 / 3.0 * std::f32::consts::PI, 0.25 * std::f32::consts::PI];
    static BASIS: LazyLock<ShBasis> = LazyLock::new(|| ShBasis::new(2));
    let mut harmonics = [0.0; PROBE_ROWS];
    BASIS.evaluate(direction, &mut harmonics);
    let mut bands = [0, 1, 1, 1, 2, 2, 2, 2, 2].into_iter();
    harmonics.map(|harmonic| harmonic * OF_BANDS[bands.next().unwrap_or_default()])
}

/// A turn that is uniform among all (\[Shoemake1992\]).
pub fn turn(seed: u64) -> Quat {
    let mut numbers = Sequence::new(seed);
    let [share, a, b] = [(); 3].map(|()| numbers.next_f32());
    let [a, b] = [a, b].map(|at| at * std::f32::consts::TAU);
    let (low, high) = ((1.0 - share).sqrt(), share.sqrt());
    Quat::from_xyzw(low * libm::sinf(a), low * libm::cosf(a), high * libm::sinf(b), high * libm::cosf(b))
}
