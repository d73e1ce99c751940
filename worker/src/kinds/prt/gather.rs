//! Rows of receivers over surface patches: `α_rs = π/N · (how many of N cosine-distributed rays from r meet patch s)`, for
//! the patches of a cut through the tree that suits the cell.

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use super::near::{self, NearHit};
use super::rows::{Gathered, Group, KeptRows, Known};
use super::{PatchTransport, Row};
use crate::factors::{Detail, cells};
use crate::geometry::Bits;
use crate::rays::Hit;
use crate::reads::{Name, Reads, Record, union};
use crate::task::{Cancelled, Progress};
use crate::transport::{
    CutBounds, Hemisphere, HemisphereRay, Met, PatchRow, RayHit, RowHits, Sources, patch_rows,
};

/// Error of taking patches whole as a share of that of truncation: behind bends it is light that is not there, as hidden
/// parts of a patch are lit like those in sight, and columns of differences cost little.
const CUT_SHARE: f32 = 0.16;

/// Rays of a receiver for each receiver of a group, whose rays note together what they read: where they are few, those of one miss much of
/// what its neighbours' meet. Less → parts noted less often, more rays cast again after an edit.
const RAYS_OF_SHARER: u32 = 128;
/// Groups are small where rays are many against the grid's cells, by this factor, as noting few cells costs little. More → as above.
const RAYS_A_CELL: u32 = 4;
/// Most receivers of a group. More → as above.
const GROUP_RECEIVERS_MAX: u32 = 16;

/// Rows of a cell's receivers.
pub struct Traced {
    /// Patches of the cell's cut and parts of the sky, ascending; those of the sky come last.
    pub keys: Vec<u64>,
    /// One row per receiver, in order.
    pub rows: Vec<Row>,
    /// All that was read for them, unless that was too much or nobody wants to know; and the rows as they were gathered.
    pub record: Option<(Record, KeptRows)>,
    /// Receivers whose rays were cast.
    pub traced: usize,
}

/// Near hits while it is not known whether the place is narrow: as they are, and as leaves in case it is not.
#[derive(Default)]
struct Near {
    hits: Vec<NearHit>,
    leaves: Vec<RayHit>,
    lost: f32,
}

/// Traces the rows of a cell's receivers but for those that are `known`, each in its receiver's place, with all of their group.
pub fn trace(
    transport: &PatchTransport,
    receivers: &[u32],
    known: Vec<Option<Known>>,
    detail: Detail,
    progress: &Progress,
) -> Result<Traced, Cancelled> {
    let PatchTransport { world, tree, settings, stage, .. } = transport;
    progress.begin(0.0, 0.9, receivers.len() as u64);
    let gathering = Gathering {
        transport,
        sources: Sources::new(world, tree, settings.patches.sky_parts),
        clear_way_m: near::clear_way_m(settings, near::longest_texel_m(&world.lightmap, receivers)),
    };
    let (groups, known) = grouped(transport, receivers, known);
    let traced = groups.iter().zip(&known).filter(|(_, known)| known.is_none()).map(|(of, _)| of.len()).sum();
    let found: Vec<(Vec<Gathered>, Vec<Name>)> = groups
        .par_iter()
        .zip(known)
        // A group is much work: no thread shall hold a second one that another could do.
        .with_max_len(1)
        .map(|(members, known)| match known {
            Some(known) => {
                progress.check()?;
                progress.advance(members.len() as u64);
                Ok(taken_over(known))
            }
            None => gathering.cast_group(members, receivers, progress),
        })
        .collect::<Result<_, Cancelled>>()?;
    let mut gathered = vec![Gathered::default(); receivers.len()];
    let mut all_reads = Vec::with_capacity(groups.len());
    for (members, (rows, reads)) in groups.iter().zip(found) {
        members.iter().zip(rows).for_each(|(&place, row)| gathered[place as usize] = row);
        all_reads.push(reads);
    }
    let met = Bits::new(tree.leaf_starts.len());
    gathered.par_iter().flat_map_iter(|of| &of.hits.leaves).for_each(|hit| met.add(hit.at as usize));
    let leaves: Vec<u32> = met.iter().map(|leaf| leaf as u32).collect();
    let mut hits: Vec<RowHits> = gathered.iter_mut().map(|of| std::mem::take(&mut of.hits)).collect();
    let bounds = CutBounds {
        columns_max: settings.patches.patches_max as usize,
        error: CUT_SHARE * settings.patches.rank_error,
    };
    let scale = std::f32::consts::PI / settings.transport.transport_rays as f32;
    progress.check()?;
    let bounds = (detail == Detail::AsBaked).then_some(bounds);
    let found = patch_rows(tree, world.lightmap.texel_m, &mut hits, scale, bounds);
    let record = if stage.grid.is_empty() {
        None
    } else {
        let read = union(all_reads.par_iter().map(Vec::as_slice));
        gathered.iter_mut().zip(hits).for_each(|(of, hits)| of.hits = hits);
        let record = Record::of(stage, tree, &read, &leaves, &found.by_share);
        let groups: Vec<Group> =
            groups.into_iter().zip(all_reads).map(|(rows, reads)| Group { rows, reads }).collect();
        record.map(|record| (record, KeptRows::of(transport, &gathered, &groups, (&read, &leaves))))
    };
    let rows = gathered.into_iter().zip(found.rows).map(|(of, PatchRow { alpha, importance })| {
        let mut row = of.row;
        (row.shared.alpha, row.importance) = (alpha, importance);
        row
    });
    let rows = rows.collect();
    Ok(Traced { keys: found.keys, rows, record, traced })
}

