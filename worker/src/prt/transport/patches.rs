//! Rows of the transport matrix over surface patches: `α_rs = π/N · (how many of N cosine-distributed rays from r meet
//! patch s)`, for the patches of a cut through the tree that suits the cell.

use glam::Vec3;
use lightkiln_proto::prt::{PatchKey, ProbeKey, Settings};
use lightkiln_proto::sh::relight_direction;
use rayon::prelude::*;

use super::alpha::Row;
use super::cut::{Meeting, Met, cut, leaves};
use super::expectation::Expectation;
use super::hemisphere::Hemisphere;
use super::near::{self, NearHit};
use super::{CellRows, Detail};
use crate::prt::world::{Surface, World};
use crate::task::{Cancelled, Progress};

/// Error of taking patches whole as a share of that of truncation: behind bends it is light that is not there, as hidden
/// parts of a patch are lit like those in sight, and columns of differences cost little.
const CUT_SHARE: f32 = 0.15;

/// What the rays of one receiver meet.
struct Gathered {
    /// Leaf patches met, ascending, each as often as it was met.
    leaves: Vec<(u32, i32)>,
    /// Parts of the sky met, likewise.
    sky: Vec<(u32, i32)>,
    row: Row,
}

/// Traces the rows of a cell's receivers. The group of the sky stays 0, as the sky has columns among the keys.
pub fn trace(
    world: &World,
    settings: &Settings,
    receivers: &[u32],
    detail: Detail,
    progress: &Progress,
) -> Result<CellRows, Cancelled> {
    let sky: Vec<Vec3> =
        (0..settings.sky_parts).map(|part| relight_direction(part, settings.sky_parts)).collect();
    let gathered: Vec<Gathered> = receivers
        .par_iter()
        .map(|&receiver| {
            progress.check()?;
            let gathered = gather(world, settings, &sky, receiver);
            gathered.row.count(progress);
            Ok(gathered)
        })
        .collect::<Result<_, Cancelled>>()?;
    Ok(summed(world, settings, receivers, gathered, detail))
}

fn gather(world: &World, settings: &Settings, sky: &[Vec3], receiver: u32) -> Gathered {
    let receiver = &world.stage.receivers[receiver as usize];
    let hemisphere = Hemisphere::new(world, receiver, settings.transport_rays);
    let mut row = Row { rays_closest: u64::from(settings.transport_rays), ..Row::default() };
    let (mut leaves, mut parts) = (Vec::new(), Vec::new());
    // Near hits, and what they are among the leaves where the place is not narrow.
    let (mut near, mut near_leaves, mut near_lost) = (Vec::new(), Vec::new(), 0.0);
    let texel_m = world.stage.texel_m;
    let reach_m = near::reach_m(settings, texel_m);
    let mut sign = -1;
    let (emitters, mean_path_m, rays_occlusion) = hemisphere.cast(settings.emitter_rays, |direction, hit| {
        sign = -sign;
        let Some(hit) = hit else {
            row.lit += 1.0;
            parts.push((nearest(sky, direction), sign));
            return;
        };
        let point_m = hemisphere.origin_m + direction * hit.t;
        let lit = |receiver: u32| world.stage.receivers[receiver as usize].albedo.iter().sum::<f32>() / 3.0;
        let linked = world.linked_surface_at(hit, point_m);
        let near_hit = if hit.t < reach_m { NearHit::of(world, hit, linked, point_m) } else { None };
        near.extend(near_hit);
        let Surface::Receiver(met) = linked else {
            let lost = match world.surface_at(hit) {
                // Walls stand between the hit and all texels around it: no texel stands for it.
                Surface::Receiver(own) => lit(own),
                Surface::Dark => world.lost_in_cavity(hit),
            };
            row.lit += lost;
            let lost_if_wide = if near_hit.is_some() { &mut near_lost } else { &mut row.uncovered };
            *lost_if_wide += lost;
            return;
        };
        row.lit += lit(met);
        let leaf = (world.stage.patches.leaf_of_receiver[met as usize], sign);
        if near_hit.is_some() {
            near_leaves.push(leaf)
        } else {
            leaves.push(leaf)
        };
    });
    if near::is_narrow(near.len(), settings) {
        near::keep(&mut row, near, settings, texel_m);
    } else {
        leaves.append(&mut near_leaves);
        row.uncovered += near_lost;
    }
    row.left_out = row.uncovered;
    (row.emitters, row.mean_path_m, row.rays_occlusion) = (emitters, mean_path_m, rays_occlusion);
    leaves.sort_unstable();
    parts.sort_unstable();
    Gathered { leaves, sky: parts, row }
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

/// Sums what was met over the patches of the cell's cut.
fn summed(
    world: &World,
    settings: &Settings,
    receivers: &[u32],
    gathered: Vec<Gathered>,
    detail: Detail,
) -> CellRows {
    let tree = &world.stage.patches;
    let mut meetings: Vec<Meeting> = Vec::new();
    for (row, gathered) in gathered.iter().enumerate() {
        meetings.extend(gathered.leaves.chunk_by(|a, b| a.0 == b.0).map(|same| Meeting {
            leaf: same[0].0,
            row: row as u32,
            count: same.len() as u32,
            excess: same.iter().map(|(_, sign)| sign).sum(),
        }));
    }
    meetings.sort_unstable_by_key(|meeting| (meeting.leaf, meeting.row));
    let met = Met { tree, meetings: &meetings, rows: receivers.len() };
    let expectation = Expectation::new(tree, world.stage.texel_m);
    let patches = match detail {
        Detail::AsBaked => {
            cut(met, &expectation, settings.patches_max as usize, CUT_SHARE * settings.rank_error)
        }
        Detail::Finest => leaves(tree, &meetings),
    };
    let mut sky_met = vec![false; settings.sky_parts as usize];
    gathered.iter().flat_map(|g| &g.sky).for_each(|&(part, _)| sky_met[part as usize] = true);
    let sky: Vec<u32> = (0..settings.sky_parts).filter(|&part| sky_met[part as usize]).collect();

    let of_patches = patches.iter().map(|&patch| tree.patches[patch as usize].key.0);
    let of_sky = sky.iter().map(|&part| PatchKey::of_sky(part).0);
    let mut keys: Vec<ProbeKey> = of_patches.chain(of_sky).collect();
    keys.sort_unstable();
    let mut table = Table {
        met,
        expectation,
        patches,
        sky,
        scale: std::f32::consts::PI / settings.transport_rays as f32,
        is_weighed: detail == Detail::AsBaked,
        keys,
        rows: Vec::with_capacity(gathered.len()),
    };
    table.begin(gathered);
    table.add_patches();
    CellRows { keys: table.keys, rows: table.rows }
}

/// Rows while they are filled.
struct Table<'a> {
    met: Met<'a>,
    expectation: Expectation<'a>,
    /// Patches of the cut and parts of the sky, ascending.
    patches: Vec<u32>,
    sky: Vec<u32>,
    /// Irradiance of one ray.
    scale: f32,
    is_weighed: bool,
    /// Ascending; those of the sky come last.
    keys: Vec<ProbeKey>,
    rows: Vec<Row>,
}

