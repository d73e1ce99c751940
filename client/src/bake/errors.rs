//! Errors of a bake that were measured at places, as `kiln evaluate --dump FILE.csv` writes them, and the colours that receivers near
//! them get.

use std::borrow::Cow;
use std::path::Path;

use glam::{Vec3, Vec4};
use lightkiln_proto::relight::ReceiverTable;
use rayon::prelude::*;

use super::places::{Place, Places};
use crate::error::{ClientError, Result};
use crate::fetch::read_limited;
use crate::picture::luminance;

/// Largest file that is read.
const FILE_BYTES_MAX: u64 = 512 << 20;
/// Most lines of places, and most lights.
const LINES_MAX: usize = 1 << 20;
const LIGHTS_MAX: usize = 256;
/// Relative error that is shown in full colour, as on the page of an evaluation.
pub const FULL_COLOUR: f32 = 0.5;
/// Linear colours: too dark, right, too bright, and of receivers whose way no place faces.
const DARK: Vec3 = Vec3::new(0.01, 0.05, 0.58);
const RIGHT: Vec3 = Vec3::splat(0.8);
const BRIGHT: Vec3 = Vec3::new(0.58, 0.01, 0.01);
const UNKNOWN: Vec3 = Vec3::splat(0.04);
/// Columns of the file that are read.
pub const COLUMNS: [&str; 15] = [
    "light",
    "x_m",
    "y_m",
    "z_m",
    "nx",
    "ny",
    "nz",
    "area_m2",
    "baked_r",
    "baked_g",
    "baked_b",
    "reference_r",
    "reference_g",
    "reference_b",
    "counted",
];

/// Errors of E_ind by light.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasuredErrors(Vec<OfLight>);

/// Errors under one light.
#[derive(Clone, Debug, PartialEq)]
struct OfLight {
    name: String,
    places: Places,
}

/// A line of the file.
struct Line {
    place: Place,
    area_m2: f32,
    reference: f32,
}

impl MeasuredErrors {
    /// Reads a file.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = read_limited(path, FILE_BYTES_MAX)?;
        let text = std::str::from_utf8(&bytes).map_err(|_| "is no text".to_owned());
        text.and_then(Self::parse).map_err(|problem| {
            let what = format!("errors '{}'", path.display());
            let next = "write it with 'kiln evaluate BUNDLE --dump FILE.csv'";
            ClientError::Argument { what, problem: format!("{problem}; {next}") }
        })
    }

    /// Reads the text of a file; errs with what is wrong with it.
    fn parse(text: &str) -> std::result::Result<Self, String> {
        let mut rest = text;
        let head = record(&mut rest)?.ok_or("is empty")?;
        let column = |name: &&str| {
            let found = head.iter().position(|field| field == name);
            found.ok_or_else(|| format!("has no column '{name}'"))
        };
        let columns = COLUMNS.iter().map(column).collect::<std::result::Result<Vec<_>, _>>()?;
        let mut lights: Vec<(String, Vec<Line>)> = Vec::new();
        for number in 2.. {
            let Some(fields) = record(&mut rest).map_err(|problem| format!("{problem} in line {number}"))?
            else {
                break;
            };
            if number > LINES_MAX {
                return Err(format!("has more than {LINES_MAX} lines"));
            }
            let (name, line) =
                line(&fields, &columns).map_err(|problem| format!("has {problem} in line {number}"))?;
            let index = lights.iter().position(|(own, _)| *own == name);
            let index = index.unwrap_or_else(|| {
                lights.push((name.to_owned(), Vec::new()));
                lights.len() - 1
            });
            if index >= LIGHTS_MAX {
                return Err(format!("has more than {LIGHTS_MAX} lights"));
            }
            lights[index].1.extend(line);
        }
        let lights: Vec<OfLight> =
            lights.into_iter().filter_map(|(name, lines)| of_light(name, lines)).collect();
        if lights.is_empty() { Err("has no place with light".to_owned()) } else { Ok(Self(lights)) }
    }

    /// Errs where no place lies in a scene of these bounds: it is another's.
    pub fn check(&self, [low, high]: [[f32; 3]; 2]) -> Result<()> {
        let [low, high] = [low, high].map(Vec3::from);
        let margin = 1e-3 * (high - low).length();
        let is_inside = |place: &Place| {
            place.position_m.cmpge(low - margin).all() && place.position_m.cmple(high + margin).all()
        };
        if self.0.iter().flat_map(|light| light.places.iter()).any(is_inside) {
            return Ok(());
        }
        let problem = "none of its places lies in this bake: it is of another scene".to_owned();
        Err(ClientError::Argument { what: "errors".to_owned(), problem })
    }

    /// Names of the lights, in the order of the file.
    pub fn lights(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(|light| light.name.as_str())
    }

    /// Colours of receivers under a light: each as the nearest place that faces the same way. `None` for a light that there is not.
    pub fn colours(&self, light: usize, receivers: &ReceiverTable) -> Option<Vec<Vec4>> {
        let light = self.0.get(light)?;
        let pairs = receivers.position_m.par_iter().zip(&receivers.normal);
        let colour = |(position, normal): (&Vec4, &Vec4)| {
            let error = light.places.nearest(position.truncate(), normal.truncate());
            error.map_or(UNKNOWN, colour).extend(0.0)
        };
        Some(pairs.map(colour).collect())
    }
}

