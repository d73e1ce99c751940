//! The hierarchy: transforms, identity, lights and cameras, and trees that are none.

use glam::Vec3;
use lightkiln_proto::scene::LightKind;
use serde_json::{Value, json};

use super::document_builder::{Document, UNSIGNED_BYTE, codes};
use crate::scene::model::LitBy;
use crate::scene::{Bundle, ImportError, Limits, import};

/// The triangle with +z normals under `node`, which must not move its plane's sides apart.
fn placed(node: Value) -> crate::scene::model::MeshInstance {
    let mut document = Document::triangle_with_normals();
    document.json["nodes"] = json!([node]);
    document.json["nodes"][0]["mesh"] = json!(0);
    document.import_one()
}

fn assert_front_is_normal_side(instance: &crate::scene::model::MeshInstance) {
    for triangle in &instance.triangles {
        let [a, b, c] = triangle.map(|vertex| instance.positions_m[vertex as usize]);
        let front = (b - a).cross(c - a);
        assert!(triangle.iter().all(|&vertex| front.dot(instance.normals[vertex as usize]) > 0.0));
    }
    assert!(instance.normals.iter().all(|normal| (normal.length() - 1.0).abs() < 1e-5));
}

#[test]
fn mirrored_node_flips_winding_and_keeps_normals_outside() {
    let instance = placed(json!({"scale": [-1, 1, 1]}));
    assert_eq!(instance.triangles, [[0, 2, 1]]);
    assert_eq!(instance.normals, [Vec3::Z; 3]);
    assert_front_is_normal_side(&instance);
    let inverted = placed(json!({"scale": [-1, -1, -1]}));
    assert!(inverted.normals.iter().all(|normal| normal.distance(Vec3::NEG_Z) < 1e-6));
    assert_front_is_normal_side(&inverted);
}

#[test]
fn two_mirrors_cancel() {
    let mut document = Document::triangle_with_normals();
    document.json["nodes"] =
        json!([{"children": [1], "scale": [1, 1, -1]}, {"mesh": 0, "scale": [-2, 1, 1]}]);
    let instance = document.import_one();
    assert_eq!(instance.triangles, [[0, 1, 2]]);
    assert_front_is_normal_side(&instance);
}

#[test]
fn sheared_and_unevenly_scaled_normals_stay_perpendicular() {
    let shear = placed(json!({"matrix": [1, 0, 0.5, 0, 0.25, 1, 0, 0, 0, 0, 3, 0, 5, 6, 7, 1]}));
    for edge in [shear.positions_m[1] - shear.positions_m[0], shear.positions_m[2] - shear.positions_m[0]] {
        assert!(edge.dot(shear.normals[0]).abs() < 1e-6);
    }
    assert_eq!(shear.positions_m[0], Vec3::new(5.0, 6.0, 7.0));
    assert_front_is_normal_side(&shear);
}

#[test]
fn flattening_node_keeps_normals_of_what_remains() {
    let instance = placed(json!({"scale": [2, 2, 0]}));
    assert_eq!(instance.normals, [Vec3::Z; 3]);
    let mut gone = Document::triangle_with_normals();
    gone.json["nodes"][0]["scale"] = json!([0, 1, 1]);
    let imported = gone.import().unwrap();
    assert_eq!(imported.counts["degenerate_triangles"], 1);
    assert_eq!(codes(&imported), ["degenerate-triangles-dropped", "no-triangles"]);
}

#[test]
fn rotation_comes_before_translation_and_after_scale() {
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let instance =
        placed(json!({"translation": [10, 0, 0], "rotation": [0, 0, half, half], "scale": [3, 1, 1]}));
    assert!(instance.positions_m[1].distance(Vec3::new(10.0, 3.0, 0.0)) < 1e-5);
    assert!(instance.positions_m[2].distance(Vec3::new(9.0, 0.0, 0.0)) < 1e-5);
    assert!((instance.world_from_object.transform_point3(Vec3::X) - instance.positions_m[1]).length() < 1e-5);
}

