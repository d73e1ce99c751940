//! Time that the adapter takes for each pass, by its own clock and without a wait.
//!
//! A pass has a mark before and one after it. Adapters that set no marks in passes run them all the same, untimed.

use std::ops::{Deref, DerefMut};

use super::gpu::Gpu;
use super::landings::Landings;
use crate::error::Result;
use crate::picture::PassTime;

/// Most passes of one submission that are timed; those beyond it run untimed.
const PASSES_MAX: u32 = 32;
/// Submissions whose times may be under way at once: those of some frames.
const LANDINGS: usize = 16;

/// Times of passes by name, in the order in which they were first run.
#[derive(Debug)]
pub struct Stopwatch {
    clock: Option<Clock>,
    times: Vec<PassTime>,
}

/// An adapter's clock.
#[derive(Debug)]
struct Clock {
    queries: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    landings: Landings,
    ns_per_tick: f64,
    /// Names of passes by submission under way.
    under_way: Vec<(u64, Vec<&'static str>)>,
    submissions: u64,
}

/// An encoder whose passes are timed.
pub struct Recorder<'a> {
    encoder: &'a mut wgpu::CommandEncoder,
    queries: Option<wgpu::QuerySet>,
    names: Vec<&'static str>,
}

/// The marks of a pass.
#[derive(Debug)]
pub struct Mark {
    queries: wgpu::QuerySet,
    first: u32,
}

impl Stopwatch {
    /// A stopwatch; without times where the adapter has no clock.
    pub fn new(gpu: &Gpu) -> Self {
        let clock = gpu.queries(2 * PASSES_MAX).map(|queries| {
            let bytes = u64::from(2 * PASSES_MAX) * wgpu::QUERY_SIZE as u64;
            let usage = wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC;
            Clock {
                queries,
                resolved: gpu.buffer("times", bytes, usage),
                landings: Landings::new(gpu, "times read back", LANDINGS, bytes),
                ns_per_tick: f64::from(gpu.queue.get_timestamp_period()),
                under_way: Vec::new(),
                submissions: 0,
            }
        });
        Self { clock, times: Vec::new() }
    }

    /// Whether the adapter has a clock.
    pub fn is_there(&self) -> bool {
        self.clock.is_some()
    }

    /// Times of passes so far, as far as they were heard of.
    pub fn times(&self) -> &[PassTime] {
        &self.times
    }

    /// Runs the commands that `record` records, and times their passes. Where too much is under way they run untimed.
    pub fn submit(&mut self, gpu: &Gpu, record: impl FnOnce(&mut Recorder<'_>)) {
        let landing = self.clock.as_ref().and_then(|clock| clock.landings.free());
        let Some((clock, landing)) = self.clock.as_mut().zip(landing) else {
            return gpu.submit(|encoder| record(&mut Recorder::untimed(encoder)));
        };
        let mut names = Vec::new();
        gpu.submit(|encoder| {
            let mut recorder = Recorder { encoder, queries: Some(clock.queries.clone()), names: Vec::new() };
            record(&mut recorder);
            names = recorder.names;
            let count = 2 * names.len() as u32;
            if count > 0 {
                encoder.resolve_query_set(&clock.queries, 0..count, &clock.resolved, 0);
                clock.landings.copy(encoder, landing, &clock.resolved, bytes_of(&names));
            }
        });
        if !names.is_empty() {
            clock.submissions += 1;
            clock.landings.ask(landing, clock.submissions, bytes_of(&names));
            clock.under_way.push((clock.submissions, names));
        }
    }

    /// Takes the times that are there; [`Gpu::poll`] hears of them first.
    pub fn hear(&mut self, gpu: &Gpu) -> Result<()> {
        let Some(clock) = &mut self.clock else { return Ok(()) };
        for (submission, ticks) in clock.landings.answers::<u64>(gpu)? {
            let Some(at) = clock.under_way.iter().position(|(own, _)| *own == submission) else { continue };
            let (_, names) = clock.under_way.swap_remove(at);
            for (name, ticks) in names.into_iter().zip(ticks.chunks_exact(2)) {
                // A clock that was set back in between tells nothing.
                let ms = ticks[1].saturating_sub(ticks[0]) as f64 * clock.ns_per_tick * 1e-6;
                add(&mut self.times, name, ms);
            }
        }
        Ok(())
    }
}

fn bytes_of(names: &[&str]) -> u64 {
    2 * names.len() as u64 * u64::from(wgpu::QUERY_SIZE)
}

fn add(times: &mut Vec<PassTime>, name: &'static str, ms: f64) {
    match times.iter_mut().find(|time| time.name == name) {
        Some(time) => {
            time.runs += 1;
            time.total_ms += ms;
            time.last_ms = ms;
        }
        None => times.push(PassTime { name, runs: 1, total_ms: ms, last_ms: ms }),
    }
}

impl<'a> Recorder<'a> {
    /// A recorder that times nothing.
    pub fn untimed(encoder: &'a mut wgpu::CommandEncoder) -> Self {
        Self { encoder, queries: None, names: Vec::new() }
    }

    /// Begins a compute pass of that name.
    pub fn compute(&mut self, name: &'static str) -> wgpu::ComputePass<'_> {
        let mark = self.mark(name);
        let timestamp_writes = mark.as_ref().map(|mark| wgpu::ComputePassTimestampWrites {
            query_set: &mark.queries,
            beginning_of_pass_write_index: Some(mark.first),
            end_of_pass_write_index: Some(mark.first + 1),
        });
        let descriptor = wgpu::ComputePassDescriptor { label: Some(name), timestamp_writes };
        self.encoder.begin_compute_pass(&descriptor)
    }

    /// Marks for render passes of that name: [`Mark::writes`] goes to the first and the last of them, which must both run.
    pub fn mark(&mut self, name: &'static str) -> Option<Mark> {
        let queries = self.queries.clone().filter(|_| self.names.len() < PASSES_MAX as usize)?;
        self.names.push(name);
        Some(Mark { queries, first: 2 * (self.names.len() as u32 - 1) })
    }
}

impl Mark {
    /// The marks that the first and the last of some render passes set; none for those between.
    pub fn writes(&self, is_first: bool, is_last: bool) -> Option<wgpu::RenderPassTimestampWrites<'_>> {
        (is_first || is_last).then(|| wgpu::RenderPassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: is_first.then_some(self.first),
            end_of_pass_write_index: is_last.then_some(self.first + 1),
        })
    }
}

impl Deref for Recorder<'_> {
    type Target = wgpu::CommandEncoder;

    fn deref(&self) -> &wgpu::CommandEncoder {
        self.encoder
    }
}

impl DerefMut for Recorder<'_> {
    fn deref_mut(&mut self) -> &mut wgpu::CommandEncoder {
        self.encoder
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_of_a_pass_add_up_in_the_order_of_first_runs() {
        let mut times = Vec::new();
        for (name, ms) in [("b", 1.0), ("a", 2.0), ("b", 4.0)] {
            add(&mut times, name, ms);
        }
        let b = PassTime { name: "b", runs: 2, total_ms: 5.0, last_ms: 4.0 };
        assert_eq!(times, [b, PassTime { name: "a", runs: 1, total_ms: 2.0, last_ms: 2.0 }]);
    }
}
