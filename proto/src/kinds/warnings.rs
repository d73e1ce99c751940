//! Warnings of a bake that came out worse than its settings ask for, each with the setting that would help.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::manifest::{ClusterRow, ClusterTotals};

/// Least share of the receivers in clusters beyond `rank_error` that is warned of.
const BLURRED_MIN: f64 = 0.02;
/// A cluster whose error is this high keeps nothing of its light that could be told from noise.
const LOST_ERROR: f32 = 0.5;
/// Least shares of receivers without light, and of light that is left out, that are warned of.
const DARK_MIN: f64 = 0.002;
const LEFT_OUT_MIN: f64 = 0.005;
/// Highest `rank_max`.
const RANK_MAX: f64 = 64.0;
/// `cavity_m` that suits rooms.
const CAVITY_M: f64 = 0.3;

/// Something about a bake that its owner should know.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Warning {
    /// Its kind, for scripts.
    pub code: String,
    /// What is wrong, where, and how much, in one line.
    pub message: String,
    /// A setting that would help, as `--set` takes it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub try_setting: Option<String>,
}

impl Warning {
    /// The warning in a line.
    pub fn line(&self) -> String {
        let message = self.message.replace(['\n', '\r'], " ");
        match &self.try_setting {
            Some(setting) => format!("{message}; try --set {setting} ({})", self.code),
            None => format!("{message} ({})", self.code),
        }
    }
}

/// Warnings of a bake in factorised clusters, by the settings that its manifest states. `finer` is the kind's setting that brings light to where it is left out.
pub fn cluster_warnings(
    settings: &Value,
    totals: &ClusterTotals,
    rows: &[ClusterRow],
    finer: Option<String>,
) -> Vec<Warning> {
    let warnings = [lost(settings, rows), blurred(settings, rows), dark(totals), left_out(totals, finer)];
    warnings.into_iter().flatten().collect()
}

/// Number of clusters whose error is beyond `rank_error`.
pub(crate) fn count_above(settings: &Value, rows: &[ClusterRow]) -> usize {
    rows.iter().filter(|row| is_above(row, rank_error(settings))).count()
}

/// A little more is within the rounding.
fn is_above(row: &ClusterRow, rank_error: f64) -> bool {
    f64::from(row.truncation_error) > rank_error * 1.0001
}

fn lost(settings: &Value, rows: &[ClusterRow]) -> Option<Warning> {
    let lost: Vec<&ClusterRow> = rows.iter().filter(|row| row.truncation_error >= LOST_ERROR).collect();
    let largest = lost.iter().max_by_key(|row| row.receivers)?;
    let [x, y, z] = largest.middle_m();
    let receivers: u64 = lost.iter().map(|row| u64::from(row.receivers)).sum();
    let rays = setting(settings, "transport_rays").unwrap_or(0.0);
    Some(Warning {
        code: "light-lost".into(),
        message: format!(
            "{} of {} clusters, with {receivers} receivers, keep little or nothing of their light, as it cannot be told \
             from noise; the largest is at {x:.2}, {y:.2}, {z:.2}",
            lost.len(),
            rows.len(),
        ),
        try_setting: (rays > 0.0).then(|| format!("transport_rays={}", (4.0 * rays).min(65_536.0))),
    })
}

fn blurred(settings: &Value, rows: &[ClusterRow]) -> Option<Warning> {
    let rank_error = rank_error(settings);
    let above: Vec<&ClusterRow> = rows.iter().filter(|row| is_above(row, rank_error)).collect();
    let receivers = |rows: &[&ClusterRow]| rows.iter().map(|row| f64::from(row.receivers)).sum::<f64>();
    let share = receivers(&above) / receivers(&rows.iter().collect::<Vec<_>>()).max(1.0);
    let highest = above.iter().map(|row| row.truncation_error).fold(0.0, f32::max);
    (share >= BLURRED_MIN).then(|| Warning {
        code: "rank-error-exceeded".into(),
        message: format!(
            "light is blurred in {} of {} clusters ({:.0} % of the receivers): their error is above rank_error \
             {rank_error}, up to {highest:.3}, as rank_max {} does not suffice",
            above.len(),
            rows.len(),
            100.0 * share,
            setting(settings, "rank_max").unwrap_or(0.0),
        ),
        try_setting: more_ranks(settings),
    })
}

/// More ranks; where there are as many as can be, smaller clusters, which need fewer.
fn more_ranks(settings: &Value) -> Option<String> {
    if setting(settings, "rank_max")? < RANK_MAX {
        return Some(format!("rank_max={RANK_MAX}"));
    }
    let smaller = (setting(settings, "split_receivers_min")? / 4.0).floor();
    (smaller >= 16.0).then(|| format!("split_receivers_min={smaller}"))
}

