//! Behaviour of scene import, on tiny glTFs built in memory.

mod appearance;
mod bundles;
mod compressed;
mod details;
mod document_builder;
mod geometry;
mod hostile;
mod movers;
mod moving;
mod nodes;
mod textures;
