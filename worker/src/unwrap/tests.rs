//! Behaviour of whole unwraps.

mod meshes;
mod oversize;
mod rules;
mod second_uv;
mod shapes;
mod soups;
