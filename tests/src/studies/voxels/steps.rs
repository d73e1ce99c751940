//! Times of steps and bytes of bricks, in the form of the paper's tables 6.4 to 6.13.

use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result};
use glam::{Vec2, Vec3};
use lightkiln_proto::voxels::OCCLUSION_REACH_M;
use lightkiln_worker::evaluate::default_lights;
use lightkiln_worker::geometry::{Geometry, Site};
use lightkiln_worker::reference::{PictureSize, camera_ray};
use lightkiln_worker::scene::{self, Limits, import};

use super::build::{Build, Built, built};
use super::cone::{Cone, Volume};
use super::fill::fragments;
use super::inject::{Lamp, shadow_map};
use super::measure::lamp_of;
use super::tree::{Cube, Tree};
use super::{Kind, Manner, Model};

/// Points of a picture that are timed along a side, and those of the paper's.
const POINTS: u32 = 64;
const PAPER_POINTS: f64 = 512.0 * 512.0;
/// Half angle of the narrow cone.
const SPECULAR_RAD: f32 = 0.07;
/// Diffuse cones of the paper's tables.
const CONES: u32 = 6;
/// Depths of its table of bytes.
const BYTE_DEPTHS: [u32; 3] = [7, 8, 9];

/// A scene with a lamp, and what its camera sees.
struct Stage {
    geometry: Geometry,
    lamp: Lamp,
    seen: Vec<(Site, Vec3)>,
}

impl Stage {
    fn open(path: &Path) -> Result<Self> {
        let limits = Limits::default();
        let bundle = scene::Bundle::from_bytes(scene::Bundle::pack_path(path, &limits)?, &limits)?;
        let geometry = Geometry::new(import(&bundle, &limits)?.scene)?;
        let lamp = default_lights(&geometry).lights.iter().find_map(|light| lamp_of(&light.lighting));
        let lamp = lamp.context("the scene has no place for a point light")?;
        let camera = geometry.scene.cameras.first().context("the scene has no camera")?;
        let size = PictureSize { width: POINTS, height: POINTS, grid: 1 };
        let of = |pixel: u32| {
            let at = Vec2::new((pixel % POINTS) as f32, (pixel / POINTS) as f32) + 0.5;
            let (eye_m, direction) = camera_ray(camera, &size, at.to_array());
            let hit = geometry.tracer.closest(eye_m, direction, f32::INFINITY)?;
            Some((geometry.site_at(&hit), direction))
        };
        let seen = (0..POINTS * POINTS).filter_map(of).collect();
        Ok(Self { lamp, seen, geometry })
    }

    fn built(&self, model: Model, build: &Build) -> Built {
        let kind = Kind { model, manner: Manner::Written };
        built(&self.geometry, kind, build, Some(&self.lamp), |_| Vec3::ZERO)
    }

    /// Milliseconds of diffuse cones for a picture of the paper's size, from those of its points here.
    fn diffuse_ms(&self, volume: &Volume, count: u32) -> f64 {
        self.picture_ms(|(site, _)| {
            volume
                .diffuse((site.position_m, site.face_normal), count, OCCLUSION_REACH_M, |_| Vec3::ZERO)
                .irradiance
        })
    }

    /// Likewise of one narrow cone.
    fn specular_ms(&self, volume: &Volume) -> f64 {
        self.picture_ms(|(site, seen_along)| {
            let normal = site.face_normal;
            let direction = *seen_along - 2.0 * seen_along.dot(normal) * normal;
            let cone = Cone { from_m: site.position_m, normal, direction, half_angle_rad: SPECULAR_RAD };
            volume.trace(&cone, OCCLUSION_REACH_M).light
        })
    }

    fn picture_ms(&self, light: impl Fn(&(Site, Vec3)) -> Vec3) -> f64 {
        let begun = Instant::now();
        let sum: Vec3 = self.seen.iter().map(light).sum();
        let secs = begun.elapsed().as_secs_f64();
        std::hint::black_box(sum);
        1e3 * secs * PAPER_POINTS / f64::from(POINTS * POINTS)
    }
}

/// The tables of a scene, on one thread.
pub fn steps(path: &Path, build: &Build) -> Result<String> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    pool.install(|| {
        let stage = Stage::open(path)?;
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Ok([
            by_depth(&stage, &name, build),
            voxelising(&stage, &name, build),
            injection(&stage, &name, build),
        ]
        .into_iter()
        .chain([shadow_maps(&stage, &name), cone_counts(&stage, &name, build), bytes(&stage, &name)])
        .collect::<Vec<String>>()
        .join("\n"))
    })
}

fn ms(secs: f64) -> String {
    format!("{:.1}", 1e3 * secs)
}

