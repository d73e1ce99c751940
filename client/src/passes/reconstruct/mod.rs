//! Cluster coefficients → irradiance at receivers: `E_ind(r) = max(N(r) + U_r · b_c, −E_emit(r))`.

pub mod reference;

use lightkiln_proto::relight::ClusterTable;

use crate::error::Result;
use crate::passes::gpu::{Gpu, groups_2d};
use crate::passes::resident::{ClusterRow, Resident, pages};

/// The shader.
pub const SHADER: &str = include_str!("reconstruct.wgsl");
/// Largest difference from the reference, relative to the largest value: the same sum of at most 256 f32 in the same
/// order; the adapter may fuse multiply and add.
pub const TOLERANCE: f32 = 1e-5;
/// Threads of a workgroup in the shader.
const THREADS: usize = 64;

/// Numbers of one page of factors; twin of `Reconstruct` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct ReconstructNumbers {
    /// Clusters in a row of the dispatch.
    pub stride: u32,
    /// Clusters of the page.
    pub cluster_count: u32,
}

/// The pass on the adapter: one dispatch per page of U.
#[derive(Debug)]
pub struct ReconstructPass {
    pipeline: wgpu::ComputePipeline,
    pages: Vec<(wgpu::BindGroup, [u32; 3])>,
}

impl ReconstructPass {
    /// Uploads U of all clusters.
    pub fn new(gpu: &Gpu, table: &ClusterTable, resident: &Resident) -> Result<Self> {
        let pipeline = gpu.compute("reconstruct", SHADER, "expand");
        let bytes = table.clusters.iter().map(|cluster| 4 * (cluster.rank * cluster.receiver_count) as u64);
        let mut groups = Vec::new();
        for run in pages(gpu, "cluster's U", bytes)? {
            let clusters = &table.clusters[run];
            let first_u = clusters[0].first_u;
            let end_u =
                clusters.iter().map(|cluster| cluster.first_u + cluster.rank * cluster.receiver_count).max();
            let rows: Vec<_> =
                clusters.iter().map(|cluster| ClusterRow::new(cluster, cluster.first_u - first_u)).collect();
            let receivers_max = clusters.iter().map(|cluster| cluster.receiver_count).max().unwrap_or(0);
            let [stride, layers] = groups_2d(rows.len() as u32);
            let numbers = ReconstructNumbers { stride, cluster_count: rows.len() as u32 };
            let group = gpu.bind(
                &pipeline.get_bind_group_layout(0),
                &[
                    gpu.uniform("reconstruct", &numbers).as_entire_binding(),
                    gpu.storage("clusters", &rows)?.as_entire_binding(),
                    gpu.storage("u", &table.u[first_u..end_u.unwrap_or(first_u)])?.as_entire_binding(),
                    resident.b.as_entire_binding(),
                    resident.e_emit.as_entire_binding(),
                    resident.e_near.as_entire_binding(),
                    resident.e_ind.as_entire_binding(),
                ],
            );
            groups.push((group, [receivers_max.div_ceil(THREADS) as u32, stride, layers]));
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
