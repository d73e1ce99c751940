//! The references against physics.

use std::sync::Arc;

use glam::{Vec3, Vec4};
use lightkiln_proto::content::{Draw, Geometry};
use lightkiln_proto::manifest::Manifest;
use lightkiln_proto::relight::{LightmapTexels, Transport};
use lightkiln_proto::scene::{LightKind, SceneLight};

use super::{fixture_light, fixture_view, prepared};
use crate::fixture::{ROOM, manifest, texture};
use crate::lights::{Caster, parse_light};
use crate::passes::atlas::reference::{sample, spread};
use crate::passes::direct::reference::{direct_irradiance, direct_texels};
use crate::passes::shadow::reference::{ShadowMaps, draw};
use crate::passes::shadow::{Eye, ShadowPlan};
use crate::preview::{Backend, View, render};
use crate::scene::LoadedScene;

/// A light of its own in the fixture, and its shadow maps.
pub(super) struct Lamp {
    pub(super) plan: ShadowPlan,
    pub(super) maps: ShadowMaps,
}

impl Lamp {
    fn new(light: &str) -> Self {
        let (bake, view) = fixture_view();
        let view = View { lights: vec![parse_light(light).unwrap()], ..view };
        let plan = prepared(&bake, &view).plan;
        let maps = draw(&bake.scene, &plan);
        Self { plan, maps }
    }

    pub(super) fn at(&self, position: Vec3, normal: Vec3) -> f32 {
        direct_irradiance(&self.plan, &self.maps, position, normal, normal).x
    }

    pub(super) fn seen_at(&self, position: Vec3, normal: Vec3) -> f32 {
        super::seen_irradiance((&self.plan, &self.maps), position, normal).x
    }
}

#[test]
fn point_light_falls_off_with_the_square_of_distance_and_the_cosine() {
    let lamp = Lamp::new("point pos=3.5,2.5,3.5 power=125.66371");
    let floor = |x: f32, z: f32| lamp.at(Vec3::new(x, 0.0, z), Vec3::Y);
    assert!((floor(3.5, 3.5) - 10.0 / 6.25).abs() < 1e-3, "{}", floor(3.5, 3.5));
    let distance2: f32 = 6.25 + 1.0;
    let wanted = 10.0 / distance2 * 2.5 / distance2.sqrt();
    assert!((floor(3.5, 2.5) - wanted).abs() < 1e-3, "{}", floor(3.5, 2.5));
}

#[test]
fn sheet_casts_a_shadow_with_holes_and_walls_cast_theirs() {
    let sun = Lamp::new("sun dir=0,-1,0 irradiance=2");
    let lit = sun.at(Vec3::new(0.3, 0.0, 3.7), Vec3::Y);
    assert!((lit - 2.0).abs() < 1e-4, "{lit}");
    // Straight below the sheet, whose holes let some light through.
    let below: Vec<f32> = (0..40)
        .flat_map(|i| (0..40).map(move |j| [i as f32 / 40.0, j as f32 / 40.0]))
        .map(|[u, v]| Vec3::new(1.4 + 1.1 * u, 0.0, 1.2 + 0.5 * u + 0.3 * v))
        .map(|position| sun.at(position, Vec3::Y))
        .collect();
    let dark = below.iter().filter(|e| **e < 0.01).count();
    let bright = below.iter().filter(|e| **e > 1.99).count();
    assert!(dark > below.len() / 2 && bright > 3, "{dark} dark, {bright} bright of {}", below.len());
    // Behind a wall there is nothing.
    let lamp = Lamp::new("point pos=2,1.5,2 power=100");
    assert_eq!(lamp.at(Vec3::new(-0.5, 1.0, 2.0), Vec3::X), 0.0);
}

