//! Rules that every unwrap must keep, as one check for all tests.

use glam::{DVec2, Vec3};

use super::meshes::{Mesh, wall};
use crate::unwrap::overlap::{FOLD_TEXELS, Footprint, PENETRATION_TEXELS, any_cell, penetration};
use crate::unwrap::{Unwrap, UnwrapBlock, UnwrapSettings, UnwrappedTriangle};

/// Figures of an unwrap that tests compare.
pub struct Checked {
    pub chart_count: usize,
}

/// Asserts every rule that holds for any mesh.
pub fn check(mesh: &Mesh, unwrap: &Unwrap, settings: &UnwrapSettings) -> Checked {
    every_triangle_once(mesh, unwrap);
    for block in &unwrap.blocks {
        assert!(block.width <= settings.max_block_texels && block.height <= settings.max_block_texels);
        assert_eq!(
            (block.width % settings.lod_align_texels, block.height % settings.lod_align_texels),
            (0, 0)
        );
        charts_keep_their_gutter(block, settings);
        charts_do_not_overlap_themselves(mesh, block, settings);
    }
    let mut charts: Vec<u32> = unwrap.blocks.iter().flat_map(|b| &b.triangles).map(|t| t.chart).collect();
    charts.sort_unstable();
    charts.dedup();
    Checked { chart_count: charts.len() }
}

fn every_triangle_once(mesh: &Mesh, unwrap: &Unwrap) {
    let mut seen = vec![0; mesh.triangles.len()];
    for triangle in unwrap.blocks.iter().flat_map(|b| &b.triangles).filter(|t| t.piece_corners.is_none()) {
        seen[triangle.source_triangle as usize] += 1;
    }
    let cut = |i: u32| unwrap.blocks.iter().flat_map(|b| &b.triangles).any(|t| t.source_triangle == i);
    for (index, &count) in seen.iter().enumerate() {
        let corners = mesh.triangles[index].map(|v| mesh.positions_m[v as usize].as_dvec3());
        let has_area = (corners[1] - corners[0]).cross(corners[2] - corners[0]).length() > 0.0;
        assert!(count <= 1, "triangle {index} placed {count} times");
        assert_eq!(count == 1 || cut(index as u32), has_area, "triangle {index}");
    }
}

fn corners(triangle: &UnwrappedTriangle) -> [DVec2; 3] {
    triangle.uv_texels.map(|p| p.as_dvec2())
}

/// Charts keep `gutter` free texels between them and their border at the edge.
fn charts_keep_their_gutter(block: &UnwrapBlock, settings: &UnwrapSettings) {
    let (width, gutter) = (block.width as i32, settings.gutter_texels as i32);
    let border = settings.border_texels() as i32;
    let mut owner = vec![u32::MAX; (block.width * block.height) as usize];
    for triangle in &block.triangles {
        any_cell(&corners(triangle), 1.0, 1e-3, |x, y| {
            assert!(x >= border && y >= border && x < width - border && y < block.height as i32 - border);
            let texel = &mut owner[(y * width + x) as usize];
            assert!(*texel == u32::MAX || *texel == triangle.chart, "charts share texel {x} {y}");
            *texel = triangle.chart;
            false
        });
    }
    for (index, &chart) in owner.iter().enumerate().filter(|(_, chart)| **chart != u32::MAX) {
        let (x, y) = (index as i32 % width, index as i32 / width);
        for (dx, dy) in (0..=gutter).flat_map(|dy| (-gutter..=gutter).map(move |dx| (dx, dy))) {
            let (nx, ny) = (x + dx, y + dy);
            if (0..width).contains(&nx) && ny < block.height as i32 {
                let other = owner[(ny * width + nx) as usize];
                assert!(other == u32::MAX || other == chart, "charts {chart} and {other} too near");
            }
        }
    }
}

/// Triangles of a chart overlap only as far as `overlap` allows. Quadratic: for small meshes.
fn charts_do_not_overlap_themselves(mesh: &Mesh, block: &UnwrapBlock, settings: &UnwrapSettings) {
    if block.triangles.len() > 6000 {
        return;
    }
    for (i, a) in block.triangles.iter().enumerate() {
        for b in block.triangles[..i].iter().filter(|b| b.chart == a.chart) {
            let depth = penetration(&corners(a), &corners(b));
            if depth > PENETRATION_TEXELS + 2e-3 {
                let pair = (a.source_triangle, b.source_triangle);
                assert!(is_small(a) || is_small(b), "triangles {pair:?} overlap by {depth} texels");
                let apart = nearest_corners_m(mesh, pair) / settings.texel_m;
                assert!(
                    f64::from(apart) < 2.0 * FOLD_TEXELS + 4.0,
                    "triangles {pair:?} share texels from afar"
                );
            }
        }
    }
}

fn is_small(triangle: &UnwrappedTriangle) -> bool {
    Footprint { uv: corners(triangle), height: [0.0; 3] }.is_small()
}

/// Distance of the nearest corners of a small triangle from the plane of the other, at most.
fn nearest_corners_m(mesh: &Mesh, pair: (u32, u32)) -> f32 {
    let corners = |t: u32| mesh.triangles[t as usize].map(|v| mesh.positions_m[v as usize]);
    let plane_distance = |t: u32, p: Vec3| {
        let [a, b, c] = corners(t);
        (b - a).cross(c - a).normalize_or_zero().dot(p - a).abs()
    };
    let least =
        |t: u32, of: u32| corners(of).into_iter().map(|p| plane_distance(t, p)).fold(f32::MAX, f32::min);
    least(pair.0, pair.1).min(least(pair.1, pair.0))
}

#[test]
#[should_panic(expected = "charts share texel")]
fn check_catches_charts_in_one_texel() {
    let settings = UnwrapSettings::with_texel_m(0.25);
    let mesh = wall((0.0, 0.0), (1.0, 1.0));
    let mut unwrap = mesh.unwrap(&settings);
    unwrap.blocks[0].triangles[1].chart += 1;
    check(&mesh, &unwrap, &settings);
}

#[test]
#[should_panic(expected = "overlap by")]
fn check_catches_an_overlap() {
    let settings = UnwrapSettings::with_texel_m(0.25);
    let mesh = wall((0.0, 0.0), (1.0, 1.0));
    let mut unwrap = mesh.unwrap(&settings);
    unwrap.blocks[0].triangles[1].uv_texels = unwrap.blocks[0].triangles[0].uv_texels;
    check(&mesh, &unwrap, &settings);
}
