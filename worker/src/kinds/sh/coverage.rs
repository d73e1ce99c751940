//! Coverage: probes are added where receivers' hits are seen by no supporting probe (METHOD.md §2).
//!
//! Sampled receivers cast rays; each hit that no supporting probe sees votes for the lattice cells around the middle
//! of its ray, from where both ends are seen. Cells with more votes than their neighbours get a probe.

use std::collections::BTreeMap;

use glam::{IVec3, Vec3};
use lightkiln_proto::kinds::sh::{Probe, ProbeSettings};
use rayon::prelude::*;

use super::candidates::{Candidate, candidate_at};
use super::radius::{is_sampled, set_radii};
use super::supporters::{Supporter, Supporters};
use crate::geometry::lattice::cell_of;
use crate::lightmap::{Receiver, Surface, World};
use crate::rays::sampling::{R2, cosine_hemisphere, tangent_frame};
use crate::task::{Cancelled, Progress, TaskError};
use crate::transport::DEAD_PATH_TEXELS;

/// Rays per sampled receiver.
const RAYS: u32 = 32;
/// Rounds of adding at most.
const ROUNDS: usize = 6;
/// Candidate lattice of added probes, as a share of the spacing.
const STEP_SHARE: f32 = 0.25;
/// Votes below this share of a receiver's rays are noise.
const VOTES_MIN: u32 = 4;

/// An uncovered ray: from a receiver to its hit.
struct Unseen {
    from_m: Vec3,
    to_m: Vec3,
}

/// `placed` with radii, and with probes added until the uncovered share of sampled rays is at most `uncovered_max`,
/// or `probes_added_max` is reached.
pub fn complete(
    world: &World,
    settings: &ProbeSettings,
    spacing_m: f32,
    placed: Vec<Probe>,
    progress: &Progress,
) -> Result<Vec<Probe>, TaskError> {
    let mut probes = placed;
    let most = probes.len() + (probes.len() as f32 * settings.probes_added_max) as usize + 1;
    set_radii(&mut probes, &world.lightmap.receivers, settings.n_overlaps, spacing_m, progress)?;
    for _ in 0..ROUNDS {
        progress.check()?;
        let (unseen, share) = unseen_rays(world, &probes, progress)?;
        if share <= settings.uncovered_max || probes.len() >= most {
            break;
        }
        let added = elected(world, settings, spacing_m, &unseen, &probes, progress);
        progress.check()?;
        if added.is_empty() {
            break;
        }
        let room = most - probes.len();
        probes.extend(added.into_iter().take(room).map(|candidate| Probe {
            key: candidate.key,
            position_m: candidate.position_m.to_array(),
            radius_m: 0.0,
        }));
        probes.sort_by_key(|probe| probe.key);
        probes.dedup_by_key(|probe| probe.key);
        set_radii(&mut probes, &world.lightmap.receivers, settings.n_overlaps, spacing_m, progress)?;
    }
    if probes.windows(2).any(|pair| pair[0].key == pair[1].key) {
        return Err(TaskError::bad_input(
            "two probes have the same identity: change probe_spacing_m a little",
        ));
    }
    Ok(probes)
}

/// Rays of sampled receivers whose hit no supporting probe sees, and their share of all along which light can come.
fn unseen_rays(
    world: &World,
    probes: &[Probe],
    progress: &Progress,
) -> Result<(Vec<Unseen>, f32), Cancelled> {
    let supporters = Supporters::new(probes);
    let asked: Vec<&Receiver> =
        world.lightmap.receivers.iter().filter(|receiver| is_sampled(receiver)).collect();
    let unseen_of = |receiver: &&Receiver| {
        progress.check()?;
        Ok(progress.casting(|| unseen_from(world, &supporters, receiver)))
    };
    let found: Vec<(Vec<Unseen>, u32)> = asked.par_iter().map(unseen_of).collect::<Result<_, Cancelled>>()?;
    let lit: u64 = found.iter().map(|(_, lit)| u64::from(*lit)).sum();
    let unseen: Vec<Unseen> = found.into_iter().flat_map(|(unseen, _)| unseen).collect();
    let share = unseen.len() as f32 / lit.max(1) as f32;
    Ok((unseen, share))
}

