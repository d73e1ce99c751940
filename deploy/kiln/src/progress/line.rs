//! A bake's progress as one line whose fields keep their places.

use std::time::Duration;

use super::tracker::Snapshot;

/// Share, stage, tasks of the stage, rays per second, time left. Fields that are not known yet are left blank, so that
/// those after them stay where they are.
pub fn line(snapshot: &Snapshot) -> String {
    let Snapshot { stage, done, total, estimate, rays_per_sec } = snapshot;
    let share = (100.0 * estimate.share).floor();
    let tasks = format!("{done}/{total}");
    let rate = rays_per_sec.map(|rate| format!("{:.2} Mrays/s", rate / 1e6)).unwrap_or_default();
    let left = estimate.left.map(|left| format!("{} left", duration_words(left))).unwrap_or_default();
    let line = format!("{share:3} %  {stage:<9} {tasks:>9} tasks  {rate:>13}  {left:>11}");
    line.trim_end().to_owned()
}

/// A time left in words, as exact as an estimate is.
pub fn duration_words(duration: Duration) -> String {
    let secs = duration.as_secs();
    match secs {
        0..=9 => format!("{} s", secs.max(1)),
        10..=99 => format!("{} s", (secs + 2) / 5 * 5),
        100..=7199 => format!("{} min", (secs + 30) / 60),
        _ => format!("{} h {} min", secs / 3600, secs / 60 % 60),
    }
}

#[cfg(test)]
mod tests {
    use super::super::estimate::Estimate;
    use super::*;

    fn snapshot(stage: &str, done: u64, rate: Option<f64>, left: Option<u64>) -> Snapshot {
        let estimate = Estimate { share: 0.09, left: left.map(Duration::from_secs) };
        Snapshot { stage: stage.into(), done, total: 202, estimate, rays_per_sec: rate }
    }

    #[test]
    fn fields_keep_their_places_whatever_is_known() {
        let known = line(&snapshot("transport", 184, Some(1.2e6), Some(130)));
        assert_eq!(known, "  9 %  transport   184/202 tasks   1.20 Mrays/s   2 min left");
        let other = line(&snapshot("place", 0, None, Some(35)));
        for end in ["%", "tasks", "left"] {
            let place = |line: &str| line.find(end).map(|at| at + end.len());
            assert_eq!(place(&known), place(&other), "{known}\n{other}");
        }
        assert_eq!(line(&snapshot("import", 0, None, None)), "  9 %  import        0/202 tasks");
    }

    #[test]
    fn a_time_left_is_told_as_exactly_as_it_is_known() {
        let words = |secs| duration_words(Duration::from_secs(secs));
        assert_eq!([0, 1, 7].map(words), ["1 s", "1 s", "7 s"]);
        assert_eq!([12, 58, 99].map(words), ["10 s", "60 s", "100 s"]);
        assert_eq!([100, 149, 151, 7199].map(words), ["2 min", "2 min", "3 min", "120 min"]);
        assert_eq!(words(7380), "2 h 3 min");
    }
}
