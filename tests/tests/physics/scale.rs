//! Scale is a matter of course: the same room in any unit is the same bake, and what is far takes nothing from what is near.

use std::sync::Arc;

use glam::Vec3;
use lightkiln_proto::kinds::Kinds;
use lightkiln_tests::scenes;
use lightkiln_worker::kinds::{BakeKinds, Runner};
use lightkiln_worker::lightmap::{Receiver, World};
use lightkiln_worker::task::{LocalRun, Progress};
use serde_json::json;

const TARGET: u32 = 6000;

/// Receivers that the tasks before transport find, and how many tasks of transport there are to be.
fn placed(kind: &str, bundle: Vec<u8>) -> (Arc<World>, usize) {
    let settings = json!({ "preset": "draft", "receivers_target": TARGET });
    let progress = Progress::new();
    let mut run = LocalRun::new(1 << 30, &progress);
    let scene = run.shelf.put(bundle);
    let plan = Kinds::new().first_tasks(kind, scene, &settings).unwrap();
    let wanted = |task: &str| task.starts_with("scene.") || task.ends_with(".plan");
    let left = run.run(&Runner::new(&BakeKinds::new()), plan, wanted, |_| {}).unwrap();
    let transport = left.iter().filter(|task| task.kind.ends_with(".transport")).count();
    (World::of_run(&run).unwrap(), transport)
}

/// The receiver as it would be in a scene of another size.
fn scaled(receiver: &Receiver, factor: f32) -> Receiver {
    Receiver { position_m: receiver.position_m * factor, ..*receiver }
}

#[test]
fn room_in_any_unit_has_the_very_same_receivers() {
    let (metres, tasks) = placed("prt", scenes::room(4.0));
    assert!(metres.lightmap.receivers.len() > 1000);
    // From a room of 4 µm to one of 131 km. Powers of two scale floating-point numbers exactly.
    for exponent in [-20, -10, 10, 15] {
        let factor = 2.0_f32.powi(exponent);
        let (other, other_tasks) = placed("prt", scenes::room(4.0 * factor));
        assert_eq!(other.lightmap.texel_m, metres.lightmap.texel_m * factor);
        assert_eq!(other.lightmap.receivers.len(), metres.lightmap.receivers.len());
        for (own, other) in metres.lightmap.receivers.iter().zip(&other.lightmap.receivers) {
            assert_eq!(*other, scaled(own, factor), "2^{exponent}");
        }
        assert_eq!(other_tasks, tasks);
    }
    // Feet, inches and miles fall between them.
    for side_m in [4.0 / 0.3048, 4.0 / 0.0254, 4.0 * 1609.344, 4.0 * 1000.0, 4.0 / 1000.0] {
        let (other, _) = placed("prt", scenes::room(side_m));
        let more = other.lightmap.receivers.len() as f32 / metres.lightmap.receivers.len() as f32;
        assert!((0.4..2.5).contains(&more), "{side_m} m: {more} times as many receivers");
    }
}

#[test]
fn probes_of_a_room_are_as_many_in_any_unit() {
    let tasks = |side_m: f32| placed("sh", scenes::room(side_m)).1;
    let metres = tasks(4.0);
    assert!(metres > 0);
    for exponent in [-20, 15] {
        assert_eq!(tasks(4.0 * 2.0_f32.powi(exponent)), metres);
    }
}

#[test]
fn plain_of_100_km_takes_no_texels_from_the_room_that_stands_on_it() {
    let (alone, _) = placed("prt", scenes::room(4.0));
    for (kind, bundle) in [
        ("prt", scenes::room_on_a_plain(5e4)),
        ("prt", scenes::room_and_a_far_triangle(1e5)),
        ("sh", scenes::room_and_a_far_triangle(1e5)),
    ] {
        let (world, tasks) = placed(kind, bundle);
        let lightmap = &world.lightmap;
        assert!(lightmap.texel_m <= 2.0 * alone.lightmap.texel_m, "{} m", lightmap.texel_m);
        assert!(lightmap.receivers.len() < 3 * TARGET as usize, "{}", lightmap.receivers.len());
        assert!(tasks < 200, "{tasks}");
        let in_room = |receiver: &&Receiver| {
            lightmap.blocks[receiver.block as usize].texel_m == lightmap.texel_m
                && receiver.position_m.abs().max_element() <= 4.0
        };
        let near: Vec<&Receiver> = lightmap.receivers.iter().filter(in_room).collect();
        assert!(near.len() > 500, "{}", near.len());
        // Lifts and tests for walls are those of a room, not of a country: nobody is lifted through a wall.
        for receiver in near {
            let offset_m = world.geometry.tracer.ray_offset_m(receiver.position_m);
            assert!(offset_m < 1e-3, "rays start {offset_m} m off the walls");
        }
    }
}

#[test]
fn texels_of_a_plain_grow_with_the_distance_and_cover_it_all() {
    let (world, _) = placed("prt", scenes::room_on_a_plain(5e4));
    let far = |receiver: &Receiver| Vec3::new(receiver.position_m.x, 0.0, receiver.position_m.z).length();
    let texel_m = |receiver: &Receiver| world.lightmap.blocks[receiver.block as usize].texel_m;
    let farthest = world.lightmap.receivers.iter().map(far).fold(0.0, f32::max);
    assert!(farthest > 4e4, "{farthest}");
    for receiver in &world.lightmap.receivers {
        let (far_m, texel_m) = (far(receiver), texel_m(receiver));
        assert!(far_m < 32.0 || texel_m > far_m / 512.0, "texel of {texel_m} m at {far_m} m");
        assert!(texel_m <= (0.5 * far_m).max(world.lightmap.texel_m), "texel of {texel_m} m at {far_m} m");
    }
}

#[test]
fn copies_in_one_place_cost_no_more_than_as_many_apart() {
    let rays = |in_one_place: bool| {
        let settings = json!({ "preset": "draft", "texel_m": 0.25 });
        let progress = Progress::new();
        let mut run = LocalRun::new(1 << 30, &progress);
        let scene = run.shelf.put(scenes::boxes(40, in_one_place));
        let plan = Kinds::new().first_tasks("prt", scene, &settings).unwrap();
        let wanted = |task: &str| task.starts_with("scene.") || task.ends_with(".plan");
        run.run(&Runner::new(&BakeKinds::new()), plan, wanted, |_| {}).unwrap();
        progress.rays().total() as f64
    };
    let [apart, together] = [false, true].map(rays);
    assert!(apart > 1e4 && together < 3.0 * apart, "{together} rays, {apart} apart");
}
