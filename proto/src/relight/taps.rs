//! Reading a lightmap between its texels: which of the four around a point count, and how much.

use crate::content::TexelEdge;

/// Links have this many values; a texel's kind has them in its lowest digit.
const LINKS_VALUES: u32 = 1 << crate::content::LINKS.len();

/// How far an edge may lie from the wall that it stands for, in texels: half a step of its offset, and half a step of its angle
/// over the longest way in a texel.
const EDGE_ROUNDING: f32 = 0.012;

/// Content of a lightmap texel, as the fourth component of its irradiance: 0 for nothing, −1 for the light of others,
/// spread over a rim, and more for a receiver's own.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TexelKind(pub f32);

impl TexelKind {
    /// A texel filled from those near it.
    pub const FILLED: Self = Self(-1.0);

    /// A receiver's own texel, from its [`crate::content::Receivers::links`] and edge; exact in f32.
    pub fn of_receiver(links: u8, edge: TexelEdge) -> Self {
        Self((1 + (u32::from(links) % LINKS_VALUES) + LINKS_VALUES * u32::from(edge.0)) as f32)
    }

    /// It is a receiver's own.
    pub fn is_receiver(self) -> bool {
        self.0 > 0.0
    }

    fn is_linked(self, bit: u32) -> bool {
        (self.0 as u32 - 1) >> bit & 1 == 1
    }

    fn edge(self) -> TexelEdge {
        TexelEdge(((self.0 as u32 - 1) / LINKS_VALUES) as u16)
    }
}

/// The four texels around a point, in the order (0, 0), (1, 0), (0, 1), (1, 1).
pub type Taps = [TexelKind; 4];

/// Shares of the four texels around a point in its light, which add up to 1, or all 0 where none has any. `share` is the
/// point's place between their centres, 0..1 in x and y. Edges are rounded: the side of them that the point is on is told by a place
/// as far from it as rounding may be, towards `before`, which is nearer to an eye that sees the point, or the point itself.
///
/// Bilinear over the receivers that no wall parts from the nearest one, the *home*; over filled texels where there is no
/// receiver. Where the point, or the place nearest to it of the nearest one's texel, lies beyond that one's edge, the home is
/// the nearest that a wall parts from that one and whose side has the point: no edge of its own is before the point, and its
/// texel is beyond the first edge or has one itself.
pub fn tap_weights(taps: Taps, share: [f32; 2], before: [f32; 2]) -> [f32; 4] {
    let sided = towards(share, before);
    let weights: [f32; 4] = std::array::from_fn(|tap| {
        let [x, y] = [tap & 1, tap >> 1];
        let along = |share: f32, step: usize| if step == 0 { 1.0 - share } else { share };
        // Never quite 0, so that a lone receiver counts wherever it lies.
        along(share[0], x) * along(share[1], y) + 1e-6
    });
    let heaviest = |counts: &dyn Fn(usize) -> bool| {
        let heavier = |best: Option<usize>, tap: usize| match best {
            Some(other) if weights[other] >= weights[tap] => best,
            _ => Some(tap),
        };
        (0..4).filter(|&tap| taps[tap].is_receiver() && counts(tap)).fold(None, heavier)
    };
    let is_beyond = |tap: usize, [x, y]: [f32; 2]| {
        taps[tap].edge().is_beyond([x - (tap & 1) as f32 + 0.5, y - (tap >> 1) as f32 + 0.5])
    };
    // A texel's edge says nothing of what lies outside of the texel: a point there asks by the nearest of its places.
    let within = |tap: usize| {
        [sided[0] - (tap & 1) as f32, sided[1] - (tap >> 1) as f32].map(|away| away.clamp(-0.5, 0.5))
    };
    let is_beyond_own = |own: usize| taps[own].edge().is_beyond(within(own).map(|away| away + 0.5));
    let mut home = heaviest(&|_| true);
    if let Some(own) = home.filter(|&own| is_beyond_own(own)) {
        let is_parted = |tap: usize| tap != own && !are_linked(taps, own, tap);
        let is_there = |tap: usize| is_beyond(own, [(tap & 1) as f32, (tap >> 1) as f32]);
        // Of those behind the wall, and those with a wall of their own, whose side has the point.
        let has_point = |tap: usize| {
            is_parted(tap) && !is_beyond(tap, sided) && (is_there(tap) || taps[tap].edge() != TexelEdge::NONE)
        };
        home = heaviest(&has_point).or_else(|| heaviest(&|tap| is_there(tap) && is_parted(tap))).or(home);
    }
    let counted: [f32; 4] = std::array::from_fn(|tap| {
        let counts = match home {
            Some(home) => tap == home || are_linked(taps, home, tap),
            None => taps[tap] == TexelKind::FILLED,
        };
        if counts { weights[tap] } else { 0.0 }
    });
    let total: f32 = counted.iter().sum();
    counted.map(|weight| if total > 0.0 { weight / total } else { 0.0 })
}

