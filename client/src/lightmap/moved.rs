//! Irradiance that objects give and take at the receivers of a lightmap, and that of what is around an object's.

use glam::Vec4;

use super::passes::LightmapPasses;
use crate::error::Result;
use crate::passes::around::{AroundPass, MixPass};
use crate::passes::gpu::Gpu;
use crate::passes::resident::Resident;
use crate::passes::stopwatch::Recorder;
use crate::passes::transfer::FeedPass;

/// Added to E_ind before λ is made of it.
#[derive(Debug)]
pub(super) struct MovedLight {
    /// By slot, W·m⁻².
    pub(super) moved: wgpu::Buffer,
    /// E_ind without it.
    kept: wgpu::Buffer,
    feed: FeedPass,
    bytes: u64,
}

/// Added to E_ind of each bounce.
#[derive(Debug)]
pub(super) struct AroundLight {
    mix: MixPass,
    add: FeedPass,
    /// E_ind of the bounces, while that of viewpoints is made.
    kept: wgpu::Buffer,
    bytes: u64,
}

impl MovedLight {
    pub(super) fn new(gpu: &Gpu, resident: &Resident) -> Result<Self> {
        let bytes = (resident.receiver_count * size_of::<Vec4>()) as u64;
        let (moved, kept) = (gpu.blank("E of objects", bytes)?, gpu.blank("E_ind before objects", bytes)?);
        let feed =
            FeedPass::clamped(gpu, resident.receiver_count, [&moved, &resident.e_ind, &resident.e_emit]);
        Ok(Self { moved, kept, feed, bytes })
    }

    /// Adds it, before λ is made.
    pub(super) fn add(&self, encoder: &mut Recorder<'_>, resident: &Resident) {
        encoder.copy_buffer_to_buffer(&resident.e_ind, 0, &self.kept, 0, self.bytes);
        self.feed.record(&mut encoder.compute("light by objects"));
    }

    /// Takes it away, before E_ind is written anew.
    pub(super) fn take_away(&self, encoder: &mut Recorder<'_>, resident: &Resident) {
        encoder.copy_buffer_to_buffer(&self.kept, 0, &resident.e_ind, 0, self.bytes);
    }
}

impl AroundLight {
    pub(super) fn new(gpu: &Gpu, resident: &Resident, around: &AroundPass) -> Result<Self> {
        let Resident { positions, e_ind, e_near, receiver_count, .. } = resident;
        let bytes = (receiver_count * size_of::<Vec4>()) as u64;
        let mix = MixPass::new(gpu, around, *receiver_count, [positions, e_ind])?;
        let add = FeedPass::plain(gpu, *receiver_count, [&mix.e_around, e_near]);
        Ok(Self { mix, add, kept: gpu.blank("E_ind before viewpoints", bytes)?, bytes })
    }

    /// Lets start values of a bounce begin at 0.
    pub(super) fn begin(&self, encoder: &mut Recorder<'_>, resident: &Resident) {
        encoder.clear_buffer(&resident.e_near, 0, None);
    }

    /// Adds it to start values.
    pub(super) fn add(&self, encoder: &mut Recorder<'_>) {
        self.add.record(&mut encoder.compute("light by objects"));
    }
}

impl LightmapPasses {
    /// Irradiance of what each viewpoint sees alone, mixed: [`Transport::under`](lightkiln_proto::relight::Transport::under).
    pub(super) fn record_around(&self, encoder: &mut Recorder<'_>, around: &AroundPass) {
        let (Some(own), resident) = (&self.around, &self.resident) else { return };
        let entry = size_of::<Vec4>() as u64;
        let sky_bytes = u64::from(around.sky_parts()) * entry;
        let first_of_sky = resident.lambda_count as u64 * entry - sky_bytes;
        encoder.copy_buffer_to_buffer(&resident.e_ind, 0, &own.kept, 0, own.bytes);
        for viewpoint in 0..around.count() {
            encoder.clear_buffer(&resident.lambda, 0, None);
            encoder.clear_buffer(&resident.e_near, 0, None);
            let from = u64::from(viewpoint) * sky_bytes;
            encoder.copy_buffer_to_buffer(&around.around, from, &resident.lambda, first_of_sky, sky_bytes);
            let mut pass = encoder.compute("light of viewpoints");
            self.basis.record(&mut pass);
            if let Some(walked) = &self.walked {
                walked.record(&mut pass);
            }
            self.reconstruct.record(&mut pass);
            own.mix.record(&mut pass, viewpoint);
        }
        encoder.clear_buffer(&resident.lambda, 0, None);
        encoder.copy_buffer_to_buffer(&own.kept, 0, &resident.e_ind, 0, own.bytes);
    }
}
