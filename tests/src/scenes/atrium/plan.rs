//! Where things stand in the atrium.

use core::f32::consts::{FRAC_PI_2, PI};

use glam::Vec3;

/// From column axis to column axis, and from there to the outer wall.
pub(super) const BAY_M: f32 = 3.0;
/// Column axes of the long sides are at z = ±this.
pub(super) const AXIS_Z_M: f32 = 4.5;
/// Column axes of the short sides are at x = ±this.
pub(super) const AXIS_X_M: f32 = 9.0;
/// Height of the lower gallery's floor above the court's.
pub(super) const LOWER_FLOOR_M: f32 = 0.15;
/// Where the lower arches spring.
pub(super) const LOWER_SPRING_M: f32 = 3.2;
/// Height of the upper gallery's floor.
pub(super) const UPPER_FLOOR_M: f32 = 5.4;
/// Where the upper arches spring.
pub(super) const UPPER_SPRING_M: f32 = 8.6;
/// The upper gallery's ceiling.
pub(super) const CEILING_M: f32 = 10.4;

/// A place on the ring around the court, with +z of what stands there facing the court.
#[derive(Clone, Debug)]
pub(super) struct Spot {
    pub name: String,
    pub axis_m: Vec3,
    pub yaw_rad: f32,
}

impl Spot {
    /// The spot's own +x, +y, +z offset in the world.
    pub fn at(&self, offset_m: Vec3) -> Vec3 {
        let (sin, cos) = (libm::sinf(self.yaw_rad), libm::cosf(self.yaw_rad));
        let turned =
            Vec3::new(cos * offset_m.x + sin * offset_m.z, offset_m.y, cos * offset_m.z - sin * offset_m.x);
        self.axis_m + turned
    }
}

/// The four sides of the court: name, bays, how far the axis is from the centre, and yaw.
const SIDES: [(&str, u32, f32, f32); 4] = [
    ("north", 6, AXIS_Z_M, 0.0),
    ("south", 6, AXIS_Z_M, PI),
    ("west", 3, AXIS_X_M, FRAC_PI_2),
    ("east", 3, AXIS_X_M, -FRAC_PI_2),
];

fn along_sides(step: impl Fn(u32) -> Vec<f32>) -> Vec<Spot> {
    let mut spots = Vec::new();
    for (side, bays, distance_m, yaw_rad) in SIDES {
        for (i, along) in step(bays).into_iter().enumerate() {
            let centre = Spot { name: String::new(), axis_m: Vec3::ZERO, yaw_rad };
            let axis_m = centre.at(Vec3::new(along, 0.0, -distance_m));
            spots.push(Spot { name: format!("{side} {}", i + 1), axis_m, yaw_rad });
        }
    }
    spots
}

/// The middle of every arcade bay, on the column axis.
pub(super) fn bays() -> Vec<Spot> {
    along_sides(|bays| (0..bays).map(|i| BAY_M * (i as f32 + 0.5 - 0.5 * bays as f32)).collect())
}

/// Every column; corners have piers instead.
pub(super) fn columns() -> Vec<Spot> {
    along_sides(|bays| (1..bays).map(|i| BAY_M * (i as f32 - 0.5 * bays as f32)).collect())
}

/// Every line across a gallery from the court's axes to the outer wall, corners too: ribs and pilasters.
pub(super) fn cross_lines() -> Vec<Spot> {
    along_sides(|bays| (0..=bays).map(|i| BAY_M * (i as f32 - 0.5 * bays as f32)).collect())
}

/// The four corners of the court.
pub(super) fn corners() -> [(&'static str, Vec3); 4] {
    [
        ("north-west", Vec3::new(-AXIS_X_M, 0.0, -AXIS_Z_M)),
        ("north-east", Vec3::new(AXIS_X_M, 0.0, -AXIS_Z_M)),
        ("south-west", Vec3::new(-AXIS_X_M, 0.0, AXIS_Z_M)),
        ("south-east", Vec3::new(AXIS_X_M, 0.0, AXIS_Z_M)),
    ]
}