/// Tables 6.4, 6.5 and 6.9.
fn by_depth(stage: &Stage, name: &str, build: &Build) -> String {
    let mut page = "| 6.4, 6.5, 6.9, ms | depth | model | octree | fill and filter | injection | 6 diffuse cones | a narrow cone |\n|---|---|---|---|---|---|---|---|\n".to_owned();
    for depth in [6, 7, 8] {
        for (model, words) in [(Model::Axes, "axes"), (Model::Lobes, "lobes")] {
            let build = Build { depth, ..*build };
            let Built { volume, times, .. } = stage.built(model, &build);
            let filter = times.filter.inside_secs + times.filter.up_secs + times.filter.edges_secs;
            page += &format!(
                "| {name} | {depth} | {words} | {} | {} | {} | {:.0} | {:.0} |\n",
                ms(times.fragments_secs + times.tree_secs),
                ms(times.fill_secs + filter),
                ms(times.shadow_secs + times.inject_secs),
                stage.diffuse_ms(&volume, CONES),
                stage.specular_ms(&volume),
            );
        }
    }
    page
}

/// Table 6.11.
fn voxelising(stage: &Stage, name: &str, build: &Build) -> String {
    let mut page = "| 6.11, ms | depth | fragments | octree | fill | inside | from children | edges | nodes |\n|---|---|---|---|---|---|---|---|---|\n".to_owned();
    for depth in [6, 7, 8] {
        let Built { volume, times, .. } = stage.built(Model::Axes, &Build { depth, ..*build });
        page += &format!(
            "| {name} | {depth} | {} | {} | {} | {} | {} | {} | {} |\n",
            ms(times.fragments_secs),
            ms(times.tree_secs),
            ms(times.fill_secs),
            ms(times.filter.inside_secs),
            ms(times.filter.up_secs),
            ms(times.filter.edges_secs),
            volume.tree.node_count(),
        );
    }
    page
}

/// Table 6.13: the filter of light is that of all values.
fn injection(stage: &Stage, name: &str, build: &Build) -> String {
    let mut page = "| 6.13, ms | depth | shadow maps | texels into voxels | inside | from children | edges | texels that write, whose voxel is written, without a voxel |\n|---|---|---|---|---|---|---|---|\n".to_owned();
    for depth in [6, 7, 8] {
        let Built { times, injected, .. } = stage.built(Model::Axes, &Build { depth, ..*build });
        page += &format!(
            "| {name} | {depth} | {} | {} | {} | {} | {} | {}, {}, {} |\n",
            ms(times.shadow_secs),
            ms(times.inject_secs),
            ms(times.filter.inside_secs),
            ms(times.filter.up_secs),
            ms(times.filter.edges_secs),
            injected.written,
            injected.dropped,
            injected.lost,
        );
    }
    page
}

/// Table 6.8.
fn shadow_maps(stage: &Stage, name: &str) -> String {
    let mut page =
        "| 6.8 | texels of a side | shadow maps, ms | texels that meet a surface |\n|---|---|---|---|\n"
            .to_owned();
    for resolution in [256, 512, 1024] {
        let begun = Instant::now();
        let seen = shadow_map(&stage.geometry, &stage.lamp, resolution);
        let met = seen.iter().flatten().count();
        page += &format!("| {name} | {resolution} | {} | {met} |\n", ms(begun.elapsed().as_secs_f64()));
    }
    page
}

/// Table 6.10.
fn cone_counts(stage: &Stage, name: &str, build: &Build) -> String {
    let counts = 4..=12;
    let heads: Vec<String> = counts.clone().map(|count| count.to_string()).collect();
    let volume = stage.built(Model::Axes, build).volume;
    let cells: Vec<String> = counts.map(|count| format!("{:.0}", stage.diffuse_ms(&volume, count))).collect();
    format!(
        "| 6.10, ms by cones | {} |\n|---|{}\n| {name} | {} |\n",
        heads.join(" | "),
        "---|".repeat(heads.len()),
        cells.join(" | ")
    )
}

/// Table 6.6.
fn bytes(stage: &Stage, name: &str) -> String {
    let mut page = "| 6.6 | depth | nodes | axes, MB | lobes, MB |\n|---|---|---|---|---|\n".to_owned();
    for depth in BYTE_DEPTHS {
        let cube = Cube::about(stage.geometry.near_bounds_m(), depth);
        let found = fragments(&stage.geometry, &cube);
        let nodes = Tree::new(cube, found.iter().map(|fragment| fragment.voxel)).node_count();
        let [axes, lobes] =
            [Model::Axes, Model::Lobes].map(|model| 1e-6 * (nodes * model.node_bytes()) as f64);
        page += &format!("| {name} | {depth} | {nodes} | {axes:.1} | {lobes:.1} |\n");
    }
    page
}
