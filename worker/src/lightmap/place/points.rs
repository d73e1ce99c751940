//! Step "points": which of a texel's 4 × 4 points lie on its receiver's own side of every wall, see `Receivers::coverage`.
//!
//! Those that see the receiver's point, both raised as for links, and those that see one of these beside them: so a
//! surface may bend, but no wall is crossed.
//!
//! Where some do not, the receiver moves to the one of its points that is nearest to their middle: beside a wall, or the
//! mouth of a gap, a texel's centre may have light of millimetres of it alone. And the foot of the wall is found, along which
//! a straight edge is laid, see `Receivers::edge`; where it is not straight, such that none of the receiver's side is beyond.

use std::sync::Arc;

use glam::{Vec2, Vec3};
use lightkiln_proto::content::{COVERAGE_POINTS, COVERAGE_SIDE, TexelEdge};
use rayon::prelude::*;

use crate::geometry::{Geometry, Site};
use crate::lightmap::{Charts, Lightmap, World};
use crate::task::Progress;

/// Points along each side of the finer grid.
const FINE_SIDE: u32 = 12;
/// Halvings of the distance between two of its points that tell where a wall stands.
const BISECTIONS: u32 = 5;
/// Distance in texels by which points may lie off a straight edge.
const STRAIGHT: f32 = 0.02;
/// Points of the coverage that are asked whether they see a place.
const NEAREST: usize = 3;
/// Directions that edges may have; of equally good ones the first is taken.
const TURNS: u32 = 256;

/// The lightmap with the points of every receiver's texel.
pub fn covered(
    geometry: &Arc<Geometry>,
    charts: &Charts,
    lightmap: Lightmap,
    progress: &Progress,
) -> Lightmap {
    let world = World::new(Arc::clone(geometry), charts, lightmap);
    let receivers = 0..world.lightmap.receivers.len() as u32;
    let found: Vec<Found> = receivers.into_par_iter().map(|index| Found::of(&world, index)).collect();
    progress.add_rays_occlusion(found.iter().map(|found| found.rays).sum());
    let mut lightmap = world.into_lightmap();
    for (receiver, found) in lightmap.receivers.iter_mut().zip(found) {
        (receiver.coverage, receiver.edge) = (found.coverage, found.edge);
        if let Some(Site { position_m, normal, face_normal }) = found.moved {
            (receiver.position_m, receiver.normal, receiver.face_normal) = (position_m, normal, face_normal);
        }
    }
    lightmap
}

/// Findings about a receiver's texel.
#[derive(Default)]
struct Found {
    coverage: u16,
    edge: TexelEdge,
    /// Where the receiver moves.
    moved: Option<Site>,
    /// Raised points of the coverage, by bit; of others too.
    raised_m: [Option<Vec3>; COVERAGE_POINTS as usize],
    rays: u64,
}

impl Found {
    fn of(world: &World, receiver: u32) -> Self {
        let mut found = Self::default();
        for (bit, site) in world.points_of(receiver) {
            found.raised_m[bit as usize] = Some(raised(world, &site));
        }
        found.cover(world, world.raised_receiver(receiver));
        if found.coverage == 0 {
            return found;
        }
        let is_parted = |bit: usize| found.raised_m[bit].is_some() && found.coverage & 1 << bit == 0;
        if (0..COVERAGE_POINTS as usize).any(is_parted) {
            found.moved = found.middle(world, receiver);
        }
        // A straight wall has a corner of the texel beyond it, however thin the strip there.
        let corners = [0, FINE_SIDE - 1, FINE_SIDE * (FINE_SIDE - 1), FINE_SIDE * FINE_SIDE - 1];
        let is_cut = found.moved.is_some()
            || corners.into_iter().any(|at| found.is_own(world, receiver, fine_place(at)) == Some(false));
        if is_cut {
            found.edge = found.fitted(world, receiver);
        }
        found
    }

    /// The point of the coverage that is nearest to the middle of all.
    fn middle(&self, world: &World, receiver: u32) -> Option<Site> {
        let is_covered = |(bit, _): &(u32, Site)| self.coverage >> bit & 1 == 1;
        let covered: Vec<Site> = world.points_of(receiver).filter(is_covered).map(|(_, site)| site).collect();
        let middle_m = covered.iter().map(|site| site.position_m).sum::<Vec3>() / covered.len() as f32;
        let from_middle = |site: &Site| site.position_m.distance_squared(middle_m);
        covered.into_iter().min_by(|a, b| from_middle(a).total_cmp(&from_middle(b)))
    }

    /// Points that see the receiver's, then those that see one of these beside them.
    fn cover(&mut self, world: &World, own_m: Vec3) {
        let mut open: Vec<usize> = Vec::new();
        for bit in 0..COVERAGE_POINTS as usize {
            self.add(world, own_m, bit, &mut open);
        }
        while let Some(bit) = open.pop() {
            let Some(from_m) = self.raised_m[bit] else { continue };
            beside(bit).for_each(|beside| self.add(world, from_m, beside, &mut open));
        }
    }

