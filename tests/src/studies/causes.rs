//! Why walks hide more, or less, than rays do: each walk's part of ambient occlusion beside that of the ray along it, by cause.

use std::fmt::Write as _;

use lightkiln_proto::voxels::{
    BRICK_VOXELS, Bundle, Cone, NO_ELEMENT, OCCLUSION_REACH_M, OCCLUSION_WALKS, SUBS, Start, VoxelTable,
    WalkHit, place_in_brick, walk_within,
};
use lightkiln_worker::geometry::Site;
use rayon::prelude::*;

use crate::harness::Held;

/// Voxels on either side of a walk's end in which its element is looked for, as a share of their side.
const NEAR: [f32; 3] = [0.0, 1e-2, -1e-2];
/// Walk and ray that end so near to each other meet the same, in sides of the finest voxels.
const SAME: f32 = 0.25;
/// A plane is met in a sub-voxel, if no more than such a share of its side outside.
const WITHIN: f32 = 0.02;

/// Relation of a walk to the ray along it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Cause {
    /// They end at one place, or neither meets anything.
    Same,
    /// Both meet something, the walk before.
    Before,
    /// The ray meets something that the walk passes.
    Passed,
    /// The walk alone meets something: the plane of an element in a sub-voxel that it crosses there.
    Crossed,
    /// It is in front of the plane still, which it meets farther on.
    Ahead,
    /// All else.
    Other,
}

impl Cause {
    const ALL: [(Self, &str); 6] = [
        (Self::Same, "both end at one place"),
        (Self::Before, "walks end before rays do"),
        (Self::Passed, "rays alone meet something"),
        (Self::Crossed, "walks alone, where they cross an element's plane"),
        (Self::Ahead, "walks alone, with the element's plane ahead"),
        (Self::Other, "walks alone, else"),
    ];
}

/// Rows of the difference in occlusion by its causes, with the share of walks.
pub(super) fn rows(held: &Held, table: &VoxelTable, sites: &[Site]) -> String {
    let hidden = |t_m: Option<f32>| t_m.map_or(0.0, |t_m| (1.0 - (t_m / OCCLUSION_REACH_M).min(1.0)).powi(2));
    let of_site = |(number, site): (usize, &Site)| {
        let bundle = Bundle::new(OCCLUSION_WALKS, number as u32);
        let start = Start::on(site.position_m, site.face_normal);
        let from_m = held.world.geometry.lifted(site.position_m, site.face_normal);
        let of_walk = |walk: u32| {
            let Cone { direction, tangent } = bundle.cosine(walk, site.face_normal);
            let met = walk_within(table, &start, direction, tangent, OCCLUSION_REACH_M);
            let ray =
                held.world.geometry.tracer.closest(from_m, direction, OCCLUSION_REACH_M).map(|hit| hit.t);
            let ends = (met.map(|hit| hit.t_m), ray);
            let cause = match ends {
                (None, None) => Cause::Same,
                (Some(walk), Some(ray)) if (walk - ray).abs() < SAME * table.voxel_m => Cause::Same,
                (Some(walk), Some(ray)) if walk < ray => Cause::Before,
                (_, Some(_)) => Cause::Passed,
                (Some(_), None) => alone(table, site, direction, met),
            };
            (cause, f64::from(hidden(ends.1) - hidden(ends.0)))
        };
        (0..bundle.walks()).map(of_walk).collect::<Vec<_>>()
    };
    let all: Vec<(Cause, f64)> = sites.par_iter().enumerate().flat_map_iter(of_site).collect();
    let mut rows = String::new();
    for (cause, words) in Cause::ALL {
        let own = || all.iter().filter(|(of, _)| *of == cause);
        let (sum, count) = (own().map(|(_, part)| part).sum::<f64>(), own().count() as f64);
        let walks = all.len() as f64;
        let _ = writeln!(
            rows,
            "| {words} | {:+.4} of it, {:.2} % of walks |",
            sum / walks,
            100.0 * count / walks
        );
    }
    rows
}

/// Cause of a walk that alone meets something, by the element's plane.
fn alone(table: &VoxelTable, site: &Site, direction: glam::Vec3, met: Option<WalkHit>) -> Cause {
    let Some(hit) = met.filter(|hit| hit.element != NO_ELEMENT && !hit.is_back) else { return Cause::Other };
    let Some(row) = table.elements.get(hit.element as usize) else { return Cause::Other };
    for level in 0..=table.top_level() {
        let side_m = table.voxel_m * (1_u32 << level) as f32;
        for near in NEAR {
            let at_m = site.position_m + direction * (hit.t_m + near * side_m);
            let cell = (at_m / side_m).floor().as_ivec3();
            let brick = table.brick(level, cell.map(|along| along.div_euclid(BRICK_VOXELS)));
            let voxel = brick.and_then(|brick| table.voxel(brick, place_in_brick(cell)));
            let Some(voxel) = voxel.map(|voxel| voxel as usize) else { continue };
            let own = table.first_elements[voxel]..table.first_elements[voxel + 1];
            if !own.contains(&hit.element) {
                continue;
            }
            let middle_m = (cell.as_vec3() + 0.5) * side_m;
            let normal = row.normal();
            let plane_m = (row.height_m - normal.dot(site.position_m - middle_m)) / normal.dot(direction);
            let is_ahead = plane_m > hit.t_m + WITHIN * side_m / SUBS as f32;
            return if is_ahead { Cause::Ahead } else { Cause::Crossed };
        }
    }
    Cause::Other
}
