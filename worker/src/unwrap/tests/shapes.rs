//! Known shapes.

use glam::{Vec2, Vec3};

use super::meshes::{Mesh, cuboid, cylinder, folded_cloth, ramp, sphere, torus, wall};
use super::rules::check;
use crate::task::Progress;
use crate::unwrap::{UnwrapSettings, unwrap_generated};

fn quarter_metre() -> UnwrapSettings {
    UnwrapSettings::with_texel_m(0.25)
}

fn chart_count(mesh: &Mesh, texel_m: f32) -> usize {
    let settings = UnwrapSettings::with_texel_m(texel_m);
    check(mesh, &mesh.unwrap(&settings), &settings).chart_count
}

#[test]
fn quad_on_the_lattice_takes_its_own_texels_and_a_border() {
    let unwrap = wall((1.0, 2.0), (3.0, 5.0)).unwrap(&quarter_metre());
    let block = &unwrap.blocks[0];
    assert_eq!((block.width, block.height), (16, 20));
    let first = block.triangles[0].uv_texels;
    assert_eq!(first[1] - first[0], Vec2::new(8.0, 0.0));
    assert_eq!(first[2] - first[0], Vec2::new(8.0, 12.0));
    assert_eq!(first[0] % 4.0, Vec2::ZERO);
}

#[test]
fn coplanar_quads_of_one_mesh_share_a_chart() {
    let mut mesh = wall((0.0, 0.0), (2.0, 2.0));
    mesh.quad([(2.0, 0.0), (5.0, 0.0), (5.0, 2.0), (2.0, 2.0)].map(|(x, y)| Vec3::new(x, y, 0.0)));
    assert_eq!(chart_count(&mesh, 0.25), 1);
}

#[test]
fn texels_of_coplanar_meshes_line_up() {
    let settings = quarter_metre();
    let offset_of = |mesh: &Mesh| {
        let triangle = &mesh.unwrap(&settings).blocks[0].triangles[0];
        let vertex = mesh.positions_m[mesh.triangles[0][0] as usize];
        triangle.uv_texels[0] - vertex.truncate() / 0.25
    };
    let here = offset_of(&wall((0.1, 0.2), (3.3, 1.7)));
    let there = offset_of(&wall((-7.9, 11.3), (2.05, 12.0)));
    let apart = (here - there) / 4.0;
    assert!((apart - apart.round()).length() < 1e-4, "{apart}");
}

#[test]
fn box_has_six_charts_even_when_shaded_smooth() {
    let mut mesh = cuboid(Vec3::new(2.0, 1.0, 3.0));
    assert_eq!(chart_count(&mesh, 0.1), 6);
    let centre = Vec3::new(1.0, 0.5, 1.5);
    mesh.normals = mesh.positions_m.iter().map(|p| (p - centre).normalize()).collect();
    assert_eq!(chart_count(&mesh, 0.1), 6);
}

#[test]
fn smooth_cylinder_has_few_charts_and_a_flat_shaded_prism_one_a_side() {
    let smooth = cylinder(32, 0.5, 4.0);
    assert!((4..=5).contains(&chart_count(&smooth, 0.05)));
    let mut prism = Mesh::default();
    for triangles in cylinder(6, 2.0, 4.0).triangles.chunks(2) {
        let source = cylinder(6, 2.0, 4.0);
        let [a, b, d] = triangles[0].map(|v| source.positions_m[v as usize]);
        prism.quad([a, b, d, source.positions_m[triangles[1][2] as usize]]);
    }
    assert_eq!(chart_count(&prism, 0.05), 6);
}

#[test]
fn sphere_and_torus_have_a_moderate_number_of_charts() {
    let spheres = chart_count(&sphere(1.0), 0.05);
    assert!((6..=20).contains(&spheres), "{spheres}");
    let tori = chart_count(&torus(2.0, 0.6), 0.05);
    assert!((6..=40).contains(&tori), "{tori}");
}

#[test]
fn spiral_ramp_is_parted_where_turns_lie_over_each_other() {
    let turns = chart_count(&ramp(5, 3.0), 0.1);
    assert!((5..=12).contains(&turns), "{turns}");
}

#[test]
fn folded_cloth_is_parted() {
    let flaps = chart_count(&folded_cloth(4), 0.1);
    assert!((4..=16).contains(&flaps), "{flaps}");
}

