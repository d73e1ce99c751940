//! The reference and the sample, held against light that is computed in another way.

use glam::{DVec3, Vec3};
use lightkiln_proto::prt::Settings;
use lightkiln_proto::scene::{LightKind, SceneLight};
use rayon::prelude::*;
use serde_json::json;

use super::figures::{Figures, Pair};
use super::lights::default_lights;
use super::sample::{Sample, site_of};
use crate::prt::{Surface, World};
use crate::rays::sampling::{R2, seed_of};
use crate::reference::{Lighting, Precision, Reference};
use crate::task::Progress;

/// A scene of the tests, prepared with few receivers.
fn world(scene: &[u8], receivers: u32) -> World {
    let settings = json!({ "preset": "draft", "receivers_target": 5 * receivers });
    let settings = Settings::from_json(&settings).unwrap();
    World::rebuild(scene.to_vec(), &settings, &Progress::new()).unwrap()
}

const CORNELL: &[u8] = include_bytes!("../../../tests/scenes/cornell.glb");
const TWO_ROOMS: &[u8] = include_bytes!("../../../tests/scenes/two_rooms.glb");

/// Radiosity on texels: `E(r) = 1/N Σ ρ (E_dir + E)` over the receivers that N cosine-distributed rays meet; no probes.
fn radiosity(world: &World, direct: &[DVec3], rays: u32, bounces: usize) -> Vec<DVec3> {
    let receivers = &world.stage.receivers;
    let offset_m = world.geometry.tracer.ray_offset_m();
    let met: Vec<Vec<u32>> = (0..receivers.len() as u32)
        .into_par_iter()
        .map(|receiver| {
            let site = site_of(&world.stage, receiver);
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
    let reference = Reference::new(&world.scene, &world.images, &world.geometry, &lighting).unwrap();
    let direct: Vec<DVec3> = (0..world.stage.receivers.len() as u32)
        .into_par_iter()
        .map(|receiver| reference.direct_irradiance(&site_of(&world.stage, receiver), 1))
        .collect();
    let light = radiosity(&world, &direct, 256, 24);
    let sample = Sample::new(&world, 400);
    assert!(sample.receivers.len() > 300);
    let precision = Precision { rel_error: 0.03, paths_max: 4096 };
    let estimates = reference.irradiance(&sample.sites(&world.stage), &precision, &Progress::new()).unwrap();
    let pairs: Vec<Pair> = sample
        .receivers
        .iter()
        .zip(&estimates)
        .map(|(sampled, estimate)| Pair {
            area_m2: sampled.area_m2,
            found: light[sampled.receiver as usize],
            reference: estimate.indirect,
        })
        .collect();
    let figures = Figures::of(&pairs);
    assert!((figures.energy_ratio - 1.0).abs() < 0.015, "{figures:?}");
    assert!(figures.rel_rmse < 0.06, "{figures:?}");
    assert!(figures.channel_energy_ratios.iter().all(|ratio| (ratio - 1.0).abs() < 0.02), "{figures:?}");
}

#[test]
fn sample_holds_the_whole_area_and_weighs_surfaces_by_it() {
    let world = world(CORNELL, 2000);
    let sample = Sample::new(&world, 2000);
    let held: f64 = sample.receivers.iter().map(|sampled| sampled.area_m2).sum();
    assert!((held + sample.share_without * sample.area_m2 - sample.area_m2).abs() < 1e-6 * sample.area_m2);
    // The back wall, 5.5 m × 5.5 m.
    let on_back_wall = |receiver: u32| {
        let receiver = &world.stage.receivers[receiver as usize];
        receiver.normal.z > 0.99 && receiver.position_m.z < -5.49
    };
    let wall = sample.receivers.iter().filter(|sampled| on_back_wall(sampled.receiver));
    let wall_m2: f64 = wall.map(|sampled| sampled.area_m2).sum();
    assert!((wall_m2 / 30.25 - 1.0).abs() < 0.03, "{wall_m2}");
    // Walls, floor and ceiling, the boxes and the part of the floor below them: all but that part has receivers.
    assert!(sample.share_without < 0.04, "{}", sample.share_without);
}

#[test]
fn chosen_lights_are_the_same_for_every_bake_of_a_scene() {
    let coarse = default_lights(&world(CORNELL, 1000));
    let wanted = ["point", "spot", "panel", "sun", "sky-uniform", "sky-gradient", "emitters"];
    assert_eq!(coarse.lights.iter().map(|light| light.name.as_str()).collect::<Vec<_>>(), wanted);
    assert!(coarse.notes.is_empty(), "{:?}", coarse.notes);
    assert_eq!(coarse, default_lights(&world(CORNELL, 3000)));
}

#[test]
fn closed_scene_gets_neither_sun_nor_sky_and_says_so() {
    let world = world(TWO_ROOMS, 2000);
    let chosen = default_lights(&world);
    let outside = |name: &str| name == "sun" || name.starts_with("sky");
    assert!(chosen.lights.iter().all(|light| !outside(&light.name)), "{chosen:?}");
    assert!(
        chosen.lights.len() >= 3 && chosen.notes.iter().any(|note| note.contains("no opening")),
        "{chosen:?}"
    );
}
