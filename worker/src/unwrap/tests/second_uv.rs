//! Adoption of second UV sets.

use glam::{Vec2, Vec3};

use super::meshes::{Mesh, wall};
use crate::unwrap::{Unwrap, UnwrapSettings, Uv1Rejected, unwrap_from_second_uv};

fn two_walls() -> Mesh {
    let mut mesh = wall((0.0, 0.0), (4.0, 8.0));
    mesh.quad([(5.0, 0.0), (9.0, 0.0), (9.0, 8.0), (5.0, 8.0)].map(|(x, y)| Vec3::new(x, y, 0.0)));
    mesh
}

/// Two upright rectangles side by side, `gap` apart.
fn side_by_side(gap: f32) -> Vec<Vec2> {
    let rectangle = |left: f32, right: f32| {
        [(left, 0.0), (right, 0.0), (right, 1.0), (left, 1.0)].map(|(x, y)| Vec2::new(x, y))
    };
    [rectangle(0.0, 0.5 - gap / 2.0), rectangle(0.5 + gap / 2.0, 1.0)].concat()
}

fn adopt(mesh: &Mesh, uv1: &[Vec2]) -> Result<Unwrap, Uv1Rejected> {
    unwrap_from_second_uv(&mesh.positions_m, uv1, &mesh.triangles, &UnwrapSettings::with_texel_m(0.25))
}

#[test]
fn good_set_is_adopted_at_the_texel_size() {
    let unwrap = adopt(&two_walls(), &side_by_side(0.1)).unwrap();
    let block = &unwrap.blocks[0];
    assert!((31..=34).contains(&block.width), "{}", block.width);
    assert_eq!(block.triangles.iter().map(|t| t.chart).collect::<Vec<_>>(), [0, 0, 1, 1]);
}

#[test]
fn tiling_set_is_rejected() {
    let uv1: Vec<Vec2> = side_by_side(0.1).iter().map(|uv| uv * 3.0).collect();
    assert_eq!(adopt(&two_walls(), &uv1), Err(Uv1Rejected::OutOfRange { triangle: 0 }));
}

#[test]
fn mirrored_overlap_is_rejected() {
    let half = side_by_side(0.1)[..4].to_vec();
    let result = adopt(&two_walls(), &[half.clone(), half].concat());
    assert!(matches!(result, Err(Uv1Rejected::Overlap { .. })), "{result:?}");
}

#[test]
fn touching_charts_are_rejected() {
    let result = adopt(&two_walls(), &side_by_side(0.001));
    assert!(matches!(result, Err(Uv1Rejected::GutterTooSmall { .. })), "{result:?}");
}

#[test]
fn collapsed_uneven_and_missing_sets_are_rejected() {
    let mesh = two_walls();
    assert_eq!(adopt(&mesh, &[Vec2::ZERO; 8]), Err(Uv1Rejected::ZeroArea { triangle: 0 }));
    let mut uneven = side_by_side(0.1);
    uneven[4..].iter_mut().for_each(|uv| *uv = Vec2::splat(0.9) + (*uv - 0.9) * 0.05);
    let result = adopt(&mesh, &uneven);
    assert!(matches!(result, Err(Uv1Rejected::TexelSizeTooUneven { percent: 50 })), "{result:?}");
    assert!(matches!(adopt(&mesh, &[]), Err(Uv1Rejected::CountMismatch { uv_count: 0, .. })));
    assert_eq!(adopt(&Mesh::default(), &[]), Err(Uv1Rejected::Empty));
}

#[test]
fn set_too_fine_for_a_block_is_rejected() {
    let mesh = wall((0.0, 0.0), (1000.0, 1000.0));
    let corners = [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y];
    assert!(matches!(adopt(&mesh, &corners), Err(Uv1Rejected::TooLarge { side_texels: 4000, .. })));
}
