//! Buffers that answers of the adapter are read from, without a wait.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

use bytemuck::Pod;

use super::gpu::{Gpu, failed};
use crate::error::Result;

/// States of a landing.
const FREE: u8 = 0;
const UNDER_WAY: u8 = 1;
const THERE: u8 = 2;
const LOST: u8 = 3;

/// A few buffers of one size, in turn copied to and read.
#[derive(Debug)]
pub struct Landings(Vec<Landing>);

#[derive(Debug)]
struct Landing {
    buffer: wgpu::Buffer,
    state: Arc<AtomicU8>,
    /// The caller's mark of what it holds.
    mark: u64,
    bytes: u64,
}

impl Landings {
    /// Makes `count` buffers of so many bytes. More buffers → fewer answers are left out, though the adapter is frames behind.
    pub fn new(gpu: &Gpu, label: &str, count: usize, bytes: u64) -> Self {
        let landing = |_| Landing {
            buffer: gpu.buffer(label, bytes, wgpu::BufferUsages::MAP_READ),
            state: Arc::new(AtomicU8::new(FREE)),
            mark: 0,
            bytes: 0,
        };
        Self((0..count).map(landing).collect())
    }

    /// A buffer that nothing is under way to; none where the adapter is too far behind.
    pub fn free(&self) -> Option<usize> {
        self.0.iter().position(|landing| landing.state.load(Ordering::Acquire) == FREE)
    }

    /// Records the copy of the first bytes of `from` to a free buffer.
    pub fn copy(&self, encoder: &mut wgpu::CommandEncoder, landing: usize, from: &wgpu::Buffer, bytes: u64) {
        encoder.copy_buffer_to_buffer(from, 0, &self.0[landing].buffer, 0, bytes);
    }

    /// Asks for the bytes of a buffer, after its copy is submitted; [`Landings::answers`] gives them with `mark`.
    pub fn ask(&mut self, landing: usize, mark: u64, bytes: u64) {
        let landing = &mut self.0[landing];
        (landing.mark, landing.bytes) = (mark, bytes);
        landing.state.store(UNDER_WAY, Ordering::Release);
        let state = Arc::clone(&landing.state);
        landing.buffer.map_async(wgpu::MapMode::Read, .., move |result| {
            state.store(if result.is_ok() { THERE } else { LOST }, Ordering::Release);
        });
    }

    /// The answers that are there, by ascending marks. [`Gpu::poll`] hears of them first.
    pub fn answers<T: Pod>(&mut self, gpu: &Gpu) -> Result<Vec<(u64, Vec<T>)>> {
        let mut found = Vec::new();
        for landing in &mut self.0 {
            match landing.state.load(Ordering::Acquire) {
                THERE => {}
                LOST => return Err(failed(format!("{} gave nothing back", gpu.name))),
                _ => continue,
            }
            let view = landing
                .buffer
                .get_mapped_range(..)
                .map_err(|error| failed(format!("{} gave nothing back ({error})", gpu.name)))?;
            found.push((landing.mark, bytemuck::pod_collect_to_vec(&view[..landing.bytes as usize])));
            drop(view);
            landing.buffer.unmap();
            landing.state.store(FREE, Ordering::Release);
        }
        found.sort_by_key(|(mark, _)| *mark);
        Ok(found)
    }
}
