//! Coplanar meshes share their light: a striped wall looks as one mesh does, and a wall between two floors parts them.

use std::collections::BTreeSet;

use glam::{DVec3, Vec3};
use lightkiln_tests::harness::{Held, Recipe, bake};
use lightkiln_tests::scenes::{
    self, BORDER_SHEET_M, CREST_M, FLOOR_BORDERS_M, PANELS_BORDER_M, PARTING_M, STRIP_M, STRIPE_BORDERS_M,
};
use lightkiln_worker::evaluate::{Evaluated, EvaluationError};
use lightkiln_worker::kinds::BakeKinds;
use lightkiln_worker::reference::{Lighting, Reference, luminance};
use lightkiln_worker::task::Progress;

use super::setup::{in_both_kinds, lamp_at, with_texels};

in_both_kinds!(
    floor_that_ends_beyond_a_wall_is_not_dark_there,
    light_is_continuous_across_stripes,
    light_is_not_shared_through_a_wall,
    panel_that_ends_behind_a_wall_is_not_dark_before_it,
);

const TEXEL_M: f32 = 0.1;
const PLASTER: [f32; 3] = [0.7, 0.69, 0.66];
/// Height of the striped wall.
const WALL_M: f32 = 2.5;
/// How far the upper ends of stripes lie to the right in the second scene.
const LEAN_M: f32 = 0.4;

/// Light that pictures show at points of the back wall.
fn shown(scene: Vec<u8>, recipe: &Recipe, points: &[[f32; 2]]) -> Vec<f64> {
    let rays: Vec<[Vec3; 2]> = points.iter().map(|&[x, y]| [Vec3::new(x, y, -1.6), Vec3::NEG_Z]).collect();
    shown_by_rays(scene, recipe, &rays)
}

/// Light that pictures show at the hits of rays from points along directions.
fn shown_by_rays(scene: Vec<u8>, recipe: &Recipe, rays: &[[Vec3; 2]]) -> Vec<f64> {
    let bake = bake(scene, recipe).unwrap();
    let bytes = |digest| {
        bake.chunk(digest).map_err(|error| EvaluationError::Missing { digest, source: error.into() })
    };
    let scene = bake.artefacts[&bake.scene].as_ref().clone();
    let progress = Progress::new();
    let evaluated: Box<dyn Evaluated> =
        BakeKinds::new().evaluated(&bake.manifest, scene, &bytes, &progress).unwrap();
    let geometry = evaluated.geometry();
    let lighting = Lighting { emitter_scale: 1.0, ..Lighting::default() };
    let reference = Reference::new(geometry, &lighting).unwrap();
    let relit = evaluated.relit(&reference, &lighting, &progress).unwrap();
    let at = |&[from_m, direction]: &[Vec3; 2]| {
        let hit = geometry.tracer.closest(from_m, direction, f32::INFINITY).unwrap();
        relit.shown_at(&hit).map_or(0.0, |light: DVec3| luminance(light))
    };
    rays.iter().map(at).collect()
}

/// Pairs of points 1 mm apart across every border of stripes that lean so far.
fn across_borders(lean_m: f32) -> Vec<[f32; 2]> {
    let heights = (0..60).map(|step| 0.05 + 0.04 * step as f32);
    let pairs = heights.flat_map(|y| {
        let x_m = move |border: f32| border + lean_m * y / WALL_M;
        STRIPE_BORDERS_M
            .into_iter()
            .flat_map(move |border| [[x_m(border) - 0.0005, y], [x_m(border) + 0.0005, y]])
    });
    pairs.collect()
}

