//! Light in cones, irradiance and ambient occlusion by the paper's models and by walks, both against rays.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use glam::{DVec3, Vec3};
use lightkiln_proto::scene::LightKind;
use lightkiln_proto::voxels::{
    Bundle, IRRADIANCE_WALKS, OCCLUSION_REACH_M, OCCLUSION_WALKS, Start, WalkLight, ambient_occlusion,
    irradiance,
};
use lightkiln_worker::emitters::radiance_of_emitters;
use lightkiln_worker::evaluate::{TestLight, default_lights};
use lightkiln_worker::geometry::Site;
use lightkiln_worker::reference::{Lighting, Reference, luminance};
use lightkiln_worker::scene::{self, Limits};
use rayon::prelude::*;

use super::build::{Build, Built, built};
use super::cone::Cone;
use super::fill::surface_of;
use super::inject::Lamp;
use super::pictures::pictures;
use super::{Kind, Manner};
use crate::harness::{Held, Recipe};
use crate::studies::walks::{
    CONE_RAYS, CONE_WALKS, CONES, HALF_ANGLES_DEG, Lights, OCCLUSION_RAYS, mean_in_cone, sites,
};

/// Rays of the truth of irradiance.
const IRRADIANCE_RAYS: u32 = 1024;
/// Bytes of an element in memory.
const ELEMENT_BYTES: u64 = 24;
/// Numbers of diffuse cones.
const DIFFUSE: [u32; 5] = [4, 6, 8, 12, 64];

/// Settings of the study.
#[derive(Clone, Debug)]
pub struct Options {
    /// Settings of the bake that walks go through.
    pub bake: serde_json::Value,
    /// Settings of the octree.
    pub build: Build,
    /// Models and manners.
    pub kinds: Vec<Kind>,
    /// Name of the light.
    pub light: String,
    /// Sites.
    pub sites: usize,
    /// Folder for pictures, if they are wanted.
    pub pictures: Option<PathBuf>,
}

/// Sums over pairs of what is found and the truth.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    count: f64,
    found: f64,
    truth: f64,
    found_found: f64,
    found_truth: f64,
    truth_truth: f64,
}

impl Sums {
    fn of(pairs: impl Iterator<Item = [f64; 2]>) -> Self {
        pairs.fold(Self::default(), |sum, [found, truth]| Self {
            count: sum.count + 1.0,
            found: sum.found + found,
            truth: sum.truth + truth,
            found_found: sum.found_found + found * found,
            found_truth: sum.found_truth + found * truth,
            truth_truth: sum.truth_truth + truth * truth,
        })
    }

    /// Root mean square error over the mean, of what is found times a factor.
    fn error(&self, scale: f64) -> f64 {
        let squares = scale * scale * self.found_found - 2.0 * scale * self.found_truth + self.truth_truth;
        (squares.max(0.0) * self.count).sqrt() / self.truth
    }

    /// Error, energy, and for `written` the error at equal energy.
    fn words(&self, kind: Option<Kind>) -> String {
        let energy = self.found / self.truth;
        let words = format!("{:.1} %, {energy:.2}", 100.0 * self.error(1.0));
        match kind {
            Some(Kind { manner: Manner::Written, .. }) if energy > 0.0 => {
                format!("{words} ({:.1} %)", 100.0 * self.error(1.0 / energy))
            }
            _ => words,
        }
    }
}

/// A scene with its light, and the volumes of all models.
pub struct Stage<'a> {
    /// The bake's light.
    pub(super) lights: Lights<'a>,
    /// Direct light alone, which `written` volumes reflect once.
    pub direct: Reference<'a>,
    volumes: Vec<Built>,
    sites: Vec<Site>,
}

impl Stage<'_> {
    /// Radiance along a ray by one bounce of the lamp.
    fn once_by_ray(&self, site: &Site, direction: Vec3) -> Vec3 {
        let geometry = &self.lights.held.world.geometry;
        let from_m = geometry.lifted(site.position_m, site.face_normal);
        let Some(hit) = geometry.tracer.closest(from_m, direction, f32::INFINITY) else { return Vec3::ZERO };
        if geometry.is_back(&hit) {
            return Vec3::ZERO;
        }
        let albedo = Vec3::from(surface_of(geometry, &hit).albedo);
        albedo
            * self.direct.direct_irradiance(&geometry.site_at(&hit), 1).as_vec3()
            * std::f32::consts::FRAC_1_PI
    }

    /// The truth that a volume is held against.
    fn truth(&self, kind: Kind, [all, once]: [f64; 2]) -> f64 {
        if kind.manner == Manner::Written { once } else { all }
    }
}

