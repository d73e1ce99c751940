//! Rows of receivers over surface patches: `α_rs = π/N · (how many of N cosine-distributed rays from r meet patch s)`, for
//! the patches of a cut through the tree that suits the cell.

use std::mem::take;

use glam::Vec3;
use rayon::prelude::*;

use super::near::{self, NearHit};
use super::sparse::{self, Corners, Texel};
use super::{PatchTransport, Row};
use crate::factors::Detail;
use crate::geometry::Bits;
use crate::rays::Hit;
use crate::reads::{Reads, Record};
use crate::task::{Cancelled, Progress};
use crate::transport::Row as Shared;
use crate::transport::{
    CutBounds, Hemisphere, HemisphereRay, Met, PatchRow, RayHit, RowHits, Sources, patch_rows,
};

/// Error of taking patches whole as a share of that of truncation: behind bends it is light that is not there, as hidden
/// parts of a patch are lit like those in sight, and columns of differences cost little.
const CUT_SHARE: f32 = 0.08;

/// Rows of a cell's receivers.
pub struct Traced {
    /// Patches of the cell's cut and parts of the sky, ascending; those of the sky come last.
    pub keys: Vec<u64>,
    /// One row per receiver, in order.
    pub rows: Vec<Row>,
    /// How many of them cast rays: the rows of the others lie between theirs.
    pub casting: usize,
    /// All that was read for them, unless that was too much.
    pub record: Option<Record>,
}

/// Hits of one receiver's rays.
#[derive(Default)]
struct Gathered {
    hits: RowHits,
    cast: Cast,
}

/// A row of rays.
#[derive(Default)]
struct Cast {
    row: Row,
    /// As in [`Surroundings`](crate::transport::Surroundings).
    emitters_met: Vec<[f32; 3]>,
    nearness_m2: f32,
}

/// Near hits while it is not known whether the place is narrow: as they are, and as leaves in case it is not.
#[derive(Default)]
struct Near {
    hits: Vec<NearHit>,
    leaves: Vec<RayHit>,
    lost: f32,
}

/// Traces the rows of a cell's receivers.
pub fn trace(
    transport: &PatchTransport,
    receivers: &[u32],
    detail: Detail,
    progress: &Progress,
) -> Result<Traced, Cancelled> {
    let PatchTransport { world, tree, settings, stage, .. } = transport;
    progress.begin(0.0, 0.9, receivers.len() as u64);
    let gathering = Gathering {
        transport,
        sources: Sources::new(world, tree, settings.patches.sky_parts),
        reads: Reads::new(world, stage),
        clear_way_m: near::clear_way_m(settings, near::longest_texel_m(&world.lightmap, receivers)),
    };
    let texels: Vec<Texel> = receivers.iter().map(|&receiver| Texel::of(world, receiver)).collect();
    let is_as_baked = detail == Detail::AsBaked;
    let bend = if is_as_baked { settings.patches.bend } else { 0.0 };
    if bend > 0.0 {
        receivers.iter().for_each(|&receiver| gathering.reads.note_receiver(receiver));
    }
    // Cast the rays, and tell who casts none.
    let mut gathered: Vec<Option<Gathered>> = receivers.iter().map(|_| None).collect();
    let corners = sparse::corners(&texels, bend, |places| {
        let cast = places.par_iter().map(|&place| {
            progress.check()?;
            let gathered = progress.casting(|| gathering.cast(receivers[place]));
            progress.advance(1);
            Ok(gathered)
        });
        let cast = cast.collect::<Result<Vec<Gathered>, Cancelled>>()?;
        let nearness_m2 = cast.iter().map(Gathered::nearness_m2).collect();
        places.iter().zip(cast).for_each(|(&place, cast)| gathered[place] = Some(cast));
        Ok(nearness_m2)
    })?;
    // Sum up the rows of those who did.
    let (hits, rows): (Vec<RowHits>, Vec<Cast>) = gathered
        .iter_mut()
        .flatten()
        .map(|gathered| (take(&mut gathered.hits), take(&mut gathered.cast)))
        .unzip();
    let met = Bits::new(tree.leaf_starts.len());
    hits.par_iter().flat_map_iter(|hits| &hits.leaves).for_each(|hit| met.add(hit.at as usize));
    let leaves: Vec<u32> = met.iter().map(|leaf| leaf as u32).collect();
    let bounds = CutBounds {
        columns_max: settings.patches.patches_max as usize,
        error: CUT_SHARE * settings.factors.rank_error,
    };
    let scale = std::f32::consts::PI / settings.transport.transport_rays as f32;
    progress.check()?;
    let found = patch_rows(tree, world.lightmap.texel_m, hits, scale, is_as_baked.then_some(bounds));
    let mut cast = rows.into_iter().zip(found.rows).map(|(mut cast, PatchRow { alpha, importance })| {
        (cast.row.shared.alpha, cast.row.importance) = (alpha, importance);
        cast
    });
    let cast: Vec<Option<Cast>> =
        corners.iter().map(|corners| if corners.is_none() { cast.next() } else { None }).collect();
    let casting = cast.iter().flatten().count();
    // Interpolate those of the others.
    let between = receivers.par_iter().zip(&corners).map(|(&receiver, corners)| {
        let Some(corners) = corners else { return Ok(None) };
        progress.check()?;
        let row = progress.casting(|| gathering.between(receiver, corners, &cast));
        progress.advance(1);
        Ok(Some(row))
    });
    let between = between.collect::<Result<Vec<Option<Row>>, Cancelled>>()?;
    let rows = cast
        .into_iter()
        .zip(between)
        .filter_map(|(own, between)| own.map(|own| own.row).or(between))
        .collect();
    let record = Record::of(stage, tree, gathering.reads, &leaves, &found.by_share);
    Ok(Traced { keys: found.keys, rows, casting, record })
}

