//! The straight edge between what is a receiver's of its texel and what lies beyond a wall, see `Receivers::edge`.
//!
//! An edge never fits quite. All of the side with the better claim lies on its own side of it, and the sliver that is wrong on
//! the other: one looks into rooms, and not into the hollows beside them.

use glam::Vec2;
use lightkiln_proto::content::TexelEdge;

/// Distance in texels by which points may lie off a straight edge.
const STRAIGHT: f32 = 0.02;
/// Directions that edges may have; of equally good ones the first is taken.
const TURNS: u32 = 256;

/// The edge between places of the receiver's own side and those beyond the wall, all from the texel's middle in texels.
/// `foot` is of places at the wall itself; `is_own_better` says that the own side has the better claim.
pub fn edge(own: &[Vec2], beyond: &[Vec2], foot: &[Vec2], is_own_better: bool) -> TexelEdge {
    let with_foot = |side: &[Vec2]| [side, foot].concat();
    if let Some(angle_rad) = straight(foot, own, beyond) {
        let across = direction(angle_rad);
        let far = |at: &Vec2| at.dot(across);
        let offset = if is_own_better {
            with_foot(own).iter().map(far).fold(f32::NEG_INFINITY, f32::max) + TexelEdge::ROUNDING
        } else {
            with_foot(beyond).iter().map(far).fold(f32::INFINITY, f32::min) - TexelEdge::ROUNDING
        };
        return TexelEdge::new(angle_rad, offset);
    }
    if !is_own_better {
        // The edge of the other side, turned.
        if let Some((angle_rad, offset)) = before(&with_foot(beyond), own) {
            return TexelEdge::new(angle_rad + std::f32::consts::PI, -offset);
        }
    }
    before(&with_foot(own), beyond)
        .map_or(TexelEdge::NONE, |(angle_rad, offset)| TexelEdge::new(angle_rad, offset))
}

fn direction(angle_rad: f32) -> Vec2 {
    Vec2::new(libm::cosf(angle_rad), libm::sinf(angle_rad))
}

/// Direction across a straight wall, away from the middle of `own`, by points of its foot, as edges store it; `None` where
/// it is not straight, or parts of either side lie on the other.
fn straight(foot: &[Vec2], own: &[Vec2], beyond: &[Vec2]) -> Option<f32> {
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
    let far = |at: &Vec2| (*at - middle).dot(across);
    let is_straight = foot.iter().all(|at| far(at).abs() < STRAIGHT)
        && own.iter().all(|at| far(at) < STRAIGHT)
        && beyond.iter().all(|at| far(at) > -STRAIGHT);
    is_straight.then(|| TexelEdge::rounded(libm::atan2f(across.y, across.x)))
}

/// Angle and offset of the edge that has all of `own` before it, and most of `beyond` behind, by places from the texel's
/// middle. `None` where nothing of it is.
fn before(own: &[Vec2], beyond: &[Vec2]) -> Option<(f32, f32)> {
    let mut best = (0, None);
    for turn in 0..TURNS {
        let angle_rad = turn as f32 / TURNS as f32 * std::f32::consts::TAU;
        let across = direction(angle_rad);
        let along = |at: &Vec2| at.dot(across);
        let last = own.iter().map(along).fold(f32::NEG_INFINITY, f32::max);
        let behind = || beyond.iter().map(along).filter(|far| *far > last);
        let count = behind().count();
        if count > best.0 {
            // As late as can be: the own side is the one that is looked at.
            let first = behind().fold(f32::INFINITY, f32::min) - 2.0 * TexelEdge::ROUNDING;
            best = (count, Some((angle_rad, first.max(last + TexelEdge::ROUNDING))));
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: u32 = 12;

    /// Places of a grid, from the texel's middle.
    fn places() -> impl Iterator<Item = Vec2> {
        (0..SIDE * SIDE).map(|i| (Vec2::new((i % SIDE) as f32, (i / SIDE) as f32) + 0.5) / SIDE as f32 - 0.5)
    }

    fn is_beyond(edge: TexelEdge, at: &Vec2) -> bool {
        edge.is_beyond((*at + 0.5).to_array())
    }

    #[test]
    fn edge_lies_along_a_straight_wall() {
        for (angle_rad, offset) in [(0.3_f32, 0.1_f32), (2.0, -0.2), (4.0, 0.05)] {
            let away = |at: &Vec2| at.dot(Vec2::from_angle(angle_rad)) > offset;
            let (beyond, own): (Vec<Vec2>, Vec<Vec2>) = places().partition(away);
            for is_own_better in [true, false] {
                let edge = edge(&own, &beyond, &[], is_own_better);
                let wrong =
                    |side: &[Vec2], own: bool| side.iter().filter(|at| is_beyond(edge, at) == own).count();
                let [of_own, of_beyond] = [wrong(&own, true), wrong(&beyond, false)];
                let [seen, hidden] = if is_own_better { [of_own, of_beyond] } else { [of_beyond, of_own] };
                assert!(seen == 0 && hidden <= 3, "{angle_rad} {offset}: {seen} {hidden}");
            }
        }
    }

    #[test]
    fn foot_of_a_straight_wall_at_any_angle_is_of_the_side_with_the_better_claim() {
        for (turn, offset) in (0..1000).map(|i| (i as f32 * 0.00628, (i % 13) as f32 * 0.05 - 0.3)) {
            let wall = Vec2::from_angle(turn);
            let far = |at: &Vec2| at.dot(wall) - offset;
            // Points of the foot are found to some thousandths of a texel.
            let along = (-50..=50).map(|i| wall * offset + wall.perp() * 0.014 * i as f32);
            let bumpy = along.zip(0..).map(|(at, i)| at + wall * 0.003 * ((i % 3) - 1) as f32);
            let foot: Vec<Vec2> = bumpy.filter(|at| at.abs().max_element() <= 0.5).collect();
            let (beyond, own): (Vec<Vec2>, Vec<Vec2>) = places().partition(|at| far(at) > 0.0);
            for is_own_better in [true, false] {
                let edge = edge(&own, &beyond, &foot, is_own_better);
                let seen = if is_own_better { &own } else { &beyond };
                let is_cut = |at: &&Vec2| is_beyond(edge, at) == is_own_better;
                let cut = foot.iter().chain(seen).filter(is_cut).count();
                assert_eq!(cut, 0, "{turn} {offset} {is_own_better}");
                // Nor is more given than the wall's own width and the edge's rounding.
                let given = places().filter(|at| is_beyond(edge, at) != (far(at) > 0.0));
                let off = given.map(|at| far(&at).abs()).fold(0.0, f32::max);
                assert!(off < STRAIGHT + 0.02, "{turn} {offset} {is_own_better}: {off}");
            }
        }
    }

    #[test]
    fn edge_never_cuts_what_is_the_receivers() {
        // A box stands in a corner of the texel; a post in the middle of another has no straight edge at all.
        let (beyond, own): (Vec<Vec2>, Vec<Vec2>) = places().partition(|at| at.x > 0.1 && at.y > 0.2);
        let around_box = edge(&own, &beyond, &[], true);
        assert!(around_box != TexelEdge::NONE && own.iter().all(|at| !is_beyond(around_box, at)));
        // The receiver inside of the box has no part of the room.
        let in_box = edge(&beyond, &own, &[], false);
        assert!(own.iter().all(|at| is_beyond(in_box, at)), "{in_box:?}");
        let (post, around): (Vec<Vec2>, Vec<Vec2>) = places().partition(|at| at.length() < 0.2);
        assert_eq!(edge(&around, &post, &[], true), TexelEdge::NONE);
    }
}
