//! λ → cluster coefficients: `b_c = (ΣVᵀ) λ|_c`.

pub mod reference;

use lightkiln_proto::relight::ClusterTable;

use crate::error::Result;
use crate::passes::gpu::{Gpu, groups_2d};
use crate::passes::resident::{ClusterRow, pages};

/// The shader.
pub const SHADER: &str = include_str!("basis.wgsl");
/// Largest difference from the reference, relative to the largest value: sums of some thousand f32 of either sign in
/// another order (64 strided sums, then a tree).
pub const TOLERANCE: f32 = 2e-5;

/// Numbers of one page of factors; twin of `Basis` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct BasisNumbers {
    /// Coefficients J of a column in lambda.
    pub coefficients: u32,
    /// Clusters in a row of the dispatch.
    pub stride: u32,
    /// Clusters of the page.
    pub cluster_count: u32,
    /// Nothing.
    pub pad: u32,
}

/// The pass on the adapter: one dispatch per page of ΣVᵀ.
#[derive(Debug)]
pub struct BasisPass {
    pipeline: wgpu::ComputePipeline,
    pages: Vec<(wgpu::BindGroup, [u32; 3])>,
}

impl BasisPass {
    /// Uploads ΣVᵀ of all clusters, which read `lambda` of J `coefficients`; `b` is of the table's clusters.
    pub fn new(
        gpu: &Gpu,
        table: &ClusterTable,
        coefficients: usize,
        lambda: &wgpu::Buffer,
        b: &wgpu::Buffer,
    ) -> Result<Self> {
        let pipeline = gpu.compute("basis", SHADER, "project");
        let support = gpu.storage("support", &table.support)?;
        let bytes = table.clusters.iter().map(|cluster| 4 * (cluster.rank * cluster.columns()) as u64);
        let mut groups = Vec::new();
        for run in pages(gpu, "cluster's ΣVᵀ", bytes)? {
            let clusters = &table.clusters[run];
            let first_vt = clusters[0].first_vt;
            let end_vt =
                clusters.iter().map(|cluster| cluster.first_vt + cluster.rank * cluster.columns()).max();
            let rows: Vec<_> = clusters
                .iter()
                .map(|cluster| ClusterRow::new(cluster, cluster.first_vt - first_vt))
                .collect();
            let rank_max = clusters.iter().map(|cluster| cluster.rank as u32).max().unwrap_or(0);
            let [stride, layers] = groups_2d(rows.len() as u32);
            let numbers = BasisNumbers {
                coefficients: coefficients as u32,
                stride,
                cluster_count: rows.len() as u32,
                pad: 0,
            };
            let group = gpu.bind(
                &pipeline.get_bind_group_layout(0),
                &[
                    gpu.uniform("basis", &numbers).as_entire_binding(),
                    gpu.storage("clusters", &rows)?.as_entire_binding(),
                    support.as_entire_binding(),
                    gpu.storage("vt", &table.vt[first_vt..end_vt.unwrap_or(first_vt)])?.as_entire_binding(),
                    lambda.as_entire_binding(),
                    b.as_entire_binding(),
                ],
            );
            groups.push((group, [rank_max, stride, layers]));
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