#[test]
fn paths_name_nodes_mesh_and_primitive_and_repeat_with_numbers() {
    let mut document = Document::triangle();
    document.json["nodes"] = json!([{"name": "house", "children": [1, 2, 3]},
        {"name": "wall", "mesh": 0}, {"name": "wall", "mesh": 0}, {"mesh": 0}]);
    let imported = document.import().unwrap();
    let paths: Vec<&str> = imported.scene.instances.iter().map(|instance| instance.path.as_str()).collect();
    assert_eq!(paths, ["house/wall/tri/0", "house/wall/tri/0#2", "house/node/tri/0"]);
}

#[test]
fn cycles_and_second_parents_are_refused() {
    let cycle = json!([{"children": [1]}, {"children": [0]}]);
    let own_child = json!([{"children": [0]}]);
    let two_parents = json!([{"children": [1, 2]}, {"children": [2]}, {"mesh": 0}]);
    for nodes in [cycle, own_child, two_parents] {
        for has_scene in [true, false] {
            let mut document = Document::triangle();
            document.json["nodes"] = nodes.clone();
            if !has_scene {
                document.json.as_object_mut().unwrap().remove("scenes");
                document.json.as_object_mut().unwrap().remove("scene");
            }
            assert!(matches!(document.import(), Err(ImportError::NodeReachedTwice { .. })));
        }
    }
}

#[test]
fn depth_is_limited_and_costs_no_stack() {
    let chain = |depth: usize| {
        let mut document = Document::triangle();
        let mut nodes: Vec<Value> = (1..depth).map(|child| json!({"children": [child]})).collect();
        nodes.push(json!({"mesh": 0}));
        document.json["nodes"] = json!(nodes);
        document
    };
    assert_eq!(chain(256).import().unwrap().scene.instances.len(), 1);
    assert!(matches!(chain(257).import(), Err(ImportError::LimitExceeded { what: "levels of nodes", .. })));
    let limits = Limits { node_depth: u64::MAX, ..Limits::default() };
    let bundle = Bundle::from_bytes(chain(5_000).glb(), &limits).unwrap();
    assert_eq!(import(&bundle, &limits).unwrap().scene.instances.len(), 1);
}

#[test]
fn scene_is_the_default_else_the_first_else_all_roots() {
    let mut document = Document::triangle();
    document.json["nodes"] = json!([{"mesh": 0, "name": "a"}, {"mesh": 0, "name": "b"}]);
    document.json["scenes"] = json!([{"nodes": [0]}, {"nodes": [1]}]);
    document.json["scene"] = json!(1);
    let imported = document.import().unwrap();
    assert_eq!(imported.scene.instances[0].path, "b/tri/0");
    assert_eq!(codes(&imported), ["other-scenes-ignored"]);
    document.json.as_object_mut().unwrap().remove("scene");
    assert_eq!(document.import_one().path, "a/tri/0");
    document.json.as_object_mut().unwrap().remove("scenes");
    assert_eq!(document.import().unwrap().scene.instances.len(), 2);
}

#[test]
fn transforms_that_overflow_are_refused() {
    let mut document = Document::triangle();
    document.json["nodes"] =
        json!([{"children": [1], "scale": [1e30, 1e30, 1e30]}, {"mesh": 0, "scale": [1e30, 1e30, 1e30]}]);
    assert!(matches!(document.import(), Err(ImportError::NonFiniteTransform { .. })));
}

#[test]
fn skins_and_morph_targets_are_baked_at_rest_with_warnings() {
    let mut document = Document::triangle();
    document.json["skins"] = json!([{"joints": [0]}]);
    document.json["nodes"][0]["skin"] = json!(0);
    document.primitive()["targets"] = json!([{"POSITION": 0}]);
    document.json["animations"] = json!([{"channels": [], "samplers": []}]);
    let imported = document.import().unwrap();
    assert_eq!(codes(&imported), ["animations-ignored", "skin-at-rest", "morph-at-rest"]);
    assert_eq!(imported.scene.instances[0].positions_m[1], Vec3::X);
}

