use glam::Vec3;
use lightkiln_proto::scene::LightKind;

use super::*;
use crate::scene::model::Scene;
use crate::scene::{Bundle, Limits, import};

fn scene(bundle: &[u8]) -> Scene {
    let limits = Limits::default();
    import(&Bundle::from_bytes(bundle.to_vec(), &limits).unwrap(), &limits).unwrap().scene
}

const CORNELL: &[u8] = include_bytes!("../../../tests/scenes/cornell.glb");
const TWO_ROOMS: &[u8] = include_bytes!("../../../tests/scenes/two_rooms.glb");

#[test]
fn room_is_looked_at_from_inside_towards_lit_walls() {
    let mut scene = scene(CORNELL);
    scene.cameras.clear();
    let geometry = Geometry::new(scene).unwrap();
    let framing = framing(&geometry);
    let camera = framing.camera.unwrap();
    let [low, high] = geometry.bounds_m();
    let eye = Vec3::from(camera.value.eye_m);
    assert!(eye.cmpgt(low).all() && eye.cmplt(high).all(), "{camera:?}");
    assert!(camera.note.contains("inside"), "{}", camera.note);
    assert!(framing.light.is_none(), "its lamp is enough");
}

#[test]
fn closed_scene_without_light_gets_a_lamp_and_open_one_a_sun() {
    let mut closed = scene(TWO_ROOMS);
    closed.lights.clear();
    closed.materials.iter_mut().for_each(|material| material.emissive = [0.0; 3]);
    let lamp = framing(&Geometry::new(closed).unwrap()).light.unwrap();
    assert!(matches!(lamp.value.kind, LightKind::Point { .. }), "{lamp:?}");
    let mut open = scene(CORNELL);
    open.lights.clear();
    open.materials.iter_mut().for_each(|material| material.emissive = [0.0; 3]);
    let sun = framing(&Geometry::new(open).unwrap()).light.unwrap();
    assert!(matches!(sun.value.kind, LightKind::Sun { .. }), "{sun:?}");
}

#[test]
fn file_with_camera_and_light_is_left_as_it_is() {
    let scene = scene(CORNELL);
    assert!(!scene.cameras.is_empty());
    assert_eq!(framing(&Geometry::new(scene).unwrap()), Framing::default());
}

#[test]
fn double_sided_thing_is_looked_at_from_outside() {
    let mut thing = scene(TWO_ROOMS);
    thing.cameras.clear();
    thing.lights.clear();
    for material in &mut thing.materials {
        material.double_sided = true;
        material.emissive = [0.0; 3];
    }
    let room = framing(&Geometry::new(thing.clone()).unwrap()).camera.unwrap();
    assert!(room.note.contains("inside"), "{}", room.note);
    // Turned inside out, a room is a box that is solid to whoever made it.
    for triangle in thing.instances.iter_mut().flat_map(|instance| &mut instance.triangles) {
        triangle.swap(1, 2);
    }
    let framing = framing(&Geometry::new(thing).unwrap());
    let (camera, light) = (framing.camera.unwrap(), framing.light.unwrap());
    assert!(camera.note.contains("outside"), "{}", camera.note);
    // A lamp inside it would light nothing that is seen.
    assert!(matches!(light.value.kind, LightKind::Sun { .. }), "{light:?}");
}
