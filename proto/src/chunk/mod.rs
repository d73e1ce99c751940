//! Chunks: the stored form of a bake (FORMAT.md), with their encoders and their normative decoder. Kinds of bake add
//! chunks of their own with [`container`], [`bytes`], [`ints`] and [`factors`], and name them in their rows of the table ([`ChunkRow`]).
//!
//! A decoder checks every length, count, index and number before it uses it; malformed input is a [`ChunkError`].

pub mod bytes;
mod cells;
mod cluster;
mod cluster_colour;
mod cluster_decode;
mod cluster_head;
mod cluster_near;
mod cluster_receivers;
mod column_keys;
mod column_order;
mod column_scale;
pub mod container;
mod directory;
pub mod error;
pub mod factors;
mod geometry;
mod geometry_decode;
pub mod ints;
mod layers;
pub mod limits;
mod numbers;
mod order;
mod patches;
mod predict;
mod quantise;
mod table;
mod texture;
mod vertices;

pub use cluster::{EncodedCluster, QuantisationSettings, ascending, encode_cluster};
pub use cluster_colour::coloured_cluster;
pub use cluster_decode::{ascending_keys, cluster_layers, decode_cluster, decode_cluster_prefix};
pub use cluster_near::NEAR_WEIGHT_ERROR;
pub use column_scale::column_deviation;
pub use container::{
    CHUNK_BYTES_MAX, ChunkKind, ENTRY_BYTES, HEAD_BYTES_MAX, HEADER_BYTES, MAGIC, SECTIONS_MAX, VERSION,
};
pub use directory::{decode_directory, encode_directory};
pub use error::ChunkError;
pub use geometry::encode_geometry;
pub use geometry_decode::decode_geometry;
pub use layers::{BAND_GROUP_LASTS, FactorShape, LAYERS_MAX, RANK_GROUP_ENDS};
pub use numbers::{
    ALBEDO_ERROR, ALBEDO_MAX, IRRADIANCE_MAX, IRRADIANCE_MIN, IRRADIANCE_RELATIVE_ERROR, NORMAL_ERROR_RAD,
    normal_code, position_error_m,
};
pub use order::{LEVELS_MAX, morton};
pub use patches::{decode_patches, encode_patches};
pub use quantise::{RELATIVE_ERROR_MAX, RELATIVE_ERROR_MIN};
pub use table::{CLUSTER, ChunkRow, DIRECTORY, GEOMETRY, ListLayers, PATCHES, SHARED, TEXTURE};
pub use texture::{Texture, decode_texture, encode_texture};
pub use vertices::LIGHTMAP_ERROR_TEXELS;

use crate::ids::Digest;

/// Errs unless `digest` is the digest of `bytes`.
pub fn verify(digest: Digest, bytes: &[u8]) -> Result<(), ChunkError> {
    let found = Digest::of(bytes);
    if found == digest { Ok(()) } else { Err(ChunkError::Digest { wanted: digest, found }) }
}

#[cfg(test)]
mod tests;
