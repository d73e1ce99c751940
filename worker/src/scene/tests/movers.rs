//! Nodes taken out of a scene: which, their frames, their bytes, and that nothing is lost.

use glam::{Affine3A, DQuat, EulerRot, Mat4, Quat, Vec3};
use lightkiln_proto::scene::Stance;
use serde_json::{Value, json};

use super::document_builder::{Document, codes, import_bytes, png};
use crate::scene::model::{Imported, Scene};
use crate::scene::movers::{MoverError, MoverNodes, Split, split};
use crate::scene::{Bundle, Limits};

/// Longest distance between a vertex and where it was, in metres.
const NEAR_M: f32 = 1e-5;

fn named(names: &[&str]) -> MoverNodes {
    MoverNodes { names: names.iter().map(|name| (*name).to_owned()).collect(), animated: false }
}

fn animated() -> MoverNodes {
    MoverNodes { animated: true, ..MoverNodes::default() }
}

fn parted(document: &Document, nodes: &MoverNodes) -> Result<Split, MoverError> {
    let limits = Limits::default();
    split(&Bundle::from_bytes(document.glb(), &limits).unwrap(), nodes, &limits)
}

fn refused(document: &Document, nodes: &MoverNodes) -> String {
    parted(document, nodes).unwrap_err().to_string()
}

fn imported(glb: &[u8]) -> Imported {
    import_bytes(glb.to_vec()).unwrap()
}

/// The JSON of a GLB.
fn json_of(glb: &[u8]) -> Value {
    let bytes = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    serde_json::from_slice(&glb[20..20 + bytes]).unwrap()
}

/// Where a stance has an object, as clients read it.
fn place(stance: &Stance) -> Affine3A {
    let [yaw, pitch, roll] = stance.turn_deg.map(f32::to_radians);
    let turn = Quat::from_euler(EulerRot::YXZ, yaw, pitch, roll);
    Affine3A::from_rotation_translation(turn, stance.position_m.into())
}

/// All vertices and normals of a scene, in an order that hangs on no file.
fn surfaces(scene: &Scene, place: Affine3A) -> Vec<[Vec3; 2]> {
    let turn = glam::Mat3::from(place.matrix3);
    let of_instance = scene.instances.iter().flat_map(|instance| {
        let corners = instance.triangles.iter().flatten().map(|vertex| *vertex as usize);
        corners.map(|at| [instance.positions_m[at], instance.normals[at]])
    });
    of_instance.map(|[at, normal]| [place.transform_point3(at), turn * normal]).collect()
}

/// Asserts that a scene and its parts, where they stand, have the same triangles.
#[track_caller]
fn assert_whole(document: &Document, split: &Split) {
    let whole = surfaces(&document.import().unwrap().scene, Affine3A::IDENTITY);
    let mut parts = surfaces(&imported(&split.rest).scene, Affine3A::IDENTITY);
    for object in &split.objects {
        parts.extend(surfaces(&imported(&object.scene).scene, place(&object.stance)));
    }
    assert_eq!(whole.len(), parts.len());
    for [at, normal] in &whole {
        let is_it =
            |[there, towards]: &[Vec3; 2]| at.distance(*there) < NEAR_M && normal.distance(*towards) < NEAR_M;
        let found = parts.iter().position(is_it);
        parts.swap_remove(found.unwrap_or_else(|| panic!("nothing is at {at} towards {normal}: {parts:?}")));
    }
}

