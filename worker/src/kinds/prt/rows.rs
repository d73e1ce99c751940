//! Rows of a cell's receivers as an artefact. A later task alike takes over those whose rays read nothing that has changed, and
//! traces the others.
//!
//! A row is kept as it was gathered, before the cut: hits by leaf and by part of the sky. Receivers come in groups that lie close
//! together, each with what its rays read and a digest of that. Nothing is named by a number of the scene, as an edit changes those.

use std::f32::consts::PI;
use std::sync::Arc;

use glam::Vec3;
use lightkiln_proto::content::{BlockKey, PatchKey, Texel};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::near::NearHit;
use super::{PatchTransport, Row, TracedSettings};
use crate::lightmap::{Lightmap, Numbering};
use crate::patches::PatchTree;
use crate::reads::{Bytes, Mark, Name, Record, Stage, places_in};
use crate::task::{TaskError, artefact};
use crate::transport::{self as rows, RayHit, RowHits};

/// Magic of the artefact.
const ARTEFACT_MAGIC: &[u8; 4] = b"LKrw";
/// Name of the rows among a task's outputs.
pub const ROWS_ARTEFACT: &str = "rows";
/// Most bytes for each receiver of a cell: if they take more, none are kept.
const RECEIVER_BYTES_MAX: usize = 2048;

/// Most that rows of a task hold.
#[derive(Clone, Copy, Debug)]
pub struct RowLimits {
    /// Receivers of its cell: a row for each.
    receivers: usize,
    /// Emitters of the scene.
    emitters: usize,
    rays: u32,
    near_hits: u32,
    sky_parts: u32,
}

impl RowLimits {
    /// Of tasks by these settings, for a cell of so many receivers in a scene of so many emitters.
    pub fn of(settings: &TracedSettings, receivers: usize, emitters: usize) -> Self {
        let TracedSettings { transport, patches, .. } = settings;
        Self {
            receivers,
            emitters,
            rays: transport.transport_rays,
            near_hits: patches.near_hits,
            sky_parts: patches.sky_parts.max(1),
        }
    }
}

/// Hits of one receiver's rays, and its row but for these.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gathered {
    pub hits: RowHits,
    pub row: Row,
}

/// Rows of a cell by their places, and names of what their rays read, ascending.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Group {
    pub rows: Vec<u32>,
    pub reads: Vec<Name>,
}

/// A row that needs no rays, and names of what those of its group read, ascending.
#[derive(Clone, Debug, PartialEq)]
pub struct Known {
    pub gathered: Gathered,
    pub reads: Arc<[Name]>,
}

