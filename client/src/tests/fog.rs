//! A medium in pictures: the adapter's as the processor's, under lights with shadows and between probes.

use glam::{Vec3, Vec4};
use lightkiln_proto::relight::Limit;

use super::fixture_view;
use crate::bake::LoadedBake;
use crate::fixture;
use crate::lights::parse_light;
use crate::passes::compare::Difference;
use crate::passes::fog::{Fog, OUTLIERS, TOLERANCE};
use crate::passes::gpu::Gpu;
use crate::preview::{Backend, View, frame_of, render};

/// A lamp and a sun in a box, in fog.
fn foggy(per_m: f32) -> View {
    let (_, view) = fixture_view();
    let mut lights = view.lights.clone();
    lights.push(parse_light("sun dir=-0.3,-1,-0.2 irradiance=3").unwrap());
    let fog = Fog { per_m, g: 0.5, height_m: Some(1.5), ..Fog::default() };
    View { lights, fog: (per_m > 0.0).then_some(fog), ..view }
}

fn radiance(bake: &LoadedBake, view: &View, backend: Backend) -> Vec<Vec4> {
    let picture = render(bake, view, backend).unwrap();
    picture.linear.iter().map(|radiance| Vec3::from(*radiance).extend(1.0)).collect()
}

#[test]
fn fog_hides_what_is_far_and_shows_light_between() {
    let bake = fixture::field_bake(true);
    let [clear, thin, thick] = [0.0, 0.2, 50.0].map(|per_m| radiance(&bake, &foggy(per_m), Backend::Cpu));
    let spread = |picture: &[Vec4]| {
        let mean = picture.iter().map(|pixel| pixel.x).sum::<f32>() / picture.len() as f32;
        picture.iter().map(|pixel| (pixel.x - mean).abs()).sum::<f32>() / picture.len() as f32 / mean
    };
    assert!(spread(&thick) < 0.7 * spread(&clear), "{} of {}", spread(&thick), spread(&clear));
    let brighter = thin.iter().zip(&clear).filter(|(thin, clear)| thin.x > clear.x).count();
    assert!(brighter > 0 && brighter < clear.len(), "{brighter} pixels are brighter in thin fog");
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_draws_fog_as_the_processor_does() {
    let bakes = [
        fixture::prt_bake(&fixture::prt_contents()),
        fixture::field_bake(true),
        fixture::field_bake(false),
        fixture::captured_bake(true),
    ];
    for bake in bakes {
        let [got, wanted] = [Backend::Gpu, Backend::Cpu].map(|backend| radiance(&bake, &foggy(0.2), backend));
        let difference = Difference::of_mean(&got, &wanted, TOLERANCE);
        println!("{}: {difference}", bake.scene.manifest.kind);
        assert!(difference.agrees(OUTLIERS), "{difference}");
        let other = radiance(&bake, &foggy(0.25), Backend::Cpu);
        let other = Difference::of_mean(&got, &other, TOLERANCE);
        assert!(!other.agrees(OUTLIERS), "a quarter denser is seen: {other}");
    }
}

#[test]
#[ignore = "needs a graphics adapter"]
fn other_fog_makes_nothing_on_the_adapter() {
    let bake = fixture::field_bake(true);
    let view = foggy(0.2);
    let gpu = Gpu::open().unwrap();
    let mut frame = frame_of(&gpu, &bake, &view).unwrap();
    frame.settle(Limit::default()).unwrap();
    frame.draw([0.0; 2]).unwrap();
    let made = gpu.created();
    frame.set_fog(None).unwrap();
    frame.draw([0.0; 2]).unwrap();
    frame.set_fog(Some(Fog { per_m: 1.0, ..Fog::default() })).unwrap();
    frame.draw([0.0; 2]).unwrap();
    assert_eq!(gpu.created(), made);
    assert!(frame.set_fog(Some(Fog { per_m: -1.0, ..Fog::default() })).is_err());
    frame.resize([view.width / 2, view.height / 2]).unwrap();
    frame.draw([0.0; 2]).unwrap();
    assert!(frame.read().unwrap().iter().any(|pixel| pixel.x > 0.0));
}
