//! Step "points": which of a texel's 4 × 4 points lie on its receiver's own side of every wall, see `Receivers::coverage`.
//!
//! Those that see the receiver's point, both raised as for links, and those that see one of these beside them: so a
//! surface may bend, but no wall is crossed.
//!
//! Where some do not, the receiver moves to the one of its points that is nearest to their middle: beside a wall, or the
//! mouth of a gap, a texel's centre may have light of millimetres of it alone. Where none does, the centre lies in a strip
//! that all points step over, as the rim of a floor that reaches through a wall: the largest part that no wall cuts is the
//! receiver's, unless it lies in a solid or the strip has a better claim. And the foot of the wall is found, along which
//! a straight edge is laid, see `Receivers::edge`. An edge never fits quite: all of the side with the better claim lies on its
//! own side of it, and the sliver that is wrong on the other, see [`has_better_claim`].

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::{Vec2, Vec3};
use lightkiln_proto::content::{COVERAGE_POINTS, COVERAGE_SIDE, TexelEdge};
use rayon::prelude::*;

use super::candidate::{Look, look};
use super::choose::BEYOND_SHARE_MIN;
use super::edges::edge;
use super::seen;
use crate::geometry::{Geometry, Site};
use crate::lightmap::{Charts, Lightmap, World};
use crate::task::{Cancelled, Progress};

/// Points along each side of the finer grid.
const FINE_SIDE: u32 = 12;
/// Halvings of the distance between two of its points that tell where a wall stands.
const BISECTIONS: u32 = 5;
/// Radius, in texels, of the half sphere that holds as much room as a hollow sees at most. A room of a few texels counts as one
/// too: light of the open may show in the sliver at its walls' feet.
const HOLLOW_RADIUS: f32 = 8.0;
/// Factor by which a place sees more room than a hollow beside it. At the foot of a wall half of the room is hidden.
const SEES_MORE: f32 = 2.0;
/// Share of the sky that a place in the open sees, at least.
const OPEN_SKY_MIN: f32 = 1.0 / 3.0;
/// Factor by which it sees more of the sky than a room beside it.
const MORE_SKY: f32 = 1.5;
/// Points of the coverage that are asked whether they see a place.
const NEAREST: usize = 3;

/// The lightmap with the points of every receiver's texel.
pub fn covered(
    geometry: &Arc<Geometry>,
    charts: &Charts,
    lightmap: Lightmap,
    progress: &Progress,
) -> Result<Lightmap, Cancelled> {
    let world = World::new(Arc::clone(geometry), charts, lightmap, progress);
    let receivers = 0..world.lightmap.receivers.len() as u32;
    let found_of = |index: u32| {
        progress.check()?;
        Ok(progress.casting(|| Found::of(&world, index)))
    };
    let found: Vec<Found> = receivers.into_par_iter().map(found_of).collect::<Result<_, Cancelled>>()?;
    let mut lightmap = world.into_lightmap();
    for (receiver, found) in lightmap.receivers.iter_mut().zip(found) {
        (receiver.coverage, receiver.fine, receiver.edge) = (found.coverage, found.fine, found.edge);
        if let Some(Site { position_m, normal, face_normal }) = found.moved {
            (receiver.position_m, receiver.normal, receiver.face_normal) = (position_m, normal, face_normal);
        }
    }
    Ok(lightmap)
}

/// Findings about a receiver's texel.
#[derive(Default)]
struct Found {
    coverage: u16,
    /// As [`seen::fine`].
    fine: u64,
    edge: TexelEdge,
    /// Where the receiver moves.
    moved: Option<Site>,
    /// Raised points of the coverage, by bit; of others too.
    raised_m: [Option<Vec3>; COVERAGE_POINTS as usize],
}

