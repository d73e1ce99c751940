//! Primitives: modes, accessors, normals and what is dropped.

use glam::{Vec2, Vec3};
use serde_json::json;

use super::document_builder::{
    BYTE, Document, FLOAT, TRIANGLE, UNSIGNED_BYTE, UNSIGNED_INT, UNSIGNED_SHORT, codes,
};
use crate::scene::ImportError;
use crate::scene::model::MeshInstance;

const SQUARE: [f32; 12] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0];

fn face_normals(instance: &MeshInstance) -> Vec<Vec3> {
    let normal = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(|vertex| instance.positions_m[vertex as usize]);
        (b - a).cross(c - a).normalize()
    };
    instance.triangles.iter().map(normal).collect()
}

fn square(mode: u32, indices: Option<&[u16]>) -> Document {
    let mut document = Document::new();
    let position = document.floats("VEC3", &SQUARE);
    let normals = [0.0, 0.0, 1.0].repeat(4);
    let normal = document.floats("VEC3", &normals);
    let mut primitive = json!({"attributes": {"POSITION": position, "NORMAL": normal}, "mode": mode});
    if let Some(indices) = indices {
        primitive["indices"] = json!(document.indices(indices));
    }
    document.json["meshes"] = json!([{"primitives": [primitive]}]);
    document
}

#[test]
fn strips_alternate_so_that_all_triangles_face_the_same_way() {
    for indices in [None, Some([0, 1, 2, 3].as_slice())] {
        let instance = square(5, indices).import_one();
        assert_eq!(instance.triangles.len(), 2);
        assert!(face_normals(&instance).iter().all(|normal| normal.distance(Vec3::Z) < 1e-6));
    }
}

#[test]
fn fans_share_their_first_corner() {
    let instance = square(6, Some(&[0, 1, 3, 2])).import_one();
    assert_eq!(instance.triangles.len(), 2);
    assert_eq!(instance.positions_m.len(), 4);
    assert!(face_normals(&instance).iter().all(|normal| normal.distance(Vec3::Z) < 1e-6));
}

#[test]
fn points_and_lines_are_skipped_with_a_warning() {
    for mode in 0..4 {
        let imported = square(mode, None).import().unwrap();
        assert!(imported.scene.instances.is_empty());
        assert_eq!(codes(&imported), ["points-and-lines-skipped", "no-triangles"]);
    }
}

#[test]
fn leftover_corners_are_dropped_with_a_warning() {
    let imported = square(4, None).import().unwrap();
    assert_eq!(imported.scene.instances[0].triangles.len(), 1);
    assert_eq!(codes(&imported), ["incomplete-triangle-dropped"]);
}

#[test]
fn unused_vertices_are_left_out_and_shared_ones_stay_shared() {
    let instance = square(4, Some(&[3, 2, 1])).import_one();
    assert_eq!(instance.positions_m, [Vec3::new(1.0, 1.0, 0.0), Vec3::Y, Vec3::X]);
    let both = square(4, Some(&[0, 1, 2, 2, 1, 3])).import_one();
    assert_eq!(both.positions_m.len(), 4);
}

#[test]
fn missing_normals_split_vertices_and_become_flat() {
    let mut document = square(4, Some(&[0, 1, 2, 2, 1, 3]));
    document.attributes().as_object_mut().unwrap().remove("NORMAL");
    let instance = document.import_one();
    assert_eq!(instance.positions_m.len(), 6);
    assert_eq!(instance.normals, [Vec3::Z; 6]);
    assert_eq!(instance.triangles, [[0, 1, 2], [3, 4, 5]]);
}

#[test]
fn zero_normals_come_from_faces_and_long_ones_are_scaled() {
    let mut document = Document::triangle();
    let normal = document.floats("VEC3", &[0.0, 0.0, 0.0, 0.0, 0.0, 7.0, f32::NAN, 0.0, 1.0]);
    document.attributes()["NORMAL"] = json!(normal);
    let imported = document.import().unwrap();
    assert_eq!(imported.scene.instances[0].normals, [Vec3::Z; 3]);
    assert_eq!(codes(&imported), ["normals-not-unit", "normals-replaced"]);
}

