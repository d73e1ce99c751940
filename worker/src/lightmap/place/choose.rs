//! The point that stands for a texel: of candidates that are gathered first, the one of highest score.
//!
//! A texel is a piece of surface, its receiver is one point of it. The point ought to get the light that the visible part
//! of the texel gets, so
//! ```text
//! score = openness · (1 on the surface, 0.3 lifted off it) · (1.5 central, 1 elsewhere)
//! ```
//! - openness: the cosine-weighted mean free path above the point, up to one texel. A point in a crevice, or under a thing
//!   that lies on the texel, is dark where the rest of the texel is lit.
//! - lifted: the point was inside of a thing and was shifted out through its top; the light there is that thing's.
//! - central: the texel's centre, or the middle of the largest coplanar region. Light is interpolated between texels as if
//!   their points were there; another point must be worth that error.
//!
//! Candidates are the central point and, where that scores less than any other could, a grid of points of the same chart in
//! the texel. Those count only if they are open, and, unless the central point is in a crevice, look elsewhere: where a
//! narrow edge has parts that look into a gap and parts that look out of it, the latter are seen.
//! Where even the best lies in a gap much narrower than the texel, others are sought in what triangles have of the texel: the
//! grid may step over a strip.
//!
//! A wall may cut a texel in two, and its central point lie in a thing that stands there: a hollow box or pier. Nobody looks
//! into a hollow, so where that sees nothing but walls close by that are turned away from it, and the part beyond the wall sees farther, the middle of
//! that part stands for the texel.
//!
//! A texel that its chart only touches is stood for by its neighbour's point, unless a wall parts the two: then by the best
//! of its own, if that is open and on its own side of the wall.

use std::borrow::Cow;

use glam::Vec3;
use rayon::prelude::*;

use super::candidate::Candidate;
use super::cover::{Coverage, Spread, TexelPoint, other_points};
use crate::lightmap::Receiver;
use crate::task::Cancelled;
use crate::unwrap::UnwrapBlock;

/// Openness from which on a point is not in a crevice. The foot of a wall that a texel's middle just misses has about this.
const OPEN_MIN: f32 = 0.5;
/// Openness from which on the strip before a hollow's wall is seen, where nothing else of its texel is: the wall hides half.
const OPEN_AT_FOOT_MIN: f32 = 0.4;
/// Openness below which a texel is looked at more closely: a gap no wider than an eighth of a texel.
const BURIED_MAX: f32 = 0.25;
/// Openness that a point needs where the central one is on its surface, if in a crevice. At the mouth of the gap above a
/// lamp half of the gap's light is seen, and pictures show the strip outside of it by the texel's edge.
const OPEN_BESIDE_MIN: f32 = 0.75;
/// Factor on the score of the central point.
const CENTRAL: f32 = 1.5;
/// Factor on the score of a point that was lifted off its surface.
const LIFTED: f32 = 0.3;
/// Share of the highest score from which on points are about as good: beside a lamp that hangs close to a ceiling all of the
/// ceiling's are open, and the first of them would be the brightest.
const ABOUT_AS_GOOD: f32 = 0.9;
/// Highest score of a point elsewhere: beside a plane in the open.
const ELSEWHERE_MAX: f32 = 1.0;
/// Cosine between faces below which one looks elsewhere than the other.
const BENT_COSINE_MAX: f32 = std::f32::consts::FRAC_1_SQRT_2;
/// Share of rays to back faces from which on a point is beyond the walls of the room: the foot of a wall that reaches
/// through the floor.
pub const BEYOND_SHARE_MIN: f32 = 0.125;

/// Most points that are gathered for a texel: a statue has thousands of triangles in one, each with a middle of its own. More →
/// more of the texel is known, more time.
const GATHERED_MAX: usize = 96;

