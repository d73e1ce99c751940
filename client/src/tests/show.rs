//! The passes of a window's picture against their references, and the clock of passes.

use glam::Vec4;

use super::adapter::{held, positive_noise};
use super::fixture_view;
use crate::passes::compare::Difference;
use crate::passes::gpu::Gpu;
use crate::passes::meter::{self, MeterNumbers, MeterPass};
use crate::passes::show::{self, ShowPass};
use crate::picture::Tone;
use crate::preview::{Backend, frame_of, render};

const SIZE: [u32; 2] = [300, 70];

/// A picture of radiance on the adapter.
fn uploaded(gpu: &Gpu, radiance: &[Vec4]) -> wgpu::TextureView {
    let size = wgpu::Extent3d { width: SIZE[0], height: SIZE[1], depth_or_array_layers: 1 };
    let texture = gpu.texture(&wgpu::TextureDescriptor {
        label: Some("radiance"),
        size,
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::Rgba32Float,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    });
    let texture = texture.unwrap();
    let layout =
        wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(16 * SIZE[0]), rows_per_image: None };
    gpu.queue.write_texture(texture.as_image_copy(), bytemuck::cast_slice(radiance), layout, size);
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}

fn noise(seed: u32) -> Vec<Vec4> {
    positive_noise((SIZE[0] * SIZE[1]) as usize, seed)
}

#[test]
#[ignore = "needs a graphics adapter"]
fn shown_picture_agrees_with_the_reference() {
    let gpu = Gpu::open().unwrap();
    for tone in [Tone::Linear, Tone::Reinhard, Tone::Filmic] {
        let pass = ShowPass::new(&gpu, wgpu::TextureFormat::Bgra8Unorm);
        let samples = [1, 2, 3].map(noise);
        let views = samples.each_ref().map(|sample| uploaded(&gpu, sample));
        // Sums of other samples of that size are not what is shown.
        let mut bytes = Vec::new();
        let mut sum = pass.sum(&gpu, &views[0], SIZE).unwrap();
        pass.add(&gpu, &sum, true, (9.0, tone));
        for (view, is_first) in views.iter().zip([true, false, false]) {
            sum = pass.sum_with(&gpu, &sum, view);
            pass.add(&gpu, &sum, is_first, (1.5, tone));
            bytes = pass.keep(&gpu, &sum).unwrap();
        }
        let got: Vec<Vec4> = bytes.iter().map(|pixel| Vec4::from(pixel.map(f32::from)) / 255.0).collect();
        let wanted = show::reference::shown(&samples, 1.5, tone);
        held("show", &Difference::of(&got, &wanted, show::TOLERANCE), 0.0);
        let other = show::reference::shown(&samples, 1.6, tone);
        assert!(!Difference::of(&got, &other, show::TOLERANCE).agrees(0.1), "exposure is seen");
    }
}

#[test]
#[ignore = "needs a graphics adapter"]
fn metered_pixels_agree_with_the_reference() {
    let gpu = Gpu::open().unwrap();
    let radiance = noise(7);
    let mut pass = MeterPass::new(&gpu, &uploaded(&gpu, &radiance), SIZE).unwrap();
    assert!(pass.ask(&gpu, 5));
    gpu.poll(true).unwrap();
    let answers = pass.answers(&gpu).unwrap();
    let [(5, got)] = &answers[..] else { panic!("{} answers", answers.len()) };
    let wanted = meter::reference::gather(MeterNumbers::of(SIZE), &radiance);
    assert_eq!(wanted.len(), 256 * 70, "wider than the grid, and lower");
    held("meter", &Difference::of(got, &wanted, meter::TOLERANCE), 0.0);
    assert_ne!(wanted, radiance[..wanted.len()]);
}

/// Every pass of a frame has a time where the adapter has a clock, and none is invented where it has not.
#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_says_how_long_each_pass_took() {
    let gpu = Gpu::open().unwrap();
    let (bake, view) = fixture_view();
    let picture = render(&bake, &view, Backend::Gpu).unwrap();
    let mut frame = frame_of(&gpu, &bake, &view).unwrap();
    frame.settle(view.limit).unwrap();
    frame.draw([0.0; 2]).unwrap();
    frame.hear_times().unwrap();
    let Some(times) = frame.pass_times() else {
        assert_eq!(picture.pass_times, None);
        return;
    };
    let names: Vec<&str> = times.iter().map(|time| time.name).collect();
    let wanted = [
        "shadow",
        "direct",
        "direct at near hits",
        "columns",
        "basis",
        "near",
        "reconstruct",
        "change",
        "atlas",
        "shade",
    ];
    assert_eq!(names, wanted);
    for time in times {
        println!("{time:?}");
        assert!(time.runs > 0 && time.total_ms >= time.last_ms && time.total_ms < 60e3, "{time:?}");
    }
    assert!(times.iter().any(|time| time.total_ms > 0.0));
    let of = |name: &str| times.iter().find(|time| time.name == name).unwrap().runs;
    assert_eq!((of("basis"), of("shade")), (u64::from(picture.bounces), 1));
    assert_eq!(picture.pass_times.unwrap().iter().map(|time| time.name).collect::<Vec<_>>(), wanted);
}
