//! Limits on every count in a chunk. Encoders refuse more, decoders check them before they allocate.

use crate::harmonics::MAX_BANDS;

/// Most receivers in a cluster.
pub const RECEIVERS_MAX: usize = 65_536;
/// Most keys of a cluster's columns: patches, or probes.
pub const CLUSTER_KEYS_MAX: usize = 16_384;
/// Highest rank of a cluster's factors.
pub const RANK_MAX: usize = 64;
/// Highest spherical-harmonic band.
pub const BANDS_MAX: usize = MAX_BANDS;
/// Most numbers in ΣVᵀ (64 MiB decoded).
pub const VT_ENTRIES_MAX: usize = 1 << 24;
/// Most emitters that a cluster lists.
pub const EMITTERS_MAX: usize = 1024;
/// Most irradiances of emitters in a cluster: receivers × emitters.
pub const EMITTER_ENTRIES_MAX: usize = 1 << 22;
/// Most near hits in a cluster.
pub const NEAR_HITS_MAX: usize = 1 << 22;
/// Most blocks of a cluster's receivers, of its near hits, or of the hits in a batch of probes.
pub const BLOCKS_MAX: usize = 65_536;
/// Most blocks of the receivers of patches: those of a whole scene.
pub const PATCH_BLOCKS_MAX: usize = 1 << 22;
/// Most surface patches of a bake.
pub const PATCHES_MAX: usize = 1 << 24;
/// Most receivers of all patches' leaves.
pub const PATCH_RECEIVERS_MAX: usize = 1 << 26;
/// Most patches that hold one leaf, in the mean: levels of their tree.
pub const PATCH_LEVELS_MAX: u64 = 16;
/// Most parts of the sky; always a power of two.
pub const SKY_PARTS_MAX: usize = 4096;
/// Most clusters in a page of a directory.
pub const DIRECTORY_CLUSTERS_MAX: usize = 4096;
/// Most draws in a geometry chunk.
pub const DRAWS_MAX: usize = 65_536;
/// Most vertices in a geometry chunk.
pub const VERTICES_MAX: usize = 1 << 23;
/// Most triangles in a geometry chunk.
pub const TRIANGLES_MAX: usize = 1 << 23;
/// Longest media type of a texture.
pub const MEDIA_TYPE_BYTES_MAX: usize = 64;
/// Longest texture file: 128 MiB.
pub const TEXTURE_BYTES_MAX: usize = 128 << 20;
/// Most decoded bytes per stored byte, beside [`EXPANSION_FREE_BYTES`]: a small chunk cannot ask for much memory. Real
/// chunks stay below 100.
pub const EXPANSION_MAX: u64 = 4096;
/// Decoded bytes that any chunk may have.
pub const EXPANSION_FREE_BYTES: u64 = 16 << 20;