/// Rows of a cell's receivers, in their order.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct KeptRows {
    /// Leaves that were hit, by the keys of their patches.
    leaves: Vec<PatchKey>,
    /// Blocks of texels that near hits lie on.
    blocks: Vec<BlockKey>,
    groups: Vec<KeptGroup>,
    rows: Vec<KeptRow>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct KeptGroup {
    /// Places of its rows.
    rows: Vec<u32>,
    /// Bits of the names that rays of the task read: those that rays of the group did.
    reads: Vec<u8>,
    /// Digest of their marks.
    digest: Mark,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct KeptRow {
    leaves: Counts,
    sky: Counts,
    lit: f32,
    uncovered: f32,
    mean_path_m: f32,
    emitters: Vec<[f32; 3]>,
    near_weight: f32,
    near: Vec<KeptNear>,
}

/// Hits on things by number.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Counts {
    /// Ascending numbers, each as the distance from the one before.
    steps: Vec<u32>,
    /// Hits of odd rays and of even ones.
    odd_even: Vec<[u16; 2]>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct KeptNear {
    block: u16,
    texel: Texel,
    is_own: bool,
    position_m: [f32; 3],
    face_normal: [f32; 3],
}

impl KeptRows {
    /// Of a cell's gathered rows and their groups; `read` are the names that their rays read, ascending, and `leaves` the leaves
    /// that they hit.
    pub fn of(
        transport: &PatchTransport,
        all: &[Gathered],
        groups: &[Group],
        (read, leaves): (&[Name], &[u32]),
    ) -> Self {
        let PatchTransport { world, tree, stage, .. } = transport;
        let marks: Vec<Mark> = read.par_iter().map(|name| stage.mark(*name)).collect();
        let of_near =
            |of: &Gathered| of.row.near.iter().map(|hit| world.lightmap.block_key(hit.receiver)).collect();
        let blocks = Numbering::of(all.iter().flat_map::<Vec<BlockKey>, _>(of_near));
        let group = |of: &Group| {
            let mut reads = vec![0; read.len().div_ceil(8)];
            places_in(read, &of.reads).for_each(|place| reads[place / 8] |= 1 << (place % 8));
            KeptGroup { rows: of.rows.clone(), digest: digest(&reads, &marks), reads }
        };
        let row = |of: &Gathered| {
            let Row { shared, near, near_weight, .. } = &of.row;
            KeptRow {
                leaves: Counts::of(&of.hits.leaves, |leaf| {
                    leaves.partition_point(|other| *other < leaf) as u32
                }),
                sky: Counts::of(&of.hits.sky, |part| part),
                lit: shared.lit,
                uncovered: shared.uncovered,
                mean_path_m: shared.mean_path_m,
                emitters: shared.emitters.clone(),
                near_weight: *near_weight,
                near: near.iter().map(|hit| KeptNear::of(hit, &world.lightmap, &blocks)).collect(),
            }
        };
        Self {
            leaves: leaves.iter().map(|&leaf| key_of_leaf(tree, leaf)).collect(),
            groups: groups.par_iter().map(group).collect(),
            rows: all.par_iter().map(row).collect(),
            blocks: blocks.into_values(),
        }
    }

    /// The rows as an artefact; `None` if that would be too large.
    pub fn encoded(&self) -> Result<Option<Vec<u8>>, TaskError> {
        let bytes = artefact::encode(ARTEFACT_MAGIC, self)?;
        Ok((bytes.len() <= RECEIVER_BYTES_MAX * self.rows.len()).then_some(bytes))
    }

    /// Rows from their artefact. Errs for such as no task within those limits leaves.
    pub fn decoded(bytes: &[u8], limits: &RowLimits) -> Result<Self, TaskError> {
        let rows: Self = artefact::decode(ARTEFACT_MAGIC, bytes)?.0;
        let fits = rows.rows.len() == limits.receivers
            && rows.are_grouped()
            && rows.rows.iter().all(|row| row.fits(limits));
        if fits { Ok(rows) } else { Err(TaskError::bad_input("kept rows are not those of such a task")) }
    }

    /// Each row is in one group, and each group has some.
    fn are_grouped(&self) -> bool {
        let mut is_in_any = vec![false; self.rows.len()];
        let mut places = self.groups.iter().flat_map(|group| &group.rows);
        let are_apart = places.all(|&place| {
            is_in_any.get_mut(place as usize).is_some_and(|is_in_any| !std::mem::replace(is_in_any, true))
        });
        are_apart && !is_in_any.contains(&false) && self.groups.iter().all(|group| !group.rows.is_empty())
    }

    /// Rows as they were gathered, of groups whose rays read nothing that has changed since the task left that record.
    pub fn holding(&self, transport: &PatchTransport, record: &Record) -> Vec<Option<Known>> {
        let PatchTransport { world, tree, stage, .. } = transport;
        let read = record.names_of_rays();
        let now = Now::of(self, &read, stage, tree, &world.lightmap);
        let mut found = vec![None; self.rows.len()];
        let held: Vec<_> = self.groups.par_iter().map(|group| group.holding(&now, &self.rows)).collect();
        for (place, known) in held.into_iter().flatten() {
            found[place as usize] = known;
        }
        found
    }
}

/// Meaning of kept rows' names in the scene as it is.
struct Now<'a> {
    read: &'a [Name],
    marks: Vec<Mark>,
    leaves: Vec<Option<u32>>,
    blocks: Vec<Option<u32>>,
    lightmap: &'a Lightmap,
}

impl<'a> Now<'a> {
    fn of(
        rows: &KeptRows,
        read: &'a [Name],
        stage: &Stage,
        tree: &PatchTree,
        lightmap: &'a Lightmap,
    ) -> Self {
        let block_of = |key: &BlockKey| lightmap.blocks.iter().position(|block| block.key == *key);
        Self {
            read,
            marks: read.par_iter().map(|name| stage.mark(*name)).collect(),
            leaves: rows.leaves.iter().map(|&key| leaf_of_key(tree, key)).collect(),
            blocks: rows.blocks.iter().map(|key| block_of(key).map(|block| block as u32)).collect(),
            lightmap,
        }
    }
}

