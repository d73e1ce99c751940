//! Settings of the bake by spherical harmonics at probes.

use crate::kinds::Rates;
use crate::settings::{FactorSettings, PlaceSettings, TexelSettings, TransportSettings};
use crate::{kind_settings, settings_group};

/// Bakes that the rates are from.
const MEASURED: &str = "a Cornell box and an atrium, draft and medium, on two threads of a server of 2026";

settings_group! {
    /// Probes, their spherical harmonics and the error of factors.
    ProbeSettings {
        /// Distance between probes in metres; 0 chooses it from `probes_target`. Smaller → more probes, sharper and more local
        /// light, more time and bytes.
        probe_spacing_m: f32 = [0.0, 0.0, 0.0], |v| v == 0.0 || (1e-3..=1e4).contains(&v), "0 (automatic) or 0.001..=10000 m";
        /// Probes to aim at when `probe_spacing_m` is 0. More → as a smaller `probe_spacing_m`.
        probes_target: u32 = [60, 250, 700], |v| (1..=100_000).contains(&v), "1..=100000";
        /// Probes that support a receiver; sets the probes' radius. More → smoother light, more columns and time.
        n_overlaps: u32 = [5, 5, 5], |v| (1..=64).contains(&v), "1..=64 probes";
        /// Relight rays per probe (a power of two). More → less noise in moving light, more run-time cost.
        relight_rays: u32 = [256, 512, 1024], |v| v.is_power_of_two() && (16..=16_384).contains(&v), "a power of two in 16..=16384";
        /// Highest spherical-harmonic band; (bands+1)² coefficients per probe. More → sharper, more bytes.
        bands: u32 = [5, 7, 7], |v| v <= 10, "0..=10";
        /// Damping of spherical-harmonic ringing (no run-time cost): band l is scaled by
        /// `1/(1 + s·(l(l+1)/((D+1)(D+2)))²)`. More → less ringing, blurrier.
        window_strength: f32 = [0.5, 0.5, 0.5], |v| (0.0..=100.0).contains(&v), "0..=100";
        /// Largest share of transported energy that no probe may see, per bake; probes are added until it is met or
        /// `probes_added_max` is reached.
        uncovered_max: f32 = [0.02, 0.005, 0.005], |v| (0.0..=1.0).contains(&v), "0..=1";
        /// Most probes added for coverage, as a share of those placed by density.
        probes_added_max: f32 = [0.5, 1.0, 1.0], |v| (0.0..=10.0).contains(&v), "0..=10";
        /// A candidate probe is inside geometry when more than this share of its rays meets back faces.
        probe_back_face_max: f32 = [0.25, 0.25, 0.25], |v| (0.0..=1.0).contains(&v), "0..=1";
        /// Relative error of truncation: the smallest rank whose dropped singular values hold at most this share (root of the
        /// squares, columns weighted by the spectrum that radiance is expected to have). Smaller → higher ranks, more bytes.
        rank_error: f32 = [0.02, 0.012, 0.006], |v| (1e-5..=0.5).contains(&v), "0.00001..=0.5";
    }
}

impl ProbeSettings {
    /// Coefficients of a probe, `(bands + 1)²`.
    pub fn coefficients(&self) -> usize {
        let bands = self.bands as usize + 1;
        bands * bands
    }
}

kind_settings! {
    /// Settings of a bake by spherical harmonics.
    Settings of super::NAME => {
        /// Texels of the lightmap.
        texels: TexelSettings,
        /// Places of receivers.
        place: PlaceSettings,
        /// Rays.
        transport: TransportSettings,
        /// Probes and bands.
        probes: ProbeSettings,
        /// Clusters and factors.
        factors: FactorSettings,
    }
}

impl Settings {
    /// Cost of a receiver.
    pub(super) fn rates(&self) -> Rates {
        let rays = f64::from(self.transport.transport_rays + self.transport.emitter_rays);
        Rates {
            cpu_us: 300.0 + 1.6 * rays,
            bundle_bytes: 90.0,
            memory_bytes: 1500.0,
            cluster_receivers: f64::from(self.factors.cluster_receivers),
            measured: MEASURED,
        }
    }
}