    fn add(&mut self, world: &World, from_m: Vec3, bit: usize, open: &mut Vec<usize>) {
        let Some(at_m) = self.raised_m[bit] else { return };
        if self.coverage & 1 << bit != 0 {
            return;
        }
        self.rays += 1;
        if world.is_linked(from_m, at_m) {
            self.coverage |= 1 << bit;
            open.push(bit);
        }
    }

    /// The edge before what is beyond a wall in a texel that has some of it.
    fn fitted(&mut self, world: &World, receiver: u32) -> TexelEdge {
        let count = FINE_SIDE * FINE_SIDE;
        let side: Vec<Option<bool>> =
            (0..count).map(|index| self.is_own(world, receiver, fine_place(index))).collect();
        let places = |own: bool| -> Vec<Vec2> {
            let found = (0..count).filter(|&index| side[index as usize] == Some(own));
            found.map(|index| fine_place(index) - 0.5).collect()
        };
        let (own, beyond) = (places(true), places(false));
        let mut foot = Vec::new();
        for index in 0..count {
            let right = ((index + 1) % FINE_SIDE != 0).then_some(index + 1);
            let below = (index + FINE_SIDE < count).then_some(index + FINE_SIDE);
            for next in [right, below].into_iter().flatten() {
                let [a, b] = [index, next].map(fine_place);
                match [side[index as usize], side[next as usize]] {
                    [Some(true), Some(false)] => foot.push(self.foot(world, receiver, a, b) - 0.5),
                    [Some(false), Some(true)] => foot.push(self.foot(world, receiver, b, a) - 0.5),
                    _ => {}
                }
            }
        }
        edge_along(&foot, &own).unwrap_or_else(|| edge_before(&[own, foot].concat(), &beyond))
    }

    /// Whether a place of the texel is on the receiver's side; `None` where there is no surface.
    fn is_own(&mut self, world: &World, receiver: u32, at: Vec2) -> Option<bool> {
        let site = world.point_of(receiver, at)?;
        let at_m = raised(world, &site);
        Some(self.sees(world, at, at_m))
    }

    /// Where a wall stands between a place of the receiver's side and one beyond.
    fn foot(&mut self, world: &World, receiver: u32, own: Vec2, beyond: Vec2) -> Vec2 {
        let (mut own, mut beyond) = (own, beyond);
        for _ in 0..BISECTIONS {
            let middle = own.midpoint(beyond);
            match self.is_own(world, receiver, middle) {
                Some(true) => own = middle,
                Some(false) | None => beyond = middle,
            }
        }
        own.midpoint(beyond)
    }

    /// A place is on the receiver's side: one of the nearest points of the coverage sees it.
    fn sees(&mut self, world: &World, at: Vec2, at_m: Vec3) -> bool {
        let covered = (0..COVERAGE_POINTS as usize).filter(|&bit| self.coverage & 1 << bit != 0);
        let place = |bit: usize| {
            let side = COVERAGE_SIDE as usize;
            (Vec2::new((bit % side) as f32, (bit / side) as f32) + 0.5) / COVERAGE_SIDE as f32
        };
        let mut nearest: Vec<usize> = covered.collect();
        nearest.sort_by(|&a, &b| {
            let [a_far, b_far] = [a, b].map(|bit| place(bit).distance_squared(at));
            a_far.total_cmp(&b_far).then(a.cmp(&b))
        });
        nearest.into_iter().take(NEAREST).any(|bit| {
            self.rays += 1;
            self.raised_m[bit].is_some_and(|from_m| world.is_linked(from_m, at_m))
        })
    }
}

fn raised(world: &World, site: &Site) -> Vec3 {
    world.geometry.raised(site.position_m, site.face_normal, world.link_height_m())
}

fn direction(angle_rad: f32) -> Vec2 {
    Vec2::new(libm::cosf(angle_rad), libm::sinf(angle_rad))
}

/// A place of the finer grid: from rim to rim.
fn fine_place(index: u32) -> Vec2 {
    const RIM: f32 = 0.01;
    let at = Vec2::new((index % FINE_SIDE) as f32, (index / FINE_SIDE) as f32) / (FINE_SIDE - 1) as f32;
    RIM + (1.0 - 2.0 * RIM) * at
}

