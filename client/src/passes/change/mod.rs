//! The change of E_ind from one bounce to the next, `Σ|E − E before| / Σ|E|`, which tells when bounces have converged. It is found on
//! the adapter, and read without a wait.

pub mod reference;

use glam::{Vec2, Vec4};

use crate::error::Result;
use crate::passes::gpu::{Gpu, failed};
use crate::passes::landings::Landings;
use crate::passes::stopwatch::Stopwatch;

/// The shader.
pub const SHADER: &str = include_str!("change.wgsl");
/// Largest relative difference from the reference, whose sums are in f64: those of the adapter are in f32, by strides and trees.
pub const TOLERANCE: f32 = 1e-4;
/// Threads of a workgroup in the shader.
const THREADS: u32 = 64;
/// Most workgroups of the first step: enough for a large adapter, few for the second.
const GROUPS_MAX: u32 = 512;
/// Answers that may be under way at once. More → a change is heard of in every frame, though the adapter is frames behind.
const LANDINGS: usize = 3;

/// Numbers of the pass; twin of `Change` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct ChangeNumbers {
    /// Receivers.
    pub receiver_count: u32,
    /// Threads of the first step.
    pub stride: u32,
}

/// The pass on the adapter.
#[derive(Debug)]
pub struct ChangePass {
    steps: [(wgpu::ComputePipeline, wgpu::BindGroup, u32); 2],
    result: wgpu::Buffer,
    landings: Landings,
    calls: u64,
    /// The last call that compared: E_ind as of then is kept.
    compared: u64,
    /// Calls whose answers are to come, each with the one that it is compared with.
    under_way: Vec<[u64; 2]>,
}

/// An answer of the pass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answer {
    /// Number of the call, from 1.
    pub call: u64,
    /// Number of the call that it is compared with, the one before that was answered; 0 for black.
    pub since: u64,
    /// Relative change since then; 0 when both are black, no finite number where light is none.
    pub change: f32,
}

impl ChangePass {
    /// Binds E_ind of so many receivers; the first call compares it with black.
    pub fn new(gpu: &Gpu, (e_ind, receivers): (&wgpu::Buffer, usize)) -> Result<Self> {
        let groups = (receivers as u32).div_ceil(THREADS).clamp(1, GROUPS_MAX);
        let numbers = ChangeNumbers { receiver_count: receivers as u32, stride: groups * THREADS };
        let (numbers, before, sums, result) = (
            gpu.uniform("change", &numbers),
            gpu.blank("E_ind before", (receivers * size_of::<Vec4>()) as u64)?,
            // As long as it is bound: the second step goes through all of it.
            gpu.blank("sums of groups", u64::from(groups) * size_of::<Vec2>() as u64)?,
            gpu.blank("sums", size_of::<Vec2>() as u64)?,
        );
        let step = |entry: &str, groups: u32, bound: &[(u32, &wgpu::Buffer)]| {
            let pipeline = gpu.compute(entry, SHADER, entry);
            let bound: Vec<_> = bound.iter().map(|(at, buffer)| (*at, buffer.as_entire_binding())).collect();
            let group = gpu.bind_at(&pipeline.get_bind_group_layout(0), &bound);
            (pipeline, group, groups)
        };
        let steps = [
            step("sum_of_groups", groups, &[(0, &numbers), (1, e_ind), (2, &before), (3, &sums)]),
            step("sum_of_all", 1, &[(3, &sums), (4, &result)]),
        ];
        let landings = Landings::new(gpu, "change read back", LANDINGS, size_of::<Vec2>() as u64);
        Ok(Self { steps, result, landings, calls: 0, compared: 0, under_way: Vec::new() })
    }

    /// Runs the pass; its answer comes later. Where too many are under way it does not run: the next answer spans this call too.
    pub fn ask(&mut self, gpu: &Gpu, watch: &mut Stopwatch) -> u64 {
        self.calls += 1;
        let Some(landing) = self.landings.free() else { return self.calls };
        let bytes = size_of::<Vec2>() as u64;
        watch.submit(gpu, |encoder| {
            let mut pass = encoder.compute("change");
            for (pipeline, group, groups) in &self.steps {
                pass.set_pipeline(pipeline);
                pass.set_bind_group(0, group, &[]);
                pass.dispatch_workgroups(*groups, 1, 1);
            }
            drop(pass);
            self.landings.copy(encoder, landing, &self.result, bytes);
        });
        self.landings.ask(landing, self.calls, bytes);
        self.under_way.push([self.calls, self.compared]);
        self.compared = self.calls;
        self.calls
    }

    /// The answers that are there, oldest first; after a wait for all that are under way if asked.
    pub fn answers(&mut self, gpu: &Gpu, waits: bool) -> Result<Vec<Answer>> {
        gpu.poll(waits)?;
        let mut answers = Vec::new();
        for (call, sums) in self.landings.answers::<[f32; 2]>(gpu)? {
            let [sums] = sums[..] else {
                return Err(failed(format!("{} gave too little back", gpu.name)));
            };
            let Some(at) = self.under_way.iter().position(|[own, _]| *own == call) else { continue };
            let [_, since] = self.under_way.swap_remove(at);
            let change = if sums == [0.0; 2] { 0.0 } else { sums[0] / sums[1] };
            answers.push(Answer { call, since, change });
        }
        Ok(answers)
    }
}
