//! The figures at pixels: as JSON and as a table for people.

use lightkiln_worker::evaluate::{
    DirectShares, Draw, Figures, Hunt, Jumps, Outlier, PixelResult, RelativeRoot, Seams, Step,
};
use serde::Serialize;

use super::table::{ABSENT, Evaluation, energy_words, rmse_words};

/// Texels that stand out which the table names for each light.
const NAMED: usize = 2;

/// Figures at pixels, of one light or of all that count.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct PixelRow {
    /// Errors of E_ind as pictures show it.
    #[serde(flatten)]
    pub figures: Figures,
    /// The part of it that reading between receivers brings, with its interval, if the kind has a lightmap.
    pub interpolation: Option<RelativeRoot>,
    /// Whether E_dir was by the client's shadow maps; of all lights: under any of them.
    pub by_shadow_maps: bool,
    /// Faults of direct light.
    pub direct: Option<DirectShares>,
    /// Jumps across borders.
    pub seams: Option<Seams>,
    /// Texels that stand out; of all lights their counts, the worst by light.
    pub hunt: Option<Hunt>,
    /// Figures of draws of the pixels.
    #[serde(skip)]
    pub draws: Vec<Draw>,
    /// Interpolation's relative squares of them.
    #[serde(skip)]
    pub interpolation_draws: Vec<f64>,
    /// Relative squares of them of direct light's error.
    #[serde(skip)]
    pub direct_draws: Vec<f64>,
}

impl PixelRow {
    /// The row of a result.
    pub fn of(result: &PixelResult) -> Self {
        let shown = &result.shown;
        Self {
            figures: shown.figures,
            interpolation: shown.interpolation,
            by_shadow_maps: result.by_shadow_maps,
            direct: result.direct,
            seams: result.seams.clone(),
            hunt: result.hunt.clone(),
            draws: shown.draws.clone(),
            interpolation_draws: shown.interpolation_draws.clone(),
            direct_draws: result.direct_draws.clone(),
        }
    }

    /// All lights together: shares and jumps are means over the lights that have them, counts are sums.
    pub fn over_lights(rows: &[&Self]) -> Option<Self> {
        let first = rows.first()?;
        let figures: Vec<(Figures, &[Draw])> = rows.iter().map(|row| (row.figures, &row.draws[..])).collect();
        let interpolation: Vec<(RelativeRoot, &[f64])> =
            rows.iter().filter_map(|row| Some((row.interpolation?, &row.interpolation_draws[..]))).collect();
        let hunts = rows.iter().filter_map(|row| row.hunt.as_ref());
        let summed = |sum: Hunt, hunt: &Hunt| Hunt {
            texels: sum.texels + hunt.texels,
            standing_out: sum.standing_out + hunt.standing_out,
            traced: sum.traced + hunt.traced,
            outliers: sum.outliers + hunt.outliers,
            worst: Vec::new(),
        };
        Some(Self {
            figures: Figures::over_lights(&figures),
            interpolation: (!interpolation.is_empty()).then(|| RelativeRoot::over_lights(&interpolation)),
            by_shadow_maps: rows.iter().any(|row| row.by_shadow_maps),
            direct: mean_shares(rows),
            seams: mean_seams(rows),
            hunt: first.hunt.as_ref().map(|_| hunts.fold(Hunt::default(), summed)),
            ..Self::default()
        })
    }

    /// Texels that stand out, if they were looked for.
    pub fn outliers(&self) -> Option<usize> {
        self.hunt.as_ref().map(|hunt| hunt.outliers)
    }
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    if count > 0.0 { sum / count } else { 0.0 }
}

fn mean_shares(rows: &[&PixelRow]) -> Option<DirectShares> {
    let shares: Vec<DirectShares> = rows.iter().filter_map(|row| row.direct).collect();
    let errors: Vec<(RelativeRoot, &[f64])> =
        rows.iter().filter_map(|row| Some((row.direct?.error, &row.direct_draws[..]))).collect();
    let pixels = shares.first()?.pixels;
    let [leak, acne] = [|share: &DirectShares| share.leak, |share: &DirectShares| share.acne]
        .map(|of| mean(shares.iter().map(of)));
    // Draws are of the same places under each light.
    Some(DirectShares { leak, acne, pixels, error: RelativeRoot::over_lights(&errors) })
}