impl KeptRow {
    /// Its hits are no more than rays, and its numbers within what they can be.
    fn fits(&self, limits: &RowLimits) -> bool {
        let (Some(leaves), Some(sky)) = (self.leaves.rays(), self.sky.rays()) else { return false };
        let rays = limits.rays as f32;
        let is_finite = |vector: &[f32; 3]| vector.iter().all(|number| number.is_finite());
        leaves + sky <= u64::from(limits.rays)
            && self.sky.last().is_none_or(|part| part < u64::from(limits.sky_parts))
            && self.near.len() <= limits.near_hits as usize
            && self.emitters.len() == limits.emitters
            && [self.lit, self.uncovered].iter().all(|sum| (0.0..=rays).contains(sum))
            && (0.0..=f32::MAX).contains(&self.mean_path_m)
            && (0.0..=PI).contains(&self.near_weight)
            && self.emitters.iter().all(is_finite)
            && self.near.iter().all(|hit| is_finite(&hit.position_m) && is_finite(&hit.face_normal))
    }

    /// `None` if a thing that it names is gone.
    fn found(&self, now: &Now) -> Option<Gathered> {
        let near = self.near.iter().map(|hit| hit.found(now)).collect::<Option<_>>()?;
        let leaves = self.leaves.hits(|place| *now.leaves.get(place as usize)?)?;
        let sky = self.sky.hits(Some)?;
        let shared = rows::Row {
            lit: self.lit,
            uncovered: self.uncovered,
            left_out: self.uncovered,
            mean_path_m: self.mean_path_m,
            emitters: self.emitters.clone(),
            ..rows::Row::default()
        };
        let row = Row { shared, near, near_weight: self.near_weight, ..Row::default() };
        Some(Gathered { hits: RowHits { leaves, sky }, row })
    }
}

impl KeptGroup {
    /// Its rows by their places; none if something that its rays read has changed, or if it is not one of that record.
    fn holding(&self, now: &Now, rows: &[KeptRow]) -> Vec<(u32, Option<Known>)> {
        let is_of_record = self.reads.len() == now.read.len().div_ceil(8);
        if !is_of_record || digest(&self.reads, &now.marks) != self.digest {
            return Vec::new();
        }
        let reads: Arc<[Name]> = bits(&self.reads).filter_map(|place| now.read.get(place).copied()).collect();
        let found = |place: u32| {
            let gathered = rows[place as usize].found(now)?;
            Some(Known { gathered, reads: Arc::clone(&reads) })
        };
        self.rows.iter().map(|&place| (place, found(place))).collect()
    }
}

impl Counts {
    fn of(hits: &[RayHit], number: impl Fn(u32) -> u32) -> Self {
        let mut hits: Vec<(u32, bool)> = hits.iter().map(|hit| (hit.at, hit.is_even)).collect();
        hits.sort_unstable();
        let (mut counts, mut last) = (Self::default(), 0);
        for same in hits.chunk_by(|a, b| a.0 == b.0) {
            let number = number(same[0].0);
            let odd = same.partition_point(|(_, is_even)| !is_even);
            counts.steps.push(number - std::mem::replace(&mut last, number));
            counts.odd_even.push([odd, same.len() - odd].map(|count| count as u16));
        }
        counts
    }

    /// How many hits there are; `None` if there are other numbers of things than of counts.
    fn rays(&self) -> Option<u64> {
        let counts = self.odd_even.iter().flatten();
        (self.steps.len() == self.odd_even.len()).then(|| counts.map(|&count| u64::from(count)).sum())
    }

    /// The highest number.
    fn last(&self) -> Option<u64> {
        (!self.steps.is_empty()).then(|| self.steps.iter().map(|&step| u64::from(step)).sum())
    }

