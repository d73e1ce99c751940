//! The report as one HTML page: pictures inline, nothing fetched from elsewhere.

use std::fmt::Write as _;
use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use lightkiln_client::fetch::write_atomically;
use lightkiln_worker::evaluate::{ClusterError, Figures, cluster_errors};

use super::gallery::{captioned, png_of, write_gallery};
use super::heat::{Bitmap, FULL_COLOUR, colour};
use super::measure::Measured;
use super::pictures::LightPictures;
use super::pixels::{
    PixelRow, interpolation_words, outlier_words, place_words, seam_words, share_words, step_words,
};
use super::table::{ABSENT, Classes, Evaluation, LightRow, energy_words, rmse_words};
use crate::console::say;
use crate::failure::{Failure, Result};

/// Name of the page in its folder.
pub const PAGE: &str = "evaluation.html";
/// Name of the figures beside it.
pub const FIGURES: &str = "evaluation.json";
/// Bars of the histogram, and the relative error at its end.
const BARS: usize = 20;
const HISTOGRAM_END: f64 = 0.5;
/// Worst clusters listed.
const WORST: usize = 12;

/// Style of pages.
pub const STYLE: &str = "body{font:15px/1.4 system-ui,sans-serif;margin:2em;max-width:1700px;color:#222}\
table{border-collapse:collapse}td,th{padding:.2em .7em;text-align:right;border-bottom:1px solid #ddd}\
td:first-child,th:first-child{text-align:left}figure{display:inline-block;margin:.4em}\
figcaption{font-size:13px;color:#555}img{image-rendering:auto;max-width:100%;border:1px solid #ccc}\
.atlas img{image-rendering:pixelated;max-height:420px}";

/// Writes the page, and the figures as JSON and pictures as files beside it; `out` is made if need be.
pub fn write_page(out: &Path, measured: &Measured, pictures: &[LightPictures]) -> Result<()> {
    std::fs::create_dir_all(out).map_err(|error| {
        Failure::bad_input(format!("the folder {} cannot be made", out.display())).caused_by(&error)
    })?;
    let html = page(measured, pictures)?;
    write_atomically(&out.join(PAGE), html.as_bytes())?;
    let json = format!("{:#}\n", serde_json::json!(measured.evaluation));
    write_gallery(out, pictures, &measured.evaluation.lights)?;
    write_atomically(&out.join(FIGURES), json.as_bytes())?;
    say!("report: {}", out.join(PAGE).display());
    Ok(())
}

fn page(measured: &Measured, pictures: &[LightPictures]) -> Result<String> {
    let evaluation = &measured.evaluation;
    let scene = escaped(&evaluation.scene);
    let mut html = format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>Lightkiln: {scene}</title>\
         <style>{STYLE}</style><h1>How right is the bake of {scene}?</h1>"
    );
    html += &table(evaluation, pictures);
    html += &notes(evaluation, &about_classes(measured));
    html += &at_pixels(evaluation);
    let clusters = cluster_errors(&measured.evaluator, &measured.results);
    html += "<h2>Error by cluster</h2>";
    html += &histogram(&clusters);
    html += &worst(&clusters);
    html += &legend();
    for (light, row) in pictures.iter().zip(&evaluation.lights) {
        let _ = write!(html, "<h2>{}</h2><p>{}</p>", escaped(&light.name), escaped(&row.words));
        let (of_view, of_atlas) = captioned(light);
        for (words, picture) in of_view {
            html += &figure(&words, picture)?;
        }
        html += "<div class=\"atlas\">";
        for (words, picture) in of_atlas {
            html += &figure(&words, picture)?;
        }
        html += "</div>";
    }
    Ok(html + "</html>\n")
}

fn table(evaluation: &Evaluation, pictures: &[LightPictures]) -> String {
    let mut html =
        "<table><tr><th>light<th>relative RMSE, 95 %<th>energy ratio, 95 %<th>p95<th>p99<th>red<th>green<th>blue\
        "
        .to_owned();
    evaluation.classes.keys().for_each(|name| html += &format!("<th>{}", escaped(name)));
    html += "<th>reference’s error<th>ꟻLIP";
    let mut row = |name: &str, figures: &Figures, classes: &Classes, flip: Option<f64>| {
        let percent = |value: f64| format!("<td>{:.2} %", 100.0 * value);
        html += &format!("<tr><td>{}<td>{}<td>{}", escaped(name), rmse_words(figures), energy_words(figures));
        let shares =
            [figures.p95, figures.p99, figures.channels[0], figures.channels[1], figures.channels[2]];
        shares.into_iter().for_each(|value| html += &percent(value));
        for name in evaluation.classes.keys() {
            html += &classes.get(name).map_or(format!("<td>{ABSENT}"), |error| percent(*error));
        }
        html += &percent(figures.reference_rel_error);
        html += &flip.map_or("<td>".to_owned(), |flip| format!("<td>{flip:.4}"));
    };
    for (light, picture) in evaluation.lights.iter().zip(pictures) {
        row(&light.shown_name(), &light.figures, &light.classes, Some(picture.flip_mean));
    }
    row("all lights", &evaluation.figures, &evaluation.classes, None);
    html + "</table>"
}

