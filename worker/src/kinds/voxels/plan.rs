//! Tasks of voxels: a region for each cube that a triangle touches, and the top.

use std::collections::BTreeSet;

use glam::{IVec3, Vec3};
use lightkiln_proto::jobs::{TaskInput, TaskSpec};
use lightkiln_proto::kinds::voxels::{VoxelSettings, tasks};
use lightkiln_proto::voxels::{BRICKS_MAX, BrickKey, LEVELS_MAX, REGION_LEVELS, REGION_VOXELS};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::overlap::Shape;
use super::touches::Scope;
use crate::kinds::prt::is_read_by_transport;
use crate::lightmap::World;
use crate::reads::Common;
use crate::task::{Context, TaskError};

/// Most regions of a bake.
const REGIONS_MAX: usize = 1 << 15;
/// Doublings of the sub-voxels of level 0 that a region's side has.
pub const REGION_DOUBLINGS: u32 = (REGION_VOXELS as u32 * 4).ilog2();

/// Parameters of a task of voxels.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VoxelParams {
    /// Cell of the region on the lattice of regions; none of the top.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub region: Option<[i32; 3]>,
    /// Side of the finest voxels in texels.
    pub voxel_texels: u32,
    /// Last level of all.
    pub last_level: u32,
}

impl VoxelParams {
    /// Side of the finest voxels in metres.
    pub fn voxel_m(&self, world: &World) -> f64 {
        f64::from(world.lightmap.texel_m) * f64::from(self.voxel_texels)
    }

    /// Cubes and levels of the task, for a scene with such bounds.
    pub fn scopes(&self, voxel_m: f64, [low_m, high_m]: [Vec3; 2]) -> Vec<Scope> {
        if let Some(region) = self.region {
            let root = IVec3::from(region);
            return vec![Scope {
                voxel_m,
                first: 0,
                last: REGION_LEVELS - 1,
                root_doublings: REGION_DOUBLINGS,
                root,
            }];
        }
        // The least cubes of one size of which two along each axis hold the scene.
        let sub_m = voxel_m / 4.0;
        let cells = |doublings: u32| {
            let cell_m = sub_m * 2.0_f64.powi(doublings as i32);
            [low_m, high_m].map(|corner| (corner.as_dvec3() / cell_m).floor().as_ivec3())
        };
        let spans = |doublings: &u32| {
            let [low, high] = cells(*doublings);
            (high - low).max_element() <= 1
        };
        let root_doublings = (self.last_level..31).find(spans).unwrap_or(31);
        let [low, high] = cells(root_doublings);
        let roots = (0..8).map(|part| low + IVec3::new(part & 1, part >> 1 & 1, part >> 2));
        let inside = roots.filter(|root| root.cmple(high).all());
        let scope =
            |root| Scope { voxel_m, first: REGION_LEVELS, last: self.last_level, root_doublings, root };
        inside.map(scope).collect()
    }
}

/// The tasks over the outputs of all scene tasks, which are a context's inputs; `stage` is an input of theirs too.
///
/// Errors when the scene is too large for voxels of that size.
pub fn planned(
    context: &Context,
    world: &World,
    settings: &VoxelSettings,
    stage: TaskInput,
    common: &Common,
) -> Result<Vec<TaskSpec>, TaskError> {
    let [low_m, high_m] = world.geometry.bounds_m();
    let extent_m = f64::from((high_m - low_m).max_element());
    let mut params = VoxelParams { region: None, voxel_texels: settings.voxel_texels, last_level: 0 };
    let voxel_m = params.voxel_m(world);
    // Cones open at 45° at most: no walk asks for voxels of more than half the scene.
    let spans = |level: &u32| voxel_m * f64::from(1_u32 << level) >= 0.5 * extent_m;
    params.last_level = (REGION_LEVELS..LEVELS_MAX).find(spans).unwrap_or(LEVELS_MAX - 1);
    let regions = regions(world, voxel_m)?;
    let mut inputs = context.as_inputs(is_read_by_transport);
    inputs.push(stage);
    let triangles = world.geometry.triangles.len() as u64;
    let mut all = Vec::with_capacity(regions.len() + 1);
    // The top is the longest.
    let alike = |task: TaskSpec| {
        let own = json!([task.kind, task.version, task.params]);
        let name = common.name(own.to_string().as_bytes());
        task.alike(name)
    };
    let cost = triangles / 1000 + world.lightmap.receivers.len() as u64 / 1000 + 1;
    all.push(alike(tasks::TOP.task("voxels top", json!(params), inputs.clone(), cost)));
    for cell in regions {
        let [x, y, z] = BrickKey::cell(cell).to_array();
        let of_cell = VoxelParams { region: Some([x, y, z]), ..params.clone() };
        let label = format!("voxels {x} {y} {z}");
        all.push(alike(tasks::REGION.task(label, json!(of_cell), inputs.clone(), REGION_COST)));
    }
    Ok(all)
}

