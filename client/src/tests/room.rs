//! Adapters that have no room for a bake, and those that are lost.
//!
//! Ignored where there is no adapter: `cargo test -p lightkiln-client --lib -- --ignored adapter`.

use std::sync::Arc;

use lightkiln_proto::kinds::prt;
use lightkiln_proto::relight::Limit;

use super::fixture_view;
use crate::bake::LoadedBake;
use crate::error::ClientError;
use crate::fetch::Source;
use crate::fixture::write_bundle;
use crate::frame::{Frame, FrameRoom};
use crate::kinds;
use crate::passes::gpu::Gpu;
use crate::passes::shadow::ShadowRoom;
use crate::preview::{Backend, StreamedBake, View, render};
use crate::stream::Budget;

/// The fixture's bake with the overview alone, and with all of its light.
fn bakes(folder: &std::path::Path, view: &View) -> [Arc<LoadedBake>; 2] {
    write_bundle(folder, prt::NAME);
    let source = Source::bundle(folder).unwrap();
    let mut streamed = StreamedBake::begin(&source, &kinds::all(), Budget::NONE).unwrap();
    let first = Arc::clone(&streamed.bake);
    streamed.refine(view, Budget::NONE).unwrap();
    [first, streamed.bake]
}

fn frame<'a>(gpu: &'a Gpu, bake: &Arc<LoadedBake>, view: &View) -> crate::error::Result<Frame<'a>> {
    let room =
        FrameRoom { size: [view.width, view.height], shadows: ShadowRoom { lights: 4, faces: 16, side: 64 } };
    let mut frame = Frame::new(gpu, Arc::clone(bake), room, view.camera.clone())?;
    frame.set_lights(&view.lights)?;
    Ok(frame)
}

fn picture(frame: &mut Frame<'_>) -> Vec<glam::Vec4> {
    frame.settle(Limit::default()).unwrap();
    frame.draw([0.0; 2]).unwrap();
    frame.read().unwrap()
}

fn is_full<T>(result: crate::error::Result<T>) -> bool {
    matches!(result, Err(ClientError::AdapterFull { .. }))
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_that_has_no_room_for_light_keeps_what_it_has_and_lets_that_go_for_what_fits_alone() {
    let folder = tempfile::tempdir().unwrap();
    let (_, view) = fixture_view();
    // A picture that is read back takes less than the light that there is no room for.
    let view = View { width: 16, height: 16, ..view };
    let [first, whole] = bakes(folder.path(), &view);
    // A device has some memory of its own.
    let own = Gpu::open().unwrap().in_use().unwrap();
    // Bytes with each frame by itself, after a picture was read.
    let taken = [&first, &whole].map(|bake| {
        let gpu = Gpu::open().unwrap();
        let mut frame = frame(&gpu, bake, &view).unwrap();
        let picture = picture(&mut frame);
        (gpu.in_use().unwrap(), picture)
    });
    let [(of_first, first_picture), (of_whole, whole_picture)] = &taken;
    println!("the overview takes {of_first} bytes, all light {of_whole}");
    assert!(of_first < of_whole, "all light takes more");
    let margin = (of_whole - of_first) / 2;

    let small = Gpu::open_within(Some(of_whole - margin)).unwrap();
    assert!(is_full(frame(&small, &whole, &view)));
    small.let_go().unwrap();
    assert!(small.in_use().unwrap() <= own, "nothing is left of a frame that there is no room for");
    let mut shown = frame(&small, &first, &view).unwrap();
    assert!(is_full(shown.set_bake(Arc::clone(&whole))));
    assert_eq!(&picture(&mut shown), first_picture, "the light from before is there");
    assert!(small.in_use().unwrap() <= of_whole - margin);

    // There is room for either, and not for both.
    let large = Gpu::open_within(Some(of_whole + margin)).unwrap();
    let mut shown = frame(&large, &first, &view).unwrap();
    shown.set_bake(Arc::clone(&whole)).unwrap();
    assert_eq!(&picture(&mut shown), whole_picture);
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_that_has_no_room_leaves_a_picture_to_the_processor_unless_it_alone_is_asked_for() {
    let (bake, view) = fixture_view();
    let view = View { adapter_bytes_max: Some(1), ..view };
    let problem = render(&bake, &view, Backend::Gpu).unwrap_err();
    assert!(matches!(problem, ClientError::AdapterFull { .. }), "{problem}");
    assert!(problem.to_string().contains("takes") && problem.to_string().contains("--backend cpu"));
    assert!(render(&bake, &view, Backend::Auto).unwrap().drawn_by.contains("the processor"));
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_that_is_lost_is_told_each_time_and_nothing_panics() {
    let folder = tempfile::tempdir().unwrap();
    let (_, view) = fixture_view();
    let [first, whole] = bakes(folder.path(), &view);
    let gpu = Gpu::open().unwrap();
    let mut frame = frame(&gpu, &first, &view).unwrap();
    picture(&mut frame);
    gpu.device.destroy();
    // The first of these may come before the loss is heard of.
    let _ = frame.advance();
    let tries = [
        frame.settle(Limit { bounces_max: 4000, change_max: 0.0 }).map(|_| ()),
        frame.draw([0.0; 2]),
        frame.read().map(|_| ()),
        frame.read_receivers().map(|_| ()),
        frame.resize([40, 30]),
        frame.set_bake(whole),
        frame.hear_times(),
    ];
    for (at, tried) in tries.into_iter().enumerate() {
        let told = tried.err().map(|error| error.to_string()).unwrap_or_default();
        assert!(told.contains("lost") && told.contains("start again"), "call {at}: '{told}'");
    }
}
