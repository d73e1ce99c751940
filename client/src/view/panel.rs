//! The panel: lights, emitters, colours, exposure, overlays, times; and the handles over the picture.

mod lights;

use std::ops::RangeInclusive;
use std::sync::Arc;

use egui::{Color32, Context, DragValue, Pos2, Response, Slider, SliderClamping, Stroke, Ui};

use super::detail;
use super::edits::Edits;
use super::handles::Part;
use super::viewer::Viewer;
use crate::bake::{FULL_COLOUR, Overlay};
use crate::passes::fog::Fog;
use crate::picture::{Exposure, Tone};
use crate::scene::Stance;
use crate::stream::{Baked, Streamed};

/// Radius of a handle in points.
const HANDLE: f32 = 7.0;
/// Stops of exposure either way.
const STOPS: RangeInclusive<f32> = -16.0..=16.0;
/// Densest medium that is set here, per metre.
const FOG_MAX: f32 = 10.0;
/// Farthest turn of a panorama that is set here.
const TURN_MAX_DEG: f32 = 360.0;
/// Largest strength that is set here.
const STRENGTH_MAX: f32 = 1e7;
/// Farthest place of an object along an axis, in metres.
const PLACE_MAX_M: f32 = 1e6;
/// Scales of an object that are set here.
const SCALES: RangeInclusive<f32> = 1e-4..=1e4;
/// Least strength that a colour is told of.
const DARK: f32 = 1e-9;

/// Numbers that the window knows.
#[derive(Clone, Debug, Default)]
pub struct Facts {
    /// Adapter that draws.
    pub drawn_by: String,
    /// Milliseconds from picture to picture, the mean of some.
    pub frame_ms: f32,
    /// Light that has come, of a bake that streams.
    pub streamed: Option<Streamed>,
    /// Notes of the bake.
    pub notes: Vec<String>,
}

/// Things that the user asks the window for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wishes {
    /// The command of this picture on the clipboard.
    pub copies: bool,
    /// The picture in a file.
    pub picture: bool,
}

/// Shows handles, and the panel if it is open.
pub fn show(ctx: &Context, viewer: &mut Viewer, facts: &Facts) -> Wishes {
    let mut wishes = Wishes::default();
    paint_handles(ctx, viewer);
    if viewer.is_panel_open {
        let window =
            egui::Window::new("Lightkiln").default_pos([8.0, 8.0]).default_size([300.0, 640.0]).vscroll(true);
        window.show(ctx, |ui| wishes = contents(ui, viewer, facts));
    }
    wishes
}

fn paint_handles(ctx: &Context, viewer: &Viewer) {
    let painter = ctx.layer_painter(egui::LayerId::background());
    let scale = ctx.pixels_per_point();
    let point = |pixel: glam::Vec2| Pos2::new(pixel.x / scale, pixel.y / scale);
    if let Some(corners) = viewer.outline() {
        let corners = corners.map(point);
        for (at, corner) in corners.iter().enumerate() {
            painter.line_segment([*corner, corners[(at + 1) % 4]], Stroke::new(1.5, Color32::WHITE));
        }
    }
    let handles = viewer.handles();
    for handle in &handles {
        let is_chosen = viewer.chosen == Some(handle.light);
        let Some(light) = viewer.edits.lights.get(handle.light) else { continue };
        let at = point(handle.pixel);
        let rim = Stroke::new(2.0, if is_chosen { Color32::WHITE } else { Color32::from_gray(40) });
        let place = handles.iter().find(|other| other.light == handle.light && other.part == Part::Place);
        if let Some(place) = place.filter(|_| handle.part == Part::Aim) {
            painter.line_segment([point(place.pixel), at], rim);
        }
        painter.circle_filled(at, HANDLE, shown_colour(light.strength));
        painter.circle_stroke(at, HANDLE, rim);
        if handle.part == Part::Sun {
            painter.circle_stroke(at, HANDLE + 4.0, rim);
        }
    }
}

/// The colour of a light at full brightness.
fn shown_colour(strength: [f32; 3]) -> Color32 {
    let [r, g, b] = parts(strength).0;
    egui::Rgba::from_rgb(r, g, b).into()
}

