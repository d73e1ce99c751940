//! Rectangular lights: sampled over their area, and met by rays, which go on behind them.

use glam::{DVec3, Vec3};

use lightkiln_proto::rectangle::Rectangle;
use lightkiln_proto::scene::SceneLight;

/// A rectangle ready to be sampled.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rect {
    centre_m: Vec3,
    half_u_m: Vec3,
    half_v_m: Vec3,
    /// Unit normal of the side that shines.
    normal: Vec3,
    area_m2: f64,
    /// W·m⁻²·sr⁻¹.
    pub radiance: DVec3,
}

/// A point taken on a rectangle.
#[derive(Clone, Copy, Debug)]
pub(super) struct RectSample {
    /// Point in metres.
    pub point_m: Vec3,
    /// Unit direction to it.
    pub direction: Vec3,
    /// Density per steradian.
    pub density: f64,
}

impl Rect {
    /// `None` for lights of other kinds, and for one that is dark.
    pub fn new(light: &SceneLight) -> Option<Self> {
        let rectangle = Rectangle::of(&light.kind)?;
        let Rectangle { centre_m, half_u_m, half_v_m, direction: normal } = rectangle;
        let radiance = Vec3::from(light.strength).as_dvec3();
        let area_m2 = f64::from(rectangle.area_m2());
        (radiance.max_element() > 0.0).then_some(Self {
            centre_m,
            half_u_m,
            half_v_m,
            normal,
            area_m2,
            radiance,
        })
    }

    /// A point uniform over the area; `None` seen from behind.
    pub fn sample(&self, from_m: Vec3, [u, v]: [f32; 2]) -> Option<RectSample> {
        let point_m = self.centre_m + self.half_u_m * (2.0 * u - 1.0) + self.half_v_m * (2.0 * v - 1.0);
        let to_rect = point_m - from_m;
        let direction = to_rect.try_normalize()?;
        let density = self.density(direction, f64::from(to_rect.length_squared()))?;
        Some(RectSample { point_m, direction, density })
    }

    /// Distance at which a ray passes the shining side, and the density with which [`Rect::sample`] takes that point.
    pub fn meet(&self, origin_m: Vec3, direction: Vec3, t_max: f32) -> Option<f64> {
        let facing = direction.dot(self.normal);
        if facing >= 0.0 {
            return None;
        }
        let t = (self.centre_m - origin_m).dot(self.normal) / facing;
        if !(t > 0.0 && t < t_max) {
            return None;
        }
        let across = origin_m + direction * t - self.centre_m;
        let inside = |half: Vec3| across.dot(half).abs() <= half.length_squared();
        if !inside(self.half_u_m) || !inside(self.half_v_m) {
            return None;
        }
        self.density(direction, f64::from(t) * f64::from(t))
    }

    /// `d² / (A cosθ)`, per steradian.
    fn density(&self, direction: Vec3, squared_m2: f64) -> Option<f64> {
        let facing = -f64::from(direction.dot(self.normal));
        (facing > 0.0).then(|| squared_m2 / (self.area_m2 * facing))
    }
}