#[test]
fn triangles_without_area_are_dropped_and_counted() {
    let imported = square(4, Some(&[0, 1, 2, 0, 0, 1, 1, 1, 1])).import().unwrap();
    assert_eq!(imported.scene.instances[0].triangles.len(), 1);
    assert_eq!(imported.counts["degenerate_triangles"], 2);
    assert_eq!(imported.warnings[0].code, "degenerate-triangles-dropped");
    assert!(imported.warnings[0].message.contains("of 2"));
}

#[test]
fn sparse_elements_replace_zeros_where_there_is_no_view() {
    let mut document = Document::new();
    let values: Vec<u8> = TRIANGLE[3..].iter().flat_map(|value| value.to_le_bytes()).collect();
    let (indices, values) = (document.view(&[1, 2]), document.view(&values));
    let position = document.push(
        "accessors",
        json!({"componentType": FLOAT, "count": 3, "type": "VEC3", "sparse": {"count": 2,
            "indices": {"bufferView": indices, "componentType": UNSIGNED_BYTE}, "values": {"bufferView": values}}}),
    );
    document.json["meshes"] = json!([{"primitives": [{"attributes": {"POSITION": position}}]}]);
    assert_eq!(document.import_one().positions_m, [Vec3::ZERO, Vec3::X, Vec3::Y]);
}

#[test]
fn sparse_indices_out_of_order_or_range_are_rejected() {
    for bad in [[2_u8, 1], [1, 1], [1, 3]] {
        let mut document = Document::triangle();
        let (indices, values) = (document.view(&bad), document.view(&[0; 24]));
        document.json["accessors"][0]["sparse"] = json!({"count": 2,
            "indices": {"bufferView": indices, "componentType": UNSIGNED_BYTE}, "values": {"bufferView": values}});
        assert!(matches!(document.import(), Err(ImportError::Accessor { .. })));
    }
}

#[test]
fn quantised_positions_normals_and_uvs_are_read_in_their_own_units() {
    let mut document = Document::new();
    let shorts: Vec<u8> =
        [0_u16, 0, 0, 0, 2, 0, 0, 0, 0, 3, 0, 0].iter().flat_map(|v| v.to_le_bytes()).collect();
    let position = document.accessor("VEC3", UNSIGNED_SHORT, 3, &shorts);
    document.json["bufferViews"][0]["byteStride"] = json!(8);
    let normal = document.accessor("VEC3", BYTE, 3, &[0, 0, 127, 0, 0, 0, 127, 0, 0, 0, 129, 0]);
    document.json["bufferViews"][1]["byteStride"] = json!(4);
    document.json["accessors"][normal]["normalized"] = json!(true);
    let uv = document.accessor("VEC2", UNSIGNED_BYTE, 3, &[0, 255, 51, 0, 0, 0]);
    document.json["accessors"][uv]["normalized"] = json!(true);
    document.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
    document.json["meshes"] = json!([{"primitives": [{"attributes":
        {"POSITION": position, "NORMAL": normal, "TEXCOORD_0": uv}}]}]);
    let instance = document.import_one();
    assert_eq!(instance.positions_m, [Vec3::ZERO, Vec3::X * 2.0, Vec3::Y * 3.0]);
    assert_eq!(instance.normals, [Vec3::Z, Vec3::Z, Vec3::NEG_Z]);
    assert_eq!(instance.uv0, [Vec2::Y, Vec2::new(0.2, 0.0), Vec2::ZERO]);
}

#[test]
fn vertex_colours_are_read_as_bytes_shorts_and_floats() {
    let with = |kind: &str, component: u32, bytes: &[u8]| {
        let mut document = Document::triangle();
        let colour = document.accessor(kind, component, 3, bytes);
        document.attributes()["COLOR_0"] = json!(colour);
        document.import().unwrap()
    };
    let bytes = with("VEC4", UNSIGNED_BYTE, &[255, 0, 51, 255].repeat(3));
    assert_eq!(bytes.scene.instances[0].colours[2], [1.0, 0.0, 0.2, 1.0]);
    let shorts: Vec<u8> = [65_535_u16, 0, 0].repeat(3).iter().flat_map(|v| v.to_le_bytes()).collect();
    assert_eq!(with("VEC3", UNSIGNED_SHORT, &shorts).scene.instances[0].colours[0], [1.0, 0.0, 0.0, 1.0]);
    let floats: Vec<u8> = [2.0_f32, f32::NAN, 0.5].repeat(3).iter().flat_map(|v| v.to_le_bytes()).collect();
    let clamped = with("VEC3", FLOAT, &floats);
    assert_eq!(clamped.scene.instances[0].colours[1], [1.0, 0.0, 0.5, 1.0]);
    assert_eq!(codes(&clamped), ["vertex-colour-clamped"]);
}

