//! Lights of the panel: their list, colours, places, directions, sizes.

use std::ops::RangeInclusive;

use egui::{DragValue, Ui};
use glam::Vec3;
use lightkiln_proto::rectangle::RECT_POINTS_MAX;
use lightkiln_proto::scene::{LightKind, SceneLight};

use super::{STRENGTH_MAX, colour_button, number, parts, place};
use crate::view::edits::new_light;
use crate::view::viewer::Viewer;

/// Largest elevation in degrees that is set here: straight up has no azimuth.
const ELEVATION_MAX: f32 = 89.9;
/// Sides of a rectangle that are set here, in metres.
const SIDES_M: RangeInclusive<f32> = 1e-3..=1e4;

/// Lights with their controls.
pub fn show(ui: &mut Ui, viewer: &mut Viewer) {
    let mut removed = None;
    for index in 0..viewer.edits.lights.len() {
        let is_chosen = viewer.chosen == Some(index);
        let light = &mut viewer.edits.lights[index];
        ui.push_id(index, |ui| {
            ui.horizontal(|ui| {
                let name = format!("{} · {}", kind_of(light), light.name);
                if ui.selectable_label(is_chosen, name).clicked() {
                    viewer.chosen = (!is_chosen).then_some(index);
                }
                if ui.small_button("remove").clicked() {
                    removed = Some(index);
                }
            });
            controls(ui, light);
        });
    }
    if let Some(index) = removed {
        viewer.chosen = Some(index);
        viewer.remove_chosen();
    }
    ui.horizontal(|ui| {
        ui.label("add");
        for kind in ["point", "spot", "sun", "rect", "sky"] {
            if ui.small_button(kind).clicked() {
                let (place_m, diagonal_m) = (viewer.place_ahead_m(), viewer.diagonal_m());
                viewer.chosen = Some(viewer.edits.lights.len());
                let number = viewer.edits.lights.len() + 1;
                viewer.edits.lights.push(new_light(kind, number, place_m, diagonal_m));
            }
        }
    });
}

fn controls(ui: &mut Ui, light: &mut SceneLight) {
    let unit = match light.kind {
        LightKind::Point { .. } | LightKind::Spot { .. } => " W/sr",
        LightKind::Sun { .. } => " W/m²",
        LightKind::Rect { .. } => " W/m²/sr",
        LightKind::Sky { .. } => " ×",
    };
    ui.horizontal(|ui| {
        if let LightKind::Sky { zenith, horizon } = &mut light.kind {
            colour_button(ui, zenith).on_hover_text("straight up");
            colour_button(ui, horizon).on_hover_text("at the horizon");
        }
        let (mut colour, mut factor) = parts(light.strength);
        let mut is_changed = match light.kind {
            LightKind::Sky { .. } => false,
            // A light that is off has a colour again when it is on.
            _ => factor > 0.0 && colour_button(ui, &mut colour).changed(),
        };
        let speed = 0.01 * f64::from(factor.max(0.1));
        if ui.add(number(&mut factor, speed).range(0.0..=STRENGTH_MAX).suffix(unit)).changed() {
            factor = factor.clamp(0.0, STRENGTH_MAX);
            is_changed = true;
        }
        if is_changed {
            light.strength = colour.map(|channel| channel * factor);
        }
    });
    match &mut light.kind {
        LightKind::Point { position_m, .. } => place(ui, position_m),
        LightKind::Spot { position_m, direction, inner_rad, outer_rad, .. } => {
            place(ui, position_m);
            angles(ui, direction);
            cone(ui, inner_rad, outer_rad);
        }
        LightKind::Sun { direction } => angles(ui, direction),
        LightKind::Rect { position_m, direction, size_m, points, .. } => {
            place(ui, position_m);
            angles(ui, direction);
            sides(ui, size_m, points);
        }
        LightKind::Sky { .. } => {}
    }
}

fn cone(ui: &mut Ui, inner_rad: &mut f32, outer_rad: &mut f32) {
    ui.horizontal(|ui| {
        ui.label("cone");
        let inner = ui.drag_angle(inner_rad).changed();
        let outer = ui.drag_angle(outer_rad).changed();
        if inner || outer {
            *outer_rad = outer_rad.clamp(0.002, std::f32::consts::FRAC_PI_2);
            *inner_rad = inner_rad.clamp(0.0, *outer_rad);
        }
    });
}

/// Width and height, and the points that shadows are cast from.
fn sides(ui: &mut Ui, size_m: &mut [f32; 2], points: &mut u32) {
    ui.horizontal(|ui| {
        for side in size_m {
            let speed = 0.01 * f64::from(*side);
            if ui.add(number(side, speed).range(SIDES_M).suffix(" m")).changed() {
                *side = side.clamp(*SIDES_M.start(), *SIDES_M.end());
            }
        }
        ui.add(DragValue::new(points).speed(0.05).range(1..=RECT_POINTS_MAX).suffix(" points"));
    });
}

/// A direction as the place in the sky that light comes from: azimuth and elevation.
fn angles(ui: &mut Ui, direction: &mut [f32; 3]) {
    let from = -Vec3::from(*direction).normalize_or(Vec3::NEG_Y);
    let mut azimuth = from.x.atan2(from.z).to_degrees();
    let mut elevation = from.y.clamp(-1.0, 1.0).asin().to_degrees();
    ui.horizontal(|ui| {
        let range = -ELEVATION_MAX..=ELEVATION_MAX;
        let around = ui.add(number(&mut azimuth, 0.5).suffix("° around")).changed();
        let up = ui.add(number(&mut elevation, 0.5).range(range).suffix("° up")).changed();
        if around || up {
            // An edit ends below straight up, where an azimuth counts.
            elevation = elevation.clamp(-ELEVATION_MAX, ELEVATION_MAX);
            let (azimuth, elevation) = (azimuth.to_radians(), elevation.to_radians());
            let level = elevation.cos();
            let from = Vec3::new(level * azimuth.sin(), elevation.sin(), level * azimuth.cos());
            *direction = (-from).into();
        }
    });
}

fn kind_of(light: &SceneLight) -> &'static str {
    match light.kind {
        LightKind::Point { .. } => "point",
        LightKind::Spot { .. } => "spot",
        LightKind::Sun { .. } => "sun",
        LightKind::Rect { .. } => "rect",
        LightKind::Sky { .. } => "sky",
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::shown;
    use super::*;
    use crate::lights::parse_light;

    #[test]
    fn lights_that_are_shown_stay_as_they_are() {
        let mut steep = parse_light("spot pos=1,2,3 dir=0,-1,0 power=5").unwrap();
        if let LightKind::Spot { inner_rad, outer_rad, .. } = &mut steep.kind {
            (*inner_rad, *outer_rad) = (0.0, 1e-4);
        }
        let mut bright = parse_light("sun dir=0,-1,0 irradiance=3").unwrap();
        bright.strength = [3e8, 0.3, 1.0 / 3.0];
        let sky = parse_light("sky zenith=0.1,0.7,0.3 horizon=0.3,0.123,0.7 strength=0.7").unwrap();
        let rect = parse_light("rect pos=1,2,3 dir=0,-1,0 size=0.0001,0.3 strength=1,2,3 points=7").unwrap();
        for wanted in [steep, bright, sky, rect] {
            let mut light = wanted.clone();
            shown(|ui| controls(ui, &mut light));
            assert_eq!(light, wanted);
        }
    }
}
