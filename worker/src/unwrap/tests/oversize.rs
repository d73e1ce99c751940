//! Surfaces at and beyond the limits.

use glam::{Vec2, Vec3};

use super::meshes::wall;
use super::rules::check;
use crate::task::Progress;
use crate::unwrap::{UnwrapError, UnwrapLookup, UnwrapSettings, unwrap_generated};

fn small_blocks() -> UnwrapSettings {
    UnwrapSettings { max_block_texels: 128, ..UnwrapSettings::with_texel_m(0.1) }
}

#[test]
fn wall_larger_than_a_block_is_cut_along_the_lattice() {
    let settings = small_blocks();
    let mesh = wall((-17.3, 3.3), (21.9, 30.1));
    let unwrap = mesh.unwrap(&settings);
    assert!(unwrap.blocks.len() > 4);
    check(&mesh, &unwrap, &settings);
    let area: f32 = unwrap.blocks.iter().flat_map(|b| &b.triangles).map(|t| area(t.uv_texels)).sum();
    let expected = (mesh.area_m2(0) + mesh.area_m2(1)) / 0.01;
    assert!((area - expected).abs() < 1e-3 * expected, "{area} of {expected}");
}

fn area([a, b, c]: [Vec2; 3]) -> f32 {
    0.5 * (b - a).perp_dot(c - a).abs()
}

#[test]
fn lookup_finds_the_texel_of_a_point_on_a_cut_triangle() {
    let settings = small_blocks();
    let mesh = wall((-17.3, 3.3), (21.9, 30.1));
    let unwrap = mesh.unwrap(&settings);
    let lookup = UnwrapLookup::new(&unwrap, mesh.triangles.len());
    for step in 1..100 {
        let first = step as f32 / 101.0;
        let weights = Vec3::new(first, 0.3 * (1.0 - first), 0.7 * (1.0 - first));
        let at = lookup.locate(1, weights).unwrap();
        let corners = mesh.triangles[1].map(|v| mesh.positions_m[v as usize]);
        let point = corners[0] * weights.x + corners[1] * weights.y + corners[2] * weights.z;
        // Lattice coordinates modulo the alignment survive placement.
        let offset = (at.uv_texels - point.truncate() / 0.1) / 4.0;
        assert!((offset - offset.round()).abs().max_element() < 2e-3, "{offset}");
    }
    assert_eq!(lookup.locate(2, Vec3::X), None);
}

#[test]
fn too_many_texels_are_refused_with_advice() {
    let mesh = wall((0.0, 0.0), (5000.0, 5000.0));
    let result = unwrap_generated(
        &mesh.positions_m,
        &[],
        &mesh.triangles,
        &UnwrapSettings::with_texel_m(0.1),
        &Progress::new(),
    );
    assert!(matches!(result, Err(UnwrapError::TooLarge { .. })), "{result:?}");
    assert!(result.unwrap_err().to_string().contains("raise the texel size"));
}

#[test]
fn huge_sliver_is_refused_instead_of_walked() {
    let positions = [Vec3::ZERO, Vec3::new(2e7, 2e7, 0.0), Vec3::new(2e7, 2e7 + 4.0, 0.0)];
    let result =
        unwrap_generated(&positions, &[], &[[0, 1, 2]], &UnwrapSettings::with_texel_m(0.1), &Progress::new());
    assert!(matches!(result, Err(UnwrapError::TooLarge { .. })), "{result:?}");
}

#[test]
fn vertex_beyond_the_lattice_is_refused() {
    let mesh = wall((1e9, 0.0), (1e9 + 128.0, 1.0));
    let result = unwrap_generated(
        &mesh.positions_m,
        &[],
        &mesh.triangles,
        &UnwrapSettings::with_texel_m(0.1),
        &Progress::new(),
    );
    assert!(matches!(result, Err(UnwrapError::TooFar { triangle: 0, .. })), "{result:?}");
}

#[test]
fn bad_settings_are_named() {
    let settings = UnwrapSettings { texel_m: f32::NAN, ..small_blocks() };
    let result = unwrap_generated(&[], &[], &[], &settings, &Progress::new());
    assert!(matches!(result, Err(UnwrapError::BadSetting { field: "texel_m", .. })));
}
