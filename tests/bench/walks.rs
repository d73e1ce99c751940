//! Walks a second through the voxels of a bake: by the processor on one thread, and by the adapter.

use std::env;
use std::time::Instant;

use lightkiln_client::bake::LoadedBake;
use lightkiln_client::fetch::Source;
use lightkiln_client::frame::{Frame, FrameRoom};
use lightkiln_client::kinds;
use lightkiln_client::lights::{Caster, parse_light};
use lightkiln_client::passes::gpu::Gpu;
use lightkiln_client::passes::shadow::ShadowRoom;
use lightkiln_client::passes::walk::Walks;
use lightkiln_client::preview::View;
use lightkiln_proto::voxels::{Bundle, OCCLUSION_WALKS, Start, ambient_occlusion};

use crate::report::row;

/// Receivers that walks of the processor start at.
const STARTS: usize = 4096;
/// Rounds; the best of each counts, as others may use the machine.
const ROUNDS: usize = 5;
/// Side of the adapter's picture in pixels.
const SIDE: u32 = 512;
/// Walks have no end but surfaces and the sky.
const REACH_M: f32 = 1e6;

/// Measures the bundles with voxels that `KILN_BENCH_BUNDLES` names, with colons between them.
pub fn measure() {
    let named = env::var("KILN_BENCH_BUNDLES").unwrap_or_default();
    if named.is_empty() {
        row("walks", "no bundle", "KILN_BENCH_BUNDLES names none");
    }
    for bundle in named.split(':').filter(|name| !name.is_empty()) {
        let bake = LoadedBake::load(&Source::bundle(bundle).unwrap(), &kinds::all()).unwrap();
        if bake.light.voxels().is_none() {
            row("walks", bundle, "a bake without voxels");
            continue;
        }
        row("million walks a second on one thread", bundle, &format!("{:.2}", by_processor(&bake)));
        match Gpu::open() {
            Ok(gpu) => {
                let figure = by_adapter(&gpu, &bake).map_or_else(
                    || "skipped: it has no clock".to_owned(),
                    |walks| format!("{walks:.2} ({})", gpu.name),
                );
                row("million walks a second on the adapter", bundle, &figure);
            }
            Err(error) => row("million walks a second on the adapter", bundle, &format!("skipped: {error}")),
        }
    }
}

/// Millions of walks a second from receivers, cosine-distributed, in the best round.
fn by_processor(bake: &LoadedBake) -> f64 {
    let (table, _) = bake.light.voxels().unwrap();
    let lightmap = bake.light.lightmap(&bake.scene).unwrap();
    let step = (lightmap.receivers.len() / STARTS).max(1);
    let starts = lightmap.receivers.position_m.iter().zip(&lightmap.receivers.normal).step_by(step);
    let starts: Vec<Start> =
        starts.map(|(at_m, normal)| Start::on(at_m.truncate(), normal.truncate())).collect();
    let round = |_| {
        let started = Instant::now();
        for (start, identity) in starts.iter().zip(0..) {
            let bundle = Bundle::new(OCCLUSION_WALKS, identity);
            let normal = start.normal.unwrap();
            std::hint::black_box(ambient_occlusion(table, start, normal, &bundle, REACH_M));
        }
        (starts.len() * OCCLUSION_WALKS as usize) as f64 / started.elapsed().as_secs_f64() / 1e6
    };
    (0..ROUNDS).map(round).fold(0.0, f64::max)
}

/// Likewise from the pixels of the bake's view, by the adapter's own clock.
fn by_adapter(gpu: &Gpu, bake: &LoadedBake) -> Option<f64> {
    let lights = [parse_light("sky zenith=1,1,1 horizon=1,1,1").unwrap()];
    let (view, _) = View::of_bake(bake, None, Some(lights.to_vec())).unwrap();
    let shadows = ShadowRoom::for_lights(&Caster::of(&lights), 256).unwrap();
    let room = FrameRoom { size: [SIDE; 2], shadows };
    let mut frame = Frame::new(gpu, bake, room, view.camera).unwrap();
    frame.set_lights(&lights).unwrap();
    let walks = Walks { reflections: false, occlusion_m: Some(REACH_M), ..Walks::default() };
    frame.set_walks(walks).unwrap();
    frame.advance().unwrap();
    let round = |_| {
        frame.draw([0.0; 2]).unwrap();
        let seen = frame.read().unwrap().iter().filter(|pixel| pixel.w == 1.0).count();
        frame.hear_times().unwrap();
        let walk = frame.pass_times()?.iter().find(|time| time.name == "walk")?;
        Some(seen as f64 * f64::from(OCCLUSION_WALKS) / (walk.last_ms * 1e3))
    };
    (0..ROUNDS).map(round).collect::<Option<Vec<f64>>>().map(|all| all.into_iter().fold(0.0, f64::max))
}
