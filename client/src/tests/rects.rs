//! Rectangular lights: energy, edges of shadows, and what is behind.

use std::f32::consts::PI;

use glam::Vec3;
use lightkiln_proto::content::Draw;
use lightkiln_proto::rectangle::Rectangle;
use lightkiln_proto::scene::SceneLight;

use super::light::{shadows, sheet};
use crate::lights::{Caster, check_lights, parse_light};
use crate::passes::shadow::{MAX_SIDE, ShadowPlan, ShadowRoom};

/// Walls of a shut room of 4 × 3 × 4 m, their fronts inside: corner and sides of each.
fn walls() -> [[Vec3; 3]; 6] {
    let [x, y, z] = [Vec3::X * 4.0, Vec3::Y * 3.0, Vec3::Z * 4.0];
    [[Vec3::ZERO, z, x], [y, x, z], [Vec3::ZERO, x, y], [z, y, x], [Vec3::ZERO, y, z], [x, z, y]]
}

#[test]
fn all_light_of_a_rectangle_falls_on_the_walls_of_a_shut_room() {
    let draws: Vec<Draw> = walls().map(|[corner, u, v]| sheet(corner, u, v)).into();
    for words in [
        "rect pos=2,2.6,2 dir=0,-1,0 size=1,0.6 strength=5,5,5",
        "rect pos=1.1,1.4,1.9 dir=0.4,0.3,-1 size=0.3,1.6 strength=5,5,5 points=9",
        // All of it stands on a wall.
        "rect pos=0.002,1.5,2 dir=1,0,0 size=2,2 strength=5,5,5 points=1",
    ] {
        let lamp = shadows(&draws, words, [[0.0; 3], [4.0, 3.0, 4.0]], (512, None));
        let mut power_w = 0.0;
        for [corner, u, v] in walls() {
            let normal = u.cross(v).normalize();
            let area_m2 = u.length() * v.length();
            for index in 0..128 * 128 {
                let [s, t] = [index % 128, index / 128].map(|step| (step as f32 + 0.5) / 128.0);
                power_w += lamp.at(corner + u * s + v * t, normal) * area_m2 / (128.0 * 128.0);
            }
        }
        let rectangle = Rectangle::of(&parse_light(words).unwrap().kind).unwrap();
        // Φ = π L A.
        let wanted = PI * 5.0 * rectangle.area_m2();
        println!("{words}: {:.4} of its power", power_w / wanted);
        assert!((power_w / wanted - 1.0).abs() < 0.01, "{words}: {power_w} W, wanted {wanted}");
    }
}

/// Irradiance on the floor under a rectangle of 1 × 1 m and radiance 1 at 2 m, with a square of 0.8 × 0.8 m at 1 m between.
fn exact(at: Vec3) -> f32 {
    const SIDE: u32 = 64;
    let along = |step: u32| (step as f32 + 0.5) / SIDE as f32 - 0.5;
    let arriving = |index: u32| {
        let point = Vec3::new(along(index % SIDE), 2.0, along(index / SIDE));
        let between = at.lerp(point, 0.5);
        let is_hidden = between.x.abs() < 0.4 && between.z.abs() < 0.4;
        let way = point - at;
        let squared = way.length_squared();
        if is_hidden { 0.0 } else { way.y * way.y / (squared * squared) }
    };
    (0..SIDE * SIDE).map(arriving).sum::<f32>() / (SIDE * SIDE) as f32
}

#[test]
fn edges_of_shadows_are_as_wide_as_the_light_and_nearer_to_right_with_more_points() {
    let floor = sheet(Vec3::new(-3.0, 0.0, -3.0), Vec3::Z * 6.0, Vec3::X * 6.0);
    let between = sheet(Vec3::new(-0.4, 1.0, -0.4), Vec3::X * 0.8, Vec3::Z * 0.8);
    let error = |points: u32| {
        let words = format!("rect pos=0,2,0 dir=0,-1,0 size=1,1 strength=1,1,1 points={points}");
        let bounds_m = [[-3.0, 0.0, -3.0], [3.0, 2.0, 3.0]];
        let lamp = shadows(&[floor.clone(), between.clone()], &words, bounds_m, (512, None));
        let (mut squares, mut mean, mut bias) = (0.0, 0.0, 0.0);
        for index in 0..60 * 60 {
            let [x, z] = [index % 60, index / 60].map(|step| -2.0 + 4.0 * (step as f32 + 0.5) / 60.0);
            let at = Vec3::new(x, 0.0, z);
            let off = lamp.at(at, Vec3::Y) - exact(at);
            squares += off * off / 3600.0;
            mean += exact(at) / 3600.0;
            bias += off / 3600.0;
        }
        println!("{points} points: {:.4} of the mean, {:+.4} in all", squares.sqrt() / mean, bias / mean);
        (squares.sqrt() / mean, bias / mean)
    };
    let errors = [1, 4, 9, 16].map(error);
    assert!(errors.windows(2).all(|pair| pair[1].0 < 0.9 * pair[0].0), "{errors:?}");
    assert!(errors[1].0 < 0.2 && errors[3].0 < 0.08, "{errors:?}");
    assert!(errors[1..].iter().all(|(_, bias)| bias.abs() < 0.02), "{errors:?}");
}

