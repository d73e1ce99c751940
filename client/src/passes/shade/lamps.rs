//! Light straight from lamps at a point that is seen; twin of `lamps.wgsl`, function by function.

use std::f32::consts::PI;

use glam::{Vec2, Vec3};

use super::Surface;
use super::specular::{Gloss, mirrored};
use crate::lights::Shape;
use crate::passes::direct::reference::{free_irradiance, lamp_irradiance};
use crate::passes::shadow::look_up::towards;
use crate::passes::shadow::reference::ShadowMaps;
use crate::passes::shadow::{Light, RECT_FACES, ShadowPlan};

/// Irradiance on a mapped normal, of that on the surface's own, at most: none comes from behind. More → bumps at grazing light are as
/// bright as their slope says; less → the surface's own shading shows.
const BENT_MOST: f32 = 8.0;

/// Light of lamps at a point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seen {
    /// Irradiance on the mapped normal in W·m⁻².
    pub irradiance: Vec3,
    /// Radiance that microfacets reflect of it towards the eye, in W·m⁻²·sr⁻¹.
    pub reflected: Vec3,
}

/// Towards the point of a rectangle that is nearest to the mirrored ray, or to its middle.
fn towards_rect(plan: &ShadowPlan, light: &Light, position: Vec3, mirrored: Vec3) -> Vec3 {
    let front = &plan.faces[(light.first_face + RECT_FACES - 1) as usize];
    let (right, up) = (Vec3::from(front.right), Vec3::from(front.up));
    let middle = Vec3::from(light.position) - position;
    let direction = Vec3::from(light.direction);
    let facing = mirrored.dot(direction);
    let far = middle.dot(direction) / facing.min(-1e-4);
    let beside = mirrored * far - middle;
    let half = Vec2::from(light.half_size_m);
    let across = Vec2::new(beside.dot(right), beside.dot(up)).clamp(-half, half);
    let within = if facing < -1e-4 { across } else { Vec2::ZERO };
    (middle + right * within.x + up * within.y).normalize_or(Vec3::Y)
}

fn towards_light(plan: &ShadowPlan, light: &Light, position: Vec3, mirrored: Vec3) -> Vec3 {
    if light.shape == Shape::Rect as u32 {
        return towards_rect(plan, light, position, mirrored);
    }
    towards(light, position)
}

/// Light of all lamps, by cascades where there are some. Shadows are those of `before`, a point a little nearer to the eye.
pub fn seen_light(
    (plan, maps): (&ShadowPlan, &ShadowMaps),
    surface: &Surface,
    before: Vec3,
    gloss: &Gloss,
) -> Seen {
    let mut seen = Seen::default();
    let (position, normal) = (surface.position, surface.towards);
    let is_bent = normal != surface.normal;
    let mirrored = mirrored(gloss.eye, normal);
    for light in &plan.lights {
        let found = lamp_irradiance((plan, maps), light, [position, before], normal, surface.facet);
        let mut arriving = found.truncate();
        if is_bent {
            arriving =
                arriving.min(BENT_MOST * found.w * free_irradiance(plan, light, position, surface.normal));
        }
        seen.irradiance += arriving;
        if gloss.is_specular() {
            let strength = Vec3::from(light.strength).max_element();
            let solid = match light.shape == Shape::Rect as u32 {
                true => found.truncate().max_element() / (4.0 * PI * strength * found.w).max(1e-30),
                false => 0.0,
            };
            let towards = towards_light(plan, light, position, mirrored);
            seen.reflected += arriving * gloss.microfacets(normal, towards, solid);
        }
    }
    seen
}
