//! The figures of an evaluation: as JSON, whose keys are a contract, and as a table for people.

use indexmap::IndexMap;
use lightkiln_worker::evaluate::{ClusterError, Figures, LightResult};
use serde::Serialize;

/// Errors relative to the mean of the reference by their class, in the order in which the kind of bake names them.
pub type Classes = IndexMap<&'static str, f64>;

/// A whole evaluation.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Evaluation {
    /// Scene as given, or as the bundle names it.
    pub scene: String,
    /// Places measured at.
    pub receivers: usize,
    /// Root mean square over lights of each error; means over lights of energy ratios. Beside `rel_rmse`, `energy_ratio`,
    /// `p95`, `p99` also per channel.
    #[serde(flatten)]
    pub figures: Figures,
    /// Root mean square over lights of each class.
    pub classes: Classes,
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
    /// Bounces until the light changed no more.
    pub bounces: usize,
}

impl LightRow {
    /// The row of a result.
    pub fn of(result: &LightResult) -> Self {
        Self {
            name: result.light.name.clone(),
            words: result.light.words.clone(),
            figures: result.figures,
            classes: result.classes.iter().map(|class| (class.name, class.rel_rmse)).collect(),
            bounces: result.bounces,
        }
    }
}

/// Root mean square over lights of errors, mean of ratios.
pub fn over_lights(rows: &[LightRow]) -> (Figures, Classes) {
    let count = rows.len().max(1) as f64;
    let mean = |of: &dyn Fn(&LightRow) -> f64| rows.iter().map(of).sum::<f64>() / count;
    let root = |of: &dyn Fn(&LightRow) -> f64| mean(&|row| of(row).powi(2)).sqrt();
    let figures = Figures {
        rel_rmse: root(&|row| row.figures.rel_rmse),
        energy_ratio: mean(&|row| row.figures.energy_ratio),
        p95: root(&|row| row.figures.p95),
        p99: root(&|row| row.figures.p99),
        channels: [0, 1, 2].map(|c| root(&|row| row.figures.channels[c])),
        channel_energy_ratios: [0, 1, 2].map(|c| mean(&|row| row.figures.channel_energy_ratios[c])),
        reference_rel_error: root(&|row| row.figures.reference_rel_error),
        mean_irradiance: mean(&|row| row.figures.mean_irradiance),
    };
    let of_class =
        |name: &'static str| (name, root(&|row| row.classes.get(name).copied().unwrap_or_default()));
    let names = rows.first().into_iter().flat_map(|row| row.classes.keys().copied());
    (figures, names.map(of_class).collect())
}

/// A table for people.
pub fn words(evaluation: &Evaluation) -> String {
    let mut text = format!("{:<14} {:>8} {:>7} {:>7} {:>7}", "light", "rel RMSE", "energy", "p95", "p99");
    evaluation.classes.keys().for_each(|name| text += &format!(" {name:>13}"));
    text += &format!(" {:>9}\n", "reference");
    let mut line = |name: &str, figures: &Figures, classes: &Classes| {
        text += &format!(
            "{:<14} {:>6.2} % {:>7.3} {:>5.1} % {:>5.1} %",
            name,
            100.0 * figures.rel_rmse,
            figures.energy_ratio,
            100.0 * figures.p95,
            100.0 * figures.p99,
        );
        classes.values().for_each(|error| text += &format!(" {:>11.2} %", 100.0 * error));
        text += &format!(" {:>7.2} %\n", 100.0 * figures.reference_rel_error);
    };
    for row in &evaluation.lights {
        line(&row.name, &row.figures, &row.classes);
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
    text
}