#[test]
fn animations_of_nothing_are_valid_and_not_played() {
    let mut document = Document::triangle();
    let channel = json!({"sampler": 0, "target": {"path": "pointer", "extensions": {"KHR_animation_pointer": {"pointer": "/x"}}}});
    let animation = json!({"channels": [channel], "samplers": [{"input": 0, "output": 0}]});
    document.json["animations"] = json!([animation, animation]);
    document.json["scenes"] = json!([{"nodes": [0]}, {}]);
    let imported = document.import().unwrap();
    assert_eq!(codes(&imported), ["animations-ignored", "other-scenes-ignored"]);
    assert_eq!(imported.scene.instances.len(), 1);
}

#[test]
fn morph_targets_take_their_default_weights_and_those_of_a_node_win() {
    let mut document = Document::triangle_with_normals();
    document.primitive()["targets"] = json!([{"POSITION": 0}, {"POSITION": 0}]);
    document.json["meshes"][0]["weights"] = json!([0.5, 0]);
    assert_eq!(document.import_one().positions_m[1], Vec3::X * 1.5);
    document.json["nodes"][0]["weights"] = json!([0, 2]);
    assert_eq!(document.import_one().positions_m[1], Vec3::X * 3.0);
    document.json["nodes"][0]["weights"] = json!([1e38, 1e38]);
    document.json["nodes"][0]["scale"] = json!([1e38, 1, 1]);
    assert!(document.import().is_err());
}