#[test]
fn duplicates_lie_in_different_charts() {
    let mut mesh = wall((0.0, 0.0), (0.05, 0.05));
    let copies: Vec<[u32; 3]> = mesh.triangles.iter().map(|&[a, b, c]| [b, c, a]).collect();
    mesh.triangles.extend(copies);
    for texel_m in [0.01, 0.5] {
        assert_eq!(chart_count(&mesh, texel_m), 2);
    }
}

#[test]
fn both_sides_of_a_sheet_lie_in_different_charts() {
    let mut mesh = wall((0.0, 0.0), (1.0, 1.0));
    let backs: Vec<[u32; 3]> = mesh.triangles.iter().map(|&[a, b, c]| [a, c, b]).collect();
    mesh.triangles.extend(backs);
    assert_eq!(chart_count(&mesh, 0.1), 2);
}

#[test]
fn surface_finer_than_its_texels_merges() {
    let bumpy = Mesh::surface(200, 200, |u, v| {
        let bump = ((u * 211.0).sin() + (v * 197.0).cos()) * 0.004;
        Vec3::new(u * 2.0, bump, -v * 2.0)
    });
    let charts = chart_count(&bumpy, 0.1);
    assert!(charts <= 4, "{charts}");
}

#[test]
fn bolt_below_a_texel_is_one_chart() {
    assert_eq!(chart_count(&cuboid(Vec3::splat(0.02)), 0.1), 1);
}

#[test]
fn speck_folded_beside_a_surface_of_whole_texels_has_its_own_chart() {
    let at = |x, y, z| Vec3::new(x, y, z);
    let folded = Mesh {
        positions_m: vec![
            at(0.05, 0.05, 0.0),
            at(0.95, 0.05, 0.0),
            at(0.95, 0.09, 0.0),
            at(0.95, 0.95, 0.0),
            at(0.05, 0.95, 0.0),
            at(0.95, 0.01, 0.01),
            at(0.98, 0.01, 0.01),
        ],
        // A wall facing +z, an upright speck at its corner, and one that faces -z.
        triangles: vec![[0, 1, 2], [0, 2, 3], [0, 3, 4], [2, 1, 5], [5, 1, 6]],
        ..Mesh::default()
    };
    assert_eq!(chart_count(&folded, 0.1), 2);
    let mut upright = folded;
    upright.triangles.pop();
    assert_eq!(chart_count(&upright, 0.1), 1);
}

#[test]
fn fan_of_needles_is_one_chart() {
    let mut mesh = Mesh { positions_m: vec![Vec3::ZERO], ..Mesh::default() };
    let count = 3000;
    for i in 0..count {
        let turn = i as f32 / count as f32 * std::f32::consts::TAU;
        mesh.positions_m.push(Vec3::new(turn.cos(), 0.0, -turn.sin()));
        mesh.triangles.push([0, 1 + i, 1 + (i + 1) % count]);
    }
    assert_eq!(chart_count(&mesh, 0.1), 1);
}

#[test]
fn moving_by_whole_texels_moves_charts_by_whole_texels() {
    let settings = quarter_metre();
    let still = torus(2.0, 0.5);
    // Positions on a grid of 2⁻¹⁰ m, so that the move is exact.
    let grid = |mesh: &Mesh| {
        let mut mesh = mesh.clone();
        mesh.positions_m.iter_mut().for_each(|p| *p = (*p * 1024.0).round() / 1024.0);
        mesh
    };
    let still = grid(&still);
    let moved = still.clone().moved(Vec3::new(8.0, -4.0, 12.0));
    let (a, b) = (still.unwrap(&settings), moved.unwrap(&settings));
    let charts = |u: &crate::unwrap::Unwrap| {
        u.blocks.iter().flat_map(|b| &b.triangles).map(|t| (t.source_triangle, t.chart)).collect::<Vec<_>>()
    };
    assert_eq!(charts(&a), charts(&b));
}

#[test]
fn same_input_gives_the_same_bytes() {
    let mesh = torus(1.0, 0.3);
    assert_eq!(mesh.unwrap(&quarter_metre()), mesh.unwrap(&quarter_metre()));
}

#[test]
fn nothing_and_broken_triangles_give_no_block() {
    let settings = quarter_metre();
    assert!(Mesh::default().unwrap(&settings).blocks.is_empty());
    let positions = [Vec3::ZERO, Vec3::X, Vec3::X * 2.0, Vec3::NAN, Vec3::Y];
    let triangles = [[0, 1, 2], [0, 1, 3], [0, 0, 4], [0, 1, 77]];
    assert!(
        unwrap_generated(&positions, &[], &triangles, &settings, &Progress::new()).unwrap().blocks.is_empty()
    );
}