/// Colour of a relative error.
fn colour(relative: f32) -> Vec3 {
    let share = (relative / FULL_COLOUR).clamp(-1.0, 1.0);
    RIGHT.lerp(if share < 0.0 { DARK } else { BRIGHT }, share.abs())
}

/// Errors over the area-weighted mean of the reference; `None` for a light that sends none.
fn of_light(name: String, lines: Vec<Line>) -> Option<OfLight> {
    let sum = |of: fn(&Line) -> f64| lines.iter().map(of).sum::<f64>();
    let mean =
        sum(|line| f64::from(line.area_m2) * f64::from(line.reference)) / sum(|line| f64::from(line.area_m2));
    if !(mean > 0.0 && mean.is_finite()) {
        return None;
    }
    let over_mean =
        |line: Line| Place { relative: (f64::from(line.place.relative) / mean) as f32, ..line.place };
    let places = Places::new(lines.into_iter().map(over_mean).collect());
    Some(OfLight { name, places })
}

/// Light and content of a line, whose error is in W·m⁻² yet; none where the evaluation did not count it.
fn line<'a>(
    fields: &'a [Cow<'_, str>],
    columns: &[usize],
) -> std::result::Result<(&'a str, Option<Line>), String> {
    let field = |column: usize| fields.get(columns[column]).map(|field| &**field);
    let name = field(0).unwrap_or_default();
    let mut numbers = [0.0_f32; COLUMNS.len()];
    for (column, number) in numbers.iter_mut().enumerate().skip(1) {
        let read =
            field(column).and_then(|text| text.parse::<f32>().ok()).filter(|number| number.is_finite());
        *number = read.ok_or_else(|| format!("no number in column '{}'", COLUMNS[column]))?;
    }
    let vector = |first: usize| Vec3::new(numbers[first], numbers[first + 1], numbers[first + 2]);
    let (baked, reference) = (luminance(vector(8)), luminance(vector(11)));
    let (area_m2, is_counted) = (numbers[7], numbers[14] != 0.0);
    if area_m2 < 0.0 {
        return Err("an area below 0".to_owned());
    }
    let place = Place { position_m: vector(1), normal: vector(4), relative: baked - reference };
    Ok((name, is_counted.then_some(Line { place, area_m2, reference })))
}

/// Splits the next record off a CSV text ([RFC 4180]): its fields; `None` at the end.
fn record<'a>(rest: &mut &'a str) -> std::result::Result<Option<Vec<Cow<'a, str>>>, &'static str> {
    if rest.is_empty() {
        return Ok(None);
    }
    let mut fields = Vec::new();
    loop {
        let (field, behind) = match rest.strip_prefix('"') {
            Some(quoted) => {
                let end = closing(quoted).ok_or("has a quote that does not end")?;
                (Cow::Owned(quoted[..end].replace("\"\"", "\"")), &quoted[end + 1..])
            }
            None => {
                let end = rest.find([',', '\n']).unwrap_or(rest.len());
                (Cow::Borrowed(rest[..end].trim_end_matches('\r')), &rest[end..])
            }
        };
        fields.push(field);
        let behind = behind.strip_prefix('\r').unwrap_or(behind);
        match behind.as_bytes().first() {
            Some(b',') => *rest = &behind[1..],
            Some(b'\n') => {
                *rest = &behind[1..];
                return Ok(Some(fields));
            }
            None => {
                *rest = behind;
                return Ok(Some(fields));
            }
            Some(_) => return Err("has text behind a quote"),
        }
    }
}

