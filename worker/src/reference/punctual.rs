//! Lights without extent: points, spots and suns (KHR_lights_punctual).

use glam::{DVec3, Vec3};
use lightkiln_proto::scene::{LightKind, SceneLight};

use crate::geometry::Site;

/// Smallest squared distance to a point light, in m².
const NEAREST_M2: f32 = 1e-8;
/// Least width of a spot's soft rim, in radians.
const RIM_MIN_RAD: f32 = 5e-4;

/// A light that is met by no ray.
#[derive(Clone, Copy, Debug)]
pub(super) struct Punctual {
    strength: DVec3,
    pub(super) shape: Shape,
}

#[derive(Clone, Copy, Debug)]
pub(super) enum Shape {
    Lamp { position_m: Vec3, range_m: Option<f32>, cone: Option<Cone> },
    Sun { towards: Vec3 },
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Cone {
    pub direction: Vec3,
    cos_inner: f32,
    pub cos_outer: f32,
}

/// Irradiance that arrives unshadowed, and the place of the light.
#[derive(Clone, Copy, Debug)]
pub(super) struct Arrival {
    /// Irradiance in W·m⁻².
    pub irradiance: DVec3,
    /// Target that must not be hidden.
    pub target: Target,
}

/// The far end of a shadow ray.
#[derive(Clone, Copy, Debug)]
pub(super) enum Target {
    /// A point in metres.
    At(Vec3),
    /// Infinity, in a unit direction.
    Towards(Vec3),
}

impl Punctual {
    /// `None` for skies and rectangles, and for lights without strength.
    pub fn new(light: &SceneLight) -> Option<Self> {
        let strength = Vec3::from(light.strength).as_dvec3();
        let unit = |direction: [f32; 3]| Vec3::from(direction).try_normalize().unwrap_or(Vec3::NEG_Y);
        let shape = match &light.kind {
            LightKind::Point { position_m, range_m } => {
                Shape::Lamp { position_m: (*position_m).into(), range_m: *range_m, cone: None }
            }
            LightKind::Spot { position_m, direction, inner_rad, outer_rad, range_m } => {
                let inner_rad = inner_rad.min(outer_rad - RIM_MIN_RAD).max(0.0);
                let cone = Cone {
                    direction: unit(*direction),
                    cos_inner: libm::cosf(inner_rad),
                    cos_outer: libm::cosf(*outer_rad),
                };
                Shape::Lamp { position_m: (*position_m).into(), range_m: *range_m, cone: Some(cone) }
            }
            LightKind::Sun { direction } => Shape::Sun { towards: -unit(*direction) },
            LightKind::Rect { .. } | LightKind::Sky { .. } => return None,
        };
        (strength.max_element() > 0.0).then_some(Self { strength, shape })
    }

    /// `I cosθ / d²` with the cone's and the range's falloff, or a sun's `E cosθ`; `None` where that is 0.
    pub fn arrival(&self, site: &Site) -> Option<Arrival> {
        let (factor, target) = match self.shape {
            Shape::Sun { towards } => (site.lamp_cosine(towards), Target::Towards(towards)),
            Shape::Lamp { position_m, range_m, cone } => {
                let to_lamp = position_m - site.position_m;
                let squared_m2 = to_lamp.length_squared().max(NEAREST_M2);
                let towards = to_lamp / squared_m2.sqrt();
                let mut factor = site.lamp_cosine(towards) / f64::from(squared_m2);
                if let Some(range_m) = range_m {
                    let share = squared_m2 / (range_m * range_m);
                    factor *= f64::from((1.0 - share * share).clamp(0.0, 1.0));
                }
                if let Some(cone) = cone {
                    factor *= f64::from(cone.falloff(-towards));
                }
                (factor, Target::At(position_m))
            }
        };
        (factor > 0.0).then(|| Arrival { irradiance: self.strength * factor, target })
    }
}

impl Cone {
    /// `clamp((cosθ − cos outer)/(cos inner − cos outer))²`, as KHR_lights_punctual recommends.
    fn falloff(&self, travel: Vec3) -> f32 {
        let share = (self.direction.dot(travel) - self.cos_outer) / (self.cos_inner - self.cos_outer);
        let share = share.clamp(0.0, 1.0);
        share * share
    }
}