fn contents(ui: &mut Ui, viewer: &mut Viewer, facts: &Facts) -> Wishes {
    let mut wishes = Wishes::default();
    ui.horizontal(|ui| {
        wishes.copies = ui.button("Copy command").on_hover_text("kiln preview … for this picture").clicked();
        wishes.picture = ui.button("Picture (F12)").clicked();
    });
    if let Some(notice) = &viewer.notice {
        ui.label(notice);
    }
    state(ui, viewer, facts);
    section(ui, "Lights", true, |ui| lights::show(ui, viewer));
    if viewer.edits.panorama.is_some() {
        section(ui, "Sky", false, |ui| panorama(ui, &mut viewer.edits));
    }
    section(ui, "Fog", false, |ui| fog(ui, &mut viewer.edits));
    section(ui, "Exposure", false, |ui| exposure(ui, viewer));
    let emitters = viewer.bake().scene.manifest.emitters.iter().map(|emitter| emitter.name.clone());
    let emitters: Vec<String> = emitters.collect();
    if !emitters.is_empty() {
        section(ui, "Lamps of the scene", false, |ui| {
            for (scale, name) in viewer.edits.emitters.iter_mut().zip(emitters) {
                slider(ui, scale, 0.0..=100.0, |slider| slider.logarithmic(true).text(name));
            }
        });
    }
    section(ui, "Materials", false, |ui| materials(ui, &mut viewer.edits));
    if !viewer.edits.objects.is_empty() {
        section(ui, "Objects", true, |ui| objects(ui, &mut viewer.edits));
    }
    section(ui, "Level of detail", false, |ui| detail::show(ui, viewer));
    section(ui, "Overlay", false, |ui| overlay(ui, viewer, facts));
    section(ui, "Times", false, |ui| times(ui, viewer, facts));
    section(ui, "Keys", false, |ui| {
        ui.label("W A S D fly, Q E down and up, right button looks around, wheel changes the speed, shift is faster");
        ui.label(
            "left button drags a light's handle, with shift along the view; Delete removes the chosen light",
        );
        ui.label("Home is the bake's camera, F1 hides this panel, F12 writes a picture");
    });
    wishes
}

fn section(ui: &mut Ui, title: &str, is_open: bool, add: impl FnOnce(&mut Ui)) {
    egui::CollapsingHeader::new(title).default_open(is_open).show(ui, add);
}

fn state(ui: &mut Ui, viewer: &Viewer, facts: &Facts) {
    let settling = viewer.settling();
    let bounces = settling.bounces;
    let change = settling.change.map_or("?".to_owned(), |change| format!("{:.2} %", 100.0 * change));
    ui.label(match settling.is_settled {
        true => format!("light settled after {bounces} bounces"),
        false => format!("bounce {bounces}, the last changed {change}"),
    });
    if let Some(Streamed { bytes, bytes_all, clusters, whole, clusters_all, baked, lost, .. }) =
        facts.streamed
    {
        if let Some(Baked { cells, cells_all }) = baked {
            ui.label(format!(
                "the bake goes on: {cells} of {cells_all} cells baked, elsewhere lights shine directly alone"
            ));
        }
        if lost > 0 {
            ui.label(format!("the server has lost {lost} clusters, which come once they are baked again"));
        }
        let percent = 100.0 * bytes as f64 / bytes_all.max(1) as f64;
        ui.label(format!(
            "{percent:.0} % of the light is here: {clusters} of {clusters_all} clusters, {whole} with all layers"
        ));
    }
    for note in &facts.notes {
        ui.label(note);
    }
}

/// A colour of at most 1, and the factor on it.
fn parts(strength: [f32; 3]) -> ([f32; 3], f32) {
    let most = strength.into_iter().fold(0.0, f32::max);
    if most < DARK { ([1.0; 3], 0.0) } else { (strength.map(|channel| channel / most), most) }
}

/// A slider. A value beyond its range stays until the user changes it.
pub(super) fn slider(
    ui: &mut Ui,
    value: &mut f32,
    range: RangeInclusive<f32>,
    dressed: impl FnOnce(Slider<'_>) -> Slider<'_>,
) {
    let [least, most] = [*range.start(), *range.end()];
    let bare = Slider::new(value, range).clamping(SliderClamping::Edits);
    if ui.add(dressed(bare)).changed() {
        *value = value.clamp(least, most);
    }
}

/// A number to drag. A value beyond its range stays until the user changes it: by arrow keys past the range too, so callers clamp.
fn number(value: &mut f32, speed: f64) -> DragValue<'_> {
    DragValue::new(value).speed(speed).clamp_existing_to_range(false)
}

/// A button of a colour, which stays bit for bit until the user changes it.
fn colour_button(ui: &mut Ui, colour: &mut [f32; 3]) -> Response {
    let mut shown = *colour;
    let response = ui.color_edit_button_rgb(&mut shown);
    if response.changed() {
        *colour = shown;
    }
    response
}

