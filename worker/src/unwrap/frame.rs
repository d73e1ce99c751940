//! The projection of a chart onto the world's texel lattice.

use glam::{DVec2, DVec3};

/// Normals closer to a world axis than this (sine, about 0.3°) take the axis itself.
const AXIS_SNAP_SINE: f64 = 5e-3;

/// Other normals are rounded to this grid, so that nearly equal planes share one frame.
const NORMAL_STEPS: f64 = 8192.0;

/// Coordinates closer to a lattice line than this, in texels, are moved onto it: rounding in a mesh's `f32`
/// positions shall not cost a row of texels.
const LATTICE_SNAP_TEXELS: f64 = 1.0 / 512.0;

/// Above this |n.y| the in-plane axes come from world x instead of world up.
const POLE_COSINE: f64 = 0.9;

/// In-plane axes and normal of a chart. `right × up = normal`: front faces run counter-clockwise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ChartFrame {
    right: DVec3,
    up: DVec3,
    /// The axis along which the chart is projected.
    pub normal: DVec3,
    texels_per_m: f64,
}

impl ChartFrame {
    /// The frame of a (not zero) normal.
    pub fn new(normal: DVec3, texel_m: f32) -> Self {
        let normal = snapped(normal);
        let (right, up) = if normal.y.abs() > POLE_COSINE {
            let right = (DVec3::X - normal * normal.x).normalize();
            (right, normal.cross(right))
        } else {
            let up = (DVec3::Y - normal * normal.y).normalize();
            (up.cross(normal), up)
        };
        Self { right, up, normal, texels_per_m: 1.0 / decimal(texel_m) }
    }

    /// Lattice coordinates and height over the plane through the world origin, all in texels.
    pub fn project(&self, position_m: DVec3) -> (DVec2, f64) {
        let [u, v, height] =
            [self.right, self.up, self.normal].map(|axis| position_m.dot(axis) * self.texels_per_m);
        (DVec2::new(onto_lattice(u), onto_lattice(v)), height)
    }
}

/// The number that was written, not its nearest `f32`: 3 m / 0.1 m shall be 30.
fn decimal(texel_m: f32) -> f64 {
    texel_m.to_string().parse().unwrap_or(f64::from(texel_m))
}

fn snapped(normal: DVec3) -> DVec3 {
    for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
        if normal.cross(axis).length() < AXIS_SNAP_SINE * normal.length() {
            return axis * normal.dot(axis).signum();
        }
    }
    (normal * (NORMAL_STEPS / normal.length())).round().normalize()
}

fn onto_lattice(coordinate: f64) -> f64 {
    let line = coordinate.round();
    if (coordinate - line).abs() < LATTICE_SNAP_TEXELS { line } else { coordinate }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_are_right_handed_and_world_aligned() {
        for normal in [DVec3::X, -DVec3::Y, DVec3::Z, DVec3::new(0.3, -0.8, 0.5), DVec3::new(0.001, 1.0, 0.0)]
        {
            let frame = ChartFrame::new(normal, 0.1);
            assert!((frame.right.cross(frame.up) - frame.normal).length() < 1e-12);
            assert!(frame.right.dot(frame.up).abs() < 1e-12);
        }
        assert_eq!(ChartFrame::new(DVec3::new(0.001, 1.0, 0.0), 0.1).normal, DVec3::Y);
        assert_eq!(ChartFrame::new(DVec3::Y, 0.1).right, DVec3::X);
        assert_eq!(ChartFrame::new(-DVec3::X, 0.1).up, DVec3::Y);
    }

    #[test]
    fn decimal_texel_sizes_meet_the_lattice() {
        let frame = ChartFrame::new(DVec3::Z, 0.1);
        assert_eq!(frame.project(DVec3::new(3.0, 0.3_f32.into(), 0.0)).0, DVec2::new(30.0, 3.0));
    }
}