/// The edge along the foot of a straight wall, by points of it; `None` where it is not straight, or parts of `own` lie beyond.
fn edge_along(foot: &[Vec2], own: &[Vec2]) -> Option<TexelEdge> {
    let middle = foot.iter().sum::<Vec2>() / foot.len().max(1) as f32;
    let [xx, xy, yy] = foot.iter().map(|at| *at - middle).fold([0.0; 3], |[xx, xy, yy], away| {
        [xx + away.x * away.x, xy + away.x * away.y, yy + away.y * away.y]
    });
    if xx + yy <= 0.0 {
        return None;
    }
    // Along the longer axis of the points' scatter; across it lies the edge's direction.
    let along = direction(0.5 * libm::atan2f(2.0 * xy, xx - yy));
    let own_side = own.iter().sum::<Vec2>() / own.len().max(1) as f32 - middle;
    let across = if along.perp().dot(own_side) > 0.0 { -along.perp() } else { along.perp() };
    let beyond = |at: &Vec2| (*at - middle).dot(across);
    let is_straight = foot.iter().all(|at| beyond(at).abs() < STRAIGHT);
    (is_straight && own.iter().all(|at| beyond(at) < STRAIGHT))
        .then(|| TexelEdge::new(libm::atan2f(across.y, across.x), middle.dot(across)))
}

/// The edge that has all of `own` before it, and most of `beyond` behind, by places from the texel's middle. None where
/// nothing of it is.
fn edge_before(own: &[Vec2], beyond: &[Vec2]) -> TexelEdge {
    let mut best = (0, TexelEdge::NONE);
    for turn in 0..TURNS {
        let angle_rad = turn as f32 / TURNS as f32 * std::f32::consts::TAU;
        let along = |at: &Vec2| at.dot(direction(angle_rad));
        let last = own.iter().map(along).fold(f32::NEG_INFINITY, f32::max);
        let behind = || beyond.iter().map(along).filter(|far| *far > last);
        let count = behind().count();
        if count > best.0 {
            // As late as can be: what is beyond a wall is often never seen, as the inside of a box.
            let first = behind().fold(f32::INFINITY, f32::min) - 2.0 * TexelEdge::ROUNDING;
            best = (count, TexelEdge::new(angle_rad, first.max(last + TexelEdge::ROUNDING)));
        }
    }
    best.1
}

/// The points left and right of a point, above and below it.
fn beside(bit: usize) -> impl Iterator<Item = usize> {
    let side = COVERAGE_SIDE as usize;
    let (x, y) = (bit % side, bit / side);
    let near = [(x > 0, bit.wrapping_sub(1)), (x + 1 < side, bit + 1)];
    let far = [(y > 0, bit.wrapping_sub(side)), (y + 1 < side, bit + side)];
    near.into_iter().chain(far).filter_map(|(is_there, bit)| is_there.then_some(bit))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Places of the finer grid, from the texel's middle.
    fn places() -> impl Iterator<Item = Vec2> {
        (0..FINE_SIDE * FINE_SIDE).map(|i| {
            (Vec2::new((i % FINE_SIDE) as f32, (i / FINE_SIDE) as f32) + 0.5) / FINE_SIDE as f32 - 0.5
        })
    }

    #[test]
    fn edge_lies_along_a_straight_wall() {
        for (angle_rad, offset) in [(0.3_f32, 0.1_f32), (2.0, -0.2), (4.0, 0.05)] {
            let is_beyond = |at: &Vec2| at.dot(Vec2::from_angle(angle_rad)) > offset;
            let (beyond, own): (Vec<Vec2>, Vec<Vec2>) = places().partition(is_beyond);
            let edge = edge_before(&own, &beyond);
            let found = |at: &Vec2| edge.is_beyond((*at + 0.5).to_array());
            assert!(own.iter().all(|at| !found(at)), "{angle_rad} {offset}");
            let missed = beyond.iter().filter(|at| !found(at)).count();
            assert!(missed <= 3, "{angle_rad} {offset}: {missed} of {}", beyond.len());
        }
    }

    #[test]
    fn edge_never_cuts_what_is_the_receivers() {
        // A box stands in a corner of the texel; a post in the middle of another has no straight edge at all.
        let (beyond, own): (Vec<Vec2>, Vec<Vec2>) = places().partition(|at| at.x > 0.1 && at.y > 0.2);
        let edge = edge_before(&own, &beyond);
        assert!(edge != TexelEdge::NONE && own.iter().all(|at| !edge.is_beyond((*at + 0.5).to_array())));
        let (post, around): (Vec<Vec2>, Vec<Vec2>) = places().partition(|at| at.length() < 0.2);
        assert_eq!(edge_before(&around, &post), TexelEdge::NONE);
    }

    #[test]
    fn points_beside_a_point_are_its_neighbours_in_the_texel() {
        assert_eq!(beside(0).collect::<Vec<_>>(), [1, 4]);
        assert_eq!(beside(6).collect::<Vec<_>>(), [5, 7, 2, 10]);
        assert_eq!(beside(15).collect::<Vec<_>>(), [14, 11]);
    }
}
