//! First light: how near a small overview of a bake comes to all of it, at how many bytes. An overview is a bake of its own, with some
//! of the receivers and with coarse patches, made of the chunks of the whole.

mod coarse;
mod factor;
mod measure;
mod overview;
mod rows;

pub use measure::{FirstLight, Whole};
pub use overview::{Overview, Size, overview};
