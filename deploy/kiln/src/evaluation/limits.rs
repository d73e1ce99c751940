//! `--fail-if 'rel_rmse>0.08'`: limits that an evaluation is held to.

use std::str::FromStr;

use lightkiln_worker::evaluate::PIXEL_CLASSES;

use super::pixels::PixelRow;
use super::table::Evaluation;
use crate::console::say;
use crate::failure::{Exit, Failure, Result};

/// Figures that a limit may name, beside the classes of error of a kind of bake.
const FIGURES: [&str; 17] = [
    "rel_rmse",
    "energy_ratio",
    "p95",
    "p99",
    "reference_rel_error",
    "share_without_receiver",
    "share_in_cavities",
    "pixel_rel_rmse",
    "pixel_energy_ratio",
    "pixel_p95",
    "pixel_p99",
    "leak",
    "acne",
    "chart_seams",
    "block_seams",
    "cluster_seams",
    "outliers",
];

/// When to fail: `FIGURE<NUMBER`, of all lights together, or `LIGHT.FIGURE<NUMBER` of one.
#[derive(Clone, Debug)]
pub struct Limit {
    text: String,
    light: Option<String>,
    figure: String,
    /// Whether a value breaks the limit, by its bound.
    is_broken: fn(&f64, &f64) -> bool,
    bound: f64,
}

impl FromStr for Limit {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let at = text.find(['<', '>']).ok_or("write FIGURE>NUMBER or FIGURE<NUMBER, e.g. rel_rmse>0.08")?;
        let (left, right) = text.split_at(at);
        let (is_broken, number): (fn(&f64, &f64) -> bool, _) = match right.as_bytes() {
            [b'>', b'=', ..] => (f64::ge, &right[2..]),
            [b'<', b'=', ..] => (f64::le, &right[2..]),
            [b'>', ..] => (f64::gt, &right[1..]),
            _ => (f64::lt, &right[1..]),
        };
        let bound: f64 = number.trim().parse().map_err(|_| format!("'{}' is no number", number.trim()))?;
        if !bound.is_finite() {
            return Err(format!("'{}' is no finite number", number.trim()));
        }
        let left = left.trim();
        let (light, name) = match left.rsplit_once('.') {
            Some((light, name)) => (Some(light.to_owned()), name),
            None => (None, left),
        };
        Ok(Self { text: text.trim().to_owned(), light, figure: name.to_owned(), is_broken, bound })
    }
}

impl Limit {
    /// Errs unless the limit names a figure or one of `classes`.
    pub fn check_figure(&self, classes: &[&str]) -> Result<()> {
        self.check_among(&[&FIGURES, classes].concat())
    }

    /// Errs unless the limit names one of those figures.
    pub fn check_among(&self, figures: &[&str]) -> Result<()> {
        let mut known = figures.iter();
        if known.clone().any(|figure| *figure == self.figure) {
            return Ok(());
        }
        let names = known.by_ref().copied().collect::<Vec<_>>().join(", ");
        let what = format!("--fail-if '{}' names no figure", self.text);
        Err(Failure::bad_input(what).try_this(format!("one of {names}")))
    }

    /// The figure that it names.
    pub fn figure(&self) -> &str {
        &self.figure
    }

    /// The light that it names, if it names one, by names and whether they count; errs when none that counts has the name.
    pub fn light_among<'a, T>(
        &self,
        lights: &'a [T],
        named: impl Fn(&'a T) -> (&'a str, bool),
    ) -> Result<Option<&'a T>> {
        let Some(wanted) = &self.light else { return Ok(None) };
        let Some(light) = lights.iter().find(|light| named(light).0 == wanted) else {
            let names: Vec<&str> = lights.iter().map(|light| named(light).0).collect();
            let what = format!("--fail-if '{}' names a light that was not measured", self.text);
            return Err(Failure::bad_input(what).try_this(format!("one of {}", names.join(", "))));
        };
        if !named(light).1 {
            let what = format!("--fail-if '{}' names a light that reaches too few places", self.text);
            return Err(Failure::bad_input(what).try_this("more --receivers, or another light"));
        }
        Ok(Some(light))
    }

    /// The figure's value and the ends of its interval, or the value for both; errs when no light has the name, or the bake
    /// no such class of error.
    fn value(&self, evaluation: &Evaluation) -> Result<(f64, [f64; 2])> {
        let light = self.light_among(&evaluation.lights, |row| (&row.name, row.counts))?;
        let (figures, classes, pixels) = match light {
            None => (&evaluation.figures, &evaluation.classes, &evaluation.pixels),
            Some(row) => (&row.figures, &row.classes, &row.pixels),
        };
        if let Some(found) = pixels.as_ref().and_then(|pixels| self.at_pixels(pixels)) {
            return Ok(found);
        }
        let interval = &figures.interval_95;
        let exact = match self.figure.as_str() {
            "rel_rmse" => return Ok((figures.rel_rmse, interval.rel_rmse)),
            "energy_ratio" => return Ok((figures.energy_ratio, interval.energy_ratio)),
            "p95" => return Ok((figures.p95, interval.p95)),
            "p99" => return Ok((figures.p99, interval.p99)),
            "share_without_receiver" => evaluation.share_without_receiver,
            "share_in_cavities" => evaluation.share_in_cavities,
            "reference_rel_error" => figures.reference_rel_error,
            class => *classes.get(class).ok_or_else(|| {
                let what =
                    format!("--fail-if '{}' names a figure that this bake or this light lacks", self.text);
                Failure::bad_input(what).try_this("a figure that the tables show")
            })?,
        };
        Ok((exact, [exact; 2]))
    }
}

