//! Settings of the relightable bake.

use crate::settings::{FactorSettings, PlaceSettings, TexelSettings, TransportSettings};
use crate::{kind_settings, settings_group};

settings_group! {
    /// Surface patches, the sky's parts and near hits.
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
        near_hits: u32 = [0, 32, 32], |v| v <= 255, "0..=255";
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
        /// Patches, sky and near hits.
        patches: PatchSettings,
        /// Clusters and factors.
        factors: FactorSettings,
    }
}
