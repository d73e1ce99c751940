//! Gradient ascent (\[Sukys2014\] §3.1.2, \[Chajdas2011\]): probes of a grid that go where light comes from, up to the surfaces that reflect it.
//!
//! A probe steps h/4 along the first band of its light, and half as far each time that a step would end in darkness or behind a wall, until
//! h/64 or 32 rounds. Those in darkness from the start stay, one of 16 in the mean, as k-means picks them. *We differ:* S2 takes the band's
//! sum over 26 directions for the gradient of irradiance, which it is not; its second order is this halving.

use glam::Vec3;
use lightkiln_proto::kinds::field::ProbeKey;
use rayon::prelude::*;

use super::light::{Capture, Light};
use super::{Account, CLEARANCE, Ground};
use crate::kinds::field::is_free;
use crate::task::{Cancelled, Progress};

/// Most rounds.
const ROUNDS: usize = 32;
/// First step over the distance between probes.
const STEP: f32 = 0.25;
/// Least step, likewise.
const STEP_MIN: f32 = 1.0 / 64.0;
/// Light over its mean below which a place is dark.
const DARK: f32 = 1e-3;
/// Dark probes of which one stays.
const DARK_SHARE: usize = 16;
/// Rounds of k-means.
const MEANS_ROUNDS: u32 = 32;

/// Probes of a scene from those of a grid, ascending by key, and counts by round.
pub fn probes(
    ground: &Ground<'_>,
    light: &Light<'_>,
    first: &[ProbeKey],
    account: &mut Account,
) -> Result<Vec<ProbeKey>, Cancelled> {
    let Ground { geometry, progress, .. } = ground;
    let capture = |&key: &ProbeKey| {
        progress.check()?;
        let at_m = ground.position_m(key);
        Ok((at_m, key, progress.casting(|| light.at(at_m))))
    };
    let captures: Vec<(Vec3, ProbeKey, Capture)> =
        first.par_iter().map(capture).collect::<Result<_, Cancelled>>()?;
    let sum: f64 = captures.iter().map(|(.., capture)| f64::from(capture.mean)).sum();
    let darkest = DARK * (sum / captures.len().max(1) as f64) as f32;
    let (lit, dark): (Vec<_>, Vec<_>) =
        captures.into_iter().partition(|(.., capture)| capture.mean > darkest);
    let may_go = |from_m: Vec3, to_m: Vec3| {
        ground.volume.holds(to_m)
            && !geometry.tracer.is_occluded(from_m, to_m)
            && is_free(geometry, to_m, CLEARANCE * ground.spacing_m)
    };
    let climb = |(at_m, key, capture): (Vec3, ProbeKey, Capture)| {
        let end = progress.casting(|| {
            let captured = |at_m: Vec3| light.at(at_m);
            let end = ascent((at_m, capture), (ground.spacing_m, darkest), captured, may_go, progress)?;
            let stands = ground.snapped(end.at_m).unwrap_or(key);
            Ok::<_, Cancelled>((stands, end.moves))
        })?;
        Ok(end)
    };
    let ends: Vec<(ProbeKey, Vec<bool>)> =
        lit.into_par_iter().map(climb).collect::<Result<_, Cancelled>>()?;
    for round in 0..ROUNDS {
        let moved = ends.iter().filter(|(_, moves)| moves.get(round) == Some(&true)).count() as u64;
        account.push((format!("moved_{}", round + 1), moved));
    }
    let dark: Vec<(Vec3, ProbeKey)> = dark.into_iter().map(|(at_m, key, _)| (at_m, key)).collect();
    let stays = means(&dark, progress)?;
    let mut keys: Vec<ProbeKey> = ends.into_iter().map(|(key, _)| key).chain(stays.iter().copied()).collect();
    keys.sort_unstable();
    let climbed = keys.len();
    keys.dedup();
    let counts =
        [("probes_dark", dark.len()), ("probes_dark_kept", stays.len()), ("met", climbed - keys.len())];
    account.extend(counts.map(|(name, count)| (name.to_owned(), count as u64)));
    Ok(keys)
}

/// End of an ascent.
#[derive(Debug, PartialEq)]
struct End {
    at_m: Vec3,
    /// Whether each round moved it.
    moves: Vec<bool>,
}

/// Ascent of a probe from a place with its light, by the distance between probes and the light of a dark place.
fn ascent(
    (mut at_m, mut capture): (Vec3, Capture),
    (spacing_m, darkest): (f32, f32),
    captured: impl Fn(Vec3) -> Capture,
    may_go: impl Fn(Vec3, Vec3) -> bool,
    progress: &Progress,
) -> Result<End, Cancelled> {
    let mut moves = Vec::new();
    let mut step_m = STEP * spacing_m;
    while moves.len() < ROUNDS && step_m >= STEP_MIN * spacing_m {
        progress.check()?;
        let Some(way) = capture.flow.try_normalize() else { break };
        let to_m = at_m + way * step_m;
        let there = may_go(at_m, to_m).then(|| captured(to_m)).filter(|there| there.mean > darkest);
        moves.push(there.is_some());
        match there {
            Some(there) => (at_m, capture) = (to_m, there),
            None => step_m *= 0.5,
        }
    }
    Ok(End { at_m, moves })
}

