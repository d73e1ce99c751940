//! Objects that move: drawn alike by adapter and processor, dark where no light of a lamp comes, and in the way of light.

use std::sync::Arc;

use glam::{Vec3, Vec4};
use lightkiln_proto::content::Draw;
use lightkiln_proto::manifest::{Glass, Material};
use lightkiln_proto::relight::Limit;

use super::{fixture_light, fixture_view, prepared};
use crate::bake::LoadedBake;
use crate::frame::{Frame, FrameRoom};
use crate::lights::parse_light;
use crate::passes::compare::Difference;
use crate::passes::gpu::Gpu;
use crate::passes::shade;
use crate::passes::shadow::ShadowRoom;
use crate::passes::shadow::reference::draw;
use crate::preview::{Backend, View, render};
use crate::scene::{Object, Rigid, Stance};

/// A cube of side 1 about the origin, whose faces look outwards.
fn cube() -> Draw {
    let mut draw = Draw::default();
    for axis in 0..3 {
        for side in [-0.5_f32, 0.5] {
            let unit = |axis: usize| {
                Vec3::from_array(std::array::from_fn(|index| f32::from(u8::from(index == axis))))
            };
            let normal = unit(axis) * side.signum();
            let (u, v) = (unit((axis + 1) % 3), unit((axis + 2) % 3) * side.signum());
            let first = draw.position_m.len() as u32;
            for (s, t) in [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)] {
                draw.position_m.push((unit(axis) * side + u * s + v * t).into());
                draw.normal.push(normal.into());
            }
            draw.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
    }
    draw
}

fn material(glass: Option<Glass>) -> Material {
    Material {
        name: "cube".to_owned(),
        base_colour: [0.8, 0.3, 0.1, 0.5],
        base_colour_texture: None,
        emissive: [0.0; 3],
        emissive_texture: None,
        emitter: None,
        alpha_cutoff: None,
        glass,
        normal_map: None,
        specular: None,
        double_sided: false,
    }
}

pub(crate) fn with_cube(mut bake: LoadedBake, glass: Option<Glass>) -> LoadedBake {
    let shape = Arc::new(Rigid(vec![cube()]));
    let object =
        Object { name: "cube".to_owned(), materials: vec![material(glass)], textures: Vec::new(), shape };
    bake.add_object(object).unwrap();
    bake
}

/// The fixture's room under a lamp alone.
pub(crate) fn lamp_view() -> (LoadedBake, View) {
    let (bake, view) = fixture_view();
    let lights = vec![parse_light("point pos=1,1.2,1 power=20").unwrap()];
    (bake, View { lights, emitter_scale: vec![0.0], samples: 1, ..view })
}

pub(crate) fn cube_at(position_m: [f32; 3], scale: f32) -> Vec<Stance> {
    vec![Stance { position_m, scale, turn_deg: [30.0, 0.0, 0.0], ..Stance::default() }]
}

fn drawn(bake: &LoadedBake, view: &View, objects: Vec<Stance>, backend: Backend) -> Vec<Vec4> {
    let view = View { objects, ..view.clone() };
    let linear = render(bake, &view, backend).unwrap().linear;
    linear.into_iter().map(|radiance| Vec3::from(radiance).extend(0.0)).collect()
}

/// Pictures of a room that a light's own bounces alone fill: no light comes out of a shut box, and all is back without it.
#[test]
fn lamp_shut_in_a_box_lights_nothing_until_the_box_leaves() {
    let (bake, view) = lamp_view();
    let open = drawn(&bake, &view, Vec::new(), Backend::Cpu);
    let bake = with_cube(bake, None);
    let shut = drawn(&bake, &view, cube_at([1.0, 1.2, 1.0], 0.3), Backend::Cpu);
    assert!(shut.iter().all(|radiance| *radiance == Vec4::ZERO));
    // Far away, the room is as it was: bounds, and with them the shadow maps' near planes, are others.
    let away = drawn(&bake, &view, cube_at([40.0, 0.0, 0.0], 0.3), Backend::Cpu);
    let difference = Difference::of_mean(&away, &open, 0.02);
    assert!(difference.agrees(0.02), "{difference}");
    assert!(open.iter().any(|radiance| radiance.x > 0.0));
}

