//! Task `….lit`: factors of surfaces that have no rays of their own, as their indirect light is the field's.
//!
//! Light at a point x of a surface with the normal n is `E = Σ_p w_p(x) Σ_j Y_j(n) q_pj`, and q is linear in λ as the rows of probes are: the
//! row of a receiver is `Σ_p w_p Σ_j Y_j(n) T_pj`. So such receivers are clusters like all others, whose rows cost no ray but those that
//! tell which probes see x. *We differ from a table of weights that is read at run time:* the bytes are about as many, and no pass is added.

use glam::Vec3;
use lightkiln_proto::chunk::ChunkError;
use lightkiln_proto::content::EmitterIrradiance;
use lightkiln_proto::harmonics::ShBasis;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{Artefact, TaskSpec};
use lightkiln_proto::kinds::field::{
    FieldPart, FieldTable, LitSettings, PROBE_ROWS, decode_field, decode_tetrahedra, normalised,
};
use lightkiln_proto::kinds::prt::Settings;
use lightkiln_proto::manifest::ChunkRef;
use lightkiln_proto::relight::PatchTable;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::assemble::field_chunks;
use crate::emitters::EmitterSet;
use crate::factors::{CellIndex, cell_of_task};
use crate::geometry::Trail;
use crate::kinds::prt::{self, KnownRow};
use crate::lightmap::{Lightmap, Numbering, Receiver, World};
use crate::patches::PatchTree;
use crate::reads::{RECORD_ARTEFACT, Reads, Record, Stage, of_before, outputs_of_before};
use crate::scene::model::{LitBy, MeshInstance, Scene};
use crate::task::{Cancelled, Context, TaskError, TaskOutput, params};
use crate::transport::{PatchRow, Row};

/// Name of the digest of the field among outputs.
const FIELD_ARTEFACT: &str = "field-digest";
/// Name of the count of such receivers.
const COUNTER: &str = "receivers_lit_by_probes";

/// Settings that a cell of such receivers depends on, beside those of its surroundings and the field.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct LitParams {
    /// Index of the cell.
    pub cell: usize,
    /// Settings of surfaces.
    pub settings: Settings,
    /// Role of the chunk of tetrahedra, where there are some.
    pub tetrahedra: Option<String>,
}

/// Receivers of a lightmap whose light is that of rays of their own, and those whose is the field's; both ascending.
pub fn by_light(scene: &Scene, lightmap: &Lightmap, settings: &LitSettings) -> [Vec<u32>; 2] {
    let is_lit: Vec<bool> =
        scene.instances.iter().map(|instance| is_lit(instance, settings.probe_lit_m)).collect();
    let instance_of = |receiver: u32| {
        let block = lightmap.receivers[receiver as usize].block;
        lightmap.blocks[block as usize].instance as usize
    };
    let (lit, own) =
        (0..lightmap.receivers.len() as u32).partition(|&receiver| is_lit[instance_of(receiver)]);
    [own, lit]
}

/// As the file says, else by size.
fn is_lit(instance: &MeshInstance, probe_lit_m: f32) -> bool {
    let is_small = || probe_lit_m > 0.0 && instance.size_m() <= probe_lit_m;
    instance.lit_by.map_or_else(is_small, |by| by == LitBy::Probes)
}

/// A field's parts, and which of its probes are around a point.
struct Field {
    parts: Vec<FieldPart>,
    /// Without depth maps and rows.
    places: FieldTable,
}

impl Field {
    /// Of the chunks of all cells and that of tetrahedra; also gives its size in memory.
    fn of(
        context: &Context,
        chunks: &[ChunkRef],
        between: Option<Digest>,
    ) -> Result<(Self, usize), TaskError> {
        let unread =
            |error: ChunkError| TaskError::bad_input_from("a chunk of the field cannot be read", error);
        let mut bytes = 0;
        let mut parts: Vec<FieldPart> = Vec::with_capacity(chunks.len());
        for chunk in chunks {
            let mut part = decode_field(&context.source.get(chunk.digest)?).map_err(unread)?;
            part.depths = Vec::new();
            bytes += 4 * (part.factors.u.len() + part.factors.vt.len()) + 32 * part.probes.len();
            parts.push(part);
        }
        let between = between.map(|digest| decode_tetrahedra(&context.source.get(digest)?).map_err(unread));
        let places: Vec<FieldPart> = parts
            .iter()
            .map(|part| FieldPart {
                spacing_m: part.spacing_m,
                probes: part.probes.clone(),
                ..FieldPart::default()
            })
            .collect();
        let places = FieldTable::join(&places, between.transpose()?.as_ref(), 0, &PatchTable::default())
            .map_err(|error| TaskError::bad_input_from("the probes contradict each other", error))?;
        Ok((Self { parts, places }, bytes))
    }
}

