//! Lights and cameras of a scene, as the manifest carries them, and stances of objects beside it.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A light that can move at run time (METHOD.md §1, dynamic light), in world space.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SceneLight {
    /// Name in the file, or `light N`.
    pub name: String,
    /// Kind with its own shape.
    pub kind: LightKind,
    /// Linear Rec.709 colour × strength. Point and spot: radiant intensity in W·sr⁻¹. Sun: irradiance on a surface
    /// that faces it, in W·m⁻². Rectangle: radiance in W·m⁻²·sr⁻¹. glTF's candela and lux are read as these radiometric units one to one.
    pub strength: [f32; 3],
}

/// The kinds of dynamic light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case", tag = "type")]
pub enum LightKind {
    /// Shines equally in all directions from a point.
    Point {
        /// Position in metres.
        position_m: [f32; 3],
        /// Distance at which glTF cuts the light off, if it gives one.
        range_m: Option<f32>,
    },
    /// Shines in a cone, smooth between the inner and the outer angle (KHR_lights_punctual).
    Spot {
        /// Position in metres.
        position_m: [f32; 3],
        /// Unit direction of travel.
        direction: [f32; 3],
        /// Half angle inside which the light is full, in radians.
        inner_rad: f32,
        /// Half angle outside which there is none, in radians.
        outer_rad: f32,
        /// Distance at which glTF cuts the light off, if it gives one.
        range_m: Option<f32>,
    },
    /// Parallel light from infinity.
    Sun {
        /// Unit direction of travel (from the sun into the scene).
        direction: [f32; 3],
    },
    /// A rectangle that shines evenly from its front (Lambert), and neither blocks light nor reflects it.
    Rect {
        /// Centre in metres.
        position_m: [f32; 3],
        /// Unit direction along which the front shines.
        direction: [f32; 3],
        /// Direction of the height, as far as it stands across `direction`.
        up: [f32; 3],
        /// Width and height in metres, above 0.
        size_m: [f32; 2],
        /// Points of it that shadows are cast from, 1..=16. More → smoother edges of shadows, more memory and time.
        points: u32,
    },
    /// Radiance from everything outside: a vertical gradient, seen where rays leave the scene.
    /// `strength` scales both colours.
    Sky {
        /// Colour straight up.
        zenith: [f32; 3],
        /// Colour at and below the horizon.
        horizon: [f32; 3],
    },
}

/// A camera in world space.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SceneCamera {
    /// Name in the file, or `camera N`.
    pub name: String,
    /// Eye in metres.
    pub eye_m: [f32; 3],
    /// A point straight ahead, in metres.
    pub target_m: [f32; 3],
    /// Unit up direction.
    pub up: [f32; 3],
    /// Vertical field of view in radians (perspective).
    pub fov_y_rad: f32,
    /// Half height of the view in metres when the camera is orthographic; then `fov_y_rad` is unused.
    pub orthographic_half_height_m: Option<f32>,
}

/// Where an object that moves is: scaled, turned, moved, at a time of an animation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stance {
    /// Place of its origin in metres.
    pub position_m: [f32; 3],
    /// Yaw, pitch and roll in degrees: turns about its y axis, then its own x, then its own z.
    pub turn_deg: [f32; 3],
    /// Factor on its size, above 0.
    pub scale: f32,
    /// Time in its animation, in seconds.
    pub time_s: f32,
    /// Animation, counted from 0.
    pub clip: u32,
    /// Turn about its hinge before all else, as a door swings: yaw, pitch and roll in degrees.
    pub swing_deg: [f32; 3],
    /// Point that stays in place then, in metres of its own space.
    pub hinge_m: [f32; 3],
}

impl Default for Stance {
    fn default() -> Self {
        Self {
            position_m: [0.0; 3],
            turn_deg: [0.0; 3],
            scale: 1.0,
            time_s: 0.0,
            clip: 0,
            swing_deg: [0.0; 3],
            hinge_m: [0.0; 3],
        }
    }
}
