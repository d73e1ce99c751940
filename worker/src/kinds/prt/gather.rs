//! Rows of the transport matrix over surface patches: `α_rs = π/N · (how many of N cosine-distributed rays from r meet
//! patch s)`, for the patches of a cut through the tree that suits the cell.

use glam::Vec3;
use lightkiln_proto::content::PatchKey;
use lightkiln_proto::harmonics::relight_direction;
use rayon::prelude::*;

use super::cut::{LeafHits, PatchHits, cut, leaves};
use super::expectation::Expectation;
use super::near::{self, NearHit};
use super::{PatchTransport, Row};
use crate::factors::Detail;
use crate::lightmap::{Numbering, Surface};
use crate::rays::Hit;
use crate::task::{Cancelled, Progress};
use crate::transport::Hemisphere;

/// Error of taking patches whole as a share of that of truncation: behind bends it is light that is not there, as hidden
/// parts of a patch are lit like those in sight, and columns of differences cost little.
const CUT_SHARE: f32 = 0.15;

/// Rows over the patches of a cell's cut.
pub struct PatchRows {
    /// Patches of the cut and parts of the sky, ascending; those of the sky come last.
    pub keys: Vec<u64>,
    /// One row per receiver, in order. The sky's group stays 0, as the sky has columns among the keys.
    pub rows: Vec<Row>,
}

/// Hits of one receiver's rays. Each leaf or part of the sky stands as often as it was hit, with the sign of the ray: +1 for
/// those of even number, −1 for the others.
#[derive(Default)]
struct Gathered {
    /// Leaf patches.
    leaves: Vec<(u32, i32)>,
    /// Parts of the sky.
    sky: Vec<(u32, i32)>,
    row: Row,
}

/// Near hits while it is not known whether the place is narrow: as they are, and as leaves in case it is not.
#[derive(Default)]
struct Near {
    hits: Vec<NearHit>,
    leaves: Vec<(u32, i32)>,
    lost: f32,
}

/// Traces the rows of a cell's receivers.
pub fn trace(
    transport: &PatchTransport,
    receivers: &[u32],
    detail: Detail,
    progress: &Progress,
) -> Result<PatchRows, Cancelled> {
    progress.begin(0.0, 0.9, receivers.len() as u64);
    let sky_parts = transport.settings.patches.sky_parts;
    let sky: Vec<Vec3> = (0..sky_parts).map(|part| relight_direction(part, sky_parts)).collect();
    let gathered: Vec<Gathered> = receivers
        .par_iter()
        .map(|&receiver| {
            progress.check()?;
            let gathered = gather(transport, &sky, receiver);
            gathered.row.shared.count(progress);
            Ok(gathered)
        })
        .collect::<Result<_, Cancelled>>()?;
    Ok(summed(transport, receivers, gathered, detail))
}

fn gather(transport: &PatchTransport, sky: &[Vec3], receiver: u32) -> Gathered {
    let PatchTransport { world, emitters, settings, .. } = transport;
    let rays = settings.transport.transport_rays;
    let hemisphere = Hemisphere::new(world, emitters, &world.lightmap.receivers[receiver as usize], rays);
    let (mut gathered, mut near) = (Gathered::default(), Near::default());
    let texel_m = world.lightmap.texel_m;
    let reach_m = near::reach_m(settings, texel_m);
    let mut sign = -1;
    let surroundings = hemisphere.cast(settings.transport.emitter_rays, |direction, hit| {
        sign = -sign;
        match hit {
            None => gathered.add_sky(nearest(sky, direction), sign),
            Some(hit) => {
                let point_m = hemisphere.origin_m + direction * hit.t;
                gathered.add_hit(transport, hit, point_m, sign, (hit.t < reach_m).then_some(&mut near));
            }
        }
    });
    let Gathered { leaves, sky, row } = &mut gathered;
    // Whether a place is narrow is known only now: near hits count as such there, and as their leaves elsewhere.
    if near::is_narrow(near.hits.len(), settings) {
        near::keep(row, near.hits, settings, texel_m);
    } else {
        leaves.append(&mut near.leaves);
        row.shared.uncovered += near.lost;
    }
    row.shared.left_out = row.shared.uncovered;
    row.shared.rays_closest = u64::from(rays);
    row.shared.add_surroundings(surroundings);
    leaves.sort_unstable();
    sky.sort_unstable();
    gathered
}

