//! The reference and the sample, held against light that is computed in another way.

use std::sync::Arc;

use glam::{DVec3, Vec2, Vec3};
use lightkiln_proto::content::{BlockKey, Texel};
use lightkiln_proto::kinds::SceneTasks;
use lightkiln_proto::kinds::prt::Settings;
use lightkiln_proto::scene::{LightKind, SceneLight};
use rayon::prelude::*;
use serde_json::json;

use super::*;
use crate::geometry::{Geometry, Site};
use crate::kinds::{BakeKinds, Runner};
use crate::lightmap::{Surface, World};
use crate::rays::Hit;
use crate::rays::sampling::{R2, seed_of};
use crate::reference::{Lighting, Precision, Reference};
use crate::scene::{Bundle, Limits, import};
use crate::task::{Cancelled, LocalRun, Progress};
use crate::vantage::vantage_points;

/// A scene of the tests, its lightmap placed with few receivers.
fn world(scene: &[u8], receivers: u32) -> Arc<World> {
    let settings = json!({ "preset": "draft", "receivers_target": 5 * receivers });
    let settings = Settings::from_json(&settings).unwrap();
    let progress = Progress::new();
    let mut run = LocalRun::new(1 << 30, &progress);
    let tasks =
        SceneTasks::of(run.shelf.put(scene.to_vec())).unwrapped(&settings.texels).placed(&settings.place);
    run.run(&Runner::new(&BakeKinds::new()), tasks.into_specs().collect(), |_| true, |_| {}).unwrap();
    World::of_run(&run).unwrap()
}

/// A sample of the receivers of a world.
fn sample_of(world: &World, count: u32) -> Sample {
    Sample::of_surfaces(&world.geometry, |hit| answer_of(world, hit), count)
}

fn answer_of(world: &World, hit: &Hit) -> Answer {
    match world.surface_at(hit) {
        Surface::Receiver(receiver) => Answer::Place(place_of(world, receiver)),
        Surface::Dark => Answer::TooSmall,
    }
}

fn place_of(world: &World, receiver: u32) -> Place {
    Place { site: world.lightmap.receivers[receiver as usize].site(), number: Some(receiver) }
}

/// A bake whose light is 1 where x is below 0, else 0.
struct Step(Arc<World>);

impl Evaluated for Step {
    fn geometry(&self) -> &Geometry {
        &self.0.geometry
    }
    fn answer_at(&self, hit: &Hit) -> Answer {
        answer_of(&self.0, hit)
    }
    fn lightmap(&self) -> Option<&dyn EvaluatedLightmap> {
        Some(self)
    }
    fn chunk_of(&self, _: &Place) -> Option<usize> {
        None
    }
    fn relit<'a>(
        &'a self,
        _: &Reference,
        _: &Lighting,
        _: &Progress,
    ) -> Result<Box<dyn Relit + 'a>, Cancelled> {
        Ok(Box::new(StepLight))
    }
}

impl EvaluatedLightmap for Step {
    fn texel_m(&self) -> f32 {
        self.0.lightmap.texel_m
    }
    fn receivers(&self) -> u32 {
        self.0.lightmap.receivers.len() as u32
    }
    fn receiver(&self, index: u32) -> Place {
        place_of(&self.0, index)
    }
    fn linked(&self, _: u32, _: [i32; 2]) -> Option<u32> {
        None
    }
    fn block_name(&self, _: BlockKey) -> &str {
        ""
    }
    fn texel_of(&self, place: &Place) -> Option<(BlockKey, Texel)> {
        Some(self.0.lightmap.name_of(place.number?))
    }
    fn place_of(&self, block: BlockKey, texel: Texel) -> Option<Place> {
        let receivers = 0..self.receivers();
        { receivers }
            .find(|&index| self.0.lightmap.name_of(index) == (block, texel))
            .map(|index| place_of(&self.0, index))
    }
    fn texel_at(&self, hit: &Hit) -> Option<(BlockKey, Vec2)> {
        self.0.lightmap_at(hit)
    }
}

struct StepLight;

