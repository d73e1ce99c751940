//! Whether a light stands where light can be: in free space, and under a sky that is seen.

use glam::Vec3;
use lightkiln_proto::scene::LightKind;
use lightkiln_proto::sh::relight_direction;

use super::lights::TestLight;
use crate::prt::World;
use crate::reference::{LightingError, PanelLight};

/// Rays that look around a light.
const LOOK_RAYS: u32 = 256;
/// Points along each side of a panel whose surroundings are looked at.
const PANEL_STEPS: i32 = 2;

/// What a look around a point met.
pub(super) struct Look {
    /// Share of rays that met backs of single-sided surfaces.
    pub back_share: f32,
    /// A ray left the scene.
    pub escapes: bool,
    /// Distance to the nearest surface in metres.
    pub nearest_m: f32,
    /// Mean distance seen in metres; rays that leave the scene see nothing.
    pub mean_m: f32,
    /// Name of the surface with the nearest back.
    pub inside_of: Option<String>,
}

/// Looks around from a point.
pub(super) fn look(world: &World, from_m: Vec3) -> Look {
    let mut look =
        Look { back_share: 0.0, escapes: false, nearest_m: f32::INFINITY, mean_m: 0.0, inside_of: None };
    let mut nearest_back_m = f32::INFINITY;
    for ray in 0..LOOK_RAYS {
        let direction = relight_direction(ray, LOOK_RAYS);
        let Some(hit) = world.geometry.tracer.closest(from_m, direction, f32::INFINITY) else {
            look.escapes = true;
            continue;
        };
        look.nearest_m = look.nearest_m.min(hit.t);
        look.mean_m += hit.t / LOOK_RAYS as f32;
        if !world.is_back(&hit) {
            continue;
        }
        look.back_share += 1.0 / LOOK_RAYS as f32;
        if hit.t < nearest_back_m {
            nearest_back_m = hit.t;
            let instance = world.geometry.triangles[hit.triangle as usize].instance;
            look.inside_of = Some(world.scene.instances[instance as usize].path.clone());
        }
    }
    look
}

/// Errors with the first light that is inside a solid, or whose panel is cut by a surface.
pub(super) fn check_place(
    world: &World,
    light: &TestLight,
    back_share_max: f32,
) -> Result<(), LightingError> {
    for lamp in &light.lighting.lights {
        if let LightKind::Point { position_m, .. } | LightKind::Spot { position_m, .. } = &lamp.kind {
            check_point(world, &light.name, Vec3::from(*position_m), back_share_max)?;
        }
    }
    light.lighting.panels.iter().try_for_each(|panel| {
        check_point(world, &light.name, panel.centre_m.into(), back_share_max)?;
        if is_free(world, panel) {
            return Ok(());
        }
        let problem = "the panel passes through a surface; make it smaller or move it";
        Err(LightingError::new(&light.name, problem))
    })
}

fn check_point(world: &World, name: &str, at_m: Vec3, back_share_max: f32) -> Result<(), LightingError> {
    let look = look(world, at_m);
    let words = |at: Vec3| format!("{:.3},{:.3},{:.3}", at.x, at.y, at.z);
    if look.back_share > back_share_max && !look.escapes {
        let solid = look.inside_of.as_deref().unwrap_or("a solid");
        let problem = format!(
            "it stands inside '{solid}' at {} ({:.0} % of the directions meet backs of surfaces and none leaves the \
             scene); move it into free space",
            words(at_m),
            100.0 * look.back_share
        );
        return Err(LightingError::new(name, problem));
    }
    if look.nearest_m <= 4.0 * world.geometry.tracer.ray_offset_m() {
        let problem = format!("it touches a surface at {}; move it off", words(at_m));
        return Err(LightingError::new(name, problem));
    }
    Ok(())
}

/// No surface cuts the rectangle along a grid of lines across it.
pub(super) fn is_free(world: &World, panel: &PanelLight) -> bool {
    let [centre_m, u, v] = [panel.centre_m, panel.half_u_m, panel.half_v_m].map(Vec3::from);
    let free = |from: Vec3, to: Vec3| {
        let hidden =
            world.geometry.tracer.is_occluded(from, to) || world.geometry.tracer.is_occluded(to, from);
        !hidden
    };
    (-PANEL_STEPS..=PANEL_STEPS).all(|step| {
        let share = step as f32 / PANEL_STEPS as f32;
        let (across, along) = (centre_m + v * share, centre_m + u * share);
        free(across - u, across + u) && free(along - v, along + v)
    })
}