#[test]
fn flat_surfaces_never_shadow_themselves() {
    let lights = [
        "point pos=2,2.9,2 power=10",
        "point pos=0.05,0.05,3.9 power=10",
        "spot pos=0.2,0.1,0.2 target=4,0,4 outer=80 power=10",
        "sun dir=0.7,-0.1,0.7 irradiance=1",
        "sun dir=0,-1,0.02 irradiance=1",
    ];
    for light in lights {
        // Without the sheet every floor point that the walls do not shade is fully lit.
        let (mut bake, view) = fixture_view();
        Arc::make_mut(&mut bake.scene).draws.draws.truncate(5);
        let view = View { lights: vec![parse_light(light).unwrap()], ..view };
        let plan = prepared(&bake, &view).plan;
        let maps = draw(&bake.scene, &plan);
        let mut open = maps.clone();
        open.depth.fill(0.0);
        // Nearer to a wall the filter may reach the wall itself, which a low light sees in front of the floor.
        let floor =
            (0..4000).map(|i| Vec3::new(0.1 + (i % 80) as f32 * 0.048, 0.0, 0.1 + (i / 80) as f32 * 0.076));
        let partial = floor.filter(|position| {
            let e = |maps| direct_irradiance(&plan, maps, *position, Vec3::Y, Vec3::Y).x;
            let share = e(&maps) / e(&open).max(1e-9);
            share > 0.0 && share < 0.999
        });
        let partial: Vec<Vec3> = partial.collect();
        // The sun from the side throws one straight edge per wall; acne would be everywhere.
        let edge = if light.starts_with("sun dir=0.7") { 160 } else { 0 };
        assert!(partial.len() <= edge, "{light}: {} such as {:?}", partial.len(), partial.first());
    }
}

/// A rectangle with its front on the side of `u × v`, outside any lightmap.
pub(super) fn sheet(corner: Vec3, u: Vec3, v: Vec3) -> Draw {
    Draw {
        position_m: [corner, corner + u, corner + u + v, corner + v].map(|at| at.to_array()).into(),
        normal: vec![u.cross(v).normalize().to_array(); 4],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Draw::default()
    }
}

/// A scene of nothing but these.
pub(super) fn scene_of(draws: &[Draw]) -> LoadedScene {
    let manifest = Manifest { lightmap: None, ..manifest("prt") };
    let geometry = Geometry { draws: draws.to_vec() };
    LoadedScene::assemble(manifest, vec![geometry], vec![texture()]).unwrap()
}

/// A scene of nothing but these, and the shadow maps of one light on it.
pub(super) fn shadows(
    draws: &[Draw],
    light: &str,
    bounds_m: [[f32; 3]; 2],
    (side, eye): (u32, Option<Eye>),
) -> Lamp {
    let scene = scene_of(draws);
    let plan = ShadowPlan::new(&Caster::of(&[parse_light(light).unwrap()]), bounds_m, side, eye).unwrap();
    let maps = draw(&scene, &plan);
    Lamp { plan, maps }
}

#[test]
fn far_ground_under_a_low_lamp_has_no_acne() {
    // Two triangles of 60 m, whose nearest corner is 600 times as near to the lamp's plane as their farthest.
    let ground = [sheet(Vec3::new(-30.0, 0.0, -30.0), Vec3::Z * 60.0, Vec3::X * 60.0)];
    for step in 0..12 {
        let (x, height, z) = (1.7 * step as f32 - 9.3, 1.1 + 0.37 * step as f32, 6.1 - 1.3 * step as f32);
        let light = format!("point pos={x},{height},{z} power=1000");
        let lamp = shadows(&ground, &light, [[-30.0, 0.0, -30.0], [30.0, 4.0, 30.0]], (2048, None));
        let dark = (0..40_000_u32).filter(|index| {
            let along = |step: u32| -29.5 + 59.0 * (step as f32 + 0.5) / 200.0;
            lamp.at(Vec3::new(along(index % 200), 0.0, along(index / 200)), Vec3::Y) <= 0.0
        });
        assert_eq!(dark.count(), 0, "{light}");
    }
}