/// The place on the way from one to another that is at most [`EDGE_ROUNDING`] from the first.
fn towards(from: [f32; 2], to: [f32; 2]) -> [f32; 2] {
    let way = [to[0] - from[0], to[1] - from[1]];
    let length = (way[0] * way[0] + way[1] * way[1]).sqrt();
    let share = (EDGE_ROUNDING / length.max(1e-9)).min(1.0);
    [from[0] + share * way[0], from[1] + share * way[1]]
}

/// Whether no wall stands between two taps that are receivers; each link is a bit of the earlier tap.
fn are_linked(taps: Taps, one: usize, other: usize) -> bool {
    let (first, second) = (one.min(other), one.max(other));
    if !taps[first].is_receiver() || !taps[second].is_receiver() {
        return false;
    }
    taps[first].is_linked(match (first, second) {
        (0, 1) | (2, 3) => 0,
        (0, 2) | (1, 3) => 1,
        (0, 3) => 2,
        _ => 3,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn weights_at(taps: Taps, share: [f32; 2]) -> [f32; 4] {
        tap_weights(taps, share, share)
    }

    const ALL: u8 = 0b1111;

    const NONE: TexelEdge = TexelEdge::NONE;

    /// The left half of a texel is its receiver's.
    fn left_half() -> TexelEdge {
        TexelEdge::new(0.0, 0.0)
    }

    #[test]
    fn texels_without_walls_are_bilinear() {
        let taps = [TexelKind::of_receiver(ALL, NONE); 4];
        let found = weights_at(taps, [0.25, 0.5]);
        for (weight, wanted) in found.iter().zip([0.375, 0.125, 0.375, 0.125]) {
            assert!((weight - wanted).abs() < 1e-5, "{found:?}");
        }
    }

    #[test]
    fn light_does_not_come_across_a_wall_between_texels() {
        // Column 0 is linked to itself, as is column 1.
        let column = TexelKind::of_receiver(0b0010, NONE);
        let found = weights_at([column; 4], [0.4, 0.2]);
        assert!(found[1] == 0.0 && found[3] == 0.0 && (found[0] + found[2] - 1.0).abs() < 1e-6, "{found:?}");
    }

    #[test]
    fn point_beyond_a_wall_in_its_texel_takes_the_light_of_that_side() {
        // A wall cuts the left texels in the middle: their receivers are left of it.
        let left = TexelKind::of_receiver(0b0010, left_half());
        let right = TexelKind::of_receiver(0b0010, NONE);
        let beyond = weights_at([left, right, left, right], [0.4, 0.2]);
        assert!(beyond[0] == 0.0 && beyond[2] == 0.0, "beyond the wall: {beyond:?}");
        // On this side of the wall, where the other texels lie to the left of this one.
        let before = weights_at([right, left, right, left], [0.7, 0.2]);
        assert!(before[0] == 0.0 && before[2] == 0.0, "before the wall: {before:?}");
    }

    #[test]
    fn point_beyond_a_wall_takes_the_light_of_a_texel_beside_that_the_wall_cuts_too() {
        // A wall along the rows: the left receiver is below it, the right one above, each in its own half.
        let half = |turn: f32| TexelEdge::new(turn * std::f32::consts::TAU, 0.01);
        let (below, above) = (TexelKind::of_receiver(0, half(0.25)), TexelKind::of_receiver(0, half(0.75)));
        let nothing = TexelKind::default();
        let taps = [below, above, nothing, nothing];
        assert_eq!(weights_at(taps, [0.4, 0.2]), [0.0, 1.0, 0.0, 0.0]);
        // A third that stands left of a wall of its own has no part in it.
        let left = TexelKind::of_receiver(0, TexelEdge::new(0.0, 0.4));
        let whole = TexelKind::of_receiver(0, NONE);
        assert_eq!(weights_at([left, below, left, whole], [0.6, 0.3]), [0.0, 0.0, 0.0, 1.0]);
        // Nor where the texel that the point lies in has no receiver.
        assert_eq!(weights_at([nothing, below, nothing, whole], [0.1, 0.3]), [0.0, 0.0, 0.0, 1.0]);
    }

    #[test]
    fn place_before_tells_the_side_of_an_edge_and_nothing_else() {
        let left = TexelKind::of_receiver(0b0010, left_half());
        let right = TexelKind::of_receiver(0b0010, NONE);
        let taps = [left, right, left, right];
        // A point right behind the rounded edge, whose eye is before the wall.
        let found = tap_weights(taps, [0.01, 0.2], [-0.9, 0.25]);
        assert!(found[1] == 0.0 && found[3] == 0.0, "{found:?}");
        assert!((found[2] - 0.2).abs() < 1e-4, "shares are those of the point: {found:?}");
        assert!(weights_at(taps, [0.01, 0.2])[0] == 0.0);
        // Further behind, it is no rounding: a surface that ends in the air has nothing before its edge.
        assert_eq!(tap_weights(taps, [0.02, 0.2], [-0.9, 0.25])[0], 0.0);
    }

    #[test]
    fn edge_says_nothing_of_what_lies_outside_of_its_texel() {
        // A round foot cuts a corner of the lower left texel; the lower right one, which has no receiver, is before the foot.
        let cut = TexelKind::of_receiver(0, TexelEdge::new(-std::f32::consts::FRAC_PI_4, 0.4));
        let (nothing, hollow) = (TexelKind::default(), TexelKind::of_receiver(0, NONE));
        let taps = [nothing, hollow, cut, nothing];
        assert_eq!(weights_at(taps, [0.68, 0.96]), [0.0, 0.0, 1.0, 0.0]);
        // In the corner itself, the light of the hollow.
        assert_eq!(weights_at(taps, [0.45, 0.6]), [0.0, 1.0, 0.0, 0.0]);
    }

    #[test]
    fn point_that_no_texel_stands_for_takes_the_nearest_light() {
        let own = TexelKind::of_receiver(ALL, left_half());
        let all_linked = weights_at([own, TexelKind::of_receiver(ALL, NONE), own, own], [0.4, 0.2]);
        assert!(all_linked.iter().all(|weight| *weight > 0.0), "{all_linked:?}");
        let (none, rim) = (TexelKind::default(), TexelKind::FILLED);
        assert_eq!(weights_at([own, rim, none, rim], [0.4, 0.2]), [1.0, 0.0, 0.0, 0.0]);
        let of_rim = weights_at([none, rim, none, rim], [0.4, 0.2]);
        assert!((of_rim[1] + of_rim[3] - 1.0).abs() < 1e-6 && of_rim[0] == 0.0, "{of_rim:?}");
        assert_eq!(weights_at([none; 4], [0.5; 2]), [0.0; 4]);
    }

    #[test]
    fn kinds_and_edges_are_exact() {
        let kind = TexelKind::of_receiver(0b1010, TexelEdge(0xA5C3));
        assert_eq!(kind.edge(), TexelEdge(0xA5C3));
        assert!(kind.is_linked(1) && kind.is_linked(3) && !kind.is_linked(0) && !kind.is_linked(2));
        assert_eq!(TexelKind::of_receiver(15, TexelEdge(u16::MAX)).0 as u32, 1 + 15 + 16 * 65_535);
        for (angle_rad, offset) in [(0.0_f32, 0.3_f32), (2.0, -0.4), (6.2, 0.0), (-1.0, 0.7)] {
            let edge = TexelEdge::new(angle_rad, offset);
            assert!(edge != TexelEdge::NONE);
            let at = |offset: f32| [0.5 + offset * angle_rad.cos(), 0.5 + offset * angle_rad.sin()];
            assert!(edge.is_beyond(at(offset + 0.01)) && !edge.is_beyond(at(offset - 0.01)), "{angle_rad}");
        }
    }
}
