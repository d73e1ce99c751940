//! Error of a bake: E_ind at places under lights that it has not seen, against the path tracer (METHOD.md §3).
//!
//! A kind of bake answers through [`Evaluated`]: it makes the bake's world anew, decodes its chunks, and says how much light
//! is at a hit under given lights. [`Evaluator`] draws a [`Sample`] of such places by area and light, compares each answer with
//! [`crate::reference`], and sums up figures and the kind's own classes of error. [`Pixels`] are measured beside them: points
//! that read the bake as pictures do, seams, and texels that stand out; a client may give its shadow maps by
//! [`ClientLights`]. Synchronous and pure; files and pages are the caller's.

mod clusters;
mod error;
mod evaluated;
mod evaluator;
mod figures;
mod hunt;
mod light_file;
mod lights;
mod open;
mod pixels;
mod sample;
mod seams;
mod shadow;
mod solid;

pub use clusters::{ClusterError, cluster_errors};
pub use error::EvaluationError;
pub use evaluated::{Answer, ChunkBytes, ErrorClass, Evaluated, EvaluatedLightmap, Measure, Place, Relit};
pub use evaluator::{ClassResult, Evaluator, LightResult, Options, PIXEL_CLASSES, PixelResult};
pub use figures::{Draw, Figures, Intervals, Pair, RelativeRoot};
pub use hunt::{Hunt, Outlier};
pub use light_file::lights_of_file;
pub use lights::{Chosen, TestLight, default_lights, panorama_light, usable_lights};
pub use pixels::{PixelFigures, Pixels};
pub use sample::{Sample, Sampled, SampledHit};
pub use seams::{Borders, Jumps, Seams, Step};
pub use shadow::{ClientLights, DirectShares, MappedIncoming, MappedLight, MappedPixel};

#[cfg(test)]
mod tests;