#[test]
fn ground_far_beyond_the_maps_of_a_sun_is_in_no_shadow() {
    // A plain of 20 km, a wall on it, and maps of what is within 16 m.
    let plain = sheet(Vec3::new(-1e4, 0.0, -1e4), Vec3::Z * 2e4, Vec3::X * 2e4);
    let wall = sheet(Vec3::new(-2.0, 0.0, 0.0), Vec3::X * 4.0, Vec3::Y * 3.0);
    let bounds_m = [[-16.0, 0.0, -16.0], [16.0, 3.0, 16.0]];
    let sun = shadows(&[plain, wall], "sun dir=-0.3,-0.9,-0.5 irradiance=2", bounds_m, (256, None));
    for away_m in [20.0, 40.0, 300.0, 9000.0] {
        for [x, z] in [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0], [0.7, -0.7]] {
            let lit = sun.at(Vec3::new(x * away_m, 0.0, z * away_m), Vec3::Y);
            assert!(lit > 1.5, "{lit} at {away_m} m along {x}, {z}");
        }
    }
    assert_eq!(sun.at(Vec3::new(-0.3, 0.0, -0.6), Vec3::Y), 0.0, "the wall's shadow");
}

#[test]
fn no_light_passes_the_foot_or_the_corner_of_a_wall() {
    // A wall (z = 0) on a floor that ends there, or goes on beyond, lit; and a fin (x = 0) that stands on both.
    let room = |floor_beyond_m: f32| {
        let floor = Vec3::new(-3.0, 0.0, -floor_beyond_m);
        [
            sheet(Vec3::new(-3.0, 0.0, 0.0), Vec3::X * 6.0, Vec3::Y * 4.0),
            sheet(floor, Vec3::Z * (3.0 + floor_beyond_m), Vec3::X * 6.0),
            sheet(Vec3::ZERO, Vec3::Y * 4.0, Vec3::Z * 2.0),
        ]
    };
    for angle in 0..96 {
        let draws = room(if angle < 48 { 0.0 } else { 2.0 });
        // From behind the wall, so that the wall shades all that is near it on this side.
        let (turn, height) = (-0.1 - 0.17 * (angle % 8) as f32, 0.3 + 0.2 * (angle % 48 / 8) as f32);
        let direction =
            Vec3::new(height.cos() * turn.sin(), -height.sin(), height.cos() * turn.cos()).normalize();
        let words = format!("sun dir={},{},{} irradiance=1", direction.x, direction.y, direction.z);
        let sun = shadows(&draws, &words, [[-3.0, 0.0, 0.0], [3.0, 4.0, 3.0]], (1024, None));
        let eye = Eye { position_m: Vec3::new(0.8, 1.5, 1.2), forward: Vec3::new(-0.6, -0.48, -0.64) };
        let wide = shadows(&draws, &words, [[-9.0, 0.0, -9.0], [9.0, 4.0, 9.0]], (1024, Some(eye)));
        assert!(wide.plan.lights[0].cascades > 0, "{:?}", wide.plan.lights);
        for index in 0..400 {
            let away_m = 2e-4 * 1.35_f32.powi(index % 20);
            let along = 0.4 + 0.07 * (index / 20) as f32;
            for (position, normal) in
                [(Vec3::new(0.0, along, away_m), Vec3::X), (Vec3::new(along, 0.0, away_m), Vec3::Y)]
            {
                assert_eq!(sun.at(position, normal), 0.0, "{position} under a sun along {direction}");
                // Depth is three times as coarse in bounds three times as wide.
                let seen = if away_m > 6e-4 { wide.seen_at(position, normal) } else { 0.0 };
                assert_eq!(seen, 0.0, "{position} under a sun along {direction}");
            }
        }
    }
}