#[test]
fn index_out_of_range_is_named() {
    let Err(ImportError::IndexOutOfRange { place, position, index, vertex_count }) =
        square(4, Some(&[0, 1, 2, 2, 9, 3])).import()
    else {
        panic!("must be refused")
    };
    assert_eq!((place.as_str(), position, index, vertex_count), ("mesh 0 primitive 0", 4, 9, 4));
}

#[test]
fn primitive_restart_value_is_out_of_range() {
    let mut document = square(4, None);
    let indices = document.accessor("SCALAR", UNSIGNED_INT, 3, &[0, 0, 0, 0, 1, 0, 0, 0, 255, 255, 255, 255]);
    document.primitive()["indices"] = json!(indices);
    assert!(matches!(document.import(), Err(ImportError::IndexOutOfRange { index: u32::MAX, .. })));
}

#[test]
fn positions_that_are_not_finite_are_named() {
    for bad in [f32::NAN, f32::INFINITY] {
        let mut document = Document::new();
        let position = document.floats("VEC3", &[0.0, 0.0, 0.0, 1.0, bad, 0.0, 0.0, 1.0, 0.0]);
        document.json["meshes"] = json!([{"primitives": [{"attributes": {"POSITION": position}}]}]);
        assert!(matches!(document.import(), Err(ImportError::NonFinitePosition { vertex: 1, .. })));
    }
}

#[test]
fn attributes_that_do_not_fit_are_rejected() {
    let broken: [fn(&mut Document); 6] = [
        |document| document.json["accessors"][0]["count"] = json!(4),
        |document| document.json["accessors"][0]["count"] = json!(u64::MAX),
        |document| document.json["accessors"][0]["byteOffset"] = json!(u64::MAX),
        |document| document.json["bufferViews"][0]["byteLength"] = json!(1000),
        |document| document.json["accessors"][0]["type"] = json!("VEC2"),
        |document| document.json["accessors"][0]["bufferView"] = json!(77),
    ];
    for (case, break_it) in broken.iter().enumerate() {
        let mut document = Document::triangle();
        break_it(&mut document);
        assert!(document.import().is_err(), "case {case}");
    }
}

#[test]
fn shorter_attribute_than_positions_is_rejected() {
    let mut document = Document::triangle();
    let uv = document.floats("VEC2", &[0.0; 4]);
    document.attributes()["TEXCOORD_0"] = json!(uv);
    let message = document.import().unwrap_err().to_string();
    assert!(message.contains("TEXCOORD_0") && message.contains("2 elements"), "{message}");
}

#[test]
fn draco_without_fallback_says_what_to_do() {
    let mut document = Document::triangle();
    document.json["accessors"][0].as_object_mut().unwrap().remove("bufferView");
    document.primitive()["extensions"] =
        json!({"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {}}});
    document.json["extensionsUsed"] = json!(["KHR_draco_mesh_compression"]);
    assert!(document.import().unwrap_err().to_string().contains("gltf-transform/cli copy"));
}

#[test]
fn draco_with_fallback_uses_it() {
    let mut document = Document::triangle();
    document.primitive()["extensions"] =
        json!({"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {}}});
    document.json["extensionsUsed"] = json!(["KHR_draco_mesh_compression"]);
    let imported = document.import().unwrap();
    assert_eq!(imported.scene.instances.len(), 1);
    assert_eq!(codes(&imported), [""; 0]);
}

#[test]
fn meshopt_views_without_fallback_say_what_to_do() {
    let mut document = Document::triangle();
    let stand_in = json!({"byteLength": 36, "extensions": {"EXT_meshopt_compression": {"fallback": true}}});
    let buffer = document.push("buffers", stand_in);
    document.json["extensionsUsed"] = json!(["EXT_meshopt_compression"]);
    assert_eq!(document.import().unwrap().counts["triangles"], 1);
    document.json["bufferViews"][0]["buffer"] = json!(buffer);
    assert!(document.import().unwrap_err().to_string().contains("how they are compressed"));
}
