//! Groups of settings that several kinds of bake share. A task's parameters hold the groups that it depends on, so that
//! kinds and settings that agree in them share its result.

use crate::settings_group;

settings_group! {
    /// Size and layout of lightmap texels.
    TexelSettings {
        /// Size of a lightmap texel in metres; 0 chooses it from `receivers_target`. Smaller → sharper light, more
        /// receivers, time and bytes with its square.
        texel_m: f32 = [0.0, 0.0, 0.0], |v| v == 0.0 || (1e-4..=100.0).contains(&v), "0 (automatic) or 0.0001..=100 m";
        /// Receivers to aim at when `texel_m` is 0, in a scene of many triangles; scenes of few get a fifth of it and 20 per
        /// triangle. (A texel is one of 1, 1.5 × a power of two, so the count is met within a factor of about two.) More →
        /// finer texels.
        receivers_target: u32 = [30_000, 200_000, 600_000], |v| (100..=20_000_000).contains(&v), "100..=20000000";
        /// Levels of detail that texel gaps and chunk layers provide for. More → wider gaps between charts.
        lod_levels: u32 = [3, 3, 3], |v| (1..=4).contains(&v), "1..=4 levels";
    }
}

impl TexelSettings {
    /// Texels between charts: one texel of the coarsest level, so that its filter stays inside the chart's own rim.
    pub fn gutter_texels(&self) -> u32 {
        1 << (self.lod_levels - 1)
    }
}

settings_group! {
    /// Places of receivers.
    PlaceSettings {
        /// A receiver is shifted out of geometry when at least this share of its rays meets back faces and none escapes.
        shift_back_face_min: f32 = [0.6, 0.6, 0.6], |v| (0.0..=1.0).contains(&v), "0..=1";
        /// Narrow places, whose mean free path is below so many metres and which nothing in the open sees, get no receivers:
        /// insides of hollow bars and walls whose faces are double-sided. (Never more than a quarter of the scene's typical
        /// free path.) 0 keeps them all; 0.3 suits rooms. More → fewer receivers, less time and bytes, dark spots beside
        /// narrow gaps.
        cavity_m: f32 = [0.0, 0.0, 0.0], |v| (0.0..=100.0).contains(&v), "0 (keep them all)..=100 m";
    }
}

settings_group! {
    /// Rays of receivers.
    TransportSettings {
        /// Cosine-distributed rays per receiver. More → less noise in transport, more time.
        transport_rays: u32 = [128, 2048, 4096], |v| (16..=65_536).contains(&v), "16..=65536";
        /// Shadow rays per receiver to emissive surfaces. More → smoother soft shadows, more time.
        emitter_rays: u32 = [32, 128, 256], |v| (4..=65_536).contains(&v), "4..=65536";
    }
}

settings_group! {
    /// Clusters and their factors.
    FactorSettings {
        /// Most receivers in a cluster. More → more work per factorisation.
        cluster_receivers: u32 = [256, 256, 256], |v| (16..=8192).contains(&v), "16..=8192";
        /// Highest rank of a cluster's factors; a cluster that needs more is split.
        rank_max: u32 = [48, 64, 64], |v| (1..=64).contains(&v), "1..=64";
        /// Smallest cluster that is still split when `rank_max` does not suffice.
        split_receivers_min: u32 = [256, 256, 256], |v| (2..=8192).contains(&v), "2..=8192";
    }
}