    /// As hits; `None` if one is on nothing.
    fn hits(&self, of: impl Fn(u32) -> Option<u32>) -> Option<Vec<RayHit>> {
        let (mut hits, mut number) = (Vec::new(), 0_u32);
        for (step, odd_even) in self.steps.iter().zip(&self.odd_even) {
            number = number.checked_add(*step)?;
            let at = of(number)?;
            for (count, is_even) in odd_even.iter().zip([false, true]) {
                hits.extend((0..*count).map(|_| RayHit { at, is_even, weight: 1.0 }));
            }
        }
        Some(hits)
    }
}

impl KeptNear {
    fn of(hit: &NearHit, lightmap: &Lightmap, blocks: &Numbering<BlockKey>) -> Self {
        let (block, texel) = lightmap.name_of(hit.receiver);
        let [position_m, face_normal] = [hit.position_m, hit.face_normal].map(|vector| vector.to_array());
        Self { block: blocks.place_u16(block), texel, is_own: hit.is_own, position_m, face_normal }
    }

    fn found(&self, now: &Now) -> Option<NearHit> {
        let block = (*now.blocks.get(usize::from(self.block))?)?;
        let [x, y] = self.texel.map(i32::from);
        Some(NearHit {
            receiver: now.lightmap.receiver_at(block, x, y)?,
            is_own: self.is_own,
            position_m: Vec3::from(self.position_m),
            face_normal: Vec3::from(self.face_normal),
        })
    }
}

/// Places of the bits that are set.
fn bits(bytes: &[u8]) -> impl Iterator<Item = usize> + '_ {
    let of_byte = |(index, byte): (usize, &u8)| {
        let first = (*byte != 0).then_some(*byte);
        let bytes = std::iter::successors(first, |byte| Some(byte & (byte - 1)).filter(|left| *left != 0));
        bytes.map(move |byte| index * 8 + byte.trailing_zeros() as usize)
    };
    bytes.iter().enumerate().flat_map(of_byte)
}

/// Digest of the marks whose bits are set.
fn digest(reads: &[u8], marks: &[Mark]) -> Mark {
    let mut bytes = Bytes::default();
    bits(reads).filter_map(|place| marks.get(place)).for_each(|mark| {
        bytes.bytes(mark);
    });
    bytes.mark()
}

/// Key of a leaf's patch. Patches stand in the order of their first leaves, each before its parts: of those that begin with the leaf
/// the last is the leaf itself.
fn key_of_leaf(tree: &PatchTree, leaf: u32) -> PatchKey {
    let end = tree.patches.partition_point(|patch| patch.first_leaf <= leaf);
    tree.patches[end - 1].key
}

