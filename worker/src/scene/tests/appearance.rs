//! Materials, images and extensions.

use serde_json::json;

use super::document_builder::{Document, codes, png};
use crate::scene::ImportError;
use crate::scene::model::{Glass, Wrap};
use crate::scene::texture::DecodedImages;

fn with_material(material: serde_json::Value) -> Document {
    let mut document = Document::triangle();
    document.json["materials"] = json!([material]);
    document.primitive()["material"] = json!(0);
    document
}

fn with_image(bytes: &[u8]) -> Document {
    let mut document = with_material(json!({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}));
    let uv = document.floats("VEC2", &[0.0; 6]);
    document.attributes()["TEXCOORD_0"] = json!(uv);
    let view = document.view(bytes);
    document.json["textures"] = json!([{"source": 0}]);
    document.json["images"] = json!([{"name": "paint", "bufferView": view, "mimeType": "image/png"}]);
    document
}

#[test]
fn primitives_without_material_get_the_default_one_appended() {
    let mut document = with_material(json!({"name": "red"}));
    document.primitive().as_object_mut().unwrap().remove("material");
    let scene = document.import().unwrap().scene;
    assert_eq!(scene.instances[0].material_index, 1);
    assert_eq!((scene.materials[1].name.as_str(), scene.materials[1].base_colour), ("default", [1.0; 4]));
}

