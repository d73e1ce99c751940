//! `--dump FILE.csv`: every measured receiver, so that any outside renderer can be held against it: the reference's E_ind and
//! E_dir are means over the points of column `points`, each with its position and shading normal. `--dump-pixels FILE.csv`: every
//! measured pixel, at which they are those of the point itself.

use std::fmt::Write as _;
use std::path::Path;

use glam::DVec3;
use lightkiln_client::fetch::write_atomically;
use lightkiln_worker::evaluate::{ClassResult, LightResult};
use lightkiln_worker::geometry::Site;

use super::measure::Measured;
use crate::failure::Result;

/// First columns of the file, `receiver` empty for kinds that answer at any point; after them, a column of each class of error that is known at the places.
const HEADER: &str = "light,receiver,x_m,y_m,z_m,nx,ny,nz,face_x,face_y,face_z,area_m2,baked_r,baked_g,baked_b,reference_r,reference_g,\
                      reference_b,error_r,error_g,error_b,direct_r,direct_g,direct_b,paths,counted,points";

/// Columns of the file of pixels.
const PIXEL_HEADER: &str = "light,x_m,y_m,z_m,nx,ny,nz,face_x,face_y,face_z,area_m2,shown_r,shown_g,shown_b,reference_r,reference_g,\
                            reference_b,error_r,error_g,error_b,direct_r,direct_g,direct_b,paths,counted";

/// Writes one line per light and place: position, shading and face normal, area, E_ind in W·m⁻² as baked and by the reference with its
/// standard error, E_dir, and E_ind with no other error than that of a class.
pub fn write_dump(path: &Path, measured: &Measured) -> Result<()> {
    let mut text = HEADER.to_owned();
    let at_sample = |result: &LightResult| -> Vec<ClassResult> {
        result.classes.iter().filter(|class| !class.at_sample.is_empty()).cloned().collect()
    };
    for class in measured.results.first().map(at_sample).unwrap_or_default() {
        text.extend(["r", "g", "b"].map(|channel| format!(",{}_only_{channel}", class.name)));
    }
    text.push('\n');
    for result in &measured.results {
        let classes = at_sample(result);
        for (index, sampled) in measured.evaluator.sample().places.iter().enumerate() {
            let site = &sampled.place.site;
            let reference = &result.reference[index];
            let colours = [
                result.baked[index],
                reference.indirect.mean,
                reference.indirect.error,
                reference.direct.mean,
            ];
            // Writing to a String cannot fail.
            let _ = write!(
                text,
                "{},{},{},{}",
                field(&result.light.name),
                sampled.place.number.map_or(String::new(), |number| number.to_string()),
                site_fields(site),
                sampled.area_m2,
            );
            colours.iter().for_each(|colour| text += &channels(*colour));
            let _ = write!(text, ",{},{}", reference.paths, u8::from(result.counted[index]));
            text.push(',');
            let points = measured.evaluator.bake().points_of(&sampled.place);
            text += &points.iter().map(point).collect::<Vec<_>>().join(";");
            classes.iter().for_each(|class| text += &channels(class.at_sample[index]));
            text.push('\n');
        }
    }
    Ok(write_atomically(path, text.as_bytes())?)
}

/// Writes one line per light and measured pixel: position, shading and face normal, the area that it stands for, E_ind in W·m⁻² as
/// shown and by the reference with its standard error, and E_dir.
pub fn write_pixels(path: &Path, measured: &Measured) -> Result<()> {
    let mut text = PIXEL_HEADER.to_owned();
    text.push('\n');
    let geometry = measured.evaluator.bake().geometry();
    for result in &measured.results {
        let pairs = result.pixels.iter().flat_map(|pixels| &pixels.shown.pairs);
        for (sampled, pair) in measured.evaluator.pixels().measured.iter().zip(pairs) {
            let site = geometry.site_at(&sampled.hit);
            // Writing to a String cannot fail.
            let _ = write!(text, "{},{},{}", field(&result.light.name), site_fields(&site), sampled.area_m2);
            let reference = &pair.reference;
            let colours =
                [pair.found, reference.indirect.mean, reference.indirect.error, reference.direct.mean];
            colours.iter().for_each(|colour| text += &channels(*colour));
            let _ = writeln!(text, ",{},{}", reference.paths, u8::from(pair.area_m2 > 0.0));
        }
    }
    Ok(write_atomically(path, text.as_bytes())?)
}

/// Position, shading and face normal as nine fields.
fn site_fields(site: &Site) -> String {
    let (p, n, f) = (site.position_m, site.normal, site.face_normal);
    format!("{},{},{},{},{},{},{},{},{}", p.x, p.y, p.z, n.x, n.y, n.z, f.x, f.y, f.z)
}

/// Position and shading normal of a point, with spaces between.
fn point(site: &Site) -> String {
    let (p, n) = (site.position_m, site.normal);
    format!("{} {} {} {} {} {}", p.x, p.y, p.z, n.x, n.y, n.z)
}

/// Three fields, each after a comma.
fn channels(colour: DVec3) -> String {
    format!(",{},{},{}", colour.x, colour.y, colour.z)
}

/// A text as a CSV field ([RFC 4180]): quoted where it must be.
fn field(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_that_windows_read_are_there() {
        let head: Vec<&str> = HEADER.split(',').collect();
        for column in lightkiln_client::bake::COLUMNS {
            assert!(head.contains(&column), "{column}");
        }
    }

    #[test]
    fn names_with_commas_and_quotes_stay_one_field() {
        assert_eq!(field("sun"), "sun");
        assert_eq!(field("a, \"b\""), "\"a, \"\"b\"\"\"");
    }
}