impl Limit {
    /// As [`Limit::value`], of a figure at pixels; `None` where it is no such figure, or is not there.
    fn at_pixels(&self, pixels: &PixelRow) -> Option<(f64, [f64; 2])> {
        let PixelRow { figures, interpolation, .. } = pixels;
        let interval = &figures.interval_95;
        let seams = pixels.seams.as_ref();
        let exact = match self.figure.as_str() {
            "pixel_rel_rmse" => return Some((figures.rel_rmse, interval.rel_rmse)),
            "pixel_energy_ratio" => return Some((figures.energy_ratio, interval.energy_ratio)),
            "pixel_p95" => return Some((figures.p95, interval.p95)),
            "pixel_p99" => return Some((figures.p99, interval.p99)),
            name if name == PIXEL_CLASSES[0] => {
                return interpolation.map(|root| (root.rel_rmse, root.interval_95));
            }
            "leak" => pixels.direct?.leak,
            "acne" => pixels.direct?.acne,
            "chart_seams" => seams?.charts.p95,
            "block_seams" => seams?.blocks.p95,
            "cluster_seams" => seams?.clusters.p95,
            "outliers" => pixels.outliers()? as f64,
            _ => return None,
        };
        Some((exact, [exact; 2]))
    }
}

/// A limit, and the value of its figure.
pub struct Held<'a> {
    /// The limit.
    pub limit: &'a Limit,
    /// Object and place, in words behind the limit's; empty of a whole evaluation.
    pub of: String,
    /// The value, and the ends of its interval.
    pub value: (f64, [f64; 2]),
}

/// Fails with [`Exit::LimitBroken`] when the evaluation breaks a limit for sure: at both ends of the figure's 95 % interval, or
/// by a figure that is no number. Names every one that it does, and says on standard error where one end does.
pub fn check(limits: &[Limit], evaluation: &Evaluation) -> Result<()> {
    let held = |limit| Ok(Held { limit, of: String::new(), value: Limit::value(limit, evaluation)? });
    check_held(limits.iter().map(held).collect::<Result<_>>()?)
}

/// As [`check`], of limits whose figures are known.
pub fn check_held(held: Vec<Held<'_>>) -> Result<()> {
    let mut broken = Vec::new();
    for Held { limit, of, value: (value, [low, high]) } in held {
        // Nothing compares with NaN, which keeps no limit.
        let is_broken = |end: f64| value.is_nan() || end.is_nan() || (limit.is_broken)(&end, &limit.bound);
        let ends = [low, high].map(is_broken);
        let words = format!("{}{of} (it is {value:.4}, 95 % between {low:.4} and {high:.4})", limit.text);
        match ends {
            [true, true] => broken.push(words),
            [false, false] => {}
            _ => say!("warning: --fail-if may be broken, more --receivers would tell: {words}"),
        }
    }
    if broken.is_empty() {
        return Ok(());
    }
    let what = format!("the evaluation fails by --fail-if: {}", broken.join("; "));
    Err(Failure::new(Exit::LimitBroken, what)
        .try_this("a higher --preset, or 'kiln evaluate --out DIR' to see where"))
}

#[cfg(test)]
mod tests {
    use lightkiln_worker::evaluate::{Figures, Hunt, Intervals, Jumps, RelativeRoot, Seams};

    use super::*;
    use crate::evaluation::table::{Classes, LightRow};

