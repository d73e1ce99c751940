//! Files made to harm: whatever the bytes, an answer and no panic.

use proptest::prelude::*;
use serde_json::json;

use super::document_builder::{Document, FLOAT, UNSIGNED_INT, import_bytes, png};
use crate::scene::{Bundle, ImportError, Limits, import};

/// One small file with every feature that has a reader of its own.
fn rich() -> Document {
    let mut document = Document::triangle_with_normals();
    let uv = document.floats("VEC2", &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
    let colour = document.floats("VEC4", &[1.0; 12]);
    let indices = document.indices(&[0, 1, 2]);
    let (sparse_indices, sparse_values) = (document.view(&[2]), document.view(&[0; 12]));
    document.json["accessors"][1]["sparse"] = json!({"count": 1,
        "indices": {"bufferView": sparse_indices, "componentType": 5121}, "values": {"bufferView": sparse_values}});
    let image = document.view(&png(2, 2, &[[200, 100, 50, 255]; 4]));
    document.attributes()["TEXCOORD_0"] = json!(uv);
    document.attributes()["COLOR_0"] = json!(colour);
    document.primitive()["indices"] = json!(indices);
    document.primitive()["material"] = json!(0);
    document.json["materials"] = json!([{"alphaMode": "MASK", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0,
        "extensions": {"KHR_texture_transform": {"rotation": 1}}}}, "emissiveFactor": [1, 1, 1]}]);
    document.json["textures"] = json!([{"source": 0, "sampler": 0}]);
    document.json["samplers"] = json!([{"wrapS": 33071}]);
    document.json["images"] = json!([{"bufferView": image, "mimeType": "image/png"}]);
    document.json["cameras"] = json!([{"type": "perspective", "perspective": {"yfov": 1, "znear": 1}}]);
    document.json["extensions"] = json!({"KHR_lights_punctual": {"lights": [{"type": "spot", "spot": {}}]}});
    document.json["nodes"] = json!([{"mesh": 0, "children": [1, 2], "rotation": [0, 0, 0, 1]}, {"camera": 0},
        {"extensions": {"KHR_lights_punctual": {"light": 0}}, "matrix": [1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]}]);
    document
}

#[test]
fn rich_file_imports_in_full() {
    let imported = rich().import().unwrap();
    let counts = ["cameras", "images", "instances", "lights", "triangles"].map(|name| imported.counts[name]);
    assert_eq!(counts, [1; 5]);
}

#[test]
fn glb_cut_at_any_length_is_an_error() {
    let glb = rich().glb();
    for length in 0..glb.len() {
        assert!(import_bytes(glb[..length].to_vec()).is_err(), "{length}");
    }
    // Also where the stated length matches the cut.
    for length in 12..glb.len() {
        let mut cut = glb[..length].to_vec();
        cut[8..12].copy_from_slice(&(length as u32).to_le_bytes());
        let _ = import_bytes(cut);
    }
}

#[test]
fn glb_with_unknown_chunks_is_read() {
    let mut glb = Document::triangle().glb();
    glb.extend(b"\x04\0\0\0XTRA1234");
    let length = glb.len() as u32;
    glb[8..12].copy_from_slice(&length.to_le_bytes());
    assert_eq!(import_bytes(glb).unwrap().counts["triangles"], 1);
}

#[test]
fn huge_counts_are_refused_before_anything_is_allocated() {
    let huge = [1_u64 << 33, 1 << 62, u64::MAX];
    for count in huge {
        let mut document = Document::new();
        document.push("accessors", json!({"componentType": FLOAT, "count": count, "type": "VEC3"}));
        document.json["meshes"] = json!([{"primitives": [{"attributes": {"POSITION": 0}}]}]);
        assert!(matches!(document.import(), Err(ImportError::LimitExceeded { .. })));
    }
}

#[test]
fn accessors_without_bytes_are_short_and_indices_into_them_cost_nothing() {
    let mut document = Document::triangle();
    let index: Vec<u8> = [0_u32, 1, 4_000_000_000].iter().flat_map(|index| index.to_le_bytes()).collect();
    let indices = document.accessor("SCALAR", UNSIGNED_INT, 3, &index);
    document.primitive()["indices"] = json!(indices);
    document.json["accessors"][0] =
        json!({"componentType": FLOAT, "count": 4_100_000_000_u64, "type": "VEC3"});
    let what = "elements in an accessor without bytes";
    assert!(
        matches!(document.import(), Err(ImportError::LimitExceeded { what: found, .. }) if found == what)
    );
}

