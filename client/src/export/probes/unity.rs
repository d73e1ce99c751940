//! Places of probes and their harmonics, as Unity's `SphericalHarmonicsL2` holds them.

use std::f32::consts::PI;

use glam::Vec4;
use serde_json::{Map, Value, json};

use super::Volume;
use crate::bake::PROBE_COEFFICIENTS;

pub const FILE: &str = "probes-unity.json";

/// Factor of each harmonic as a polynomial of the normal: 1, y, z, x, xy, yz, 3z² − 1, zx, x² − y².
const POLYNOMIALS: [f32; PROBE_COEFFICIENTS] = [
    0.282_094_8,
    0.488_602_5,
    0.488_602_5,
    0.488_602_5,
    1.092_548_4,
    1.092_548_4,
    0.315_391_57,
    1.092_548_4,
    0.546_274_2,
];
/// Signs of their mirror images: importers of glTF turn x round for Unity's left-handed world.
const MIRRORED: [f32; PROBE_COEFFICIENTS] = [1.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0, -1.0, 1.0];

/// Adds the file: all probes, those of cells too.
pub fn write(volume: &Volume<'_>, files: &mut Vec<(String, Vec<u8>)>, extras: &mut Map<String, Value>) {
    let of_channel = |own: &[Vec4], channel: usize| -> Vec<f32> {
        let factors = POLYNOMIALS.iter().zip(MIRRORED);
        own.iter().zip(factors).map(|(row, (factor, sign))| row[channel] * factor * sign / PI).collect()
    };
    let of_probe = |(probe, place): (u32, &Vec4)| {
        let [x, y, z, _] = place.to_array();
        let own = volume.coefficients(probe);
        let coefficients = [0, 1, 2].map(|channel| of_channel(own, channel)).concat();
        json!({ "position": [-x, y, z], "coefficients": coefficients })
    };
    let probes: Vec<Value> = volume.probes().zip(volume.space.positions_m()).map(of_probe).collect();
    let text = json!({ "unit": "W/m2/sr", "probes": probes });
    files.push((FILE.to_owned(), text.to_string().into_bytes()));
    extras.insert("unity".to_owned(), json!({ "file": FILE }));
}
