//! The load bench: what the queue costs and carries, how fast rays are, and what bakes take. `tests/bench/run` builds what it
//! needs and runs it.
//!
//! Arguments name parts (`stores`, `plans`, `queue`, `idle`, `workers`, `scale-costs`, `scale-load`, `scale-model`, `rays`, `bakes`,
//! `relight`, `field`, `walks`, `objects`); without any, all are measured. Figures go to standard output as rows of one table, which `tests/bench/README.md`
//! keeps.

#![allow(clippy::unwrap_used, reason = "a bench may end at any error")]
#![allow(clippy::disallowed_methods, reason = "a bench looks from time to time at what other processes do")]

mod bakes;
mod calls;
mod farm;
mod field;
mod idle;
#[path = "../../server/tests/model/mod.rs"]
mod model;
mod objects;
#[path = "../../server/tests/parts/mod.rs"]
mod parts;
mod plans;
mod queue;
mod rays;
mod relight;
mod report;
mod scale;
mod scenes;
mod stores;
mod walks;
mod workers;

/// Measurements by name.
const PARTS: [(&str, fn()); 14] = [
    ("stores", stores::measure),
    ("plans", plans::measure),
    ("queue", queue::measure),
    ("idle", idle::measure),
    ("workers", workers::measure),
    ("scale-costs", scale::measure_costs),
    ("scale-load", scale::measure_load),
    ("scale-model", scale::measure_model),
    ("rays", rays::measure),
    ("bakes", bakes::measure),
    ("relight", relight::measure),
    ("field", field::measure),
    ("walks", walks::measure),
    ("objects", objects::measure),
];

fn main() {
    // Cargo adds a flag of its own.
    let wanted: Vec<String> =
        std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    for name in &wanted {
        let names = PARTS.map(|(part, _)| part);
        assert!(names.contains(&name.as_str()), "there is no part '{name}', only {names:?}");
    }
    report::begin();
    for (name, measure) in PARTS {
        if wanted.is_empty() || wanted.iter().any(|wanted| wanted == name) {
            measure();
        }
    }
    report::end();
}
