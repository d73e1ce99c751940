//! Probes and the tetrahedra between them, as Godot's `LightmapGIData` holds them, in a text resource.

use std::collections::BTreeSet;
use std::f32::consts::PI;
use std::fmt::{Display, Write as _};

use glam::{IVec3, Vec3, Vec4};
use lightkiln_proto::harmonics::band_of;
use serde_json::{Map, Value, json};

use super::Volume;
use super::bsp::{Node, tree};
use crate::bake::{PROBE_COEFFICIENTS, Tetrahedra};

pub const FILE: &str = "probes-godot.tres";

/// The resource, with names for what it holds.
const TEMPLATE: &str = include_str!("godot.tres");

/// Bands of the clamped cosine, which Godot's shader multiplies coefficients by.
const BANDS: [f32; 3] = [PI, 2.0 * PI / 3.0, PI / 4.0];

/// Points with coefficients of irradiance, and tetrahedra between them.
struct Mesh {
    places_m: Vec<Vec3>,
    rows: Vec<[Vec4; PROBE_COEFFICIENTS]>,
    vertices: Vec<[u32; 4]>,
}

impl Mesh {
    /// Tetrahedra of a cloud; corners of its box have the mean light of the probes that share a tetrahedron with them.
    fn of_tetrahedra(volume: &Volume<'_>, between: &Tetrahedra<'_>) -> Self {
        let probes = volume.probes().end;
        let mut rows: Vec<[Vec4; PROBE_COEFFICIENTS]> =
            volume.probes().map(|probe| volume.rows(probe)).collect();
        for corner in probes..between.places_m.len() as u32 {
            let beside: BTreeSet<u32> = between
                .vertices
                .iter()
                .filter(|of| of.contains(&corner))
                .flatten()
                .copied()
                .filter(|vertex| *vertex < probes)
                .collect();
            let mut mean = [Vec4::ZERO; PROBE_COEFFICIENTS];
            for probe in &beside {
                let share = 1.0 / beside.len() as f32;
                mean.iter_mut().zip(volume.rows(*probe)).for_each(|(mean, row)| *mean += row * share);
            }
            rows.push(mean);
        }
        let places_m = between.places_m.iter().map(|place| place.truncate()).collect();
        Self { places_m, rows, vertices: between.vertices.to_vec() }
    }

    /// Cells of a lattice, each cut into six tetrahedra about its diagonal.
    fn of_lattice(volume: &Volume<'_>) -> Self {
        const WAYS: [[usize; 2]; 6] = [[0, 1], [0, 2], [1, 0], [1, 2], [2, 0], [2, 1]];
        let [x, y, z] = volume.size();
        let points = 0..volume.probe_of.len();
        let place = |index: usize| volume.lattice.point(index).as_vec3() * volume.lattice.spacing_m;
        let cells = (1..z).flat_map(|z| (1..y).flat_map(move |y| (1..x).map(move |x| [x - 1, y - 1, z - 1])));
        let of_cell = |cell: [usize; 3]| {
            let low = IVec3::from(cell.map(|at| at as i32));
            let vertex = |at: IVec3| volume.index(at.to_array().map(|at| at as usize)) as u32;
            WAYS.map(|[a, b]| {
                let one = low + IVec3::AXES[a];
                [low, one, one + IVec3::AXES[b], low + 1].map(vertex)
            })
        };
        Self {
            places_m: points.clone().map(place).collect(),
            rows: points.map(|index| volume.rows(volume.probe_of[index])).collect(),
            vertices: cells.flat_map(of_cell).collect(),
        }
    }
}

/// Adds the file; none where there is no space between probes.
pub fn write(volume: &Volume<'_>, files: &mut Vec<(String, Vec<u8>)>, extras: &mut Map<String, Value>) {
    let mesh = match volume.space.tetrahedra() {
        Some(between) => Mesh::of_tetrahedra(volume, &between),
        None => Mesh::of_lattice(volume),
    };
    if mesh.vertices.is_empty() {
        return;
    }
    files.push((FILE.to_owned(), resource(&mesh).into_bytes()));
    extras.insert("godot".to_owned(), json!({ "file": FILE }));
}

/// The resource's text.
fn resource(mesh: &Mesh) -> String {
    let Mesh { places_m, rows, vertices } = mesh;
    let ends = [places_m[0]; 2];
    let [low_m, high_m] = places_m.iter().fold(ends, |[low, high], at| [low.min(*at), high.max(*at)]);
    let numbers = |place: Vec3| place.to_array();
    let bounds = [numbers(low_m), numbers(high_m - low_m)].concat();
    let of_node = |Node { plane, over, under }: Node| {
        let [a, b, c, d] = plane.to_array().map(|number| number.to_bits() as i32);
        [a, b, c, d, over, under]
    };
    let bsp = tree(places_m, vertices).into_iter().flat_map(of_node);
    // E / π, without the bands.
    let of_row = |(j, row): (usize, &Vec4)| {
        let [red, green, blue, _] = (*row / (PI * BANDS[band_of(j)])).to_array();
        [red, green, blue, 1.0]
    };
    let harmonics = rows.iter().flat_map(|own| own.iter().enumerate().flat_map(of_row));
    let parts = [
        ("BOUNDS", listed(bounds)),
        ("PLANES", listed(bsp)),
        ("POINTS", listed(places_m.iter().copied().flat_map(numbers))),
        ("HARMONICS", listed(harmonics)),
        ("TETRAHEDRA", listed(vertices.iter().flatten())),
    ];
    parts.iter().fold(TEMPLATE.to_owned(), |text, (name, numbers)| text.replacen(name, numbers, 1))
}

/// Numbers with commas.
fn listed(numbers: impl IntoIterator<Item = impl Display>) -> String {
    let mut text = String::new();
    for number in numbers {
        if !text.is_empty() {
            text.push_str(", ");
        }
        // Writing to a string does not fail.
        let _ = write!(text, "{number}");
    }
    text
}
