//! Any triangles at all.

use glam::{Vec2, Vec3};
use proptest::prelude::*;

use super::meshes::Mesh;
use super::rules::check;
use crate::unwrap::{UnwrapSettings, unwrap_from_second_uv};

/// Coordinates that often coincide, so that soups share vertices, edges and planes.
fn coordinate() -> impl Strategy<Value = f32> {
    prop_oneof![4 => (-4..5_i32).prop_map(|i| i as f32 * 0.5), 1 => -3.0..3.0_f32]
}

fn mesh() -> impl Strategy<Value = Mesh> {
    let position = (coordinate(), coordinate(), coordinate()).prop_map(Vec3::from);
    let vertices = prop::collection::vec(position, 3..24);
    vertices.prop_flat_map(|positions_m| {
        let index = 0..positions_m.len() as u32;
        let triangle = (index.clone(), index.clone(), index).prop_map(|(a, b, c)| [a, b, c]);
        let triangles = prop::collection::vec(triangle, 1..60);
        triangles.prop_map(move |triangles| {
            let normals = positions_m.iter().map(|p| p.normalize_or_zero()).collect();
            Mesh { positions_m: positions_m.clone(), normals, triangles }
        })
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn any_soup_keeps_the_rules(
        mesh in mesh(),
        texel_m in prop::sample::select(vec![0.07_f32, 0.25, 1.0, 8.0]),
        gutter_texels in 0..5_u32,
        lod_align_texels in prop::sample::select(vec![1_u32, 4, 8]),
    ) {
        let settings = UnwrapSettings {
            gutter_texels,
            lod_align_texels,
            max_block_texels: 64,
            ..UnwrapSettings::with_texel_m(texel_m)
        };
        let unwrap = mesh.unwrap(&settings);
        prop_assert_eq!(&unwrap, &mesh.unwrap(&settings));
        check(&mesh, &unwrap, &settings);
    }

    #[test]
    fn any_second_uv_set_is_answered(mesh in mesh(), seed in 0.0..1.0_f32) {
        let uv1: Vec<Vec2> = mesh.positions_m.iter().map(|p| (p.truncate() + p.z * seed) * 0.1 + 0.5).collect();
        let _ = unwrap_from_second_uv(&mesh.positions_m, &uv1, &mesh.triangles, &UnwrapSettings::with_texel_m(0.1));
    }
}
