//! A plot as SVG: logarithmic axes, one polyline per line, direct labels.

use std::fmt::Write;

/// Points of a line, ascending or not.
pub struct Line {
    /// Label at its end.
    pub label: String,
    /// Places on both axes, above 0.
    pub points: Vec<[f64; 2]>,
}

const WIDTH: f64 = 760.0;
const HEIGHT: f64 = 420.0;
/// Left, top, right, bottom.
const MARGINS: [f64; 4] = [64.0, 20.0, 210.0, 48.0];
const COLOURS: [&str; 6] = ["#1b6ca8", "#c8553d", "#3f8f4f", "#8a5fb0", "#b98a1d", "#555555"];

/// Draws lines; `None` where no point can be shown on logarithmic axes.
pub fn svg(title: &str, x_words: &str, y_words: &str, lines: &[Line]) -> Option<String> {
    let shown = |point: &&[f64; 2]| point.iter().all(|value| *value > 0.0 && value.is_finite());
    let points: Vec<&[f64; 2]> = lines.iter().flat_map(|line| &line.points).filter(shown).collect();
    let bounds = |axis: usize| {
        let values = points.iter().map(|point| point[axis]);
        let (low, high) = values.fold((f64::INFINITY, 0.0_f64), |(low, high), v| (low.min(v), high.max(v)));
        (low / 1.15, high * 1.15)
    };
    if points.is_empty() {
        return None;
    }
    let (x_bounds, y_bounds) = (bounds(0), bounds(1));
    let [left, top, right, bottom] = MARGINS;
    let share = |value: f64, (low, high): (f64, f64)| (value / low).ln() / (high / low).ln();
    let x_of = |value: f64| left + share(value, x_bounds) * (WIDTH - left - right);
    let y_of = |value: f64| HEIGHT - bottom - share(value, y_bounds) * (HEIGHT - top - bottom);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" font-family=\"sans-serif\" \
         font-size=\"12\"><title>{title}</title><rect width=\"{WIDTH}\" height=\"{HEIGHT}\" fill=\"#fff\"/>\n"
    );
    let (x_end, y_end) = (WIDTH - right, HEIGHT - bottom);
    for value in ticks(x_bounds) {
        let x = x_of(value);
        let _ = writeln!(out, "<path d=\"M{x:.1} {top}V{y_end}\" stroke=\"#ddd\"/>");
        let _ =
            writeln!(out, "<text x=\"{x:.1}\" y=\"{}\" text-anchor=\"middle\">{value}</text>", y_end + 16.0);
    }
    for value in ticks(y_bounds) {
        let y = y_of(value);
        let _ = writeln!(out, "<path d=\"M{left} {y:.1}H{x_end}\" stroke=\"#ddd\"/>");
        let _ = writeln!(
            out,
            "<text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{value}</text>",
            left - 6.0,
            y + 4.0
        );
    }
    let middle = (left + x_end) * 0.5;
    let _ =
        writeln!(out, "<text x=\"{middle}\" y=\"{}\" text-anchor=\"middle\">{x_words}</text>", HEIGHT - 10.0);
    let _ = writeln!(
        out,
        "<text transform=\"translate(16 {}) rotate(-90)\" text-anchor=\"middle\">{y_words}</text>",
        (top + y_end) * 0.5
    );
    for (index, line) in lines.iter().enumerate() {
        let colour = COLOURS[index % COLOURS.len()];
        let mut points: Vec<&[f64; 2]> = line.points.iter().filter(shown).collect();
        points.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let places: Vec<String> =
            points.iter().map(|[x, y]| format!("{:.1},{:.1}", x_of(*x), y_of(*y))).collect();
        let _ = writeln!(
            out,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>",
            places.join(" ")
        );
        for [x, y] in &points {
            let _ = writeln!(
                out,
                "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"3\" fill=\"{colour}\"/>",
                x_of(*x),
                y_of(*y)
            );
        }
        let y = top + 14.0 + 18.0 * index as f64;
        let _ =
            writeln!(out, "<text x=\"{}\" y=\"{y}\" fill=\"{colour}\">{}</text>", x_end + 12.0, line.label);
    }
    out.push_str("</svg>\n");
    Some(out)
}

/// 1, 2 and 5 times powers of ten between two bounds.
fn ticks((low, high): (f64, f64)) -> Vec<f64> {
    let first = low.log10().floor() as i32;
    let last = high.log10().ceil() as i32;
    let powers = first..=last;
    powers
        .flat_map(|power| [1.0, 2.0, 5.0].map(|step| (step, power)))
        // Through text, so that a tick reads 0.2 and not 0.2 and a bit.
        .filter_map(|(step, power)| format!("{step}e{power}").parse::<f64>().ok())
        .filter(|value| (low..=high).contains(value))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(ticks((0.15, 6.0)), [0.2, 0.5, 1.0, 2.0, 5.0]);
    }

    #[test]
    fn plot_shows_every_point_and_label_and_nothing_of_what_cannot_be_shown() {
        let line = |label: &str, points: &[[f64; 2]]| Line { label: label.into(), points: points.to_vec() };
        let lines = [line("first", &[[1.0, 2.0], [10.0, 1.0]]), line("second", &[[0.0, 1.0], [3.0, 4.0]])];
        let plot = svg("a title", "x", "y", &lines).unwrap();
        assert_eq!(plot.matches("<circle").count(), 3);
        assert!(plot.contains(">first<") && plot.contains(">second<") && plot.contains("a title"));
        assert!(svg("none", "x", "y", &[line("l", &[[f64::NAN, 1.0]])]).is_none());
    }
}
