//! Level of detail: which part of each cluster bounces compute, and light of the receivers that are left out:
//! `E_r ← mix(E_r, mean of E over its stand-ins, share)`. The reference is a bounce in detail of the contract,
//! `Transport::settle_in`, which tests hold whole bounces against.

use lightkiln_proto::relight::{ClusterTable, Detail, LOD_LEVELS, LodPlan, LodTable, LodView, StandIn};

use crate::error::Result;
use crate::passes::gpu::{Gpu, groups_2d};
use crate::passes::resident::{Resident, pages};

/// The shader that marks receivers which are not computed, with the clusters' part in front.
pub const MARK_SHADER: &str = concat!(include_str!("../shared/detail.wgsl"), include_str!("mark.wgsl"));
/// The shader of stand-ins, with the clusters' part in front.
pub const FILL_SHADER: &str = concat!(include_str!("../shared/detail.wgsl"), include_str!("fill.wgsl"));
/// Largest difference from the reference after some bounces, relative to the largest value: that of the passes before, and a share
/// that is steep where its zone is narrow.
pub const TOLERANCE: f32 = 1e-4;
/// Threads of a workgroup in the shaders.
const THREADS: u32 = 64;

/// Number of a bounce; twin of `Turn` in the shaders.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct TurnNumbers {
    /// The bounce.
    pub bounce: u32,
    /// Clusters.
    pub cluster_count: u32,
    /// Clusters in a row of a dispatch over all.
    pub stride: u32,
}

/// Numbers of the stand-ins of a level; twin of `Fill` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct FillNumbers {
    /// Receivers.
    pub count: u32,
    /// Threads in a row of the dispatch.
    pub stride: u32,
    /// Their level.
    pub level: u32,
}

/// Detail of clusters on the adapter, as passes over clusters read it: all of each at first.
#[derive(Debug)]
pub struct DetailBuffers {
    /// [`Detail`] of each cluster.
    pub details: wgpu::Buffer,
    /// Order of rows, see [`LodTable::order`]: read where not all of a cluster's are computed.
    pub order: wgpu::Buffer,
    /// [`TurnNumbers`].
    pub turn: wgpu::Buffer,
    full: Vec<Detail>,
}

impl DetailBuffers {
    /// Of a table's clusters, all of each.
    pub fn new(gpu: &Gpu, table: &ClusterTable) -> Result<Self> {
        let full: Vec<Detail> = table.clusters.iter().map(Detail::full).collect();
        let rows: usize = table.clusters.iter().map(|cluster| cluster.row_count).sum();
        let turn = turn(full.len(), 0);
        Ok(Self {
            details: gpu.storage("details", &full)?,
            order: gpu.blank("order of rows", (rows * size_of::<u32>()) as u64)?,
            turn: gpu.uniform("turn", &turn),
            full,
        })
    }
}

fn turn(clusters: usize, bounce: u32) -> TurnNumbers {
    let cluster_count = clusters as u32;
    TurnNumbers { bounce, cluster_count, stride: groups_2d(cluster_count)[0] }
}

/// The passes on the adapter.
#[derive(Debug)]
pub struct LodPass {
    mark: (wgpu::ComputePipeline, wgpu::BindGroup),
    mark_groups: [u32; 2],
    fill: wgpu::ComputePipeline,
    /// Coarsest first.
    fills: Vec<(wgpu::BindGroup, [u32; 2])>,
    view: wgpu::Buffer,
    /// Details as the adapter has them.
    written: Vec<Detail>,
    is_on: bool,
}

impl LodPass {
    /// Uploads orders of rows and stand-ins.
    pub fn new(gpu: &Gpu, table: &LodTable, resident: &Resident) -> Result<Self> {
        let DetailBuffers { details, order, turn, full } = &resident.detail;
        gpu.write(order, &table.order);
        let mark = gpu.compute("receivers that are not computed", MARK_SHADER, "mark");
        let bound = [turn, details, order, &resident.e_near].map(wgpu::Buffer::as_entire_binding);
        let mark_group = gpu.bind(&mark.get_bind_group_layout(0), &bound);
        let fill = gpu.compute("stand-ins", FILL_SHADER, "fill");
        let view = gpu.uniform("eye", &LodView::default());
        let mut fills = Vec::new();
        for level in (0..LOD_LEVELS - 1).rev() {
            let stand_ins = &table.stand_ins[level];
            let bytes = stand_ins.iter().map(|_| size_of::<StandIn>() as u64);
            for run in pages(gpu, "receiver's stand-ins", bytes)? {
                let count = run.len() as u32;
                let groups = groups_2d(count.div_ceil(THREADS));
                let numbers = FillNumbers { count, stride: groups[0] * THREADS, level: level as u32 };
                let (numbers, stand_ins) =
                    (gpu.uniform("stand-ins", &numbers), gpu.storage("stand-ins", &stand_ins[run])?);
                let Resident { positions, e_emit, e_ind, .. } = resident;
                let bound = [&numbers, turn, &view, details, &stand_ins, positions, e_emit, e_ind]
                    .map(wgpu::Buffer::as_entire_binding);
                fills.push((gpu.bind(&fill.get_bind_group_layout(0), &bound), groups));
            }
        }
        let mark_groups = groups_2d(full.len() as u32);
        let written = full.clone();
        Ok(Self { mark: (mark, mark_group), mark_groups, fill, fills, view, written, is_on: false })
    }

    /// Writes a plan, or all of each cluster.
    pub fn set(&mut self, gpu: &Gpu, resident: &Resident, plan: Option<&LodPlan>) {
        self.is_on = plan.is_some();
        let detail = &resident.detail;
        let details = plan.map_or(&detail.full, |plan| &plan.details);
        // An eye that moves changes the level of few clusters, and in most frames of none.
        if *details != self.written {
            gpu.write(&detail.details, details);
            self.written.clone_from(details);
        }
        if let Some(plan) = plan {
            gpu.write(&self.view, &[plan.view]);
        }
    }

    /// Writes the number of the next bounce.
    pub fn set_turn(&self, gpu: &Gpu, resident: &Resident, bounce: u32) {
        gpu.write(&resident.detail.turn, &[turn(self.written.len(), bounce)]);
    }

    /// Records the marks, before near hits are gathered.
    pub fn mark(&self, pass: &mut wgpu::ComputePass<'_>) {
        pass.set_pipeline(&self.mark.0);
        pass.set_bind_group(0, &self.mark.1, &[]);
        pass.dispatch_workgroups(self.mark_groups[0], self.mark_groups[1], 1);
    }

    /// Records the stand-ins, after receivers are computed.
    pub fn fill(&self, pass: &mut wgpu::ComputePass<'_>) {
        pass.set_pipeline(&self.fill);
        for (group, [x, y]) in self.fills.iter().filter(|_| self.is_on) {
            pass.set_bind_group(0, group, &[]);
            pass.dispatch_workgroups(*x, *y, 1);
        }
    }
}
