//! The panel's part on the level of detail.

use egui::{DragValue, Ui};
use lightkiln_proto::relight::{LevelCount, Lod, LodDistance, LodLevel};

use super::panel::slider;
use super::viewer::Viewer;

/// Farthest beginning of a level that is set here, in diagonals of the scene.
const FARTHEST: f32 = 2.0;
/// Largest factor on distances that is set here.
const FACTOR_MAX: f32 = 16.0;

/// Presets, sliders of each level, and the work that is left.
pub fn show(ui: &mut Ui, viewer: &mut Viewer) {
    let counts = viewer.lod_counts();
    let diagonal_m = viewer.diagonal_m();
    let chosen = &mut viewer.edits.lod;
    ui.horizontal(|ui| {
        ui.selectable_value(chosen, None, "all");
        for (name, preset) in Lod::PRESETS {
            ui.selectable_value(chosen, Some(preset), name);
        }
    });
    let Some(lod) = chosen else { return };
    controls(ui, lod, diagonal_m);
    if let Some(counts) = counts {
        work(ui, &counts);
    }
}

fn controls(ui: &mut Ui, lod: &mut Lod, diagonal_m: f32) {
    // An edit keeps levels in order: the rest is refused by the frame, which says why.
    let mut least = 0;
    for (index, level) in lod.levels.iter_mut().enumerate() {
        ui.push_id(index, |ui| {
            if index > 0 {
                let mut diagonals = match level.distance {
                    LodDistance::Diagonals(diagonals) => diagonals,
                    LodDistance::Metres(metres) => metres / diagonal_m,
                };
                let before = diagonals;
                slider(ui, &mut diagonals, 0.0..=FARTHEST, |slider| {
                    slider.text(format!("level {index} from"))
                });
                if diagonals != before {
                    level.distance = LodDistance::Diagonals(diagonals);
                }
            }
            numbers(ui, level);
        });
        level.receivers = level.receivers.max(least);
        least = level.receivers;
    }
    slider(ui, &mut lod.beside, 1.0..=FACTOR_MAX, |slider| slider.text("farther beside the view"));
    slider(ui, &mut lod.behind, 1.0..=FACTOR_MAX, |slider| slider.text("farther behind the eye"));
    lod.behind = lod.behind.max(lod.beside);
    slider(ui, &mut lod.blend, 0.0..=1.0, |slider| slider.text("zone of blending"));
}

fn numbers(ui: &mut Ui, level: &mut LodLevel) {
    let LodLevel { columns, rank, receivers, interval, .. } = level;
    ui.horizontal(|ui| {
        ui.add(DragValue::new(columns).speed(0.05).range(0..=15).prefix("columns ≥ "));
        ui.add(DragValue::new(rank).range(1..=256).prefix("rank "));
        ui.add(DragValue::new(receivers).speed(0.05).range(0..=3).prefix("receivers ≥ "));
        let mut power = interval.max(&mut 1).ilog2();
        if ui.add(DragValue::new(&mut power).speed(0.05).range(0..=4).prefix("every 2^")).changed() {
            *interval = 1 << power.min(4);
        }
    });
}

fn work(ui: &mut Ui, counts: &[LevelCount]) {
    egui::Grid::new("work by level").show(ui, |ui| {
        ui.label("level");
        ui.label("clusters");
        ui.label("receivers computed");
        ui.label("numbers read");
        ui.end_row();
        for (index, count) in counts.iter().enumerate() {
            ui.label(index.to_string());
            ui.label(count.clusters.to_string());
            ui.label(format!("{} of {}", count.receivers_computed, count.receivers));
            ui.label(format!("{:.0} %", 100.0 * count.numbers_read as f64 / count.numbers.max(1) as f64));
            ui.end_row();
        }
    });
}

#[cfg(test)]
mod tests {
    use egui::Context;

    use super::*;

    #[test]
    fn settings_that_are_shown_stay_as_they_are() {
        let metres = LodLevel { distance: LodDistance::Metres(1e4), ..LodLevel::full(LodDistance::NOWHERE) };
        for (name, preset) in Lod::PRESETS {
            let mut wanted = preset;
            (wanted.levels[3].distance, wanted.beside, wanted.behind) = (metres.distance, 20.0, 30.0);
            let mut lod = wanted;
            let ctx = Context::default();
            for _ in 0..3 {
                let mut output = ctx.run_ui(egui::RawInput::default(), |ui| controls(ui, &mut lod, 10.0));
                output.textures_delta.clear();
            }
            assert_eq!(lod, wanted, "{name}");
        }
    }
}
