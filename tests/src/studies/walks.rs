//! Walks through voxels beside rays through triangles: light in cones, ambient occlusion, directions that go through walls, bytes,
//! walks a second.

use std::fmt::Write as _;
use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result};
use glam::{DVec3, Vec3};
use lightkiln_proto::relight::NO_PATCH;
use lightkiln_proto::voxels::{
    Bundle, OCCLUSION_REACH_M, OCCLUSION_WALKS, Seen, Start, VOXELS, VoxelTable, VoxelTotals, WalkLight,
    ambient_occlusion, walk,
};
use lightkiln_worker::emitters::radiance_of_emitters;
use lightkiln_worker::evaluate::default_lights;
use lightkiln_worker::geometry::Site;
use lightkiln_worker::lightmap::Surface;
use lightkiln_worker::rays::Hit;
use lightkiln_worker::reference::luminance;
use lightkiln_worker::scene::{self, Limits};
use rayon::prelude::*;

use super::causes;
use crate::harness::{Held, Recipe};

/// Half angles of cones, in degrees.
pub(super) const HALF_ANGLES_DEG: [f32; 4] = [2.0, 8.0, 15.0, 30.0];
/// Walks of a cone, and rays of its truth.
pub(super) const CONE_WALKS: u32 = 16;
pub(super) const CONE_RAYS: u32 = 512;
/// Sites, and cones about each.
pub(super) const SITES: usize = 300;
pub(super) const CONES: u32 = 16;
/// Rays of the truth of ambient occlusion.
pub(super) const OCCLUSION_RAYS: u32 = 1024;
/// Walks whose speed and leaks are measured.
const WALKS: u32 = 400_000;

/// The bake's own light along rays and walks.
pub(super) struct Lights<'a> {
    pub(super) held: &'a Held,
    pub(super) light: WalkLight<'a>,
    pub(super) table: &'a VoxelTable,
    pub(super) patch_of_slot: Vec<u32>,
    pub(super) emitter_scale: f32,
}

impl Lights<'_> {
    /// Radiance along a ray, of the finest patch that it meets.
    pub(super) fn by_ray(&self, site: &Site, direction: Vec3) -> Vec3 {
        let geometry = &self.held.world.geometry;
        let from_m = geometry.lifted(site.position_m, site.face_normal);
        let hit = geometry.tracer.closest(from_m, direction, f32::INFINITY);
        hit.map_or_else(|| self.light.of_sky(direction), |hit| self.of_hit(&hit))
    }

    /// Radiance of the side that is hit.
    pub(super) fn of_hit(&self, hit: &Hit) -> Vec3 {
        let world = &self.held.world;
        if world.geometry.is_back(hit) {
            return Vec3::ZERO;
        }
        let glow = Vec3::from(world.geometry.material(hit.triangle).emissive) * self.emitter_scale;
        let met = world.linked_surface_at(hit, world.geometry.point_of(hit));
        let Surface::Receiver(receiver) = met else { return glow };
        let slot = self.held.slot(receiver);
        let patch =
            slot.and_then(|slot| self.patch_of_slot.get(slot as usize)).filter(|patch| **patch != NO_PATCH);
        glow + patch.map_or(Vec3::ZERO, |patch| self.light.of_patch(*patch))
    }

    pub(super) fn by_walk(&self, site: &Site, direction: Vec3, tangent: f32) -> Vec3 {
        let start = Start::on(site.position_m, site.face_normal);
        let met = walk(self.table, &start, direction, tangent).map_or(Seen::Sky(direction), Seen::Hit);
        self.light.radiance(&met)
    }
}

/// Errors of some figure against its truth: root mean square over the mean, and the ratio of means.
#[derive(Default)]
struct Errors {
    squares: f64,
    truth: f64,
    found: f64,
    count: f64,
}

impl Errors {
    fn of(pairs: impl Iterator<Item = [f64; 2]>) -> Self {
        pairs.fold(Self::default(), |sum, [found, truth]| Self {
            squares: sum.squares + (found - truth).powi(2),
            truth: sum.truth + truth,
            found: sum.found + found,
            count: sum.count + 1.0,
        })
    }

    fn words(&self) -> String {
        let mean = self.truth / self.count;
        format!(
            "{:.1} %, energy {:.3}",
            100.0 * (self.squares / self.count).sqrt() / mean,
            self.found / self.truth
        )
    }
}

