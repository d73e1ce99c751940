//! Panoramas in the browser: files are read as the native client reads them, and parts of the sky have its means.

use std::f32::consts::TAU;

use lightkiln_client::lights::{Panorama, read_panorama};
use lightkiln_proto::relight::PanoramaImage;
use serde_json::{Value, json};
use std::sync::Arc;

use super::{browser_at, bytes_of_hex, served};

const MODULE: &str = "/pages/skies.js";
/// Width and height of [`file`].
const SIZE: [usize; 2] = [128, 64];
/// Largest difference of a mean, relative to the largest: sums in f64 of directions that are rounded otherwise.
const MEANS_TOLERANCE: f32 = 1e-5;

/// Light clouds and a bright sun, as a packed file.
pub fn file() -> Vec<u8> {
    let [width, height] = SIZE;
    let mut bytes =
        format!("#?RADIANCE\n# clouds\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n").into_bytes();
    for y in 0..height {
        let row: Vec<[u8; 4]> = (0..width).map(|x| texel(x, y)).collect();
        bytes.extend(packed(&row));
    }
    bytes
}

fn texel(x: usize, y: usize) -> [u8; 4] {
    let wave = |at: usize, turns: f32, of: usize| (at as f32 / of as f32 * turns * TAU).sin();
    let shade = |wave: f32| (110.0 + 60.0 * wave) as u8;
    let is_sun = (90..92).contains(&x) && (8..10).contains(&y);
    [shade(wave(x, 3.0, SIZE[0])), shade(wave(y, 2.0, SIZE[1])), 90, if is_sun { 138 } else { 129 }]
}

/// A row, channel by channel: runs where four or more are alike.
fn packed(row: &[[u8; 4]]) -> Vec<u8> {
    let mut bytes = vec![2, 2, (row.len() >> 8) as u8, row.len() as u8];
    for channel in 0..4 {
        let values: Vec<u8> = row.iter().map(|texel| texel[channel]).collect();
        for run in values.chunk_by(|a, b| a == b) {
            for part in run.chunks(127) {
                match part.len() {
                    length @ 4.. => bytes.extend([128 + length as u8, part[0]]),
                    length => {
                        bytes.push(length as u8);
                        bytes.extend(part);
                    }
                }
            }
        }
    }
    bytes
}

/// The picture of a file's bytes by the native client.
pub fn image(bytes: &[u8]) -> PanoramaImage {
    read(bytes).unwrap()
}

fn read(bytes: &[u8]) -> Result<PanoramaImage, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sky.hdr");
    std::fs::write(&path, bytes).unwrap();
    read_panorama(&path).map_err(|error| error.to_string())
}

