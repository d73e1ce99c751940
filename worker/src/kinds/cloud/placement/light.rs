//! Light by which S2 places probes (\[Sukys2014\] §3.1): indirect light under the lights of the file, captured at any place.
//!
//! Light of lamps and emissive surfaces counts from its first bounce on, as S2 decouples it; the sky counts straight. *We differ:* captures
//! do not trace paths. The reference traces irradiance once, at sites spread over the scene; a ray of a capture takes E_ind of the site
//! nearest to its hit that faces alike, and E_dir of the hit itself. All captures send the same rays, so that noise is no contrast.

use std::collections::HashMap;

use glam::{DVec3, IVec3, Vec3};
use lightkiln_proto::harmonics::relight_direction;

use super::contrast::{Gathered, Samples};
use crate::geometry::{Geometry, spread_sites};
use crate::kinds::field::light_of_file;
use crate::reference::{Precision, Reference, Site, luminance};
use crate::task::{Progress, TaskError};

/// Sites at which irradiance is traced.
const SITES: u32 = 4096;
/// Precision there; rays of a capture average over many.
const PRECISION: Precision = Precision { rel_error: 0.1, paths_max: 1 << 10 };
/// Points of a rectangle that a hit is lit from.
const RECT_POINTS: u32 = 4;
/// Rays of a capture.
const RAYS: u32 = 256;
/// Cells of the finest grid of sites over the scene's diagonal.
const CELLS: f32 = 64.0;
/// Grids of sites, each of twice the cells of the one before.
const GRIDS: usize = 8;
/// Least cosine between normals that face alike.
const ALIKE_MIN: f32 = 0.5;

/// Indirect light of a scene.
pub struct Light<'a> {
    reference: Reference<'a>,
    sites: Vec<Site>,
    /// E_ind of each.
    indirect: Vec<DVec3>,
    grids: Vec<Grid>,
}

/// Sites by cells.
struct Grid {
    cell_m: f32,
    sites: HashMap<IVec3, Vec<u32>>,
}

/// Light at a place.
#[derive(Clone, Debug, PartialEq)]
pub struct Capture {
    /// Irradiance by normal.
    pub samples: Samples,
    /// Luminance of ∫ ω L(ω) dω, the first band: where light comes from.
    pub flow: Vec3,
    /// Luminance of the mean irradiance over all normals, π times the mean radiance.
    pub mean: f32,
}

impl<'a> Light<'a> {
    /// Under the lights of the file. Errors where it has none.
    pub fn of(geometry: &'a Geometry, progress: &Progress) -> Result<Self, TaskError> {
        let lighting = light_of_file(geometry).ok_or_else(|| {
            TaskError::bad_input(
                "field_placement = 2 or 3 places probes by the lights of the scene file, which has none; add lights or emissive surfaces \
                 to it, or take field_placement = 0 or 1",
            )
        })?;
        let reference = Reference::new(geometry, &lighting).map_err(|error| {
            TaskError::bad_input_from("a light of the scene file cannot place probes", error)
        })?;
        let sites = spread_sites(geometry, SITES);
        let estimates = reference.irradiance(&sites, &PRECISION, progress)?;
        let indirect = estimates.into_iter().map(|estimate| estimate.indirect.mean).collect();
        let finest_m = geometry.diagonal_m().max(f32::MIN_POSITIVE) / CELLS;
        let grids = (0..GRIDS).map(|grid| Grid::of(&sites, finest_m * (1 << grid) as f32)).collect();
        Ok(Self { reference, sites, indirect, grids })
    }

    /// Captures the light at a place.
    pub fn at(&self, at_m: Vec3) -> Capture {
        let mut gathered = Gathered::new();
        let (mut flow, mut mean) = (DVec3::ZERO, 0.0);
        let share = 4.0 * std::f64::consts::PI / f64::from(RAYS);
        for ray in 0..RAYS {
            let direction = relight_direction(ray, RAYS);
            let radiance = self.radiance(at_m, direction) * share;
            gathered.add(direction, radiance);
            flow += luminance(radiance) * direction.as_dvec3();
            mean += 0.25 * luminance(radiance);
        }
        Capture { samples: gathered.samples(), flow: flow.as_vec3(), mean: mean as f32 }
    }

    /// Radiance that comes along a ray: of the sky, or reflected.
    fn radiance(&self, at_m: Vec3, direction: Vec3) -> DVec3 {
        let surface = match self.reference.reflector(at_m, direction) {
            Ok(surface) if surface.lit => surface,
            Ok(_) => return DVec3::ZERO,
            Err(sky) => return sky,
        };
        let albedo = Vec3::from(surface.albedo).as_dvec3();
        let direct = self.reference.direct_irradiance(&surface.site, RECT_POINTS);
        let indirect = self.nearest(&surface.site).map_or(DVec3::ZERO, |site| self.indirect[site as usize]);
        albedo * (direct + indirect) / std::f64::consts::PI
    }

    /// The site nearest to a hit that faces alike, of those in cells around it.
    fn nearest(&self, hit: &Site) -> Option<u32> {
        let of_grid = |grid: &Grid| {
            let near = grid
                .around(hit.position_m)
                .filter(|&site| self.sites[site as usize].normal.dot(hit.face_normal) > ALIKE_MIN);
            let place = |site: u32| self.sites[site as usize].position_m.distance_squared(hit.position_m);
            let (away_m2, site) = near
                .map(|site| (place(site), site))
                .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))?;
            // Farther than a cell, there may be a nearer one beyond those looked at.
            (away_m2 <= grid.cell_m.powi(2)).then_some(site)
        };
        self.grids.iter().find_map(of_grid)
    }
}

impl Grid {
    fn of(sites: &[Site], cell_m: f32) -> Self {
        let mut by_cell: HashMap<IVec3, Vec<u32>> = HashMap::new();
        for (number, site) in (0..).zip(sites) {
            by_cell.entry((site.position_m / cell_m).floor().as_ivec3()).or_default().push(number);
        }
        Self { cell_m, sites: by_cell }
    }

    fn around(&self, at_m: Vec3) -> impl Iterator<Item = u32> + '_ {
        let cell = (at_m / self.cell_m).floor().as_ivec3();
        (0..27)
            .map(move |by: i32| cell + IVec3::new(by % 3, by / 3 % 3, by / 9) - 1)
            .filter_map(|cell| self.sites.get(&cell))
            .flatten()
            .copied()
    }
}