#[test]
fn lists_of_empty_objects_are_counted_before_they_are_read() {
    let json = format!(r#"{{"asset": {{"version": "2.0"}}, "materials": [{}{{}}]}}"#, "{},".repeat(999));
    let import = |json_tree_bytes| {
        let limits = Limits { json_tree_bytes, ..Limits::default() };
        import(&Bundle::from_bytes(json.clone().into_bytes(), &limits).unwrap(), &limits)
    };
    let Err(ImportError::LimitExceeded { found, .. }) = import(100_000) else { panic!("must be refused") };
    assert_eq!(found, 1000 * size_of::<gltf::json::Material>() as u64);
    assert!(import(found).is_ok());
}

#[test]
fn textures_may_not_have_more_pixels_than_the_upload_makes_likely() {
    let limits = Limits { texture_pixels_free: 2, pixels_per_byte: 0, ..Limits::default() };
    let refused = import(&Bundle::from_bytes(rich().glb(), &limits).unwrap(), &limits).unwrap_err();
    let message = refused.to_string();
    assert!(
        matches!(refused, ImportError::LimitExceeded { what: "pixels in all textures", .. }),
        "{message}"
    );
    assert!(message.contains("textures smaller"), "{message}");
    let limits = Limits { pixels_per_byte: 1, ..limits };
    assert!(import(&Bundle::from_bytes(rich().glb(), &limits).unwrap(), &limits).is_ok());
}

#[test]
fn light_brighter_than_any_star_is_refused_with_its_material() {
    let mut document = Document::triangle();
    let lamp = |strength: f64| {
        json!([{"name": "lamp", "emissiveFactor": [0, 1, 0],
        "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": strength}}}])
    };
    for strength in [1e13, 1e30, 1e38] {
        document.json["materials"] = lamp(strength);
        let message = document.import().unwrap_err().to_string();
        assert!(message.contains("lamp") && message.contains("1e12"), "{message}");
    }
    document.json["materials"] = lamp(1e9);
    assert_eq!(document.import().unwrap().scene.materials[0].emissive, [0.0, 1e9, 0.0]);
}

#[test]
fn instances_of_one_mesh_count_each() {
    let mut document = Document::triangle();
    let nodes: Vec<_> = (0..10).map(|_| json!({"mesh": 0})).collect();
    document.json["nodes"] = json!(nodes);
    document.json["scenes"] = json!([{"nodes": (0..10).collect::<Vec<_>>()}]);
    let limits = Limits { triangles: 9, ..Limits::default() };
    let bundle = Bundle::from_bytes(document.glb(), &limits).unwrap();
    assert!(matches!(import(&bundle, &limits), Err(ImportError::LimitExceeded { what: "triangles", .. })));
}

#[test]
fn json_size_is_bounded_before_parsing() {
    let limits = Limits { json_objects: 100, json_values: 1000, ..Limits::default() };
    let refused = |json: String| {
        let bundle = Bundle::from_bytes(json.into_bytes(), &limits).unwrap();
        matches!(import(&bundle, &limits), Err(ImportError::LimitExceeded { .. }))
    };
    assert!(refused(format!(r#"{{"nodes": [{}{{}}]}}"#, "{},".repeat(200))));
    assert!(refused(format!(r#"{{"x": [{}1]}}"#, "1,".repeat(2000))));
    assert!(!refused(format!(
        r#"{{"asset": {{"version": "2.0", "generator": "\"{}"}}}}"#,
        "{,".repeat(3000)
    )));
}

#[test]
fn json_nested_without_end_is_an_error() {
    let json = format!(r#"{{"asset": {{"version": "2.0"}}, "extras": {}"#, "[".repeat(1 << 20));
    assert!(matches!(import_bytes(json.into_bytes()), Err(ImportError::Json { .. })));
}

#[test]
fn references_to_nothing_are_named() {
    type Break = fn(&mut Document);
    let broken: [(&str, Break); 7] = [
        ("scene 9", |document| document.json["scene"] = json!(9)),
        ("node 9", |document| document.json["scenes"][0]["nodes"] = json!([9])),
        ("mesh 9", |document| document.json["nodes"][0]["mesh"] = json!(9)),
        ("camera 9", |document| document.json["nodes"][1]["camera"] = json!(9)),
        ("material 9", |document| document.primitive()["material"] = json!(9)),
        ("image 9", |document| document.json["textures"][0]["source"] = json!(9)),
        ("buffer 9", |document| document.json["bufferViews"][0]["buffer"] = json!(9)),
    ];
    for (wanted, break_it) in broken {
        let mut document = rich();
        break_it(&mut document);
        let message = document.import().unwrap_err().to_string();
        assert!(message.contains(wanted), "{message}");
    }
}

#[test]
fn same_bytes_give_the_same_scene() {
    assert_eq!(rich().import().unwrap(), rich().import().unwrap());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn flipped_bytes_never_panic(flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)) {
        let mut glb = rich().glb();
        for (position, value) in flips {
            let position = position.index(glb.len());
            glb[position] = value;
        }
        let _ = import_bytes(glb);
    }

    #[test]
    fn replaced_numbers_never_panic(
        choice in any::<prop::sample::Index>(),
        number in prop_oneof![Just("0"), Just("1"), Just("7"), Just("255"), Just("-1"), Just("4294967295"),
            Just("18446744073709551615"), Just("1e38"), Just("5126"), Just("3")],
    ) {
        let json = serde_json::to_string(&rich().json).unwrap();
        let is_number = |position: &usize| {
            let bytes = json.as_bytes();
            bytes[*position].is_ascii_digit() && matches!(bytes[position - 1], b':' | b',' | b'[')
        };
        let starts: Vec<usize> = (1..json.len()).filter(is_number).collect();
        let start = starts[choice.index(starts.len())];
        let end = start + json[start..].find([',', ']', '}']).unwrap_or(0);
        let mut document = rich();
        let replaced = format!("{}{number}{}", &json[..start], &json[end..]);
        document.json = serde_json::from_str(&replaced).unwrap();
        let _ = document.import();
    }
}