fn mean_seams(rows: &[&PixelRow]) -> Option<Seams> {
    let seams: Vec<&Seams> = rows.iter().filter_map(|row| row.seams.as_ref()).collect();
    let first = seams.first()?;
    let of = |border: fn(&Seams) -> Jumps| Jumps {
        pairs: border(first).pairs,
        mean: mean(seams.iter().map(|seams| border(seams).mean)),
        p95: mean(seams.iter().map(|seams| border(seams).p95)),
    };
    Some(Seams {
        charts: of(|seams| seams.charts),
        blocks: of(|seams| seams.blocks),
        wide: of(|seams| seams.wide),
        clusters: of(|seams| seams.clusters),
        inside: of(|seams| seams.inside),
        worst: Vec::new(),
    })
}

/// The class with its 95 % interval, in %.
pub fn interpolation_words(row: &PixelRow) -> String {
    row.interpolation.map_or(ABSENT.to_owned(), |root| {
        let [low, high] = root.interval_95.map(|end| 100.0 * end);
        format!("{:.1} ({low:.1} to {high:.1}) %", 100.0 * root.rel_rmse)
    })
}

/// Leak and acne shares, in %.
pub fn share_words(row: &PixelRow) -> [String; 2] {
    let words =
        |share: Option<f64>| share.map_or(ABSENT.to_owned(), |share| format!("{:.2} %", 100.0 * share));
    [words(row.direct.map(|direct| direct.leak)), words(row.direct.map(|direct| direct.acne))]
}

/// 95th percentiles of the jumps across borders of charts, blocks and clusters, and inside clusters, in %.
pub fn seam_words(row: &PixelRow) -> [String; 4] {
    let words = |border: fn(&Seams) -> Jumps| {
        let jumps = row.seams.as_ref().map(border).filter(|jumps| jumps.pairs > 0);
        jumps.map_or(ABSENT.to_owned(), |jumps| format!("{:.1} %", 100.0 * jumps.p95))
    };
    [
        words(|seams| seams.charts),
        words(|seams| seams.blocks),
        words(|seams| seams.clusters),
        words(|seams| seams.inside),
    ]
}

/// Texels that stand out, of those that were path-traced.
pub fn outlier_words(row: &PixelRow) -> String {
    row.hunt.as_ref().map_or(ABSENT.to_owned(), |hunt| format!("{} of {}", hunt.outliers, hunt.traced))
}

/// Place and light of a texel that stands out.
pub fn place_words(outlier: &Outlier) -> String {
    let [x, y, z] = outlier.position_m;
    let [column, row] = outlier.texel;
    let Outlier { block, light, around, reference, reference_around, .. } = outlier;
    format!(
        "{x:.2},{y:.2},{z:.2}, texel {column},{row} of '{block}': {light:.3} beside {around:.3} W/m², \
         by paths {reference:.3} beside {reference_around:.3}"
    )
}

/// Place and light of a jump across a border.
pub fn step_words(step: &Step) -> String {
    let [x, y, z] = step.position_m;
    let Step { blocks: [block, other], light: [one, next], reference: [true_one, true_next], .. } = step;
    format!(
        "{x:.2},{y:.2},{z:.2}, border of '{block}' and '{other}': {one:.3} beside {next:.3} W/m², \
         by paths {true_one:.3} beside {true_next:.3}"
    )
}