/// Bakes a scene and measures it; a table in Markdown.
pub fn measured(path: &Path, settings: serde_json::Value) -> Result<String> {
    let bundle = scene::Bundle::pack_path(path, &Limits::default())?;
    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let held = Held::new(bundle, &Recipe { kind: "prt", settings })?;
    let (table, patches) = held.decoded.voxels(&held.bake)?;
    let mut page = format!("| `{name}` | |\n|---|---|\n");
    page += &sizes(&held, &table)?;
    let sites = sites(&held, SITES);
    let emitters = radiance_of_emitters(&held.world.geometry.scene);
    for chosen in default_lights(&held.world.geometry).lights {
        let lit = held.under(&chosen.lighting)?;
        let scale = chosen.lighting.emitter_scale;
        let emitter = |emitter: u16| Vec3::from(emitters[usize::from(emitter)]) * scale;
        let light = WalkLight::new(&table, patches, &lit.light().settled.lambda, emitter);
        let patch_of_slot = patches.finest_of_slots();
        let lights = Lights { held: &held, light, table: &table, patch_of_slot, emitter_scale: scale };
        for half_angle_deg in HALF_ANGLES_DEG {
            let [walks, rays] = cones(&lights, &sites, half_angle_deg.to_radians());
            let (walks, rays) = (walks.words(), rays.words());
            writeln!(
                page,
                "| radiance in cones of {half_angle_deg}°, {} | walks {walks}; rays along them {rays} |",
                chosen.name
            )?;
        }
    }
    page += &occlusion(&held, &table, &sites)?;
    page += &causes::rows(&held, &table, &sites);
    page += &speed(&held, &table, &sites)?;
    Ok(page)
}

/// So many receivers, evenly chosen.
pub(super) fn sites(held: &Held, count: usize) -> Vec<Site> {
    let all: Vec<u32> = held.receivers(|_| true).into_iter().filter(|&r| held.slot(r).is_some()).collect();
    let step = (all.len() / count).max(1);
    all.iter()
        .step_by(step)
        .map(|&receiver| held.world.lightmap.receivers[receiver as usize].site())
        .collect()
}

fn sizes(held: &Held, table: &VoxelTable) -> Result<String> {
    let body: lightkiln_proto::kinds::prt::Body = held.bake.manifest.body()?;
    let VoxelTotals { elements, .. } = body.voxels.context("the bake has no voxels")?;
    let count: u64 = elements.iter().sum();
    let bytes: u64 = held.bake.manifest.chunks(VOXELS).iter().map(|chunk| chunk.bytes).sum();
    let receivers = held.receivers(|_| true).len() as f64;
    Ok(format!(
        "| elements | {count}, voxels of {} m; {:.2} a receiver |\n| bytes | {:.1} an element, {:.1} a receiver |\n",
        table.voxel_m,
        count as f64 / receivers,
        bytes as f64 / count as f64,
        bytes as f64 / receivers,
    ))
}

/// Luminance of the mean radiance along a bundle's directions in a cone of an axis and a half angle, of those above a face; each is found from its
/// direction and the tangent of its own half angle.
pub(super) fn mean_in_cone(
    bundle: &Bundle,
    (axis, half_angle_rad): (Vec3, f32),
    face_normal: Vec3,
    of: &dyn Fn(Vec3, f32) -> Vec3,
) -> f64 {
    let along = |walk: u32| bundle.uniform(walk, axis, half_angle_rad);
    let above = (0..bundle.walks()).map(along).filter(|cone| cone.direction.dot(face_normal) > 0.0);
    let (sum, met) = above.fold((DVec3::ZERO, 0.0), |(sum, met), cone| {
        (sum + of(cone.direction, cone.tangent).as_dvec3(), met + 1.0)
    });
    luminance(sum / f64::max(met, 1.0))
}

/// Mean radiance in cones by walks, and by rays along the walks' directions, both against that of many rays.
fn cones(lights: &Lights, sites: &[Site], half_angle_rad: f32) -> [Errors; 2] {
    let of_site = |(number, site): (usize, &Site)| {
        let axes = Bundle::new(CONES, number as u32);
        let of_cone = |cone: u32| {
            let axis = axes.cosine(cone, site.face_normal).direction;
            let identity = number as u32 * CONES + cone;
            let mean = |count: u32, of: &dyn Fn(Vec3, f32) -> Vec3| {
                mean_in_cone(&Bundle::new(count, identity), (axis, half_angle_rad), site.face_normal, of)
            };
            let truth = mean(CONE_RAYS, &|direction, _| lights.by_ray(site, direction));
            let rays = mean(CONE_WALKS, &|direction, _| lights.by_ray(site, direction));
            let walks = mean(CONE_WALKS, &|direction, tangent| lights.by_walk(site, direction, tangent));
            [[walks, truth], [rays, truth]]
        };
        (0..CONES).map(of_cone).collect::<Vec<_>>()
    };
    let all: Vec<[[f64; 2]; 2]> = sites.par_iter().enumerate().flat_map_iter(of_site).collect();
    [0, 1].map(|which| Errors::of(all.iter().map(|pair| pair[which])))
}

