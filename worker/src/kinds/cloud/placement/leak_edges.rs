//! Leak edges (\[Sukys2014\] §3.2.2): probes before and behind surfaces that part the ends of an edge between probes.
//!
//! Rays go both ways along each edge. Where one meets a surface farther than a tenth of the edge from both ends, and not along it, a probe
//! is added 0.02 of the edge before the hit, or at the nearest point of the lattice that sees this place. Four rounds, each with new
//! tetrahedra. *We differ:* S2 wants d·n > 0, which no front that is met has; we want |d·n| > 0.05.

use std::collections::BTreeSet;

use glam::Vec3;
use lightkiln_proto::kinds::field::ProbeKey;
use rayon::prelude::*;

use super::Ground;
use crate::geometry::Geometry;
use crate::kinds::field::{Survey, Tessellation};
use crate::task::{Cancelled, TaskError};

/// Rounds.
const ROUNDS: u32 = 4;
/// Share of an edge that a hit is from both ends at least.
const ENDS: f32 = 0.1;
/// Least cosine between an edge and a surface's normal.
const ALONG: f32 = 0.05;
/// Share of an edge that a probe stands before the hit.
const BEFORE: f32 = 0.02;

/// Adds probes along edges that leak, until none does or there are too many, and counts them by round.
pub fn added(
    ground: &Ground<'_>,
    survey: &mut Survey,
    tessellation: impl Fn(&Survey) -> Result<Tessellation, TaskError>,
) -> Result<(), TaskError> {
    for round in 1..=ROUNDS {
        let leaks = leaks(ground, survey)?;
        survey.account.push((format!("edges_leaking_{round}"), leaks.edges));
        let room = ground.probes_max.saturating_sub(survey.probes.len());
        let made = leaks.made.into_iter().take(room);
        let before = survey.probes.len();
        survey.probes.extend(made.map(|key| (key.0, [0; 3])));
        let count = survey.probes.len() - before;
        survey.account.push((format!("leak_probes_{round}"), count as u64));
        if count == 0 {
            break;
        }
        survey.probes.sort_unstable();
        survey.tessellation = Some(tessellation(survey)?);
    }
    Ok(())
}

/// Edges that leak, and probes to be added.
struct Leaks {
    edges: u64,
    made: BTreeSet<ProbeKey>,
}

fn leaks(ground: &Ground<'_>, survey: &Survey) -> Result<Leaks, Cancelled> {
    let of_edge = |&[a, b]: &[u32; 2]| {
        ground.progress.check()?;
        let [a_m, b_m] = [a, b].map(|probe| survey.probe(probe as usize).position_m(survey.step_m));
        let found = ground.progress.casting(|| {
            let ways = [place_before(ground.geometry, a_m, b_m), place_before(ground.geometry, b_m, a_m)];
            let made: Vec<ProbeKey> =
                ways.iter().flatten().filter_map(|place_m| ground.snapped(*place_m)).collect();
            (ways.iter().any(Option::is_some), made)
        });
        Ok(found)
    };
    let found: Vec<(bool, Vec<ProbeKey>)> =
        edges(survey).par_iter().map(of_edge).collect::<Result<_, Cancelled>>()?;
    let edges = found.iter().filter(|(leaks, _)| *leaks).count() as u64;
    let is_new = |key: &ProbeKey| survey.probes.binary_search_by_key(&key.0, |probe| probe.0).is_err();
    Ok(Leaks { edges, made: found.into_iter().flat_map(|(_, made)| made).filter(is_new).collect() })
}

/// Edges between probes.
fn edges(survey: &Survey) -> Vec<[u32; 2]> {
    let count = survey.probes.len() as u32;
    let tetrahedra = survey.tessellation.iter().flat_map(|tessellation| &tessellation.tetrahedra);
    let of = |vertices: &[u32; 4]| {
        let [a, b, c, d] = *vertices;
        [[a, b], [a, c], [a, d], [b, c], [b, d], [c, d]].map(|[a, b]| [a.min(b), a.max(b)])
    };
    let mut all: Vec<[u32; 2]> = tetrahedra.flat_map(of).filter(|[_, last]| *last < count).collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// The place before a surface that an edge meets.
fn place_before(geometry: &Geometry, from_m: Vec3, to_m: Vec3) -> Option<Vec3> {
    let length_m = from_m.distance(to_m);
    let way = (to_m - from_m).try_normalize()?;
    let hit = geometry.tracer.closest(from_m, way, length_m)?;
    let is_between = hit.t > ENDS * length_m && hit.t < (1.0 - ENDS) * length_m;
    let is_along = way.dot(geometry.face_normal(hit.triangle)).abs() <= ALONG;
    (is_between && !is_along).then(|| from_m + way * (hit.t - BEFORE * length_m))
}
