//! Compressed meshes: decoded to what they were, and errors where they cannot be.

use draco_core::{
    DataType, EncoderBuffer, EncoderOptions, FaceIndex, GeometryAttributeType, Mesh, MeshEncoder,
    PointAttribute,
};
use glam::{Vec2, Vec3};
use serde_json::{Value, json};

use super::document_builder::{BYTE, Document, FLOAT, UNSIGNED_INT, UNSIGNED_SHORT, codes};
use crate::scene::{Bundle, ImportError, Limits, import};

/// Vertices along a side of the test's mesh.
const SIDE: u32 = 9;

/// A bumpy sheet: positions, uvs and triangles.
fn sheet() -> (Vec<[f32; 3]>, Vec<[f32; 2]>, Vec<u32>) {
    let corners = (0..SIDE * SIDE).map(|i| ((i % SIDE) as f32 / 8.0, (i / SIDE) as f32 / 8.0));
    let positions = corners.clone().map(|(u, v)| [u, v, (u * v * 8.0).fract() * 0.25]).collect();
    let uvs = corners.map(|(u, v)| [u, 1.0 - v]).collect();
    let mut indices = Vec::new();
    for i in (0..SIDE * SIDE).filter(|i| i % SIDE < SIDE - 1 && i / SIDE < SIDE - 1) {
        indices.extend([i, i + 1, i + SIDE, i + 1, i + SIDE + 1, i + SIDE]);
    }
    (positions, uvs, indices)
}

fn attribute<const N: usize>(kind: GeometryAttributeType, values: &[[f32; N]]) -> PointAttribute {
    let mut attribute = PointAttribute::new();
    attribute.init(kind, N as u8, DataType::Float32, false, values.len());
    attribute.buffer_mut().update_f32s_le(0, values.as_flattened());
    attribute
}

/// The sheet as Draco, the ids of its attributes, and how many points it decodes to.
fn draco_bytes() -> Vec<u8> {
    let (positions, uvs, indices) = sheet();
    let mut mesh = Mesh::new();
    mesh.set_num_points(positions.len());
    mesh.add_attribute(attribute(GeometryAttributeType::Position, &positions));
    mesh.add_attribute(attribute(GeometryAttributeType::TexCoord, &uvs));
    mesh.set_num_faces(indices.len() / 3);
    for (face, corners) in indices.as_chunks::<3>().0.iter().enumerate() {
        mesh.set_face(FaceIndex(face as u32), corners.map(Into::into));
    }
    let mut encoder = MeshEncoder::new();
    encoder.set_mesh(mesh);
    let mut bytes = EncoderBuffer::new();
    encoder.encode(&EncoderOptions::new(), &mut bytes).unwrap();
    bytes.data().to_vec()
}

