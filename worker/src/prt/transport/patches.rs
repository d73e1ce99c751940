//! Rows of the transport matrix over surface patches: `α_rs = π/N · (how many of N cosine-distributed rays from r meet
//! patch s)`, for the patches of a cut through the tree that suits the cell.

use glam::Vec3;
use lightkiln_proto::prt::{PatchKey, ProbeKey, Settings};
use lightkiln_proto::sh::relight_direction;
use rayon::prelude::*;

use super::alpha::Row;
use super::cut::{Meeting, cut, leaves};
use super::hemisphere::Hemisphere;
use super::{CellRows, Detail};
use crate::prt::world::{Surface, World};
use crate::task::{Cancelled, Progress};

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
    let mut sign = -1;
    let (emitters, mean_path_m, rays_occlusion) = hemisphere.cast(settings.emitter_rays, |direction, hit| {
        sign = -sign;
        let Some(hit) = hit else {
            row.lit += 1.0;
            parts.push((nearest(sky, direction), sign));
            return;
        };
        let point_m = hemisphere.origin_m + direction * hit.t;
        let Surface::Receiver(met) = world.linked_surface_at(hit, point_m) else { return };
        let albedo = world.stage.receivers[met as usize].albedo;
        row.lit += (albedo[0] + albedo[1] + albedo[2]) / 3.0;
        leaves.push((world.stage.patches.leaf_of_receiver[met as usize], sign));
    });
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
    let positions_m: Vec<Vec3> =
        receivers.iter().map(|&receiver| world.stage.receivers[receiver as usize].position_m).collect();
    let patches = match detail {
        Detail::AsBaked => cut(tree, &meetings, &positions_m, settings.patches_max as usize),
        Detail::Finest => leaves(tree, &meetings),
    };
    let mut sky_met = vec![false; settings.sky_parts as usize];
    gathered.iter().flat_map(|g| &g.sky).for_each(|&(part, _)| sky_met[part as usize] = true);

    let sky_parts = (0..settings.sky_parts).filter(|&part| sky_met[part as usize]);
    let of_patches = patches.iter().map(|&patch| tree.patches[patch as usize].key.0);
    let mut keys: Vec<ProbeKey> = of_patches.chain(sky_parts.map(|part| PatchKey::of_sky(part).0)).collect();
    keys.sort_unstable();
    let column = |key: PatchKey| keys.binary_search(&key.0).ok();
    let scale = std::f32::consts::PI / settings.transport_rays as f32;
    let mut rows: Vec<Row> = Vec::with_capacity(gathered.len());
    for gathered in gathered {
        let [mut alpha, mut noise] = [(); 2].map(|()| vec![0.0; keys.len() + 1]);
        for (part, sign) in gathered.sky {
            if let Some(column) = column(PatchKey::of_sky(part)) {
                alpha[column] += scale;
                noise[column] += scale * sign as f32;
            }
        }
        rows.push(Row { alpha, noise, ..gathered.row });
    }
    for patch in patches.iter().map(|&patch| &tree.patches[patch as usize]) {
        let Some(column) = column(patch.key) else { continue };
        let start = meetings.partition_point(|meeting| meeting.leaf < patch.first_leaf);
        let end = meetings.partition_point(|meeting| meeting.leaf < patch.first_leaf + patch.leaf_count);
        for meeting in &meetings[start..end] {
            let row = &mut rows[meeting.row as usize];
            row.alpha[column] += meeting.count as f32 * scale;
            row.noise[column] += meeting.excess as f32 * scale;
        }
    }
    CellRows { keys, rows }
}
