//! The light meter: pixels of a picture on a grid, from which the exposure is found without reading all of it.

pub mod reference;

use glam::Vec4;

use super::gpu::Gpu;
use super::landings::Landings;
use crate::error::Result;

/// The shader.
pub const SHADER: &str = include_str!("meter.wgsl");
/// Largest difference from the reference: pixels are copied.
pub const TOLERANCE: f32 = 0.0;
/// Most grid points along a side. More → the exposure is nearer to that of all pixels, more bytes are read back.
const SIDE_MAX: u32 = 256;
/// Threads of a workgroup along each side, in the shader.
const THREADS: u32 = 8;
/// Answers that may be under way at once.
const LANDINGS: usize = 3;

/// Numbers of the pass; twin of `Meter` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct MeterNumbers {
    /// Grid points along x.
    pub columns: u32,
    /// Grid points along y.
    pub rows: u32,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
}

impl MeterNumbers {
    /// The grid of a picture of `size` pixels: all of them where it is small.
    pub fn of([width, height]: [u32; 2]) -> Self {
        Self { columns: width.min(SIDE_MAX), rows: height.min(SIDE_MAX), width, height }
    }

    fn points(&self) -> u64 {
        u64::from(self.columns) * u64::from(self.rows)
    }
}

/// The pass on the adapter, for pictures of one size.
#[derive(Debug)]
pub struct MeterPass {
    numbers: MeterNumbers,
    pipeline: wgpu::ComputePipeline,
    group: wgpu::BindGroup,
    seen: wgpu::Buffer,
    landings: Landings,
}

impl MeterPass {
    /// Binds a picture of radiance of `size` pixels.
    pub fn new(gpu: &Gpu, radiance: &wgpu::TextureView, size: [u32; 2]) -> Result<Self> {
        let numbers = MeterNumbers::of(size);
        let bytes = numbers.points() * size_of::<Vec4>() as u64;
        let pipeline = gpu.compute("meter", SHADER, "gather");
        let seen = gpu.blank("metered pixels", bytes)?;
        let group = gpu.bind(
            &pipeline.get_bind_group_layout(0),
            &[
                gpu.uniform("meter", &numbers).as_entire_binding(),
                wgpu::BindingResource::TextureView(radiance),
                seen.as_entire_binding(),
            ],
        );
        let landings = Landings::new(gpu, "meter read back", LANDINGS, bytes);
        Ok(Self { numbers, pipeline, group, seen, landings })
    }

    /// Meters the picture; the answer comes later, with `mark`. Whether it will: none does where too many are under way.
    pub fn ask(&mut self, gpu: &Gpu, mark: u64) -> bool {
        let Some(landing) = self.landings.free() else { return false };
        let bytes = self.numbers.points() * size_of::<Vec4>() as u64;
        gpu.submit(|encoder| {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &self.group, &[]);
            pass.dispatch_workgroups(
                self.numbers.columns.div_ceil(THREADS),
                self.numbers.rows.div_ceil(THREADS),
                1,
            );
            drop(pass);
            self.landings.copy(encoder, landing, &self.seen, bytes);
        });
        self.landings.ask(landing, mark, bytes);
        true
    }

    /// The answers that are there, by ascending marks.
    pub fn answers(&mut self, gpu: &Gpu) -> Result<Vec<(u64, Vec<Vec4>)>> {
        gpu.poll(false)?;
        self.landings.answers(gpu)
    }
}
