//! Spawn and merge (\[Sukys2014\] §3.1.1): probes of a grid, of which near pairs alike become one and near pairs unlike get a third between.
//!
//! A round looks at pairs within 1.5 h in the order of their keys; a pair is merged where its contrast is below 0.1 and it is closer than
//! 0.75 h, and spawns where its contrast is above 0.5. New probes stand half way, on the lattice. *We differ:* S2 looks at any pair, which
//! takes n² contrasts and spawns across the scene.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use glam::IVec3;
use lightkiln_proto::kinds::field::ProbeKey;
use rayon::prelude::*;

use super::contrast::contrast;
use super::light::{Capture, Light};
use super::{Account, Ground};
use crate::task::{Cancelled, Progress};

/// Most rounds.
const ROUNDS: u32 = 8;
/// Contrast below which probes are alike.
const ALIKE: f32 = 0.1;
/// Contrast above which they are unlike.
const UNLIKE: f32 = 0.5;
/// How near probes are that are merged, over the distance between probes.
const MERGED: f32 = 0.75;
/// How near those are that are compared, likewise.
const COMPARED: f32 = 1.5;

/// Probes of a scene from those of a grid, ascending by key, and counts by round.
pub fn probes(
    ground: &Ground<'_>,
    light: &Light<'_>,
    first: &[ProbeKey],
    account: &mut Account,
) -> Result<Vec<ProbeKey>, Cancelled> {
    let mut cloud = Captures::default();
    let captured = |key: ProbeKey| light.at(ground.position_m(key));
    cloud.add(first, captured, ground.progress)?;
    let mean = cloud.mean();
    let mut free: HashMap<ProbeKey, bool> = HashMap::new();
    for round in 1..=ROUNDS {
        let mut may_stand = |key| *free.entry(key).or_insert_with(|| ground.is_free(key));
        let change = change(&cloud, (mean, ground.steps()), &mut may_stand, ground.progress)?;
        account.push((format!("merged_{round}"), change.gone.len() as u64 / 2));
        cloud.probes.retain(|key, _| !change.gone.contains(key));
        let merged: Vec<ProbeKey> = change.merged.into_iter().collect();
        cloud.add(&merged, captured, ground.progress)?;
        let room = ground.probes_max.saturating_sub(cloud.probes.len());
        let spawned = strongest(change.spawned, room);
        cloud.add(&spawned, captured, ground.progress)?;
        account.push((format!("spawned_{round}"), spawned.len() as u64));
        account.push((format!("probes_{round}"), cloud.probes.len() as u64));
        if change.gone.is_empty() && spawned.is_empty() {
            break;
        }
    }
    Ok(cloud.probes.into_keys().collect())
}

/// Probes and the light that they captured.
#[derive(Default)]
struct Captures {
    probes: BTreeMap<ProbeKey, Capture>,
}

impl Captures {
    fn add(
        &mut self,
        keys: &[ProbeKey],
        captured: impl Fn(ProbeKey) -> Capture + Sync,
        progress: &Progress,
    ) -> Result<(), Cancelled> {
        let capture = |&key: &ProbeKey| {
            progress.check()?;
            Ok((key, progress.casting(|| captured(key))))
        };
        let new = keys.par_iter().filter(|key| !self.probes.contains_key(key)).map(capture);
        let new: Vec<(ProbeKey, Capture)> = new.collect::<Result<_, Cancelled>>()?;
        self.probes.extend(new);
        Ok(())
    }

    /// Ē, the mean irradiance of all.
    fn mean(&self) -> f32 {
        let sum: f64 = self.probes.values().map(|capture| f64::from(capture.mean)).sum();
        (sum / self.probes.len().max(1) as f64) as f32
    }
}

/// Changes of a round.
#[derive(Debug, Default, PartialEq)]
struct Change {
    /// Probes that are merged.
    gone: BTreeSet<ProbeKey>,
    /// Their successors.
    merged: BTreeSet<ProbeKey>,
    /// New probes between others, and the contrasts of these.
    spawned: BTreeMap<ProbeKey, f32>,
}

/// Those of greatest contrast, as many as there is room for: S2 ends at a greatest number of probes.
fn strongest(spawned: BTreeMap<ProbeKey, f32>, room: usize) -> Vec<ProbeKey> {
    let mut all: Vec<(ProbeKey, f32)> = spawned.into_iter().collect();
    all.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    all.into_iter().take(room).map(|(key, _)| key).collect()
}