#[test]
fn cascades_show_a_fence_near_the_eye_on_wide_ground() {
    // Bars of 5 cm every 10 cm along x, and 200 m of ground.
    let bars = (-40..40).map(|bar| sheet(Vec3::new(0.1 * bar as f32, 0.0, 0.0), Vec3::X * 0.05, Vec3::Y));
    let ground = sheet(Vec3::new(-100.0, 0.0, -100.0), Vec3::Z * 200.0, Vec3::X * 200.0);
    let draws: Vec<Draw> = bars.chain([ground]).collect();
    let direction = Vec3::new(0.3, -0.6, 0.8).normalize();
    let words = format!("sun dir={},{},{} irradiance=1", direction.x, direction.y, direction.z);
    let eye = Eye { position_m: Vec3::new(0.0, 1.0, 1.5), forward: Vec3::new(0.0, -0.6, -0.8) };
    let sun = shadows(&draws, &words, [[-100.0, 0.0, -100.0], [100.0, 1.0, 100.0]], (1024, Some(eye)));
    let mut off = [0.0, 0.0];
    for index in 0..2000 {
        let (x, z) = (-1.0 + 0.001 * index as f32, 0.2 + 0.3 * (index % 17) as f32 / 17.0);
        let at_fence = x - direction.x / direction.z * z;
        let wanted = if (at_fence / 0.1).rem_euclid(1.0) < 0.5 { 0.0 } else { -direction.y };
        let at = Vec3::new(x, 0.0, z);
        for (off, found) in off.iter_mut().zip([sun.seen_at(at, Vec3::Y), sun.at(at, Vec3::Y)]) {
            *off += (found - wanted).abs() / -direction.y / 2000.0;
        }
    }
    assert!(off[0] < 0.12 && off[1] > 0.35, "{off:?}");
    // Open ground is lit on both sides of every cascade's rim.
    for index in 0..20_000 {
        let (x, z) = (-60.0 + 0.006 * index as f32, 3.0 + 0.9 * (index % 61) as f32);
        let found = sun.seen_at(Vec3::new(x, 0.0, z), Vec3::Y);
        assert!((found + direction.y).abs() < 1e-4, "{x} {z}: {found}");
    }
}

#[test]
fn narrow_facets_before_the_void_stay_lit() {
    // A slab of 6 mm whose top and front the sun lights, with nothing behind it; texels of the map are wider.
    let thick = Vec3::NEG_Z * 0.006;
    let slab = [
        sheet(Vec3::ZERO, Vec3::X * 2.0, Vec3::Y * 2.0),
        sheet(Vec3::Y * 2.0, Vec3::X * 2.0, thick),
        sheet(thick, Vec3::Y * 2.0, Vec3::X * 2.0),
    ];
    for angle in 0..12 {
        let height = 0.2 + 0.1 * angle as f32;
        let light = format!("sun dir=0.3,{},{} irradiance=1", -height.sin(), -height.cos());
        let sun = shadows(&slab, &light, [[0.0; 3], [2.0; 3]], (512, None));
        for index in 0..200 {
            let (x, z) = (0.1 + 0.009 * index as f32, -0.0005 - 0.005 * (index % 7) as f32 / 6.0);
            assert!(sun.at(Vec3::new(x, 2.0, z), Vec3::Y) > 0.0, "{x} {z} under {light}");
        }
    }
}

#[test]
fn sky_alone_settles_soon_and_lights_the_open_floor() {
    let (bake, view) = fixture_view();
    let sky = parse_light("sky zenith=1,1,1 horizon=1,1,1 strength=2").unwrap();
    let view = View { lights: vec![sky], emitter_scale: vec![0.0], ..view };
    let picture = render(&bake, &view, Backend::Cpu).unwrap();
    assert!(picture.converged && picture.bounces < 60, "{}", picture.bounces);
    assert!(picture.linear.iter().all(|pixel| pixel[1] > 0.0));
}

#[test]
fn no_light_gives_a_black_picture_and_settles_at_once() {
    let (bake, view) = fixture_view();
    let view = View { lights: Vec::new(), emitter_scale: vec![0.0], ..view };
    let picture = render(&bake, &view, Backend::Cpu).unwrap();
    assert!(picture.linear.iter().flatten().all(|value| *value == 0.0));
    assert_eq!(picture.bounces, 1);
}

