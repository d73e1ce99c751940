//! Lightkiln's thin client: fetches a bake's manifest and chunks, and relights the scene.
//!
//! [`fetch`] reads bundles and servers, [`scene`] and [`bake`] hold a bake in memory, [`kinds`] load its
//! light, [`passes`] are the steps of the frame (each on the graphics adapter and, as its reference, on the processor),
//! [`frame`] keeps them on an adapter while lights change, [`preview`] draws pictures, [`export`] freezes light for engines, [`web`] gives browsers the shaders. Nothing here panics on a bad chunk: malformed input is a [`ClientError`].
//!
//! ```no_run
//! use lightkiln_client::{bake::LoadedBake, fetch::Source, kinds, preview};
//!
//! let bake = LoadedBake::load(&Source::bundle("room.bake")?, &kinds::all())?;
//! let (view, notes) = preview::View::of_bake(&bake, None, None)?;
//! notes.iter().for_each(|note| eprintln!("{note}"));
//! preview::render_png(&bake, &view, preview::Backend::Auto, "room.png".as_ref())?;
//! # Ok::<(), lightkiln_client::ClientError>(())
//! ```

pub mod bake;
mod error;
pub mod export;
pub mod fetch;
#[cfg(test)]
mod fixture;
pub mod frame;
pub mod kinds;
pub mod lightmap;
pub mod lights;
mod movers;
pub mod passes;
pub mod picture;
pub mod preview;
pub mod raster;
pub mod scene;
pub mod stream;
#[cfg(test)]
mod tests;
mod threads;
#[cfg(feature = "view")]
pub mod view;
pub mod web;

pub use error::{ClientError, Result};
pub use threads::Threads;
pub use wgpu;