/// Ambient occlusion by walks against rays.
fn occlusion(held: &Held, table: &VoxelTable, sites: &[Site]) -> Result<String> {
    let of_site = |(number, site): (usize, &Site)| {
        let bundle = Bundle::new(OCCLUSION_WALKS, number as u32);
        let start = Start::on(site.position_m, site.face_normal);
        let walks = ambient_occlusion(table, &start, site.face_normal, &bundle, OCCLUSION_REACH_M);
        let by_rays = |bundle: &Bundle| {
            let from_m = held.world.geometry.lifted(site.position_m, site.face_normal);
            let hidden = |ray: u32| {
                let direction = bundle.cosine(ray, site.face_normal).direction;
                let hit = held.world.geometry.tracer.closest(from_m, direction, OCCLUSION_REACH_M);
                hit.map_or(0.0, |hit| (1.0 - hit.t / OCCLUSION_REACH_M).powi(2))
            };
            1.0 - (0..bundle.walks()).map(hidden).sum::<f32>() / bundle.walks() as f32
        };
        let truth = by_rays(&Bundle::new(OCCLUSION_RAYS, number as u32));
        [walks, by_rays(&bundle)].map(|found| f64::from(found - truth))
    };
    let all: Vec<[f64; 2]> = sites.par_iter().enumerate().map(of_site).collect();
    let mean = |which: usize, of: fn(f64) -> f64| {
        all.iter().map(|pair| of(pair[which])).sum::<f64>() / all.len() as f64
    };
    Ok(format!(
        "| ambient occlusion within {OCCLUSION_REACH_M} m | walks differ from rays by {:.4} in the mean, {:.4} each; rays along them by {:.4} each |\n",
        mean(0, |difference| difference),
        mean(0, f64::abs),
        mean(1, f64::abs),
    ))
}

/// Walks a second on one thread; the share that reaches the sky where rays do not, and the reverse; and the difference of lengths.
fn speed(held: &Held, table: &VoxelTable, sites: &[Site]) -> Result<String> {
    let bundle = Bundle::new(WALKS, 7);
    let of = |walk: u32| {
        let site = &sites[walk as usize % sites.len()];
        (site, bundle.cosine(walk, site.face_normal).direction)
    };
    let begun = Instant::now();
    let mut met = 0_u32;
    for number in 0..WALKS {
        let (site, direction) = of(number);
        met +=
            u32::from(walk(table, &Start::on(site.position_m, site.face_normal), direction, 0.05).is_some());
    }
    let each = WALKS as f64 / begun.elapsed().as_secs_f64();
    let compare = |number: u32| {
        let (site, direction) = of(number);
        let walked = walk(table, &Start::on(site.position_m, site.face_normal), direction, 0.0);
        let from_m = held.world.geometry.lifted(site.position_m, site.face_normal);
        let traced = held.world.geometry.tracer.closest(from_m, direction, f32::INFINITY);
        let apart = walked.zip(traced).map(|(walk, ray)| f64::from((walk.t_m - ray.t).abs() / table.voxel_m));
        [
            f64::from(u8::from(walked.is_none() && traced.is_some())),
            f64::from(u8::from(walked.is_some() && traced.is_none())),
            f64::from(u8::from(apart.is_some_and(|apart| apart > 1.0))),
        ]
    };
    let sums = (0..WALKS / 4)
        .into_par_iter()
        .map(compare)
        .reduce(|| [0.0; 3], |a, b| std::array::from_fn(|which| a[which] + b[which]));
    let [escaped, stopped, apart] = sums.map(|sum| 400.0 * sum / f64::from(WALKS));
    Ok(format!(
        "| {WALKS} walks, τ = 0.05, one thread | {:.2} million a second, {:.1} % meet a surface |\n\
         | walks without width | {escaped:.3} % reach the sky where rays meet a surface, {stopped:.3} % the reverse; {apart:.2} % end more than a \
         voxel off |\n",
        each * 1e-6,
        100.0 * f64::from(met) / f64::from(WALKS),
    ))
}