/// What rows of a cell are gathered from.
struct Gathering<'a> {
    transport: &'a PatchTransport,
    sources: Sources<'a>,
    reads: Reads<'a>,
    /// As in [`near::clear_way_m`].
    clear_way_m: f32,
}

impl Gathering<'_> {
    fn hemisphere(&self, receiver: u32) -> Hemisphere<'_> {
        let PatchTransport { world, emitters, settings, radiance, .. } = self.transport;
        let rays = settings.transport.transport_rays;
        Hemisphere::new(world, emitters, receiver, rays).for_radiance(*radiance)
    }

    /// Row of a receiver between corners that cast rays; it asks emitters itself.
    fn between(&self, receiver: u32, corners: &Corners, cast: &[Option<Cast>]) -> Row {
        let of_corners =
            corners.iter().filter_map(|&(corner, weight)| Some((cast[corner].as_ref()?, weight)));
        let mut row = interpolated(of_corners);
        let PatchTransport { emitters, settings, .. } = self.transport;
        if !emitters.is_empty() {
            let hemisphere = self.hemisphere(receiver);
            let sampled = hemisphere.sample_emitters(settings.transport.emitter_rays, &self.reads.trail);
            add(row.shared.emitters.as_flattened_mut(), sampled.as_flattened(), 1.0);
        }
        row
    }

    /// Casts a receiver's rays.
    fn cast(&self, receiver: u32) -> Gathered {
        let Self { transport, sources, reads, clear_way_m } = self;
        let PatchTransport { world, settings, .. } = transport;
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
                        gathered.cast.row.shared.lit += 1.0;
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
        let Gathered { hits, cast } = &mut gathered;
        let row = &mut cast.row;
        // Whether a place is narrow is known only now: near hits count as such there, and as their leaves elsewhere.
        if near::is_narrow(near.hits.len(), settings) {
            near::keep(row, near.hits, settings, &world.lightmap, texel_m);
            row.near.iter().for_each(|hit| reads.note_around(hit.position_m(), *clear_way_m));
        } else {
            hits.leaves.append(&mut near.leaves);
            row.shared.uncovered += near.lost;
        }
        row.shared.left_out = row.shared.uncovered;
        cast.nearness_m2 = surroundings.nearness_m2;
        cast.emitters_met.clone_from(&surroundings.emitters_met);
        row.shared.add_surroundings(surroundings);
        gathered
    }
}

/// Mean of rows that were cast, with weights: light straight from emitters as far as rays met it.
fn interpolated<'a>(corners: impl Iterator<Item = (&'a Cast, f32)>) -> Row {
    let mut row = Row::default();
    for (corner, weight) in corners {
        let (shared, other) = (&mut row.shared, &corner.row.shared);
        add_to(&mut shared.alpha, &other.alpha, weight);
        for (own, other) in row.importance.iter_mut().zip(&corner.row.importance) {
            add_to(own, other, weight);
        }
        shared.emitters.resize(corner.emitters_met.len(), [0.0; 3]);
        add(shared.emitters.as_flattened_mut(), corner.emitters_met.as_flattened(), weight);
        shared.lit += weight * other.lit;
        shared.uncovered += weight * other.uncovered;
        shared.left_out += weight * other.left_out;
        shared.mean_path_m += weight * other.mean_path_m;
    }
    // Weights of polynomials may be below 0, none of these may.
    let Shared { emitters, lit, uncovered, left_out, mean_path_m, .. } = &mut row.shared;
    let counts = [lit, uncovered, left_out, mean_path_m];
    emitters.as_flattened_mut().iter_mut().chain(counts).for_each(|value| *value = value.max(0.0));
    row
}

fn add_to(sums: &mut Vec<f32>, values: &[f32], weight: f32) {
    sums.resize(values.len(), 0.0);
    add(sums, values, weight);
}

fn add(sums: &mut [f32], values: &[f32], weight: f32) {
    sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += weight * value);
}

impl Gathered {
    /// As in [`Surroundings`](crate::transport::Surroundings); endless where light is read at near hits, which no row between has.
    fn nearness_m2(&self) -> f32 {
        if self.cast.row.near.is_empty() { self.cast.nearness_m2 } else { f32::INFINITY }
    }

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
        self.cast.row.shared.lit += met.lit;
        let (leaves, lost) = match near {
            Some((near_hit, near)) => {
                near.hits.push(near_hit);
                (&mut near.leaves, &mut near.lost)
            }
            None => (&mut self.hits.leaves, &mut self.cast.row.shared.uncovered),
        };
        match met.leaf {
            Some(leaf) => leaves.push(ray(leaf)),
            None => *lost += met.lit,
        }
    }
}