/// A triangle bound to two joints, one moved by 3 in y and turned a half turn about z, the other moved by 1 in x.
fn skinned() -> Document {
    let mut document = Document::triangle_with_normals();
    let joints = document.accessor("VEC4", UNSIGNED_BYTE, 3, &[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0]);
    let weights = document.floats("VEC4", &[1.0, 0.0, 0.0, 0.0, 0.25, 0.25, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
    let identity = [1.0, 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.];
    let mut bound = [identity, identity].concat();
    bound[16 + 12] = -4.0;
    let matrices = document.floats("MAT4", &bound);
    document.json["accessors"][matrices]["count"] = json!(2);
    document.attributes()["JOINTS_0"] = json!(joints);
    document.attributes()["WEIGHTS_0"] = json!(weights);
    document.json["skins"] = json!([{"joints": [1, 2], "inverseBindMatrices": matrices}]);
    document.json["nodes"] = json!([
        {"mesh": 0, "skin": 0, "translation": [70, 70, 70]},
        {"translation": [0, 3, 0], "rotation": [0, 0, 1, 0]},
        {"translation": [5, 0, 0]}]);
    document.json["scenes"] = json!([{"nodes": [0, 1, 2]}]);
    document
}

#[test]
fn skinned_meshes_stand_where_their_joints_are() {
    let instance = skinned().import_one();
    // The second joint moves by 1 in x; half of each gives the mean; the first turns and moves.
    let wanted = [Vec3::X, Vec3::new(0.5, 1.5, 0.0), Vec3::new(0.0, 2.0, 0.0)];
    for (found, wanted) in instance.positions_m.iter().zip(wanted) {
        assert!(found.distance(wanted) < 1e-6, "{found} {wanted}");
    }
}

#[test]
fn joints_that_are_not_there_are_named() {
    let mut document = skinned();
    document.json["skins"][0]["joints"] = json!([1]);
    let message = document.import().unwrap_err().to_string();
    assert!(message.contains("joint 1") && message.contains("has 1"), "{message}");
    document.json["skins"][0]["joints"] = json!([1, 9]);
    assert!(document.import().unwrap_err().to_string().contains("node 9"));
}

#[test]
fn lights_shine_along_minus_z_of_their_node_in_world_space() {
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let mut document = Document::triangle();
    document.json["extensions"] = json!({"KHR_lights_punctual": {"lights": [
        {"type": "spot", "color": [1, 0.5, 0], "intensity": 8, "spot": {}, "range": 3},
        {"type": "directional", "name": "sun"}, {"type": "point", "intensity": -1}]}});
    let light = |index: usize| json!({"KHR_lights_punctual": {"light": index}});
    document.json["nodes"] = json!([
        {"translation": [1, 2, 3], "scale": [2, 2, 2], "children": [1, 2, 3]},
        {"translation": [1, 0, 0], "rotation": [-half, 0, 0, half], "extensions": light(0)},
        {"extensions": light(1)}, {"extensions": light(2)}]);
    let imported = document.import().unwrap();
    let lights = &imported.scene.lights;
    let LightKind::Spot { position_m, direction, inner_rad, outer_rad, range_m } = &lights[0].kind else {
        panic!("must be a spot")
    };
    assert_eq!(*position_m, [3.0, 2.0, 3.0]);
    assert!(Vec3::from(*direction).distance(Vec3::NEG_Y) < 1e-6);
    assert_eq!((*inner_rad, *outer_rad, *range_m), (0.0, std::f32::consts::FRAC_PI_4, Some(3.0)));
    assert_eq!(lights[0].strength, [8.0, 4.0, 0.0]);
    assert_eq!(lights[1].kind, LightKind::Sun { direction: [0.0, 0.0, -1.0] });
    assert_eq!(lights[1].name, "sun");
    assert_eq!(lights[2].strength, [0.0; 3]);
    assert_eq!(codes(&imported), ["light-strength-clamped", "no-triangles"]);
}

#[test]
fn cameras_ignore_scale_and_keep_both_projections() {
    let mut document = Document::triangle();
    document.json["cameras"] = json!([
        {"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.1}},
        {"type": "orthographic", "name": "plan", "orthographic": {"xmag": 1, "ymag": 2.5, "zfar": 9, "znear": 0}},
        {"type": "perspective"}]);
    document.json["nodes"] = json!([{"children": [1, 2, 3], "scale": [3, -2, 5]},
        {"camera": 0, "translation": [0, 1, 0]}, {"camera": 1}, {"camera": 2}]);
    let imported = document.import().unwrap();
    let [first, second] = imported.scene.cameras.as_slice() else { panic!("two cameras") };
    assert_eq!((first.eye_m, first.target_m), ([0.0, -2.0, 0.0], [0.0, -2.0, -1.0]));
    assert_eq!((first.up, first.fov_y_rad), ([0.0, -1.0, 0.0], 0.7));
    assert_eq!((second.name.as_str(), second.orthographic_half_height_m), ("plan", Some(2.5)));
    assert!(codes(&imported).contains(&"camera-skipped"));
}

#[test]
fn extras_say_what_lights_a_node_and_all_below_it() {
    let mut document = Document::triangle_with_normals();
    document.json["nodes"] = json!([
        {"children": [1, 2, 3], "extras": {"kiln_lit": "probes", "other": [1, {}]}},
        {"mesh": 0},
        {"mesh": 0, "translation": [1, 0, 0], "extras": {"kiln_lit": "texels"}},
        {"mesh": 0, "translation": [2, 0, 0], "extras": {"kiln_lit": ["candles"]}},
        {"mesh": 0, "translation": [3, 0, 0], "extras": 7},
        {"mesh": 0, "translation": [4, 0, 0], "extras": {"kiln_lit": "walks"}},
    ]);
    document.json["scenes"] = json!([{"nodes": [0, 4, 5]}]);
    let imported = document.import().unwrap();
    let lit: Vec<Option<LitBy>> = imported.scene.instances.iter().map(|instance| instance.lit_by).collect();
    let [probes, texels, walks] = [LitBy::Probes, LitBy::Texels, LitBy::Walks].map(Some);
    assert_eq!(lit, [probes, texels, probes, None, walks]);
    assert_eq!(codes(&imported), ["lit-by-something-else"]);
    assert!(imported.warnings[0].message.contains(r#""kiln_lit": ["candles"]"#), "{:?}", imported.warnings);
}
