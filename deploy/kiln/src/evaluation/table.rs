//! The figures of an evaluation: as JSON, whose keys are a contract, and as a table for people.

use lightkiln_worker::evaluate::{Classes, ClusterError, Figures, LightResult};
use serde::Serialize;

/// A whole evaluation.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Evaluation {
    /// Scene as given, or as the bundle names it.
    pub scene: String,
    /// Receivers measured at.
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
    /// Share of the lit area that has no receiver.
    pub share_without_receiver: f64,
    /// Share of the lit area in cavities that nothing in the open sees, not in `share_without_receiver`.
    pub share_in_cavities: f64,
    /// Cluster cells, and clusters, whose factors were made anew to tell factorisation from quantisation.
    pub cells_made_anew: usize,
    /// See `cells_made_anew`.
    pub clusters_made_anew: usize,
    /// Clusters of the bake.
    pub clusters: usize,
    /// The worst clusters.
    pub worst_clusters: Vec<ClusterError>,
    /// What was left out, and why.
    pub notes: Vec<String>,
}

/// One light's figures.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LightRow {
    /// Name.
    pub name: String,
    /// What it is and where.
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
            classes: result.classes,
            bounces: result.settled.bounces,
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
    let classes = Classes {
        transport: root(&|row| row.classes.transport),
        factorisation: root(&|row| row.classes.factorisation),
        quantisation: root(&|row| row.classes.quantisation),
    };
    (figures, classes)
}

/// A table for people.
pub fn words(evaluation: &Evaluation) -> String {
    let mut text = format!(
        "{:<14} {:>8} {:>7} {:>7} {:>7} {:>9} {:>9} {:>9} {:>9}\n",
        "light", "rel RMSE", "energy", "p95", "p99", "transport", "factors", "quantised", "reference"
    );
    let mut line = |name: &str, figures: &Figures, classes: &Classes| {
        text += &format!(
            "{:<14} {:>6.2} % {:>7.3} {:>5.1} % {:>5.1} % {:>7.2} % {:>7.2} % {:>7.2} % {:>7.2} %\n",
            name,
            100.0 * figures.rel_rmse,
            figures.energy_ratio,
            100.0 * figures.p95,
            100.0 * figures.p99,
            100.0 * classes.transport,
            100.0 * classes.factorisation,
            100.0 * classes.quantisation,
            100.0 * figures.reference_rel_error,
        );
    };
    for row in &evaluation.lights {
        line(&row.name, &row.figures, &row.classes);
    }
    line("all", &evaluation.figures, &evaluation.classes);
    text += &format!(
        "{} receivers; {} of {} clusters made anew for factors; {:.2} % of the lit area is too small or \
         too deep for receivers; {:.1} % more lies in cavities that nothing in the open sees and was left out\n",
        evaluation.receivers,
        evaluation.clusters_made_anew,
        evaluation.clusters,
        100.0 * evaluation.share_without_receiver,
        100.0 * evaluation.share_in_cavities,
    );
    text
}