/// Longest mean free path, in texels, of a point in a hollow.
const HOLLOW_MAX: f32 = 32.0;
/// Share of what a point in a hollow sees that is turned away from it at least: the inside of a thing is, the walls of a room are
/// not. At the foot of a wall that a room shares with another, and that faces the other, it is up to 0.67 by chance.
const HOLLOW_AWAY_MIN: f32 = 0.7;
/// Factor by which the part of a texel beyond the wall of a hollow sees farther.
pub const FARTHER: f32 = 1.5;

/// Questions that the choice asks of the scene.
pub trait Site: Sync {
    /// The receiver at the point, wherever that is.
    fn receiver(&self, point: &TexelPoint) -> Receiver;
    /// The point as a candidate; `None` where no receiver can be.
    fn candidate(&self, point: &TexelPoint) -> Option<Candidate>;
    /// Normal of the face that the point lies on.
    fn face_normal(&self, point: &TexelPoint) -> Vec3;
    /// Errors once nobody waits for the choice any more.
    fn check(&self) -> Result<(), Cancelled>;
    /// A wall stands between two receivers.
    fn is_parted(&self, a: &Receiver, b: &Receiver) -> bool;
    /// A wall stands between two receivers, and the first is not merely on the surface's rim, where rounding may put it beyond.
    fn is_beyond(&self, a: &Receiver, b: &Receiver) -> bool;
}

/// Score of a point that is not central; 0 where there is none.
fn score(candidate: Option<&Candidate>) -> f32 {
    candidate.map_or(0.0, |candidate| candidate.openness * if candidate.is_lifted { LIFTED } else { 1.0 })
}

/// The candidate that stands for each covered texel; `None` where none can.
pub fn chosen(
    chart: &UnwrapBlock,
    covered: &[TexelPoint],
    site: &impl Site,
) -> Result<Vec<Option<Candidate>>, Cancelled> {
    let candidate = |point: &TexelPoint| {
        site.check()?;
        Ok(site.candidate(point))
    };
    let mut chosen: Vec<Option<Candidate>> =
        covered.par_iter().map(candidate).collect::<Result<_, Cancelled>>()?;
    // Gather other points only where one of them could have a higher score.
    let is_contested = |index: &usize| {
        let central = chosen[*index].as_ref();
        CENTRAL * score(central) < ELSEWHERE_MAX || central.is_some_and(may_be_cut_by_hollow)
    };
    let contested: Vec<usize> = (0..covered.len()).filter(is_contested).collect();
    choose_among(Spread::OverTexel, &contested, (chart, covered), &mut chosen, site)?;
    // The part of a strip that is seen may lie between the points that were looked at.
    let is_buried = |index: &usize| chosen[*index].as_ref().is_some_and(is_buried);
    let buried: Vec<usize> = contested.into_iter().filter(is_buried).collect();
    choose_among(Spread::OverParts, &buried, (chart, covered), &mut chosen, site)?;
    Ok(chosen)
}

/// The best of the chosen point and others, for some covered texels.
fn choose_among(
    spread: Spread,
    texels: &[usize],
    (chart, covered): (&UnwrapBlock, &[TexelPoint]),
    chosen: &mut [Option<Candidate>],
    site: &impl Site,
) -> Result<(), Cancelled> {
    let wanted: Vec<TexelPoint> = texels.iter().map(|&index| covered[index]).collect();
    let better: Vec<Option<Candidate>> = other_points(chart, &wanted, spread, || site.check())?
        .par_iter()
        .zip(texels)
        .map(|(others, &index)| {
            site.check()?;
            Ok(best(&covered[index], chosen[index], &few(others), site))
        })
        .collect::<Result<_, Cancelled>>()?;
    for (&index, better) in texels.iter().zip(better) {
        chosen[index] = better;
    }
    Ok(())
}

/// The points, or as many as are gathered, evenly among them.
fn few(points: &[TexelPoint]) -> Cow<'_, [TexelPoint]> {
    if points.len() <= GATHERED_MAX {
        return Cow::Borrowed(points);
    }
    let at = |index: usize| points[(2 * index + 1) * points.len() / (2 * GATHERED_MAX)];
    (0..GATHERED_MAX).map(at).collect()
}

