//! Costs of calls, as `tests/bench/run scale-costs` printed them: one caller, 600 calls of each kind, one `kiln server` (built for
//! release) on an empty database, on two processors of an AMD EPYC under a load of nine by other programs. Processor time is counted
//! in hundredths of a second, so that a figure has steps of 0.02 ms; shared caches and turns may make it larger than on an idle machine.
//!
//! The costs are whole: the part of them that falls under a bake's lock is not measured, and is assumed in the model
//! (`tests/src/scale/run.rs`).

use lightkiln_tests::scale::costs::{Call, Costs};

const fn call(server_ms: f64, database_ms: f64, trips: f64) -> Call {
    Call { server_ms, database_ms, trips }
}

/// On SQLite.
pub const SQLITE: Costs = Costs {
    http_ms: 0.05,
    claim: call(1.65, 0.0, 0.0),
    lease: call(0.16, 0.0, 0.0),
    heartbeat: call(0.63, 0.0, 0.0),
    look: call(0.38, 0.0, 0.0),
    upload: call(2.18, 0.0, 0.0),
    commit: call(4.02, 0.0, 0.0),
    result: call(1.10, 0.0, 0.0),
    flush_ms: 0.62,
};

/// On PostgreSQL 15.
pub const POSTGRES: Costs = Costs {
    http_ms: 0.06,
    claim: call(1.33, 3.15, 5.8),
    lease: call(0.04, 0.11, 0.1),
    heartbeat: call(0.55, 0.72, 5.4),
    look: call(0.40, 0.27, 5.0),
    upload: call(2.78, 1.85, 11.6),
    commit: call(2.88, 6.08, 20.5),
    result: call(0.20, 0.88, 0.1),
    flush_ms: 0.35,
};