fn dark(totals: &ClusterTotals) -> Option<Warning> {
    let dark = totals.receivers_without_light;
    // As f64: both counts come out of a file, and their sum need not fit into an integer.
    let share = dark as f64 / (totals.receivers as f64 + dark as f64).max(1.0);
    (share >= DARK_MIN).then(|| Warning {
        code: "receivers-without-light".into(),
        message: format!(
            "{dark} receivers ({:.1} %) get no light, as they lie inside solids or in gaps that are narrower than a \
             texel; their neighbours' light stands in for it, and a smaller texel_m reaches more of the gaps",
            100.0 * share
        ),
        try_setting: Some(format!("cavity_m={CAVITY_M}")),
    })
}

fn left_out(totals: &ClusterTotals, finer: Option<String>) -> Option<Warning> {
    (totals.left_out_fraction >= LEFT_OUT_MIN).then(|| Warning {
        code: "light-left-out".into(),
        message: format!(
            "{:.1} % of the light comes from places that the bake does not know, and is left out: the picture is that much \
             too dark",
            100.0 * totals.left_out_fraction
        ),
        try_setting: finer,
    })
}

fn rank_error(settings: &Value) -> f64 {
    setting(settings, "rank_error").unwrap_or(f64::INFINITY)
}

/// A setting by its name, as the manifest states it; those of newer programs may lack it.
fn setting(settings: &Value, name: &str) -> Option<f64> {
    let value = settings.get(name)?.as_f64()?;
    // Settings are stored as f32, and 0.02 of these is not 0.02.
    (value as f32).to_string().parse().ok()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn row(receivers: u32, truncation_error: f32) -> ClusterRow {
        ClusterRow {
            bounds_m: [[0.0; 3], [2.0; 3]],
            receivers,
            keys: 4,
            rank: 3,
            truncation_error,
            quantisation_error: 0.0,
            uncovered_fraction: 0.0,
            layers: Vec::new(),
            checks: Vec::new(),
        }
    }

    fn settings(rank_max: u32) -> Value {
        json!({ "rank_error": 0.02_f32, "rank_max": rank_max, "split_receivers_min": 256, "transport_rays": 128 })
    }

    fn warnings(rows: &[ClusterRow], of: impl FnOnce(&mut ClusterTotals)) -> Vec<Warning> {
        let settings = settings(48);
        let mut totals = ClusterTotals::of(rows);
        of(&mut totals);
        cluster_warnings(&settings, &totals, rows, Some("texel_m=0.05".into()))
    }

    #[test]
    fn bake_within_its_settings_warns_of_nothing() {
        assert_eq!(warnings(&[row(100, 0.02), row(100, 0.001)], |_| ()), []);
        // A small share beyond is no poor bake.
        assert_eq!(warnings(&[row(1000, 0.01), row(10, 0.03)], |_| ()), []);
    }

    #[test]
    fn clusters_beyond_rank_error_are_counted_with_the_setting_that_helps() {
        let found = warnings(&[row(100, 0.02), row(100, 0.05), row(200, 0.09)], |_| ());
        let [blurred] = &found[..] else { panic!("{found:?}") };
        assert_eq!(blurred.code, "rank-error-exceeded");
        let words = "blurred in 2 of 3 clusters (75 % of the receivers)";
        assert!(blurred.message.contains(words) && blurred.message.contains("0.090"), "{blurred:?}");
        assert!(blurred.line().contains("; try --set rank_max=64 ("), "{}", blurred.line());
        assert_eq!(more_ranks(&settings(64)).as_deref(), Some("split_receivers_min=64"));
    }

    #[test]
    fn cluster_that_lost_its_light_is_named_by_its_place() {
        let found = warnings(&[row(3000, 0.01), row(7, 1.0)], |_| ());
        let [lost] = &found[..] else { panic!("{found:?}") };
        assert!(lost.message.contains("1 of 2") && lost.message.contains("1.00, 1.00, 1.00"), "{lost:?}");
        assert_eq!(lost.try_setting.as_deref(), Some("transport_rays=512"));
    }

    #[test]
    fn receivers_without_light_and_light_left_out_are_told() {
        let found = warnings(&[row(1000, 0.01)], |totals| {
            totals.receivers_without_light = 349;
            totals.left_out_fraction = 0.03;
        });
        let codes: Vec<&str> = found.iter().map(|warning| warning.code.as_str()).collect();
        assert_eq!(codes, ["receivers-without-light", "light-left-out"]);
        assert!(found[0].message.starts_with("349 receivers (25.9 %)"), "{found:?}");
        assert_eq!(found[1].try_setting.as_deref(), Some("texel_m=0.05"));
    }

    #[test]
    fn counts_of_a_damaged_manifest_are_warned_of_like_others() {
        let found = warnings(&[row(1000, 0.01)], |totals| totals.receivers_without_light = u64::MAX);
        assert!(found[0].message.contains("(100.0 %)"), "{found:?}");
    }

    #[test]
    fn warning_is_one_line() {
        let warning = Warning { code: "a".into(), message: "one\ntwo".into(), try_setting: None };
        assert_eq!(warning.line(), "one two (a)");
    }
}
