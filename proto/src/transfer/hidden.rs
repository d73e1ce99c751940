//! Radiance that parts of an object hide: means of its surroundings over caps about the nodes of an octahedron, from which the cap of any part
//! is interpolated.

use std::f32::consts::TAU;

use glam::{Vec2, Vec3, Vec4};

use super::surroundings::Surroundings;

/// Nodes along a side of the unfolded octahedron. More → edges of what is around as sharp as caps are narrow, time and memory by the square.
pub const HIDDEN_SIDE: u32 = 17;
/// Widths of caps: the widest are halves of the sphere.
pub const HIDDEN_WIDTHS: u32 = 6;
/// Solid angle of caps of a width, of that of the one before.
const WIDER: f32 = 2.188_5;
/// Half width of a cap's rim, in cosine.
pub const RIM: f32 = 0.06;
/// Solid angle of the narrowest caps as a share of half a sphere: of a half angle of 0.2 rad.
pub const NARROWEST: f32 = 0.019_933_422;

/// Means over caps.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Hidden {
    /// By width, row and column, W·m⁻²·sr⁻¹.
    means: Vec<Vec4>,
}

/// Axes of the caps of each width, row after row.
pub fn hidden_axes() -> impl Iterator<Item = Vec3> {
    let along = |node: u32| 2.0 * node as f32 / (HIDDEN_SIDE - 1) as f32 - 1.0;
    let axis = move |node: u32| {
        let [x, y] = [along(node % HIDDEN_SIDE), along(node / HIDDEN_SIDE)];
        let z = 1.0 - x.abs() - y.abs();
        let sign = |value: f32| if value < 0.0 { -1.0 } else { 1.0 };
        let [x, y] = if z < 0.0 { [(1.0 - y.abs()) * sign(x), (1.0 - x.abs()) * sign(y)] } else { [x, y] };
        Vec3::new(x, y, z).normalize()
    };
    (0..HIDDEN_SIDE * HIDDEN_SIDE).map(axis)
}

/// Cosine of the half angle of caps of a width.
pub fn hidden_cosine(width: u32) -> f32 {
    1.0 - NARROWEST * (0..width).fold(1.0, |share, _| share * WIDER)
}

impl Hidden {
    /// Of surroundings.
    pub fn of(surroundings: &Surroundings) -> Self {
        let of_width = |width| {
            let cosine = hidden_cosine(width);
            hidden_axes().map(move |axis| surroundings.mean(axis, cosine, RIM).extend(0.0))
        };
        Self { means: (0..HIDDEN_WIDTHS).flat_map(of_width).collect() }
    }

    /// Weighted mean of some.
    pub fn mixed<'a>(of: impl Iterator<Item = (&'a Self, f32)>) -> Self {
        let mut means = vec![Vec4::ZERO; (HIDDEN_WIDTHS * HIDDEN_SIDE * HIDDEN_SIDE) as usize];
        for (own, weight) in of {
            means.iter_mut().zip(&own.means).for_each(|(sum, mean)| *sum += weight * *mean);
        }
        Self { means }
    }

    /// Mean radiance over a cap of a solid angle about an axis of length 1, W·m⁻²·sr⁻¹: of the narrowest where it is narrower.
    pub fn mean(&self, axis: Vec3, solid_angle: f32) -> Vec3 {
        if self.means.is_empty() {
            return Vec3::ZERO;
        }
        let mut width = (solid_angle / (TAU * NARROWEST)).max(1.0);
        let mut narrower = 0;
        while narrower < HIDDEN_WIDTHS - 2 && width >= WIDER {
            width /= WIDER;
            narrower += 1;
        }
        let wider = ((width - 1.0) / (WIDER - 1.0)).min(1.0);
        let at = unfolded(axis);
        let first = at.floor().min(Vec2::splat((HIDDEN_SIDE - 2) as f32));
        let share = at - first;
        let node = (narrower * HIDDEN_SIDE + first.y as u32) * HIDDEN_SIDE + first.x as u32;
        let mut sum = Vec4::ZERO;
        for corner in 0..8_u32 {
            let [x, y, z] = [corner & 1, corner >> 1 & 1, corner >> 2];
            let of = |bit: u32, share: f32| if bit == 1 { share } else { 1.0 - share };
            let weight = of(x, share.x) * of(y, share.y) * of(z, wider);
            let place = node + (z * HIDDEN_SIDE + y) * HIDDEN_SIDE + x;
            sum += weight * self.means[place as usize];
        }
        sum.truncate()
    }
}

/// Place of a direction among the nodes.
fn unfolded(axis: Vec3) -> Vec2 {
    let [x, y, z] = (axis / axis.abs().element_sum().max(f32::MIN_POSITIVE)).to_array();
    let sign = |value: f32| if value < 0.0 { -1.0 } else { 1.0 };
    let flat = if z < 0.0 {
        Vec2::new((1.0 - y.abs()) * sign(x), (1.0 - x.abs()) * sign(y))
    } else {
        Vec2::new(x, y)
    };
    ((0.5 + 0.5 * flat) * (HIDDEN_SIDE - 1) as f32).max(Vec2::ZERO)
}
