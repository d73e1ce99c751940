//! Words of pictures: what arguments of the command line say.

use lightkiln_client::preview::Fog;
use lightkiln_client::scene::Recolour;
use lightkiln_proto::relight::Lod;
use lightkiln_proto::words::lod_from_text;

/// Stops of exposure, −32..=32: a factor of 4·10⁹ either way.
pub(super) fn parse_stops(text: &str) -> Result<f32, String> {
    match text.parse() {
        Ok(stops @ -32.0..=32.0) => Ok(stops),
        _ => Err("write a number of stops in -32..=32, e.g. -1.5".to_owned()),
    }
}

/// Fog as words.
pub(super) fn parse_fog(text: &str) -> Result<Fog, String> {
    Fog::from_text(text).map_err(|error| error.to_string())
}

/// Levels of detail as words.
pub(super) fn parse_lod(text: &str) -> Result<Lod, String> {
    lod_from_text(text).map_err(|error| error.to_string())
}

/// A colour of a material as `NAME=r,g,b`; the name may hold '='.
pub fn parse_recolour(text: &str) -> Result<Recolour, String> {
    let wrong = || "write the material's name and a linear colour, e.g. \"plaster=0.6,0.5,0.4\"".to_owned();
    let (name, colour) = text.rsplit_once('=').ok_or_else(wrong)?;
    let channels: Vec<f32> = colour
        .split(',')
        .map(|channel| channel.trim().parse())
        .collect::<Result<_, _>>()
        .map_err(|_| wrong())?;
    let base_colour = <[f32; 3]>::try_from(channels).map_err(|_| wrong())?;
    if !base_colour.iter().all(|channel| (0.0..=1.0).contains(channel)) {
        return Err("each channel of a colour is a number from 0 to 1".to_owned());
    }
    Ok(Recolour { material: name.to_owned(), base_colour })
}

/// A size as `WIDTHxHEIGHT`, each 1..=16384 pixels.
pub fn parse_size(text: &str) -> Result<(u32, u32), String> {
    let wrong = || "write width x height in pixels, e.g. 1280x720".to_owned();
    let (width, height) = text.split_once(['x', 'X']).ok_or_else(wrong)?;
    match (width.parse(), height.parse()) {
        (Ok(width @ 1..=16_384), Ok(height @ 1..=16_384)) => Ok((width, height)),
        (Ok(_), Ok(_)) => Err("each side is 1..=16384 pixels".to_owned()),
        _ => Err(wrong()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_of_materials_are_a_name_and_three_channels() {
        let wall = Recolour { material: "wall=red".to_owned(), base_colour: [0.5, 0.25, 1.0] };
        assert_eq!(parse_recolour("wall=red=0.5, 0.25,1"), Ok(wall));
        for wrong in
            ["wall", "wall=", "wall=1,2", "wall=1,1,1,1", "wall=a,b,c", "wall=1.5,0,0", "wall=nan,0,0"]
        {
            assert!(parse_recolour(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn exposure_is_a_finite_number_of_stops() {
        assert_eq!(parse_stops("-1.5"), Ok(-1.5));
        for wrong in ["inf", "nan", "-33", "bright", ""] {
            assert!(parse_stops(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn size_is_width_by_height_within_bounds() {
        assert_eq!(parse_size("640x480"), Ok((640, 480)));
        for wrong in ["640", "640x", "0x480", "640x99999", "axb", "640*480"] {
            assert!(parse_size(wrong).is_err(), "{wrong}");
        }
    }
}
