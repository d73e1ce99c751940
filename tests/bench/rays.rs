//! Rays a second on one thread, by each kind of vectors that the processor has, beside Embree on the same rays.

use std::env;
use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

use glam::Vec3;
use lightkiln_worker::geometry::{Geometry, spread_sites};
use lightkiln_worker::rays::Vectors;
use lightkiln_worker::rays::sampling::R2;
use lightkiln_worker::scene::{Bundle, Limits, import};

use crate::report::row;
use crate::scenes::scenes;

/// Places that rays leave from, spread by area, along a curve as receivers are.
const SITES: u32 = 4096;
/// Rays of each place: those that a point of a texel has at medium.
const RAYS: u32 = 64;
/// Rounds; the best of each counts, as others may use the machine.
const ROUNDS: usize = 5;

/// Starts, directions and far ends of rays.
struct Rays {
    name: &'static str,
    is_occlusion: bool,
    rays: Vec<(Vec3, Vec3, f32)>,
}

/// Measures every scene.
pub fn measure() {
    for path in scenes() {
        let place = path.file_stem().unwrap().to_string_lossy().into_owned();
        let limits = Limits::default();
        let bundle = Bundle::pack_path(&path, &limits).unwrap();
        let scene = import(&Bundle::from_bytes(bundle, &limits).unwrap(), &limits).unwrap().scene;
        let mut geometry = Geometry::new(scene).unwrap();
        let all = recorded(&geometry);
        for vectors in Vectors::all() {
            geometry.tracer = geometry.tracer.with_vectors(vectors);
            for rays in &all {
                row(&what(rays), &place, &format!("{:.2} ({})", cast(&geometry, rays), vectors.name()));
            }
        }
        for (rays, figure) in all.iter().zip(embree(&geometry, &all)) {
            row(&what(rays), &place, &figure);
        }
    }
}

fn what(rays: &Rays) -> String {
    format!("million rays a second on one thread, {}", rays.name)
}

/// The rays that a bake casts: all over hemispheres, short ones that look for what is near, and some between places.
fn recorded(geometry: &Geometry) -> [Rays; 3] {
    let sites = spread_sites(geometry, SITES);
    let start_m = |index: usize| {
        let site = &sites[index % sites.len()];
        site.ray_origin_m(geometry.tracer.ray_offset_m(site.position_m))
    };
    let near_m = geometry.near_diagonal_m() / 500.0;
    let mut rays = [Vec::new(), Vec::new(), Vec::new()];
    for (index, site) in sites.iter().enumerate() {
        let (points, from_m) = (R2::new(index as u64), start_m(index));
        for ray in 0..RAYS {
            let direction = site.direction(points.point(ray));
            rays[0].push((from_m, direction, f32::INFINITY));
            rays[1].push((from_m, direction, near_m));
            // Steps of a prime number meet other places each time.
            let to_m = start_m(index + 1 + 769 * (ray as usize + 1));
            rays[2].push((from_m, to_m - from_m, 1.0));
        }
    }
    let [closest, short, occlusion] = rays;
    [
        Rays { name: "closest", is_occlusion: false, rays: closest },
        Rays { name: "closest, short", is_occlusion: false, rays: short },
        Rays { name: "occlusion", is_occlusion: true, rays: occlusion },
    ]
}

/// Millions of rays a second of the best round.
fn cast(geometry: &Geometry, Rays { is_occlusion, rays, .. }: &Rays) -> f64 {
    let tracer = &geometry.tracer;
    let met = |&&(from_m, direction, end): &&(Vec3, Vec3, f32)| match is_occlusion {
        true => tracer.is_occluded(from_m, from_m + direction),
        false => tracer.closest(from_m, direction, end).is_some(),
    };
    let round = |_| {
        let started = Instant::now();
        std::hint::black_box(rays.iter().filter(met).count());
        rays.len() as f64 / started.elapsed().as_secs_f64() / 1e6
    };
    (0..ROUNDS).map(round).fold(0.0, f64::max)
}

/// Figures of Embree on the same triangles and rays, through its binding for Python.
fn embree(geometry: &Geometry, all: &[Rays]) -> Vec<String> {
    let folder = tempfile::tempdir().unwrap();
    let corners = (0..geometry.triangles.len() as u32).flat_map(|index| geometry.corners(index));
    write(&folder.path().join("triangles"), corners.flat_map(|corner| corner.to_array()));
    for (index, Rays { rays, .. }) in all.iter().enumerate() {
        let numbers = rays.iter().flat_map(|(from_m, direction, end)| {
            from_m.to_array().into_iter().chain(direction.to_array()).chain([*end])
        });
        write(&folder.path().join(format!("rays-{index}")), numbers);
    }
    let python = env::var("KILN_BENCH_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench/embree.py");
    let kinds = all.iter().map(|rays| if rays.is_occlusion { "OCCLUDED" } else { "INTERSECT" });
    let run =
        Command::new(python).arg(script).arg(folder.path()).arg(ROUNDS.to_string()).args(kinds).output();
    let figures = run.ok().filter(|run| run.status.success());
    let Some(figures) = figures else {
        return vec!["skipped: no Embree (pip install embreex numpy)".to_owned(); all.len()];
    };
    String::from_utf8(figures.stdout).unwrap().lines().map(|line| format!("{line} (Embree)")).collect()
}

fn write(path: &Path, numbers: impl Iterator<Item = f32>) {
    fs::write(path, numbers.flat_map(f32::to_le_bytes).collect::<Vec<u8>>()).unwrap();
}