impl Relit for StepLight {
    fn irradiance(&self, place: &Place) -> Option<DVec3> {
        Some(DVec3::splat(if place.site.position_m.x < 0.0 { 1.0 } else { 0.0 }))
    }
    fn bounces(&self) -> (usize, bool) {
        (1, true)
    }
}

#[test]
fn errors_are_expected_where_light_is_and_where_it_changes() {
    let bake = Step(world(CORNELL, 1000));
    let sample = sample_of(&bake.0, 300);
    let kind = LightKind::Point { position_m: [0.0, 3.0, 0.0], range_m: None };
    let lamp = SceneLight { name: "lamp".into(), kind, strength: [1.0; 3] };
    let lighting = Lighting { lights: vec![lamp], ..Lighting::default() };
    let light = lights::TestLight { name: "lamp".into(), words: String::new(), lighting };
    let expected = evaluator::expected_errors(&bake, &sample, &[light], &Progress::new()).unwrap();
    let area_m2: f64 = sample.places.iter().map(|sampled| sampled.area_m2).sum();
    let is_lit = |place: &Place| place.site.position_m.x < 0.0;
    let lit_m2: f64 =
        sample.places.iter().filter(|sampled| is_lit(&sampled.place)).map(|sampled| sampled.area_m2).sum();
    let mut met = [[0; 2]; 2];
    for (sampled, expected) in sample.places.iter().zip(expected) {
        let (block, [x, y]) = bake.texel_of(&sampled.place).unwrap();
        let steps = [(1, 0), (-1, 0), (0, 1), (0, -1)];
        let beside = steps.map(|(dx, dy)| {
            let texel = [x.wrapping_add_signed(dx), y.wrapping_add_signed(dy)];
            EvaluatedLightmap::place_of(&bake, block, texel)
        });
        let own = is_lit(&sampled.place);
        let changes = beside.iter().flatten().any(|place| is_lit(place) != own);
        let wanted = (f64::from(u8::from(own)) + 2.0 * f64::from(u8::from(changes))) * area_m2 / lit_m2;
        assert!((expected - wanted).abs() < 1e-9, "{expected} for {wanted}");
        met[usize::from(own)][usize::from(changes)] += 1;
    }
    assert!(met.iter().flatten().all(|&count| count > 5), "{met:?}");
}

const CORNELL: &[u8] = include_bytes!("../../../tests/scenes/cornell.glb");
const TWO_ROOMS: &[u8] = include_bytes!("../../../tests/scenes/two_rooms.glb");

/// Radiosity on texels: `E(r) = 1/N Σ ρ (E_dir + E)` over the receivers that N cosine-distributed rays meet; no probes.
fn radiosity(world: &World, direct: &[DVec3], rays: u32, bounces: usize) -> Vec<DVec3> {
    let receivers = &world.lightmap.receivers;
    let offset_m = world.geometry.tracer.ray_offset_m(Vec3::ZERO);
    let met: Vec<Vec<u32>> = (0..receivers.len() as u32)
        .into_par_iter()
        .map(|receiver| {
            let site = world.lightmap.receivers[receiver as usize].site();
            let points = R2::new(seed_of(&[u64::from(receiver), 99]));
            let meets = |ray| {
                let direction = site.direction(points.point(ray));
                let hit =
                    world.geometry.tracer.closest(site.ray_origin_m(offset_m), direction, f32::INFINITY)?;
                match world.surface_at(&hit) {
                    Surface::Receiver(other) => Some(other),
                    Surface::Dark => None,
                }
            };
            (0..rays).filter_map(meets).collect()
        })
        .collect();
    let mut light = vec![DVec3::ZERO; receivers.len()];
    for _ in 0..bounces {
        let leaving: Vec<DVec3> = receivers
            .iter()
            .zip(direct)
            .zip(&light)
            .map(|((receiver, direct), light)| Vec3::from(receiver.albedo).as_dvec3() * (*direct + *light))
            .collect();
        let gathered = |met: &Vec<u32>| met.iter().map(|&other| leaving[other as usize]).sum::<DVec3>();
        light = met.par_iter().map(|met| gathered(met) / f64::from(rays)).collect();
    }
    light
}

