//! The sky as bakes are lit by it.

use glam::Vec3;

use crate::scene::{LightKind, SceneLight};

/// Radiance from outside, `mix(horizon, zenith, max(ω_y, 0))`, W·m⁻²·sr⁻¹, y up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sky {
    /// Radiance straight up.
    pub zenith: Vec3,
    /// Radiance at and below the horizon.
    pub horizon: Vec3,
}

impl Sky {
    /// Sum of the skies among `lights`; black when there is none.
    pub fn of(lights: &[SceneLight]) -> Self {
        let mut sum = Self::default();
        for light in lights {
            if let LightKind::Sky { zenith, horizon } = &light.kind {
                sum.zenith += Vec3::from(*zenith) * Vec3::from(light.strength);
                sum.horizon += Vec3::from(*horizon) * Vec3::from(light.strength);
            }
        }
        sum
    }

    /// Radiance that arrives from unit direction `towards_sky`.
    pub fn radiance(&self, towards_sky: Vec3) -> Vec3 {
        self.horizon.lerp(self.zenith, towards_sky.y.clamp(0.0, 1.0))
    }
}
