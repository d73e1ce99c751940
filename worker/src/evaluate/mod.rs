//! How right a bake is: E_ind at receivers under lights that it never met, against the path tracer (METHOD.md §4.5).
//!
//! [`Evaluator`] makes the bake's world anew from its scene and settings, decodes its chunks, and draws a [`Sample`] of
//! receivers by area. Under each light the decoded chunks are relit by the normative reconstruction until bounces
//! converge, with E_dir from exact rays; what that gives at the sampled receivers is compared with
//! [`crate::reference`], and split into [`Classes`] of error. Synchronous and pure; files and pages are the caller's.

mod baked;
mod classes;
mod clusters;
mod error;
mod evaluator;
mod figures;
mod light_file;
mod lights;
mod sample;
mod solid;
#[cfg(test)]
mod tests;

pub use baked::{Baked, Direct, DirectAt, Incoming, Place, Settled, names};
pub use classes::Classes;
pub use clusters::{ClusterError, cluster_errors};
pub use error::EvaluationError;
pub use evaluator::{Evaluator, LightResult, Options};
pub use figures::{Figures, Pair};
pub use light_file::lights_of_file;
pub use lights::{Chosen, TestLight};
pub use sample::{Sample, Sampled, site_of};