/// A table for people; nothing where no pixels were measured.
pub fn pixel_words(evaluation: &Evaluation) -> String {
    let Some(all) = &evaluation.pixels else { return String::new() };
    let mut text = format!(
        "\n{:<14} {:>22} {:>21} {:>7} {:>7} {:>7} {:>23} {:>7} {:>7} {:>8} {:>8} {:>8} {:>8} {:>9}\n",
        "at pixels",
        "rel RMSE, 95 %",
        "energy, 95 %",
        "p95",
        "p99",
        ">25 %",
        "interpolation, 95 %",
        "leak",
        "acne",
        "charts",
        "blocks",
        "clusters",
        "inside",
        "outliers",
    );
    let mut line = |name: &str, row: &PixelRow| {
        let [leak, acne] = share_words(row);
        let [charts, blocks, clusters, inside] = seam_words(row);
        text += &format!(
            "{:<14} {:>22} {:>21} {:>5.1} % {:>5.1} % {:>5.1} % {:>23} {leak:>7} {acne:>7} {charts:>8} {blocks:>8} \
             {clusters:>8} {inside:>8} {:>9}\n",
            name,
            rmse_words(&row.figures),
            energy_words(&row.figures),
            100.0 * row.figures.p95,
            100.0 * row.figures.p99,
            100.0 * row.figures.area_above[1],
            interpolation_words(row),
            outlier_words(row),
        );
    };
    for row in &evaluation.lights {
        row.pixels.iter().for_each(|pixels| line(&row.shown_name(), pixels));
    }
    line("all", all);
    let maps = if all.by_shadow_maps {
        "by the client's shadow maps where it has the light"
    } else {
        "by exact rays"
    };
    text += &format!(
        "{} pixels, direct light {maps}; charts, blocks, clusters: 95 % of the jumps across their borders are smaller, \
         inside: those of texels inside clusters; outliers: texels that stand out from their neighbours without the \
         reference doing so, of the worst that were path-traced\n",
        evaluation.pixels_measured,
    );
    for row in &evaluation.lights {
        let Some(direct) = row.pixels.as_ref().and_then(|pixels| pixels.direct) else { continue };
        let [low, high] = direct.error.interval_95.map(|end| 100.0 * end);
        text += &format!(
            "{}: direct light as shown differs from exact rays by {:.1} ({low:.1} to {high:.1}) % of its mean\n",
            row.name,
            100.0 * direct.error.rel_rmse
        );
    }
    for row in &evaluation.lights {
        let worst = row.pixels.iter().flat_map(|pixels| &pixels.hunt).flat_map(|hunt| &hunt.worst);
        worst.take(NAMED).for_each(|outlier| text += &format!("{}: {}\n", row.name, place_words(outlier)));
        let steps = row.pixels.iter().flat_map(|pixels| &pixels.seams).flat_map(|seams| &seams.worst);
        steps.take(NAMED).for_each(|step| text += &format!("{}: {}\n", row.name, step_words(step)));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(interpolation: f64, leak: Option<f64>, outliers: usize) -> PixelRow {
        let root = RelativeRoot { rel_rmse: interpolation, interval_95: [0.0; 2] };
        PixelRow {
            interpolation: Some(root),
            direct: leak.map(|leak| DirectShares { leak, pixels: 10, ..DirectShares::default() }),
            hunt: Some(Hunt { outliers, traced: 64, ..Hunt::default() }),
            draws: vec![Draw::default(); 500],
            interpolation_draws: vec![interpolation * interpolation.abs(); 500],
            direct_draws: vec![0.0; 500],
            ..PixelRow::default()
        }
    }

    #[test]
    fn lights_without_shadow_maps_do_not_thin_out_the_shares_of_those_with() {
        let rows = [row(0.3, Some(0.02), 3), row(-0.1, None, 2)];
        let all = PixelRow::over_lights(&rows.each_ref()).unwrap();
        assert_eq!(all.direct.unwrap().leak, 0.02);
        assert_eq!(all.outliers(), Some(5));
        assert!((all.interpolation.unwrap().rel_rmse - 0.2).abs() < 1e-12, "{:?}", all.interpolation);
        assert_eq!(share_words(&rows[1]), [ABSENT, ABSENT]);
        // In each draw one light's error gains as much as another's loses: together they are sure.
        let direct_row = |squares: [f64; 2]| PixelRow {
            direct: Some(DirectShares {
                error: RelativeRoot { rel_rmse: 0.5_f64.sqrt(), interval_95: squares.map(f64::sqrt) },
                ..DirectShares::default()
            }),
            direct_draws: (0..500).map(|draw| squares[draw % 2]).collect(),
            ..row(0.0, None, 0)
        };
        let rows = [direct_row([0.2, 0.8]), direct_row([0.8, 0.2])];
        let error = PixelRow::over_lights(&rows.each_ref()).unwrap().direct.unwrap().error;
        for found in [error.rel_rmse, error.interval_95[0], error.interval_95[1]] {
            assert!((found - 0.5_f64.sqrt()).abs() < 1e-9, "{error:?}");
        }
        assert!(PixelRow::over_lights(&[]).is_none());
    }
}