/// Runs the task: inputs of [`World::of`] and [`PatchTree::of`], `cells`, `stage`, the chunk of tetrahedra where there is one, and `field/…` of every
/// cell of probes; outputs those of `prt.transport` but rows, and the digest of the field. Those of a task alike where its record still holds and the
/// field is the same.
pub fn run(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let LitParams { cell, settings, tetrahedra } = params(task)?;
    let stage = Stage::of(context)?;
    let cell = cell_of_task(context, cell)?;
    let chunks = field_chunks(context);
    let between = tetrahedra.map(|role| context.digest(&role)).transpose()?;
    let digest = digest_of(chunks.iter().map(|chunk| chunk.digest).chain(between));
    if let Some(kept) = kept(context, &stage, digest)? {
        return Ok(kept);
    }
    let field = context.memory.get_or_insert(digest, || Field::of(context, &chunks, between))?;
    let world = World::of(context)?;
    let emitters = EmitterSet::of(context, &world.geometry)?;
    let named = field.parts.iter().flat_map(|part| &part.emitters).map(|column| usize::from(column.emitter));
    if named.max().is_some_and(|emitter| emitter >= emitters.count()) {
        return Err(TaskError::bad_input(
            "a chunk of the field names an emitter that the scene does not have",
        ));
    }
    let reads = Reads::new(&world, &stage);
    let of_receiver = |&receiver: &u32| {
        context.progress.check()?;
        context.progress.advance(1);
        Ok(weights(&world, &field.places, receiver, &reads.trail))
    };
    context.progress.begin(0.0, 0.9, cell.receivers.len() as u64);
    let weights: Vec<Vec<(u32, f32)>> = context
        .progress
        .casting(|| cell.receivers.iter().map(of_receiver).collect::<Result<_, Cancelled>>())?;
    let read = reads.into_names();
    let rows = Rows::of(&field.parts, &weights);
    let of_receiver = |(&receiver, weights): (&u32, &Vec<(u32, f32)>)| {
        let normal = world.lightmap.receivers[receiver as usize].normal;
        rows.of_receiver(weights, normal, emitters.radiance())
    };
    let known: Vec<KnownRow> = cell.receivers.par_iter().zip(&weights).map(of_receiver).collect();
    let mut output =
        prt::of_known_rows(&world, &settings, (rows.keys.values(), known), &cell, context.progress)?;
    let tree = PatchTree::of(context)?;
    if let Some(record) = Record::of(&stage, &tree, &read, &[], &[]) {
        output.artefacts.push((RECORD_ARTEFACT.to_owned(), record.encoded()?));
    }
    output.artefacts.push((FIELD_ARTEFACT.to_owned(), digest.to_string().into_bytes()));
    output.counters.insert(COUNTER.into(), cell.receivers.len() as f64);
    output.note = format!("{} receivers lit by probes", cell.receivers.len());
    Ok(output)
}

fn digest_of(all: impl Iterator<Item = Digest>) -> Digest {
    Digest::of(all.map(|digest| digest.to_string()).collect::<Vec<_>>().join(" ").as_bytes())
}

/// The result of a task alike, if the field is the same and all that its rays read is as it was.
fn kept(context: &Context, stage: &Stage, field: Digest) -> Result<Option<TaskOutput>, TaskError> {
    let is_same = |outputs: &Vec<Artefact>| -> Result<bool, TaskError> {
        let text = |bytes: &[u8]| Ok(String::from_utf8_lossy(bytes).into_owned());
        let of_before_it = of_before(context, outputs, FIELD_ARTEFACT, text)?;
        let record = of_before(context, outputs, RECORD_ARTEFACT, Record::decoded)?;
        Ok(of_before_it == Some(field.to_string()) && record.is_some_and(|record| !record.changes(stage).any))
    };
    for outputs in context.alike {
        if !is_same(outputs)? {
            continue;
        }
        let Some(artefacts) = outputs_of_before(context, outputs, "")? else { continue };
        let index = artefacts.iter().find(|(name, _)| name == CellIndex::OUTPUT);
        let Some(index) = index.and_then(|(_, bytes)| CellIndex::decoded(bytes).ok()) else { continue };
        let note =
            "as before: neither the field nor what parts it from these surfaces has changed".to_owned();
        let counters = index.counters();
        return Ok(Some(TaskOutput { artefacts, note, counters, ..TaskOutput::default() }));
    }
    Ok(None)
}

