//! Figures of objects amid a bake: as a table for people, and as a page with pictures.

use std::fmt::Write as _;
use std::path::Path;

use lightkiln_client::fetch::write_atomically;

use super::{ObjectEvaluation, ObjectLight, ObjectRow};
use crate::console::say;
use crate::evaluation::amid::{AmidLight, Judged, NEAR_RADII};
use crate::evaluation::gallery::png_of;
use crate::evaluation::html::{STYLE, escaped, figure};
use crate::evaluation::table::{energy_words, rmse_words};
use crate::failure::{Failure, Result};

/// Name of the page in its folder.
const PAGE: &str = "objects.html";
/// Name of the figures beside it.
const FIGURES: &str = "objects.json";
/// Columns and their widths in characters.
const COLUMNS: [(&str, usize); 10] = [
    ("light", 14),
    ("near, 95 %", 22),
    ("ignored", 9),
    ("ratio", 6),
    ("bake alone", 10),
    ("energy, 95 %", 21),
    ("all", 9),
    ("ignored", 9),
    ("own surface, 95 %", 22),
    ("energy, 95 %", 21),
];

/// A table for people.
pub fn object_words(evaluation: &ObjectEvaluation) -> String {
    let mut text = String::new();
    for row in &evaluation.objects {
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "{} at {} ({}), near: within {:.2} m",
            row.object,
            row.place,
            row.stance,
            near_m(row)
        );
        text += &line(COLUMNS.map(|(name, _)| name.to_owned()));
        lines(row).for_each(|cells| text += &line(cells));
        let [near, elsewhere, own] = row.places;
        let _ = writeln!(text, "{near} places near it, {elsewhere} elsewhere, {own} on its own surface");
    }
    text
}

fn near_m(row: &ObjectRow) -> f32 {
    NEAR_RADII * row.radius_m
}

/// Cells of each light, and of all together.
fn lines(row: &ObjectRow) -> impl Iterator<Item = [String; COLUMNS.len()]> + '_ {
    let lights = row.lights.iter().map(|light| cells(&shown_name(light), &light.errors));
    lights.chain([cells("all lights", &row.all_lights)])
}

fn cells(name: &str, errors: &AmidLight) -> [String; COLUMNS.len()] {
    let share = |judged: &Judged| format!("{:.2} %", 100.0 * judged.figures.rel_rmse);
    [
        name.to_owned(),
        rmse_words(&errors.near.figures),
        share(&errors.near_ignored),
        format!("{:.2}", errors.ratio()),
        share(&errors.near_alone),
        energy_words(&errors.near.figures),
        share(&errors.all),
        share(&errors.all_ignored),
        rmse_words(&errors.own.figures),
        energy_words(&errors.own.figures),
    ]
}

fn line(cells: [String; COLUMNS.len()]) -> String {
    let [first, rest @ ..] = cells;
    let mut text = format!("{first:<width$}", width = COLUMNS[0].1);
    for (cell, (_, width)) in rest.iter().zip(&COLUMNS[1..]) {
        let _ = write!(text, " {cell:>width$}");
    }
    text + "\n"
}

/// Its name, in brackets if it does not count.
fn shown_name(light: &ObjectLight) -> String {
    if light.counts { light.name.clone() } else { format!("({})", light.name) }
}

/// Writes the page, and the figures as JSON and pictures as files beside it; `out` is made if need be.
pub fn write_objects(out: &Path, evaluation: &ObjectEvaluation) -> Result<()> {
    std::fs::create_dir_all(out).map_err(|error| {
        Failure::bad_input(format!("the folder {} cannot be made", out.display())).caused_by(&error)
    })?;
    let mut html = head(evaluation);
    for (number, row) in evaluation.objects.iter().enumerate() {
        html += &section(row);
        for (light, strip) in row.lights.iter().zip(&row.strips) {
            let caption =
                format!("{}: with the object, ignored, by paths; the first two less the third", light.name);
            html += &figure(&caption, strip)?;
            let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-';
            let name: String = light.name.chars().map(|c| if is_plain(c) { c } else { '_' }).collect();
            let file = format!("{number}-{}-{name}.png", row.place);
            write_atomically(&out.join(file), &png_of(strip)?)?;
        }
    }
    write_atomically(&out.join(PAGE), (html + "</html>\n").as_bytes())?;
    let json = format!("{:#}\n", serde_json::json!(evaluation));
    write_atomically(&out.join(FIGURES), json.as_bytes())?;
    say!("report: {}", out.join(PAGE).display());
    Ok(())
}

fn head(evaluation: &ObjectEvaluation) -> String {
    let scene = escaped(&evaluation.scene);
    let mut html = format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>Lightkiln: objects in {scene}</title>\
         <style>{STYLE}</style><h1>How right are objects in {scene}?</h1><p>E_ind at receivers, over the mean of the \
         reference at the same places, to which paths were traced with the object in place. Near is within three radii of \
         the object. Ignored: the object has direct light and shadows alone. Bake alone: without the object, against paths \
         without it.</p>"
    );
    for note in &evaluation.notes {
        let _ = write!(html, "<p>Note: {}</p>", escaped(note));
    }
    html
}

fn section(row: &ObjectRow) -> String {
    let mut html = format!(
        "<h2>{} at {}</h2><p>{}; near is within {:.2} m</p><table>",
        escaped(&row.object),
        escaped(&row.place),
        escaped(&row.stance),
        near_m(row)
    );
    let mut line = |cell: &str, cells: [String; COLUMNS.len()]| {
        html += "<tr>";
        cells.iter().for_each(|words| html += &format!("<{cell}>{}", escaped(words)));
    };
    line("th", COLUMNS.map(|(name, _)| name.to_owned()));
    lines(row).for_each(|cells| line("td", cells));
    html + "</table>"
}
