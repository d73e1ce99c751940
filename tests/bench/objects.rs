//! Objects with bakes of their own beside a bake: the time of a frame without, with one and with ten of them, by the adapter's own clock, and their bytes.

use std::env;
use std::sync::Arc;

use glam::Vec3;
use lightkiln_client::bake::{Beside, LoadedBake};
use lightkiln_client::fetch::Source;
use lightkiln_client::frame::{Frame, FrameRoom};
use lightkiln_client::kinds;
use lightkiln_client::lights::{Caster, parse_light};
use lightkiln_client::passes::gpu::Gpu;
use lightkiln_client::passes::shadow::ShadowRoom;
use lightkiln_client::preview::View;
use lightkiln_client::scene::Stance;
use lightkiln_proto::transfer::TRANSFER;

use crate::report::row;

/// Frames; the best of each pass counts, as others may use the machine.
const FRAMES: usize = 5;
/// Objects.
const COUNTS: [usize; 3] = [0, 1, 10];
const SIZE: [u32; 2] = [1366, 768];

/// Measures the object of `KILN_BENCH_OBJECT` beside the bundles with voxels that `KILN_BENCH_BUNDLES` names, with colons between them.
pub fn measure() {
    let named = env::var("KILN_BENCH_BUNDLES").unwrap_or_default();
    let object = env::var("KILN_BENCH_OBJECT").unwrap_or_default();
    if named.is_empty() || object.is_empty() {
        row("objects", "no bundle", "KILN_BENCH_BUNDLES and KILN_BENCH_OBJECT name none");
        return;
    }
    let load = |bundle: &str| LoadedBake::load(&Source::bundle(bundle).unwrap(), &kinds::all()).unwrap();
    let own = Arc::new(load(&object));
    let bytes = own.scene.manifest.bytes_of(TRANSFER);
    row("kB of an object's volume as stored", &object, &format!("{:.0}", bytes as f64 / 1e3));
    let gpu = match Gpu::open() {
        Ok(gpu) => gpu,
        Err(error) => return row("objects", &object, &format!("skipped: {error}")),
    };
    for bundle in named.split(':').filter(|name| !name.is_empty()) {
        for count in COUNTS {
            let mut bake = load(bundle);
            for _ in 0..count {
                bake.put(Beside::Baked { name: object.clone(), bake: own.clone() }).unwrap();
            }
            let found = frame_of(&gpu, &bake, count);
            let figure = found.map_or_else(
                || "skipped: it has no clock".to_owned(),
                |[bounce, shade]| format!("bounce {bounce:.2}, shading {shade:.2} ({})", gpu.name),
            );
            row(&format!("ms of a frame with {count} objects"), bundle, &figure);
        }
    }
}

/// Milliseconds of a bounce and of shading.
fn frame_of(gpu: &Gpu, bake: &LoadedBake, count: usize) -> Option<[f64; 2]> {
    let lights = [parse_light("sky zenith=1,1,1 horizon=1,1,1").unwrap()];
    let (view, _) = View::of_bake(bake, None, Some(lights.to_vec())).unwrap();
    let shadows = ShadowRoom::for_lights(&Caster::of(&lights), 256).unwrap();
    let mut frame = Frame::new(gpu, bake, FrameRoom { size: SIZE, shadows }, view.camera).unwrap();
    frame.set_lights(&lights).unwrap();
    let [low, high] = bake.scene.manifest.bounds_m.map(Vec3::from);
    // In two rows across the middle of the bake, on its ground.
    let place = |index: usize| {
        let along = Vec3::new((index % 5) as f32 / 4.0, 0.0, (index / 5) as f32);
        let within = low.lerp(high, 0.3) + along * (high - low) * Vec3::new(0.4, 0.0, 0.4);
        Stance { position_m: [within.x, low.y, within.z], scale: 0.3, ..Stance::default() }
    };
    frame.set_objects(&(0..count).map(place).collect::<Vec<_>>()).unwrap();
    let mut best = [f64::INFINITY; 2];
    let mut before = [0.0; 2];
    for _ in 0..FRAMES {
        frame.advance().unwrap();
        frame.draw([0.0; 2]).unwrap();
        frame.hear_times().unwrap();
        let times = frame.pass_times()?;
        let sum = |is_of: &dyn Fn(&str) -> bool| -> f64 {
            times.iter().filter(|time| is_of(time.name)).map(|time| time.total_ms).sum()
        };
        let others = ["shade", "shadow", "direct", "direct at near hits", "atlas"];
        let so_far = [sum(&|name| !others.contains(&name)), sum(&|name| name == "shade")];
        best = [0, 1].map(|at| best[at].min(so_far[at] - before[at]));
        before = so_far;
    }
    Some(best)
}
