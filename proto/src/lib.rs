//! The contract between Lightkiln's roles: ids, API types, job and plan types, the table of kinds of
//! bake with their settings, manifests, and the chunk format with its normative CPU decoder. No I/O happens here.

pub mod address;
pub mod api;
pub mod chunk;
pub mod commits;
pub mod content;
pub mod evaluation;
pub mod events;
pub mod filter;
pub mod glass;
pub mod harmonics;
pub mod ids;
pub mod jobs;
pub mod kinds;
pub mod limits;
pub mod lobes;
pub mod manifest;
pub mod nearest;
pub mod problem;
pub mod rectangle;
pub mod relight;
pub mod results;
pub mod scene;
pub mod scene_parts;
pub mod settings;
pub mod trace;
pub mod transfer;
pub mod voxels;
pub mod words;