fn light_is_continuous_across_stripes(kind: &'static str) {
    let recipe = with_texels(kind, TEXEL_M, 256);
    for lean_m in [0.0, LEAN_M] {
        let colours = [[0.6, 0.15, 0.1], PLASTER, [0.15, 0.2, 0.4]];
        let found = shown(scenes::striped_wall(&colours, lean_m), &recipe, &across_borders(lean_m));
        let mut jumps: Vec<f64> =
            found.chunks(2).map(|pair| (pair[0] - pair[1]).abs() / pair[0].max(pair[1])).collect();
        jumps.sort_by(f64::total_cmp);
        let (mean, most) = (jumps.iter().sum::<f64>() / jumps.len() as f64, jumps[jumps.len() - 1]);
        println!("{kind}, leaning {lean_m} m: mean jump {mean:.4}, largest {most:.4} of {}", jumps.len());
        assert!(found.iter().all(|light| *light > 0.1), "the wall is dark: the test shows nothing");
        assert!(
            mean < 0.005 && most < 0.02,
            "leaning {lean_m} m: jumps by {mean} in the mean, {most} at most"
        );
    }
    let points: Vec<[f32; 2]> =
        (0..2400).map(|i| [-0.8 + 0.0131 * (i % 120) as f32, 0.1 + 0.11 * (i / 120) as f32]).collect();
    let striped = shown(scenes::striped_wall(&[PLASTER], LEAN_M), &recipe, &points);
    let whole = shown(scenes::striped_wall(&[], LEAN_M), &recipe, &points);
    let mean = whole.iter().sum::<f64>() / whole.len() as f64;
    let squares = striped.iter().zip(&whole).map(|(one, other)| (one / other - 1.0).powi(2));
    let rms = (squares.sum::<f64>() / whole.len() as f64).sqrt();
    println!("{kind}: rms difference from one mesh {rms:.4}, mean light {mean:.3}");
    assert!(rms < 0.04, "the striped wall differs from the same in one piece by {rms}");
}

/// Guests gather light of their own where the neighbour's chart has another lattice.
#[test]
fn light_of_a_bent_neighbour_is_about_the_same_at_the_border() {
    let recipe = with_texels("prt", TEXEL_M, 256);
    let held = Held::new(scenes::bent_panel(), &recipe).unwrap();
    let lightmap = &held.world.lightmap;
    let own_guests = (0..).zip(&lightmap.receivers).filter(|(index, receiver)| {
        let block = &lightmap.blocks[receiver.block as usize];
        block.name.contains("panel") && lightmap.is_guest(*index) && receiver.light_of == *index
    });
    let count = own_guests.count();
    let heights = (0..60).map(|step| 0.1 + 0.03 * step as f32);
    let sides = |y| [[PANELS_BORDER_M - 0.0005, y], [PANELS_BORDER_M + 0.0005, y]];
    let found = shown(scenes::bent_panel(), &recipe, &heights.flat_map(sides).collect::<Vec<_>>());
    let jump = |pair: &[f64]| (pair[0] - pair[1]).abs() / pair[0].max(pair[1]);
    let mean = found.chunks(2).map(jump).sum::<f64>() / (found.len() / 2) as f64;
    println!("{count} guests with light of their own, mean jump {mean:.4}");
    assert!(count > 15, "{count} guests have light of their own: the lattices agree");
    assert!(found.iter().all(|light| *light > 0.1), "the panels are dark: the test shows nothing");
    assert!(mean < 0.03, "jumps by {mean} in the mean");
}

/// A strip between a border and the wall of a hollow, 1/20 texel wide, has the light of what it goes on in, whether that is of its
/// plane or falls away; the hollow has none of it.
#[test]
fn strip_between_a_border_and_a_hollow_is_lit_as_its_neighbour() {
    for drop_m in [0.0, 0.0015] {
        let along = |x_m: f32| (-5..=5).map(move |step| [x_m, 0.1 * step as f32]);
        let down = |[x, z]: [f32; 2]| [Vec3::new(x, 0.7, z), Vec3::NEG_Y];
        let columns =
            [CREST_M - 0.5 * STRIP_M, CREST_M + 0.5 * STRIP_M, CREST_M - 2.0 * STRIP_M, CREST_M - 0.05];
        let rays: Vec<[Vec3; 2]> = columns.into_iter().flat_map(along).map(down).collect();
        let scene = scenes::hollow_at_a_border(drop_m);
        let found = shown_by_rays(scene, &with_texels("prt", 0.125, 256), &rays);
        let [strip, beside, inside @ ..] = &found.chunks(11).collect::<Vec<_>>()[..] else { unreachable!() };
        println!("falling by {drop_m} m: {strip:.2?} beside {beside:.2?}, inside {inside:.4?}");
        assert!(beside.iter().all(|light| *light > 0.1), "the floor is dark: the test shows nothing");
        let jump = |(a, b): (&f64, &f64)| (a - b).abs() / a.max(*b);
        let jumps: Vec<f64> = strip.iter().zip(*beside).map(jump).collect();
        let most = jumps.iter().copied().fold(0.0, f64::max);
        assert!(most < 0.05, "falling by {drop_m} m: jumps by {most}");
        let leak = inside.concat().into_iter().fold(0.0, f64::max);
        assert!(leak < 1e-3 * beside[5], "falling by {drop_m} m: {leak} in the hollow");
    }
}

