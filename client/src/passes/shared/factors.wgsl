// Clusters and their packed factors; joined in front of the passes that read them. Twin: `relight/packed.rs` of the contract.

struct Cluster {
    first_row: u32,
    row_count: u32,
    first_column: u32,
    column_count: u32,
    rank: u32,
    first_b: u32,
    // First word of this cluster's factor in the page's buffer.
    first_word: u32,
    // Wide columns of ΣVᵀ or wide groups of ranks of U, the first; words of each group of these.
    wide: u32,
    wide_words: u32,
    // Columns of ΣVᵀ behind these whose numbers have 8 bits; those of the others have 4.
    bytes: u32,
}

// Ranks of a group, and words of one by the bits of its numbers.
const GROUP = 8u;
const OF_8 = 2u;
const OF_16 = 4u;

// Four 8-bit numbers of a word.
fn of_8(word: u32) -> vec4f {
    return vec4f(bitcast<vec4i>(vec4u(word << 24u, word << 16u, word << 8u, word)) >> vec4u(24u));
}

// Four 16-bit numbers of two words.
fn of_16(low: u32, high: u32) -> vec4f {
    return vec4f(bitcast<vec4i>(vec4u(low << 16u, low, high << 16u, high)) >> vec4u(16u));
}