fn leaf_of_key(tree: &PatchTree, key: PatchKey) -> Option<u32> {
    tree.of_key(key).filter(|patch| patch.leaf_count == 1).map(|patch| patch.first_leaf)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hits_come_back_by_leaf_with_odd_rays_first_and_none_where_a_leaf_is_gone() {
        let ray = |at: u32, is_even: bool| RayHit { at, is_even, weight: 1.0 };
        let hits = [ray(9, true), ray(4, true), ray(9, false), ray(4, false), ray(9, true)];
        let counts = Counts::of(&hits, |at| at / 4);
        assert_eq!((&counts.steps[..], &counts.odd_even[..]), (&[1, 1][..], &[[1, 1], [1, 2]][..]));
        let back = counts.hits(|number| Some(10 * number)).unwrap();
        assert_eq!(back, [ray(10, false), ray(10, true), ray(20, false), ray(20, true), ray(20, true)]);
        assert_eq!(counts.hits(|number| (number == 1).then_some(0)), None);
        let overflowing = Counts { steps: vec![u32::MAX, 1], odd_even: vec![[1, 0]; 2] };
        assert_eq!(overflowing.hits(Some), None);
    }

    #[test]
    fn rows_that_no_task_leaves_are_refused() {
        type Harm = fn(&mut KeptRow);
        let limits = RowLimits { receivers: 2, emitters: 1, rays: 16, near_hits: 1, sky_parts: 4 };
        let near = KeptNear {
            block: 0,
            texel: [3, 4],
            is_own: false,
            position_m: [1.0, 2.0, 3.0],
            face_normal: [0.0, 1.0, 0.0],
        };
        let good = KeptRow {
            leaves: Counts { steps: vec![2, 1], odd_even: vec![[4, 3], [1, 0]] },
            sky: Counts { steps: vec![0, 3], odd_even: vec![[4, 3], [0, 1]] },
            lit: 16.0,
            uncovered: 1.0,
            mean_path_m: 2.0,
            emitters: vec![[0.5; 3]],
            near_weight: PI,
            near: vec![near],
        };
        let in_groups = |rows: &[KeptRow], groups: &[&[u32]]| {
            let group = |rows: &&[u32]| KeptGroup { rows: rows.to_vec(), ..KeptGroup::default() };
            let groups = groups.iter().map(group).collect();
            let rows = KeptRows { rows: rows.to_vec(), groups, leaves: Vec::new(), blocks: Vec::new() };
            KeptRows::decoded(&artefact::encode(ARTEFACT_MAGIC, &rows).unwrap(), &limits)
        };
        let decoded = |rows: &[KeptRow]| in_groups(rows, &[&[1, 0]]);
        assert_eq!(decoded(&[good.clone(), good.clone()]).unwrap().rows, [good.clone(), good.clone()]);
        assert!(in_groups(std::slice::from_ref(&good), &[&[0]]).is_err(), "a row too few");
        let both = [good.clone(), good.clone()];
        assert!(in_groups(&both, &[&[1], &[0]]).is_ok());
        for groups in [&[&[0][..]][..], &[], &[&[0, 1], &[1]], &[&[0, 1, 2]], &[&[0, 0]], &[&[0, 1], &[]]] {
            assert!(in_groups(&both, groups).is_err(), "{groups:?}");
        }
        let hostile: [(&str, Harm); 13] = [
            ("a leaf without a count", |row| row.leaves.steps.push(1)),
            ("a count without a part of the sky", |row| row.sky.odd_even.push([0; 2])),
            ("a hit more than rays", |row| row.leaves.odd_even[0][0] += 1),
            ("hits that overflow", |row| row.leaves.odd_even = vec![[u16::MAX; 2]; 2]),
            ("a part that no sky has", |row| row.sky.steps[1] = 4),
            ("parts that overflow", |row| row.sky.steps = vec![u32::MAX, 1]),
            ("a near hit too many", |row| row.near.push(row.near[0].clone())),
            ("an emitter too few", |row| row.emitters.clear()),
            ("more light than rays", |row| row.lit = 16.5),
            ("light that is no number", |row| row.uncovered = f32::NAN),
            ("a path without end", |row| row.mean_path_m = f32::INFINITY),
            ("more than a hemisphere", |row| row.near_weight = 3.2),
            ("a place that is none", |row| row.near[0].position_m[1] = f32::NAN),
        ];
        for (what, harm) in hostile {
            let mut row = good.clone();
            harm(&mut row);
            assert!(decoded(&[good.clone(), row]).is_err(), "{what}");
        }
    }

    #[test]
    fn rows_hold_while_marks_that_their_group_read_do_and_only_beside_its_own_record() {
        let names: Vec<Name> = (0..11).map(Name).collect();
        let mut marks: Vec<Mark> = (0..11).map(|byte| [byte; 16]).collect();
        let reads = vec![0b0000_0101, 0b0000_0100];
        let group = KeptGroup { rows: vec![1, 0], digest: digest(&reads, &marks), reads };
        let rows = vec![KeptRow::default(); 2];
        let lightmap =
            Lightmap { texel_m: 1.0, first_block: vec![0], blocks: Vec::new(), receivers: Vec::new() };
        let holding = |marks: &[Mark], read: &[Name]| {
            let (marks, leaves, blocks) = (marks.to_vec(), Vec::new(), Vec::new());
            group.holding(&Now { read, marks, leaves, blocks, lightmap: &lightmap }, &rows)
        };
        let found = holding(&marks, &names);
        let places: Vec<u32> = found.iter().map(|(place, _)| *place).collect();
        assert_eq!(places, [1, 0]);
        for (_, known) in &found {
            assert_eq!(known.as_ref().unwrap().reads[..], [Name(0), Name(2), Name(10)]);
        }
        assert_eq!(holding(&marks[..8], &names[..8]), [], "a record of fewer names");
        marks[1] = [77; 16];
        assert_eq!(holding(&marks, &names).len(), 2, "they read nothing of that");
        marks[10] = [77; 16];
        assert_eq!(holding(&marks, &names), []);
    }
}
