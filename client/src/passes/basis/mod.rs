//! λ → cluster coefficients: `b_c = s (ΣVᵀ) λ|_c`.

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
    include_str!("basis.wgsl")
);
/// Largest difference from the reference, relative to the largest value: sums of some thousand f32 of either sign in
/// another order (by shares of the columns).
pub const TOLERANCE: f32 = 2e-5;
/// Threads of a group on adapters that are processors in truth: each barrier costs them as much as all threads together.
const PROCESSOR_THREADS: f64 = 64.0;
/// Numbers of one page of factors; twin of `Basis` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct BasisNumbers {
    /// Clusters in a row of the dispatch.
    pub stride: u32,
    /// Clusters of the page.
    pub cluster_count: u32,
    /// The page's first among all.
    pub first_cluster: u32,
}

/// The pass on the adapter: one dispatch per page of ΣVᵀ.
#[derive(Debug)]
pub struct BasisPass {
    pipeline: wgpu::ComputePipeline,
    pages: Vec<(wgpu::BindGroup, [u32; 2])>,
}

impl BasisPass {
    /// Uploads ΣVᵀ of all clusters, which read `lambda`; `b` and `detail` are of the table's clusters.
    pub fn new(
        gpu: &Gpu,
        table: &ClusterTable,
        [lambda, b]: [&wgpu::Buffer; 2],
        detail: &DetailBuffers,
    ) -> Result<Self> {
        let overrides: &[_] = if gpu.software { &[("THREADS", PROCESSOR_THREADS)] } else { &[] };
        let pipeline = gpu.compute_with(("basis", SHADER, "project"), None, overrides);
        let columns = gpu.storage("columns", &table.columns)?;
        let steps = gpu.storage("steps", &table.steps)?;
        let bytes = table.clusters.iter().map(|cluster| (4 * cluster.vt.len) as u64);
        let mut groups = Vec::new();
        for run in pages(gpu, "cluster's ΣVᵀ", bytes)? {
            let first_cluster = run.start as u32;
            let clusters = &table.clusters[run];
            let words = words_of(clusters.iter().map(|cluster| cluster.vt));
            let rows: Vec<_> =
                clusters.iter().map(|cluster| ClusterRow::new(cluster, &cluster.vt, words.start)).collect();
            let [stride, layers] = groups_2d(rows.len() as u32);
            let numbers = BasisNumbers { stride, cluster_count: rows.len() as u32, first_cluster };
            let group = gpu.bind(
                &pipeline.get_bind_group_layout(0),
                &[
                    gpu.uniform("basis", &numbers).as_entire_binding(),
                    gpu.storage("clusters", &rows)?.as_entire_binding(),
                    columns.as_entire_binding(),
                    gpu.storage("vt", &table.vt[words])?.as_entire_binding(),
                    steps.as_entire_binding(),
                    lambda.as_entire_binding(),
                    b.as_entire_binding(),
                    detail.details.as_entire_binding(),
                    detail.turn.as_entire_binding(),
                ],
            );
            groups.push((group, [stride, layers]));
        }
        Ok(Self { pipeline, pages: groups })
    }

    /// Records the pass.
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>) {
        pass.set_pipeline(&self.pipeline);
        for (group, [x, y]) in &self.pages {
            pass.set_bind_group(0, group, &[]);
            pass.dispatch_workgroups(*x, *y, 1);
        }
    }
}
