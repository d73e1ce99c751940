//! What the client needs for a bake: memory a receiver on the graphics adapter, and the time of a bounce.

use std::env;
use std::time::{Duration, Instant};

use lightkiln_client::bake::LoadedBake;
use lightkiln_client::fetch::Source;
use lightkiln_client::frame::{Frame, FrameRoom};
use lightkiln_client::kinds;
use lightkiln_client::lights::{Caster, parse_light};
use lightkiln_client::passes::gpu::Gpu;
use lightkiln_client::passes::shadow::ShadowRoom;
use lightkiln_client::preview::View;
use lightkiln_proto::manifest::with_chunks;

use crate::report::{quantile, row};

/// Bounces in a row that are timed together, and how often.
const BOUNCES: u32 = 10;
const ROUNDS: usize = 7;

/// Measures the bundles that `KILN_BENCH_BUNDLES` names, with colons between them.
pub fn measure() {
    let named = env::var("KILN_BENCH_BUNDLES").unwrap_or_default();
    let bundles: Vec<&str> = named.split(':').filter(|name| !name.is_empty()).collect();
    if bundles.is_empty() {
        row("a bounce", "no bundle", "KILN_BENCH_BUNDLES names none");
        return;
    }
    let gpu = Gpu::open().unwrap();
    for bundle in bundles {
        measured(&gpu, bundle);
    }
}

fn measured(gpu: &Gpu, bundle: &str) {
    let bake = LoadedBake::load(&Source::bundle(bundle).unwrap(), &kinds::all()).unwrap();
    let receivers: u32 = with_chunks(&bake.scene.manifest).map(|(row, _)| row.receivers).sum();
    let lights = [parse_light("sky zenith=1,1,1 horizon=1,1,1").unwrap()];
    let (view, _) = View::of_bake(&bake, None, Some(lights.to_vec())).unwrap();
    let shadows = ShadowRoom::for_lights(&Caster::of(&lights), 256).unwrap();
    let before = gpu.stored();
    let room = FrameRoom { size: [16, 16], shadows };
    let mut frame = Frame::new(gpu, &bake, room, view.camera).unwrap();
    let stored = gpu.stored() - before;
    frame.set_lights(&lights).unwrap();
    let mut times: Vec<Duration> = (0..ROUNDS)
        .map(|_| {
            let start = Instant::now();
            for _ in 0..BOUNCES {
                frame.advance().unwrap();
            }
            gpu.poll(true).unwrap();
            start.elapsed() / BOUNCES
        })
        .collect();
    let place = format!("{bundle}, {}", gpu.name);
    row(
        "memory for light on the adapter",
        &place,
        &format!("{:.0} B a receiver", stored as f64 / f64::from(receivers)),
    );
    let [best, median] = [0.0, 0.5].map(|share| quantile(&mut times, share).as_secs_f64() * 1000.0);
    row("a bounce", &place, &format!("{best:.2} ms, median {median:.2} ms, {receivers} receivers"));
}
