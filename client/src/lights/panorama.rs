//! Panoramas from files of Radiance HDR.

use std::fs::File;
use std::io::{BufReader, Read as _, Seek as _};
use std::path::Path;

use image::ImageDecoder as _;
use image::codecs::hdr::HdrDecoder;
use lightkiln_proto::relight::{PANORAMA_PIXELS_MAX, PanoramaImage};

use crate::error::{ClientError, Result};

/// Beginnings of the files.
const SIGNATURES: [&[u8]; 2] = [b"#?RADIANCE", b"#?RGBE"];

/// Reads a panorama in equirectangular projection from a Radiance HDR file; its pixels are radiance in W·m⁻²·sr⁻¹ once the header's
/// exposures are divided out.
///
/// Errors where the file is none, is too large, or holds numbers that are no radiance.
pub fn read_panorama(path: &Path) -> Result<PanoramaImage> {
    let refused =
        |problem: String| ClientError::Argument { what: format!("panorama {}", path.display()), problem };
    let cannot = |error: std::io::Error| refused(format!("cannot be read: {error}"));
    let mut file = File::open(path).map_err(cannot)?;
    let mut start = Vec::new();
    file.by_ref().take(SIGNATURES[0].len() as u64).read_to_end(&mut start).map_err(cannot)?;
    if !SIGNATURES.iter().any(|signature| start.starts_with(signature)) {
        return Err(refused("is no Radiance HDR file (.hdr); convert it to one".to_owned()));
    }
    file.rewind().map_err(cannot)?;
    let bad = |error: image::ImageError| refused(format!("cannot be decoded: {error}"));
    // Not strict: that takes one of the two beginnings alone.
    let decoder = HdrDecoder::new_nonstrict(BufReader::new(file)).map_err(bad)?;
    let (width, height) = decoder.dimensions();
    if u64::from(width) * u64::from(height) > PANORAMA_PIXELS_MAX as u64 {
        let problem =
            format!("has {width} × {height} pixels, more than the {PANORAMA_PIXELS_MAX} of a panorama");
        return Err(refused(format!("{problem}: make it smaller")));
    }
    let exposure = decoder.metadata().exposure.unwrap_or(1.0);
    if !(exposure > 0.0 && exposure.is_finite()) {
        return Err(refused(format!("has an exposure of {exposure}")));
    }
    let mut pixels = vec![[0.0_f32; 3]; width as usize * height as usize];
    decoder.read_image(bytemuck::cast_slice_mut(&mut pixels)).map_err(bad)?;
    pixels.iter_mut().flatten().for_each(|value| *value /= exposure);
    let name = path.display().to_string();
    PanoramaImage::new(name, width, height, pixels).map_err(refused)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: &[u8]) -> Result<PanoramaImage> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a sky.hdr");
        std::fs::write(&path, bytes).unwrap();
        read_panorama(&path)
    }

    /// Two pixels, each a colour of three times 128/256 with an exponent of 129: 1, and of 131: 4.
    fn file(head: &str) -> Vec<u8> {
        let mut bytes = format!("{head}\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n").into_bytes();
        bytes.extend([128, 64, 0, 129, 128, 128, 128, 131]);
        bytes
    }

    #[test]
    fn pixels_are_read_and_exposures_divided_out() {
        let image = read(&file("#?RADIANCE")).unwrap();
        assert_eq!((image.size(), image.pixels()), ([2, 1], &[[1.0, 0.5, 0.0], [4.0; 3]][..]));
        assert!(image.name().ends_with("a sky.hdr"));
        let exposed = read(&file("#?RGBE\nEXPOSURE=2")).unwrap();
        assert_eq!(exposed.pixels(), [[0.5, 0.25, 0.0], [2.0; 3]]);
    }

    #[test]
    fn hostile_files_are_refused_by_their_name_and_panic_nobody() {
        let whole = file("#?RADIANCE");
        for length in 0..whole.len() {
            let error = read(&whole[..length]).unwrap_err().to_string();
            assert!(error.contains("a sky.hdr"), "{error}");
        }
        // Every byte in turn is another: some of them are files still.
        for at in 0..whole.len() {
            for bit in 0..8 {
                let mut other = whole.clone();
                other[at] ^= 1 << bit;
                let _ = read(&other);
            }
        }
        let text = |text: &str| read(text.as_bytes()).unwrap_err().to_string();
        assert!(text("\u{89}PNG").contains("no Radiance HDR file"));
        assert!(text("#?RADIANCE\n\n-Y 9000 +X 9000\n").contains("smaller"));
        assert!(text("#?RADIANCE\n\n-Y 4294967295 +X 4294967295\n").contains("a sky.hdr"));
        assert!(text("#?RADIANCE\n\n-Y 0 +X 0\n").contains("0 × 0"));
        assert!(text("#?RADIANCE\nEXPOSURE=0\n\n-Y 1 +X 1\n1111").contains("exposure"));
        assert!(read_panorama(Path::new("/nowhere/at/all.hdr")).unwrap_err().to_string().contains("all.hdr"));
    }
}