/// Probes that a receiver's light comes from, and their weights: of those around its place, the ones that a ray from there meets; where it meets
/// none, of those around these; none where no probe is in sight, as in a drawer, which depth maps take for the room. Its place is as far off the surface as
/// [`FieldTable::raised`] has it, or half of the way to what stands before it. Marks the `trail` of the rays that tell.
fn weights(world: &World, table: &FieldTable, receiver: u32, trail: &Trail) -> Vec<(u32, f32)> {
    let geometry = &world.geometry;
    let Receiver { position_m, face_normal, .. } = world.lightmap.receivers[receiver as usize];
    let height_m = table.raised(position_m, face_normal).distance(position_m);
    let at_m = geometry.raised(position_m, face_normal, height_m);
    trail.from(position_m).mark(face_normal, Some(2.0 * height_m));
    let [low_m, high_m] = geometry.bounds_m();
    let from = trail.from(at_m);
    let is_seen = |&(probe, _): &(u32, f32)| {
        let probe_m = table.position_m[probe as usize].truncate();
        let is_within = probe_m.cmpge(low_m).all() && probe_m.cmple(high_m).all();
        from.mark(probe_m - at_m, is_within.then_some(1.0));
        !geometry.tracer.is_occluded(probe_m, at_m)
    };
    let seen = |probes: Vec<(u32, f32)>| normalised(probes.into_iter().filter(is_seen));
    let near = seen(table.cage(at_m));
    if near.is_empty() { seen(table.wide(at_m)) } else { near }
}

/// Rows of probes as factors of the parts that they come in.
struct Rows<'a> {
    parts: &'a [FieldPart],
    /// Part of each probe, and its number there.
    part_of: Vec<(u32, u32)>,
    /// Columns of all parts that any weight names.
    keys: Numbering<u64>,
    /// Places of each part's columns among them.
    places: Vec<Vec<u32>>,
}

impl<'a> Rows<'a> {
    fn of(parts: &'a [FieldPart], weights: &[Vec<(u32, f32)>]) -> Self {
        let of_part =
            |(index, part): (u32, &FieldPart)| (0..part.probes.len() as u32).map(move |at| (index, at));
        let part_of: Vec<(u32, u32)> = (0..).zip(parts).flat_map(of_part).collect();
        let mut is_read = vec![false; parts.len()];
        for (probe, _) in weights.iter().flatten() {
            is_read[part_of[*probe as usize].0 as usize] = true;
        }
        let keys = parts.iter().zip(&is_read).filter(|(_, is_read)| **is_read);
        let keys = Numbering::of(keys.flat_map(|(part, _)| part.factors.keys.iter().copied()));
        let places = parts.iter().zip(&is_read).map(|(part, &is_read)| {
            let of_part = part.factors.keys.iter().take(if is_read { usize::MAX } else { 0 });
            of_part.map(|&key| keys.place(key) as u32).collect()
        });
        let places = places.collect();
        Self { parts, part_of, keys, places }
    }

    /// `Σ_p w_p Σ_j Y_j(n) T_pj`, and the light of emitters likewise, which probes hold with such a `radiance` and receivers with 1.
    fn of_receiver(&self, weights: &[(u32, f32)], normal: Vec3, radiance: &[[f32; 3]]) -> KnownRow {
        let mut harmonics = [0.0; PROBE_ROWS];
        ShBasis::new(2).evaluate(normal, &mut harmonics);
        let mut alpha = vec![0.0_f32; self.keys.len()];
        let mut direct = vec![[0.0_f32; 3]; radiance.len()];
        let mut of_parts: Vec<(u32, u32, f32)> = weights
            .iter()
            .map(|&(probe, weight)| {
                let (part, at) = self.part_of[probe as usize];
                (part, at, weight)
            })
            .collect();
        of_parts.sort_by_key(|&(part, at, _)| (part, at));
        for of_part in of_parts.chunk_by(|a, b| a.0 == b.0) {
            let index = of_part[0].0 as usize;
            let FieldPart { factors, emitters: of_emitters, .. } = &self.parts[index];
            let (rank, columns) = (factors.rank as usize, factors.keys.len());
            let mut shares = vec![0.0_f32; rank];
            for &(_, at, weight) in of_part {
                for (j, harmonic) in harmonics.iter().enumerate() {
                    let row = at as usize * PROBE_ROWS + j;
                    let u = &factors.u[row * rank..][..rank];
                    shares.iter_mut().zip(u).for_each(|(share, u)| *share += weight * harmonic * u);
                    for EmitterIrradiance { emitter, irradiance } in of_emitters {
                        let sum = &mut direct[usize::from(*emitter)];
                        sum.iter_mut()
                            .zip(irradiance[row])
                            .for_each(|(sum, e)| *sum += weight * harmonic * e);
                    }
                }
            }
            for (share, row) in shares.iter().zip(factors.vt.chunks_exact(columns.max(1))) {
                let places = self.places[index].iter();
                places.zip(row).for_each(|(&place, value)| alpha[place as usize] += share * value);
            }
        }
        for (sum, radiance) in direct.iter_mut().flatten().zip(radiance.iter().flatten()) {
            *sum = if *radiance > 0.0 { (*sum / radiance).max(0.0) } else { 0.0 };
        }
        let PatchRow { alpha, importance } = PatchRow::without_noise(self.keys.values(), alpha);
        KnownRow { shared: Row { alpha, emitters: direct, ..Row::default() }, importance }
    }
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::content::{PatchKey, TransportFactors};
    use lightkiln_proto::kinds::field::{Probe, ProbeKey};