impl Found {
    fn of(world: &World, receiver: u32) -> Self {
        let mut found = Self::default();
        for (bit, site) in world.points_of(receiver) {
            found.raised_m[bit as usize] = Some(raised(world, receiver, &site));
        }
        found.cover(world, world.raised_receiver(receiver));
        let is_lost = found.coverage == 0;
        if is_lost {
            found.cover_part(world, receiver);
        }
        if found.coverage == 0 {
            let own_m = world.raised_receiver(receiver);
            let sees = |_, site: &Site| world.is_linked(own_m, raised(world, receiver, site));
            found.fine = seen::fine(world, receiver, 0, sees);
            return found;
        }
        let is_parted = |bit: usize| found.raised_m[bit].is_some() && found.coverage & 1 << bit == 0;
        if is_lost || (0..COVERAGE_POINTS as usize).any(is_parted) {
            found.moved = found.middle(world, receiver);
        }
        // A straight wall has a corner of the texel beyond it, however thin the strip there; where the surface ends before a
        // corner, it may have none.
        let corners = [0, FINE_SIDE - 1, FINE_SIDE * (FINE_SIDE - 1), FINE_SIDE * FINE_SIDE - 1];
        let is_cut = found.moved.is_some()
            || corners.into_iter().any(|at| found.is_own(world, receiver, fine_place(at)) != Some(true));
        if is_cut {
            found.edge = found.fitted(world, receiver);
        }
        let fine = |at: Vec2, site: &Site| found.sees(world, at, raised(world, receiver, site));
        let unhidden = seen::unhidden(world, receiver, found.coverage);
        if unhidden == found.coverage {
            found.fine = seen::fine(world, receiver, found.coverage, fine);
        } else {
            found.coverage = unhidden;
            found.moved = found.middle(world, receiver);
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
        self.spread(world, open);
    }

    /// The largest part that no wall cuts, of those outside of solids that the receiver's own point has no better claim than.
    fn cover_part(&mut self, world: &World, receiver: u32) {
        let mut parts: Vec<u16> = Vec::new();
        for (bit, raised_m) in self.raised_m.into_iter().enumerate() {
            if raised_m.is_some() && parts.iter().all(|part| part & 1 << bit == 0) {
                self.coverage = 1 << bit;
                self.spread(world, vec![bit]);
                parts.push(self.coverage);
            }
        }
        parts.sort_by_key(|part| COVERAGE_POINTS - part.count_ones());
        let own_look = look_from(world, receiver, &world.lightmap.receivers[receiver as usize].site());
        for part in parts {
            self.coverage = part;
            let look = self.middle(world, receiver).map(|site| look_from(world, receiver, &site));
            let takes =
                |look: Look| look.back_share < BEYOND_SHARE_MIN && !has_better_claim(&own_look, &look);
            if look.is_some_and(takes) {
                return;
            }
        }
        self.coverage = 0;
    }

    /// Adds points that see those in `open`, beside them.
    fn spread(&mut self, world: &World, mut open: Vec<usize>) {
        while let Some(bit) = open.pop() {
            let Some(from_m) = self.raised_m[bit] else { continue };
            beside(bit, COVERAGE_SIDE as usize).for_each(|beside| self.add(world, from_m, beside, &mut open));
        }
    }

    fn add(&mut self, world: &World, from_m: Vec3, bit: usize, open: &mut Vec<usize>) {
        let Some(at_m) = self.raised_m[bit] else { return };
        if self.coverage & 1 << bit != 0 {
            return;
        }
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
        let places = |own: bool| -> Vec<u32> {
            (0..count).filter(|&index| side[index as usize] == Some(own)).collect()
        };
        let (own, beyond) = (places(true), places(false));
        let better = self.better(world, receiver, &beyond);
        // A receiver with the best claim has all of its side.
        let is_own = better.is_empty();
        let other = if is_own { beyond } else { better };
        let foot = self.foots(world, receiver, &own, &other);
        let from_middle = |places: Vec<u32>| -> Vec<Vec2> {
            places.into_iter().map(|index| fine_place(index) - 0.5).collect()
        };
        edge(&from_middle(own), &from_middle(other), &foot, is_own)
    }

    /// Places of `beyond` with a better claim than the receiver: of each part that no wall cuts, the middle one is asked.
    fn better(&mut self, world: &World, receiver: u32, beyond: &[u32]) -> Vec<u32> {
        let own = self.moved.unwrap_or(world.lightmap.receivers[receiver as usize].site());
        let own_look = look_from(world, receiver, &own);
        let mut better = Vec::new();
        for part in parts(world, receiver, beyond) {
            let middle = part.iter().map(|&index| fine_place(index)).sum::<Vec2>() / part.len() as f32;
            let from_middle = |index: u32| fine_place(index).distance_squared(middle);
            let nearest = part.iter().copied().min_by(|&a, &b| from_middle(a).total_cmp(&from_middle(b)));
            let site = nearest.and_then(|index| world.point_of(receiver, fine_place(index)));
            if site.is_some_and(|site| has_better_claim(&look_from(world, receiver, &site), &own_look)) {
                better.extend(part);
            }
        }
        better.sort_unstable();
        better
    }

    /// Where walls stand between places of the receiver's side and others beside them, from the texel's middle.
    fn foots(&mut self, world: &World, receiver: u32, own: &[u32], other: &[u32]) -> Vec<Vec2> {
        let mut found = Vec::new();
        for &index in own {
            for beside in beside(index as usize, FINE_SIDE as usize) {
                if other.binary_search(&(beside as u32)).is_ok() {
                    let [a, b] = [index, beside as u32].map(fine_place);
                    found.push(self.foot(world, receiver, a, b) - 0.5);
                }
            }
        }
        found
    }

    /// Whether a place of the texel is on the receiver's side; `None` where there is no surface.
    fn is_own(&mut self, world: &World, receiver: u32, at: Vec2) -> Option<bool> {
        let site = world.point_of(receiver, at)?;
        let at_m = raised(world, receiver, &site);
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
    fn sees(&self, world: &World, at: Vec2, at_m: Vec3) -> bool {
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
        nearest
            .into_iter()
            .take(NEAREST)
            .any(|bit| self.raised_m[bit].is_some_and(|from_m| world.is_linked(from_m, at_m)))
    }
}

/// Whether one side of a wall has a better claim than the other to the sliver that an edge gets wrong: a place than a hollow
/// beside it, if it is seen from more room; and a room than the open, whose light would show in it.
///
/// Cubes of paths tell how much room that is: means of paths would let a hollow have a strip at its foot, from which the hollow's
/// wall hides half of all.
pub fn has_better_claim(one: &Look, other: &Look) -> bool {
    if other.seen < HOLLOW_RADIUS.powi(3) {
        one.seen > SEES_MORE * other.seen
    } else {
        one.room >= HOLLOW_RADIUS && other.sky > OPEN_SKY_MIN && MORE_SKY * one.sky < other.sky
    }
}

/// Parts of ascending places of a receiver's texel that no wall cuts.
fn parts(world: &World, receiver: u32, places: &[u32]) -> Vec<Vec<u32>> {
    let raised_m = |index: u32| Some(raised(world, receiver, &world.point_of(receiver, fine_place(index))?));
    let mut left: BTreeMap<u32, Option<Vec3>> =
        places.iter().map(|&index| (index, raised_m(index))).collect();
    let mut parts = Vec::new();
    while let Some((first, first_m)) = left.pop_first() {
        let (mut part, mut open) = (vec![first], vec![(first, first_m)]);
        while let Some((from, from_m)) = open.pop() {
            for beside in beside(from as usize, FINE_SIDE as usize).map(|beside| beside as u32) {
                let Some(&at_m) = left.get(&beside) else { continue };
                if let (Some(from_m), Some(to_m)) = (from_m, at_m)
                    && world.is_linked(from_m, to_m)
                {
                    left.remove(&beside);
                    part.push(beside);
                    open.push((beside, at_m));
                }
            }
        }
        parts.push(part);
    }
    parts
}

/// Surroundings of a place of a receiver's texel.
pub fn look_from(world: &World, receiver: u32, site: &Site) -> Look {
    let own = &world.lightmap.receivers[receiver as usize];
    let (seed, texel_m) = (world.lightmap.seed_of(own, 9), world.lightmap.texel_m_of(receiver));
    look(&world.geometry, texel_m, (world.raised_on(own.block, site), site.face_normal), seed)
}

/// A point on a receiver's texel, raised as for links.
fn raised(world: &World, receiver: u32, site: &Site) -> Vec3 {
    world.raised_on(world.lightmap.receivers[receiver as usize].block, site)
}

/// A place of the finer grid: from rim to rim.
fn fine_place(index: u32) -> Vec2 {
    const RIM: f32 = 0.01;
    let at = Vec2::new((index % FINE_SIDE) as f32, (index / FINE_SIDE) as f32) / (FINE_SIDE - 1) as f32;
    RIM + (1.0 - 2.0 * RIM) * at
}

/// The points left and right of a point of a grid, above and below it.
fn beside(at: usize, side: usize) -> impl Iterator<Item = usize> {
    let (x, y) = (at % side, at / side);
    let near = [(x > 0, at.wrapping_sub(1)), (x + 1 < side, at + 1)];
    let far = [(y > 0, at.wrapping_sub(side)), (y + 1 < side, at + side)];
    near.into_iter().chain(far).filter_map(|(is_there, at)| is_there.then_some(at))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rooms_have_a_better_claim_than_hollows_and_the_open_and_hollows_none() {
        let look =
            |radius: f32, room: f32, sky: f32| Look { seen: radius.powi(3), room, sky, ..Look::default() };
        let (hollow, crate_) = (look(2.0, 2.0, 0.0), look(7.5, 3.0, 0.1));
        let (room, hall) = (look(9.0, 9.0, 0.05), look(15.0, 30.0, 0.3));
        // At the foot of a wall, all that is met is near.
        let open = look(12.0, 0.3, 0.6);
        for (one, other, is_better) in [
            (room, hollow, true),
            (open, hollow, true),
            (room, open, true),
            (hall, open, true),
            (room, hall, false),
            (open, crate_, true),
            (room, crate_, false),
            (hollow, open, false),
        ] {
            assert_eq!(has_better_claim(&one, &other), is_better, "{one:?} {other:?}");
            assert!(!(is_better && has_better_claim(&other, &one)), "{one:?} {other:?}");
        }
        // A strip at the foot of a tall hollow is seen from half of its room.
        let (strip, tall) = (Look { seen: 0.5 * room.seen, ..room }, look(6.0, 6.0, 0.0));
        assert!(has_better_claim(&strip, &look(5.0, 5.0, 0.0)) && !has_better_claim(&tall, &strip));
        let all = [hollow, crate_, room, hall, open];
        assert!(all.iter().all(|one| !has_better_claim(one, one) && !has_better_claim(&crate_, &open)));
    }

    #[test]
    fn points_beside_a_point_are_its_neighbours_in_the_texel() {
        assert_eq!(beside(0, 4).collect::<Vec<_>>(), [1, 4]);
        assert_eq!(beside(6, 4).collect::<Vec<_>>(), [5, 7, 2, 10]);
        assert_eq!(beside(15, 4).collect::<Vec<_>>(), [14, 11]);
    }
}
