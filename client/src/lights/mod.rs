//! Lights and cameras of a view: words of the command line, the bake's own, and the light that each sends.

mod framing;
mod panorama;
mod words;

use std::f32::consts::FRAC_PI_2;

use glam::Vec3;
use lightkiln_proto::rectangle::{RECT_POINTS_MAX, Rectangle, rect_cells};
use lightkiln_proto::scene::{LightKind, SceneLight};

use crate::error::{ClientError, Result};

pub use framing::{camera_of, lights_of};
pub use lightkiln_proto::relight::{Panorama, Sky};
pub use panorama::read_panorama;
pub use words::{ParsedLights, parse_camera, parse_light, parse_lights, quoted};

/// A light that casts shadows, ready for the direct pass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Caster {
    /// Position in metres, of a rectangle its centre; unused for suns.
    pub position: Vec3,
    /// Unit direction of travel; unused for points.
    pub direction: Vec3,
    /// Intensity in W·sr⁻¹; irradiance in W·m⁻² for suns; radiance in W·m⁻²·sr⁻¹ for rectangles.
    pub strength: Vec3,
    /// Cut-off distance in metres; 0 when there is none.
    pub range: f32,
    /// Cosines of the spot's inner and outer half angle.
    pub cone: [f32; 2],
    /// Vector along a rectangle's width, of half its length, in metres.
    pub half_u_m: Vec3,
    /// Vector along its height, likewise.
    pub half_v_m: Vec3,
    /// Columns and rows of its cells, each with a point in its middle that shadows are cast from.
    pub cells: [u32; 2],
    /// Which.
    pub shape: Shape,
}

/// Shapes of a [`Caster`]; the numbers are the shaders'.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// All around.
    Point = 0,
    /// A cone.
    Spot = 1,
    /// Parallel.
    Sun = 2,
    /// A rectangle.
    Rect = 3,
}

impl Caster {
    /// The casters among `lights`, in order; those without strength are left out.
    pub fn of(lights: &[SceneLight]) -> Vec<Self> {
        lights
            .iter()
            .filter_map(Self::from_light)
            .filter(|caster| caster.strength.max_element() > 0.0)
            .collect()
    }

    fn from_light(light: &SceneLight) -> Option<Self> {
        let strength = Vec3::from(light.strength);
        let blank = Self {
            position: Vec3::ZERO,
            direction: Vec3::NEG_Y,
            strength,
            range: 0.0,
            cone: [-1.0, -2.0],
            half_u_m: Vec3::ZERO,
            half_v_m: Vec3::ZERO,
            cells: [0; 2],
            shape: Shape::Point,
        };
        Some(match &light.kind {
            LightKind::Point { position_m, range_m } => {
                Self { position: (*position_m).into(), range: range_m.unwrap_or(0.0), ..blank }
            }
            LightKind::Spot { position_m, direction, inner_rad, outer_rad, range_m } => {
                let outer = outer_rad.clamp(1e-3, FRAC_PI_2);
                let inner = inner_rad.clamp(0.0, outer - 5e-4);
                Self {
                    position: (*position_m).into(),
                    direction: Vec3::from(*direction).try_normalize().unwrap_or(Vec3::NEG_Y),
                    range: range_m.unwrap_or(0.0),
                    cone: [inner.cos(), outer.cos()],
                    shape: Shape::Spot,
                    ..blank
                }
            }
            LightKind::Sun { direction } => Self {
                direction: Vec3::from(*direction).try_normalize().unwrap_or(Vec3::NEG_Y),
                shape: Shape::Sun,
                ..blank
            },
            LightKind::Rect { size_m, points, .. } => {
                let rectangle = Rectangle::of(&light.kind)?;
                Self {
                    position: rectangle.centre_m,
                    direction: rectangle.direction,
                    half_u_m: rectangle.half_u_m,
                    half_v_m: rectangle.half_v_m,
                    cells: rect_cells(*size_m, *points),
                    shape: Shape::Rect,
                    ..blank
                }
            }
            LightKind::Sky { .. } => return None,
        })
    }
}

/// Errs where a light has a number that none can have.
pub(crate) fn check_lights(lights: &[SceneLight]) -> Result<()> {
    let finite = |light: &SceneLight| {
        let position_ok = match &light.kind {
            LightKind::Point { position_m, .. } | LightKind::Spot { position_m, .. } => {
                position_m.iter().all(|value| value.is_finite())
            }
            LightKind::Sun { .. } => true,
            LightKind::Rect { position_m, points, .. } => {
                let is_rectangle = Rectangle::of(&light.kind).is_some();
                is_rectangle
                    && position_m.iter().all(|value| value.is_finite())
                    && (1..=RECT_POINTS_MAX).contains(points)
            }
            LightKind::Sky { zenith, horizon } => {
                zenith.iter().chain(horizon).all(|value| value.is_finite() && *value >= 0.0)
            }
        };
        position_ok && light.strength.iter().all(|value| value.is_finite() && *value >= 0.0)
    };
    match lights.iter().find(|light| !finite(light)) {
        Some(light) => Err(ClientError::Argument {
            what: format!("light '{}'", light.name),
            problem: "has a number that is negative or not finite, or a rectangle without direction, area or 1 to 16 points".to_owned(),
        }),
        None => Ok(()),
    }
}

/// Errs where a factor on emitters is none that they can have.
pub(crate) fn check_scale(scale: &[f32]) -> Result<()> {
    match scale.iter().find(|scale| !scale.is_finite() || **scale < 0.0) {
        Some(scale) => Err(ClientError::Argument {
            what: format!("scale {scale} of emitters"),
            problem: "is negative or not finite".to_owned(),
        }),
        None => Ok(()),
    }
}