#[test]
fn radiosity_on_texels_agrees_with_the_path_tracer() {
    let world = world(CORNELL, 5000);
    let kind = LightKind::Point { position_m: [0.4, 3.0, -2.0], range_m: None };
    let lamp = SceneLight { name: "lamp".into(), kind, strength: [10.0; 3] };
    let lighting = Lighting { lights: vec![lamp], ..Lighting::default() };
    let reference = Reference::new(&world.geometry, &lighting).unwrap();
    let direct: Vec<DVec3> = (0..world.lightmap.receivers.len() as u32)
        .into_par_iter()
        .map(|receiver| reference.direct_irradiance(&world.lightmap.receivers[receiver as usize].site(), 1))
        .collect();
    let light = radiosity(&world, &direct, 256, 24);
    let sample = sample_of(&world, 400);
    assert!(sample.places.len() > 300);
    let sites: Vec<Site> = sample.places.iter().map(|sampled| sampled.place.site).collect();
    let precision = Precision { rel_error: 0.03, paths_max: 4096 };
    let estimates = reference.irradiance(&sites, &precision, &Progress::new()).unwrap();
    let pairs: Vec<Pair> = sample
        .places
        .iter()
        .zip(&estimates)
        .map(|(sampled, estimate)| Pair {
            area_m2: sampled.area_m2,
            found: light[sampled.place.number.unwrap() as usize],
            reference: *estimate,
        })
        .collect();
    let (figures, _) = Figures::of(&pairs);
    assert!((figures.energy_ratio - 1.0).abs() < 0.015, "{figures:?}");
    assert!(figures.rel_rmse < 0.06, "{figures:?}");
    assert!(figures.channel_energy_ratios.iter().all(|ratio| (ratio - 1.0).abs() < 0.02), "{figures:?}");
}

#[test]
fn sample_holds_the_whole_area_and_weighs_surfaces_by_it() {
    let world = world(CORNELL, 2000);
    let sample = sample_of(&world, 2000);
    let held: f64 = sample.places.iter().map(|sampled| sampled.area_m2).sum();
    assert!((held + sample.share_without * sample.area_m2 - sample.area_m2).abs() < 1e-6 * sample.area_m2);
    // The back wall, 5.5 m × 5.5 m.
    let on_back_wall = |site: &Site| site.normal.z > 0.99 && site.position_m.z < -5.49;
    let wall = sample.places.iter().filter(|sampled| on_back_wall(&sampled.place.site));
    let wall_m2: f64 = wall.map(|sampled| sampled.area_m2).sum();
    assert!((wall_m2 / 30.25 - 1.0).abs() < 0.03, "{wall_m2}");
    // Walls, floor and ceiling, the boxes and the part of the floor below them: all but that part has receivers.
    assert!(sample.share_without < 0.04, "{}", sample.share_without);
}

#[test]
fn chosen_lights_hang_on_the_scene_alone() {
    let coarse = default_lights(&world(CORNELL, 1000).geometry);
    let wanted = ["point", "spot", "rect", "sun", "sky-uniform", "sky-gradient", "emitters"];
    assert_eq!(coarse.lights.iter().map(|light| light.name.as_str()).collect::<Vec<_>>(), wanted);
    assert!(coarse.notes.is_empty(), "{:?}", coarse.notes);
    assert_eq!(coarse, default_lights(&world(CORNELL, 3000).geometry));
}

#[test]
fn rectangle_hangs_in_a_room_though_more_space_is_free_outside() {
    let settings = Limits::default();
    let mut scene =
        import(&Bundle::from_bytes(CORNELL.to_vec(), &settings).unwrap(), &settings).unwrap().scene;
    let [low, high] = scene.bounds_m();
    // As backs, its walls' outsides would let no light stand before them.
    scene.materials.iter_mut().for_each(|material| material.double_sided = true);
    // All of it once more beside it, farther away than it is wide, and turned inside out: no room.
    let beside_m = Vec3::X * (2.2 * (high.x - low.x));
    let mut beside = scene.instances.clone();
    for instance in &mut beside {
        instance.path.push_str(" beside");
        instance.positions_m.iter_mut().for_each(|at_m| *at_m += beside_m);
        instance.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
    }
    scene.instances.extend(beside);
    let geometry = Geometry::new(scene).unwrap();
    let roomiest = vantage_points(&geometry)
        .into_iter()
        .max_by(|a, b| a.look.nearest_m.total_cmp(&b.look.nearest_m))
        .unwrap()
        .position_m;
    assert!(roomiest.x > high.x, "most space is free at {roomiest}, in the room: the test shows nothing");
    let rect = default_lights(&geometry).lights.into_iter().find(|light| light.name == "rect").unwrap();
    let LightKind::Rect { position_m, .. } = rect.lighting.lights[0].kind else { panic!("{rect:?}") };
    let centre_m = Vec3::from(position_m);
    assert!(centre_m.cmpgt(low).all() && centre_m.cmplt(high).all(), "{centre_m}");
}

