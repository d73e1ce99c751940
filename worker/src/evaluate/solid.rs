//! Whether a light stands where light can be: in free space, and under a sky that is seen.

use glam::Vec3;
use lightkiln_proto::rectangle::Rectangle;
use lightkiln_proto::scene::LightKind;

use super::lights::TestLight;
use crate::geometry::Geometry;
use crate::reference::LightingError;
use crate::vantage::Look;

/// Share of directions that meet backs of surfaces beyond which a light stands in a solid.
const BACK_SHARE_MAX: f32 = 0.25;
/// Points along each side of a rectangle whose surroundings are looked at.
const RECT_STEPS: i32 = 2;

/// Errors with the first light that is inside a solid, or whose rectangle is cut by a surface.
pub(super) fn check_place(geometry: &Geometry, light: &TestLight) -> Result<(), LightingError> {
    for lamp in &light.lighting.lights {
        if let LightKind::Point { position_m, .. }
        | LightKind::Spot { position_m, .. }
        | LightKind::Rect { position_m, .. } = &lamp.kind
        {
            check_point(geometry, &light.name, Vec3::from(*position_m))?;
        }
        if Rectangle::of(&lamp.kind).is_some_and(|rectangle| !is_free(geometry, &rectangle)) {
            let problem = "the rectangle passes through a surface; make it smaller or move it";
            return Err(LightingError::new(&light.name, problem));
        }
    }
    Ok(())
}

fn check_point(geometry: &Geometry, name: &str, at_m: Vec3) -> Result<(), LightingError> {
    let look = Look::from(geometry, at_m);
    let words = |at: Vec3| format!("{:.3},{:.3},{:.3}", at.x, at.y, at.z);
    if look.back_share > BACK_SHARE_MAX && look.sky_share == 0.0 {
        let solid = look.inside_of.as_deref().unwrap_or("a solid");
        let problem = format!(
            "it stands inside '{solid}' at {} ({:.0} % of the directions meet backs of surfaces and none leaves the \
             scene); move it into free space",
            words(at_m),
            100.0 * look.back_share
        );
        return Err(LightingError::new(name, problem));
    }
    if look.nearest_m <= 4.0 * geometry.tracer.ray_offset_m(at_m) {
        let problem = format!("it touches a surface at {}; move it off", words(at_m));
        return Err(LightingError::new(name, problem));
    }
    Ok(())
}

/// No surface cuts the rectangle along a grid of lines across it.
pub(super) fn is_free(geometry: &Geometry, rectangle: &Rectangle) -> bool {
    let Rectangle { centre_m, half_u_m: u, half_v_m: v, .. } = *rectangle;
    let free = |from: Vec3, to: Vec3| {
        let hidden = geometry.tracer.is_occluded(from, to) || geometry.tracer.is_occluded(to, from);
        !hidden
    };
    (-RECT_STEPS..=RECT_STEPS).all(|step| {
        let share = step as f32 / RECT_STEPS as f32;
        let (across, along) = (centre_m + v * share, centre_m + u * share);
        free(across - u, across + u) && free(along - v, along + v)
    })
}