#[test]
fn atlas_reads_at_chart_edges_are_never_dark() {
    let (scene, light) = fixture_light();
    let lit = vec![Vec4::ONE; light.transport.receivers.len()];
    let black = vec![Vec4::ZERO; lit.len()];
    let atlas = spread(&scene.lightmap, &light.texels, &lit, &black);
    for block in 0..scene.lightmap.blocks.len() as u32 {
        for step in 0..=160 {
            let at = step as f32 * 0.05;
            for texel in [[at, 0.0], [0.0, at], [at, at], [8.0, at]] {
                let read = sample(&scene.lightmap, &atlas, block, texel);
                assert!((read - Vec3::ONE).length() < 1e-5, "block {block} at {texel:?}: {read}");
            }
        }
    }
}

#[test]
fn spot_cone_and_range_end_where_they_should() {
    let spot = SceneLight {
        name: String::new(),
        kind: LightKind::Spot {
            position_m: [2.0, 2.0, 2.0],
            direction: [0.0, -1.0, 0.0],
            inner_rad: 0.2,
            outer_rad: 0.4,
            range_m: Some(2.5),
        },
        strength: [4.0; 3],
    };
    let (bake, _) = fixture_view();
    let plan = ShadowPlan::new(&Caster::of(&[spot]), [[0.0; 3], ROOM.into()], 512, None).unwrap();
    let mut maps = draw(&bake.scene, &plan);
    maps.depth.fill(0.0);
    let at = |x: f32, y: f32| direct_irradiance(&plan, &maps, Vec3::new(x, y, 2.0), Vec3::Y, Vec3::Y).x;
    let window = 1.0 - (1.0_f32 / 2.5).powi(4);
    assert!((at(2.0, 1.0) - 4.0 * window).abs() < 1e-3, "{}", at(2.0, 1.0));
    assert_eq!(at(2.0 + 0.43, 1.0), 0.0);
    assert_eq!(at(2.0, -0.6), 0.0);
}

#[test]
fn direct_light_of_a_texel_is_the_mean_over_the_points_of_its_coverage() {
    let (bake, view) = fixture_view();
    let prepared = prepared(&bake, &view);
    let maps = draw(&bake.scene, &prepared.plan);
    let (_, light) = fixture_light();
    let receivers = &light.transport.receivers;
    let found = direct_texels(receivers, &light.points, &Default::default(), &prepared.plan, &maps);
    let (mut in_half_shadow, mut off) = (0, 0.0_f32);
    for (slot, found) in found.iter().enumerate() {
        let own = (receivers.position_m[slot].truncate(), receivers.normal[slot].truncate());
        let texel = light.points.of(slot, own.0);
        assert_eq!(texel.len() as u32, receivers.coverage[slot].count_ones(), "slot {slot}");
        let points = (0..texel.len()).map(|point| texel.point(point));
        let at = |(position, normal): (Vec3, Vec3)| {
            direct_irradiance(&prepared.plan, &maps, position, normal, normal)
        };
        let each: Vec<Vec3> = if texel.is_empty() { vec![at(own)] } else { points.map(at).collect() };
        let mean = each.iter().sum::<Vec3>() / each.len() as f32;
        off = off.max((found.truncate() - mean).abs().max_element());
        let bounds = each.iter().fold((f32::INFINITY, 0.0_f32), |(a, b), e| (a.min(e.x), b.max(e.x)));
        in_half_shadow += u32::from(bounds.0 == 0.0 && bounds.1 > 0.0);
    }
    let brightest = found.iter().map(|e| e.max_element()).fold(0.0, f32::max);
    assert!(in_half_shadow > 4, "{in_half_shadow}");
    // Where the first points agree, the others are not asked.
    assert!(off < 0.1 * brightest, "{off} of {brightest}");
}

