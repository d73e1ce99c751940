//! Settings of the relightable bake: a raw form with presets, validated into [`Settings`].
//!
//! Each field says its unit, its range and what more or less of it does.

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// A setting that is unknown or out of range.
#[derive(Debug, Error)]
pub enum SettingsError {
    /// A key or a type that the bake does not know.
    #[error("{0}")]
    Malformed(String),
    /// A value outside its range.
    #[error("{name} = {value} is out of range: {range}")]
    OutOfRange {
        /// Setting.
        name: &'static str,
        /// Value given.
        value: String,
        /// Allowed range, with unit.
        range: &'static str,
    },
}

/// How much work to spend; sets every default below.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// A look within seconds: coarse texels, noisy.
    Draft,
    /// Everyday bakes.
    #[default]
    Medium,
    /// Final bakes, held to the published error figures.
    High,
}

/// What light is carried by from where it leaves to where it arrives (METHOD.md "Basis at the probe").
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BasisKind {
    /// Real spherical harmonics at probes.
    Sh,
    /// Mean radiance of surface patches: small ones near a receiver, large ones far away. At equal bytes it is closer to the
    /// reference than spherical harmonics, and faster to bake.
    #[default]
    Patches,
}

/// A numeric setting as documentation shows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SettingRow {
    /// Key in settings files and `--set`.
    pub name: &'static str,
    /// Allowed values, with unit.
    pub range: &'static str,
    /// Values under draft, medium and high.
    pub presets: [f64; 3],
    /// What it is, and what more and less of it does.
    pub effect: &'static str,
}