fn place(ui: &mut Ui, place_m: &mut [f32; 3]) {
    ui.horizontal(|ui| {
        for axis in place_m {
            ui.add(number(axis, 0.02).suffix(" m"));
        }
    });
}

fn exposure(ui: &mut Ui, viewer: &mut Viewer) {
    let found = viewer.exposure();
    let edits = &mut viewer.edits;
    let mut is_automatic = matches!(edits.exposure, Exposure::Auto { .. });
    if ui.checkbox(&mut is_automatic, "automatic").changed() {
        edits.exposure = if is_automatic { Exposure::default() } else { Exposure::Fixed(found) };
    }
    match &mut edits.exposure {
        Exposure::Auto { stops } => {
            slider(ui, stops, STOPS, |slider| slider.text("stops above"));
        }
        Exposure::Fixed(factor) => {
            slider(ui, factor, 1e-6..=1e6, |slider| slider.logarithmic(true).text("factor"));
        }
    }
    ui.horizontal(|ui| {
        for (tone, name) in [(Tone::Filmic, "filmic"), (Tone::Reinhard, "reinhard"), (Tone::Linear, "none")] {
            ui.selectable_value(&mut edits.tone, tone, name);
        }
    });
}

/// Turn and strength of the panorama.
fn panorama(ui: &mut Ui, edits: &mut Edits) {
    let Some(shown) = &edits.panorama else { return };
    let [mut turn_deg, mut strength] = [shown.turn_deg(), shown.strength()];
    ui.label(shown.image().name());
    let is_changed = ui.horizontal(|ui| {
        let turned =
            ui.add(number(&mut turn_deg, 0.5).range(-TURN_MAX_DEG..=TURN_MAX_DEG).suffix("° turn")).changed();
        let speed = 0.01 * f64::from(strength.max(0.1));
        let scaled = ui.add(number(&mut strength, speed).range(0.0..=STRENGTH_MAX).prefix("× ")).changed();
        turned || scaled
    });
    if is_changed.inner {
        let turn_deg = turn_deg.clamp(-TURN_MAX_DEG, TURN_MAX_DEG);
        // A strength beyond all measure changes nothing.
        if let Ok(changed) = shown.changed(turn_deg, strength.clamp(0.0, STRENGTH_MAX)) {
            edits.panorama = Some(Arc::new(changed));
        }
    }
}

/// The medium between surfaces: none at a density of 0.
fn fog(ui: &mut Ui, edits: &mut Edits) {
    let mut fog = edits.fog.unwrap_or(Fog { per_m: 0.0, ..Fog::default() });
    slider(ui, &mut fog.per_m, 0.0..=FOG_MAX, |slider| slider.logarithmic(true).text("stopped per metre"));
    slider(ui, &mut fog.albedo, 0.0..=1.0, |slider| slider.text("scattered"));
    slider(ui, &mut fog.g, -0.9..=0.9, |slider| slider.text("forwards"));
    edits.fog = (fog.per_m > 0.0).then_some(fog);
}

fn materials(ui: &mut Ui, edits: &mut Edits) {
    ui.checkbox(&mut edits.details.normal_maps, "normal maps");
    ui.checkbox(&mut edits.details.specular, "specular reflection");
    for colour in &mut edits.colours {
        ui.horizontal(|ui| {
            if colour.is_glass {
                ui.label(format!("{} (glass: its colour is baked)", colour.material));
                return;
            }
            colour_button(ui, &mut colour.now);
            ui.label(&colour.material);
            let is_other = colour.is_given || colour.now != colour.baked;
            if is_other && ui.small_button("as baked").clicked() {
                (colour.now, colour.is_given) = (colour.baked, false);
            }
        });
    }
}