/// So deep in a crevice that hardly any light comes there. Points in solids are another matter: what is beside those is often
/// their own inside.
fn is_buried(candidate: &Candidate) -> bool {
    !candidate.is_shifted && candidate.openness < BURIED_MAX
}

/// Walls are close on all sides, and what is seen of them is the inside of a thing.
fn may_be_in_hollow(central: &Candidate) -> bool {
    central.outlook < HOLLOW_MAX && central.away > HOLLOW_AWAY_MIN
}

/// One of the hollow's walls may cut the texel, as it is within a texel.
fn may_be_cut_by_hollow(central: &Candidate) -> bool {
    may_be_in_hollow(central) && central.openness < ELSEWHERE_MAX
}

/// The middle of the texel's points beyond the wall of the hollow that the central one is in.
fn out_of_hollow(
    central: &Candidate,
    others: &[TexelPoint],
    open_min: f32,
    site: &impl Site,
) -> Option<(TexelPoint, Candidate)> {
    let beyond: Vec<(&TexelPoint, Vec3)> = others
        .iter()
        .map(|other| (other, site.receiver(other)))
        .filter(|(_, other)| site.is_beyond(other, &central.receiver))
        .map(|(other, receiver)| (other, receiver.position_m))
        .collect();
    let middle_m = beyond.iter().map(|(_, at_m)| *at_m).sum::<Vec3>() / beyond.len().max(1) as f32;
    let from_middle = |(_, at_m): &(&TexelPoint, Vec3)| at_m.distance_squared(middle_m);
    let (&point, _) = beyond.into_iter().min_by(|a, b| from_middle(a).total_cmp(&from_middle(b)))?;
    let out = site.candidate(&point)?;
    let sees_farther = out.outlook.min(out.far) > FARTHER * central.outlook;
    (is_seen(&out, open_min) && sees_farther).then_some((point, out))
}

/// So open, and on its own side of the walls of the room. A shifted point is beyond a wall in any case.
fn is_seen(own: &Candidate, open_min: f32) -> bool {
    own.openness > open_min && own.back_share < BEYOND_SHARE_MIN && !own.is_shifted
}

/// The candidate of highest score: the central one, or of others that score about as much the one nearest to their middle.
/// Where the central one lies in a thing, as a shelf, those under it may be in the room or in a hollow that bears it: those
/// count that see about as far as any.
fn best(
    point: &TexelPoint,
    central: Option<Candidate>,
    others: &[TexelPoint],
    site: &impl Site,
) -> Option<Candidate> {
    let hollow = central.as_ref().filter(|central| may_be_cut_by_hollow(central));
    if let Some((_, out)) = hollow.and_then(|central| out_of_hollow(central, others, OPEN_MIN, site)) {
        return Some(out);
    }
    let in_crevice = score(central.as_ref()) < OPEN_MIN;
    let own = site.face_normal(point);
    let is_admitted = |other: &&TexelPoint| in_crevice || site.face_normal(other).dot(own) < BENT_COSINE_MAX;
    let is_sound = central.as_ref().is_some_and(|central| !central.is_shifted);
    let least = if is_sound { OPEN_BESIDE_MIN } else { OPEN_MIN }.max(CENTRAL * score(central.as_ref()));
    let found: Vec<Candidate> =
        others.iter().filter(is_admitted).filter_map(|other| site.candidate(other)).collect();
    let highest = found.iter().map(|other| score(Some(other))).fold(0.0, f32::max);
    if highest <= least {
        return central;
    }
    let mut about_as_good: Vec<Candidate> =
        found.into_iter().filter(|other| score(Some(other)) > least.max(ABOUT_AS_GOOD * highest)).collect();
    if !is_sound {
        let farthest = about_as_good.iter().map(|other| other.outlook).fold(0.0, f32::max).min(HOLLOW_MAX);
        about_as_good.retain(|other| FARTHER * other.outlook > farthest);
    }
    let place_m = |candidate: &Candidate| candidate.receiver.position_m;
    let middle_m = about_as_good.iter().map(place_m).sum::<Vec3>() / about_as_good.len() as f32;
    let from_middle = |candidate: &Candidate| place_m(candidate).distance_squared(middle_m);
    about_as_good.into_iter().min_by(|a, b| from_middle(a).total_cmp(&from_middle(b)))
}

