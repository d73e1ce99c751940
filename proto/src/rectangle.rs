//! The geometry of rectangular lights.

use glam::Vec3;

use crate::scene::LightKind;

/// Most points of a rectangular light that its shadows are cast from.
pub const RECT_POINTS_MAX: u32 = 16;
/// Points unless a light says otherwise.
pub const RECT_POINTS: u32 = 4;
/// Length of a vector across the light, of a unit hint, below which rounding alone would turn the rectangle.
const ACROSS_MIN: f32 = 1e-4;
/// Share by which sides of cells have to be more alike, so that rounding decides no tie.
const TIE: f64 = 1e-4;

/// A rectangle with its place, sides and the way in which it shines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rectangle {
    /// Centre in metres.
    pub centre_m: Vec3,
    /// From the centre to the middle of the right side, in metres.
    pub half_u_m: Vec3,
    /// From the centre to the middle of the upper side, in metres.
    pub half_v_m: Vec3,
    /// Unit direction along which it shines.
    pub direction: Vec3,
}

impl Rectangle {
    /// The rectangle of a light; `None` for lights of other kinds, and for one without direction or area.
    pub fn of(kind: &LightKind) -> Option<Self> {
        let LightKind::Rect { position_m, direction, up, size_m: [width_m, height_m], .. } = kind else {
            return None;
        };
        let direction = Vec3::from(*direction).try_normalize()?;
        // A hint along the light is as good as none.
        let across = |up: Vec3| {
            let across = direction.cross(up.try_normalize()?);
            (across.length() >= ACROSS_MIN).then(|| across.normalize())
        };
        let right = [Vec3::from(*up), default_up(direction)].into_iter().find_map(across)?;
        let up = right.cross(direction);
        let has_area = *width_m > 0.0 && *height_m > 0.0 && width_m.is_finite() && height_m.is_finite();
        has_area.then_some(Self {
            centre_m: (*position_m).into(),
            half_u_m: right * (0.5 * width_m),
            half_v_m: up * (0.5 * height_m),
            direction,
        })
    }

    /// Area in m².
    pub fn area_m2(&self) -> f32 {
        4.0 * self.half_u_m.length() * self.half_v_m.length()
    }
}

/// Columns and rows of so many cells alike of a rectangle of that width and height, as near to squares as may be; of ties
/// fewer columns.
pub fn rect_cells([width_m, height_m]: [f32; 2], points: u32) -> [u32; 2] {
    let points = points.clamp(1, RECT_POINTS_MAX);
    let aspect = f64::from(width_m) / f64::from(height_m);
    // Ratio of the sides of a cell, the longer over the shorter.
    let longer = |columns: u32| {
        let ratio = aspect * f64::from(points / columns) / f64::from(columns);
        ratio.max(1.0 / ratio)
    };
    let mut best = 1;
    for columns in 2..=points {
        if points.is_multiple_of(columns) && longer(columns) < longer(best) * (1.0 - TIE) {
            best = columns;
        }
    }
    [best, points / best]
}

/// Direction of the height of a rectangle that shines along `direction`, unless given.
pub fn default_up(direction: Vec3) -> Vec3 {
    if direction.y.abs() > 0.9 { Vec3::NEG_Z } else { Vec3::Y }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rect(direction: [f32; 3], up: [f32; 3], size_m: [f32; 2]) -> Option<Rectangle> {
        Rectangle::of(&LightKind::Rect { position_m: [1.0, 2.0, 3.0], direction, up, size_m, points: 4 })
    }

    #[test]
    fn sides_stand_at_right_angles_and_the_height_leans_towards_up() {
        let found = rect([0.0, 0.0, -2.0], [3.0, 1.0, 5.0], [2.0, 1.0]).unwrap();
        let Rectangle { half_u_m, half_v_m, direction, .. } = found;
        assert!(half_u_m.dot(half_v_m).abs() < 1e-6 && half_u_m.dot(direction).abs() < 1e-6);
        assert!((half_u_m.length() - 1.0).abs() < 1e-6 && (half_v_m.length() - 0.5).abs() < 1e-6);
        assert!(half_v_m.dot(Vec3::new(3.0, 1.0, 0.0)) > 0.499 * 10.0_f32.sqrt(), "{half_v_m}");
        assert!((half_u_m.cross(half_v_m).normalize() + direction).length() < 1e-6);
        assert!((found.area_m2() - 2.0).abs() < 1e-6);
        // Up along the light says nothing.
        let along = rect([0.0, -1.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0]).unwrap();
        // Nor does one that is along it but for rounding.
        assert_eq!(rect([0.0, -1.0, 0.0], [3e-6, 1.0, 0.0], [1.0, 1.0]), Some(along));
        assert_ne!(rect([0.0, -1.0, 0.0], [3e-3, 1.0, 0.0], [1.0, 1.0]), Some(along));
    }

    #[test]
    fn rectangles_without_area_or_direction_are_none() {
        for (direction, size_m) in [
            ([0.0; 3], [1.0; 2]),
            ([0.0, -1.0, 0.0], [0.0, 1.0]),
            ([0.0, -1.0, 0.0], [1.0, -1.0]),
            ([0.0, -1.0, 0.0], [f32::NAN, 1.0]),
            ([f32::NAN, -1.0, 0.0], [1.0; 2]),
        ] {
            assert_eq!(rect(direction, [0.0, 0.0, 1.0], size_m), None, "{direction:?} {size_m:?}");
        }
    }

    #[test]
    fn cells_are_as_near_to_squares_as_their_number_lets_them() {
        assert_eq!(rect_cells([1.0, 1.0], 4), [2, 2]);
        assert_eq!(rect_cells([1.2, 0.1], 4), [4, 1]);
        assert_eq!(rect_cells([0.1, 1.2], 4), [1, 4]);
        assert_eq!(rect_cells([2.0, 1.0], 8), [4, 2]);
        assert_eq!(rect_cells([1.0, 1.0], 0), [1, 1]);
        assert_eq!(rect_cells([1.0, 1.0], 1000), [4, 4]);
    }

    #[test]
    fn ties_of_cells_are_fewer_columns_whatever_the_rounding() {
        for tenths in 1..200_u32 {
            // Twice as wide as high: cells of 1 : 2 and of 2 : 1 are as near to squares.
            let height_m = tenths as f32 / 10.0;
            let width_m = (2 * tenths) as f32 / 10.0;
            for off in [-1, 0, 1] {
                let rounded = f32::from_bits(width_m.to_bits().wrapping_add_signed(off));
                assert_eq!(rect_cells([rounded, height_m], 4), [2, 2], "{rounded} × {height_m}");
                assert_eq!(rect_cells([height_m, rounded], 4), [1, 4], "{height_m} × {rounded}");
            }
            assert_eq!(rect_cells([height_m, height_m], 2), [1, 2]);
        }
    }
}
