//! The table, and what it was measured on.

use std::fs::read_to_string;
use std::time::Duration;

/// The machine, and the head of the table.
pub fn begin() {
    let cpu = read_to_string("/proc/cpuinfo").unwrap();
    let model = cpu.lines().find_map(|line| line.strip_prefix("model name")).unwrap_or(": unknown");
    let cores = std::thread::available_parallelism().unwrap();
    let memory = read_to_string("/proc/meminfo").unwrap();
    let memory_kib: u64 = memory.split_whitespace().nth(1).unwrap().parse().unwrap();
    println!(
        "{} × {cores}, {} GiB of memory; {}\n",
        model.trim_start_matches([':', '\t', ' ']),
        memory_kib >> 20,
        load()
    );
    println!("| what | where | figure |\n|---|---|---|");
}

/// The load at the end tells whether others had the machine, too.
pub fn end() {
    println!("\n{}", load());
}

fn load() -> String {
    let load = read_to_string("/proc/loadavg").unwrap();
    format!("load {}", load.split_whitespace().take(3).collect::<Vec<_>>().join(" "))
}

/// One figure.
pub fn row(what: &str, place: &str, figure: &str) {
    println!("| {what} | {place} | {figure} |");
}

/// A time in milliseconds.
pub fn millis(time: Duration) -> String {
    format!("{:.0} ms", time.as_secs_f64() * 1000.0)
}

/// The time that this share of the times is within.
pub fn quantile(times: &mut [Duration], share: f64) -> Duration {
    times.sort_unstable();
    times[((times.len() - 1) as f64 * share).round() as usize]
}

/// Median and 99th percentile, in milliseconds.
pub fn quantiles(times: &mut [Duration]) -> String {
    let [median, late] = [0.5, 0.99].map(|share| quantile(times, share).as_secs_f64() * 1000.0);
    format!("median {median:.1} ms, p99 {late:.1} ms")
}