/// Places that stand for those in darkness: k-means, k = ⌈n/16⌉, from the first place and then the farthest from those before; of each
/// mean, the place nearest to it.
fn means(dark: &[(Vec3, ProbeKey)], progress: &Progress) -> Result<Vec<ProbeKey>, Cancelled> {
    let count = dark.len().div_ceil(DARK_SHARE);
    let Some(&(first_m, _)) = dark.first() else { return Ok(Vec::new()) };
    let mut means_m = vec![first_m];
    let mut away_m2: Vec<f32> = dark.iter().map(|(at_m, _)| at_m.distance_squared(first_m)).collect();
    while means_m.len() < count {
        progress.check()?;
        let (farthest, _) =
            (0..).zip(&away_m2).fold(
                (0, -1.0),
                |best: (usize, f32), (index, away)| {
                    if *away > best.1 { (index, *away) } else { best }
                },
            );
        means_m.push(dark[farthest].0);
        for (away, (at_m, _)) in away_m2.iter_mut().zip(dark) {
            *away = away.min(at_m.distance_squared(dark[farthest].0));
        }
    }
    let nearest_to = |at_m: Vec3, all: &mut dyn Iterator<Item = Vec3>| {
        all.enumerate().fold((0, f32::INFINITY), |best: (usize, f32), (index, other_m)| {
            let away = at_m.distance_squared(other_m);
            if away < best.1 { (index, away) } else { best }
        })
    };
    let mut of: Vec<usize> = Vec::new();
    for _ in 0..MEANS_ROUNDS {
        progress.check()?;
        let now: Vec<usize> =
            dark.par_iter().map(|(at_m, _)| nearest_to(*at_m, &mut means_m.iter().copied()).0).collect();
        if now == of {
            break;
        }
        of = now;
        let mut sums = vec![(glam::DVec3::ZERO, 0.0); means_m.len()];
        for (&mean, (at_m, _)) in of.iter().zip(dark) {
            sums[mean].0 += at_m.as_dvec3();
            sums[mean].1 += 1.0;
        }
        for (mean_m, (sum, count)) in means_m.iter_mut().zip(sums) {
            if count > 0.0 {
                *mean_m = (sum / count).as_vec3();
            }
        }
    }
    let stays = |mean_m: &Vec3| dark[nearest_to(*mean_m, &mut dark.iter().map(|(at_m, _)| *at_m)).0].1;
    Ok(means_m.iter().map(stays).collect())
}

#[cfg(test)]
mod tests {
    use glam::IVec3;

    use super::*;

    fn lit(flow: Vec3, mean: f32) -> Capture {
        Capture { samples: [[mean; 3]; 26], flow, mean }
    }

    #[test]
    fn probes_climb_to_a_wall_and_stop_before_it() {
        let wall = |_: Vec3, to_m: Vec3| to_m.x < 1.6;
        let start = (Vec3::ZERO, lit(Vec3::X, 1.0));
        let end = ascent(start, (1.0, 0.1), |_| lit(Vec3::X, 1.0), wall, &Progress::new()).unwrap();
        // Six whole steps, then ever shorter ones: within the least of the wall.
        assert!(end.at_m.x < 1.6 && end.at_m.x > 1.6 - 2.0 * STEP_MIN, "{end:?}");
        assert!(end.moves[..6].iter().all(|moved| *moved) && !end.moves[6]);
    }

    #[test]
    fn darkness_turns_probes_back_and_32_rounds_end() {
        let captured = |at_m: Vec3| lit(Vec3::Y, if at_m.y < 0.9 { 1.0 } else { 0.0 });
        let start = (Vec3::ZERO, lit(Vec3::Y, 1.0));
        let end = ascent(start, (1.0, 0.1), captured, |_, _| true, &Progress::new()).unwrap();
        assert!(end.at_m.y < 0.9 && end.at_m.y > 0.9 - 2.0 * STEP_MIN, "{end:?}");
        let start = (Vec3::ZERO, lit(Vec3::Y, 1.0));
        let end = ascent(start, (1.0, 0.1), |_| lit(Vec3::Y, 1.0), |_, _| true, &Progress::new()).unwrap();
        assert_eq!((end.moves.len(), end.at_m), (ROUNDS, Vec3::Y * 8.0));
    }

    #[test]
    fn one_of_sixteen_dark_probes_stays_in_each_dark_room() {
        let place = |room: i32, index: i32| {
            let point = IVec3::new(1000 * room + index % 4, index / 4, 0);
            (point.as_vec3(), ProbeKey::of(point).unwrap())
        };
        let dark: Vec<_> = (0..3).flat_map(|room| (0..16).map(move |index| place(room, index))).collect();
        let stays = means(&dark, &Progress::new()).unwrap();
        let rooms: Vec<i32> = stays.iter().map(|key| key.point().x / 1000).collect();
        let mut sorted = rooms.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, [0, 1, 2]);
        // Each from the middle of its room.
        assert!(stays.iter().all(|key| (1..3).contains(&(key.point().x % 1000))), "{stays:?}");
        assert!(means(&[], &Progress::new()).unwrap().is_empty());
    }
}