/// Places of a cell's receivers by group, and the rows of each group that is known as a whole.
///
/// A group is of few receivers that lie close together, which hangs on their points alone: their rays read much the same, and noting it for
/// each by itself costs as much as all else.
fn grouped(
    transport: &PatchTransport,
    receivers: &[u32],
    mut known: Vec<Option<Known>>,
) -> (Vec<Vec<u32>>, Vec<Option<Vec<Known>>>) {
    let of_all = &transport.world.lightmap.receivers;
    let positions_m: Vec<Vec3> =
        receivers.iter().map(|&receiver| of_all[receiver as usize].position_m).collect();
    let rays = transport.settings.transport.transport_rays;
    let most = (rays / RAYS_OF_SHARER).min(RAYS_A_CELL * transport.stage.grid.len() as u32 / rays);
    let groups = cells(&positions_m, most.clamp(1, GROUP_RECEIVERS_MAX));
    let groups: Vec<Vec<u32>> = groups.into_iter().map(|cell| cell.receivers).collect();
    known.resize_with(receivers.len(), || None);
    let known =
        groups.iter().map(|members| members.iter().map(|&place| known[place as usize].take()).collect());
    let known = known.collect();
    (groups, known)
}

/// Rows of a group that is known, and what was read for them.
fn taken_over(known: Vec<Known>) -> (Vec<Gathered>, Vec<Name>) {
    let (rows, mut reads): (Vec<Gathered>, Vec<Arc<[Name]>>) =
        known.into_iter().map(|known| (known.gathered, known.reads)).unzip();
    reads.dedup_by(|a, b| Arc::ptr_eq(a, b));
    (rows, union(reads.par_iter().map(|reads| &reads[..])))
}

/// Sources of the rows of a cell.
struct Gathering<'a> {
    transport: &'a PatchTransport,
    sources: Sources<'a>,
    /// As in [`near::clear_way_m`].
    clear_way_m: f32,
}

impl Gathering<'_> {
    fn hemisphere(&self, receiver: u32) -> Hemisphere<'_> {
        let PatchTransport { world, emitters, settings, radiance, .. } = self.transport;
        let rays = settings.transport.transport_rays;
        Hemisphere::new(world, emitters, receiver, rays).for_radiance(*radiance)
    }

    /// Casts the rays of a group, whose places are given, and tells what they read.
    fn cast_group(
        &self,
        places: &[u32],
        receivers: &[u32],
        progress: &Progress,
    ) -> Result<(Vec<Gathered>, Vec<Name>), Cancelled> {
        let reads = Reads::new(&self.transport.world, &self.transport.stage);
        let rows = places.iter().map(|&place| {
            progress.check()?;
            let gathered = progress.casting(|| self.cast(receivers[place as usize], &reads));
            progress.advance(1);
            Ok(gathered)
        });
        let rows = rows.collect::<Result<_, Cancelled>>()?;
        Ok((rows, reads.into_names()))
    }

    /// Casts a receiver's rays, and notes what they read.
    fn cast(&self, receiver: u32, reads: &Reads) -> Gathered {
        let Self { transport, sources, clear_way_m } = self;
        let PatchTransport { world, emitters, settings, .. } = transport;
        let hemisphere = self.hemisphere(receiver);
        let (mut gathered, mut near) = (Gathered::default(), Near::default());
        let texel_m = world.lightmap.texel_m_of(receiver);
        let reach_m = near::reach_m(settings, texel_m);
        let from_m = hemisphere.origin_m();
        let mut is_even = true;
        let surroundings = hemisphere.cast(
            settings.transport.emitter_rays,
            &reads.trail,
            |HemisphereRay { origin_m, direction }, hit| {
                let ray = |at: u32| RayHit { at, is_even, weight: 1.0 };
                match hit {
                    None => {
                        gathered.row.shared.lit += 1.0;
                        gathered.hits.sky.push(ray(sources.sky(direction)));
                    }
                    Some(hit) => {
                        let point_m = origin_m + direction * hit.t;
                        let near = (point_m.distance(from_m) < reach_m).then_some(&mut near);
                        let met = sources.at(hit, point_m);
                        reads.note_hit(&met.found, point_m);
                        gathered.add_hit(transport, met, hit, point_m, ray, near);
                    }
                }
                is_even = !is_even;
            },
        );
        let Gathered { hits, row, .. } = &mut gathered;
        // Whether a place is narrow is known only now: near hits count as such there, and as their leaves elsewhere.
        if near::is_narrow(near.hits.len(), settings) {
            near::keep(row, near.hits, settings, &world.lightmap, texel_m);
            let around_m = clear_way_m.max(reach_m);
            row.near.iter().for_each(|hit| reads.note_around(hit.position_m, around_m));
            near::drop_shut(row, (world, emitters), settings, receiver);
        } else {
            hits.leaves.append(&mut near.leaves);
            row.shared.uncovered += near.lost;
        }
        row.shared.left_out = row.shared.uncovered;
        row.shared.add_surroundings(surroundings);
        gathered
    }
}

impl Gathered {
    /// Adds a hit to its leaf, or to `near` where it is given and the hit's light can be read at its very point.
    fn add_hit(
        &mut self,
        transport: &PatchTransport,
        met: Met,
        hit: &Hit,
        point_m: Vec3,
        ray: impl Fn(u32) -> RayHit,
        near: Option<&mut Near>,
    ) {
        let near =
            near.and_then(|near| Some((NearHit::of(&transport.world, hit, &met.found, point_m)?, near)));
        self.row.shared.lit += met.lit;
        let (leaves, lost) = match near {
            Some((near_hit, near)) => {
                near.hits.push(near_hit);
                (&mut near.leaves, &mut near.lost)
            }
            None => (&mut self.hits.leaves, &mut self.row.shared.uncovered),
        };
        match met.leaf {
            Some(leaf) => leaves.push(ray(leaf)),
            None => *lost += met.lit,
        }
    }
}