/// An object that a wall cuts in two stands on both sides of it: the half in the room shades the floor, and no light is other than finite.
/// One behind the wall is not there for a lamp inside.
#[test]
fn object_inside_a_wall_shows_its_half_and_one_behind_it_changes_nothing() {
    let (bake, view) = lamp_view();
    let open = drawn(&bake, &view, Vec::new(), Backend::Cpu);
    let bake = with_cube(bake, None);
    let differs = |objects: Vec<Stance>| {
        let picture = drawn(&bake, &view, objects, Backend::Cpu);
        assert!(picture.iter().all(|radiance| radiance.is_finite()));
        !Difference::of_mean(&picture, &open, 0.02).agrees(0.02)
    };
    assert!(differs(cube_at([1.0, 0.0, 1.0], 0.5)), "its upper half is seen");
    assert!(!differs(cube_at([1.0, -0.6, 1.0], 0.5)), "below the floor");
    assert!(!differs(cube_at([-0.6, 0.6, 1.0], 0.5)), "behind the wall");
}

/// A board before the lamp takes light from the floor, and with it the light that the floor sends to the rest of the room.
#[test]
fn shadow_of_an_object_reaches_the_bounced_light() {
    let (bake, view) = lamp_view();
    let bake = with_cube(bake, None);
    let (_, light) = fixture_light();
    let bounced = |objects: Vec<Stance>| {
        let view = View { objects, ..view.clone() };
        let prepared = prepared(&bake, &view);
        let maps = draw(&prepared.scene, &prepared.plan);
        let settled = light.settled(&prepared.lit(&maps), &Default::default(), view.limit).light;
        let slots = 0..light.transport.receivers.len() as u32;
        slots.map(|slot| f64::from(settled.indirect(slot).x)).sum::<f64>()
    };
    let [open, board] = [cube_at([40.0, 0.0, 0.0], 0.3), cube_at([1.0, 0.8, 1.0], 0.5)].map(bounced);
    assert!(board < 0.8 * open && board > 0.0, "{board} {open}");
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_draws_objects_as_the_processor_does() {
    let glass = Glass { blends: true, transmission: 0.0, transmission_texture: None };
    for glass in [None, Some(glass)] {
        let (bake, view) = lamp_view();
        let bake = with_cube(bake, glass);
        for objects in
            [cube_at([1.0, 0.4, 1.0], 0.5), cube_at([0.6, 0.5, 1.3], 0.3), cube_at([1.0, 0.0, 1.0], 0.5)]
        {
            let [got, wanted] =
                [Backend::Gpu, Backend::Cpu].map(|backend| drawn(&bake, &view, objects.clone(), backend));
            let difference = Difference::of_mean(&got, &wanted, shade::TOLERANCE);
            println!("{difference}");
            assert!(difference.agrees(2.0 * shade::OUTLIERS), "{difference}");
            let elsewhere = drawn(&bake, &view, cube_at([1.2, 0.4, 0.7], 0.5), Backend::Cpu);
            let other = Difference::of_mean(&got, &elsewhere, shade::TOLERANCE);
            assert!(!other.agrees(2.0 * shade::OUTLIERS), "the object is seen: {other}");
        }
    }
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_moves_objects_and_makes_nothing_for_it() {
    const LIMIT: Limit = Limit { bounces_max: 64, change_max: 1e-5 };
    let gpu = Gpu::open().unwrap();
    let (bake, view) = lamp_view();
    let bake = with_cube(bake, Some(Glass { blends: true, transmission: 0.2, transmission_texture: None }));
    let room = FrameRoom { size: [160, 120], shadows: ShadowRoom { lights: 4, faces: 16, side: 256 } };
    let frame = || {
        let mut frame = Frame::new(&gpu, &bake, room, view.camera.clone()).unwrap();
        frame.set_lights(&view.lights).unwrap();
        frame
    };
    let drawn = |frame: &mut Frame<'_>| {
        assert!(frame.settle(LIMIT).unwrap().1);
        frame.draw([0.0; 2]).unwrap();
        frame.read().unwrap()
    };
    let mut kept = frame();
    drawn(&mut kept);
    let (near, far) = (cube_at([1.0, 0.5, 1.0], 0.5), cube_at([6.0, 0.5, 1.0], 0.5));
    for objects in [near.clone(), far, near.clone(), Vec::new()] {
        let before = gpu.created();
        kept.set_objects(&objects).unwrap();
        assert!(kept.settle(LIMIT).unwrap().1);
        kept.draw([0.25, 0.0]).unwrap();
        assert_eq!(gpu.created(), before, "objects that move make nothing");
        let got = drawn(&mut kept);
        let mut anew = frame();
        anew.set_objects(&objects).unwrap();
        let difference = Difference::of_mean(&got, &drawn(&mut anew), 2e-3);
        assert!(difference.agrees(0.0), "{difference}");
    }
    let at_rest = drawn(&mut kept);
    let too_many = [near.clone(), near].concat();
    assert!(kept.set_objects(&too_many).unwrap_err().to_string().contains("1 objects"));
    assert_eq!(drawn(&mut kept), at_rest);
}
