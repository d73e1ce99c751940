use glam::Vec3;
use lightkiln_proto::scene::LightKind;

use super::*;
use crate::scene::model::{Material, MeshInstance, Scene};
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
    assert!(camera.note.contains("inside") && camera.note.contains("fov=60\""), "{}", camera.note);
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

/// The taller box of the room, alone, with a LED of a share of its width behind it or, at −1, before it, which faces away from it
/// or is turned to it; and the camera's choice of a light. The box itself emits `glimmer`.
fn led(side: f32, share: f32, is_turned: bool, glimmer: f32) -> Framing {
    let mut scene = scene(CORNELL);
    scene.lights.clear();
    scene.cameras.clear();
    let glowing = scene.materials.iter().position(|material| material.emissive != [0.0; 3]).unwrap();
    scene.instances.retain(|instance| instance.path.contains("tall box"));
    let of_box = scene.instances[0].material_index as usize;
    scene.materials[of_box].emissive = [glimmer; 3];
    let [low, high] = scene.bounds_m();
    let size_m = share * (high.x - low.x);
    let at_m =
        Vec3::new(0.5 * (low.x + high.x), 0.5 * (low.y + high.y), if side > 0.0 { low.z } else { high.z });
    let (right, up) = (Vec3::X * (-size_m * side), Vec3::Y * size_m);
    let from_m = at_m - 0.5 * (right + up) - Vec3::Z * (0.01 * side);
    let led = MeshInstance {
        path: "led".into(),
        material_index: glowing as u32,
        positions_m: vec![from_m, from_m + right, from_m + up],
        normals: vec![Vec3::Z * -side; 3],
        uv0: Vec::new(),
        uv1: Vec::new(),
        colours: Vec::new(),
        triangles: vec![if is_turned { [0, 2, 1] } else { [0, 1, 2] }],
        world_from_object: scene.instances[0].world_from_object,
        lit_by: None,
    };
    scene.instances.push(led);
    framing(&Geometry::new(scene).unwrap())
}

#[test]
fn light_that_nothing_in_sight_has_counts_as_none_in_the_open() {
    let behind = led(1.0, 0.01, false, 0.0).light.expect("the LED shines away from the camera");
    assert!(matches!(behind.value.kind, LightKind::Sun { .. }), "{behind:?}");
    assert!(behind.note.contains("glows") && behind.note.contains("chose a sun"), "{}", behind.note);
    // A lamp in the picture does not light what is in it beside the lamp.
    assert!(led(-1.0, 0.6, false, 0.0).light.is_some(), "the camera looks at the light and at a black box");
    let mut glowing = scene(CORNELL);
    glowing.lights.clear();
    glowing.materials.iter_mut().for_each(|material| material.emissive = [1.0; 3]);
    assert!(
        framing(&Geometry::new(glowing).unwrap()).light.is_none(),
        "nothing is left that would need light"
    );
    // An emissive texture that is all but black there, as on a device with a display.
    assert!(led(1.0, 0.01, false, 1e-4).light.is_some(), "a glimmer is no light");
    // All of the box's front has the LED in sight, and next to no light by it.
    let faint = led(-1.0, 0.05, true, 0.0).light.expect("the LED lights a spot of the box");
    assert!(faint.note.contains("glows"), "{}", faint.note);
}

/// The taller box of the room, stretched, and how much of a picture of 4:3 its corners reach: 1 at the nearest edge.
fn reach_of_stretched(stretch: Vec3) -> (f32, Vec3) {
    let mut scene = scene(CORNELL);
    scene.lights.clear();
    scene.cameras.clear();
    scene.instances.retain(|instance| instance.path.contains("tall box"));
    for position in scene.instances.iter_mut().flat_map(|instance| &mut instance.positions_m) {
        *position *= stretch;
    }
    let geometry = Geometry::new(scene).unwrap();
    let camera = framing(&geometry).camera.unwrap().value;
    let [low, high] = geometry.bounds_m();
    let (eye, target) = (Vec3::from(camera.eye_m), Vec3::from(camera.target_m));
    let forward = (target - eye).normalize();
    let right = forward.cross(Vec3::Y).normalize();
    let tangent = (0.5 * camera.fov_y_rad).tan();
    let reach = (0..8).map(|corner: u32| {
        let share = Vec3::new((corner & 1) as f32, (corner >> 1 & 1) as f32, (corner >> 2) as f32);
        let to_corner = low + (high - low) * share - eye;
        let ahead = to_corner.dot(forward);
        assert!(ahead > 0.0, "{to_corner} lies behind the camera");
        let [x, y] = [right, right.cross(forward)].map(|axis| to_corner.dot(axis).abs() / (ahead * tangent));
        y.max(x / (4.0 / 3.0))
    });
    (reach.fold(0.0, f32::max), -forward)
}