/// Changes of a round among probes, on a lattice of so many steps over the distance between probes. No probe is merged twice in a round,
/// and none that is merged spawns after.
fn change(
    cloud: &Captures,
    (mean, steps): (f32, i32),
    may_stand: &mut impl FnMut(ProbeKey) -> bool,
    progress: &Progress,
) -> Result<Change, Cancelled> {
    let reach = COMPARED * steps as f32;
    let cell_of = |point: IVec3| point.div_euclid(IVec3::splat(reach as i32 + 1));
    let mut by_cell: HashMap<IVec3, Vec<ProbeKey>> = HashMap::new();
    for &key in cloud.probes.keys() {
        by_cell.entry(cell_of(key.point())).or_default().push(key);
    }
    let mut change = Change::default();
    for (&key, own) in &cloud.probes {
        progress.check()?;
        let cell = cell_of(key.point());
        let around = (0..27).map(|by: i32| cell + IVec3::new(by % 3, by / 3 % 3, by / 9) - 1);
        let mut near: Vec<ProbeKey> =
            around.filter_map(|cell| by_cell.get(&cell)).flatten().copied().filter(|of| *of > key).collect();
        near.sort_unstable();
        for other in near {
            let away = (other.point() - key.point()).as_vec3().length();
            if away > reach || change.gone.contains(&key) || change.gone.contains(&other) {
                continue;
            }
            let middle = ProbeKey::of((key.point() + other.point()).div_euclid(IVec3::splat(2)));
            let (Some(middle), Some(capture)) = (middle, cloud.probes.get(&other)) else { continue };
            let contrast = contrast(&own.samples, &capture.samples, mean);
            let is_new = !cloud.probes.contains_key(&middle) && !change.merged.contains(&middle);
            if contrast < ALIKE && away < MERGED * steps as f32 && may_stand(middle) {
                change.gone.extend([key, other]);
                change.merged.insert(middle);
            } else if contrast > UNLIKE && is_new && may_stand(middle) {
                let strongest = change.spawned.entry(middle).or_default();
                *strongest = strongest.max(contrast);
            }
        }
    }
    Ok(change)
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEPS: i32 = 12;

    fn key(x: i32) -> ProbeKey {
        ProbeKey::of(IVec3::new(x, 0, 0)).unwrap()
    }

    /// Probes on a line, of even light.
    fn line(of: &[(i32, f32)]) -> Captures {
        let capture = |light: f32| Capture { samples: [[light; 3]; 26], flow: glam::Vec3::ZERO, mean: light };
        Captures { probes: of.iter().map(|&(x, light)| (key(x), capture(light))).collect() }
    }

    fn changed(of: &[(i32, f32)], shut: &[i32]) -> Change {
        let mut may_stand = |at: ProbeKey| !shut.iter().any(|x| at == key(*x));
        change(&line(of), (1.0, STEPS), &mut may_stand, &Progress::new()).unwrap()
    }

    #[test]
    fn pairs_unlike_spawn_between_and_pairs_alike_are_merged() {
        let found = changed(&[(0, 1.0), (12, 10.0), (40, 1.0), (46, 1.1)], &[]);
        assert_eq!(found.spawned.keys().copied().collect::<Vec<_>>(), [key(6)]);
        assert_eq!(found.merged, [key(43)].into());
        assert_eq!(found.gone, [key(40), key(46)].into());
    }

    #[test]
    fn pairs_in_between_far_apart_or_about_geometry_stay() {
        // Neither alike nor unlike.
        assert_eq!(changed(&[(0, 1.0), (6, 2.0)], &[]), Change::default());
        // Alike, but not near enough; unlike, but too far.
        assert_eq!(changed(&[(0, 1.0), (10, 1.0), (30, 10.0)], &[]), Change::default());
        assert_eq!(changed(&[(0, 1.0), (12, 10.0), (40, 1.0), (46, 1.1)], &[6, 43]), Change::default());
    }

    #[test]
    fn merged_probes_take_no_further_part() {
        let found = changed(&[(0, 1.0), (4, 1.0), (8, 1.0), (14, 9.0)], &[]);
        assert_eq!(found.gone, [key(0), key(4)].into());
        assert_eq!(found.merged, [key(2)].into());
        assert_eq!(found.spawned.keys().copied().collect::<Vec<_>>(), [key(11)]);
    }

    #[test]
    fn the_greatest_contrasts_spawn_where_there_is_little_room() {
        let all = [(key(1), 0.6), (key(2), 0.9), (key(3), 0.9), (key(4), 0.7)];
        assert_eq!(strongest(all.into(), 3), [key(2), key(3), key(4)]);
        assert_eq!(strongest(all.into(), 0), []);
    }
}
