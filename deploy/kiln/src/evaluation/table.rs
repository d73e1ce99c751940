//! The figures of an evaluation: as JSON, whose keys are a contract, and as a table for people.

use indexmap::IndexMap;
use lightkiln_worker::evaluate::{ClusterError, Draw, Figures, LightResult};
use serde::Serialize;

use super::pixels::{PixelRow, pixel_words};

/// Errors relative to the mean of the reference by their class, in the order in which the kind of bake names them.
pub type Classes = IndexMap<&'static str, f64>;

/// A whole evaluation.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Evaluation {
    /// Scene as given, or as the bundle names it.
    pub scene: String,
    /// Places measured at.
    pub receivers: usize,
    /// Root mean square over the lights that count of each error; means of energy ratios. Beside `rel_rmse`, `energy_ratio`,
    /// `p95`, `p99` also per channel.
    #[serde(flatten)]
    pub figures: Figures,
    /// Root mean square over lights of each class.
    pub classes: Classes,
    /// Pixels measured.
    pub pixels_measured: usize,
    /// The same at pixels, if they were measured.
    pub pixels: Option<PixelRow>,
    /// Light by light.
    pub lights: Vec<LightRow>,
    /// Standard error that was asked of the reference.
    pub rel_error: f64,
    /// Share of the lit area where the bake has no answer.
    pub share_without_receiver: f64,
    /// Share of the lit area in cavities that nothing in the open sees, not in `share_without_receiver`.
    pub share_in_cavities: f64,
    /// Units of work, and chunks in them, that were made anew to tell classes of error apart.
    pub units_made_anew: usize,
    /// See `units_made_anew`.
    pub chunks_made_anew: usize,
    /// Chunks of light of the bake.
    pub chunks: usize,
    /// The worst clusters.
    pub worst_clusters: Vec<ClusterError>,
    /// Notes on lights and places that were left out, and why.
    pub notes: Vec<String>,
}

/// One light's figures.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LightRow {
    /// Name.
    pub name: String,
    /// Its type and place, in words.
    pub words: String,
    /// Errors.
    #[serde(flatten)]
    pub figures: Figures,
    /// Errors by class.
    pub classes: Classes,
    /// Figures at pixels, if they were measured.
    pub pixels: Option<PixelRow>,
    /// Bounces until the light changed no more.
    pub bounces: usize,
    /// Whether the light reaches enough places to count among all lights.
    pub counts: bool,
    /// Figures of draws of the places.
    #[serde(skip)]
    pub draws: Vec<Draw>,
}

impl LightRow {
    /// The row of a result.
    pub fn of(result: &LightResult) -> Self {
        Self {
            name: result.light.name.clone(),
            words: result.light.words.clone(),
            figures: result.figures,
            classes: result.classes.iter().map(|class| (class.name, class.rel_rmse)).collect(),
            pixels: result.pixels.as_ref().map(PixelRow::of),
            bounces: result.bounces,
            counts: result.counts,
            draws: result.draws.clone(),
        }
    }
}

impl LightRow {
    /// Its name, in brackets if it does not count.
    pub fn shown_name(&self) -> String {
        if self.counts { self.name.clone() } else { format!("({})", self.name) }
    }
}

/// Figures, classes and pixels of the lights that count, together. A class is over the lights that have it.
pub fn over_lights(rows: &[LightRow]) -> (Figures, Classes, Option<PixelRow>) {
    let rows: Vec<&LightRow> = rows.iter().filter(|row| row.counts).collect();
    let lights: Vec<(Figures, &[Draw])> = rows.iter().map(|row| (row.figures, &row.draws[..])).collect();
    let mut classes: IndexMap<&'static str, (f64, f64)> = IndexMap::new();
    for (name, error) in rows.iter().flat_map(|row| &row.classes) {
        let (squares, count) = classes.entry(name).or_default();
        (*squares, *count) = (*squares + error * error.abs(), *count + 1.0);
    }
    let root = |(name, (squares, count)): (&'static str, (f64, f64))| {
        let mean = squares / count;
        (name, mean.abs().sqrt().copysign(mean))
    };
    let pixels: Vec<&PixelRow> = rows.iter().filter_map(|row| row.pixels.as_ref()).collect();
    (Figures::over_lights(&lights), classes.into_iter().map(root).collect(), PixelRow::over_lights(&pixels))
}

/// The relative error with its 95 % interval, in %.
pub fn rmse_words(figures: &Figures) -> String {
    let [low, high] = figures.interval_95.rel_rmse.map(|end| 100.0 * end);
    format!("{:.2} ({low:.2} to {high:.2}) %", 100.0 * figures.rel_rmse)
}

/// The energy ratio with its 95 % interval.
pub fn energy_words(figures: &Figures) -> String {
    let [low, high] = figures.interval_95.energy_ratio;
    format!("{:.3} ({low:.3} to {high:.3})", figures.energy_ratio)
}

/// Stands for a figure that a light does not have.
pub const ABSENT: &str = "–";

/// A table for people.
pub fn words(evaluation: &Evaluation) -> String {
    let mut text = format!(
        "{:<14} {:>22} {:>21} {:>7} {:>7} {:>7}",
        "light", "rel RMSE, 95 %", "energy, 95 %", "p95", "p99", ">25 %"
    );
    evaluation.classes.keys().for_each(|name| text += &format!(" {name:>13}"));
    text += &format!(" {:>9}\n", "reference");
    let mut line = |name: &str, figures: &Figures, classes: &Classes| {
        text += &format!(
            "{:<14} {:>22} {:>21} {:>5.1} % {:>5.1} % {:>5.1} %",
            name,
            rmse_words(figures),
            energy_words(figures),
            100.0 * figures.p95,
            100.0 * figures.p99,
            100.0 * figures.area_above[1],
        );
        for name in evaluation.classes.keys() {
            let error = classes.get(name).map(|error| format!("{:.2} %", 100.0 * error));
            text += &format!(" {:>13}", error.as_deref().unwrap_or(ABSENT));
        }
        text += &format!(" {:>7.2} %\n", 100.0 * figures.reference_rel_error);
    };
    for row in &evaluation.lights {
        line(&row.shown_name(), &row.figures, &row.classes);
    }
    line("all", &evaluation.figures, &evaluation.classes);
    text += &format!(
        "{} places; {} of {} chunks made anew for classes of error; {:.2} % of the lit area is too small or too \
         deep for the bake; {:.1} % more lies in cavities that nothing in the open sees and was left out\n",
        evaluation.receivers,
        evaluation.chunks_made_anew,
        evaluation.chunks,
        100.0 * evaluation.share_without_receiver,
        100.0 * evaluation.share_in_cavities,
    );
    text + &pixel_words(evaluation)
}
