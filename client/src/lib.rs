//! Lightkiln's thin client: fetches a bake's manifest and chunks, and relights the scene.
//!
//! [`fetch`] reads bundles and servers, [`bake`] decodes a bake into flat arrays, [`passes`] are the steps of the
//! frame (each on the graphics adapter and, as its reference, on the processor), [`preview`] draws pictures.
//! Nothing here panics on a bad chunk: malformed input is a [`ClientError`].

pub mod bake;
mod error;
pub mod fetch;
#[cfg(test)]
mod fixture;
pub mod lights;
pub mod passes;
pub mod picture;
pub mod preview;
pub mod raster;

pub use error::{ClientError, Result};
