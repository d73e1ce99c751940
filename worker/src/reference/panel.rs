//! Rectangular panels: sampled over their area, and met by rays, which go on behind them.

use glam::{DVec3, Vec3};

use super::lighting::PanelLight;

/// A panel ready to be sampled.
#[derive(Clone, Copy, Debug)]
pub(super) struct Panel {
    centre_m: Vec3,
    half_u_m: Vec3,
    half_v_m: Vec3,
    /// Unit normal of the side that shines.
    normal: Vec3,
    area_m2: f64,
    /// W·m⁻²·sr⁻¹.
    pub radiance: DVec3,
}

/// A point taken on a panel.
#[derive(Clone, Copy, Debug)]
pub(super) struct PanelSample {
    /// Point in metres.
    pub point_m: Vec3,
    /// Unit direction to it.
    pub direction: Vec3,
    /// Density per steradian.
    pub density: f64,
}

impl Panel {
    /// `None` for one that is dark.
    pub fn new(light: &PanelLight) -> Option<Self> {
        let (half_u_m, half_v_m) = (Vec3::from(light.half_u_m), Vec3::from(light.half_v_m));
        let scaled = half_u_m.cross(half_v_m);
        let radiance = Vec3::from(light.radiance).as_dvec3();
        let normal = scaled.try_normalize()?;
        let area_m2 = 4.0 * f64::from(scaled.length());
        let centre_m = light.centre_m.into();
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
    pub fn sample(&self, from_m: Vec3, [u, v]: [f32; 2]) -> Option<PanelSample> {
        let point_m = self.centre_m + self.half_u_m * (2.0 * u - 1.0) + self.half_v_m * (2.0 * v - 1.0);
        let to_panel = point_m - from_m;
        let direction = to_panel.try_normalize()?;
        let density = self.density(direction, f64::from(to_panel.length_squared()))?;
        Some(PanelSample { point_m, direction, density })
    }

    /// Distance at which a ray passes the shining side, and the density with which [`Panel::sample`] takes that point.
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