#[test]
fn nothing_behind_a_rectangle_or_a_wall_is_lit() {
    let wall = sheet(Vec3::new(1.0, 0.0, -2.0), Vec3::Z * 4.0, Vec3::Y * 3.0);
    let floor = sheet(Vec3::new(-2.0, 0.0, -2.0), Vec3::Z * 4.0, Vec3::X * 6.0);
    let words = "rect pos=0,1,0 dir=1,0,0 size=1,1 strength=1,1,1";
    let lamp = shadows(&[wall, floor], words, [[-2.0, 0.0, -2.0], [4.0, 3.0, 2.0]], (512, None));
    for step in 0..400 {
        let (x, z) = (0.002 + 1.99 * (step % 20) as f32 / 20.0, -1.9 + 3.8 * (step / 20) as f32 / 20.0);
        assert_eq!(lamp.at(Vec3::new(-x, 0.0, z), Vec3::Y), 0.0, "behind it at {x}");
        assert_eq!(lamp.at(Vec3::new(1.0 + x, 0.0, z), Vec3::Y), 0.0, "behind the wall at {x}");
    }
    assert!(lamp.at(Vec3::new(0.5, 0.0, 0.0), Vec3::Y) > 0.1);
}

#[test]
fn cells_that_no_shadow_map_tells_of_are_dark_where_there_is_no_other() {
    let floor = [sheet(Vec3::new(-2.0, 0.0, -2.0), Vec3::Z * 4.0, Vec3::X * 6.0)];
    // The floor cuts it just above its middle.
    let at = |points: u32| {
        let words = format!("rect pos=0,-0.01,0 dir=1,0,0 size=1,1 strength=1,1,1 points={points}");
        let bounds_m = [[-2.0, -1.0, -2.0], [4.0, 3.0, 2.0]];
        shadows(&floor, &words, bounds_m, (512, None)).at(Vec3::new(0.5, 0.0, 0.0), Vec3::Y)
    };
    assert_eq!(at(1), 0.0);
    // Middles of the upper two of four stand above the floor. Lambert's formula: 0.34.
    assert!((at(4) - 0.34).abs() < 0.03, "{}", at(4));
}

#[test]
fn more_maps_than_there_can_be_and_rectangles_of_nothing_are_refused() {
    let rect = parse_light("rect pos=0,1,0 dir=0,-1,0 size=1,1 radiance=1 points=16").unwrap();
    let casters = Caster::of(&vec![rect.clone(); 4]);
    let error = ShadowRoom::for_lights(&casters, MAX_SIDE).unwrap_err().to_string();
    assert!(error.contains("320 shadow maps") && error.contains("points of rectangles"), "{error}");
    let three = ShadowRoom::for_lights(&casters[..3], MAX_SIDE).unwrap();
    assert_eq!((three.faces, three.side), (240, 512));
    let plan = ShadowPlan::within(&three, &casters[..3], [[0.0; 3], [1.0; 3]], None).unwrap();
    assert_eq!(plan.faces.len(), 240);
    let changed = |change: fn(&mut [f32; 2], &mut [f32; 3], &mut u32)| {
        let mut light: SceneLight = rect.clone();
        let lightkiln_proto::scene::LightKind::Rect { size_m, direction, points, .. } = &mut light.kind
        else {
            panic!("{light:?}");
        };
        change(size_m, direction, points);
        check_lights(&[light])
    };
    assert!(changed(|_, _, _| {}).is_ok());
    assert!(changed(|size_m, _, _| size_m[1] = 0.0).is_err());
    assert!(changed(|size_m, _, _| size_m[0] = f32::INFINITY).is_err());
    assert!(changed(|_, direction, _| *direction = [0.0; 3]).is_err());
    assert!(changed(|_, _, points| *points = 0).is_err());
    assert!(changed(|_, _, points| *points = u32::MAX).is_err());
}

#[test]
fn every_sun_has_cascades_and_their_light_adds_up() {
    let ground = [sheet(Vec3::new(-50.0, 0.0, -50.0), Vec3::Z * 100.0, Vec3::X * 100.0)];
    let suns = ["sun dir=0.3,-0.8,0.2 irradiance=1", "sun dir=-0.6,-0.5,0.1 irradiance=2"];
    let suns = suns.map(|words| parse_light(words).unwrap());
    let eye = crate::passes::shadow::Eye { position_m: Vec3::new(0.0, 1.6, 4.0), forward: Vec3::NEG_Z };
    let bounds_m = [[-50.0, 0.0, -50.0], [50.0, 3.0, 50.0]];
    let plan = ShadowPlan::new(&Caster::of(&suns), bounds_m, 512, Some(eye)).unwrap();
    assert_eq!(plan.lights.iter().map(|light| light.cascades).collect::<Vec<_>>(), [3, 3]);
    let of_two = |index: usize| plan.lights[index].first_cascade as usize;
    assert_eq!([of_two(0), of_two(1)], [plan.first_cascade, plan.first_cascade + 3]);
    let scene = super::light::scene_of(&ground);
    let maps = crate::passes::shadow::reference::draw(&scene, &plan);
    let wanted: f32 = suns
        .iter()
        .zip([1.0, 2.0])
        .map(|(sun, strength)| {
            let lightkiln_proto::scene::LightKind::Sun { direction } = sun.kind else { panic!("a sun") };
            strength * -Vec3::from(direction).y
        })
        .sum();
    for at in [Vec3::new(0.1, 0.0, 3.0), Vec3::new(1.0, 0.0, -6.0), Vec3::new(-20.0, 0.0, 11.0)] {
        let found = super::seen_irradiance((&plan, &maps), at, Vec3::Y).x;
        assert!((found - wanted).abs() < 1e-4, "{found}, wanted {wanted} at {at}");
    }
}
