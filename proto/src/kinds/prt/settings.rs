//! Settings of the relightable bake.

use crate::kinds::Rates;
use crate::kinds::voxels::{VoxelPresence, VoxelSettings};
use crate::settings::{FactorSettings, PlaceSettings, TexelSettings, TransportSettings};
use crate::{kind_settings, settings_group};

/// Bakes that the rates are from.
const MEASURED: &str = "a Cornell box and an atrium, draft and medium, on two threads of a server of 2026";

settings_group! {
    /// Surface patches, the sky's parts, near hits and the error of factors.
    PatchSettings {
        /// Most patches that a cluster tells apart, besides the parts of the sky; those whose telling apart would lower the
        /// error of irradiance by less than `rank_error²/patches_max`, in squares, are not. More → sharper light, more bytes
        /// and time.
        patches_max: u32 = [1024, 4096, 8192], |v| (16..=8192).contains(&v), "16..=8192";
        /// Parts of the sky (a power of two). More → a sharper sky, more columns.
        sky_parts: u32 = [64, 64, 128], |v| v.is_power_of_two() && (16..=4096).contains(&v), "a power of two in 16..=4096";
        /// Reach of near hits in texels: closer hits are read at their very points, in places so narrow that a quarter of a
        /// receiver's rays meet something as close. More → more such places, sharper light in gaps, more bytes.
        near_texels: f32 = [2.0, 2.0, 2.0], |v| (0.01..=16.0).contains(&v), "0.01..=16 texels";
        /// Near hits that a receiver in a narrow place keeps; 0: none, all light is that of texels. More → less noise in gaps
        /// that a lamp shines into, more bytes and run-time cost.
        near_hits: u32 = [0, 16, 16], |v| v <= 255, "0..=255";
        /// Relative error of truncation: the smallest rank whose dropped signal holds at most this share (root of the squares,
        /// columns weighted by the radiance that they are expected to have). It also bounds the loss by patches that are not
        /// told apart, and by quantisation. Smaller → higher ranks, more bytes.
        rank_error: f32 = [0.01, 0.005, 0.003], |v| (1e-5..=0.5).contains(&v), "0.00001..=0.5";
    }
}

kind_settings! {
    /// Settings of a relightable bake.
    Settings of super::NAME => {
        /// Texels of the lightmap.
        texels: TexelSettings,
        /// Places of receivers.
        place: PlaceSettings,
        /// Rays.
        transport: TransportSettings,
        /// Patches, sky, near hits and the error of factors.
        patches: PatchSettings,
        /// Clusters and factors.
        factors: FactorSettings,
        /// Whether it has voxels.
        has_voxels: VoxelPresence,
        /// Voxels.
        voxels: VoxelSettings,
    }
}

impl Settings {
    /// Cost of a receiver.
    pub(super) fn rates(&self) -> Rates {
        let rays = f64::from(self.transport.transport_rays + self.transport.emitter_rays);
        Rates {
            cpu_us: 300.0 + 0.7 * rays,
            bundle_bytes: 60.0,
            memory_bytes: 2200.0,
            cluster_receivers: f64::from(self.factors.cluster_receivers),
            measured: MEASURED,
        }
    }
}
