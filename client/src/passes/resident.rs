//! Arrays of receivers and clusters on the adapter that several passes share.

use std::ops::Range;

use glam::Vec4;
use lightkiln_proto::relight::{Cluster, Columns, Packing, Transport};

use super::gpu::Gpu;
use super::lod::DetailBuffers;
use super::place::Place;
use super::room::full;
use crate::error::Result;

/// Receivers, and the arrays that passes hand to each other. Same layouts as the references' slices.
#[derive(Debug)]
pub struct Resident {
    /// Positions by slot, in metres.
    pub positions: wgpu::Buffer,
    /// Normals by slot.
    pub normals: wgpu::Buffer,
    /// Albedo by slot.
    pub albedo: wgpu::Buffer,
    /// E_dir by slot, W·m⁻².
    pub e_dir: wgpu::Buffer,
    /// E_emit by slot, W·m⁻².
    pub e_emit: wgpu::Buffer,
    /// E_ind by slot, W·m⁻².
    pub e_ind: wgpu::Buffer,
    /// N of near hits by slot, W·m⁻²; w is 0 but for receivers that no bounce computes.
    pub e_near: wgpu::Buffer,
    /// λ, J entries a column; the sky last.
    pub lambda: wgpu::Buffer,
    /// b of all clusters.
    pub b: wgpu::Buffer,
    /// The part of each cluster that bounces compute.
    pub detail: DetailBuffers,
    /// Where an object's receivers stand; none of those that stay.
    pub place: Option<Place>,
    /// Receivers.
    pub receiver_count: usize,
    /// Entries of `lambda`.
    pub lambda_count: usize,
    /// Entries of `b`.
    pub b_count: usize,
}

impl Resident {
    /// Uploads the constant arrays and makes room for the others, which are 0.
    pub fn new(gpu: &Gpu, transport: &Transport<impl Columns>) -> Result<Self> {
        let (receivers, clusters) = (&transport.receivers, &transport.clusters);
        let four = size_of::<Vec4>() as u64;
        let lambda_count = transport.columns.lambda_count();
        let by_slot = receivers.len() as u64 * four;
        Ok(Self {
            positions: gpu.storage("positions", &receivers.position_m)?,
            normals: gpu.storage("normals", &receivers.normal)?,
            albedo: gpu.storage("albedo", &receivers.albedo)?,
            e_dir: gpu.blank("E_dir", by_slot)?,
            e_emit: gpu.blank("E_emit", by_slot)?,
            e_ind: gpu.blank("E_ind", by_slot)?,
            e_near: gpu.blank("E of near hits", by_slot)?,
            lambda: gpu.blank("lambda", lambda_count as u64 * four)?,
            b: gpu.blank("b", clusters.b_len as u64 * four)?,
            detail: DetailBuffers::new(gpu, clusters)?,
            place: None,
            receiver_count: receivers.len(),
            lambda_count,
            b_count: clusters.b_len,
        })
    }

    /// Writes the end of λ, which no pass writes.
    pub fn write_sky(&self, gpu: &Gpu, sky: &[Vec4]) {
        let start = (self.lambda_count - sky.len()) * size_of::<Vec4>();
        gpu.queue.write_buffer(&self.lambda, start as u64, bytemuck::cast_slice(sky));
    }
}

/// The pass of a bake that makes λ of the light at receivers.
pub trait ColumnsPass: std::fmt::Debug {
    /// Records the pass.
    fn record(&self, pass: &mut wgpu::ComputePass<'_>);
}

/// A cluster as shaders read it; twin of `Cluster` in `shared/factors.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct ClusterRow {
    /// First row: the slot of its first receiver where rows are receivers.
    pub first_row: u32,
    /// Rows.
    pub row_count: u32,
    /// First of its columns in the list of all.
    pub first_column: u32,
    /// Columns.
    pub column_count: u32,
    /// Rank k.
    pub rank: u32,
    /// First of its entries in b.
    pub first_b: u32,
    /// First word of its factor in the page's buffer.
    pub first_word: u32,
    /// Wide columns of ΣVᵀ or wide groups of ranks of U: the first.
    pub wide: u32,
    /// Words of each group of these.
    pub wide_words: u32,
    /// Columns of ΣVᵀ behind these whose numbers have 8 bits; those of the others have 4.
    pub bytes: u32,
}

impl ClusterRow {
    /// The row of a cluster, for one of its factors in a page whose first word is `first`.
    pub fn new(cluster: &Cluster, factor: &Packing, first: usize) -> Self {
        Self {
            first_row: cluster.first_row as u32,
            row_count: cluster.row_count as u32,
            first_column: cluster.first_column as u32,
            column_count: cluster.column_count as u32,
            rank: cluster.rank as u32,
            first_b: cluster.first_b as u32,
            first_word: (factor.first - first) as u32,
            wide: factor.wide as u32,
            wide_words: factor.wide_words as u32,
            bytes: factor.bytes as u32,
        }
    }
}

/// Words of factors that lie one after the other.
pub fn words_of(factors: impl Iterator<Item = Packing>) -> Range<usize> {
    factors.fold(0..0, |words, factor| {
        let start = if words.is_empty() { factor.first } else { words.start };
        start..words.end.max(factor.first + factor.len)
    })
}

/// Splits items of given sizes into runs that each fit into one storage binding.
pub fn pages(gpu: &Gpu, what: &str, bytes: impl Iterator<Item = u64>) -> Result<Vec<Range<usize>>> {
    let mut runs = Vec::new();
    let (mut first, mut sum, mut count) = (0, 0, 0);
    for item in bytes {
        if item > gpu.binding_max {
            return Err(full(format!(
                "one {what} takes {item} bytes, {} binds {}",
                gpu.name, gpu.binding_max
            )));
        }
        if sum + item > gpu.binding_max {
            runs.push(first..count);
            (first, sum) = (count, 0);
        }
        sum += item;
        count += 1;
    }
    if count > first {
        runs.push(first..count);
    }
    Ok(runs)
}
