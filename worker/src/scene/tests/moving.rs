//! Files whose things move: meshes at a time.

use glam::{Quat, Vec3};
use serde_json::json;

use super::document_builder::Document;
use crate::scene::model::MeshInstance;
use crate::scene::{Bundle, ImportError, Limits, MovingFile};

fn opened(document: &Document) -> Result<MovingFile, ImportError> {
    let limits = Limits::default();
    Ok(MovingFile::open(Bundle::from_bytes(document.glb(), &limits)?, limits)?.0)
}

fn at(document: &Document, time_s: f32) -> MeshInstance {
    opened(document).unwrap().at(Some(0), time_s).unwrap().remove(0)
}

/// The triangle with one animation of one channel.
fn animated(path: &str, interpolation: &str, times: &[f32], kind: &str, values: &[f32]) -> Document {
    let mut document = Document::triangle_with_normals();
    let input = document.floats("SCALAR", times);
    let output = document.floats(kind, values);
    document.json["animations"] = json!([{
        "channels": [{"sampler": 0, "target": {"node": 0, "path": path}}],
        "samplers": [{"input": input, "output": output, "interpolation": interpolation}],
    }]);
    document
}

/// Place of the triangle's first corner, which is the node's origin.
fn origin(document: &Document, time_s: f32) -> Vec3 {
    at(document, time_s).positions_m[0]
}

#[test]
fn translations_go_from_key_to_key_and_hold_at_the_ends() {
    let values = [0.0, 0.0, 0.0, 4.0, 0.0, 2.0];
    let line = animated("translation", "LINEAR", &[1.0, 3.0], "VEC3", &values);
    assert_eq!([0.0, 1.5, 2.0, 3.0, 9.0].map(|time| origin(&line, time).x), [0.0, 1.0, 2.0, 4.0, 4.0]);
    let steps = animated("translation", "STEP", &[1.0, 3.0], "VEC3", &values);
    assert_eq!([0.0, 2.9, 3.0].map(|time| origin(&steps, time).x), [0.0, 0.0, 4.0]);
    let file = opened(&line).unwrap();
    assert_eq!(file.lengths_s(), [3.0]);
    // At rest the node stands where the file has it.
    assert_eq!(file.at(None, 2.0).unwrap()[0].positions_m[0], Vec3::ZERO);
}

#[test]
fn splines_are_hermite_and_their_tangents_are_per_second() {
    // From 0 to 0 over 2 s, leaving at 1 m/s and coming in at −1 m/s: 2·(t³ − 2t² + t) − 2·(t³ − t²) is 0.5 in the middle.
    #[rustfmt::skip]
    let values = [
        0.0, 0.0, 0.0,  0.0, 0.0, 0.0,  1.0, 0.0, 0.0,
        -1.0, 0.0, 0.0,  0.0, 0.0, 0.0,  0.0, 0.0, 0.0,
    ];
    let spline = animated("translation", "CUBICSPLINE", &[0.0, 2.0], "VEC3", &values);
    assert!((origin(&spline, 1.0).x - 0.5).abs() < 1e-6);
    assert_eq!(origin(&spline, 5.0), Vec3::ZERO);
}

#[test]
fn rotations_turn_the_short_way_and_normals_turn_with_them() {
    let [a, b] = [0.0, 1.6].map(Quat::from_rotation_y);
    // The negated quaternion is the same turn.
    let values = [a.to_array(), (-b).to_array()].concat();
    let turning = animated("rotation", "LINEAR", &[0.0, 1.0], "VEC4", &values);
    let half = at(&turning, 0.5);
    let expected = Quat::from_rotation_y(0.8);
    assert!((half.positions_m[1] - expected * Vec3::X).length() < 1e-5, "{:?}", half.positions_m);
    assert!((half.normals[0] - expected * Vec3::Z).length() < 1e-5, "{:?}", half.normals);
}

#[test]
fn weights_of_morph_targets_move_vertices() {
    let mut document = animated("weights", "LINEAR", &[0.0, 1.0], "SCALAR", &[0.0, 1.0]);
    let moved = document.floats("VEC3", &[0.0, 0.0, 6.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    document.primitive()["targets"] = json!([{"POSITION": moved}]);
    assert_eq!(origin(&document, 0.5).z, 3.0);
}

#[test]
fn meshes_are_as_large_when_a_node_vanishes() {
    let values = [1.0, 1.0, 1.0, 0.0, 0.0, 0.0, -1.0, 1.0, 1.0];
    let shrinking = animated("scale", "LINEAR", &[0.0, 1.0, 2.0], "VEC3", &values);
    let [whole, gone, mirrored] = [0.0, 1.0, 2.0].map(|time| at(&shrinking, time));
    for other in [&gone, &mirrored] {
        assert_eq!(whole.positions_m.len(), other.positions_m.len());
        assert_eq!(whole.triangles.len(), other.triangles.len());
    }
    assert!(gone.positions_m.iter().all(|position| *position == Vec3::ZERO));
    // Fronts stay fronts under a mirror.
    assert_eq!(mirrored.triangles[0], [0, 2, 1]);
}

#[test]
fn channels_that_name_nothing_or_hold_no_numbers_are_errors() {
    let good = animated("translation", "LINEAR", &[0.0, 1.0], "VEC3", &[0.0; 6]);
    let wrong = |change: &dyn Fn(&mut Document)| {
        let mut document = good.clone();
        change(&mut document);
        let all = opened(&document).and_then(|file| file.at(Some(0), 0.5));
        all.unwrap_err().to_string()
    };
    let channel = |document: &mut Document, key: &str, value: serde_json::Value| {
        document.json["animations"][0]["channels"][0][key] = value;
    };
    assert!(wrong(&|document| channel(document, "sampler", json!(7))).contains("sampler"));
    let other = json!({"node": 9, "path": "translation"});
    assert!(wrong(&|document| channel(document, "target", other.clone())).contains("node 9"));
    let bent = json!({"node": 0, "path": "weights"});
    assert!(wrong(&|document| channel(document, "target", bent.clone())).contains("morph targets"));
    assert!(
        wrong(&|document| document.json["nodes"][0]["matrix"] = json!(glam::Mat4::IDENTITY.to_cols_array()))
            .contains("matrix")
    );
    let few = animated("translation", "CUBICSPLINE", &[0.0, 1.0], "VEC3", &[0.0; 6]);
    let error = opened(&few).unwrap().at(Some(0), 0.5).unwrap_err().to_string();
    assert!(error.contains("6 are needed"), "{error}");
    let endless = animated("translation", "LINEAR", &[0.0, 1.0], "VEC3", &[f32::INFINITY; 6]);
    let error = opened(&endless).unwrap().at(Some(0), 0.5).unwrap_err().to_string();
    assert!(error.contains("not finite"), "{error}");
}

#[test]
fn bakes_of_files_that_move_are_what_they_were() {
    let moving = animated("translation", "LINEAR", &[0.0, 1.0], "VEC3", &[5.0; 6]);
    assert_eq!(moving.import_one().positions_m[0], Vec3::ZERO);
}