impl Table<'_> {
    fn column(&self, key: PatchKey) -> usize {
        self.keys.binary_search(&key.0).unwrap_or_default()
    }

    /// Rows with the sky's columns. Weighed columns stand in the order of keys, but that what all patches have in common
    /// follows them, and what all of the sky has, the sky.
    fn begin(&mut self, gathered: Vec<Gathered>) {
        let [of_all, of_part] = Expectation::sky();
        let columns: Vec<usize> = self.sky.iter().map(|&part| self.column(PatchKey::of_sky(part))).collect();
        for gathered in gathered {
            let mut row = Row { alpha: vec![0.0; self.keys.len() + 1], ..gathered.row };
            if self.is_weighed {
                row.weighed = [(); 2].map(|()| vec![0.0; self.keys.len() + 2]);
            }
            for (part, sign) in gathered.sky {
                let Ok(place) = self.sky.binary_search(&part) else { continue };
                row.alpha[columns[place]] += self.scale;
                for (weighed, sign) in row.weighed.iter_mut().zip([1.0, sign as f32]) {
                    if let [.., last] = &mut weighed[..] {
                        *last += of_all * self.scale * sign;
                        weighed[columns[place] + 1] += of_part * self.scale * sign;
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
                .map(|part| (self.column(self.key(part)), self.met.share(part, patch) as f32))
                .collect();
            let parent = self.parent(index);
            let deviation = self.expectation.variance(patch, parent).sqrt() as f32;
            for meeting in self.met.of(patch) {
                let row = &mut self.rows[meeting.row as usize];
                let [seen, excess] = [meeting.count as f32, meeting.excess as f32].map(|n| n * self.scale);
                row.alpha[own] += seen;
                parts.iter().for_each(|&(part, share)| row.alpha[part] -= share * seen);
                if self.is_weighed {
                    for (weighed, value) in row.weighed.iter_mut().zip([seen, excess]) {
                        weighed[own] += deviation * value;
                        if parent.is_none() {
                            weighed[common] += Expectation::common() * value;
                        }
                    }
                }
            }
        }
    }

    fn key(&self, patch: u32) -> PatchKey {
        self.met.tree.patches[patch as usize].key
    }

    /// Parts of a patch of the cut, if they are in it, as all or none are.
    fn parts(&self, index: usize) -> impl Iterator<Item = u32> + '_ {
        let patch = self.patches[index];
        let is_open = self.patches.get(index + 1) == Some(&(patch + 1))
            && self.met.tree.patches[patch as usize].end > patch + 1;
        self.met.tree.parts(patch).take_while(move |_| is_open)
    }

    /// The patch of the cut that a patch of it is part of.
    fn parent(&self, index: usize) -> Option<u32> {
        let patch = self.patches[index];
        // Of those before it whose ends are beyond it, the last.
        self.patches[..index]
            .iter()
            .rev()
            .copied()
            .find(|&other| self.met.tree.patches[other as usize].end > patch)
    }
}
