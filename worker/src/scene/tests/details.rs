//! Normal maps and specular reflection, which transport does not know.

use serde_json::{Value, json};

use super::document_builder::{Document, codes, png};
use crate::assemble::materials::materials;
use crate::scene::model::{Imported, Specular};
use crate::scene::{Bundle, ImportError, Limits, import};

/// A triangle with texture coordinates, and with images of 2 × 2 texels: paint, bumps and rust.
fn textured(material: Value) -> Document {
    let mut document = Document::triangle();
    let uv = document.floats("VEC2", &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
    document.attributes()["TEXCOORD_0"] = json!(uv);
    document.attributes()["TEXCOORD_1"] = json!(uv);
    for (index, name) in ["bumps", "paint", "rust"].into_iter().enumerate() {
        let view = document.view(&png(2, 2, &[[index as u8; 4]; 4]));
        document.push("images", json!({"name": name, "bufferView": view, "mimeType": "image/png"}));
        document.push("textures", json!({"source": index}));
    }
    document.json["materials"] = json!([material]);
    document.primitive()["material"] = json!(0);
    document
}

fn whole() -> Value {
    let moved = json!({"KHR_texture_transform": {"scale": [3.0, 3.0], "offset": [0.5, 0.0]}});
    json!({
        "normalTexture": {"index": 0, "scale": 0.5, "extensions": moved},
        "pbrMetallicRoughness": {
            "baseColorTexture": {"index": 1}, "metallicRoughnessTexture": {"index": 2},
            "metallicFactor": 0.25, "roughnessFactor": 0.75,
        },
    })
}

fn specular_of(material: Value) -> Option<Specular> {
    textured(material).import().unwrap().scene.materials.remove(0).specular
}

#[test]
fn details_stand_beside_the_scene_that_light_is_baked_of() {
    let Imported { scene, details, warnings, .. } = textured(whole()).import().unwrap();
    assert!(warnings.is_empty(), "{warnings:?}");
    let names = |images: &[crate::scene::model::SceneImage]| -> Vec<String> {
        images.iter().map(|image| image.name.clone()).collect()
    };
    assert_eq!(
        (names(&scene.images), names(&details)),
        (vec!["paint".to_owned()], vec!["bumps".to_owned(), "rust".to_owned()])
    );
    let [material] = &materials(&scene).0[..] else { panic!("one material") };
    let map = material.normal_map.as_ref().unwrap();
    assert_eq!((map.texture.texture, map.scale), (1, 0.5));
    assert_eq!(map.texture.transform, Some([[3.0, 0.0, 0.5], [0.0, 3.0, 0.0]]));
    let specular = material.specular.as_ref().unwrap();
    assert_eq!((specular.metallic, specular.roughness), (0.25, 0.75));
    assert_eq!(specular.texture.as_ref().map(|used| used.texture), Some(2));
}

#[test]
fn meshes_of_a_normal_map_alone_are_drawn_with_its_coordinates() {
    let scene = textured(json!({"normalTexture": {"index": 0, "texCoord": 1}})).import().unwrap().scene;
    let draws: Vec<_> = crate::draw::draws_as_they_are(&scene, &scene.instances[0]).collect();
    assert_eq!(draws[0].uv, [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]);
}

#[test]
fn fully_rough_surfaces_and_glass_reflect_as_diffuse_ones() {
    for plain in [
        json!({}),
        json!({"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0}}),
        json!({"pbrMetallicRoughness": {"metallicFactor": 1.0, "roughnessFactor": 7.0}}),
        json!({"alphaMode": "BLEND", "pbrMetallicRoughness": {"roughnessFactor": 0.2}}),
        json!({"extensions": {"KHR_materials_pbrSpecularGlossiness": {}}, "pbrMetallicRoughness": {"roughnessFactor": 0.2}}),
    ] {
        assert_eq!(specular_of(plain.clone()), None, "{plain}");
    }
    let smooth = specular_of(json!({"pbrMetallicRoughness": {"roughnessFactor": -3.0}})).unwrap();
    assert_eq!((smooth.metallic, smooth.roughness), (1.0, 0.0));
    let textured = specular_of(json!({"pbrMetallicRoughness": {"metallicRoughnessTexture": {"index": 2}}}));
    assert!(textured.unwrap().texture.is_some());
}

#[test]
fn details_on_another_uv_set_and_odd_scales_are_left_out_with_a_warning() {
    let mut other = whole();
    other["normalTexture"]["texCoord"] = json!(1);
    let imported = textured(other).import().unwrap();
    assert_eq!(codes(&imported), ["texture-uv-set-differs"]);
    assert!(
        imported.scene.materials[0].normal_map.is_none() && imported.scene.materials[0].specular.is_some()
    );
    let mut scaled = whole();
    scaled["normalTexture"]["scale"] = json!(1e9);
    let imported = textured(scaled).import().unwrap();
    assert_eq!(codes(&imported), ["normal-scale-ignored"]);
    assert_eq!(imported.scene.materials[0].normal_map.as_ref().unwrap().scale, 1.0);
    let mut moved = whole();
    moved["normalTexture"]["extensions"]["KHR_texture_transform"] = json!({"scale": "much"});
    assert_eq!(codes(&textured(moved).import().unwrap()), ["texture-transform-ignored"]);
}

#[test]
fn details_without_room_beside_colours_are_left_out_and_broken_ones_refused() {
    let limits = Limits { texture_pixels_total: 8, ..Limits::default() };
    let of = |document: &Document| import(&Bundle::from_bytes(document.glb(), &limits).unwrap(), &limits);
    let imported = of(&textured(whole())).unwrap();
    assert_eq!(codes(&imported), ["texture-left-out"]);
    assert!(imported.warnings[0].message.contains("textures smaller"), "{:?}", imported.warnings);
    let material = &imported.scene.materials[0];
    assert!(material.normal_map.is_some() && material.specular.as_ref().unwrap().texture.is_none());
    let mut broken = textured(whole());
    let view = broken.view(b"\x89PNG\r\n\x1a\nnothing");
    broken.json["images"][0]["bufferView"] = json!(view);
    assert!(matches!(broken.import(), Err(ImportError::Image { .. })));
    let mut missing = textured(whole());
    missing.json["materials"][0]["normalTexture"]["index"] = json!(9);
    assert!(matches!(missing.import(), Err(ImportError::MissingReference { .. })));
}