    fn evaluation() -> Evaluation {
        let figures = |rel_rmse: f64| {
            let interval_95 = Intervals {
                rel_rmse: [rel_rmse - 0.005, rel_rmse + 0.02],
                energy_ratio: [0.94, 0.96],
                ..Intervals::default()
            };
            Figures { rel_rmse, energy_ratio: 0.95, interval_95, ..Figures::default() }
        };
        let classes = Classes::from_iter([("transport", 0.07)]);
        let row = LightRow {
            name: "sun".into(),
            words: String::new(),
            figures: figures(0.2),
            classes: classes.clone(),
            pixels: None,
            bounces: 1,
            counts: true,
            draws: Vec::new(),
        };
        let seams = Seams { charts: Jumps { pairs: 9, mean: 0.01, p95: 0.04 }, ..Seams::default() };
        let pixels = PixelRow {
            figures: figures(0.2),
            interpolation: Some(RelativeRoot { rel_rmse: -0.01, interval_95: [-0.03, 0.02] }),
            seams: Some(seams),
            hunt: Some(Hunt { outliers: 3, ..Hunt::default() }),
            ..PixelRow::default()
        };
        let (lights, pixels) = (vec![row], Some(pixels));
        Evaluation { figures: figures(0.09), classes, pixels, lights, ..Evaluation::default() }
    }

    #[test]
    fn limits_hold_or_are_broken_by_their_figure() {
        for (text, broken) in [
            ("rel_rmse>0.08", true),
            ("rel_rmse > 0.09", false),
            ("rel_rmse>=0.08", true),
            // Broken by the value, kept by one end of the interval: not for sure.
            ("rel_rmse>=0.09", false),
            ("energy_ratio<0.97", true),
            ("energy_ratio<0.955", false),
            ("energy_ratio<=0.9", false),
            ("transport>0.05", true),
            ("pixel_rel_rmse>0.19", true),
            ("interpolation>0.03", false),
            ("interpolation>-0.04", true),
            ("chart_seams>0.03", true),
            ("outliers>3", false),
            ("outliers>2", true),
            ("sun.rel_rmse>0.1", true),
            ("sun.rel_rmse>0.3", false),
        ] {
            let limit: Limit = text.parse().unwrap();
            let checked = check(&[limit], &evaluation());
            assert_eq!(checked.is_err(), broken, "{text}");
            if let Err(failure) = checked {
                assert_eq!(failure.exit(), Exit::LimitBroken);
                assert!(failure.to_string().contains(text), "{failure}");
            }
        }
        for wrong in ["moon.p95>1", "quantisation>1", "leak>0", "sun.pixel_p95>1"] {
            let failure = check(&[wrong.parse().unwrap()], &evaluation()).unwrap_err();
            assert_eq!(failure.exit(), Exit::BadInput, "{wrong}");
        }
    }

    #[test]
    fn figure_that_is_no_number_keeps_no_limit() {
        let mut evaluation = evaluation();
        evaluation.figures.rel_rmse = f64::NAN;
        evaluation.classes = Classes::from_iter([("transport", f64::NAN)]);
        for text in ["rel_rmse>9", "rel_rmse<0", "transport>=9", "transport<=0"] {
            let failure = check(&[text.parse().unwrap()], &evaluation).unwrap_err();
            assert_eq!(failure.exit(), Exit::LimitBroken, "{text}");
            assert!(failure.to_string().contains("NaN"), "{failure}");
        }
        assert!(check(&["energy_ratio<0.9".parse().unwrap()], &evaluation).is_ok());
    }

    #[test]
    fn nonsense_is_refused_with_what_would_be_right() {
        for (text, said) in [
            ("rel_rmse", "FIGURE>NUMBER"),
            ("rel_rmse>much", "'much'"),
            ("rel_rmse>NaN", "finite"),
            ("rel_rmse=0.1", "FIGURE>NUMBER"),
            ("rel_rmse>=", "no number"),
        ] {
            let error = text.parse::<Limit>().unwrap_err();
            assert!(error.contains(said), "{text}: {error}");
        }
    }

    #[test]
    fn unknown_figures_are_refused_before_anything_is_measured() {
        let check = |text: &str| text.parse::<Limit>().unwrap().check_figure(&["transport"]);
        assert!(check("rel_rmse>1").is_ok() && check("sun.transport>1").is_ok());
        for wrong in ["rmse>1", ">0.1", "quantisation>1"] {
            let failure = check(wrong).unwrap_err();
            assert!(failure.to_string().contains("rel_rmse"), "{failure}");
        }
    }
}