#[test]
fn points_of_a_texel_are_those_of_its_coverage_on_the_mesh() {
    let (_, light) = fixture_light();
    let receivers = &light.transport.receivers;
    let of = |bits: u16| receivers.coverage.iter().position(|coverage| *coverage == bits).unwrap();
    for (bits, wanted) in [(0x00FF, 8), (u16::MAX, 16), (0, 0)] {
        let slot = of(bits);
        let centre = receivers.position_m[slot].truncate();
        let texel = light.points.of(slot, centre);
        assert_eq!(texel.len(), wanted);
        let offsets: Vec<Vec3> = (0..wanted).map(|point| texel.point(point).0 - centre).collect();
        let (sum, normal) = (offsets.iter().sum::<Vec3>(), receivers.normal[slot].truncate());
        assert!(offsets.iter().all(|offset| offset.dot(normal).abs() < 1e-4));
        // Half a texel's points have their middle a quarter of it aside; the fixture's are a seventh of a room long at most.
        assert_eq!(sum.length() > 0.1, bits == 0x00FF, "{bits:#x}: {sum}");
    }
}

#[test]
fn picture_does_not_interpolate_across_a_wall_that_stands_on_the_floor() {
    let (scene, light) = fixture_light();
    // The floor's right half is lit; between columns 3 and 4 the fixture has no links.
    let (floor, slots) = (&light.transport.clusters.clusters[0], &light.transport.slots);
    let block = scene.lightmap.block_index(100).unwrap();
    let mut lit = vec![Vec4::ZERO; light.transport.receivers.len()];
    for (y, x) in (0..8).flat_map(|y| (4..8).map(move |x| (y, x))) {
        if let Some(slot) = slots.slot(block, [x, y]) {
            assert!((slot as usize) < floor.row_count);
            lit[slot as usize] = Vec4::ONE;
        }
    }
    let atlas = spread(&scene.lightmap, &light.texels, &lit, &vec![Vec4::ZERO; lit.len()]);
    for step in 1..160 {
        // On the border of two rows either's edge may count.
        let at = (step as f32 - 0.5) * 0.05;
        let read = |x: f32| sample(&scene.lightmap, &atlas, block, [x, at]).x;
        // In row 6 the wall leans over column 3.
        let is_cut = (6.01..6.99).contains(&at);
        let near = read(3.95);
        assert!(if is_cut { near > 0.999 } else { near < 1e-5 }, "at {at}: {near}");
        assert!(read(3.45) < 1e-5, "at {at}: {}", read(3.45));
        // Near the floor's hole, column 4 has no receiver to be nearest.
        if !(3.5..=5.5).contains(&at) {
            assert!(read(4.05) > 0.999 && read(4.4) > 0.999, "at {at}: {} {}", read(4.05), read(4.4));
        }
    }
}

#[test]
fn pages_show_the_same_light_as_the_texels_that_evaluation_reads() {
    let (scene, light) = fixture_light();
    let Transport { slots, receivers, .. } = &light.transport;
    let of_slot = |slot: u32| Vec4::new(1.0 + (slot % 7) as f32, 0.1 * slot as f32, 2.0, 0.0);
    let lit: Vec<Vec4> = (0..receivers.len() as u32).map(of_slot).collect();
    let pages = spread(&scene.lightmap, &light.texels, &lit, &vec![Vec4::ZERO; lit.len()]);
    let texels = LightmapTexels { slots, receivers };
    for (index, block) in scene.lightmap.blocks.iter().enumerate() {
        let block_index = index as u32;
        for step in 0..400_u16 {
            let along = |axis: usize, step: u16| (f32::from(step) + 0.37) / 20.0 * block.size[axis] as f32;
            let place = [along(0, step % 20), along(1, step / 20)];
            let shown = texels.shown(block_index, place, of_slot).unwrap_or(Vec4::ZERO).truncate();
            assert_eq!(sample(&scene.lightmap, &pages, block_index, place), shown, "{index} {place:?}");
        }
    }
}