#[test]
fn emissive_strength_multiplies_the_factor() {
    let material = json!({"emissiveFactor": [1, 0.5, 0],
        "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 12}}});
    assert_eq!(with_material(material).import().unwrap().scene.materials[0].emissive, [12.0, 6.0, 0.0]);
}

#[test]
fn factors_out_of_range_are_clamped_with_a_warning() {
    let imported = with_material(json!({"pbrMetallicRoughness": {"baseColorFactor": [2, -1, 0.5, 1e9]}}))
        .import()
        .unwrap();
    assert_eq!(imported.scene.materials[0].base_colour, [1.0, 0.0, 0.5, 1.0]);
    assert_eq!(codes(&imported), ["material-factor-clamped"]);
}

#[test]
fn mask_keeps_its_cutoff_and_blend_has_none_but_a_share() {
    let mask = with_material(json!({"alphaMode": "MASK", "alphaCutoff": 0.25, "doubleSided": true}));
    let material = &mask.import().unwrap().scene.materials[0];
    assert_eq!((material.alpha_cutoff, material.double_sided), (Some(0.25), true));
    let default_cutoff = with_material(json!({"alphaMode": "MASK"})).import().unwrap();
    assert_eq!(default_cutoff.scene.materials[0].alpha_cutoff, Some(0.5));
    let blend = with_material(json!({"alphaMode": "BLEND"})).import().unwrap();
    let material = &blend.scene.materials[0];
    let glass = Glass { blends: true, transmission: 0.0, transmission_texture: None };
    assert_eq!((material.alpha_cutoff, &material.glass), (None, &Some(glass)));
    assert!(blend.warnings.is_empty(), "{:?}", blend.warnings);
    assert_eq!(mask.import().unwrap().scene.materials[0].glass, None);
}

fn transmission_of(pbr: serde_json::Value, factor: f32) -> crate::scene::model::Imported {
    let mut document = with_material(json!({"pbrMetallicRoughness": pbr,
        "extensions": {"KHR_materials_transmission": {"transmissionFactor": factor}}}));
    document.json["extensionsUsed"] = json!(["KHR_materials_transmission"]);
    document.json["extensionsRequired"] = json!(["KHR_materials_transmission"]);
    document.import().unwrap()
}

#[test]
fn transmission_is_what_metal_leaves_of_it() {
    for (metallic, factor, wanted) in [(0.0, 0.9, 0.9), (0.5, 0.8, 0.4), (0.0, 7.0, 1.0), (0.0, -1.0, 0.0)] {
        let imported = transmission_of(json!({"metallicFactor": metallic}), factor);
        let found = imported.scene.materials[0].glass.as_ref().map_or(0.0, |glass| glass.transmission);
        assert!((found - wanted).abs() < 1e-6, "metal {metallic}, factor {factor}: {found}");
        assert!(imported.warnings.is_empty(), "{:?}", imported.warnings);
    }
    // Metal is glTF's default.
    assert_eq!(transmission_of(json!({}), 1.0).scene.materials[0].glass, None);
    let tinted = transmission_of(json!({"metallicFactor": 0, "baseColorFactor": [0.2, 0.9, 0.3, 1]}), 1.0);
    assert_eq!(codes(&tinted), ["glass-tint-grey"]);
}

#[test]
fn red_of_a_transmission_texture_is_read_as_a_linear_number() {
    let mut document = with_image(&png(1, 1, &[[64, 200, 10, 255]]));
    document.json["materials"][0]["pbrMetallicRoughness"]["metallicFactor"] = json!(0);
    document.json["materials"][0]["extensions"] = json!({"KHR_materials_transmission":
        {"transmissionFactor": 1, "transmissionTexture": {"index": 0}}});
    let scene = document.import().unwrap().scene;
    let texture = scene.materials[0].glass.as_ref().unwrap().transmission_texture.clone().unwrap();
    let images = DecodedImages::decode(&scene).unwrap();
    let [.., share] = images.sample_bilinear(&texture, [0.5; 2]);
    assert!((share - 64.0 / 255.0).abs() < 1e-6, "{share}");
    // The colour of the same image stays as it was.
    let colour = scene.materials[0].base_colour_texture.as_ref().unwrap();
    assert!((images.sample_bilinear(colour, [0.5; 2])[1] - 0.577).abs() < 0.01);
    assert_eq!(scene.images.len(), 2);
}

#[test]
fn required_extensions_that_are_not_supported_are_named() {
    for (name, advice) in
        [("KHR_texture_basisu", "gltf-transform/cli ktxdecompress"), ("EXT_odd", "without it")]
    {
        let mut document = Document::triangle();
        document.json["extensionsRequired"] = json!([name]);
        let message = document.import().unwrap_err().to_string();
        assert!(message.contains(name) && message.contains(advice), "{message}");
    }
}

#[test]
fn used_extensions_that_are_not_understood_are_warned_of() {
    let mut document = with_material(json!({"extensions": {"KHR_materials_unlit": {}}}));
    document.json["extensionsUsed"] = json!(["KHR_materials_unlit", "KHR_texture_transform"]);
    let imported = document.import().unwrap();
    assert_eq!(codes(&imported), ["extension-ignored"]);
    assert!(imported.warnings[0].message.contains("KHR_materials_unlit"));
}

#[test]
fn images_are_kept_encoded_with_their_true_type_and_size() {
    let bytes = png(2, 1, &[[255; 4]; 2]);
    let scene = with_image(&bytes).import().unwrap().scene;
    let image = &scene.images[0];
    assert_eq!(
        (image.name.as_str(), image.media_type.as_str(), image.size_px),
        ("paint", "image/png", [2, 1])
    );
    assert_eq!(image.bytes, bytes);
}

#[test]
fn image_formats_that_are_not_read_leave_the_factor_with_a_warning() {
    let imported = with_image(b"\xABKTX 20\xBB\r\n\x1a\nrest").import().unwrap();
    assert_eq!(imported.scene.materials[0].base_colour_texture, None);
    assert!(imported.scene.images.is_empty());
    assert_eq!(codes(&imported), ["texture-format-unsupported"]);
}

#[test]
fn broken_images_are_errors_that_name_them() {
    let whole = png(9, 9, &[[7; 4]; 81]);
    let cut = &whole[..whole.len() - 20];
    for bytes in [cut, b"version https://git-lfs.github.com/spec/v1", b"nothing"] {
        let message = with_image(bytes).import().unwrap_err().to_string();
        assert!(message.contains("paint"), "{message}");
    }
}

#[test]
fn images_beyond_the_pixel_limit_are_refused_by_their_header() {
    let mut bytes = png(1, 1, &[[7; 4]]);
    // Width and height of the header, with its checksum: 65535 × 65535.
    bytes[16..24].copy_from_slice(&[0, 0, 255, 255, 0, 0, 255, 255]);
    let checksum = crc32(&bytes[12..29]);
    bytes[29..33].copy_from_slice(&checksum.to_be_bytes());
    assert!(matches!(with_image(&bytes).import(), Err(ImportError::LimitExceeded { .. })));
}

fn crc32(bytes: &[u8]) -> u32 {
    let step = |crc: u32, &byte: &u8| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ (0xEDB8_8320 * (crc & 1)))
    };
    !bytes.iter().fold(u32::MAX, step)
}

