//! Normal maps and specular reflection: by both backends alike, nothing where a material has none, and nothing lost in even light.

use std::sync::Arc;

use glam::{Vec3, Vec4};

use super::{prepared, surface_at, view_of};
use crate::bake::LoadedBake;
use crate::fixture;
use crate::kinds::field;
use crate::lights::parse_light;
use crate::passes::compare::Difference;
use crate::passes::shade;
use crate::passes::shadow::reference::draw;
use crate::preview::{Backend, SurfaceDetails, View, render};

/// Normal maps alone.
const MAPS: SurfaceDetails = SurfaceDetails { specular: false, ..ALL };
const ALL: SurfaceDetails = SurfaceDetails { normal_maps: true, specular: true };

fn bakes() -> Vec<LoadedBake> {
    vec![
        fixture::field_bake(true),
        fixture::field_bake(false),
        fixture::captured_bake(true),
        fixture::prt_bake(&fixture::prt_contents()),
    ]
}

fn drawn(bake: &LoadedBake, view: &View, details: SurfaceDetails, backend: Backend) -> Vec<Vec4> {
    let view = View { details, ..view.clone() };
    let linear = render(bake, &view, backend).unwrap().linear;
    linear.into_iter().map(|radiance| Vec3::from(radiance).extend(0.0)).collect()
}

fn lit_view(bake: &LoadedBake) -> View {
    let mut view = view_of(bake);
    let rectangle = "rect pos=3.2,2,3.2 target=1,0,1 size=0.8,0.5 power=30 points=4";
    view.lights.push(parse_light(rectangle).unwrap());
    View { samples: 1, ..view }
}

/// Pipelines of scenes without details hold no part of them.
#[test]
fn details_are_compiled_where_materials_have_them() {
    let of = |bake: &LoadedBake| shade::details_of(&bake.scene.manifest.materials).map(|(_, is_set)| is_set);
    for bake in bakes() {
        assert_eq!(of(&bake), [0.0, 0.0]);
        let mut bake = fixture::detailed(bake);
        assert_eq!(of(&bake), [1.0, 1.0]);
        for material in &mut Arc::make_mut(&mut bake.scene).manifest.materials {
            material.normal_map = None;
        }
        assert_eq!(of(&bake), [0.0, 1.0]);
    }
}

#[test]
fn materials_without_details_look_the_same_with_and_without_them() {
    for bake in bakes() {
        let view = View { samples: 1, ..view_of(&bake) };
        let [shown, left_out] =
            [ALL, SurfaceDetails::NONE].map(|details| drawn(&bake, &view, details, Backend::Cpu));
        assert!(shown == left_out && shown.iter().any(|radiance| radiance.x > 0.0));
    }
}

/// Pictures without maps, without reflection, and with a map upside down are told from those with all.
#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_draws_details_as_the_processor_does() {
    let tolerance = shade::TOLERANCE.max(field::TOLERANCE);
    for (index, bake) in bakes().into_iter().map(fixture::detailed).enumerate() {
        let view = lit_view(&bake);
        let got = drawn(&bake, &view, ALL, Backend::Gpu);
        let difference = Difference::of_mean(&got, &drawn(&bake, &view, ALL, Backend::Cpu), tolerance);
        println!("{}: {difference}", bake.scene.manifest.kind);
        assert!(difference.agrees(2.0 * shade::OUTLIERS), "{difference}");
        if index > 0 {
            continue;
        }
        let others = [MAPS, SurfaceDetails { normal_maps: false, ..ALL }]
            .map(|details| drawn(&bake, &view, details, Backend::Cpu));
        let turned = drawn(&flipped(&bake), &view, ALL, Backend::Cpu);
        for other in others.into_iter().chain([turned]) {
            let other = Difference::of_mean(&got, &other, tolerance);
            assert!(!other.agrees(10.0 * shade::OUTLIERS), "{other}");
        }
    }
}

/// The scene with the map's green channel turned round; its light is not looked at.
fn flipped(bake: &LoadedBake) -> LoadedBake {
    let mut scene = (*bake.scene).clone();
    let map = scene.manifest.materials[0].normal_map.as_ref().unwrap().texture.texture as usize;
    scene.textures[map] = fixture::waves(-1.0);
    let of_kind = |other: &LoadedBake| other.scene.manifest.kind == scene.manifest.kind;
    let light = bakes().into_iter().find(of_kind).unwrap().light;
    LoadedBake::new(scene, light)
}