/// Files of few bytes in each way of packing, their prefixes, and each of them with another bit in turn.
fn small_files() -> Vec<Vec<u8>> {
    let with = |head: &str, pixels: &[u8]| [head.as_bytes(), pixels].concat();
    let flat = [128, 64, 0, 129, 128, 128, 128, 131];
    let old = [9, 8, 7, 130, 1, 1, 1, 3, 4, 5, 6, 120, 1, 1, 1, 1, 1, 1, 1, 0, 255, 0, 0, 1];
    let new = [2, 2, 0, 8, 136, 9, 3, 1, 2, 3, 133, 4, 136, 200, 2, 127, 128, 134, 129];
    let mut files = vec![
        with("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n", &flat),
        with("#?RGBE\nEXPOSURE=2\n EXPOSURE = 0.3\nEXPOSURE=x\n\n-Y 1 +X 2\n", &flat),
        with(
            "#?RADIANCE\n\n-Y 2 +X 4\n",
            &[&old[..12], &[7, 0, 0, 128], &old[12..20], &[3, 3, 3, 3, 3, 3, 3, 3]].concat(),
        ),
        with("#?RADIANCE\n\n-Y 2 +X 8\n", &[new, new].concat()),
        with("#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 2\n", &flat),
        with("#?RADIANCE\n\n+Y 1 +X 2\n", &flat),
        with("#?RADIANCE\nEXPOSURE=0\n\n-Y 1 +X 1\n", &flat),
        with("#?RADIANCE\n\n-Y 0 +X 0\n", &[]),
        with("#?RADIANCE\n\n-Y 9000 +X 9000\n", &flat),
        with("#?RADIANCE\n\n-Y 4294967295 +X 4294967295\n", &flat),
        with("#?RADIANCE\n\n-Y 2 +X 1\n", &flat),
        with("#?RADIANCE\n\n-Y 1 +X 1\n", &[255, 0, 0, 255]),
        with("\u{89}PNG", &[]),
    ];
    let whole = files.clone();
    for file in &whole[..4] {
        files.extend((0..file.len()).map(|length| file[..length].to_vec()));
        for bit in 0..8 * file.len() {
            let mut other = file.clone();
            other[bit / 8] ^= 1 << (bit % 8);
            files.push(other);
        }
    }
    files
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[test]
#[ignore = "needs chromium"]
fn chromium_reads_and_refuses_panoramas_as_the_native_client_does() {
    let files = small_files();
    let server = served(|_| None);
    let sent: Vec<String> = files.iter().map(|file| hex(file)).collect();
    let told = browser_at(&server).run(MODULE, "read", json!([sent]));
    let [mut read_ones, mut refused] = [0, 0];
    for (at, file) in files.iter().enumerate() {
        let (got, shown) = (&told[at], String::from_utf8_lossy(file));
        match read(file) {
            Ok(image) => {
                read_ones += 1;
                let pixels: Vec<u8> =
                    image.pixels().iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
                assert_eq!(got["size"], json!(image.size()), "{shown}: {got}");
                assert_eq!(bytes_of_hex(&got["pixels"]), pixels, "{shown}");
            }
            Err(error) => {
                refused += 1;
                assert!(got["error"].is_string(), "{shown}: {error}, but {got}");
            }
        }
    }
    assert!(read_ones > 100 && refused > 100, "{read_ones} read, {refused} refused");
    let words = |at: usize| told[at]["error"].as_str().unwrap().to_owned();
    assert!(
        words(7).contains("0 × 0") && words(8).contains("smaller") && words(10).contains("twice as wide")
    );
    assert!(words(6).contains("exposure") && words(12).contains("no Radiance HDR file"));
}

#[test]
#[ignore = "needs chromium"]
fn chromium_finds_the_means_of_the_skys_parts_that_rust_finds() {
    let server = served(|request| (request.path == "/sky.hdr").then(|| super::files::Answer::of(file())));
    let browser = browser_at(&server);
    // A picture of its own size, and one that is reduced.
    let large: Vec<[f32; 3]> =
        (0..1500 * 750_u32).map(|at| [(at % 1500) as f32, (at / 1500) as f32, 3.0]).collect();
    let large = PanoramaImage::new("large".into(), 1500, 750, large).unwrap();
    for (name, image) in [("file", image(&file())), ("large", large)] {
        let image = Arc::new(image);
        for turn_deg in [0.0, 33.0, -200.0] {
            let told = browser.run(MODULE, "means", json!([name, turn_deg, 64]));
            let got: Vec<f32> = serde_json::from_value(told).unwrap();
            let panorama = Panorama::new(Arc::clone(&image), turn_deg, 1.0).unwrap();
            let wanted: Vec<f32> = panorama.part_means(64).iter().flat_map(|mean| mean.to_array()).collect();
            assert_eq!(got.len(), wanted.len());
            let largest = wanted.iter().copied().fold(0.0, f32::max);
            let differing = |wanted: &[f32]| {
                let pairs = got.iter().zip(wanted);
                pairs.filter(|(got, wanted)| (*got - *wanted).abs() > MEANS_TOLERANCE * largest).count()
            };
            // A pixel on the border of two parts may go to the other.
            let count = differing(&wanted);
            println!("{name} turned by {turn_deg}: {count} of {} means differ", wanted.len());
            assert!(count <= wanted.len() / 16, "{count} of {} means differ", wanted.len());
            let other = Panorama::new(Arc::clone(&image), turn_deg + 5.0, 1.0).unwrap();
            let other: Vec<f32> = other.part_means(64).iter().flat_map(|mean| mean.to_array()).collect();
            assert!(differing(&other) > wanted.len() / 4, "another turn is not seen");
        }
    }
}

#[test]
#[ignore = "needs chromium"]
fn chromium_makes_no_sky_of_turns_and_pixels_that_are_none() {
    let server = served(|_| None);
    let told: Value = browser_at(&server).run(MODULE, "refusals", json!([]));
    for (words, at) in [
        ("0 × 1", 0),
        ("2 × 2", 1),
        ("twice as wide", 2),
        ("1,0", 3),
        ("turn=NaN", 4),
        ("strength=-1", 5),
        ("lower", 6),
    ] {
        assert!(
            told[at].as_str().is_some_and(|told| told.contains("panorama p") && told.contains(words)),
            "{told}"
        );
    }
}