/// Bakes a scene and measures it; a table in Markdown.
pub fn measured(path: &Path, options: &Options) -> Result<String> {
    let bundle = scene::Bundle::pack_path(path, &Limits::default())?;
    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let held = Held::new(bundle, &Recipe { kind: "prt", settings: options.bake.clone() })?;
    let (table, patches) = held.decoded.voxels(&held.bake)?;
    let chosen = light_of(&held, &options.light)?;
    let lit = held.under(&chosen.lighting)?;
    let scale = chosen.lighting.emitter_scale;
    let emitters = radiance_of_emitters(&held.world.geometry.scene);
    let emitter = |emitter: u16| Vec3::from(emitters[usize::from(emitter)]) * scale;
    let light = WalkLight::new(&table, patches, &lit.light().settled.lambda, emitter);
    let patch_of_slot = patches.finest_of_slots();
    let lights = Lights { held: &held, light, table: &table, patch_of_slot, emitter_scale: scale };
    let lamp = lamp_of(&chosen.lighting);
    let kinds = options.kinds.iter().filter(|kind| lamp.is_some() || kind.manner == Manner::Mended);
    let of = |kind: &Kind| {
        built(&held.world.geometry, *kind, &options.build, lamp.as_ref(), |hit| lights.of_hit(hit))
    };
    let volumes: Vec<Built> = kinds.map(of).collect();
    let direct = Reference::new(&held.world.geometry, &chosen.lighting)?;
    let sites = sites(&held, options.sites);
    let stage = Stage { lights, direct, volumes, sites };
    let kinds: Vec<String> = stage.volumes.iter().map(|built| built.volume.kind.words()).collect();
    let mut page = format!("| `{name}`, {} | walks | rays | {} |\n", chosen.name, kinds.join(" | "));
    page += &format!("|---|---|---|{}\n", "---|".repeat(kinds.len()));
    for half_angle_deg in HALF_ANGLES_DEG {
        write!(page, "| radiance in cones of {half_angle_deg}° |")?;
        page += &row(&stage, &cones(&stage, half_angle_deg.to_radians()));
    }
    for count in DIFFUSE {
        write!(page, "| irradiance by {count} cones, {IRRADIANCE_WALKS} walks or rays |")?;
        page += &row(&stage, &diffuse(&stage, count));
    }
    page += &occlusion(&stage, 6);
    page += &sizes(&stage)?;
    if let Some(folder) = &options.pictures {
        let lamp = lamp.context("pictures are of a point light")?;
        pictures(&stage, lamp, options.build, folder)?;
    }
    Ok(page)
}

/// The light of a name among those that scenes are measured with.
fn light_of(held: &Held, name: &str) -> Result<TestLight> {
    let lights = default_lights(&held.world.geometry).lights;
    let names: Vec<&str> = lights.iter().map(|light| light.name.as_str()).collect();
    let names = names.join(", ");
    let found = lights.into_iter().find(|light| light.name == name);
    found.with_context(|| format!("there is no light '{name}'; there are {names}"))
}

/// The lamp of a light that is one.
pub fn lamp_of(lighting: &Lighting) -> Option<Lamp> {
    match lighting.lights.as_slice() {
        [lamp] => match lamp.kind {
            LightKind::Point { position_m, .. } => {
                Some(Lamp { position_m: position_m.into(), intensity: lamp.strength.into() })
            }
            _ => None,
        },
        _ => None,
    }
}

/// Figures of a place: the truths, by walks, by rays along them, by each volume.
struct Figures {
    truths: [f64; 2],
    walks: f64,
    rays: f64,
    volumes: Vec<f64>,
}

fn row(stage: &Stage, figures: &[Figures]) -> String {
    let of = |found: &dyn Fn(&Figures) -> f64| {
        Sums::of(figures.iter().map(|figure| [found(figure), figure.truths[0]])).words(None)
    };
    let mut row = format!(" {} | {} |", of(&|figure| figure.walks), of(&|figure| figure.rays));
    for (at, built) in stage.volumes.iter().enumerate() {
        let kind = built.volume.kind;
        let pairs = figures.iter().map(|figure| [figure.volumes[at], stage.truth(kind, figure.truths)]);
        row += &format!(" {} |", Sums::of(pairs).words(Some(kind)));
    }
    row + "\n"
}

/// Mean radiance in cones about the axes of each site.
fn cones(stage: &Stage, half_angle_rad: f32) -> Vec<Figures> {
    let lights = &stage.lights;
    let of_site = |(number, site): (usize, &Site)| {
        let axes = Bundle::new(CONES, number as u32);
        let of_cone = |cone: u32| {
            let axis = axes.cosine(cone, site.face_normal).direction;
            let identity = number as u32 * CONES + cone;
            let mean = |count: u32, of: &dyn Fn(Vec3, f32) -> Vec3| {
                mean_in_cone(&Bundle::new(count, identity), (axis, half_angle_rad), site.face_normal, of)
            };
            let cone =
                Cone { from_m: site.position_m, normal: site.face_normal, direction: axis, half_angle_rad };
            let traced = |built: &Built| {
                let volume = &built.volume;
                let met = volume.trace(&cone, OCCLUSION_REACH_M);
                luminance(volume.with_sky(&met, axis, |direction| lights.light.of_sky(direction)).as_dvec3())
            };
            Figures {
                truths: [
                    mean(CONE_RAYS, &|direction, _| lights.by_ray(site, direction)),
                    mean(CONE_RAYS, &|direction, _| stage.once_by_ray(site, direction)),
                ],
                walks: mean(CONE_WALKS, &|direction, tangent| lights.by_walk(site, direction, tangent)),
                rays: mean(CONE_WALKS, &|direction, _| lights.by_ray(site, direction)),
                volumes: stage.volumes.iter().map(traced).collect(),
            }
        };
        (0..CONES).map(of_cone).collect::<Vec<_>>()
    };
    stage.sites.par_iter().enumerate().flat_map_iter(of_site).collect()
}