/// Behind a wall a panel ends beside a wall that goes on: what is seen of the texels there lies before the wall, and has none of the
/// light of the dark room behind it.
fn panel_that_ends_behind_a_wall_is_not_dark_before_it(kind: &'static str) {
    let rays: Vec<[Vec3; 2]> = [0.003, 0.01, 0.03, 0.1]
        .into_iter()
        .flat_map(|away_m| (1..=18).map(move |step| [PARTING_M + away_m, 0.1 * step as f32]))
        .map(|[x, y]| [Vec3::new(x, y, -1.6), Vec3::NEG_Z])
        .collect();
    let found = shown_by_rays(scenes::panel_through_a_wall(), &with_texels(kind, 0.125, 256), &rays);
    let columns: Vec<&[f64]> = found.chunks(18).collect();
    println!("{columns:.2?}");
    let [strips @ .., open] = &columns[..] else { unreachable!() };
    for strip in strips {
        assert!(strip.iter().zip(*open).all(|(at_wall, beside)| at_wall > &(0.5 * beside)));
    }
}

/// The floor of a dark room ends right beyond its wall: the strip there is lit as the floor that it goes on in.
fn floor_that_ends_beyond_a_wall_is_not_dark_there(kind: &'static str) {
    let rays: Vec<[Vec3; 2]> = [0.001, 0.01, 0.05]
        .into_iter()
        .flat_map(|away_m| (-8..=8).map(move |step| [BORDER_SHEET_M + away_m, 0.11 * step as f32]))
        .map(|[x, z]| [Vec3::new(x, 0.5, z), Vec3::NEG_Y])
        .collect();
    let found = shown_by_rays(scenes::floor_through_a_wall(), &with_texels(kind, 0.125, 256), &rays);
    let columns: Vec<&[f64]> = found.chunks(17).collect();
    println!("{columns:.2?}");
    let [strips @ .., open] = &columns[..] else { unreachable!() };
    for strip in strips {
        assert!(strip.iter().zip(*open).all(|(at_wall, beside)| at_wall > &(0.5 * beside)));
    }
}

fn light_is_not_shared_through_a_wall(kind: &'static str) {
    let held = Held::new(scenes::parted_floor(), &with_texels(kind, TEXEL_M, 128)).unwrap();
    let lightmap = &held.world.lightmap;
    let [_, wall_m, _] = FLOOR_BORDERS_M;
    // Planks 0 and 1 lie left of the wall.
    let left_blocks: BTreeSet<u32> = (0..)
        .zip(&lightmap.blocks)
        .filter(|(_, block)| block.name.contains("plank 0") || block.name.contains("plank 1"))
        .map(|(index, _)| index)
        .collect();
    assert_eq!(left_blocks.len(), 2);
    let on_floor = held.receivers(|r| r.normal.y > 0.9 && r.position_m.y.abs() < 0.01);
    let mut sharing = 0;
    for &index in &on_floor {
        let receiver = &lightmap.receivers[index as usize];
        if receiver.light_of != index {
            sharing += 1;
            let is_left = receiver.position_m.x < wall_m;
            assert_eq!(left_blocks.contains(&receiver.block), is_left, "{:?}", lightmap.name_of(index));
        }
    }
    assert!(sharing > 60, "{sharing} receivers share light: the test shows nothing");
    let lit = held.under(&lamp_at(Vec3::new(-1.0, 1.6, 0.3))).unwrap();
    let mean = |is_left: bool| {
        let chosen: Vec<u32> = on_floor
            .iter()
            .copied()
            .filter(|&index| left_blocks.contains(&lightmap.receivers[index as usize].block) == is_left)
            .collect();
        assert!(chosen.len() > 300);
        chosen.iter().map(|&index| luminance(lit.baked(index))).sum::<f64>() / chosen.len() as f64
    };
    let (bright, dark) = (mean(true), mean(false));
    println!("{kind}: {dark} right of the wall against {bright}; {sharing} receivers share light");
    assert!(bright > 0.1, "the lit side is dark: the test shows nothing");
    assert!(dark <= 1e-4 * bright, "{dark} right of the wall against {bright}");
}