fn notes(evaluation: &Evaluation, classes: &str) -> String {
    let mut html = format!(
        "<p>E_ind at {} places, weighted by area, over the mean of the reference. Squares are \
         products of the errors against two halves of the reference, so that its noise cancels; where they sum up to less \
         than 0, the error is lost in it and its sign is minus. Intervals hold the noise and the choice of places, \
         percentiles the noise. The reference’s standard error was asked to be {:.1} % of \
         the mean, or of the geometric mean of it and the value where that is brighter; more at places that stand for little area. {} Of {} chunks of light, {} were made \
         anew to tell these apart. All lights: root mean square over lights, mean of energy ratios. {:.2} % of the lit \
         area is too small or too deep for the bake; {:.1} % more lies in \
         cavities that nothing in the open sees and was left out. Pictures by paths hold some noise, and so \
         does their ꟻLIP.</p>",
        evaluation.receivers,
        100.0 * evaluation.rel_error,
        classes,
        evaluation.chunks,
        evaluation.chunks_made_anew,
        100.0 * evaluation.share_without_receiver,
        100.0 * evaluation.share_in_cavities,
    );
    for note in &evaluation.notes {
        let _ = write!(html, "<p>Note: {}</p>", escaped(note));
    }
    html
}

/// Figures at pixels and the texels that stand out; nothing where none were measured.
fn at_pixels(evaluation: &Evaluation) -> String {
    let Some(all) = &evaluation.pixels else { return String::new() };
    let mut html = "<h2>At pixels</h2><table><tr><th>light<th>relative RMSE, 95 %<th>energy ratio, 95 %<th>p95<th>p99\
                    <th>above 25 %<th>interpolation, 95 %<th>leak<th>acne<th>charts<th>blocks<th>clusters<th>inside\
                    <th>outliers"
        .to_owned();
    let mut line = |name: &str, row: &PixelRow| {
        let figures = &row.figures;
        html += &format!("<tr><td>{}<td>{}<td>{}", escaped(name), rmse_words(figures), energy_words(figures));
        for value in [figures.p95, figures.p99, figures.area_above[1]] {
            html += &format!("<td>{:.2} %", 100.0 * value);
        }
        let words = [interpolation_words(row)].into_iter().chain(share_words(row)).chain(seam_words(row));
        words.chain([outlier_words(row)]).for_each(|words| html += &format!("<td>{words}"));
    };
    for row in &evaluation.lights {
        row.pixels.iter().for_each(|pixels| line(&row.shown_name(), pixels));
    }
    line("all lights", all);
    let _ = write!(
        html,
        "</table><p>E_ind at {} points of surfaces, read from the lightmap as pictures read it, with direct light by the \
         client’s shadow maps where it has the light. Interpolation: the signed root of the mean square error there less \
         that at the receivers of the same points. Leak, acne: shares of the area where direct light is there, or is \
         lacking, though exact rays all around within the reach of the shadow map’s filter say otherwise. Charts, \
         blocks, clusters: the 95th percentile of jumps across their borders over the light there, inside: the same of \
         texels inside clusters. Outliers: texels that stand out from their neighbours by a factor of 1.5 without the \
         reference doing so, of the worst that were path-traced.</p>",
        evaluation.pixels_measured
    );
    let worst = |row: &LightRow| -> Vec<String> {
        let hunt = row.pixels.as_ref().and_then(|pixels| pixels.hunt.as_ref());
        let named = hunt.into_iter().flat_map(|hunt| &hunt.worst);
        let seams = row.pixels.as_ref().and_then(|pixels| pixels.seams.as_ref());
        let steps = seams.into_iter().flat_map(|seams| &seams.worst);
        named
            .map(place_words)
            .chain(steps.map(step_words))
            .map(|words| format!("<li>{}: {}", escaped(&row.name), escaped(&words)))
            .collect()
    };
    let worst: Vec<String> = evaluation.lights.iter().flat_map(worst).collect();
    if worst.is_empty() { html } else { html + "<ul>" + &worst.concat() + "</ul>" }
}

