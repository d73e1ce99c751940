//! Times as people write and read them.

use chrono::{DateTime, NaiveDate, SecondsFormat};
use lightkiln_server::clock::{Clock as _, SystemClock};

/// A moment to the millisecond, e.g. `2026-11-24T07:30:00.250Z`.
pub fn utc(unix_ms: i64) -> String {
    rfc3339(unix_ms, SecondsFormat::Millis)
}

/// A moment to the second, e.g. `2026-11-24T07:30:00Z`.
pub fn utc_secs(unix_ms: i64) -> String {
    rfc3339(unix_ms, SecondsFormat::Secs)
}

fn rfc3339(unix_ms: i64, format: SecondsFormat) -> String {
    DateTime::from_timestamp_millis(unix_ms).unwrap_or_default().to_rfc3339_opts(format, true)
}

/// Unix milliseconds of a moment that an argument names: by its age (`90s`, `12h`, `7d`), its day or its second (UTC).
///
/// Errs with what may be written.
pub fn moment(text: &str) -> Result<i64, String> {
    moment_before(text, SystemClock.now_ms())
}

fn moment_before(text: &str, now_ms: i64) -> Result<i64, String> {
    if let Ok(age) = humantime::parse_duration(text) {
        return Ok(now_ms.saturating_sub(i64::try_from(age.as_millis()).unwrap_or(i64::MAX)).max(0));
    }
    let day = || Some(text.parse::<NaiveDate>().ok()?.and_hms_opt(0, 0, 0)?.and_utc().timestamp_millis());
    let second = || Some(DateTime::parse_from_rfc3339(text).ok()?.timestamp_millis());
    let at_ms = day().or_else(second).filter(|at_ms| *at_ms >= 0);
    at_ms.ok_or_else(|| "write an age, e.g. 90m, 12h or 7d, or a day, e.g. 2026-11-24".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_named_by_age_day_and_second() {
        let now_ms = 1_000_000_000_000;
        let day_ms = 86_400_000;
        for (text, at_ms) in [
            ("90s", now_ms - 90_000),
            ("2h 30m", now_ms - 9_000_000),
            ("7d", now_ms - 7 * day_ms),
            ("1000years", 0),
            ("1970-01-03", 2 * day_ms),
            ("1970-01-01T01:00:00+01:00", 0),
        ] {
            assert_eq!(moment_before(text, now_ms), Ok(at_ms), "{text}");
        }
        for wrong in ["", "soon", "-1h", "7", "1969-12-31", "2026-13-01"] {
            assert!(moment_before(wrong, now_ms).unwrap_err().contains("12h"), "{wrong}");
        }
        assert_eq!([utc(1_250), utc_secs(1_250)], ["1970-01-01T00:00:01.250Z", "1970-01-01T00:00:01Z"]);
    }
}