fn objects(ui: &mut Ui, edits: &mut Edits) {
    for (index, object) in edits.objects.iter_mut().enumerate() {
        let length_s = object.length_s;
        let Stance { position_m, turn_deg, scale, time_s, swing_deg, hinge_m, .. } = &mut object.stance;
        ui.push_id(index, |ui| {
            ui.label(format!("{} · {}", index + 1, object.name));
            place(ui, position_m);
            // Words of a command line have no farther places.
            *position_m = position_m
                .map(|axis| if axis.is_nan() { axis } else { axis.clamp(-PLACE_MAX_M, PLACE_MAX_M) });
            ui.horizontal(|ui| {
                for (angle, name) in turn_deg.iter_mut().zip(["° yaw", "° pitch", "° roll"]) {
                    ui.add(number(angle, 0.5).suffix(name));
                }
            });
            // Things that were given a hinge swing.
            if [*swing_deg, *hinge_m] != [[0.0; 3]; 2] {
                ui.horizontal(|ui| {
                    for (angle, name) in swing_deg.iter_mut().zip(["° swing", "° pitch", "° roll"]) {
                        ui.add(number(angle, 0.5).suffix(name));
                    }
                });
            }
            ui.horizontal(|ui| {
                let speed = 0.01 * f64::from(*scale);
                if ui.add(number(scale, speed).range(SCALES).prefix("× ")).changed() {
                    *scale = scale.clamp(*SCALES.start(), *SCALES.end());
                }
                if length_s > 0.0 {
                    if ui.add(number(time_s, 0.02).range(0.0..=length_s).suffix(" s")).changed() {
                        *time_s = time_s.clamp(0.0, length_s);
                    }
                    ui.checkbox(&mut object.plays, "plays");
                }
            });
        });
    }
}

fn overlay(ui: &mut Ui, viewer: &mut Viewer, facts: &Facts) {
    let lights = viewer.error_lights.clone();
    let chosen = &mut viewer.edits.overlay;
    ui.radio_value(chosen, None, "none");
    ui.radio_value(chosen, Some(Overlay::Clusters), "clusters");
    ui.radio_value(chosen, Some(Overlay::Patches), "patches");
    ui.radio_value(
        chosen,
        Some(Overlay::Lod),
        "level of detail: red is the finest, then green, blue, yellow",
    );
    if let Some(Streamed { clusters, .. }) = facts.streamed {
        let residency = Overlay::Residency { clusters };
        let is_chosen = matches!(chosen, Some(Overlay::Residency { .. }));
        if ui.radio(is_chosen, "light that has come: green is here, red is the overview").clicked()
            || is_chosen
        {
            *chosen = Some(residency);
        }
    }
    for (light, name) in lights.iter().enumerate() {
        ui.radio_value(chosen, Some(Overlay::Errors { light }), format!("error under {name}"));
    }
    if let Some(Overlay::Errors { .. }) = chosen {
        legend(ui);
    }
}

/// Colours of errors.
fn legend(ui: &mut Ui) {
    let full = 100.0 * FULL_COLOUR;
    for (colour, words) in [
        (Color32::from_rgb(200, 24, 24), format!("too bright by {full} % of the light's mean or more")),
        (Color32::from_rgb(230, 230, 230), "right".to_owned()),
        (Color32::from_rgb(24, 64, 200), format!("too dark by {full} % or more")),
        (Color32::from_rgb(56, 56, 56), "no place was measured that faces this way".to_owned()),
    ] {
        ui.horizontal(|ui| {
            let (place, _) = ui.allocate_exact_size(egui::vec2(14.0, 14.0), egui::Sense::hover());
            ui.painter().rect_filled(place, 2.0, colour);
            ui.label(words);
        });
    }
    ui.label("each texel as the nearest measured place");
}

fn times(ui: &mut Ui, viewer: &Viewer, facts: &Facts) {
    let ms = facts.frame_ms;
    ui.label(format!("{ms:.1} ms a picture, by {}", facts.drawn_by));
    ui.label(format!("{:.2} m/s of flight", viewer.fly.speed_m()));
    let Some(times) = viewer.pass_times() else {
        ui.label("times of passes: not supported by this adapter");
        return;
    };
    egui::Grid::new("times").show(ui, |ui| {
        for time in times {
            ui.label(time.name);
            ui.label(format!("{:.3} ms", time.last_ms));
            ui.end_row();
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Shows controls for some pictures, without a user.
    pub(super) fn shown(mut add: impl FnMut(&mut Ui)) {
        let ctx = Context::default();
        for _ in 0..3 {
            let mut output = ctx.run_ui(egui::RawInput::default(), &mut add);
            output.textures_delta.clear();
        }
    }

    #[test]
    fn numbers_and_colours_that_are_shown_stay_as_they_are() {
        let (mut stops, mut scale, mut colour) = (-20.0, 250.0, [0.123, 0.7, 0.3]);
        shown(|ui| {
            slider(ui, &mut stops, STOPS, |slider| slider.text("stops above"));
            slider(ui, &mut scale, 0.0..=100.0, |slider| slider.logarithmic(true).text("lamp"));
            colour_button(ui, &mut colour);
        });
        assert_eq!((stops, scale, colour), (-20.0, 250.0, [0.123, 0.7, 0.3]));
    }
}