/// Irradiance by so many cones.
fn diffuse(stage: &Stage, count: u32) -> Vec<Figures> {
    let lights = &stage.lights;
    let of_site = |(number, site): (usize, &Site)| {
        let normal = site.face_normal;
        let by_rays = |rays: u32, of: &dyn Fn(Vec3) -> Vec3| {
            let bundle = Bundle::new(rays, number as u32);
            let along = |ray: u32| of(bundle.cosine(ray, normal).direction).as_dvec3();
            luminance((0..rays).map(along).sum::<DVec3>() * std::f64::consts::PI / f64::from(rays))
        };
        let start = Start::on(site.position_m, normal);
        let bundle = Bundle::new(IRRADIANCE_WALKS, number as u32);
        let walks = irradiance(lights.table, &start, normal, &bundle, |seen| lights.light.radiance(seen));
        let traced = |built: &Built| {
            let sky = |direction: Vec3| lights.light.of_sky(direction);
            let found = built.volume.diffuse((site.position_m, normal), count, OCCLUSION_REACH_M, sky);
            luminance(found.irradiance.as_dvec3())
        };
        Figures {
            truths: [
                by_rays(IRRADIANCE_RAYS, &|direction| lights.by_ray(site, direction)),
                by_rays(IRRADIANCE_RAYS, &|direction| stage.once_by_ray(site, direction)),
            ],
            walks: luminance(walks.as_dvec3()),
            rays: by_rays(IRRADIANCE_WALKS, &|direction| lights.by_ray(site, direction)),
            volumes: stage.volumes.iter().map(traced).collect(),
        }
    };
    stage.sites.par_iter().enumerate().map(of_site).collect()
}

/// Bytes: of elements where they are read, and of bricks in the paper's format.
fn sizes(stage: &Stage) -> Result<String> {
    let body: lightkiln_proto::kinds::prt::Body = stage.lights.held.bake.manifest.body()?;
    let elements: u64 = body.voxels.context("the bake has no voxels")?.elements.iter().sum();
    let mut row =
        format!("| bytes where they are read, MB | {:.2} |  |", 1e-6 * (ELEMENT_BYTES * elements) as f64);
    for Built { volume, .. } in &stage.volumes {
        let bytes = volume.tree.node_count() * volume.kind.model.node_bytes();
        row += &format!(" {:.1} |", 1e-6 * bytes as f64);
    }
    Ok(row + "\n")
}

/// Ambient occlusion: mean difference from that of rays, and mean of its sizes.
fn occlusion(stage: &Stage, count: u32) -> String {
    let geometry = &stage.lights.held.world.geometry;
    let of_site = |(number, site): (usize, &Site)| {
        let normal = site.face_normal;
        let by_rays = |rays: u32| {
            let bundle = Bundle::new(rays, number as u32);
            let from_m = geometry.lifted(site.position_m, normal);
            let hidden = |ray: u32| {
                let direction = bundle.cosine(ray, normal).direction;
                let hit = geometry.tracer.closest(from_m, direction, OCCLUSION_REACH_M);
                hit.map_or(0.0, |hit| (1.0 - hit.t / OCCLUSION_REACH_M).powi(2))
            };
            1.0 - (0..rays).map(hidden).sum::<f32>() / rays as f32
        };
        let truth = by_rays(OCCLUSION_RAYS);
        let bundle = Bundle::new(OCCLUSION_WALKS, number as u32);
        let start = Start::on(site.position_m, normal);
        let walks = ambient_occlusion(stage.lights.table, &start, normal, &bundle, OCCLUSION_REACH_M);
        let traced = |built: &Built| {
            built.volume.diffuse((site.position_m, normal), count, OCCLUSION_REACH_M, |_| Vec3::ZERO).open
        };
        let found = [walks, by_rays(OCCLUSION_WALKS)].into_iter().chain(stage.volumes.iter().map(traced));
        found.map(|found| f64::from(found - truth)).collect::<Vec<f64>>()
    };
    let all: Vec<Vec<f64>> = stage.sites.par_iter().enumerate().map(of_site).collect();
    let mut row = format!(
        "| ambient occlusion within {OCCLUSION_REACH_M} m by {count} cones, {OCCLUSION_WALKS} walks or rays |"
    );
    for at in 0..2 + stage.volumes.len() {
        let mean = |of: fn(f64) -> f64| all.iter().map(|found| of(found[at])).sum::<f64>() / all.len() as f64;
        row += &format!(" {:+.3}, {:.3} |", mean(|off| off), mean(f64::abs));
    }
    row + "\n"
}