/// Cost of a region.
const REGION_COST: u64 = 20;

/// Regions that a triangle touches, ascending.
fn regions(world: &World, voxel_m: f64) -> Result<BTreeSet<BrickKey>, TaskError> {
    let side_m = voxel_m * f64::from(REGION_VOXELS);
    let geometry = &world.geometry;
    let reach = geometry.bounds_m().map(|corner| corner.abs().max_element()).into_iter().fold(0.0, f32::max);
    let too_many = || {
        TaskError::bad_input(format!(
            "voxels of {voxel_m} m are too fine for a scene of {} m: more than {REGIONS_MAX} regions; raise voxel_texels or \
             texel_m, or leave voxels off",
            geometry.diagonal_m()
        ))
    };
    if f64::from(reach) / side_m >= f64::from(BRICKS_MAX >> REGION_LEVELS) {
        return Err(too_many());
    }
    // Cube that holds all regions in reach.
    let doublings = (2.0 * f64::from(reach) / side_m).max(1.0).log2().ceil() as u32 + 1;
    let of_triangle = |index: u32| {
        let mut found = Vec::new();
        if geometry.material(index).glass.is_some() {
            return found;
        }
        if let Some(shape) = Shape::new(geometry.corners(index)) {
            // Eight cubes meet in the origin.
            for part in 0..8 {
                enter(&shape, side_m, (doublings, octant(IVec3::NEG_ONE, part)), &mut found);
            }
        }
        found
    };
    let all = 0..geometry.triangles.len() as u32;
    let found: BTreeSet<BrickKey> = all
        .into_par_iter()
        .fold(BTreeSet::new, |mut found, index| {
            if found.len() <= REGIONS_MAX {
                found.extend(of_triangle(index));
            }
            found
        })
        .reduce(BTreeSet::new, |mut a, b| {
            a.extend(b);
            a
        });
    if found.len() > REGIONS_MAX { Err(too_many()) } else { Ok(found) }
}

/// One of the eight halves of cells, the lowest being `low`.
fn octant(low: IVec3, part: i32) -> IVec3 {
    low + IVec3::new(part & 1, part >> 1 & 1, part >> 2)
}

/// Adds the regions of a cube that a triangle touches, until there are too many: a scene of great extent has far more cells than any triangle
/// touches.
fn enter(shape: &Shape, side_m: f64, (doublings, cell): (u32, IVec3), found: &mut Vec<BrickKey>) {
    if found.len() > REGIONS_MAX || !shape.touches(cell, side_m * 2.0_f64.powi(doublings as i32)) {
        return;
    }
    if doublings == 0 {
        found.push(BrickKey::new(REGION_LEVELS - 1, cell));
        return;
    }
    for part in 0..8 {
        enter(shape, side_m, (doublings - 1, octant(2 * cell, part)), found);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Regions of one triangle, of regions 1 m wide.
    fn of(corners: [[f32; 3]; 3], doublings: u32) -> Vec<BrickKey> {
        let shape = Shape::new(corners.map(Vec3::from)).unwrap();
        let mut found = Vec::new();
        for part in 0..8 {
            enter(&shape, 1.0, (doublings, octant(IVec3::NEG_ONE, part)), &mut found);
        }
        found.sort_unstable();
        found
    }

    #[test]
    fn regions_of_a_triangle_are_those_that_it_touches() {
        let corners = [[-2.4, 0.3, -1.7], [3.2, 1.6, 0.4], [0.1, -2.8, 2.2]];
        let shape = Shape::new(corners.map(Vec3::from)).unwrap();
        let mut wanted = Vec::new();
        for z in -5..5 {
            for y in -5..5 {
                let along = (-5..5).map(|x| IVec3::new(x, y, z)).filter(|cell| shape.touches(*cell, 1.0));
                wanted.extend(along.map(|cell| BrickKey::new(REGION_LEVELS - 1, cell)));
            }
        }
        wanted.sort_unstable();
        assert!(wanted.len() > 20);
        for doublings in [3, 9] {
            assert_eq!(of(corners, doublings), wanted);
        }
    }

    #[test]
    fn sliver_through_a_million_cells_along_each_axis_is_soon_too_many_regions() {
        let far = 100_000.0;
        assert_eq!(of([[-far; 3], [far, far, far - 0.1], [far, far - 0.1, far]], 18).len(), REGIONS_MAX + 1);
    }
}