/// A glTF whose one primitive is compressed by Draco, and required to be read so.
fn draco() -> Document {
    let mut document = Document::new();
    let view = document.view(&draco_bytes());
    let count = SIDE * SIDE;
    let position =
        document.push("accessors", json!({"componentType": FLOAT, "count": count, "type": "VEC3"}));
    let uv = document.push("accessors", json!({"componentType": FLOAT, "count": count, "type": "VEC2"}));
    let corners = (SIDE - 1) * (SIDE - 1) * 6;
    let indices = document
        .push("accessors", json!({"componentType": UNSIGNED_SHORT, "count": corners, "type": "SCALAR"}));
    document.json["meshes"] = json!([{"name": "sheet", "primitives": [{
        "attributes": {"POSITION": position, "TEXCOORD_0": uv}, "indices": indices, "extensions": {
            "KHR_draco_mesh_compression": {"bufferView": view, "attributes": {"POSITION": 0, "TEXCOORD_0": 1}}}}]}]);
    document.json["extensionsUsed"] = json!(["KHR_draco_mesh_compression"]);
    document.json["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]);
    document
}

/// Doubled area of all triangles, and the sum over corners of uv by position: both are the same in any order.
fn sums(positions: &[Vec3], uvs: &[Vec2], triangles: &[[u32; 3]]) -> [f32; 2] {
    let mut sums = [0.0; 2];
    for triangle in triangles {
        let [a, b, c] = triangle.map(|vertex| positions[vertex as usize]);
        sums[0] += (b - a).cross(c - a).length();
        sums[1] += triangle.iter().map(|&v| positions[v as usize].y * uvs[v as usize].y).sum::<f32>();
    }
    sums
}

#[test]
fn draco_meshes_are_decoded_to_what_they_were() {
    let imported = draco().import().unwrap();
    assert_eq!(codes(&imported), [""; 0]);
    let found = &imported.scene.instances[0];
    assert_eq!(found.triangles.len() as u32, (SIDE - 1) * (SIDE - 1) * 2);
    let (positions, uvs, indices) = sheet();
    let positions: Vec<Vec3> = positions.into_iter().map(Vec3::from).collect();
    let uvs: Vec<Vec2> = uvs.into_iter().map(Vec2::from).collect();
    let wanted = sums(&positions, &uvs, indices.as_chunks::<3>().0);
    let found = sums(&found.positions_m, &found.uv0, &found.triangles);
    for (wanted, found) in wanted.into_iter().zip(found) {
        assert!((wanted - found).abs() < 1e-2 * wanted, "{wanted} {found}");
    }
}

#[test]
fn draco_meshes_that_cannot_be_decoded_name_the_mesh_and_the_way_out() {
    type Break = fn(&mut Value);
    let broken: [Break; 6] = [
        |json| json["accessors"][2]["count"] = json!(3),
        |json| json["accessors"][0]["componentType"] = json!(BYTE),
        |json| json["accessors"][2]["componentType"] = json!(FLOAT),
        |json| json["bufferViews"][0]["byteLength"] = json!(20),
        |json| json["meshes"][0]["primitives"][0]["mode"] = json!(5),
        |json| json["meshes"][0]["primitives"][0]["extensions"]["KHR_draco_mesh_compression"] = json!({}),
    ];
    for (index, break_it) in broken.into_iter().enumerate() {
        let mut document = draco();
        break_it(&mut document.json);
        let message = document.import().unwrap_err().to_string();
        assert!(
            message.contains("sheet") && message.contains("gltf-transform/cli copy"),
            "{index}: {message}"
        );
    }
}

/// Adds a view that stands for compressed bytes, as the extension has it, and an accessor over it.
fn meshopt_accessor(document: &mut Document, bytes: &[u8], extension: Value, accessor: Value) -> usize {
    let packed = document.view(bytes);
    let mut view = document.json["bufferViews"][packed].take();
    let (offset, length) = (view["byteOffset"].take(), view["byteLength"].take());
    let mut extension = extension;
    extension["buffer"] = json!(0);
    extension["byteOffset"] = offset;
    extension["byteLength"] = length;
    let size = extension["count"].as_u64().unwrap() * extension["byteStride"].as_u64().unwrap();
    document.json["bufferViews"][packed] = json!({"buffer": 1, "byteLength": size, "byteStride": null,
        "extensions": {"EXT_meshopt_compression": extension}});
    document.json["bufferViews"][packed].as_object_mut().unwrap().remove("byteStride");
    let mut accessor = accessor;
    accessor["bufferView"] = json!(packed);
    document.push("accessors", accessor)
}

/// A glTF whose views are compressed by meshoptimizer, as gltfpack leaves them: no fallback.
fn meshopt() -> Document {
    let (positions, _, indices) = sheet();
    let mut document = Document::new();
    let stand_in =
        json!({"byteLength": 1 << 20, "extensions": {"EXT_meshopt_compression": {"fallback": true}}});
    document.push("buffers", stand_in);
    let count = SIDE * SIDE;
    let exponential = meshopt::encode_filter_exp(&positions, 20, meshopt::EncodeExpMode::SharedVector);
    let bytes = meshopt::encode_vertex_buffer_level(&exponential, 2, Some(0)).unwrap();
    let position = meshopt_accessor(
        &mut document,
        &bytes,
        json!({"byteStride": 12, "count": count, "mode": "ATTRIBUTES", "filter": "EXPONENTIAL"}),
        json!({"componentType": FLOAT, "count": count, "type": "VEC3"}),
    );
    let normals = vec![[0.6_f32, 0.0, 0.8, 0.0]; count as usize];
    let octahedral = meshopt::encode_filter_oct::<i8>(&normals, 8);
    let bytes = meshopt::encode_vertex_buffer_level(&octahedral, 2, Some(0)).unwrap();
    let normal = meshopt_accessor(
        &mut document,
        &bytes,
        json!({"byteStride": 4, "count": count, "mode": "ATTRIBUTES", "filter": "OCTAHEDRAL"}),
        json!({"componentType": BYTE, "count": count, "type": "VEC3", "normalized": true}),
    );
    document.json["bufferViews"][normal]["byteStride"] = json!(4);
    let bytes = meshopt::encode_index_buffer(&indices, count as usize).unwrap();
    let triangles = meshopt_accessor(
        &mut document,
        &bytes,
        json!({"byteStride": 4, "count": indices.len(), "mode": "TRIANGLES"}),
        json!({"componentType": UNSIGNED_INT, "count": indices.len(), "type": "SCALAR"}),
    );
    document.json["meshes"] = json!([{"primitives": [{
        "attributes": {"POSITION": position, "NORMAL": normal}, "indices": triangles}]}]);
    document.json["extensionsRequired"] = json!(["EXT_meshopt_compression"]);
    document
}

#[test]
fn meshopt_views_are_decoded_to_what_they_were() {
    let imported = meshopt().import().unwrap();
    assert_eq!(codes(&imported), [""; 0]);
    let found = &imported.scene.instances[0];
    let (positions, uvs, indices) = sheet();
    let positions: Vec<Vec3> = positions.into_iter().map(Vec3::from).collect();
    let uvs: Vec<Vec2> = uvs.into_iter().map(Vec2::from).collect();
    let wanted = sums(&positions, &uvs, indices.as_chunks::<3>().0);
    let found_sums = sums(&found.positions_m, &vec![Vec2::ZERO; positions.len()], &found.triangles);
    assert!((wanted[0] - found_sums[0]).abs() < 1e-3, "{wanted:?} {found_sums:?}");
    assert!(found.normals.iter().all(|normal| normal.distance(Vec3::new(0.6, 0.0, 0.8)) < 0.01));
}

#[test]
fn meshopt_views_are_read_without_a_fallback_that_did_not_come_along() {
    let mut document = meshopt();
    let whole = document.import().unwrap();
    document.json["buffers"][1]["uri"] = json!("sheet.fallback.bin");
    let found = document.import().unwrap();
    assert_eq!(found.scene.instances[0].positions_m, whole.scene.instances[0].positions_m);
    // Views that are not compressed have no bytes then.
    document.json["bufferViews"][0].as_object_mut().unwrap().remove("extensions");
    let message = document.import().unwrap_err().to_string();
    assert!(message.contains("no bytes of its own"), "{message}");
}

#[test]
fn meshopt_views_that_cannot_be_decoded_are_named_with_the_way_out() {
    type Break = fn(&mut Value);
    let broken: [(&str, Break); 6] = [
        ("stride", |view| view["byteStride"] = json!(6)),
        ("stride", |view| view["filter"] = json!("OCTAHEDRAL")),
        ("stride", |view| view["mode"] = json!("INDICES")),
        ("unknown variant", |view| view["mode"] = json!("POINTS")),
        ("cannot hold", |view| view["count"] = json!(50_000_000)),
        ("native error", |view| view["count"] = json!(80)),
    ];
    for (said, break_it) in broken {
        let mut document = meshopt();
        break_it(&mut document.json["bufferViews"][0]["extensions"]["EXT_meshopt_compression"]);
        let message = document.import().unwrap_err().to_string();
        let is_helpful = message.contains("buffer view 0") && message.contains("gltf-transform/cli copy");
        assert!(is_helpful && message.contains(said), "{said}: {message}");
    }
}

#[test]
fn meshes_may_not_decompress_without_end() {
    for document in [draco(), meshopt()] {
        let limits = Limits { decoded_bytes: 100, ..Limits::default() };
        let bundle = Bundle::from_bytes(document.glb(), &limits).unwrap();
        let refused = import(&bundle, &limits);
        let what = "bytes of decompressed meshes";
        assert!(matches!(refused, Err(ImportError::LimitExceeded { what: found, .. }) if found == what));
    }
}

#[test]
fn compressed_bytes_with_faults_never_panic() {
    for document in [draco(), meshopt()] {
        let whole = document.glb();
        // Of each byte of the packed meshes, one bit.
        let start =
            whole.len() - if document.json["buffers"].as_array().unwrap().len() > 1 { 900 } else { 400 };
        for position in start.min(whole.len())..whole.len() {
            let mut flipped = whole.clone();
            flipped[position] ^= 1 << (position % 8);
            let _ = super::document_builder::import_bytes(flipped);
        }
    }
}