impl Gathered {
    fn add_sky(&mut self, part: u32, sign: i32) {
        self.row.shared.lit += 1.0;
        self.sky.push((part, sign));
    }

    /// Adds a hit to its leaf, or to `near` where it is given and the hit's light can be read at its very point.
    fn add_hit(
        &mut self,
        transport: &PatchTransport,
        hit: &Hit,
        point_m: Vec3,
        sign: i32,
        near: Option<&mut Near>,
    ) {
        let PatchTransport { world, tree, .. } = transport;
        let row = &mut self.row.shared;
        let albedo =
            |receiver: u32| world.lightmap.receivers[receiver as usize].albedo.iter().sum::<f32>() / 3.0;
        let linked = world.linked_surface_at(hit, point_m);
        let near = near.and_then(|near| Some((NearHit::of(world, hit, linked, point_m)?, near)));
        let Surface::Receiver(met) = linked else {
            let lost = match world.surface_at(hit) {
                // Walls stand between the hit and all texels around it: no texel stands for it.
                Surface::Receiver(own) => albedo(own),
                Surface::Dark => world.lost_in_cavity(hit),
            };
            row.lit += lost;
            match near {
                Some((near_hit, near)) => {
                    near.hits.push(near_hit);
                    near.lost += lost;
                }
                None => row.uncovered += lost,
            }
            return;
        };
        row.lit += albedo(met);
        let leaf = (tree.leaf_of_receiver[met as usize], sign);
        match near {
            Some((near_hit, near)) => {
                near.hits.push(near_hit);
                near.leaves.push(leaf);
            }
            None => self.leaves.push(leaf),
        }
    }
}

/// Index of the direction nearest to `direction`; of equally near ones, the first.
fn nearest(directions: &[Vec3], direction: Vec3) -> u32 {
    let mut best = (0, f32::NEG_INFINITY);
    for (index, other) in directions.iter().enumerate() {
        let cosine = direction.dot(*other);
        if cosine > best.1 {
            best = (index, cosine);
        }
    }
    best.0 as u32
}

/// Sums hits over the patches of the cell's cut.
fn summed(
    transport: &PatchTransport,
    receivers: &[u32],
    gathered: Vec<Gathered>,
    detail: Detail,
) -> PatchRows {
    let PatchTransport { world, tree, settings, .. } = transport;
    let mut leaf_hits: Vec<LeafHits> = Vec::new();
    for (row, gathered) in gathered.iter().enumerate() {
        leaf_hits.extend(gathered.leaves.chunk_by(|a, b| a.0 == b.0).map(|same| LeafHits {
            leaf: same[0].0,
            row: row as u32,
            count: same.len() as u32,
            excess: same.iter().map(|(_, sign)| sign).sum(),
        }));
    }
    leaf_hits.sort_unstable_by_key(|hits| (hits.leaf, hits.row));
    let hits = PatchHits { tree, leaves: &leaf_hits, rows: receivers.len() };
    let expectation = Expectation::new(tree, world.lightmap.texel_m);
    let patches = match detail {
        Detail::AsBaked => {
            let columns_max = settings.patches.patches_max as usize;
            cut(hits, &expectation, columns_max, CUT_SHARE * settings.factors.rank_error)
        }
        Detail::Finest => leaves(tree, &leaf_hits),
    };
    let sky = Numbering::of(gathered.iter().flat_map(|g| &g.sky).map(|&(part, _)| part));
    let of_patches = patches.iter().map(|&patch| tree.patches[patch as usize].key.0);
    let of_sky = sky.values().iter().map(|&part| PatchKey::of_sky(part).0);
    let keys = Numbering::of(of_patches.chain(of_sky));
    let mut table = Table {
        hits,
        expectation,
        patches,
        sky,
        scale: std::f32::consts::PI / settings.transport.transport_rays as f32,
        is_truncated: detail == Detail::AsBaked,
        keys,
        rows: Vec::with_capacity(gathered.len()),
    };
    table.begin(gathered);
    table.add_patches();
    PatchRows { keys: table.keys.into_values(), rows: table.rows }
}

