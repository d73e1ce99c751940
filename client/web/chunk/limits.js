// Limits on every count in a chunk, as `proto/src/chunk/limits.rs` has them: checked before anything is allocated.

export const CHUNK_BYTES_MAX = 256 * 2 ** 20;
export const HEAD_BYTES_MAX = 1024;
export const SECTIONS_MAX = 256;
export const LAYERS_MAX = 4;
export const LEVELS_MAX = 4;
export const RECEIVERS_MAX = 65_536;
export const CLUSTER_KEYS_MAX = 16_384;
export const RANK_MAX = 64;
export const BANDS_MAX = 10;
/** Numbers in ΣVᵀ. */
export const VT_ENTRIES_MAX = 2 ** 24;
export const EMITTERS_MAX = 1024;
/** Receivers × emitters. */
export const EMITTER_ENTRIES_MAX = 2 ** 22;
export const NEAR_HITS_MAX = 2 ** 22;
/** Blocks of a cluster's receivers, or of its near hits. */
export const BLOCKS_MAX = 65_536;
export const PATCH_BLOCKS_MAX = 2 ** 22;
export const PATCHES_MAX = 2 ** 24;
export const PATCH_RECEIVERS_MAX = 2 ** 26;
/** Patches that hold one leaf, in the mean. */
export const PATCH_LEVELS_MAX = 16;
export const SKY_PARTS_MAX = 4096;
export const DIRECTORY_CLUSTERS_MAX = 4096;
export const DRAWS_MAX = 65_536;
export const VERTICES_MAX = 2 ** 23;
export const TRIANGLES_MAX = 2 ** 23;
export const MEDIA_TYPE_BYTES_MAX = 64;
export const TEXTURE_BYTES_MAX = 128 * 2 ** 20;
/** Decoded bytes per stored byte, beside those that any chunk may have. */
export const EXPANSION_MAX = 4096;
export const EXPANSION_FREE_BYTES = 16 * 2 ** 20;
