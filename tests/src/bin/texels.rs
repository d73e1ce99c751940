//! Says which texel and which receivers stand for what rays meet, for whoever looks for the cause of a dark or bright spot:
//! `cargo run --release -p lightkiln-tests --bin texels -- SCENE TEXEL_M FROM:TO…`, points as `x,y,z` in metres.
//!
//! Runs the tasks up to the placement alone, which takes seconds where a bake takes minutes.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use glam::{Vec2, Vec3};
use lightkiln_proto::kinds::SceneTasks;
use lightkiln_proto::kinds::prt::Settings;
use lightkiln_worker::kinds::{BakeKinds, Runner};
use lightkiln_worker::lightmap::World;
use lightkiln_worker::scene::{Bundle, Limits};
use lightkiln_worker::task::{LocalRun, Progress};

/// Bytes of artefacts that are kept at once.
const SHELF_BYTES: usize = 1 << 32;

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [scene, texel_m, rays @ ..] = &arguments[..] else {
        bail!("give a scene, the size of a texel in metres, and rays as FROM:TO, e.g. 0,2,0:0,0,0");
    };
    let rays: Vec<[Vec3; 2]> = rays.iter().map(|ray| parsed(ray)).collect::<Result<_>>()?;
    let texel_m: f32 = texel_m.parse().with_context(|| format!("'{texel_m}' is no size of a texel"))?;
    let world = world(Path::new(scene), texel_m)?;
    println!("{} receivers", world.lightmap.receivers.len());
    for [from_m, to_m] in rays {
        println!("{from_m} to {to_m}:");
        describe(&world, from_m, (to_m - from_m).normalize());
    }
    Ok(())
}

fn parsed(ray: &str) -> Result<[Vec3; 2]> {
    let point = |text: &str| -> Result<Vec3> {
        let numbers: Vec<f32> =
            text.split(',').map(str::parse).collect::<Result<_, _>>().with_context(|| format!("'{text}'"))?;
        let [x, y, z] = numbers[..] else { bail!("'{text}' is not a point x,y,z") };
        Ok(Vec3::new(x, y, z))
    };
    let Some((from, to)) = ray.split_once(':') else { bail!("'{ray}' is not a ray FROM:TO") };
    Ok([point(from)?, point(to)?])
}

/// The scene with its receivers placed.
fn world(scene: &Path, texel_m: f32) -> Result<Arc<World>> {
    let bundle = Bundle::pack_path(scene, &Limits::default())?;
    let settings = serde_json::json!({ "preset": "medium", "texel_m": texel_m });
    let settings = Settings::from_json(&settings)?;
    let progress = Progress::new();
    let mut run = LocalRun::new(SHELF_BYTES, &progress);
    let tasks = SceneTasks::of(run.shelf.put(bundle)).unwrapped(&settings.texels).placed(&settings.place);
    run.run(&Runner::new(&BakeKinds::new()), tasks.into_specs().collect(), |_| true, |_| {})?;
    Ok(World::of_run(&run)?)
}

/// The hit of a ray, and the texels that are interpolated around it.
fn describe(world: &World, from_m: Vec3, direction: Vec3) {
    let Some(hit) = world.geometry.tracer.closest(from_m, direction, f32::INFINITY) else {
        println!("  meets nothing");
        return;
    };
    let at_m = from_m + direction * hit.t;
    let found = world.found_at(&hit, at_m);
    let side = if hit.front { "front" } else { "back" };
    println!(
        "  meets the {side} of triangle {} at {at_m}, normal {}",
        hit.triangle,
        world.geometry.side_normal(&hit)
    );
    println!("  stood for by {:?}, read at {:?}", found.own, found.read);
    let Some((block, place)) = found.place else {
        println!("  which has no texels");
        return;
    };
    let charts: Vec<u32> = world.pieces_of(hit.triangle).map(|(_, piece)| piece.chart).collect();
    println!("  texel {place} of '{}', chart {charts:?}", world.lightmap.blocks[block as usize].name);
    let middle = place.floor().as_ivec2();
    for (dx, dy) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy))) {
        let [x, y] = [middle.x + dx, middle.y + dy];
        let Some(receiver) = world.lightmap.receiver_at(block, x, y) else {
            println!("    {x},{y}: no receiver of its own");
            continue;
        };
        let own = &world.lightmap.receivers[receiver as usize];
        let guest = if world.lightmap.is_guest(receiver) { ", a guest" } else { "" };
        let beyond = if own.edge.is_beyond((place - Vec2::new(x as f32, y as f32)).to_array()) {
            ", hit beyond its edge"
        } else {
            ""
        };
        println!(
            "    {x},{y}: receiver {receiver}{guest}, light of {}, at {} facing {}, links {:04b}, coverage {:016b}{beyond}",
            own.light_of, own.position_m, own.face_normal, own.links, own.coverage
        );
    }
}
