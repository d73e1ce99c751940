//! The contract between Lightkiln's roles: ids, units, API types, job and plan types, spherical harmonics, and the
//! chunk format with its normative CPU decoder. No I/O happens here.

pub mod address;
pub mod api;
pub mod bake;
pub mod chunk;
pub mod events;
pub mod ids;
pub mod jobs;
pub mod manifest;
pub mod problem;
pub mod prt;
pub mod scene;
pub mod sh;
pub mod trace;
pub mod units;
pub mod words;
