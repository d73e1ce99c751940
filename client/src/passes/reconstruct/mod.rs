//! Cluster coefficients → irradiance at receivers or other rows: `E_r = max(N_r + U_r · b_c, −F_r)`.

pub mod reference;

use lightkiln_proto::relight::ClusterTable;

use crate::error::Result;
use crate::passes::gpu::{Gpu, groups_2d};
use crate::passes::lod::DetailBuffers;
use crate::passes::resident::{ClusterRow, pages, words_of};

/// The shader, with the clusters' parts in front.
pub const SHADER: &str = concat!(
    include_str!("../shared/factors.wgsl"),
    include_str!("../shared/detail.wgsl"),
    include_str!("reconstruct.wgsl")
);
/// Largest difference from the reference, relative to the largest value: sums of at most 256 f32 of either sign in
/// another order (by eight ranks, the start last).
pub const TOLERANCE: f32 = 1e-5;
/// Rows of a workgroup in the shader.
const ROWS: usize = 4 * 64;

/// Numbers of one page of factors; twin of `Reconstruct` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct ReconstructNumbers {
    /// Clusters in a row of the dispatch.
    pub stride: u32,
    /// Clusters of the page.
    pub cluster_count: u32,
    /// Whether there is F; else rows have a sign.
    pub has_beside: u32,
    /// The page's first among all.
    pub first_cluster: u32,
}

/// Arrays of the pass, an entry a row but for b.
#[derive(Clone, Copy, Debug)]
pub struct RowArrays<'a> {
    /// b of all clusters.
    pub b: &'a wgpu::Buffer,
    /// N: of receivers, the irradiance from near hits.
    pub start: &'a wgpu::Buffer,
    /// F, light that is added to E: of receivers, E_emit. None for rows that have a sign.
    pub beside: Option<&'a wgpu::Buffer>,
    /// E, which the pass writes.
    pub result: &'a wgpu::Buffer,
    /// The part of each cluster that is computed.
    pub detail: &'a DetailBuffers,
}

/// The pass on the adapter: one dispatch per page of U.
#[derive(Debug)]
pub struct ReconstructPass {
    pipeline: wgpu::ComputePipeline,
    pages: Vec<(wgpu::BindGroup, [u32; 3])>,
}

impl ReconstructPass {
    /// Uploads U of all clusters.
    pub fn new(gpu: &Gpu, table: &ClusterTable, rows: RowArrays<'_>) -> Result<Self> {
        let pipeline = gpu.compute("reconstruct", SHADER, "expand");
        let bytes = table.clusters.iter().map(|cluster| (4 * cluster.u.len) as u64);
        let mut groups = Vec::new();
        for run in pages(gpu, "cluster's U", bytes)? {
            let first_cluster = run.start as u32;
            let clusters = &table.clusters[run];
            let words = words_of(clusters.iter().map(|cluster| cluster.u));
            let of_page: Vec<_> =
                clusters.iter().map(|cluster| ClusterRow::new(cluster, &cluster.u, words.start)).collect();
            let rows_max = clusters.iter().map(|cluster| cluster.row_count).max().unwrap_or(0);
            let [stride, layers] = groups_2d(of_page.len() as u32);
            let numbers = ReconstructNumbers {
                stride,
                cluster_count: of_page.len() as u32,
                has_beside: rows.beside.is_some().into(),
                first_cluster,
            };
            let group = gpu.bind(
                &pipeline.get_bind_group_layout(0),
                &[
                    gpu.uniform("reconstruct", &numbers).as_entire_binding(),
                    gpu.storage("clusters", &of_page)?.as_entire_binding(),
                    gpu.storage("u", &table.u[words])?.as_entire_binding(),
                    rows.b.as_entire_binding(),
                    rows.start.as_entire_binding(),
                    rows.beside.unwrap_or(rows.start).as_entire_binding(),
                    rows.result.as_entire_binding(),
                    rows.detail.details.as_entire_binding(),
                    rows.detail.order.as_entire_binding(),
                    rows.detail.turn.as_entire_binding(),
                ],
            );
            groups.push((group, [rows_max.div_ceil(ROWS) as u32, stride, layers]));
        }
        Ok(Self { pipeline, pages: groups })
    }

    /// Records the pass.
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>) {
        pass.set_pipeline(&self.pipeline);
        for (group, [x, y, z]) in &self.pages {
            pass.set_bind_group(0, group, &[]);
            pass.dispatch_workgroups(*x, *y, *z);
        }
    }
}
