//! A window on a bake: fly through it, move its lights, change its colours, and see the light follow.
//!
//! ```text
//! winit ─▶ app ─▶ viewer ─▶ Frame      input, edits and one bounce a picture; none of it waits
//!           └───▶ panel, handles       controls by egui over the picture
//!           └───▶ feed                 a server's bake, piece by piece from another thread
//! ```
//! The viewer needs no window: tests give it input, and read its pictures.

mod app;
mod detail;
mod edits;
mod feed;
mod fly;
mod handles;
mod input;
mod lens;
mod pace;
mod panel;
mod surface;
#[cfg(test)]
mod tests;
mod viewer;

use std::path::PathBuf;

use crate::bake::{LoadedBake, MeasuredErrors};
use crate::error::Result;
use crate::preview::{StreamedBake, View};
use crate::scene::Recolour;

pub use app::run;

/// A bake to look at.
pub enum Subject {
    /// All of it is there. The function gives it as light that comes piece by piece, for an adapter that has no room for all.
    Whole(Box<LoadedBake>, Box<dyn FnOnce() -> Result<StreamedBake>>),
    /// Its light comes piece by piece, while one looks.
    Streamed(Box<StreamedBake>),
}

/// How a window is opened, and when it closes by itself.
#[derive(Clone, Debug)]
pub struct Options {
    /// Camera, size, lights, exposure, quality at first.
    pub view: View,
    /// Colours of materials at first.
    pub materials: Vec<Recolour>,
    /// Errors of the bake to show at first.
    pub errors: Option<MeasuredErrors>,
    /// Words of the command line that name the bake, for copied commands.
    pub bake_words: String,
    /// Notes to show, such as which light was chosen.
    pub notes: Vec<String>,
    /// The panel is open at first.
    pub has_panel: bool,
    /// Most memory that light which comes piece by piece takes when it is lit, in bytes.
    pub memory: u64,
    /// Closes the window after so many pictures with all the light that is to come, or some later, when the last is whole. A
    /// server that is lost before is an error then.
    pub frames: Option<u64>,
    /// Writes the last picture as PNG when the window closes.
    pub screenshot: Option<PathBuf>,
}
