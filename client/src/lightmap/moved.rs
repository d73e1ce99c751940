//! Irradiance that objects give and take at the receivers of a lightmap, and that of what is around an object's.

use glam::Vec4;
use lightkiln_proto::relight::SkyRows;

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
    pub(super) fn new(gpu: &Gpu, resident: &Resident, around: &AroundPass, rows: &SkyRows) -> Result<Self> {
        let Resident { positions, e_near, receiver_count, .. } = resident;
        let mix = MixPass::new(gpu, around, rows, positions)?;
        let add = FeedPass::plain(gpu, *receiver_count, [&mix.e_around, e_near]);
        Ok(Self { mix, add })
    }

    /// Irradiance of what each viewpoint sees alone, mixed.
    pub(super) fn record(&self, encoder: &mut Recorder<'_>) {
        self.mix.record(&mut encoder.compute("light of viewpoints"));
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