#[test]
fn view_from_outside_is_filled_by_things_of_any_shape() {
    let shapes =
        [Vec3::ONE, Vec3::new(100.0, 0.1, 60.0), Vec3::new(0.1, 30.0, 0.1), Vec3::new(40.0, 1.0, 1.0)];
    for stretch in shapes {
        let (reach, _) = reach_of_stretched(stretch);
        assert!((0.8..1.0).contains(&reach), "{stretch}: its corners reach {reach} of the picture");
    }
    let steepness = |stretch| reach_of_stretched(stretch).1.y;
    assert!(
        steepness(Vec3::new(100.0, 0.1, 60.0)) > 1.5 * steepness(Vec3::ONE),
        "flat things are seen from above"
    );
}

/// Two rooms of 4 × 4 × 3 m beside each other, and a door of 1 × 2 m in the wall between.
fn rooms_with_a_door() -> Scene {
    let mut scene = Scene { materials: vec![Material::opaque("grey", [0.5; 3])], ..Scene::default() };
    scene.materials[0].double_sided = true;
    let mut wall = |corner: [f32; 3], u: [f32; 3], v: [f32; 3]| {
        let [corner, u, v] = [corner, u, v].map(Vec3::from);
        scene.instances.push(MeshInstance {
            path: format!("wall {corner} {u}"),
            positions_m: vec![corner, corner + u, corner + u + v, corner + v],
            normals: vec![u.cross(v).normalize(); 4],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..MeshInstance::default()
        });
    };
    wall([-4.0, 0.0, -2.0], [0.0, 0.0, 4.0], [8.0, 0.0, 0.0]);
    wall([-4.0, 3.0, -2.0], [8.0, 0.0, 0.0], [0.0, 0.0, 4.0]);
    for (corner, u) in [
        ([-4.0, 0.0, -2.0], [8.0, 0.0, 0.0]),
        ([-4.0, 0.0, 2.0], [8.0, 0.0, 0.0]),
        ([-4.0, 0.0, -2.0], [0.0, 0.0, 4.0]),
        ([4.0, 0.0, -2.0], [0.0, 0.0, 4.0]),
        ([-0.1, 0.0, -2.0], [0.0, 0.0, 1.2]),
        ([0.1, 0.0, -2.0], [0.0, 0.0, 1.2]),
        ([-0.1, 0.0, -0.8], [0.2, 0.0, 0.0]),
        ([-0.1, 0.0, 0.2], [0.2, 0.0, 0.0]),
        ([-0.1, 0.0, 0.2], [0.0, 0.0, 1.8]),
        ([0.1, 0.0, 0.2], [0.0, 0.0, 1.8]),
    ] {
        wall(corner, u, [0.0, 3.0, 0.0]);
    }
    wall([-0.1, 2.0, -0.8], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]);
    wall([0.1, 2.0, -0.8], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]);
    wall([-0.1, 2.0, -0.8], [0.0, 0.0, 1.0], [0.2, 0.0, 0.0]);
    scene
}

#[test]
fn objects_stand_in_the_open_beside_walls_and_in_doorways_where_they_fit() {
    let geometry = Geometry::new(rooms_with_a_door()).unwrap();
    let (places, notes) = standing_places(&geometry, [Vec3::new(-0.3, -0.5, -0.2), Vec3::new(0.3, 0.5, 0.2)]);
    let names: Vec<&str> = places.iter().map(|place| place.name).collect();
    assert_eq!(names, ["floor", "wall", "doorway"], "{notes:?}");
    let [open, wall, door] = [0, 1, 2].map(|index| Vec3::from(places[index].stance.position_m));
    assert!(places.iter().all(|place| (place.stance.position_m[1] - 0.502).abs() < 1e-4), "{places:?}");
    assert!(open.x.abs() > 1.0 && open.x.abs() < 3.0 && open.z.abs() < 1.2, "{open}");
    let to_wall = (4.0 - wall.x.abs()).min(2.0 - wall.z.abs()).min(wall.x.abs() - 0.1);
    assert!(
        (to_wall - 0.25).abs() < 1e-3,
        "its back, 20 cm behind its middle, is 5 cm before the wall: {wall}"
    );
    assert!(door.x.abs() < 0.15 && (door.z + 0.3).abs() < 0.01, "{door}");
    // A door is too narrow for a table.
    let (places, notes) = standing_places(&geometry, [Vec3::new(-0.7, 0.0, -0.6), Vec3::new(0.7, 0.8, 0.6)]);
    let names: Vec<&str> = places.iter().map(|place| place.name).collect();
    assert_eq!(names, ["floor", "wall"]);
    assert_eq!(notes, ["doorway: no doorway was found in which it fits"]);
    let (places, notes) = standing_places(&geometry, [Vec3::ZERO, Vec3::splat(5.0)]);
    assert!(places.is_empty() && notes.len() == 3, "{notes:?}");
}