/// Where a quoted text ends: at a quote that is not doubled.
fn closing(quoted: &str) -> Option<usize> {
    let mut from = 0;
    loop {
        let at = from + quoted[from..].find('"')?;
        if !quoted[at + 1..].starts_with('"') {
            return Some(at);
        }
        from = at + 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(lines: &[&str]) -> String {
        let head = format!("{},points\n", COLUMNS.join(","));
        lines.iter().fold(head, |text, line| text + line + "\n")
    }

    /// Two places above each other on a floor and below a ceiling, and a third that was not counted.
    fn measured() -> MeasuredErrors {
        let text = file(&[
            "\"a, \"\"b\"\"\",0,0,0,0,1,0,1,2,2,2,1,1,1,1,0 0 0 0 1 0",
            "\"a, \"\"b\"\"\",1,0.1,0,0,-1,0,3,1,1,1,1,1,1,1,",
            "\"a, \"\"b\"\"\",0,0,0,0,1,0,1,9,9,9,1,1,1,0,",
            "dark,0,0,0,0,1,0,1,0,0,0,0,0,0,1,",
        ]);
        MeasuredErrors::parse(&text).unwrap()
    }

    fn receiver(position: Vec3, normal: Vec3) -> ReceiverTable {
        ReceiverTable {
            position_m: vec![position.extend(0.0)],
            normal: vec![normal.extend(0.0)],
            ..Default::default()
        }
    }

    #[test]
    fn receivers_show_the_nearest_place_that_faces_their_way() {
        let measured = measured();
        assert_eq!(measured.lights().collect::<Vec<_>>(), ["a, \"b\""]);
        let of = |position, normal| measured.colours(0, &receiver(position, normal)).unwrap()[0].truncate();
        let near_second = Vec3::new(0.9, 0.1, 0.0);
        assert_eq!(of(near_second, Vec3::Y), BRIGHT, "twice the mean is too bright, though it is farther");
        assert_eq!(of(near_second, Vec3::NEG_Y), RIGHT);
        assert_eq!(of(near_second, Vec3::X), UNKNOWN);
        assert!(measured.colours(1, &receiver(Vec3::ZERO, Vec3::Y)).is_none());
        assert_eq!(colour(-0.25), RIGHT.lerp(DARK, 0.5));
    }

    #[test]
    fn files_that_cannot_be_read_say_why_and_where() {
        let good = "a,0,0,0,0,1,0,1,2,2,2,1,1,1,1,";
        let cases = [
            (String::new(), "is empty"),
            ("light,x_m\n".to_owned(), "no column 'y_m'"),
            (file(&[]), "no place with light"),
            (file(&["dark,0,0,0,0,1,0,1,0,0,0,0,0,0,1,"]), "no place with light"),
            (file(&[good, "a,0,0"]), "no number in column 'z_m' in line 3"),
            (file(&["a,0,x,0,0,1,0,1,2,2,2,1,1,1,1,"]), "no number in column 'y_m' in line 2"),
            (file(&["a,0,inf,0,0,1,0,1,2,2,2,1,1,1,1,"]), "no number in column 'y_m' in line 2"),
            (file(&["a,0,0,0,0,1,0,-1,2,2,2,1,1,1,1,"]), "area below 0"),
            (file(&["\"a,0,0"]), "a quote that does not end"),
            (file(&["\"a\"b,0,0"]), "text behind a quote"),
        ];
        for (text, wanted) in cases {
            let problem = MeasuredErrors::parse(&text).unwrap_err();
            assert!(problem.contains(wanted), "{problem}, wanted {wanted}");
        }
        let missing = MeasuredErrors::read(Path::new("no such file.csv")).unwrap_err().to_string();
        assert!(missing.contains("no such file.csv"), "{missing}");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("places.csv");
        std::fs::write(&path, b"\xff\xfe").unwrap();
        let problem = MeasuredErrors::read(&path).unwrap_err().to_string();
        assert!(problem.contains("is no text") && problem.contains("kiln evaluate"), "{problem}");
    }

    #[test]
    fn errors_of_another_scene_are_refused() {
        measured().check([[-1.0; 3], [2.0; 3]]).unwrap();
        let problem = measured().check([[50.0; 3], [60.0; 3]]).unwrap_err().to_string();
        assert!(problem.contains("another scene"), "{problem}");
    }
}