    use super::*;

    /// A part of one probe on the lattice whose row j is `value(j)` of a part of the sky.
    fn part(x: i32, sky: u32, value: impl Fn(usize) -> f32) -> FieldPart {
        FieldPart {
            spacing_m: 1.0,
            probes: vec![Probe { key: ProbeKey::of(glam::IVec3::new(x, 0, 0)).unwrap(), moved: [0; 3] }],
            factors: TransportFactors {
                keys: vec![PatchKey::of_sky(sky).0],
                rank: 1,
                u: (0..PROBE_ROWS).map(value).collect(),
                vt: vec![2.0],
                ..TransportFactors::default()
            },
            emitters: vec![EmitterIrradiance { emitter: 1, irradiance: vec![[1.0, 0.0, -1.0]; PROBE_ROWS] }],
            ..FieldPart::default()
        }
    }

    #[test]
    fn row_is_that_of_probes_by_their_weights_and_the_normal() {
        let parts = [part(0, 3, |j| j as f32), part(1, 5, |j| if j == 0 { 1.0 } else { 0.0 })];
        let weights = vec![(0, 0.25), (1, 0.75)];
        let rows = Rows::of(&parts, std::slice::from_ref(&weights));
        let normal = Vec3::new(0.6, 0.0, 0.8);
        let mut harmonics = [0.0; PROBE_ROWS];
        ShBasis::new(2).evaluate(normal, &mut harmonics);
        let row = rows.of_receiver(&weights, normal, &[[1.0; 3], [4.0, 0.0, 0.5]]).shared;
        let by_hand: f32 = (0..PROBE_ROWS).map(|j| 0.25 * 2.0 * j as f32 * harmonics[j]).sum();
        assert!((row.alpha[0] - by_hand).abs() < 1e-5, "{} {by_hand}", row.alpha[0]);
        assert!((row.alpha[1] - 1.5 * harmonics[0]).abs() < 1e-6);
        let sum: f32 = harmonics.iter().sum();
        assert_eq!(row.emitters[0], [0.0; 3]);
        assert!(
            (row.emitters[1][0] - sum.max(0.0) / 4.0).abs() < 1e-5,
            "of both parts alike, for radiance 1"
        );
        assert_eq!(row.emitters[1][1], 0.0, "of a colour that does not shine");
        assert!((row.emitters[1][2] - (-sum).max(0.0) / 0.5).abs() < 1e-5, "never below 0");
        // A part that no weight names has no columns.
        let alone = Rows::of(&parts, &[vec![(1, 1.0)]]);
        assert_eq!(alone.keys.values(), [PatchKey::of_sky(5).0]);
    }

    #[test]
    fn words_of_the_file_come_before_size() {
        let instance = |lit_by: Option<LitBy>| MeshInstance {
            positions_m: vec![Vec3::ZERO, Vec3::new(0.1, 0.2, 0.05)],
            lit_by,
            ..MeshInstance::default()
        };
        let lit = |said: Option<LitBy>| [0.0, 0.19, 0.2].map(|below_m| is_lit(&instance(said), below_m));
        assert_eq!(lit(None), [false, false, true]);
        assert_eq!(lit(Some(LitBy::Probes)), [true; 3]);
        assert_eq!(lit(Some(LitBy::Texels)), [false; 3]);
    }
}