/// The classes of error in words.
fn about_classes(measured: &Measured) -> String {
    let Some(result) = measured.results.first() else { return String::new() };
    result
        .classes
        .iter()
        .map(|class| format!("{}: {}.", escaped(class.name), escaped(class.about)))
        .collect::<Vec<_>>()
        .join(" ")
}

/// Clusters by error, as bars.
fn histogram(clusters: &[ClusterError]) -> String {
    let mut counts = [0_usize; BARS];
    for cluster in clusters {
        let bar = (cluster.rel_rmse / HISTOGRAM_END * BARS as f64) as usize;
        counts[bar.min(BARS - 1)] += 1;
    }
    let most = counts.iter().copied().max().unwrap_or(0).max(1);
    let mut html =
        "<svg width=\"640\" height=\"190\" role=\"img\" aria-label=\"clusters by error\">".to_owned();
    for (bar, count) in counts.iter().enumerate() {
        let height = 140.0 * *count as f64 / most as f64;
        let _ = write!(
            html,
            "<rect x=\"{}\" y=\"{:.1}\" width=\"28\" height=\"{height:.1}\" fill=\"#47a\"><title>{count}</title></rect>\
             <text x=\"{}\" y=\"170\" font-size=\"10\">{:.1}</text>",
            20 + 30 * bar,
            155.0 - height,
            20 + 30 * bar,
            100.0 * HISTOGRAM_END * bar as f64 / BARS as f64,
        );
    }
    let last = 100.0 * HISTOGRAM_END;
    html + &format!(
        "<text x=\"20\" y=\"186\" font-size=\"11\">clusters by relative RMSE over all lights, % (the last bar holds all above); \
         highest bar {most}, axis to {last:.0} %</text></svg>"
    )
}

fn worst(clusters: &[ClusterError]) -> String {
    let mut html =
        "<table><tr><th>worst clusters<th>relative RMSE<th>bias<th>receivers measured<th>at (m)".to_owned();
    for cluster in clusters.iter().take(WORST) {
        let name = cluster.cluster.map_or("left out as unlit".to_owned(), |index| format!("cluster {index}"));
        let [x, y, z] = cluster.position_m;
        let _ = write!(
            html,
            "<tr><td>{name}<td>{:.1} %<td>{:+.1} %<td>{}<td>{x:.2}, {y:.2}, {z:.2}",
            100.0 * cluster.rel_rmse,
            100.0 * cluster.rel_bias,
            cluster.receivers
        );
    }
    html + "</table>"
}

/// Legend of the colours of differences.
fn legend() -> String {
    let mut html = "<h2>Differences</h2><p>".to_owned();
    for step in -4..=4 {
        let relative = FULL_COLOUR * f64::from(step) / 4.0;
        let [r, g, b, _] = colour(relative);
        let ink = if step == 0 { "#222" } else { "#fff" };
        let _ = write!(
            html,
            "<span style=\"background:rgb({r},{g},{b});color:{ink};padding:.3em .6em;border:1px solid #ccc\">{:+.1} %</span>",
            100.0 * relative
        );
    }
    html + " of the mean of the reference; blue is too dark, red too bright, grey is no receiver.</p>"
}

/// A picture inline, with its caption.
pub fn figure(caption: &str, picture: &Bitmap) -> Result<String> {
    let png = png_of(picture)?;
    let caption = escaped(caption);
    Ok(format!(
        "<figure><img width=\"{}\" height=\"{}\" alt=\"{caption}\" src=\"data:image/png;base64,{}\"><figcaption>{caption}\
         </figcaption></figure>",
        picture.width,
        picture.height,
        STANDARD.encode(png)
    ))
}

/// Text that is no HTML.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_a_scene_cannot_break_the_page() {
        assert_eq!(escaped("<a b=\"c\">&"), "&lt;a b=&quot;c&quot;&gt;&amp;");
    }

    #[test]
    fn histogram_counts_every_cluster_once() {
        let cluster = |rel_rmse| ClusterError {
            cluster: None,
            position_m: [0.0; 3],
            receivers: 1,
            rel_rmse,
            rel_bias: 0.0,
        };
        let html = histogram(&[cluster(0.01), cluster(0.012), cluster(0.3), cluster(7.0)]);
        let counts: usize = html
            .split("<title>")
            .skip(1)
            .map(|rest| rest.split('<').next().unwrap().parse::<usize>().unwrap())
            .sum();
        assert_eq!(counts, 4);
        assert!(html.contains("highest bar 2"));
    }
}
