//! Edges between probes in free space, along which light is told from one to the next: green ones, and red ones that a surface cuts.

use std::collections::BTreeSet;
use std::sync::Arc;

use glam::Vec3;
use lightkiln_proto::content::Draw;
use lightkiln_proto::manifest::Material;

use super::components::see_each_other;
use super::probes::{no_probes, plain_material};
use crate::bake::{FreeSpace, LoadedBake, NO_PROBE};
use crate::error::Result;
use crate::scene::{Object, Rigid};

/// Thickness of a bar over the distance between probes.
const THICKNESS: f32 = 0.012;
/// Sides of a bar.
const SIDES: usize = 3;

/// An object of the edges of tetrahedra, or of a lattice's cells, to be put into the bake where it stands. Errs for a kind without light in
/// free space.
pub fn probe_edges(bake: &LoadedBake) -> Result<Object> {
    let space = bake.light.free_space().ok_or_else(|| no_probes(bake))?;
    let radius_m = 0.5 * THICKNESS * space.spacing_m();
    let mut draws = [0, 1].map(|material| Draw { material, ..Draw::default() });
    for [from, to] in edges(space) {
        let ends_m = [from, to].map(|probe| space.positions_m()[probe as usize].truncate());
        add_bar(&mut draws[usize::from(!see_each_other(space, [from, to], ends_m))], ends_m, radius_m);
    }
    let materials: Vec<Material> = vec![
        plain_material("edge", [0.1, 0.8, 0.2]),
        plain_material("edge through a surface", [0.9, 0.05, 0.05]),
    ];
    let shape = Arc::new(Rigid(draws.into_iter().filter(|draw| !draw.triangles.is_empty()).collect()));
    Ok(Object { name: "edges".to_owned(), materials, textures: Vec::new(), shape })
}

/// Pairs of probes, the lesser first.
fn edges(space: &dyn FreeSpace) -> BTreeSet<[u32; 2]> {
    let probes = space.positions_m().len() as u32;
    let sorted = |a: u32, b: u32| [a.min(b), a.max(b)];
    if let Some(between) = space.tetrahedra() {
        let pairs = |of: &[u32; 4]| {
            let of = *of;
            (0..4).flat_map(move |a| (0..a).map(move |b| sorted(of[a], of[b])))
        };
        // Corners of the box are no probes.
        return between.vertices.iter().flat_map(pairs).filter(|[_, last]| *last < probes).collect();
    }
    let Some(lattice) = space.lattice() else { return BTreeSet::new() };
    let [x, y, z] = lattice.size.to_array().map(|along| along as usize);
    let mut found = BTreeSet::new();
    for at in 0..lattice.probe_at.len() {
        let place = [at % x, at / x % y, at / (x * y)];
        for (axis, (step, count)) in [(1, x), (x, y), (x * y, z)].into_iter().enumerate() {
            if place[axis] + 1 < count {
                let pair = sorted(lattice.probe_at[at], lattice.probe_at[at + step]);
                found.extend((pair[1] != NO_PROBE).then_some(pair));
            }
        }
    }
    found
}

/// Adds a bar with open ends.
fn add_bar(draw: &mut Draw, [from_m, to_m]: [Vec3; 2], radius_m: f32) {
    let Some(way) = (to_m - from_m).try_normalize() else { return };
    let (u, v) = way.any_orthonormal_pair();
    let first = draw.position_m.len() as u32;
    for side in 0..SIDES {
        let (sine, cosine) = (std::f32::consts::TAU * side as f32 / SIDES as f32).sin_cos();
        let out = cosine * u + sine * v;
        for end_m in [from_m, to_m] {
            draw.position_m.push((end_m + radius_m * out).to_array());
            draw.normal.push(out.to_array());
        }
        let next = (side + 1) % SIDES;
        let [a, b, c, d] = [2 * side, 2 * next, 2 * side + 1, 2 * next + 1].map(|at| first + at as u32);
        draw.triangles.extend([[a, b, c], [c, b, d]]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture;

    #[test]
    fn bars_look_outwards() {
        for to_m in [Vec3::X, Vec3::new(0.3, -2.0, 0.7), Vec3::NEG_Z] {
            let mut draw = Draw::default();
            add_bar(&mut draw, [Vec3::ZERO, to_m], 0.01);
            for triangle in &draw.triangles {
                let [a, b, c] = triangle.map(|corner| Vec3::from(draw.position_m[corner as usize]));
                let out: Vec3 = triangle.iter().map(|&corner| Vec3::from(draw.normal[corner as usize])).sum();
                assert!((b - a).cross(c - a).dot(out) > 0.0, "{triangle:?} towards {to_m}");
            }
        }
    }

    #[test]
    fn edges_are_those_of_cells_and_of_tetrahedra() {
        let [lattice, cloud] = [true, false].map(fixture::field_bake);
        let [lattice, cloud] = [&lattice, &cloud].map(|bake| edges(bake.light.free_space().unwrap()));
        // 3 × 2 × 3 points; cells cut into six have all diagonals from their least corner, too.
        assert_eq!((lattice.len(), cloud.len()), (33, 57));
        assert!(lattice.is_subset(&cloud));
        let bake = fixture::field_bake(false);
        let object = probe_edges(&bake).unwrap();
        let bars: usize =
            object.shape.draws(0, 0.0).unwrap().iter().map(|draw| draw.triangles.len() / (2 * SIDES)).sum();
        assert_eq!(bars, 57);
        let plain = fixture::prt_bake(&fixture::prt_contents());
        assert!(probe_edges(&plain).unwrap_err().to_string().contains("no probes to show"));
    }
}