#[test]
fn closed_scene_gets_neither_sun_nor_sky_and_says_so() {
    let world = world(TWO_ROOMS, 2000);
    let chosen = default_lights(&world.geometry);
    let outside = |name: &str| name == "sun" || name.starts_with("sky");
    assert!(chosen.lights.iter().all(|light| !outside(&light.name)), "{chosen:?}");
    assert!(
        chosen.lights.len() >= 3 && chosen.notes.iter().any(|note| note.contains("no opening")),
        "{chosen:?}"
    );
}

/// Direct light of a lamp of 10 W·sr⁻¹ that a client shows by some share of the unshadowed light.
struct ShownShare<F> {
    lamp_m: Vec3,
    share: F,
}

impl<F: Fn(&Site) -> f64 + Sync> MappedLight for ShownShare<F> {
    fn incoming(&self) -> Option<MappedIncoming> {
        None
    }

    fn at(&self, site: &Site) -> MappedPixel {
        let way = self.lamp_m - site.position_m;
        let unshadowed =
            DVec3::splat(10.0 * site.lamp_cosine(way.normalize()) / f64::from(way.length_squared()));
        MappedPixel { shown: unshadowed * (self.share)(site), unshadowed, filter_m: 0.02, coarse: 0.0 }
    }
}

#[test]
fn light_everywhere_leaks_into_shadows_no_light_is_acne_and_exact_light_is_neither() {
    let geometry = &world(CORNELL, 500).geometry;
    let lamp_m = Vec3::new(0.4, 3.0, -2.0);
    let kind = LightKind::Point { position_m: lamp_m.to_array(), range_m: None };
    let lamp = SceneLight { name: "lamp".into(), kind, strength: [10.0; 3] };
    let lighting = Lighting { lights: vec![lamp], ..Lighting::default() };
    let reference = Reference::new(geometry, &lighting).unwrap();
    let sites = crate::geometry::spread_sites(geometry, 500);
    let is_lit = |site: &Site| f64::from(u8::from(reference.direct_irradiance(site, 1).x > 0.0));
    // Lit ones stand for more area.
    let weighted: Vec<(Site, f64)> = sites.iter().map(|site| (*site, 0.5 + 2.0 * is_lit(site))).collect();
    let shares = |share: &(dyn Fn(&Site) -> f64 + Sync)| {
        DirectShares::of(&weighted, &ShownShare { lamp_m, share }, &reference).0
    };
    let total: f64 = weighted.iter().map(|(_, weight)| weight).sum();
    let lit = weighted.iter().map(|(site, weight)| weight * is_lit(site)).sum::<f64>() / total;
    assert!((0.3..0.95).contains(&lit), "{lit}");
    let [everywhere, nowhere, exact] = [shares(&|_| 1.0), shares(&|_| 0.0), shares(&is_lit)];
    assert!(
        everywhere.leak > 0.5 * (1.0 - lit) && everywhere.leak <= 1.0 - lit && everywhere.acne == 0.0,
        "{everywhere:?}"
    );
    assert!(nowhere.acne > 0.9 * lit && nowhere.acne <= lit && nowhere.leak == 0.0, "{nowhere:?}");
    assert_eq!((exact.leak, exact.acne, exact.pixels), (0.0, 0.0, sites.len()));
    assert!(exact.error.rel_rmse < 1e-3 && everywhere.error.rel_rmse > 0.1, "{exact:?} {everywhere:?}");
}
