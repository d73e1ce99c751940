//! Panoramas as skies: the light that they send, and what is seen of them.

use std::sync::Arc;

use glam::Vec4;
use lightkiln_proto::relight::PanoramaImage;

use super::{fixture_view, view_of};
use crate::bake::LoadedBake;
use crate::fixture;
use crate::frame::Frame;
use crate::lights::{Panorama, parse_light};
use crate::passes::compare::Difference;
use crate::passes::gpu::Gpu;
use crate::passes::shade;
use crate::preview::{Backend, View, frame_of, render};

/// Light clouds and a bright sun.
fn image(of: impl Fn(f32, f32) -> [f32; 3]) -> Arc<PanoramaImage> {
    let pixels = (0..128 * 64).map(|at| of((at % 128) as f32, (at / 128) as f32)).collect();
    Arc::new(PanoramaImage::new("clouds.hdr".into(), 128, 64, pixels).unwrap())
}

fn clouds() -> Arc<PanoramaImage> {
    image(|x, y| {
        let [red, green] = [1.0 + (0.2 * x).sin(), 1.0 + (0.3 * y).cos()];
        let sun = if (90.0..92.0).contains(&x) && (8.0..10.0).contains(&y) { 400.0 } else { 0.0 };
        [red + sun, green + sun, 0.7 + sun]
    })
}

fn under(view: &View, image: &Arc<PanoramaImage>, turn_deg: f32) -> View {
    let panorama = Panorama::new(Arc::clone(image), turn_deg, 1.5).unwrap();
    View { lights: Vec::new(), emitter_scale: vec![0.0], panorama: Some(Arc::new(panorama)), ..view.clone() }
}

fn four(pixels: &[[f32; 3]]) -> Vec<Vec4> {
    pixels.iter().map(|[r, g, b]| Vec4::new(*r, *g, *b, 0.0)).collect()
}

#[test]
fn even_panorama_lights_and_looks_as_an_even_sky() {
    let (patches, view) = fixture_view();
    for bake in [patches, fixture::sh_bake()] {
        let view = View { samples: 1, ..under(&view, &image(|_, _| [0.2, 0.4, 0.6]), 70.0) };
        let sky = parse_light("sky zenith=0.3,0.6,0.9 horizon=0.3,0.6,0.9").unwrap();
        let even = View { lights: vec![sky], panorama: None, ..view.clone() };
        let [got, wanted] = [&view, &even].map(|view| render(&bake, view, Backend::Cpu).unwrap());
        let difference = Difference::of_mean(&four(&got.linear), &four(&wanted.linear), 2e-3);
        assert!(difference.agrees(0.0), "{difference}");
        // Another one is seen.
        let other = render(&bake, &under(&view, &clouds(), 0.0), Backend::Cpu).unwrap();
        assert!(!Difference::of_mean(&four(&other.linear), &four(&wanted.linear), 2e-3).agrees(0.1));
    }
}

/// A picture of light that no former light is left in.
fn drawn(frame: &mut Frame<'_>, view: &View) -> Vec<Vec4> {
    frame.settle(view.limit).unwrap();
    for _ in 0..40 {
        frame.advance().unwrap();
    }
    frame.draw([0.0; 2]).unwrap();
    frame.read().unwrap()
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_draws_panoramas_as_the_processor_does() {
    let patches = fixture::prt_bake(&fixture::prt_contents());
    for bake in [patches, fixture::sh_bake()] {
        let view = under(&view_of(&bake), &clouds(), 140.0);
        let [got, wanted] =
            [Backend::Gpu, Backend::Cpu].map(|backend| render(&bake, &view, backend).unwrap());
        let difference = Difference::of_mean(&four(&got.linear), &four(&wanted.linear), shade::TOLERANCE);
        println!("panorama: {difference}");
        assert!(difference.agrees(2.0 * shade::OUTLIERS), "{difference}");
    }
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_turns_and_scales_a_panorama_and_makes_nothing_for_it() {
    let gpu = Gpu::open().unwrap();
    let bake: LoadedBake = fixture::prt_bake(&fixture::prt_contents());
    let image = clouds();
    let view = under(&view_of(&bake), &image, 10.0);
    let mut kept = frame_of(&gpu, &bake, &view).unwrap();
    let first = drawn(&mut kept, &view);
    let before = gpu.created();
    let turned = under(&view, &image, 100.0);
    kept.set_sky(turned.panorama.as_ref()).unwrap();
    kept.settle(view.limit).unwrap();
    kept.draw([0.25, 0.0]).unwrap();
    assert_eq!(gpu.created(), before, "a turn makes nothing");
    let got = drawn(&mut kept, &view);
    assert!(!Difference::of_mean(&got, &first, shade::TOLERANCE).agrees(0.1), "the turn is seen");
    let wanted = drawn(&mut frame_of(&gpu, &bake, &turned).unwrap(), &view);
    let difference = Difference::of_mean(&got, &wanted, 2e-3);
    assert!(difference.agrees(0.0), "{difference}");
    // Without it all is dark.
    kept.set_sky(None).unwrap();
    assert!(drawn(&mut kept, &view).iter().all(|pixel| pixel.truncate() == glam::Vec3::ZERO));
}