/// Points of their own for texels that are touched only, and that a wall parts from the point that stands for them: the
/// bevel of a rail, when all of the rail's texels beside it lie in a hollow pier.
pub fn parted(
    chart: &UnwrapBlock,
    coverage: &Coverage,
    chosen: &[Option<Candidate>],
    site: &impl Site,
) -> Result<Vec<(TexelPoint, Candidate)>, Cancelled> {
    let texels: Vec<Touched> = coverage
        .touched
        .chunk_by(|a, b| a.texel == b.texel)
        .map(|regions| {
            let place = Coverage::place(regions[0].texel, chart.width);
            Touched { regions, neighbour: chosen[coverage.stands_for[place] as usize].as_ref() }
        })
        .collect();
    let own = |touched: &Touched| site.check().map(|()| touched.own(site));
    let mut found: Vec<Option<(TexelPoint, Candidate)>> =
        texels.par_iter().map(own).collect::<Result<_, Cancelled>>()?;
    // The middles of all regions may lie in the hollow too, and a strip of one outside of it.
    let in_hollow: Vec<usize> = (0..texels.len())
        .filter(|&index| found[index].is_none() && texels[index].may_be_in_hollow())
        .collect();
    let wanted: Vec<TexelPoint> = in_hollow.iter().map(|&index| texels[index].regions[0]).collect();
    let outside: Vec<Option<(TexelPoint, Candidate)>> =
        other_points(chart, &wanted, Spread::OverParts, || site.check())?
            .par_iter()
            .zip(&in_hollow)
            .map(|(others, &index)| site.check().map(|()| texels[index].out_of_hollow(&few(others), site)))
            .collect::<Result<_, Cancelled>>()?;
    for (index, outside) in in_hollow.into_iter().zip(outside) {
        found[index] = outside;
    }
    Ok(found.into_iter().flatten().collect())
}

/// A texel that its chart only touches.
struct Touched<'a> {
    /// Middles of its coplanar regions, from the largest to the smallest.
    regions: &'a [TexelPoint],
    /// Candidate that stands for it.
    neighbour: Option<&'a Candidate>,
}