/// Rows while they are filled.
struct Table<'a> {
    hits: PatchHits<'a>,
    expectation: Expectation<'a>,
    /// Patches of the cut, ascending.
    patches: Vec<u32>,
    /// Parts of the sky that were hit.
    sky: Numbering<u32>,
    /// Irradiance of one ray.
    scale: f32,
    is_truncated: bool,
    /// Those of the sky come last.
    keys: Numbering<u64>,
    rows: Vec<Row>,
}

impl Table<'_> {
    fn column(&self, key: PatchKey) -> usize {
        self.keys.place(key.0)
    }

    /// Rows with the sky's columns. Importance-weighted columns stand in the order of keys; the common part of all patches
    /// follows theirs, and that of all of the sky follows the sky's.
    fn begin(&mut self, gathered: Vec<Gathered>) {
        let [of_all, of_part] = Expectation::sky();
        let of_parts = self.sky.values().iter();
        let columns: Vec<usize> = of_parts.map(|&part| self.column(PatchKey::of_sky(part))).collect();
        for gathered in gathered {
            let mut row = gathered.row;
            row.shared.alpha = vec![0.0; self.keys.len() + 1];
            if self.is_truncated {
                row.importance = [(); 2].map(|()| vec![0.0; self.keys.len() + 2]);
            }
            for (part, sign) in gathered.sky {
                let column = columns[self.sky.place(part)];
                row.shared.alpha[column] += self.scale;
                for (weighted, sign) in row.importance.iter_mut().zip([1.0, sign as f32]) {
                    if let [.., last] = &mut weighted[..] {
                        *last += of_all * self.scale * sign;
                        weighted[column + 1] += of_part * self.scale * sign;
                    }
                }
            }
            self.rows.push(row);
        }
    }

    /// The columns of patches: a patch that is part of another one of the cut has the difference from its share of that.
    fn add_patches(&mut self) {
        let common = self.keys.len() - self.sky.len();
        for index in 0..self.patches.len() {
            let patch = self.patches[index];
            let own = self.column(self.key(patch));
            let parts: Vec<(usize, f32)> = self
                .parts(index)
                .map(|part| (self.column(self.key(part)), self.hits.share(part, patch) as f32))
                .collect();
            let parent = self.parent(index);
            let deviation = self.expectation.variance(patch, parent).sqrt() as f32;
            for hits in self.hits.of(patch) {
                let row = &mut self.rows[hits.row as usize];
                let [seen, excess] = [hits.count as f32, hits.excess as f32].map(|n| n * self.scale);
                row.shared.alpha[own] += seen;
                parts.iter().for_each(|&(part, share)| row.shared.alpha[part] -= share * seen);
                if self.is_truncated {
                    for (weighted, value) in row.importance.iter_mut().zip([seen, excess]) {
                        weighted[own] += deviation * value;
                        if parent.is_none() {
                            weighted[common] += Expectation::common() * value;
                        }
                    }
                }
            }
        }
    }

    fn key(&self, patch: u32) -> PatchKey {
        self.hits.tree.patches[patch as usize].key
    }

    /// Parts of a patch of the cut, if they are in it, as all or none are.
    fn parts(&self, index: usize) -> impl Iterator<Item = u32> + '_ {
        let patch = self.patches[index];
        let is_open = self.patches.get(index + 1) == Some(&(patch + 1))
            && self.hits.tree.patches[patch as usize].end > patch + 1;
        self.hits.tree.parts(patch).take_while(move |_| is_open)
    }

    /// The patch of the cut that a patch of it is part of.
    fn parent(&self, index: usize) -> Option<u32> {
        let patch = self.patches[index];
        // Of those before it whose ends are beyond it, the last.
        self.patches[..index]
            .iter()
            .rev()
            .copied()
            .find(|&other| self.hits.tree.patches[other as usize].end > patch)
    }
}