/// Floor, and a chair on a turned, scaled table with a lamp; the chair's mesh stands elsewhere in the room too.
fn room() -> Document {
    let mut document = Document::triangle_with_normals();
    let image = document.view(&png(1, 1, &[[200, 10, 10, 255]]));
    let other = document.view(&png(1, 1, &[[10, 10, 200, 255]]));
    document.json["images"] = json!([
        {"bufferView": other, "mimeType": "image/png", "name": "blue"},
        {"bufferView": image, "mimeType": "image/png", "name": "red"},
    ]);
    document.json["samplers"] = json!([{"wrapS": 10497}, {"wrapS": 33071, "wrapT": 33071}]);
    document.json["textures"] = json!([{"source": 0}, {"source": 1, "sampler": 1}]);
    document.json["materials"] = json!([
        {"name": "blue", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}},
        {"name": "plain"},
        {"name": "red", "pbrMetallicRoughness": {"baseColorTexture": {"index": 1}}, "emissiveFactor": [1, 1, 1],
         "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 5.0}}},
    ]);
    let seat = document.json["meshes"][0]["primitives"][0].clone();
    let uvs = document.floats("VEC2", &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
    let mut textured = seat.clone();
    textured["material"] = json!(2);
    textured["attributes"]["TEXCOORD_0"] = json!(uvs);
    let mut blue = textured.clone();
    blue["material"] = json!(0);
    document.json["meshes"] = json!([
        {"name": "floor", "primitives": [blue]},
        {"name": "legs", "primitives": [seat]},
        {"name": "seat", "primitives": [textured]},
    ]);
    document.json["extensionsUsed"] = json!(["KHR_lights_punctual", "KHR_materials_emissive_strength"]);
    document.json["extensions"] = json!({"KHR_lights_punctual": {"lights": [{"type": "point"}]}});
    document.json["cameras"] = json!([{"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.1}}]);
    let turn = Quat::from_euler(EulerRot::YXZ, 0.7, 0.4, -0.3).to_array();
    document.json["nodes"] = json!([
        {"name": "floor", "mesh": 0, "scale": [5.0, 5.0, 5.0]},
        {"name": "table", "translation": [1.0, 2.0, -0.5], "rotation": turn, "scale": [0.5, 0.5, 0.5], "children": [2, 5]},
        {"name": "chair", "translation": [3.0, 0.25, 1.0], "rotation": turn, "scale": [2.0, 1.0, -3.0], "children": [3, 4]},
        {"name": "seat", "mesh": 2, "translation": [0.0, 0.5, 0.0]},
        {"name": "legs", "mesh": 1, "rotation": turn},
        {"name": "spare", "mesh": 2},
        {"name": "lamp", "translation": [0.0, 3.0, 0.0], "extensions": {"KHR_lights_punctual": {"light": 0}}},
        {"name": "eye", "camera": 0},
        {"name": "empty"},
    ]);
    document.json["scenes"][0]["nodes"] = json!([0, 1, 6, 7, 8]);
    document
}

#[test]
fn parts_where_they_stand_are_the_whole_scene() {
    let document = room();
    for names in [&["chair"][..], &["seat"], &["table"], &["legs", "spare"], &["seat", "legs", "floor"]] {
        let split = parted(&document, &named(names)).unwrap();
        assert_eq!(split.objects.iter().map(|object| &object.name[..]).collect::<Vec<_>>(), names);
        assert_whole(&document, &split);
        assert_eq!(imported(&split.rest).warnings, [], "{names:?}");
    }
}

#[test]
fn rest_keeps_lights_and_cameras_and_an_object_has_none() {
    let mut document = room();
    document.json["nodes"][2]["children"] = json!([3, 4, 6, 7]);
    document.json["scenes"][0]["nodes"] = json!([0, 1, 8]);
    let whole = document.import().unwrap().scene;
    let split = parted(&document, &named(&["chair"])).unwrap();
    let rest = imported(&split.rest).scene;
    assert_eq!((&rest.lights, &rest.cameras), (&whole.lights, &whole.cameras));
    let object = imported(&split.objects[0].scene).scene;
    assert_eq!((object.lights.len(), object.cameras.len()), (0, 0));
    let [warning] = &split.warnings[..] else { panic!("{:?}", split.warnings) };
    assert!(warning.code == "light-stays-behind" && warning.message.contains("\"chair\""), "{warning:?}");
    // Of movers within movers, too, it is told once.
    animate(&mut document, &[(1, "rotation"), (2, "rotation")]);
    let [warning] = &parted(&document, &animated()).unwrap().warnings[..] else { panic!("one warning") };
    assert!(!warning.message.contains("first of"), "{warning:?}");
}

#[test]
fn object_is_in_its_nodes_frame_with_its_scale() {
    let mut document = Document::triangle_with_normals();
    document.json["nodes"] = json!([
        {"name": "floor", "mesh": 0},
        {"name": "car", "mesh": 0, "translation": [4.0, 0.5, -2.0], "rotation": Quat::from_rotation_y(0.5).to_array(), "scale": [2.0, 3.0, 1.0]},
    ]);
    document.json["scenes"][0]["nodes"] = json!([0, 1]);
    let split = parted(&document, &named(&["car"])).unwrap();
    let stance = split.objects[0].stance;
    assert_eq!((stance.position_m, stance.scale), ([4.0, 0.5, -2.0], 1.0));
    let [yaw, pitch, roll] = stance.turn_deg;
    assert!((yaw - 0.5_f32.to_degrees()).abs() < 1e-4 && [pitch, roll] == [0.0; 2], "{stance:?}");
    let corners = &imported(&split.objects[0].scene).scene.instances[0].positions_m;
    assert_eq!(corners[..], [Vec3::ZERO, 2.0 * Vec3::X, 3.0 * Vec3::Y]);
}

#[test]
fn materials_and_images_come_along_and_no_others() {
    let split = parted(&room(), &named(&["chair"])).unwrap();
    let object = imported(&split.objects[0].scene).scene;
    let looks: Vec<&str> = object.materials.iter().map(|material| &material.name[..]).collect();
    assert_eq!(looks[..1], ["red"], "{looks:?}");
    assert_eq!(object.materials[0].emissive, [5.0; 3]);
    let texture = object.materials[0].base_colour_texture.as_ref().unwrap();
    assert_eq!(
        texture.wrap,
        room().import().unwrap().scene.materials[2].base_colour_texture.as_ref().unwrap().wrap
    );
    assert_eq!(object.images.iter().map(|image| &image.name[..]).collect::<Vec<_>>(), ["red"]);
    let split = parted(&room(), &self::named(&["chair", "spare"])).unwrap();
    let rest = imported(&split.rest).scene;
    assert_eq!(rest.images.iter().map(|image| &image.name[..]).collect::<Vec<_>>(), ["blue"]);
    let json = json_of(&split.rest);
    assert_eq!(json["meshes"].as_array().unwrap().len(), 1);
    assert_eq!(json["extensionsUsed"], room().json["extensionsUsed"]);
    assert_eq!(
        json_of(&split.objects[1].scene)["extensionsUsed"],
        json!(["KHR_materials_emissive_strength"])
    );
}

#[test]
fn object_is_the_same_bytes_in_whatever_scene_it_stands() {
    let split = parted(&room(), &named(&["chair"])).unwrap();
    // Another room: other numbers, names, parents, turns, and one buffer view for all.
    let mut other = room();
    other.floats("VEC3", &[7.0; 9]);
    other.push("materials", json!({"name": "late"}));
    let swap = |document: &mut Document, list: &str, a: usize, b: usize| {
        document.json[list].as_array_mut().unwrap().swap(a, b);
    };
    swap(&mut other, "materials", 0, 2);
    other.json["meshes"][0]["primitives"][0]["material"] = json!(2);
    other.json["meshes"][2]["primitives"][0]["material"] = json!(0);
    swap(&mut other, "meshes", 1, 2);
    let [seat, legs, chair] = [3, 4, 2];
    other.json["nodes"][seat]["mesh"] = json!(1);
    other.json["nodes"][legs]["mesh"] = json!(2);
    other.json["nodes"][5]["mesh"] = json!(1);
    other.json["nodes"][chair]["name"] = json!("chair.001");
    other.json["nodes"][chair]["translation"] = json!([-9.5, 0.1, 0.3]);
    other.json["nodes"][chair]["rotation"] =
        json!(Quat::from_euler(EulerRot::YXZ, -2.1, 0.9, 0.2).to_array());
    other.json["nodes"][1]["rotation"] = json!(Quat::from_rotation_x(1.1).to_array());
    let again = parted(&other, &named(&["chair.001"])).unwrap();
    assert_whole(&other, &again);
    assert_ne!(split.objects[0].stance, again.objects[0].stance);
    assert_eq!(json_of(&split.objects[0].scene), json_of(&again.objects[0].scene));
    assert!(split.objects[0].scene == again.objects[0].scene, "the same JSON, and other bytes");
    // Another chair.
    other.json["nodes"][chair]["scale"] = json!([2.0, 1.0, -2.5]);
    let taller = parted(&other, &named(&["chair.001"])).unwrap();
    assert!(split.objects[0].scene != taller.objects[0].scene);
}

#[test]
fn rest_is_the_same_bytes_wherever_its_movers_stand() {
    let split = parted(&room(), &named(&["chair"])).unwrap();
    let mut moved = room();
    moved.json["nodes"][2]["translation"] = json!([0.0, 1.0, 7.0]);
    assert!(split.rest == parted(&moved, &named(&["chair"])).unwrap().rest);
}

#[test]
fn matrices_of_nodes_are_placed_and_turned_chairs_stay_the_same() {
    let of = |turn: f32| {
        let mut document = room();
        let chair = document.json["nodes"][2].as_object_mut().unwrap();
        chair.retain(|key, _| !["translation", "rotation", "scale"].contains(&key.as_str()));
        let turn = Quat::from_euler(EulerRot::YXZ, turn, 0.3, 0.1);
        let matrix =
            Mat4::from_scale_rotation_translation(Vec3::splat(1.5), turn, Vec3::new(3.0, 0.1, turn.y));
        chair.insert("matrix".to_owned(), json!(matrix.to_cols_array()));
        let split = parted(&document, &named(&["chair"])).unwrap();
        assert_whole(&document, &split);
        split
    };
    let [one, other] = [0.2, 2.9].map(of);
    assert_ne!(one.objects[0].stance, other.objects[0].stance);
    assert!(one.objects[0].scene == other.objects[0].scene);
}

#[test]
fn sheared_and_mirrored_nodes_are_where_they_were() {
    let mut document = room();
    document.json["nodes"][1]["scale"] = json!([0.5, 2.0, -1.0]);
    for names in [["chair"], ["seat"], ["legs"]] {
        assert_whole(&document, &parted(&document, &named(&names)).unwrap());
    }
    let matrix = Mat4::from_scale(Vec3::new(-1.0, 1.0, 1.0)) * Mat4::from_rotation_y(0.4);
    document.json["nodes"][3] = json!({"name": "seat", "mesh": 2, "matrix": matrix.to_cols_array()});
    assert_whole(&document, &parted(&document, &named(&["seat"])).unwrap());
}

#[test]
fn compressed_strided_and_sparse_meshes_are_packed_as_they_are_read() {
    let mut document = room();
    let mut bytes = Vec::new();
    for corner in [[0.0_f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]] {
        bytes.extend(corner.iter().flat_map(|number| number.to_le_bytes()));
        bytes.extend([127_u8, 0, 0, 0]);
    }
    let view = document.view(&bytes);
    document.json["bufferViews"][view]["byteStride"] = json!(16);
    let accessor = |offset: usize, component: u32, normalized: bool| json!({"bufferView": view, "byteOffset": offset, "componentType": component, "count": 3, "type": "VEC3", "normalized": normalized});
    let position = document.push("accessors", accessor(0, super::document_builder::FLOAT, false));
    let normal = document.push("accessors", accessor(12, super::document_builder::BYTE, true));
    let indices = document.view(&[1, 0, 2, 0]);
    let values = document.view(
        &[[2.0_f32, 0.0, 0.0], [0.0, 2.0, 0.0]]
            .concat()
            .iter()
            .flat_map(|number| number.to_le_bytes())
            .collect::<Vec<_>>(),
    );
    document.json["accessors"][position]["sparse"] = json!({
        "count": 2,
        "indices": {"bufferView": indices, "componentType": super::document_builder::UNSIGNED_SHORT},
        "values": {"bufferView": values},
    });
    let list = document.indices(&[2, 0, 1]);
    document.json["meshes"][1]["primitives"][0] =
        json!({"attributes": {"POSITION": position, "NORMAL": normal}, "indices": list});
    document.json["extensionsUsed"] = json!(["KHR_mesh_quantization", "KHR_lights_punctual"]);
    document.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
    let split = parted(&document, &named(&["legs"])).unwrap();
    assert_whole(&document, &split);
    let object = json_of(&split.objects[0].scene);
    assert_eq!(object["extensionsRequired"], json!(["KHR_mesh_quantization"]));
    let strides: Vec<&Value> =
        object["bufferViews"].as_array().unwrap().iter().map(|view| &view["byteStride"]).collect();
    assert_eq!(strides, [&json!(4), &Value::Null, &Value::Null], "{object}");
}

/// Animates properties of nodes.
fn animate(document: &mut Document, channels: &[(usize, &str)]) {
    let channel =
        |(node, path): &(usize, &str)| json!({"sampler": 0, "target": {"node": node, "path": path}});
    let channels: Vec<Value> = channels.iter().map(channel).collect();
    let input = document.floats("SCALAR", &[0.0, 1.0]);
    let output = document.floats("VEC3", &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
    document.json["animations"] =
        json!([{"channels": channels, "samplers": [{"input": input, "output": output}]}]);
}

#[test]
fn animated_nodes_are_objects_and_their_animated_parts_are_too() {
    let mut document = room();
    // The camera and the node without a mesh move nothing that is seen; weights bend.
    animate(
        &mut document,
        &[(7, "translation"), (1, "rotation"), (3, "translation"), (8, "scale"), (0, "weights")],
    );
    let split = parted(&document, &animated()).unwrap();
    let names: Vec<&str> = split.objects.iter().map(|object| &object.name[..]).collect();
    assert_eq!(names, ["table", "seat"]);
    assert_whole(&document, &split);
    // Legs and spare chair go with the table.
    assert_eq!(imported(&split.objects[0].scene).scene.instances.len(), 2);
    assert!(codes(&imported(&split.rest)).is_empty() && split.warnings.is_empty());
    // Who names nodes is told of what is not played.
    document.push("scenes", json!({"nodes": []}));
    let split = parted(&document, &named(&["seat"])).unwrap();
    let told: Vec<&str> = split.warnings.iter().map(|warning| &warning.code[..]).collect();
    assert_eq!(told, ["animations-ignored", "other-scenes-ignored"]);
    document.json["scenes"].as_array_mut().unwrap().pop();
    let both = MoverNodes { names: vec!["floor".to_owned()], animated: true };
    assert!(refused(&document, &both).contains("nothing is left"));
    let both = MoverNodes { names: vec!["legs".to_owned()], animated: true };
    assert_eq!(parted(&document, &both).unwrap().objects.len(), 3);
}

#[test]
fn animation_pointers_are_read_and_a_scene_without_animation_is_refused() {
    let mut document = room();
    assert!(refused(&document, &animated()).contains("no animation"));
    animate(&mut document, &[(0, "weights"), (7, "translation")]);
    assert!(refused(&document, &animated()).contains("no animation"));
    let target =
        json!({"path": "pointer", "extensions": {"KHR_animation_pointer": {"pointer": "/nodes/2/rotation"}}});
    document.json["animations"][0]["channels"][0]["target"] = target;
    let split = parted(&document, &animated()).unwrap();
    assert_eq!(split.objects[0].name, "chair");
}

#[test]
fn skins_move_with_their_joints_or_are_refused() {
    let mut document = Document::triangle_with_normals();
    let joints = document.accessor("VEC4", super::document_builder::UNSIGNED_BYTE, 3, &[0; 12]);
    let weights = document.floats("VEC4", &[1.0, 0.0, 0.0, 0.0].repeat(3));
    document.json["meshes"] = json!([document.json["meshes"][0], document.json["meshes"][0]]);
    document.attributes()["JOINTS_0"] = json!(joints);
    document.attributes()["WEIGHTS_0"] = json!(weights);
    document.json["skins"] = json!([{"joints": [3]}]);
    document.json["nodes"] = json!([
        {"name": "floor", "mesh": 1},
        {"name": "man", "translation": [1.0, 2.0, 3.0], "rotation": Quat::from_rotation_z(0.3).to_array(), "children": [2, 3]},
        {"name": "skin", "mesh": 0, "skin": 0},
        {"name": "hip", "translation": [0.0, 1.0, 0.0], "rotation": Quat::from_rotation_x(0.6).to_array(), "children": [4]},
        {"name": "sword", "mesh": 1},
    ]);
    document.json["scenes"][0]["nodes"] = json!([0, 1]);
    assert_whole(&document, &parted(&document, &named(&["man"])).unwrap());
    let error = refused(&document, &named(&["skin"]));
    assert!(
        error.contains("\"skin\"") && error.contains("\"hip\"") && error.contains("above both"),
        "{error}"
    );
    // The skin stays in the scene with a joint that carries what moves.
    let split = parted(&document, &named(&["hip"])).unwrap();
    assert_whole(&document, &split);
    animate(&mut document, &[(1, "translation"), (2, "translation"), (3, "rotation"), (4, "rotation")]);
    let split = parted(&document, &animated()).unwrap();
    let names: Vec<&str> = split.objects.iter().map(|object| &object.name[..]).collect();
    assert_eq!(names, ["man", "sword"]);
    assert_whole(&document, &split);
}

#[test]
fn names_that_are_no_single_nodes_with_a_mesh_are_refused() {
    let document = room();
    for (names, words) in [
        (&["Chair"][..], &["\"Chair\"", "there are \"chair\"", "as the glTF has it"][..]),
        (&["nonsense"], &["there are", ", …"]),
        (&["seat", "seat"], &["named twice"]),
        (&["table", "legs"], &["node 4 (\"legs\") is below node 1 (\"table\")"]),
        (&["legs", "chair"], &["node 4 (\"legs\") is below node 2 (\"chair\")"]),
        (&["lamp"], &["node 6 (\"lamp\") has no mesh"]),
        (&["empty"], &["no mesh of its own"]),
        (&["floor", "table"], &["nothing is left"]),
    ] {
        let error = refused(&document, &named(names));
        assert!(words.iter().all(|word| error.contains(word)), "{names:?}: {error}");
    }
    let mut twins = room();
    twins.json["nodes"][5]["name"] = json!("seat");
    assert!(refused(&twins, &named(&["seat"])).contains("2 nodes are named \"seat\""));
    let mut broken = room();
    broken.json["meshes"][2]["primitives"][0]["attributes"]["POSITION"] = json!(99);
    assert!(refused(&broken, &named(&["seat"])).contains("accessor 99"));
    let mut cyclic = room();
    cyclic.json["nodes"][4]["children"] = json!([2]);
    assert!(refused(&cyclic, &named(&["seat"])).contains("reached twice"));
}

#[test]
fn turns_about_all_axes_are_told_in_degrees() {
    for turn in [[170.0, -80.0, 20.0], [-35.0, 89.9, 100.0], [0.0, 90.0, 45.0]] {
        let [yaw, pitch, roll] = turn.map(f64::to_radians);
        let wanted = DQuat::from_euler(EulerRot::YXZ, yaw, pitch, roll).as_quat();
        let mut document = room();
        document.json["nodes"][5]["rotation"] = json!(wanted.to_array());
        document.json["nodes"][1]["rotation"] = json!([0, 0, 0, 1]);
        let split = parted(&document, &named(&["spare"])).unwrap();
        let found = place(&split.objects[0].stance);
        assert!((found.transform_vector3(Vec3::ONE) - wanted * Vec3::ONE).length() < NEAR_M, "{turn:?}");
    }
}
