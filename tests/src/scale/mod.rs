//! A farm in a model, for farms larger than a machine can hold: throughput, tail, and load of servers and database, from measured costs of
//! calls and measured task times. `tests/bench` measures the costs, runs the model, and compares it with a run of real workers.

pub mod costs;
pub mod engine;
pub mod farm;
mod run;
#[cfg(test)]
mod tests;
pub mod timeline;
pub mod times;
