//! E_dir of receivers on the adapter.

use std::ops::Range;

use wgpu::ShaderStages as Stages;

use super::points::TexelPoints;
use crate::error::Result;
use crate::passes::gpu::{Gpu, groups_2d, storage_read, storage_write, uniform};
use crate::passes::resident::{Resident, pages};
use crate::passes::shadow::ShadowPass;

/// The shader, with the lights' part in front.
pub const TEXELS_SHADER: &str = concat!(
    include_str!("../shared/light.wgsl"),
    include_str!("../shared/rect.wgsl"),
    include_str!("../shared/shadow_map.wgsl"),
    include_str!("../shared/whole_maps.wgsl"),
    include_str!("../shared/unplaced.wgsl"),
    include_str!("texels.wgsl")
);
/// The shader for an object's receivers.
pub const PLACED_TEXELS_SHADER: &str = concat!(
    include_str!("../shared/light.wgsl"),
    include_str!("../shared/rect.wgsl"),
    include_str!("../shared/shadow_map.wgsl"),
    include_str!("../shared/whole_maps.wgsl"),
    include_str!("../shared/placed.wgsl"),
    include_str!("texels.wgsl")
);
/// Threads of a workgroup in the shader.
const THREADS: u32 = 64;

/// Numbers of the pass; twin of `TexelNumbers` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct TexelNumbers {
    /// Slot of the first receiver.
    pub first: u32,
    /// Receivers.
    pub count: u32,
    /// Threads in a row of the dispatch.
    pub stride: u32,
    /// Metres that an offset of 1 is.
    pub reach_m: f32,
}

/// The pass on the adapter.
#[derive(Debug)]
pub struct TexelsPass {
    pipeline: wgpu::ComputePipeline,
    pages: Vec<Page>,
    /// Of an object's receivers.
    place: Option<wgpu::BindGroup>,
}

/// Receivers whose points fit into one binding.
#[derive(Debug)]
struct Page {
    group: wgpu::BindGroup,
    groups: [u32; 2],
}

impl TexelsPass {
    /// Uploads the points of all texels; the lights are the shadow pass'.
    pub fn new(gpu: &Gpu, shadow: &ShadowPass, resident: &Resident, points: &TexelPoints) -> Result<Self> {
        let read = storage_read;
        let kinds = [uniform(false), read(), read(), storage_write(), read(), read()];
        let layout = gpu.bind_layout(&kinds.map(|kind| (Stages::COMPUTE, kind)));
        let (pipeline_layout, shader) = match &resident.place {
            None => (gpu.pipeline_layout(&[&shadow.light_layout, &layout]), TEXELS_SHADER),
            Some(place) => {
                let groups = [&shadow.light_layout, &layout, &place.layout];
                (gpu.pipeline_layout(&groups), PLACED_TEXELS_SHADER)
            }
        };
        let pipeline =
            gpu.compute_with(("direct texels", shader, "direct_texels"), Some(&pipeline_layout), &[]);
        let page = |run: Range<usize>| {
            let [start, end] = [run.start, run.end].map(|slot| points.starts[slot]);
            let starts: Vec<u32> = points.starts[run.start..=run.end].iter().map(|at| at - start).collect();
            let groups = groups_2d((run.len() as u32).div_ceil(THREADS));
            let numbers = TexelNumbers {
                first: run.start as u32,
                count: run.len() as u32,
                stride: groups[0] * THREADS,
                reach_m: points.reach_m,
            };
            let group = gpu.bind(
                &layout,
                &[
                    gpu.uniform("texels", &numbers).as_entire_binding(),
                    resident.positions.as_entire_binding(),
                    resident.normals.as_entire_binding(),
                    resident.e_dir.as_entire_binding(),
                    gpu.storage("first points of texels", &starts)?.as_entire_binding(),
                    gpu.storage("points of texels", &points.points[start as usize..end as usize])?
                        .as_entire_binding(),
                ],
            );
            Ok(Page { group, groups })
        };
        let bytes =
            points.starts.windows(2).map(|pair| u64::from(pair[1] - pair[0]) * size_of::<[u32; 2]>() as u64);
        // A receiver without points takes room in the table of starts alone.
        let bytes = bytes.map(|bytes| bytes.max(2 * size_of::<u32>() as u64));
        let pages = pages(gpu, "receiver's points", bytes)?.into_iter().map(page).collect::<Result<_>>()?;
        let place = resident.place.as_ref().map(|place| place.group.clone());
        Ok(Self { pipeline, pages, place })
    }

    /// Records the pass.
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>, shadow: &ShadowPass) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &shadow.light_group, &[]);
        if let Some(place) = &self.place {
            pass.set_bind_group(2, place, &[]);
        }
        for page in &self.pages {
            pass.set_bind_group(1, &page.group, &[]);
            pass.dispatch_workgroups(page.groups[0], page.groups[1], 1);
        }
    }
}
