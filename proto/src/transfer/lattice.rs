//! Nodes of a volume: along each axis some stand on the object's bounds, the others evenly within and beyond them.

use glam::Vec3;

use super::content::LEVELS;

/// Half side of the finest level in halves of the object's largest side, H.
const NEAR_H: f32 = 1.5;
/// Share of a level's half side from which on it blends into the next.
pub(super) const BLEND_FROM: f32 = 0.9;
/// Reach in H, along the axis on which a point is farthest: beyond it the object changes nothing.
pub const REACH_H: f32 = 12.0;
/// Distance in H from which on its effect fades.
pub const FADE_H: f32 = 10.0;
/// Nodes stand so far before the object's bounds, in H: none lies in a face.
const BEFORE_H: f32 = 1.0 / 256.0;

/// Nodes along an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// First node, nodes before and behind the object, last node, in metres.
    pub stops_m: [f32; 4],
    /// Intervals on each side.
    pub outer: u32,
    /// Intervals between the nodes before and behind the object.
    pub inner: u32,
}

impl Axis {
    /// Between an object's bounds and those of a level, with so many nodes.
    fn new([low_m, high_m]: [f32; 2], [first_m, last_m]: [f32; 2], nodes: u32) -> Self {
        let intervals = nodes - 1;
        let even = intervals as f32 * (high_m - low_m) / (last_m - first_m);
        // As many on either side.
        let parity = intervals % 2;
        let nearest = 2.0 * ((even - parity as f32) / 2.0).round() + parity as f32;
        let inner = (nearest.max(1.0) as u32).max(2 - parity).min(intervals - 2);
        Self { stops_m: [first_m, low_m, high_m, last_m], outer: (intervals - inner) / 2, inner }
    }

    /// Place of a node in metres.
    pub fn node_m(&self, node: u32) -> f32 {
        let [first, low, high, last] = self.stops_m;
        let Self { outer, inner, .. } = *self;
        let along =
            |from: f32, to: f32, step: u32, steps: u32| from + (to - from) * (step as f32 / steps as f32);
        if node < outer {
            along(first, low, node, outer)
        } else if node <= outer + inner {
            along(low, high, node - outer, inner)
        } else {
            along(high, last, node - outer - inner, outer)
        }
    }

    /// Node number, with its fraction, of a place; of one beyond, the first or last.
    pub fn at(&self, place_m: f32) -> f32 {
        let [first, low, high, last] = self.stops_m;
        let (outer, inner) = (self.outer as f32, self.inner as f32);
        // Places far from the origin may leave no room between two.
        let share = |from: f32, to: f32| {
            if to > from { ((place_m - from) / (to - from)).clamp(0.0, 1.0) } else { 0.0 }
        };
        if place_m < low {
            share(first, low) * outer
        } else if place_m <= high {
            outer + share(low, high) * inner
        } else {
            outer + inner + share(high, last) * outer
        }
    }
}

/// Nodes of a level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lattice {
    /// Along x, y and z.
    pub axes: [Axis; 3],
    /// Along each axis.
    pub nodes: u32,
    /// Middle of the object in metres.
    pub middle_m: Vec3,
    /// Half side of the level's cube in metres.
    pub half_m: f32,
}

impl Lattice {
    /// Of a level around an object of such bounds.
    pub fn new(box_m: [[f32; 3]; 2], level: u32, nodes: u32) -> Self {
        let [low_m, high_m] = box_m.map(Vec3::from);
        let middle_m = 0.5 * (low_m + high_m);
        let h_m = half_side_m(box_m);
        let half_m = NEAR_H * (1_u32 << level.min(LEVELS - 1)) as f32 * h_m;
        let before_m = BEFORE_H * h_m;
        let axis = |at: usize| {
            let bounds = [low_m[at] - before_m, high_m[at] + before_m];
            Axis::new(bounds, [middle_m[at] - half_m, middle_m[at] + half_m], nodes)
        };
        Self { axes: [axis(0), axis(1), axis(2)], nodes, middle_m, half_m }
    }

    /// Place of a node, x fastest, in metres.
    pub fn node_m(&self, index: usize) -> Vec3 {
        let side = self.nodes as usize;
        let at = [index % side, index / side % side, index / (side * side)];
        let [x, y, z] = [0, 1, 2].map(|axis| self.axes[axis].node_m(at[axis] as u32));
        Vec3::new(x, y, z)
    }

    /// By node: whether some point of this level reads it. Nearer ones read the level below, until that blends into this one.
    pub fn read_nodes(&self, level: u32) -> Vec<bool> {
        let side = self.nodes as usize;
        let from_m = if level == 0 { 0.0 } else { BLEND_FROM * 0.5 * self.half_m };
        // A cell holds a place as far away as its farthest corner.
        let is_far = |at: [usize; 3]| {
            let node_m = self.node_m((at[2] * side + at[1]) * side + at[0]);
            (node_m - self.middle_m).abs().max_element() >= from_m
        };
        let around = |at: usize| at.saturating_sub(1)..=(at + 1).min(side - 1);
        let of = |index: usize| {
            let [x, y, z] = [index % side, index / side % side, index / (side * side)];
            around(z).any(|z| around(y).any(|y| around(x).any(|x| is_far([x, y, z]))))
        };
        (0..side * side * side).map(of).collect()
    }

    /// First of the eight nodes around a place, and its share of the way to the next ones.
    pub fn around(&self, place_m: Vec3) -> ([u32; 3], Vec3) {
        let last = (self.nodes - 2) as f32;
        let at = [0, 1, 2].map(|axis| self.axes[axis].at(place_m[axis]));
        let first = at.map(|at| at.floor().clamp(0.0, last));
        let shares = [0, 1, 2].map(|axis| at[axis] - first[axis]);
        (first.map(|first| first as u32), shares.into())
    }
}

/// H: half of the largest side, in metres.
pub(super) fn half_side_m([low, high]: [[f32; 3]; 2]) -> f32 {
    0.5 * (Vec3::from(high) - Vec3::from(low)).max_element()
}