#[test]
fn texture_transform_overrides_the_uv_set_and_sets_the_map() {
    let mut document = with_image(&png(1, 1, &[[9; 4]]));
    let info = &mut document.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"];
    info["texCoord"] = json!(1);
    info["extensions"] =
        json!({"KHR_texture_transform": {"offset": [0.5, 0.25], "scale": [2, 3], "texCoord": 0}});
    document.json["samplers"] = json!([{"wrapS": 33071, "wrapT": 33648}]);
    document.json["textures"][0]["sampler"] = json!(0);
    let texture = document.import().unwrap().scene.materials.remove(0).base_colour_texture.unwrap();
    assert_eq!(texture.uv_set, 0);
    assert_eq!(texture.uv_transform, [[2.0, 0.0, 0.5], [0.0, 3.0, 0.25]]);
    assert_eq!(texture.wrap, [Wrap::Clamp, Wrap::Mirror]);
}

#[test]
fn texture_transform_turns_as_the_khronos_test_model_does() {
    // TextureTransformTest "Rotation": at uv (0.421, 1.016) of the quad lies the marker to which the arrow, drawn along
    // the image's diagonal, must point after a turn by 22.5°.
    let mut document = with_image(&png(1, 1, &[[9; 4]]));
    document.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["extensions"] =
        json!({"KHR_texture_transform": {"rotation": std::f32::consts::FRAC_PI_8}});
    let rows = document.import().unwrap().scene.materials.remove(0).base_colour_texture.unwrap().uv_transform;
    let [u, v] = rows.map(|[a, b, c]| a * 0.421 + b * 1.016 + c);
    assert!((u - v).abs() < 1e-3, "{u} {v}");
}

#[test]
fn texture_on_a_mesh_without_uvs_is_warned_of() {
    let mut document = with_image(&png(1, 1, &[[9; 4]]));
    document.attributes().as_object_mut().unwrap().remove("TEXCOORD_0");
    assert_eq!(codes(&document.import().unwrap()), ["texture-without-uvs"]);
}

#[test]
fn materials_of_specular_and_glossiness_have_their_diffuse_colour() {
    let old = |specular: [f32; 3]| {
        json!({"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}, "extensions": {
            "KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [0.1, 0.2, 0.3, 0.5],
                "diffuseTexture": {"index": 0}, "specularFactor": specular}}})
    };
    let mut document = with_image(&png(1, 1, &[[9; 4]]));
    document.json["materials"] = json!([old([0.04; 3])]);
    document.json["extensionsUsed"] = json!(["KHR_materials_pbrSpecularGlossiness"]);
    let imported = document.import().unwrap();
    assert_eq!(imported.scene.materials[0].base_colour, [0.1, 0.2, 0.3, 0.5]);
    assert!(imported.scene.materials[0].base_colour_texture.is_some());
    assert_eq!(codes(&imported), [""; 0]);
    document.json["materials"] = json!([old([0.9; 3])]);
    assert_eq!(codes(&document.import().unwrap()), ["specular-colour-ignored"]);
}

#[test]
fn required_extensions_of_gloss_and_motion_do_not_stop_a_bake() {
    let mut document = Document::triangle();
    document.json["extensionsRequired"] = json!(["KHR_materials_clearcoat", "KHR_animation_pointer"]);
    document.json["extensionsUsed"] = document.json["extensionsRequired"].clone();
    assert_eq!(codes(&document.import().unwrap()), ["extension-ignored"]);
}
