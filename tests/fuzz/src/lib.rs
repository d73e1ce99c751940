//! Entry points for libFuzzer; see README.md.

#[allow(clippy::unwrap_used, reason = "a panic is what a fuzzer looks for")]
pub mod targets;