fn unseen_from(world: &World, supporters: &Supporters, receiver: &Receiver) -> (Vec<Unseen>, u32) {
    let points = R2::new(world.lightmap.seed_of(receiver, 2));
    let (tangent, bitangent) = tangent_frame(receiver.face_normal);
    let tracer = &world.geometry.tracer;
    let offset_m = tracer.ray_offset_m(receiver.position_m);
    let origin_m = receiver.position_m + receiver.face_normal * offset_m;
    let around: Vec<Supporter> = supporters.around(receiver.position_m);
    let (mut unseen, mut lit) = (Vec::new(), 0);
    let (mut open, mut path_m) = (false, 0.0);
    for ray in 0..RAYS {
        let local = cosine_hemisphere(points.point(ray));
        let direction = tangent * local.x + bitangent * local.y + receiver.face_normal * local.z;
        let Some(hit) = world.geometry.tracer.met(origin_m, direction, f32::INFINITY) else {
            (open, lit) = (true, lit + 1);
            continue;
        };
        path_m += hit.t;
        if world.surface_at(&hit) == Surface::Dark {
            continue;
        }
        lit += 1;
        let normal = world.geometry.side_normal(&hit);
        let met_m = origin_m + direction * hit.t;
        let point_m = met_m + normal * tracer.ray_offset_m(met_m);
        let seen = around.iter().any(|supporter| {
            (supporter.position_m - point_m).dot(normal) > 0.0
                && !world.geometry.tracer.is_occluded(point_m, supporter.position_m)
        });
        open |= seen;
        if !seen {
            unseen.push(Unseen { from_m: origin_m, to_m: point_m });
        }
    }
    // Nothing shines in a cavity: it is left alone.
    if !open && path_m / (RAYS as f32) < world.lightmap.texel_m * DEAD_PATH_TEXELS {
        return (Vec::new(), 0);
    }
    (unseen, lit)
}

/// New probes: cells whose votes are a maximum among their neighbours and where a probe can stand, most votes first.
fn elected(
    world: &World,
    settings: &ProbeSettings,
    spacing_m: f32,
    unseen: &[Unseen],
    probes: &[Probe],
    progress: &Progress,
) -> Vec<Candidate> {
    let step_m = spacing_m * STEP_SHARE;
    let mut votes: BTreeMap<[i32; 3], u32> = BTreeMap::new();
    for ray in unseen {
        // Near the receiver, so that the new probe supports it, yet far enough along to see the hit.
        let length_m = ray.from_m.distance(ray.to_m);
        let share = (0.5_f32).min(spacing_m * 0.75 / length_m.max(f32::MIN_POSITIVE));
        *votes.entry(cell_of(ray.from_m.lerp(ray.to_m, share), step_m).to_array()).or_default() += 1;
    }
    let stands = |cell: &[i32; 3], count: &u32| {
        let found = candidate_at(world, IVec3::from_array(*cell), step_m, settings.probe_back_face_max)?;
        let is_near = |probe: &Probe| {
            let position_m = Vec3::from_array(probe.position_m);
            position_m.distance(found.position_m) < step_m
                && !world.geometry.tracer.is_occluded(position_m, found.position_m)
        };
        (!probes.iter().any(is_near)).then_some((*cell, (*count, found)))
    };
    let standing: BTreeMap<[i32; 3], (u32, Candidate)> = votes
        .par_iter()
        .filter(|(_, count)| **count >= VOTES_MIN)
        // Whoever asked gives up next.
        .filter(|_| !progress.is_cancelled())
        .filter_map(|(cell, count)| progress.casting(|| stands(cell, count)))
        .collect();
    let is_peak = |cell: IVec3, count: u32| {
        (0..27).all(|index| {
            let near = (cell + IVec3::new(index % 3 - 1, index / 3 % 3 - 1, index / 9 - 1)).to_array();
            let other = standing.get(&near).map_or(0, |(count, _)| *count);
            other < count || (other == count && near >= cell.to_array())
        })
    };
    let mut peaks: Vec<(u32, Candidate)> = standing
        .iter()
        .filter(|(cell, (count, _))| is_peak(IVec3::from_array(**cell), *count))
        .map(|(_, peak)| *peak)
        .collect();
    peaks.sort_by_key(|(count, candidate)| (std::cmp::Reverse(*count), candidate.key));
    peaks.into_iter().map(|(_, candidate)| candidate).collect()
}