/// Light that is the same from everywhere is the same on every slope; white surfaces send all of it back, metal or not.
#[test]
fn even_light_shows_neither_normal_maps_nor_metal() {
    for is_lattice in [true, false] {
        for bake in fixture::even_bakes(is_lattice, 2.0) {
            let mut bake = fixture::detailed(bake);
            let view = View { lights: Vec::new(), samples: 1, ..view_of(&bake) };
            let draw = |bake: &LoadedBake, details| drawn(bake, &view, details, Backend::Cpu);
            let wanted = draw(&bake, SurfaceDetails::NONE);
            let mapped = draw(&bake, MAPS);
            assert!(Difference::of_mean(&mapped, &wanted, 1e-5).agrees(0.0) || is_black(&wanted));
            for material in &mut Arc::make_mut(&mut bake.scene).manifest.materials {
                (material.base_colour, material.base_colour_texture) = ([1.0; 4], None);
            }
            let (white, reflecting) = (draw(&bake, SurfaceDetails::NONE), draw(&bake, ALL));
            assert!(Difference::of_mean(&reflecting, &white, 1e-4).agrees(0.0) || is_black(&white));
            // Uneven light is seen to be.
            let lamp =
                View { lights: vec![parse_light("point pos=1,1.2,1 power=20").unwrap()], ..view.clone() };
            let [mapped, plain] =
                [ALL, SurfaceDetails::NONE].map(|details| drawn(&bake, &lamp, details, Backend::Cpu));
            assert!(!Difference::of_mean(&mapped, &plain, 1e-2).agrees(0.1));
        }
    }
}

/// Without lamps a lightmap of the fixture is dark: its share of the field is tested below.
fn is_black(picture: &[Vec4]) -> bool {
    picture.iter().all(|radiance| radiance.truncate() == Vec3::ZERO)
}

/// Light of a lightmap is turned by the field's: not at all where that is even, within its bound elsewhere.
#[test]
fn lightmap_is_turned_as_the_field_says() {
    for is_lattice in [true, false] {
        let [even, _] = fixture::even_bakes(is_lattice, 2.0);
        for (bake, is_even) in [(even, true), (fixture::field_bake(is_lattice), false)] {
            let view = View {
                lights: vec![parse_light("sky zenith=1,1,1 horizon=0.2,0.2,0.2").unwrap()],
                ..view_of(&bake)
            };
            let prepared = prepared(&bake, &view);
            let maps = draw(&prepared.scene, &prepared.plan);
            let settled = bake.light.settle(&prepared.lit(&maps), &Default::default(), Default::default());
            let at = |towards: Vec3| {
                let mut surface = surface_at(Vec3::new(0.0, 1.2, 2.0), Vec3::X, 1);
                (surface.lightmap_texel, surface.lightmap_before) = ([3.4, 4.2], [3.4, 4.2]);
                surface.towards = towards;
                settled.indirect.indirect_irradiance(&surface)
            };
            let own = at(Vec3::X);
            let [up, down] = [0.5, -0.5].map(|y| at(Vec3::new(1.0, y, 0.0).normalize()));
            assert!(own.min_element() > 0.0);
            if is_even {
                assert!(
                    up.abs_diff_eq(own, 1e-5 * own.x) && down.abs_diff_eq(own, 1e-5 * own.x),
                    "{own} {up} {down}"
                );
            } else {
                // The box is open above.
                assert!(up.x > 1.05 * own.x && down.x < 0.95 * own.x, "{own} {up} {down}");
                assert!(up.max_element() <= 4.0 * own.max_element());
            }
        }
    }
}

/// No light comes from behind a surface, however its map bends it, and what comes along it fades.
#[test]
fn maps_let_no_light_through_from_behind() {
    let bake = fixture::prt_bake(&fixture::prt_contents());
    let bent = Vec3::new(0.0, 1.0, 1.0).normalize();
    let seen = |lamp: &str| {
        let view = View { lights: vec![parse_light(lamp).unwrap()], ..view_of(&bake) };
        let plan = prepared(&bake, &view).plan;
        let maps = draw(&bake.scene, &plan);
        let [plain, mapped] = [Vec3::Y, bent].map(|towards| {
            let surface = shade::Surface { towards, ..surface_at(Vec3::new(2.0, 1.5, 2.0), Vec3::Y, 0) };
            let gloss = shade::specular::Gloss::of(Vec3::ONE, [1.0, 0.5], towards, bent);
            shade::lamps::seen_light((&plan, &maps), &surface, surface.position, &gloss)
        });
        (plain.irradiance.x, mapped)
    };
    for lamp in ["point pos=2,1.2,3.5 power=20", "rect pos=2,0.6,3.5 dir=0,0,-1 size=0.4,0.4 power=20"] {
        let (plain, mapped) = seen(lamp);
        assert_eq!((plain, mapped), (0.0, shade::lamps::Seen::default()), "{lamp}");
    }
    let (plain, mapped) = seen("point pos=2,1.52,3.5 power=20");
    assert!(mapped.irradiance.x > plain && mapped.irradiance.x <= 8.01 * plain, "{plain} {mapped:?}");
    assert!(mapped.reflected.x > 0.0);
}