macro_rules! settings {
    ($( $(#[doc = $doc:literal])* $name:ident : $kind:ty = [$draft:expr, $medium:expr, $high:expr], $check:expr, $range:literal; )*) => {
        /// Settings as a file, a request or `--set` gives them: only what differs from the preset.
        #[derive(Clone, Debug, Default, PartialEq, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct RawSettings {
            /// Preset that fills in the rest; `medium` unless set.
            pub preset: Option<Preset>,
            /// What carries light: `sh` or `patches`.
            pub basis: Option<BasisKind>,
            $( $(#[doc = $doc])* pub $name: Option<$kind>, )*
        }

        /// Validated settings; every bake states all of them in its manifest. What an older one did not know yet is read as
        /// its preset has it; but it has no near hits.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        #[serde(try_from = "RawSettings")]
        pub struct Settings {
            /// Preset that the rest started from.
            pub preset: Preset,
            /// What carries light.
            pub basis: BasisKind,
            $( $(#[doc = $doc])* pub $name: $kind, )*
        }

        impl TryFrom<RawSettings> for Settings {
            type Error = SettingsError;

            fn try_from(raw: RawSettings) -> Result<Self, SettingsError> {
                let mut raw = raw;
                // A bake of before near hits has none.
                raw.near_hits.get_or_insert(0);
                if raw.preset.is_none() {
                    return Err(SettingsError::Malformed("settings that name no preset".into()));
                }
                raw.validate()
            }
        }

        impl RawSettings {
            /// Fills in the preset and checks every range.
            pub fn validate(self) -> Result<Settings, SettingsError> {
                let preset = self.preset.unwrap_or_default();
                $(
                    let $name: $kind = self.$name.unwrap_or(match preset {
                        Preset::Draft => $draft,
                        Preset::Medium => $medium,
                        Preset::High => $high,
                    });
                    let in_range: fn($kind) -> bool = $check;
                    if !in_range($name) {
                        let value = $name.to_string();
                        return Err(SettingsError::OutOfRange { name: stringify!($name), value, range: $range });
                    }
                )*
                Ok(Settings { preset, basis: self.basis.unwrap_or_default(), $($name,)* })
            }
        }

        impl Settings {
            /// The values of all numeric settings.
            pub(crate) fn numbers(&self) -> Vec<f64> {
                vec![$(f64::from(self.$name)),*]
            }

            /// Every numeric setting.
            pub const TABLE: &'static [SettingRow] = &[$( SettingRow {
                name: stringify!($name),
                range: $range,
                presets: [$draft as f64, $medium as f64, $high as f64],
                effect: concat!($($doc),*),
            }, )*];
        }
    };
}

settings! {
    /// Size of a lightmap texel in metres; 0 chooses it from `receivers_target`. Smaller → sharper light, more
    /// receivers, time and bytes with its square.
    texel_m: f32 = [0.0, 0.0, 0.0], |v| v == 0.0 || (1e-4..=100.0).contains(&v), "0 (automatic) or 0.0001..=100 m";
    /// Receivers to aim at when `texel_m` is 0, in a scene of many triangles; scenes of few get a fifth of it and 20 per
    /// triangle. (A texel is one of 1, 1.5 × a power of two, so the count is met within a factor of about two.) More →
    /// finer texels.
    receivers_target: u32 = [30_000, 200_000, 600_000], |v| (100..=20_000_000).contains(&v), "100..=20000000";
    /// Levels of detail that texel gaps and chunk layers provide for. More → wider gaps between charts.
    lod_levels: u32 = [3, 3, 3], |v| (1..=4).contains(&v), "1..=4 levels";
    /// Distance between probes in metres; 0 chooses it from `probes_target`. Smaller → more probes, sharper and
    /// more local light, more time and bytes.
    probe_spacing_m: f32 = [0.0, 0.0, 0.0], |v| v == 0.0 || (1e-3..=1e4).contains(&v), "0 (automatic) or 0.001..=10000 m";
    /// Probes to aim at when `probe_spacing_m` is 0. More → as a smaller `probe_spacing_m`.
    probes_target: u32 = [60, 250, 700], |v| (1..=100_000).contains(&v), "1..=100000";
    /// Probes that support a receiver; sets the probes' radius. More → smoother light, more columns and time.
    n_overlaps: u32 = [5, 5, 5], |v| (1..=64).contains(&v), "1..=64 probes";
    /// Relight rays per probe (a power of two). More → less noise in moving light, more run-time cost.
    relight_rays: u32 = [256, 512, 1024], |v| v.is_power_of_two() && (16..=16_384).contains(&v), "a power of two in 16..=16384";
    /// Most patches that a cluster tells apart with `basis=patches`, besides the parts of the sky; those whose telling apart
    /// would lower the error of irradiance by less than `rank_error²/patches_max`, in squares, are not. More → sharper
    /// light, more bytes and time.
    patches_max: u32 = [1024, 4096, 8192], |v| (16..=8192).contains(&v), "16..=8192";
    /// Parts of the sky with `basis=patches` (a power of two). More → a sharper sky, more columns.
    sky_parts: u32 = [64, 64, 128], |v| v.is_power_of_two() && (16..=4096).contains(&v), "a power of two in 16..=4096";
    /// Highest spherical-harmonic band; (bands+1)² coefficients per probe. More → sharper, more bytes.
    bands: u32 = [5, 7, 7], |v| v <= 10, "0..=10";
    /// Damping of spherical-harmonic ringing (no run-time cost): band l is scaled by
    /// `1/(1 + s·(l(l+1)/((D+1)(D+2)))²)`. More → less ringing, blurrier.
    window_strength: f32 = [0.5, 0.5, 0.5], |v| (0.0..=100.0).contains(&v), "0..=100";
    /// Cosine-distributed rays per receiver. More → less noise in transport, more time.
    transport_rays: u32 = [128, 1024, 2048], |v| (16..=65_536).contains(&v), "16..=65536";
    /// Shadow rays per receiver to emissive surfaces. More → smoother soft shadows, more time.
    emitter_rays: u32 = [32, 64, 256], |v| (4..=65_536).contains(&v), "4..=65536";
    /// Most receivers in a cluster. More → more work per factorisation; fewer bytes with `basis=sh` (up to 1024).
    cluster_receivers: u32 = [256, 256, 256], |v| (16..=8192).contains(&v), "16..=8192";
    /// Highest rank of a cluster's factors; a cluster that needs more is split.
    rank_max: u32 = [48, 64, 64], |v| (1..=64).contains(&v), "1..=64";
    /// Relative error of truncation: the smallest rank whose dropped singular values hold at most this share
    /// (root of the squares, columns weighted by the spectrum that radiance is expected to have). With patches it also
    /// bounds what may be lost by not telling patches apart, and by quantisation. Smaller → higher ranks, more bytes.
    rank_error: f32 = [0.02, 0.01, 0.005], |v| (1e-5..=0.5).contains(&v), "0.00001..=0.5";
    /// Smallest cluster that is still split when `rank_max` does not suffice.
    split_receivers_min: u32 = [256, 256, 256], |v| (2..=8192).contains(&v), "2..=8192";
    /// Largest share of transported energy that no probe may see, per bake; probes are added until it is met or
    /// `probes_added_max` is reached.
    uncovered_max: f32 = [0.02, 0.005, 0.005], |v| (0.0..=1.0).contains(&v), "0..=1";
    /// Most probes added for coverage, as a share of those placed by density.
    probes_added_max: f32 = [0.5, 1.0, 1.0], |v| (0.0..=10.0).contains(&v), "0..=10";
    /// A candidate probe is inside geometry when more than this share of its rays meets back faces.
    probe_back_face_max: f32 = [0.25, 0.25, 0.25], |v| (0.0..=1.0).contains(&v), "0..=1";
    /// A receiver is shifted out of geometry when at least this share of its rays meets back faces and none escapes.
    shift_back_face_min: f32 = [0.6, 0.6, 0.6], |v| (0.0..=1.0).contains(&v), "0..=1";
    /// How close hits are, in texels, that are read at their very points with `basis=patches`, in places so narrow that a
    /// quarter of a receiver's rays meet something as close. More → more such places, sharper light in gaps, more bytes.
    near_texels: f32 = [2.0, 2.0, 2.0], |v| (0.01..=16.0).contains(&v), "0.01..=16 texels";
    /// Points that a receiver in a narrow place keeps of them; 0: none, all light is that of texels. More → less noise in
    /// gaps that a lamp shines into, more bytes and run-time cost.
    near_hits: u32 = [0, 32, 32], |v| v <= 255, "0..=255";
    /// Places of a mean free path below so many metres that nothing in the open sees get no receivers: the insides of
    /// hollow bars and walls whose faces are double-sided. (Never more than a quarter of the scene's typical free path.)
    /// 0 keeps them all; 0.3 suits rooms. More → fewer receivers, less time and bytes, dark spots beside narrow gaps.
    cavity_m: f32 = [0.0, 0.0, 0.0], |v| (0.0..=100.0).contains(&v), "0 (keep them all)..=100 m";
}

impl Settings {
    /// Reads settings from a request; `null` means all defaults.
    pub fn from_json(json: &serde_json::Value) -> Result<Self, SettingsError> {
        let raw = if json.is_null() {
            RawSettings::default()
        } else {
            RawSettings::deserialize(json).map_err(|error| SettingsError::Malformed(error.to_string()))?
        };
        raw.validate()
    }

    /// Highest band of what carries light: a patch has one coefficient.
    pub fn coefficient_bands(&self) -> u32 {
        match self.basis {
            BasisKind::Sh => self.bands,
            BasisKind::Patches => 0,
        }
    }

    /// Coefficients of a probe, `(bands + 1)²`, or of a patch, 1.
    pub fn coefficients(&self) -> usize {
        let bands = self.coefficient_bands() as usize + 1;
        bands * bands
    }

    /// Texels between charts: one texel of the coarsest level, so that its filter stays inside the chart's own rim.
    pub fn gutter_texels(&self) -> u32 {
        1 << (self.lod_levels - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn presets_are_valid_and_differ() {
        let of = |preset: &str| Settings::from_json(&json!({ "preset": preset })).unwrap();
        assert!(of("draft").transport_rays < of("medium").transport_rays);
        assert!(of("medium").transport_rays < of("high").transport_rays);
    }

    #[test]
    fn settings_of_a_bake_that_did_not_know_one_yet_are_read_with_its_presets_value() {
        let settings = Settings::from_json(&json!({ "preset": "high", "texel_m": 0.25 })).unwrap();
        let mut stated = serde_json::to_value(&settings).unwrap();
        assert_eq!(serde_json::from_value::<Settings>(stated.clone()).unwrap(), settings);
        stated.as_object_mut().unwrap().remove("cavity_m");
        assert_eq!(serde_json::from_value::<Settings>(stated.clone()).unwrap(), settings);
        stated.as_object_mut().unwrap().remove("near_hits");
        let without = Settings { near_hits: 0, ..settings.clone() };
        assert!(settings.near_hits > 0);
        assert_eq!(serde_json::from_value::<Settings>(stated.clone()).unwrap(), without);
        stated["relight_rays"] = json!(100);
        assert!(serde_json::from_value::<Settings>(stated.clone()).is_err());
        stated["relight_rays"] = json!(256);
        stated.as_object_mut().unwrap().remove("preset");
        assert!(serde_json::from_value::<Settings>(stated).is_err());
    }

    #[test]
    fn unknown_keys_and_wrong_ranges_are_rejected_by_name() {
        let unknown = Settings::from_json(&json!({ "texel": 1 })).unwrap_err().to_string();
        assert!(unknown.contains("texel"), "{unknown}");
        let range = Settings::from_json(&json!({ "relight_rays": 100 })).unwrap_err().to_string();
        assert!(range.contains("relight_rays = 100") && range.contains("power of two"), "{range}");
        assert!(Settings::from_json(&json!({ "texel_m": f64::MAX })).is_err());
    }
}
