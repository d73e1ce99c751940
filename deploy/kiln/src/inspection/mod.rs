//! Figures of a bundle or a chunk, for people and as JSON.

mod bundle;
mod chunk;

pub use bundle::BundleFigures;
pub use chunk::ChunkFigures;