impl Touched<'_> {
    /// The neighbour's walls may be more than a texel away from its point.
    fn may_be_in_hollow(&self) -> bool {
        self.neighbour.is_some_and(may_be_in_hollow)
    }

    /// The best of the regions' middles that a wall parts from the neighbour.
    fn own(&self, site: &impl Site) -> Option<(TexelPoint, Candidate)> {
        let is_admitted = |own: &Candidate| {
            is_seen(own, OPEN_MIN)
                && self.neighbour.is_none_or(|other| site.is_parted(&own.receiver, &other.receiver))
        };
        self.regions
            .iter()
            .filter_map(|&point| Some((point, site.candidate(&point).filter(is_admitted)?)))
            .reduce(|best, next| if score(Some(&next.1)) > score(Some(&best.1)) { next } else { best })
    }

    /// The middle of the points beyond the wall of the hollow that the neighbour is in.
    fn out_of_hollow(&self, points: &[TexelPoint], site: &impl Site) -> Option<(TexelPoint, Candidate)> {
        out_of_hollow(self.neighbour?, points, OPEN_AT_FOOT_MIN, site)
    }
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::content::{AreaCode, TexelEdge};

    use super::*;

    /// Triangle 0 lies in a shelf, 1 in the hollow under it, 2 in the room; so much of what is seen from these is turned away.
    struct Shelf {
        away: f32,
    }

    impl Site for Shelf {
        fn receiver(&self, point: &TexelPoint) -> Receiver {
            Receiver {
                block: 0,
                texel: point.texel,
                position_m: Vec3::from(point.weights),
                normal: Vec3::Y,
                face_normal: Vec3::Y,
                albedo: [0.5; 3],
                emission: [0.0; 3],
                links: 0,
                coverage: 0,
                fine: 0,
                edge: TexelEdge::NONE,
                area: AreaCode::ONE,
                light_of: 0,
            }
        }

        fn candidate(&self, point: &TexelPoint) -> Option<Candidate> {
            let outlook = [None, Some(3.0), Some(100.0)][point.triangle as usize]?;
            let receiver = self.receiver(point);
            Some(Candidate {
                receiver,
                openness: 0.9,
                back_share: 0.0,
                outlook,
                far: outlook,
                away: self.away,
                is_shifted: false,
                is_lifted: false,
            })
        }

        fn face_normal(&self, _: &TexelPoint) -> Vec3 {
            Vec3::Y
        }

        fn check(&self) -> Result<(), Cancelled> {
            Ok(())
        }

        fn is_parted(&self, _: &Receiver, _: &Receiver) -> bool {
            true
        }

        fn is_beyond(&self, _: &Receiver, _: &Receiver) -> bool {
            true
        }
    }

    #[test]
    fn of_thousands_of_points_a_few_are_gathered_evenly_and_of_few_all() {
        let points = |count: u32| -> Vec<TexelPoint> {
            (0..count)
                .map(|triangle| TexelPoint { texel: [0, 0], triangle, weights: [1.0, 0.0, 0.0] })
                .collect()
        };
        assert_eq!(few(&points(GATHERED_MAX as u32)).as_ref(), points(GATHERED_MAX as u32));
        let gathered: Vec<u32> = few(&points(96_000)).iter().map(|point| point.triangle).collect();
        assert_eq!(gathered.len(), GATHERED_MAX);
        assert_eq!(gathered[0], 500);
        assert!(gathered.windows(2).all(|pair| pair[1] - pair[0] == 1000), "{gathered:?}");
    }

    #[test]
    fn points_in_a_room_stand_for_a_texel_rather_than_those_in_a_hollow() {
        let point =
            |triangle: u32, x: f32| TexelPoint { texel: [0, 0], triangle, weights: [x, 0.5, 0.5 - x] };
        // Those in the hollow are nearer to the middle of all.
        let others = [point(1, 0.2), point(1, 0.25), point(1, 0.3), point(2, 0.45), point(2, 0.5)];
        let shelf = Shelf { away: 0.0 };
        let found = best(&point(0, 0.3), None, &others, &shelf).unwrap();
        assert!(found.receiver.position_m.x > 0.4, "{found:?}");
        // Where there is no room to be seen, the hollow has its own light.
        let found = best(&point(0, 0.3), None, &others[..3], &shelf).unwrap();
        assert_eq!(found.receiver.position_m.x, 0.25);
    }

    #[test]
    fn middle_of_a_texel_is_in_a_hollow_if_what_it_sees_is_the_inside_of_a_thing() {
        let point =
            |triangle: u32, x: f32| TexelPoint { texel: [0, 0], triangle, weights: [x, 0.5, 0.5 - x] };
        let (middle, beyond) = (point(1, 0.3), [point(2, 0.45)]);
        for (away, wanted) in [(1.0, 0.45), (0.0, 0.3), (0.6, 0.3)] {
            let shelf = Shelf { away };
            let found = best(&middle, shelf.candidate(&middle), &beyond, &shelf).unwrap();
            assert_eq!(found.receiver.position_m.x, wanted, "{away} turned away");
        }
    }
}
