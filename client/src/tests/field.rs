//! Light of a field on objects: by both backends alike, gone behind walls, and that of a surface where an object lies on it.

use glam::{Vec3, Vec4};
use lightkiln_proto::relight::Limit;

use super::objects::{cube_at, lamp_view, with_cube};
use super::{prepared, surface_at, view_of};
use crate::bake::LoadedBake;
use crate::fixture;
use crate::kinds::field;
use crate::lights::parse_light;
use crate::passes::compare::Difference;
use crate::passes::shade;
use crate::passes::shadow::reference::draw;
use crate::preview::{Backend, View, render};
use crate::scene::Stance;

/// The room under a lamp, and under the sky with its glowing sheet; each with an object that hangs in it.
fn views(is_lattice: bool) -> [(LoadedBake, View); 2] {
    let bake = || with_cube(fixture::field_bake(is_lattice), None);
    let (_, of_lamp) = lamp_view();
    let of_sky = view_of(&fixture::field_bake(is_lattice));
    let sky = vec![parse_light("sky zenith=0.2,0.4,0.9 horizon=0.6,0.6,0.6").unwrap()];
    [(bake(), of_lamp), (bake(), View { lights: sky, samples: 1, ..of_sky })]
}

fn drawn(bake: &LoadedBake, view: &View, objects: Vec<Stance>, backend: Backend) -> Vec<Vec4> {
    let view = View { objects, ..view.clone() };
    let linear = render(bake, &view, backend).unwrap().linear;
    linear.into_iter().map(|radiance| Vec3::from(radiance).extend(0.0)).collect()
}

#[test]
fn object_gets_light_that_bounces_and_surfaces_keep_theirs() {
    let (_, view) = lamp_view();
    for is_lattice in [true, false] {
        let with = with_cube(fixture::field_bake(is_lattice), None);
        let (plain, _) = lamp_view();
        let without = with_cube(plain, None);
        let objects = cube_at([2.0, 1.6, 2.6], 0.5);
        let [lit, unlit] = [&with, &without].map(|bake| drawn(bake, &view, objects.clone(), Backend::Cpu));
        let brighter = lit.iter().zip(&unlit).filter(|(lit, unlit)| lit.x > unlit.x + 1e-4).count();
        let same = lit.iter().zip(&unlit).filter(|(lit, unlit)| lit == unlit).count();
        println!("{brighter} pixels are brighter, {same} the same, of {}", lit.len());
        assert!(brighter > 100, "{brighter} pixels of the object have bounced light");
        assert_eq!(brighter + same, lit.len(), "no other pixel differs");
    }
}

/// Beside a wall, light on an object that faces as the wall does is near that of the wall.
#[test]
fn light_beside_a_wall_is_near_the_walls_own() {
    [true, false].into_iter().for_each(light_beside_a_wall);
}

fn light_beside_a_wall(is_lattice: bool) {
    let [(bake, view), _] = views(is_lattice);
    let (scene, light) = fixture::field_light(is_lattice);
    let prepared = prepared(&bake, &view);
    let maps = draw(&prepared.scene, &prepared.plan);
    let lit = prepared.lit(&maps);
    let settled = crate::bake::Light::settle(&light, &lit, &Default::default(), Limit::default());
    let object = scene.draws.draws.len() as u32;
    let at = |position: Vec3, normal: Vec3| {
        settled.indirect.indirect_irradiance(&surface_at(position, normal, object))
    };
    // Over the floor's middle, looking up, there is the light of the whole room; the floor itself has about as much.
    let floor = light.lightmap.settled(&lit, &Default::default(), Limit::default()).light;
    let slots = 0..light.lightmap.transport.receivers.len() as u32;
    let is_floor = |slot: &u32| {
        let place = light.lightmap.transport.receivers.position_m[*slot as usize];
        place.y < 0.01 && (place.x - 2.0).abs() < 0.6 && (place.z - 2.0).abs() < 0.6
    };
    let of_floor: Vec<f32> = slots.filter(is_floor).map(|slot| floor.indirect(slot).x).collect();
    let mean = of_floor.iter().sum::<f32>() / of_floor.len() as f32;
    let found = at(Vec3::new(2.0, 0.3, 2.0), Vec3::Y).x;
    println!("{found} beside {mean}");
    assert!((found / mean - 1.0).abs() < 0.45, "{found} beside the floor's {mean}");
    assert_eq!(at(Vec3::new(9.0, 1.0, 9.0), Vec3::Y), Vec3::ZERO, "no probe is there");
    assert_eq!(at(Vec3::new(-0.5, 1.0, 2.0), Vec3::X), Vec3::ZERO, "behind the wall");
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_lights_objects_by_the_field_as_the_processor_does() {
    for (bake, view) in [true, false].into_iter().flat_map(views) {
        for objects in
            [cube_at([2.0, 1.6, 2.6], 0.5), cube_at([1.0, 0.4, 1.0], 0.5), cube_at([3.6, 1.5, 2.0], 0.9)]
        {
            let [got, wanted] =
                [Backend::Gpu, Backend::Cpu].map(|backend| drawn(&bake, &view, objects.clone(), backend));
            let tolerance = shade::TOLERANCE.max(field::TOLERANCE);
            let difference = Difference::of_mean(&got, &wanted, tolerance);
            println!("{difference}");
            // Objects are a few hundredths of the picture.
            assert!(difference.agrees(0.25 * shade::OUTLIERS), "{difference}");
            let (plain, _) = lamp_view();
            let unlit = drawn(&with_cube(plain, None), &view, objects, Backend::Cpu);
            let other = Difference::of_mean(&got, &unlit, tolerance);
            assert!(!other.agrees(0.25 * shade::OUTLIERS), "the field's light is seen: {other}");
        }
    }
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_draws_captured_light_as_the_processor_does() {
    for is_lattice in [true, false] {
        let bake = fixture::captured_bake(is_lattice);
        let (_, view) = lamp_view();
        let [got, wanted] =
            [Backend::Gpu, Backend::Cpu].map(|backend| drawn(&bake, &view, Vec::new(), backend));
        let tolerance = shade::TOLERANCE.max(field::TOLERANCE);
        let difference = Difference::of_mean(&got, &wanted, tolerance);
        println!("{difference}");
        assert!(difference.agrees(shade::OUTLIERS), "{difference}");
        let (plain, _) = lamp_view();
        let relit = drawn(&plain, &view, Vec::new(), Backend::Cpu);
        let other = Difference::of_mean(&got, &relit, tolerance);
        assert!(!other.agrees(shade::OUTLIERS), "the light is the probes' own: {other}");
    }
}
